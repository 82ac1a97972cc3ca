"""The light of a scene, as the kernel takes it (native/scene_light.cpp). The specification is learn/scene_light.py."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from jghand_engine.avatar.blocks import Blocks, padded_rows, set_pointers
from jghand_engine.avatar.cast_task import CAPSULE_SINE2_MIN, EVENED, PATCH, CastStep, anchors_beside
from jghand_engine.avatar.lamp_rows import LAMPS_MAX, Limits, lamp_rows, shares_on, world_shade
from jghand_engine.avatar.learned import SkinResponse, lamp_directions
from jghand_engine.avatar.scene_light import (
    CELLS,
    LOBES,
    WORLD_FLOOR,
    SceneLight,
    World,
    mirrored_lobes,
)
from jghand_engine.hand.joints import BONE_COUNT
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native.binding import address, aligned_zeros
from jghand_engine.native.learned_tasks import LearnedTask
from jghand_engine.native.scene_light_task import (
    APART,
    GRID,
    LAMP_NUMBERS,
    NUMBER,
    SWEEPS,
    SWEPT,
    THROWN,
    LampDepth,
    SceneLightTask,
)
from jghand_engine.native.tasks import LANES

# edge of a lamp's shadow on skin, as a part of the capsule's radius
FLESH_SOFTNESS = 0.12
# and where anchors, 4 mm apart, look for an edge that runs between them
WIDE_SOFTNESS = 0.6
# concentration of a spherical Gaussian that is as wide as GGX mirrors, over 1 / roughness^4: half the angle in the
# half vector is a quarter of it in the mirrored direction
MIRROR_SHARPNESS = 0.5
# of the picture through which thrown light is swept, over how far anchors are apart: finer ones leave gaps between them
TEXELS = 0.6
# what a bone may lack of standing before skin wholly: rounding
WHOLLY = 1e-6
# without a world its cells are black
BLACK = World(np.zeros((2, 4, 3)))
# capsules say what stands before all lamps
NO_DEPTHS: Mapping[int, LampDepth] = {}
# of a lamp without a picture: it has no part, and no layer
NO_DEPTH = LampDepth(layer=-1)


@dataclass(frozen=True)
class Apart:
    """Light of lamps on a hand that is drawn by itself, a layer each, to be shadowed at each pixel.

    at_pixels: (layers,) float32, how much of it, 0..1; Gaussians keep the rest, shadowed as at them
    rows:      (layers, rows, 4) float32, what of it Gaussians have: rgb, and the sum of these as far as it reaches
               them; is written
    """

    at_pixels: np.ndarray
    rows: np.ndarray


class SceneLightStep:
    """Fills in a task what the light of a scene does to its poses. It must live as long as the task.

    response: of the skin, in the avatar's own order · blocks: of its Gaussians · cast: whose anchors it uses ·
    limits: below which light is left out · sweeps: whether light that skin throws stops at what stands before it ·
    task, arrays: of the scene, and what its fields point to, by name
    """

    def __init__(
        self,
        response: SkinResponse,
        blocks: Blocks,
        cast: CastStep,
        task: LearnedTask,
        limits: Limits,
        *,
        sweeps: bool = False,
    ) -> None:
        self._response, self._blocks, self._cast, self._limits = response, blocks, cast, limits
        material = np.stack([response.spread, response.roughness, response.reflectance], 1)
        rows = cast.rows
        beside = anchors_beside(cast.anchors.position_m, cast.anchors.normal)
        self.arrays = {
            "material": blocks.blocked(material),
            "posed": aligned_zeros((rows // LANES, 9, LANES)),
            "visible": aligned_zeros((rows, CELLS)),
            "reflecting": aligned_zeros((blocks.rows // LANES, 3, LANES)),
            **_standing_before(cast),
            "skin_seen": aligned_zeros((LAMPS_MAX, blocks.rows)),
            "apart": aligned_zeros((0, blocks.count, APART, LANES)),
            "thrown": aligned_zeros((rows // PATCH, THROWN)),
            "beside": _evened(cast, beside),
            "bounced": aligned_zeros((rows, 4)),
            "sky": aligned_zeros((blocks.rows,)),
            # 7 numbers of the world and 3 of each lamp, in whole vectors
            "reached": aligned_zeros((rows, padded_rows(7 + 3 * LAMPS_MAX))),
            "irradiance": aligned_zeros((16, 3)),
            "left": aligned_zeros((LAMPS_MAX, rows)),
            "lobe": aligned_zeros((LOBES, 7)),
            "lamp": aligned_zeros((4 * LAMPS_MAX, len(LAMP_NUMBERS))),
            "casting": aligned_zeros((LAMPS_MAX, len(LAMP_NUMBERS))),
        }
        self.task = SceneLightTask(
            shade_gain=response.shade_gain,
            flesh_softness=FLESH_SOFTNESS,
            wide_softness=WIDE_SOFTNESS,
            sine2_min=CAPSULE_SINE2_MIN,
        )
        if sweeps:
            self.arrays |= _swept(cast, beside)
            area_m2 = self.arrays["area"]
            self.task.texel_m = TEXELS * float(np.sqrt(area_m2[area_m2 > 0].mean()))
        set_pointers(self.task, self.arrays)
        task.scene = ctypes.addressof(self.task)
        self._apart: Apart | None = None
        self._world: World | None = None
        self._set_world(None)

    def prepare(
        self,
        light: SceneLight,
        bones: Bones,
        depths: Mapping[int, LampDepth] = NO_DEPTHS,
        *,
        keep_pose: bool = False,
    ) -> None:
        """Sets the light of the next pose, or of the one that stands; the hand's capsules are the cast shadow's, whose
        `prepare` comes after this: shadows of the world are found for its own directions. depths: what stands before
        lamps, by their numbers; capsules say it of the others"""
        self.task.keeps_pose = keep_pose
        # without its shadow nothing was found of the world
        self.task.keeps_visible = keep_pose and light.world is self._world and self.task.shade > 0
        if light.world is not self._world:
            self._set_world(light.world)
        shares, points_m = shares_on(light, bones, self._cast.joints_m)
        rows, casting, sources = lamp_rows(light, shares, bones.root_m, points_m, self._limits)
        rows[:, NUMBER["on_gloss"]] *= self._response.mirrors
        self.arrays["lamp"][: len(rows)], self.arrays["casting"][: len(casting)] = rows, casting
        self.task.lamps, self.task.slots = len(rows), len(casting)
        self.task.shade, _ = world_shade(shares, self._response.bounce, self._limits)
        self._set_depths(depths, sources)
        self._set_left(None if light.shades is None else light.shades.left[0], sources)
        self._set_baked(None if light.baked is None else light.baked.field[0])

    def _set_depths(self, depths: Mapping[int, LampDepth], sources: list[int]) -> None:
        """Sets what stands before lamps; sources: the lamps by slot."""
        self.task.depth = None
        if not depths:
            return
        # the task points to it
        self._depths = (LampDepth * len(sources))(*(depths.get(number, NO_DEPTH) for number in sources))
        self.task.depth = ctypes.addressof(self._depths)
        layers = 1 + max((depth.layer for depth in self._depths), default=-1)
        if layers > len(self.arrays["apart"]):
            self.arrays["apart"] = aligned_zeros((layers, self._blocks.count, APART, LANES))
            set_pointers(self.task, {"apart": self.arrays["apart"]})

    def draw_apart(self, apart: Apart | None) -> None:
        """Sets which light is drawn by itself of what was prepared; None: none."""
        task, self._apart = self.task, apart
        task.layers = 0 if apart is None else len(apart.at_pixels)
        if apart is None:
            return
        task.at_pixels = address(apart.at_pixels, np.float32, "at_pixels", (task.layers,))
        task.layer, task.layer_stride = apart.rows.ctypes.data, apart.rows.strides[0] // apart.rows.itemsize

    def _set_baked(self, field: np.ndarray | None) -> None:
        """Sets what lights matt skin in place of the lamps, (N, 4, 3) as `Baked` has it, and of the world."""
        if field is None:
            self.task.baked = None
            return
        self.arrays["lamp"][:, NUMBER["on_matt"]] = 0
        self.arrays["baked"] = self._blocks.blocked(field[: len(self._blocks.order)].reshape(-1, 12))
        self.task.baked = self.arrays["baked"].ctypes.data

    def _set_left(self, of_lamp: np.ndarray | None, sources: list[int]) -> None:
        """Sets what a scene leaves of the lamps (lamps, anchors), as `Shades` has it; sources: the lamps by slot."""
        left = self.arrays["left"]
        self.task.left = None if of_lamp is None else left.ctypes.data
        if of_lamp is not None:
            left[...] = 1
            for slot, index in enumerate(sources):
                if index < len(of_lamp):
                    left[slot, self._cast.row_of_anchor] = of_lamp[index]

    def _set_world(self, world: World | None) -> None:
        task, response = self.task, self._response
        self._world = world
        terms = (BLACK if world is None else world).terms
        mean = terms.mean_irradiance
        self.arrays["irradiance"][...] = terms.irradiance(response.softness)
        self._cast.set_lamps(terms.direction, terms.light)
        task.lobes = 0 if world is None or not response.mirrors else LOBES
        if world is not None and task.lobes:
            self.arrays["lobe"][...] = mirrored(world, response.roughness)
            self.arrays["lobe"][:, 3] /= np.log(2)
        task.least = tuple((WORLD_FLOOR * mean).tolist())
        task.bounce = tuple(response.bounce.tolist())
        task.softness = tuple(response.softness.tolist())


def _standing_before(cast: CastStep) -> dict[str, np.ndarray]:
    """How much each bone counts for the Gaussians, the mean of the anchors around them: own, partly, hides_start and
    hides of SceneLightTask."""
    of_anchor = cast.arrays["foreign"].transpose(0, 2, 1).reshape(cast.rows, BONE_COUNT)
    nearest, share = cast.around["nearest"], cast.around["share"]
    # (blocks, 16, BONE_COUNT)
    mean = np.sum([share[:, k, :, None] * of_anchor[nearest[:, k]] for k in range(nearest.shape[1])], 0)
    own = (mean == 0).all(1)
    partly = (mean < 1 - WHOLLY).any(1) & ~own
    count = partly.sum(1)
    hides = aligned_zeros((1 + int(count.sum()), LANES))
    hides[0], hides[1:] = 1, mean.transpose(0, 2, 1)[partly]
    bits = 1 << np.arange(BONE_COUNT)
    return {
        "own": (own @ bits).astype(np.uint32),
        "partly": (partly @ bits).astype(np.uint32),
        "hides_start": (1 + np.cumsum(count) - count).astype(np.int32),
        "hides": hides,
    }


def _evened(cast: CastStep, beside: np.ndarray) -> np.ndarray:
    """Over which anchors light that skin throws is evened: beside of SceneLightTask."""
    rows = aligned_zeros((cast.rows, EVENED), np.int32)
    rows[cast.row_of_anchor] = cast.row_of_anchor[beside]
    return rows


def _swept(cast: CastStep, beside: np.ndarray) -> dict[str, np.ndarray]:
    """Through what light is swept that skin throws: the arrays of native/bounce.cpp. beside: (A, EVENED) anchors"""
    place_m, area_m2 = cast.anchors.position_m, aligned_zeros((cast.rows,))
    apart2_m2 = np.square(place_m[beside] - place_m[:, None]).sum(-1).max(1)
    area_m2[cast.row_of_anchor] = np.pi * apart2_m2 / (EVENED - 1)
    direction = aligned_zeros((SWEPT, 3))
    direction[...] = lamp_directions(SWEPT)
    three = cast.rows // LANES, 3, LANES
    return {
        "area": area_m2,
        "swept": direction,
        "once": aligned_zeros(three),
        "sent": aligned_zeros(three),
        "caught": aligned_zeros((SWEEPS, cast.rows, 4)),
        "sweeping": aligned_zeros((SWEEPS, 4 * GRID**2 + 6 * cast.rows)),
    }


def mirrored(world: World, roughness: np.ndarray) -> np.ndarray:
    """(LOBES, 7) what skin of a mean roughness mirrors of the world, see `mirrored_lobes`."""
    return _lobes(world, MIRROR_SHARPNESS / float(np.mean(roughness)) ** 4)


@lru_cache(maxsize=4)
def _lobes(world: World, sharpness: float) -> np.ndarray:
    return mirrored_lobes(world, sharpness)
