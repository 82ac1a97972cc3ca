"""Learning in light that is known: what it makes of a posed hand, and what of its shadows need be found only once.

Which flesh stands before which lamp, or before which part of the world, follows from the pose and the light alone; it
is found for the template's Gaussians, without gradients, and kept for as long as there is room.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.captures.known_light import KnownLight
from jghand_engine.captures.sample import Sample
from jghand_engine.errors import InputError
from jghand_engine.learn.cast_shadow import CastTensors
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.light import unit
from jghand_engine.learn.pictures import LruCache, MixedLight
from jghand_engine.learn.scene_light import (
    Flesh,
    LampRows,
    Shadows,
    Skin,
    by_column,
    matt,
    reached,
    shadows,
    towards_eye,
)
from jghand_engine.learn.skeleton import BoneTransforms
from jghand_engine.learn.skinning import PosedSkin, SkinMaps, apply, posed_anchors
from jghand_engine.learn.tensors import HandTensors, mapped
from jghand_engine.native.scene_light_task import NUMBER

# shadows kept in memory, bytes: 1.5 MB for a world and three lamps on 40,000 Gaussians
SHADOW_CACHE_BYTES = 2_000_000_000
# of a lamp's row
RED, BLUE = NUMBER["red"], NUMBER["blue"]


@dataclass(frozen=True)
class Pose:
    """bones, maps: of one pose · position_m, normal: (N, 3) of the template's Gaussians, canonical"""

    bones: BoneTransforms
    maps: SkinMaps
    position_m: Tensor
    normal: Tensor


@dataclass(frozen=True)
class _Lit:
    """What a pose and a picture's lights are to each other, all of them on.

    anchors: posed, root-relative · rows: (n, LAMP_NUMBERS) of all lamps · lamp: (n,) whose each is, by its number
    """

    anchors: Skin
    fallen: Shadows
    rows: np.ndarray
    lamp: np.ndarray


class LitHand:
    """Lights one hand. cast: of all its Gaussians · joints_m: (21, 3) canonical"""

    def __init__(self, cast: CastTensors, joints_m: Tensor) -> None:
        self._cast, self._joints_m = cast, joints_m
        self._lit: LruCache[_Lit] = LruCache(SHADOW_CACHE_BYTES, lambda lit: lit.fallen.nbytes())

    def gaussians(
        self, avatar: HandTensors, skin: PosedSkin, pose: Pose, mixed: MixedLight, eye_m: Tensor
    ) -> Gaussians:
        """What a camera at `eye_m` (3,) sees, scene-linear, with gradients. mixed: the lights"""
        learned = avatar.learned
        assert learned is not None
        assert learned.response is not None
        assert learned.cast is not None
        assert skin.normal is not None
        light = mixed.light.weighted(mixed.weight)

        def there(tensor: Tensor) -> Tensor:
            return tensor.to(skin.matt.position_m)

        key = mixed.image, light.world is None
        lit = self._lit.get(key, lambda: mapped(self._all_lit(mapped(pose, Tensor.cpu), mixed.light, light), there))
        rows = lit.rows.copy()
        # suns are the world's, in its group
        lamps, suns = len(mixed.light.lamps), len(mixed.light.suns)
        of_world = mixed.weight[:1] if mixed.light.world is not None else np.zeros((1, 3))
        weight = np.concatenate([mixed.weight[len(mixed.weight) - lamps :], np.repeat(of_world, suns, 0)])
        rows[:, RED : BLUE + 1] *= weight[lit.lamp]
        # what is weak in the mix has not faded: it is learned from, too
        on = LampRows(np.ones(1), rows[rows[:, RED : BLUE + 1].any(1)], rows[:0])
        root_m = pose.bones.root_m.to(skin.normal)
        # where the skin lies decides how lamps stand to it, but it is not pulled about by that
        posed = Skin(by_column(skin.matt.position_m.detach() - root_m), by_column(skin.normal))
        got = reached(learned.cast, lit.anchors, lit.fallen.prefix(len(avatar)), light, on, learned.response)
        shade = None if skin.shade is None else by_column(skin.shade)
        rgb = matt(by_column(skin.matt.rgb), posed, got, light, on, learned.response, shade)
        rgb = towards_eye(rgb, posed, eye_m.to(root_m) - root_m, got, light, on, learned.response)
        if rgb.requires_grad:
            rgb.register_hook(by_column)
        return replace(skin.matt, rgb=rgb)

    @torch.no_grad()
    def _all_lit(self, pose: Pose, known: KnownLight, light: SceneLight) -> _Lit:
        bones, maps = pose.bones, pose.maps
        anchors, joints_m = posed_anchors(self._cast, self._joints_m, bones)
        flesh = Flesh.of(self._cast, joints_m, bones.scale)
        linear_offset = torch.cat([bones.linear, bones.offset_m[..., None]], -1).numpy()
        root_m, canonical = bones.root_m.double().numpy(), (self._joints_m - self._joints_m[:1]).numpy()
        rows, casting, lamp = [], [], []
        for number, one in enumerate((*known.lamps, *known.suns)):
            alone = LampRows.of(SceneLight(None, (one,)), root_m, linear_offset, canonical)
            alone.rows[:, NUMBER["slot"]] = len(casting) if len(alone.casting) else -1
            rows += [*alone.rows]
            casting += [*alone.casting]
            lamp += [number] * len(alone.rows)
        every = LampRows(np.ones(1), *(np.array(each).reshape(-1, len(NUMBER)) for each in (rows, casting)))
        at = apply(maps.linear, pose.position_m - bones.canonical_root_m.to(pose.position_m)) + maps.offset_m
        skin, around = Skin(at, unit(apply(maps.turning, pose.normal))), Skin(*anchors)
        fallen = shadows(self._cast, around, skin, flesh, light, every)
        return _Lit(around, fallen, every.rows, np.array(lamp, int))


def trained_on(samples: Sequence[Sample]) -> dict[str, int]:
    """How many worlds, and lamps of each kind, pictures were lit by. InputError for one whose light is not known."""
    counts: dict[str, int] = {}
    worlds = set()
    for sample in samples:
        if sample.light is None:
            raise InputError(f"light of {sample.image}", wanted="one that is known, as of the others", came="none")
        if sample.light.world is not None:
            # turned differently in each picture
            worlds.add(sample.light.world.radiance.tobytes())
        for lamp in sample.light.lamps:
            name = lamp.kind.name.lower()
            counts[name] = counts.get(name, 0) + 1
    return {"worlds": len(worlds), **dict(sorted(counts.items()))}
