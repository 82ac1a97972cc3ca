"""An avatar as torch tensors, with gradients or without: what training makes and differentiates.

Fields are those of `avatar.HandAvatar` and `learned.Learned`, in the same shapes and order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.avatar.correctives import LinearCorrectives
from jghand_engine.avatar.learned import Anchors, CastShadow, Ellipsoid, Learned, Light, ShadowLook, SkinResponse
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.cast_shadow import AnchorTensors, CastTensors
from jghand_engine.learn.light import LightTensors
from jghand_engine.learn.pose_net import LinearNet, PoseNet
from jghand_engine.learn.scene_light import ResponseTensors

Record = TypeVar("Record")


@dataclass(frozen=True)
class LearnedTensors:
    """See learned.Learned; without cheaper tiers of the correctives."""

    normal: Tensor
    shine: Tensor
    light: LightTensors
    correctives: PoseNet | LinearNet | None
    shadow: ShadowLook | None
    world_offsets: bool = False
    ellipsoid: Ellipsoid[Tensor] | None = None
    cast: CastTensors | None = None
    response: ResponseTensors | None = None
    in_studio: bool = False


@dataclass(frozen=True)
class HandTensors:
    """See avatar.HandAvatar."""

    info: AvatarInfo
    handedness: Handedness
    canonical_joints_m: Tensor
    position_m: Tensor
    sigma_m: Tensor
    opacity: Tensor
    rgb: Tensor
    bone_weights: Tensor
    uvd: Tensor
    learned: LearnedTensors | None = None

    def __len__(self) -> int:
        return self.position_m.shape[0]

    def for_hand(self, handedness: Handedness) -> HandTensors:
        """The same, driven by joints of the named hand."""
        return replace(self, handedness=Handedness(handedness))

    @classmethod
    def of(cls, avatar: HandAvatar | HandTensors) -> HandTensors:
        """A copy of a finished avatar, without gradients; tensors as they are."""
        if isinstance(avatar, HandTensors):
            return avatar
        hand: HandTensors = _as_tensors(avatar)
        correctives = None if avatar.learned is None else avatar.learned.correctives
        if hand.learned is None or correctives is None:
            return hand
        kind = LinearNet if isinstance(correctives, LinearCorrectives) else PoseNet
        net = kind.of(correctives, hand.bone_weights, hand.uvd)  # type: ignore[arg-type]
        return replace(hand, learned=replace(hand.learned, correctives=net))

    def avatar(self) -> HandAvatar:
        """The numbers of now, apart from what goes on learning."""
        return _as_arrays(self)


_TENSORS_OF = {
    HandAvatar: HandTensors,
    Learned: LearnedTensors,
    Light: LightTensors,
    Ellipsoid: Ellipsoid,
    CastShadow: CastTensors,
    Anchors: AnchorTensors,
    SkinResponse: ResponseTensors,
}
_ARRAYS_OF = {tensors: arrays for arrays, tensors in _TENSORS_OF.items()}


def _as_tensors(value: Any) -> Any:
    """A record of arrays as that of tensors, copied, for an array may be read-only; all else as it is."""
    if isinstance(value, np.ndarray):
        return torch.tensor(value)
    kind: Any = _TENSORS_OF.get(type(value))
    return value if kind is None else kind(**{f.name: _as_tensors(getattr(value, f.name)) for f in fields(kind)})


def _as_arrays(value: Any) -> Any:
    """The reverse."""
    if isinstance(value, Tensor):
        return value.detach().cpu().numpy().copy()
    if isinstance(value, PoseNet):
        return value.plain()
    kind: Any = _ARRAYS_OF.get(type(value))
    names = [] if kind is None else [f.name for f in fields(type(value))]
    return value if kind is None else kind(**{name: _as_arrays(getattr(value, name)) for name in names})


def mapped(record: Record, change: Callable[[Tensor], Tensor]) -> Record:
    """A frozen dataclass with `change` applied to its tensors, in nested records too; all else stays as it is."""
    values: dict[str, Any] = {}
    for f in fields(record):  # type: ignore[arg-type]
        value = getattr(record, f.name)
        if isinstance(value, Tensor):
            values[f.name] = change(value)
        elif is_dataclass(value) and not isinstance(value, type):
            values[f.name] = mapped(value, change)
    return replace(record, **values)  # type: ignore[type-var]
