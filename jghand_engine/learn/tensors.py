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
from jghand_engine.avatar.learned import Anchors, CastShadow, Ellipsoid, Learned, Light, ShadowLook
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.cast_shadow import AnchorTensors, CastTensors
from jghand_engine.learn.light import LightTensors
from jghand_engine.learn.pose_net import LinearNet, PoseNet

Record = TypeVar("Record")


@dataclass(frozen=True)
class EllipsoidTensors:
    """See learned.Ellipsoid."""

    log_stretch: Tensor
    quaternion: Tensor


@dataclass(frozen=True)
class LearnedTensors:
    """See learned.Learned; without cheaper tiers of the correctives."""

    normal: Tensor
    shine: Tensor
    light: LightTensors
    correctives: PoseNet | LinearNet | None
    shadow: ShadowLook | None
    world_offsets: bool = False
    ellipsoid: EllipsoidTensors | None = None
    cast: CastTensors | None = None


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
        arrays = {f.name: getattr(avatar, f.name) for f in fields(cls) if f.name != "learned"}
        values: dict[str, Any] = {
            name: _tensor(value) if isinstance(value, np.ndarray) else value for name, value in arrays.items()
        }
        hand = cls(**values)
        return hand if avatar.learned is None else replace(hand, learned=_learned_tensors(avatar.learned, hand))

    def avatar(self) -> HandAvatar:
        """The numbers of now, apart from what goes on learning."""
        values = {f.name: _plain(getattr(self, f.name)) for f in fields(self) if f.name != "learned"}
        return HandAvatar(**values, learned=None if self.learned is None else _learned(self.learned))


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


def _tensor(array: np.ndarray) -> Tensor:
    """A copy: an array may be read-only."""
    return torch.tensor(array)


def _plain(value: Any) -> Any:
    """A tensor as an array of its own; all else as it is."""
    return value.detach().cpu().numpy().copy() if isinstance(value, Tensor) else value


def _converted(kind: type[Record], record: Any, change: Callable[[Any], Any]) -> Record:
    return kind(**{f.name: change(getattr(record, f.name)) for f in fields(kind)})  # type: ignore[arg-type]


def _learned_tensors(learned: Learned, hand: HandTensors) -> LearnedTensors:
    correctives, ellipsoid, cast = learned.correctives, learned.ellipsoid, learned.cast
    net = None if correctives is None else _net(correctives, hand)
    cast_tensors = None
    if cast is not None:
        anchors = _converted(AnchorTensors, cast.anchors, _tensor)
        cast_tensors = CastTensors(_tensor(cast.lamp_rgb), _tensor(cast.bounced_rgb), anchors, _tensor(cast.own))
    return LearnedTensors(
        normal=_tensor(learned.normal),
        shine=_tensor(learned.shine),
        light=_converted(LightTensors, learned.light, _tensor),
        correctives=net,
        shadow=learned.shadow,
        world_offsets=learned.world_offsets,
        ellipsoid=None if ellipsoid is None else _converted(EllipsoidTensors, ellipsoid, _tensor),
        cast=cast_tensors,
    )


def _net(correctives: Any, hand: HandTensors) -> PoseNet | LinearNet:
    kind = LinearNet if hasattr(correctives, "direction") else PoseNet
    return kind.of(correctives, hand.bone_weights, hand.uvd)


def _learned(learned: LearnedTensors) -> Learned:
    net, ellipsoid, cast = learned.correctives, learned.ellipsoid, learned.cast
    shadows = None
    if cast is not None:
        anchors = _converted(Anchors, cast.anchors, _plain)
        shadows = CastShadow(_plain(cast.lamp_rgb), _plain(cast.bounced_rgb), anchors, _plain(cast.own))
    return Learned(
        normal=_plain(learned.normal),
        shine=_plain(learned.shine),
        light=_converted(Light, learned.light, _plain),
        correctives=None if net is None else net.plain(),
        shadow=learned.shadow,
        world_offsets=learned.world_offsets,
        ellipsoid=None if ellipsoid is None else _converted(Ellipsoid, ellipsoid, _plain),
        cast=shadows,
    )
