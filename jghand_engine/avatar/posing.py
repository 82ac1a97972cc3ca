"""The one recipe of a posed hand: bone transforms -> correctives -> skin -> light. `Poser` does it in the rows of an
image, `Posing` for files.

All of it is done by the native kernels, in tenths of a millisecond; the differentiable form that training goes through
is `learn/skinning.py`, and tests hold the two together. Only what the skin reflects depends on the camera: it is found
apart, for images, and left out of files.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import Blocks, set_pointers
from jghand_engine.avatar.cast_task import Capsules, CastStep
from jghand_engine.avatar.corrective_task import corrective_step
from jghand_engine.avatar.forearm import hidden_from
from jghand_engine.avatar.lamp_rows import LIMITS, Limits
from jghand_engine.avatar.learned import ANCHOR_NEIGHBORS, Learned, anchors_around
from jghand_engine.avatar.relighting import in_studio, relightable
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.avatar.scene_light_step import NO_DEPTHS, Apart, SceneLightStep
from jghand_engine.avatar.skin_task import learned_arrays, learned_task, skin_arrays, skin_task
from jghand_engine.color import linear_to_srgb
from jghand_engine.errors import InputError, RetryError
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native import library as native_library
from jghand_engine.native.binding import Library, address, aligned_zeros, new_team
from jghand_engine.native.learned_tasks import CorrectiveKind, LearnedTask
from jghand_engine.native.rasterizer import GaussianArrays
from jghand_engine.native.scene_light_task import LampDepth
from jghand_engine.native.tasks import LANES, SkinTask
from jghand_engine.native.threads import shared_pool


@dataclass(frozen=True)
class PosedHand:
    """The Gaussians of one pose, in the avatar's own order, float32; they belong to the caller.

    position_m:    (N, 3) meters, in the frame of the joints
    sigma_m:       (N,) standard deviation, meters
    rgb:           (N, 3) display-referred sRGB 0..1 without what is reflected; None where no pose changes the colors
    covariance_m2: (N, 6) xx, xy, xz, yy, yz, zz square meters of ellipsoids; None for spheres
    """

    position_m: np.ndarray
    sigma_m: np.ndarray
    rgb: np.ndarray | None
    covariance_m2: np.ndarray | None = None


class Posing:
    """Poses one avatar again and again for nobody's eye. Its own correctives are used, never a cheaper tier of them.

    threads: 0 takes as many as is sensible
    light:   of a scene, in the frame of the joints, through sRGB's curve; None: what the avatar carries, or a studio's.
             A painted hand shines with its own colors in any
    InputError for an avatar that no scene can light.
    """

    def __init__(
        self, avatar: HandAvatar, threads: int = 0, library: Library | None = None, light: SceneLight | None = None
    ) -> None:
        self._scene = light if avatar.learned is not None else None
        avatar = in_studio(avatar) if self._scene is None else relightable(avatar)
        learned, self._skeleton = avatar.learned, avatar.skeleton()
        self._relit = learned is not None
        if learned is not None:
            # without shine the kernel's colors are those that are the same from everywhere
            avatar = replace(avatar, learned=replace(learned, shine=np.zeros_like(learned.shine)))
        self._poser = Poser(library or native_library.load(), avatar)
        # the row in which each Gaussian stands
        self._row = np.argsort(self._poser.blocks.order)
        self._pool = shared_pool(threads)

    def __call__(self, joints_m: np.ndarray, forearm: np.ndarray | None = None) -> PosedHand:
        """The Gaussians of joints (21, 3), level order, meters, all of them finite, and of a turned forearm, as
        `HandPose` has it."""
        bones, poser = self._skeleton.bones(joints_m, forearm=forearm), self._poser
        poser.prepare(bones, np.zeros(3), light=self._scene)
        self._pool.run(lambda _thread: poser.run())
        into, row = poser.into, self._row
        rgb = into.rgb if self._scene is None else linear_to_srgb(poser.matt_rgb)
        # centers are added to the wrist in double precision
        return PosedHand(
            (into.position_m[row].astype(np.float64) + bones.root_m).astype(np.float32),
            into.sigma_m[row],
            np.clip(rgb[row], 0, 1) if self._relit else None,
            None if into.covariance_m2 is None else into.covariance_m2[row],
        )


def new_rows(rows: int, *, ellipsoids: bool, fades: bool) -> GaussianArrays:
    """Arrays for Gaussians that are posed. fades: whether what faces away fades out, of any of them"""
    covariance_m2 = aligned_zeros((rows, 6)) if ellipsoids else None
    return GaussianArrays(
        aligned_zeros((rows, 3)),
        aligned_zeros((rows,)),
        aligned_zeros((rows,)),
        aligned_zeros((rows, 3)),
        covariance_m2,
        np.ones(rows, np.float32) if fades else None,
    )


class Poser:
    """Poses one avatar, painted or trained, into rows of an image's arrays, without gradients.

    blocks: which Gaussian stands in which row; rows beyond the avatar have sigma 0 and opacity 0
    into:   the rows, `blocks.rows` of them; with covariances where any hand of the image has ellipsoids
    limits: below which parts of the light of a scene are left out
    sweeps: whether light that skin throws stops at what stands before it
    teams:  counters to be set to zero before what was prepared is run again
    """

    def __init__(
        self,
        library: Library,
        avatar: HandAvatar,
        into: GaussianArrays | None = None,
        limits: Limits = LIMITS,
        *,
        sweeps: bool = False,
    ) -> None:
        self._call, self._maps, learned = library.call, avatar.map_count, avatar.learned
        self.blocks = blocks = Blocks.of(avatar.position_m)
        ellipsoids = learned is not None and learned.ellipsoid is not None
        fades = learned is not None and learned.fades
        self.into = new_rows(blocks.rows, ellipsoids=ellipsoids, fades=fades) if into is None else into
        self.into.opacity[:], self.into.rgb[:] = blocks.in_rows(avatar.opacity), blocks.in_rows(avatar.rgb)
        self._team, self._gloss_team = new_team(), new_team()
        self.teams = [self._team, self._gloss_team]
        self._arrays = skin_arrays(avatar, blocks)
        self._skin = task = skin_task(blocks)
        set_pointers(task, self._arrays)
        rows, covariance = blocks.rows, self.into.covariance_m2
        task.position = address(self.into.position_m, np.float32, "position_m", (rows, 3), writable=True)
        task.sigma = address(self.into.sigma_m, np.float32, "sigma_m", (rows,), writable=True)
        if covariance is not None:
            task.covariance = address(covariance, np.float32, "covariance_m2", (rows, 6), writable=True)
        _check_size(library, library.call.jg_skin_task_bytes(), SkinTask)
        self._light = None if learned is None else _Light(library, avatar, learned, blocks, limits, sweeps=sweeps)
        # what the task points to, and the pose that stands
        self._stands: tuple[np.ndarray, Bones, Capsules | None] | None = None
        self._cap = avatar.cap
        # from where, and with which light apart
        self._seen: tuple[float, ...] | None = None

    def prepare(
        self,
        bones: Bones,
        shift_m: np.ndarray,
        *,
        keep_correctives: bool = False,
        others: Capsules | None = None,
        light: SceneLight | None = None,
        depths: Mapping[int, LampDepth] = NO_DEPTHS,
    ) -> None:
        """Sets the next pose. Positions come out relative to the hand's root, plus `shift_m` (3,).
        keep_correctives: whether those of the last pose that was run are used again. others: the flesh of hands beside
        this one, which cast their shadow on it. light: of the scene, in the frame of the joints, for an avatar with a
        response; depths: what stands before its lamps, by their numbers, capsules say it of the others.

        InputError names an array that the kernel cannot read or write.
        """
        linear_offset = np.ascontiguousarray(bones.linear_offset, np.float32)
        task = self._skin
        task.linear_offset = address(linear_offset, np.float32, "linear_offset", (self._maps, 3, 4))
        task.shift = tuple(shift_m)
        # finite for a hand without size
        inverse_scale = 1.0 / max(bones.scale, float(np.finfo(np.float32).tiny))
        task.scale, task.inverse_scale = bones.scale, inverse_scale
        if self._light is not None:
            self._light.task.skin = task
            self._light.prepare_scene(light, bones, depths)
            self._light.prepare(bones, self.into, others, keep_correctives=keep_correctives)
        self._stands, self._seen = (linear_offset, bones, others), None
        self._team.fill(0)

    def hide(self) -> None:
        """Nothing of the avatar is drawn before its next pose."""
        self.into.position_m.fill(np.nan)
        self._stands = None

    def prepare_light(self, light: SceneLight, depths: Mapping[int, LampDepth] = NO_DEPTHS) -> bool:
        """Sets another light of the scene for the pose that stands: `run` lights it anew, and nothing else. Whether
        there is anything to be run: not for an avatar without a response."""
        if self._light is None or not self._light.is_lit or self._stands is None:
            return False
        _, bones, others = self._stands
        self._light.prepare_scene(light, bones, depths, keep_pose=True)
        self._light.prepare_shadows(bones, others)
        self._seen = None
        self._team.fill(0)
        return True

    def run(self) -> None:
        """Poses the avatar; every thread of a team calls it."""
        if self._light is None:
            self._call.jg_skin(self._team.ctypes.data, ctypes.addressof(self._skin))
        else:
            self._call.jg_learned_pose(self._team.ctypes.data, ctypes.addressof(self._light.task))

    @property
    def matt_rgb(self) -> np.ndarray:
        """(rows, 3) linear colors that are the same from everywhere, of what was run in the light of a scene."""
        if self._light is None or not self._light.is_lit:
            raise InputError("colors without gloss", wanted="an avatar with a response", came="one without")
        return self._light.matt_rgb

    def light_around(self, position_m: np.ndarray) -> LightAround | None:
        """Around canonical places (V, 3), meters; None for an avatar that was not learned."""
        return None if self._light is None else self._light.around(position_m, self.blocks)

    def prepare_gloss(self, eye_m: np.ndarray, apart: Apart | None = None) -> bool:
        """Sets where the camera stands (3,), in the frame of the positions, and which light is drawn by itself. Whether
        there is anything to be run: not without a pose, or when nothing is reflected or the pose was seen so last."""
        light, parts = self._light, () if apart is None else tuple(apart.at_pixels.tolist())
        if self._stands is None or light is None or not light.reflects or self._seen == (*eye_m, *parts):
            return False
        self._seen = (*eye_m, *parts)
        light.task.eye = tuple(eye_m)
        if self._cap is not None:
            light.task.from_behind = self._cap.seen(self._stands[0], np.array(self._skin.shift), eye_m)
        light.draw_apart(apart)
        self._gloss_team.fill(0)
        return True

    def run_gloss(self) -> None:
        """Colors as that camera sees them; every thread of a team calls it, after `run`."""
        if self._light is not None:
            self._call.jg_learned_gloss(self._gloss_team.ctypes.data, ctypes.addressof(self._light.task))


@dataclass(frozen=True)
class LightAround:
    """The light that falls on places of a hand, which is known at the anchors of its cast shadow.

    poses:   what finds it, and what the kernel reads of that
    nearest: (V, 3) rows of the anchors around each
    beside:  (V, 3) rows of the Gaussians at these
    share:   (V, 3) float32 of each, sums to 1, or 0 of a hand without anchors, whose light needs none
    """

    poses: _Light
    nearest: np.ndarray
    beside: np.ndarray
    share: np.ndarray

    @property
    def task(self) -> LearnedTask:
        return self.poses.task


class _Light:
    """What a trained avatar adds to skinning: correctives, light, the shadows that fingers cast, gloss."""

    def __init__(
        self,
        library: Library,
        avatar: HandAvatar,
        learned: Learned,
        blocks: Blocks,
        limits: Limits,
        *,
        sweeps: bool,
    ) -> None:
        _check_size(library, library.call.jg_learned_task_bytes(), LearnedTask)
        self.task, self.reflects, self._rows = learned_task(learned, avatar.handedness), learned.reflects, blocks.rows
        self._fades = learned.fades
        self._arrays = learned_arrays(avatar, learned, blocks)
        if self._fades:
            self._arrays["hidden_from"] = blocks.in_rows(hidden_from(avatar.position_m, avatar.opacity, avatar.cap))
        set_pointers(self.task, self._arrays)
        self.task.lobes = len(self._arrays["lobe"])
        self._correctives = corrective_step(learned.correctives, avatar, blocks, self.task)
        self._cast = None if learned.cast is None else CastStep(learned.cast, avatar, blocks, self.task)
        self._anchors = None if learned.cast is None else learned.cast.anchors
        self._scene = None
        if learned.response is not None and self._cast is not None:
            self._scene = SceneLightStep(learned.response, blocks, self._cast, self.task, limits, sweeps=sweeps)
        self.is_lit = self._scene is not None

    @property
    def matt_rgb(self) -> np.ndarray:
        return self._arrays["matt"][:, 3:].reshape(-1, 3, LANES).swapaxes(1, 2).reshape(-1, 3)

    def around(self, position_m: np.ndarray, blocks: Blocks) -> LightAround:
        if self._cast is None or self._anchors is None:
            nowhere = np.zeros((len(position_m), ANCHOR_NEIGHBORS), np.int64)
            return LightAround(self, nowhere, nowhere, nowhere.astype(np.float32))
        nearest, share = anchors_around(self._anchors, position_m)
        # anchors stand at the first Gaussians; what is drawn may be a prefix of them
        beside = np.argsort(blocks.order)[np.minimum(nearest, len(blocks.order) - 1)]
        return LightAround(self, self._cast.row_of_anchor[nearest], beside, share)

    def prepare_scene(
        self,
        light: SceneLight | None,
        bones: Bones,
        depths: Mapping[int, LampDepth],
        *,
        keep_pose: bool = False,
    ) -> None:
        if self._scene is not None:
            self._scene.prepare(light or SceneLight(), bones, depths, keep_pose=keep_pose)

    def draw_apart(self, apart: Apart | None) -> None:
        if self._scene is not None:
            self._scene.draw_apart(apart)

    def prepare(self, bones: Bones, into: GaussianArrays, others: Capsules | None, *, keep_correctives: bool) -> None:
        task, front = self.task, into.front if self._fades else None
        task.rgb = address(into.rgb, np.float32, "rgb", (self._rows, 3), writable=True)
        task.front = None if front is None else address(front, np.float32, "front", (self._rows,), writable=True)
        if not keep_correctives:
            self._correctives.prepare(task, bones.angles_rad)
        elif task.given is not None:
            task.correctives = CorrectiveKind.GIVEN
        self.prepare_shadows(bones, others)

    def prepare_shadows(self, bones: Bones, others: Capsules | None) -> None:
        if self._cast is not None:
            self._cast.prepare(bones, others)


def _check_size(library: Library, size: int, mirror: type[ctypes.Structure]) -> None:
    """RetryError when the library's structure is not of the size of its mirror."""
    if size != ctypes.sizeof(mirror):
        wanted = f"a {mirror.__name__} of {ctypes.sizeof(mirror)} bytes"
        raise RetryError(f"native library {library.path.name}", wanted=wanted, came=str(size))
