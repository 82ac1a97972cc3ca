"""Ground truth of a picture: maps of what each pixel shows, and where the joints are and whether one sees them.

The channels:

    Z             meters along the view axis, 0 where there is nothing: the mean of what covers the pixel
    normal.X Y Z  unit, towards the camera, in its axes (x right, y down, z forward), 0 where there is nothing
    hand_id       1 where the hand is, 0 elsewhere
    bone_id       the bone that covers most: the number, 1..20, of the joint of the standard order at which it ends
    A             how much of the pixel is covered, 0..1, as the picture was blended
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar, bone_numbers
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, PARENTS
from jghand_engine.hand.orders import LEVEL_OF_STANDARD, STANDARD_OF_LEVEL, hand_length
from jghand_engine.native.contract import Z_NEAR_M
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import Frame

# the skin around a joint is what lies in a slab of this half thickness across its bone: thin beside the shortest bone
JOINT_SLAB_M = 0.004
# which of the distances of that skin counts, percent: the largest are strays of the neighboring finger
JOINT_REACH_PERCENTILE = 95.0
# a joint is visible when what is before it begins at most so many times that far from it: rays come in at an angle and
# bent joints bulge, seen 1.3; what hides a joint begins from 1.6 on, and the thickness of a finger away as a rule
JOINT_REACH_ROOM = 1.45
MAPS = ("depth", "normal", "ids", "alpha")
JOINTS = "joints"


def pass_names(text: str) -> tuple[str, ...]:
    """`depth,joints` as names. InputError names what is none, and what comes twice."""
    names = tuple(word.strip() for word in text.split(",") if word.strip())
    unknown = [name for name in names if name not in (*MAPS, JOINTS)]
    if unknown or not names or len(set(names)) < len(names):
        raise InputError(
            "--passes",
            wanted=f"names of {', '.join((*MAPS, JOINTS))}, each once",
            came=", ".join(unknown) or repr(text),
        )
    return names


def channels(frame: Frame, bone_ids: np.ndarray | None, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Name of the channel -> (H, W) float32 or uint32, of the maps in `names`. Those must be in the frame, and depth
    for all but alpha; bone_ids, for ids: (H, W) as HandRenderer.bone_ids gives them."""
    found: dict[str, np.ndarray] = {}
    alpha = frame.rgba[..., 3]
    # where there is enough coverage to speak of a depth: all maps end at the same pixels
    covered = frame.depth_m > 0
    if "alpha" in names:
        found["A"] = alpha
    if "depth" in names:
        found["Z"] = frame.depth_m
    if "normal" in names and frame.normal is not None:
        normal = np.where(covered[..., None], frame.normal, np.float32(0))
        found |= {f"normal.{axis}": normal[..., place] for place, axis in enumerate("XYZ")}
    if "ids" in names and bone_ids is not None:
        found["hand_id"] = covered.astype(np.uint32)
        found["bone_id"] = np.where(covered, _filled(bone_ids, covered), 0).astype(np.uint32)
    return found


def _filled(bone_ids: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """(H, W) bones, with those of the next pixel that has one where the picture is covered and there is none: they are
    counted in a picture of their own, whose outline may be a pixel off."""
    ids, (height, width) = bone_ids, bone_ids.shape
    while ids.any() and (covered & (ids == 0)).any():
        before = np.pad(ids, 1)
        # pixels at an edge are nearer than those at a corner
        for down, right in ((0, 1), (1, 0), (1, 2), (2, 1), (0, 0), (0, 2), (2, 0), (2, 2)):
            ids = np.where(ids == 0, before[down : down + height, right : right + width], ids)
    return ids


@dataclass(frozen=True)
class JointView:
    """The joints of a picture, standard order. joints_m (21, 3) world, meters · px (21, 2) pixels, (0, 0) the outer
    corner of the top-left one, NaN where the joint is not before the camera, beyond its near plane · depth_m (21,)
    along the view axis · inside (21,) whether it lies in the picture · visible (21,) whether it does and nothing hides
    it but the flesh around it."""

    joints_m: np.ndarray
    px: np.ndarray
    depth_m: np.ndarray
    inside: np.ndarray
    visible: np.ndarray

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON, which knows no NaN: `px` of a joint is None then."""
        facts = {name: getattr(self, name).tolist() for name in self.__dataclass_fields__}
        return facts | {"px": [None if np.isnan(px).any() else px.tolist() for px in self.px]}


class JointWitness:
    """Says which joints of an avatar's pictures are visible.

    A joint lies in the flesh and is never seen itself. It counts as visible where it lies in the picture and nothing
    hides it but the flesh around it: the surface that its pixel shows is no farther before it than skin is from that
    joint at rest, with some room.
    """

    def __init__(self, avatar: HandAvatar) -> None:
        self._reach_m = JOINT_REACH_ROOM * joint_reach_m(avatar)
        self._length_m = hand_length(avatar.canonical_joints_m)

    def look(self, joints_m: np.ndarray, camera: Camera, depth_map_m: np.ndarray) -> JointView:
        """joints_m: (21, 3) level order, meters, world · depth_map_m: (H, W) through a pinhole, 0 where nothing is"""
        reach_m = self._reach_m * hand_length(np.asarray(joints_m)) / self._length_m
        joints_m = np.asarray(joints_m, np.float64)[LEVEL_OF_STANDARD]
        px, depth_m = camera.project(joints_m)
        # in the camera's plane there is no place in the picture, and behind it a mirrored one
        px[~(depth_m > Z_NEAR_M)] = np.nan
        inside = np.all((px >= 0) & (px < [camera.width, camera.height]), axis=1)
        shown_m = np.zeros(JOINT_COUNT)
        column, row = np.floor(px[inside]).astype(int).T
        shown_m[inside] = depth_map_m[row, column]
        # the surface lies on the same ray, along which the way is longer than along the axis
        before_m = (depth_m - shown_m) * np.linalg.norm(_rays(camera, px), axis=1)
        visible = inside & ((shown_m == 0) | (before_m <= reach_m))
        return JointView(joints_m, px, depth_m, inside, visible)


def joint_reach_m(avatar: HandAvatar) -> np.ndarray:
    """(21,) how far the skin around each joint is from it at rest, meters, standard order: of the Gaussians of its
    bones in a slab across the bone."""
    bones, points = bone_numbers(avatar), avatar.position_m.astype(np.float64)
    canonical = avatar.canonical_joints_m
    reach_m = np.zeros(JOINT_COUNT)
    for level in range(JOINT_COUNT):
        joint = STANDARD_OF_LEVEL[level]
        away = points[np.isin(bones, _bones_at(level))] - canonical[level]
        # across the bone that ends here, at the wrist across the way to the middle finger
        axis = canonical[level] - canonical[PARENTS[level]] if level else canonical[3] - canonical[0]
        across = np.abs(away @ (axis / np.linalg.norm(axis))) < JOINT_SLAB_M
        distances = np.linalg.norm(away[across] if across.any() else away, axis=1)
        reach_m[joint] = np.percentile(distances, JOINT_REACH_PERCENTILE) if len(distances) else 0.0
    return reach_m


def _bones_at(level: int) -> list[int]:
    children = [child for child in range(1, JOINT_COUNT) if PARENTS[child] == level]
    return [int(STANDARD_OF_LEVEL[bone]) for bone in (level, *children) if bone]


def _rays(camera: Camera, px: np.ndarray) -> np.ndarray:
    """(N, 3) the way to pixels (N, 2), 1 long along the axis, in the camera's axes."""
    if camera.orthographic:
        return np.tile([0.0, 0.0, 1.0], (len(px), 1))
    across = (px - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    return np.column_stack([across, np.ones(len(px))])
