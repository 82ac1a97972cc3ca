"""Posing a trained avatar with the native library: the same as `skinning.posed_skin` and `seen_from`. First all that
the pose decides, then what is reflected towards the camera, which is all that a camera that moves alone asks for.
"""

from __future__ import annotations

import ctypes

import numpy as np

from jghand_engine import limits
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.fast_cast import FastCast
from jghand_engine.avatar.fast_correctives import fast_correctives
from jghand_engine.avatar.fast_skinning import Blocks, FastSkinning, PosedArrays, check_task, inverse_scale, point
from jghand_engine.avatar.learned import Learned, Light
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native.binding import Library, address, aligned_zeros, new_team
from jghand_engine.native.learned_tasks import CorrectiveKind, LearnedTask
from jghand_engine.native.tasks import LANES


class FastLearnedSkin:
    """Poses one trained avatar again and again, without gradients.

    skin: the order of its rows, and their opacity · reflecting: whether colors depend on where the camera stands; if
    not, `prepare` and `run` give them, and there is no gloss to be run
    """

    def __init__(self, library: Library, avatar: HandAvatar) -> None:
        if avatar.learned is None:
            raise InputError("skin of a trained avatar", wanted="one that was trained", came=avatar.info.name)
        check_task(library, library.call.jg_learned_task_bytes(), LearnedTask)
        self._call = library.call
        self.skin = FastSkinning(library, avatar)
        self.team, self.gloss_team = new_team(), new_team()
        self.reflecting = avatar.learned.reflects
        self._task = new_task(avatar.learned, avatar.handedness)
        self._arrays = learned_arrays(avatar, avatar.learned, self.skin.blocks)
        point(self._task, self._arrays)
        self._task.lobes = len(self._arrays["lobe"])
        self._correctives = fast_correctives(avatar.learned.correctives, avatar, self.skin.blocks, self._task)
        cast = avatar.learned.cast
        self._cast = None if cast is None else FastCast(cast, avatar, self.skin.blocks, self._task)
        self._posed = False
        self._eye_m: np.ndarray | None = None
        self._keep: tuple[object, ...] = ()

    def prepare(
        self,
        bones: Bones,
        into: PosedArrays,
        rgb: np.ndarray,
        shift_m: np.ndarray,
        *,
        keeps_correctives: bool = False,
    ) -> None:
        """Sets the next pose; `into` and `shift_m` as for FastSkinning, rgb (rows, 3) float32 for the colors.
        keeps_correctives: whether those of the last pose that was run are used again.

        InputError names an array that the kernel cannot read or write.
        """
        self.skin.prepare(bones, into, shift_m)
        task = self._task
        task.rgb = address(rgb, np.float32, "rgb", (self.skin.rows, 3), writable=True)
        task.skin = self.skin.task
        task.palm = tuple((bones.linear_offset[0, :, :3].astype(np.float64) * inverse_scale(bones)).ravel())
        if not keeps_correctives:
            self._correctives.prepare(task, bones.angles_rad)
        elif task.given is not None:
            task.correctives = CorrectiveKind.GIVEN
        if self._cast is not None:
            self._cast.prepare(bones)
        self._keep = (into, rgb)
        self._posed, self._eye_m = True, None
        self.team.fill(0)

    def run(self) -> None:
        """Poses the avatar; every thread of a team calls it."""
        self._call.jg_learned_pose(self.team.ctypes.data, ctypes.addressof(self._task))

    def prepare_gloss(self, eye_m: np.ndarray) -> bool:
        """Sets where the camera stands (3,), in the frame of the positions. Whether there is anything to be run: not
        when nothing is reflected or the pose was seen from there last."""
        if not self._posed:
            raise InputError("picture", wanted="a pose", came="none")
        if not self.reflecting or (self._eye_m is not None and np.array_equal(eye_m, self._eye_m)):
            return False
        self._eye_m = np.array(eye_m, np.float64)
        self._task.eye = tuple(self._eye_m)
        self.gloss_team.fill(0)
        return True

    def run_gloss(self) -> None:
        """Colors as that camera sees them; every thread of a team calls it, after `run`."""
        self._call.jg_learned_gloss(self.gloss_team.ctypes.data, ctypes.addressof(self._task))


def new_task(learned: Learned, handedness: Handedness) -> LearnedTask:
    """What the kernel is told of a trained avatar, without arrays."""
    side = -1 if handedness is Handedness.LEFT else 1
    return LearnedTask(
        rim=float(learned.light.rim),
        volume_min=limits.BLEND_DET_MIN,
        exponent_max=limits.LIGHT_EXPONENT_MAX,
        length2_min=limits.NORMAL_LENGTH2_MIN,
        world_offsets=side if learned.world_offsets else 0,
    )


def learned_arrays(avatar: HandAvatar, learned: Learned, blocks: Blocks) -> dict[str, np.ndarray]:
    """What the kernel reads of colors: fields of LearnedTask by name; `matt`, which it writes, where it reflects."""
    look = np.concatenate([learned.normal, avatar.rgb, learned.shine[:, None]], 1)
    arrays = {"look": blocks.blocked(look)} | _light(learned.light)
    if learned.reflects:
        arrays["matt"] = aligned_zeros((blocks.count, 6, LANES))
    return arrays


def _light(light: Light) -> dict[str, np.ndarray]:
    length2 = np.square(light.lobe_direction).sum(-1, keepdims=True)
    direction = light.lobe_direction / np.sqrt(np.maximum(length2, limits.NORMAL_LENGTH2_MIN))
    lobe = np.concatenate([direction, light.lobe_sharpness[:, None] / np.log(2), light.lobe_rgb], 1)
    arrays = {}
    for name, values in (("irradiance", light.irradiance), ("lobe", lobe)):
        arrays[name] = aligned_zeros(values.shape)
        arrays[name][...] = values
    return arrays
