"""The shadows that fingers and other hands cast, as the kernel of trained skin takes them (native/learned_cast.cpp).

The specification is `learn/cast_shadow.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import Blocks, set_pointers
from jghand_engine.avatar.learned import CAPSULE_LENGTH2_MIN, CastShadow, lamp_directions
from jghand_engine.avatar.nearest import nearest_centers
from jghand_engine.hand.joints import BONE_COUNT, JOINT_COUNT
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native.binding import aligned_zeros
from jghand_engine.native.learned_tasks import LearnedTask
from jghand_engine.native.tasks import LANES

# edges of shadows: softness of the capsule's surface, as a part of its radius, and half width of a lamp per distance
# (64 lamps on a sphere are 0.25 in radius; sharper edges learned poses a little better, with less than half of it)
FLESH_SOFTNESS = 0.2
LAMP_HALF_WIDTH = 0.15
# floors against division by zero: squared sine between ray and axis, width of an edge (m), bounced light
CAPSULE_SINE2_MIN = 1e-3
CAPSULE_WIDTH_MIN_M = 1e-6
BOUNCED_MIN = 1e-12
# neighboring anchors, in the order of their blocks, that throw light onto others as one: half a centimeter of skin
PATCH = 4
# how far apart skin counts as that faces another way, so that fingers' sides do not share a patch, m per unit normal
NORMAL_M = 0.02
# anchors whose mean is taken of the skin that they see, a centimeter of their own
EVENED = 8
# display-referred colors go with light to this power
LIGHT_TO_DISPLAY = 1 / 2.2


@dataclass(frozen=True)
class Capsules:
    """The flesh of other hands, (K,) capsules, meters relative to the root of the hand on which they cast a shadow.

    start_m, end_m: (K, 3)
    radius_m:       (K,)
    part:           (K,) 0..1 how much they count
    """

    start_m: np.ndarray
    end_m: np.ndarray
    radius_m: np.ndarray
    part: np.ndarray


def anchor_blocks(position_m: np.ndarray, normal: np.ndarray) -> Blocks:
    """Anchors, by place and normal (A, 3), in the order in which the kernels have them: neighbors that face about the
    same way together."""
    return Blocks.of(_by_place_and_normal(position_m, normal))


def anchors_beside(position_m: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(A, EVENED) anchors, those nearest to each, whose mean is taken of the skin that they see: what is found of few
    patches differs more from anchor to anchor than light does. Of a hand of fewer, some count twice."""
    at = _by_place_and_normal(position_m, normal)
    near = nearest_centers(at, at, EVENED)
    return near[:, np.arange(EVENED) % near.shape[1]].astype(np.int32)


def _by_place_and_normal(position_m: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return np.concatenate([position_m, NORMAL_M * normal], 1)


class CastStep:
    """Fills in a task what the shadows of its poses are found from. It must live as long as the task.

    blocks: of the avatar's Gaussians · arrays: fields of CastTask by name · around: those of LearnedTask
    joints_m: (21, 3) of the canonical hand, root-relative · direction: (16 groups, 3) towards the lamps
    flesh_ends_m: start and end (20, 3) of its capsules, root-relative · flesh_radius_m: (20,)
    anchors: of the avatar · rows: of them, whole blocks · row_of_anchor: in which each stands
    """

    def __init__(self, cast: CastShadow, avatar: HandAvatar, blocks: Blocks, task: LearnedTask) -> None:
        anchors, root_m = cast.anchors, avatar.canonical_joints_m[0]
        own = anchor_blocks(anchors.position_m, anchors.normal)
        rest = np.concatenate([anchors.position_m.astype(np.float64) - root_m, anchors.normal], 1)
        self.joints_m = avatar.canonical_joints_m - root_m
        self.rows = own.rows
        flesh = cast.flesh.astype(np.float64)
        self.flesh_ends_m, self.flesh_radius_m = (flesh[:, :3] - root_m, flesh[:, 3:6] - root_m), flesh[:, 6]
        self.direction, lamp = _lamps(lamp_directions(len(cast.lamp_rgb)), cast.lamp_rgb)
        groups = len(lamp)
        self.arrays = {
            "rest": own.blocked(rest),
            **own.bones(avatar.map_weights(anchors.position_m, anchors.bone_weights)),
            "foreign": own.blocked(1 - cast.own.astype(np.float64)),
            "lamp": lamp,
            "fallen": aligned_zeros((own.rows, 4)),
        }
        self.row_of_anchor = np.argsort(own.order)
        self.anchors = anchors
        self.around = {
            "nearest": blocks.blocked(self.row_of_anchor[anchors.nearest], np.int32),
            "share": blocks.blocked(anchors.share),
        }
        shadow = task.cast
        shadow.blocks, shadow.groups = own.count, groups
        shadow.bounced = tuple(np.maximum(cast.bounced_rgb, BOUNCED_MIN).tolist())
        shadow.softness, shadow.lamp_width = FLESH_SOFTNESS, LAMP_HALF_WIDTH
        shadow.width_min, shadow.distance2_min = CAPSULE_WIDTH_MIN_M, CAPSULE_LENGTH2_MIN
        shadow.to_display = LIGHT_TO_DISPLAY
        set_pointers(task, self.around)
        self._shadow, self._groups = shadow, groups
        self._set_capsules(BONE_COUNT)

    def _set_capsules(self, count: int) -> None:
        """Room for so many of them."""
        self._capsule = aligned_zeros((count, 8))
        self._capsule_lamp = aligned_zeros((count, self._groups, 2, LANES))
        self._other = aligned_zeros((max(count - BONE_COUNT, 1),))
        self._shadow.capsules = count
        self.arrays |= {"capsule": self._capsule, "capsule_lamp": self._capsule_lamp, "other": self._other}
        set_pointers(self._shadow, self.arrays)

    def set_lamps(self, direction: np.ndarray, rgb: np.ndarray) -> None:
        """Other lamps, as many as there were. direction: (K, 3) unit · rgb: (K, 3)"""
        self.direction, self.arrays["lamp"][...] = _lamps(direction, rgb)

    def prepare(self, bones: Bones, others: Capsules | None = None) -> None:
        """Sets the capsules of the next pose. others: of hands beside this one."""
        start, end = (posed_ends_m(bones.linear_offset, ends_m) for ends_m in self.flesh_ends_m)
        radius_m = bones.scale * self.flesh_radius_m
        if others is not None:
            start, end = np.concatenate([start, others.start_m]), np.concatenate([end, others.end_m])
            radius_m = np.concatenate([radius_m, others.radius_m])
        count = len(start)
        if count != self._shadow.capsules:
            self._set_capsules(count)
        if others is not None:
            self._other[:] = others.part
        axis = end - start
        length2 = np.maximum((axis * axis).sum(1), CAPSULE_LENGTH2_MIN)
        along = axis @ self.direction.T
        sine2 = np.maximum(length2[:, None] - along * along, CAPSULE_SINE2_MIN * length2[:, None])
        self._capsule[:, :3], self._capsule[:, 3:6] = start, axis
        self._capsule[:, 6], self._capsule[:, 7] = 1 / length2, radius_m
        self._capsule_lamp[:, :, 0] = along.reshape(count, -1, LANES)
        self._capsule_lamp[:, :, 1] = (1 / sine2).reshape(count, -1, LANES)


def posed_joints_m(linear_offset: np.ndarray, joints_m: np.ndarray) -> np.ndarray:
    """(21, 3) where the bones' maps (21, 3, 4) carry the joints (21, 3) of the canonical hand, root-relative."""
    # bone i ends at joint i
    return _moved(linear_offset[:JOINT_COUNT], joints_m)


def posed_ends_m(linear_offset: np.ndarray, ends_m: np.ndarray) -> np.ndarray:
    """(20, 3) where the maps of bones 1 to 20 carry points of their flesh (20, 3), root-relative."""
    return _moved(linear_offset[1:JOINT_COUNT], ends_m)


def _moved(matrices: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    return np.einsum("ijk,ik->ij", matrices[:, :, :3].astype(np.float64), points_m) + matrices[:, :, 3]


def _lamps(direction: np.ndarray, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions (16 groups, 3) float64, and lamps (groups, 6, 16) as the kernel has them. Those of one group stand
    near each other, so that skin turns away from all of them at once; black ones fill up the last group."""
    order = np.lexsort((direction[:, 2], direction[:, 1] > 0, direction[:, 0] > 0))
    spare = -len(rgb) % LANES
    direction = np.pad(direction[order], ((0, spare), (0, 0)), mode="edge")
    both = np.concatenate([direction, np.pad(rgb[order].astype(np.float64), ((0, spare), (0, 0)))], 1)
    lamp = aligned_zeros((len(both) // LANES, 6, LANES))
    lamp[...] = both.reshape(-1, LANES, 6).transpose(0, 2, 1)
    return direction, lamp
