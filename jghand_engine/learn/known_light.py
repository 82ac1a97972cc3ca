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

from jghand_engine.avatar.cast_task import posed_joints_m
from jghand_engine.avatar.lamp_rows import irradiance_at
from jghand_engine.avatar.scene_light import LOBE_ROWS, SceneLight, World
from jghand_engine.captures.known_light import KnownLight
from jghand_engine.captures.sample import Sample
from jghand_engine.errors import InputError
from jghand_engine.learn.cast_shadow import CastTensors
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.light import unit
from jghand_engine.learn.model import LightPart
from jghand_engine.learn.pictures import LruCache, MixedLight
from jghand_engine.learn.scene_light import (
    Flesh,
    LampRows,
    Patches,
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
from jghand_engine.native.scene_light_task import NUMBER, LampKind

# shadows kept in memory, bytes: 1.5 MB for a world and three lamps on 40,000 Gaussians
SHADOW_CACHE_BYTES = 2_000_000_000
LAMPS_IN_WORLD = (LightPart.LAMPS, LightPart.SHADOWS_AND_LAMPS)
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
    """Lights one hand. cast: of all its Gaussians · joints_m: (21, 3) canonical · left_out: of the light"""

    def __init__(self, cast: CastTensors, joints_m: Tensor, left_out: LightPart | None = None) -> None:
        if left_out in (LightPart.SHADOWS, LightPart.SHADOWS_AND_LAMPS):
            # all flesh is a point's own, which hides nothing from it
            cast = replace(cast, own=torch.ones_like(cast.own))
        self._cast, self._canonical_m, self._left_out = cast, (joints_m - joints_m[:1]).numpy(), left_out
        self._patches = Patches.of(cast.anchors)
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
        apart = self._left_out not in LAMPS_IN_WORLD
        if not apart:
            mixed = self._with_lamps_in_world(mixed, pose)
        light = mixed.light.weighted(mixed.weight)

        def there(tensor: Tensor) -> Tensor:
            return tensor.to(skin.matt.position_m)

        def all_lit() -> _Lit:
            return mapped(self._all_lit(mapped(pose, Tensor.cpu), mixed.light, light), there)

        # a world that has lamps in it is another one in every mix
        lit = self._lit.get((mixed.image, light.world is None), all_lit) if apart else all_lit()
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

    def _with_lamps_in_world(self, mixed: MixedLight, pose: Pose) -> MixedLight:
        bones = mapped(pose.bones, Tensor.cpu)
        middle_m = posed_joints_m(_linear_offset(bones), self._canonical_m).mean(0) + bones.root_m.double().numpy()
        light = lamps_in_world(mixed.light.weighted(mixed.weight), middle_m)
        return replace(mixed, light=KnownLight(light.world, (), ()), weight=np.ones((1, 3)))

    @torch.no_grad()
    def _all_lit(self, pose: Pose, known: KnownLight, light: SceneLight) -> _Lit:
        bones, maps = pose.bones, pose.maps
        anchors, ends_m = posed_anchors(self._cast, bones)
        flesh = Flesh.of(self._cast, ends_m, bones.scale)
        root_m, linear_offset = bones.root_m.double().numpy(), _linear_offset(bones)
        rows, casting, lamp = [], [], []
        for number, one in enumerate((*known.lamps, *known.suns)):
            alone = LampRows.of(SceneLight(None, (one,)), root_m, linear_offset, self._canonical_m)
            alone.rows[:, NUMBER["slot"]] = len(casting) if len(alone.casting) else -1
            rows += [*alone.rows]
            casting += [*alone.casting]
            lamp += [number] * len(alone.rows)
        every = LampRows(np.ones(1), *(np.array(each).reshape(-1, len(NUMBER)) for each in (rows, casting)))
        at = apply(maps.linear, pose.position_m - bones.canonical_root_m.to(pose.position_m)) + maps.offset_m
        skin, around = Skin(at, unit(apply(maps.turning, pose.normal))), Skin(*anchors)
        fallen = shadows(self._cast, self._patches, around, skin, flesh, light, every)
        return _Lit(around, fallen, every.rows, np.array(lamp, int))


def _linear_offset(bones: BoneTransforms) -> np.ndarray:
    """(maps, 3, 4) of bones on the CPU, as the renderer has them."""
    return torch.cat([bones.linear, bones.offset_m[..., None]], -1).numpy()


def lamps_in_world(light: SceneLight, middle_m: np.ndarray) -> SceneLight:
    """The same light without lamps: what they send to the middle of a hand (3,) comes from pixels of the world."""
    world = light.world or World(np.zeros((2 * LOBE_ROWS, 4 * LOBE_ROWS, 3), np.float32))
    radiance = world.radiance.astype(np.float64)
    direction, solid_angle = World(np.ones_like(radiance), world.env_from_world).samples
    for lamp in light.lamps:
        irradiance = irradiance_at(lamp.numbers[None], middle_m[None])[0, 0]
        towards = np.array(lamp.place_m) - (0 if lamp.kind is LampKind.SUN else middle_m)
        pixel = np.unravel_index((direction @ towards).argmax(), radiance.shape[:2])
        radiance[pixel] += irradiance / solid_angle[pixel]
    return SceneLight(World(radiance, world.env_from_world))


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
