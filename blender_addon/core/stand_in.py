# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface of a hand at any 21 joints: what throws its shadow in Cycles and EEVEE, and where the scene's shadow on
it is looked for.

It is the engine's template, whose file the build copies into the zip. Each vertex has weights of the bones that *begin*
at a joint, as armatures have them. Does not use bpy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from . import posing
from .joints import KNUCKLES, LEFT, NAMES, RIGHT, TAILS, WRIST

_NAME = "hand_right.npz"
# where the skin is looked at for shadows: 3.5 mm from each other, like the engine's anchors
POINTS = 3000
# where light is baked: 1.8 mm from each other, less than a Gaussian of the skin is wide
FINE_POINTS = 12_000
# from where to where behind the wrist it bends, meters: the engine's
BEND_M = (-0.015, 0.035)
# the engine's too (METHOD 2.4, 2.7): spread of the split of the wrist's weight over the metacarpals, and how far before
# the wrist that begins, meters; how much a plane of two metacarpals is the palm's
_SPLIT_M, _WRIST_BLEND_M, _PALM_PART = 0.012, 0.015, 0.2
# the step of differences by a knuckle, as a part of its distance from the wrist
_STEP = 0.02
_MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Surface:
    """A closed hand.

    vertices: (V, 3), unit of the joints
    faces:    (F, 3), counter-clockwise seen from outside
    weights:  (V, 21) of the bone that begins at each joint, standard order; rows sum to 1
    """

    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray

    @property
    def normals(self) -> np.ndarray:
        """(V, 3) unit, outwards: faces count by their area."""
        corners = self.vertices[self.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        total = np.zeros_like(self.vertices)
        for corner in range(3):
            np.add.at(total, self.faces[:, corner], across)
        return _unit(total)


def surface_at(joints: np.ndarray, handedness: str, *, forearm: bool = False) -> Surface:
    """The template's hand carried to (21, 3) joints of any pose, any unit: each bone, metacarpals too, is turned onto
    its new place and stretched along itself; across, all are as thick as the whole hand is large. forearm: with it.
    JGHandFailure: bad_joints."""
    template, rest, shares = _template(handedness, forearm)
    (maps,) = _maps_at(np.asarray(joints)[None], rest, handedness)
    return replace(template, vertices=_carried(template, shares, maps[None])[0])


def _maps_at(joints: np.ndarray, rest: np.ndarray, handedness: str) -> np.ndarray:
    """(F, 26, 3, 4) of B_0, which has no length, the metacarpals, and the bones that begin at the other joints, from
    the template's rest matrices to (F, 21, 3) joints."""
    joints, own = posing.checked_joints(joints), rest[:, :3, 3]
    palm = _palm_turns(joints, own, handedness)
    axes = posing.posed_axes(joints, rest, handedness, metacarpals=palm[:, 1:])
    later = range(1, len(NAMES))
    turns = np.concatenate([palm, axes[:, 1:] @ np.swapaxes(rest[1:, :3, :3], -1, -2)], 1)
    starts = [WRIST] * palm.shape[1] + [*later]
    ends = [WRIST, *KNUCKLES] + [TAILS[place] if TAILS[place] >= 0 else place for place in later]
    own_bones = own[ends] - own[starts]
    lengths, own_lengths = (
        np.linalg.norm(joints[:, ends] - joints[:, starts], axis=-1),
        np.linalg.norm(own_bones, axis=-1),
    )
    size, has_length = lengths.sum(-1, keepdims=True) / own_lengths.sum(), own_lengths > 0
    along = own_bones / np.where(has_length, own_lengths, 1.0)[:, None]
    longer = np.where(has_length, lengths / np.where(has_length, own_lengths, 1.0) - size, 0.0)[..., None, None]
    linear = turns @ (size[..., None, None] * np.eye(3) + longer * along[:, :, None] * along[:, None, :])
    places = joints[:, starts] - np.einsum("fjab,jb->fja", linear, own[starts])
    return np.concatenate([linear, places[..., None]], -1)


def _carried(template: Surface, shares: np.ndarray, maps: np.ndarray) -> np.ndarray:
    """(F, V, 3) where maps (F, 26, 3, 4) carry the vertices."""
    weights = np.concatenate([template.weights[:, :1] * shares, template.weights[:, 1:]], 1)
    skin = (weights @ maps.reshape(*maps.shape[:2], 12)).reshape(len(maps), -1, 3, 4)
    return np.einsum("fvab,vb->fva", skin[..., :3], template.vertices) + skin[..., 3]


def _palm_turns(joints: np.ndarray, rest: np.ndarray, handedness: str) -> np.ndarray:
    """How the palm and the metacarpals of thumb to pinky are turned from (21, 3) joints at rest to (F, 21, 3), (F, 6,
    3, 3): as the engine has it, so that a palm that arches turns with its knuckles."""
    mirror, knuckles = _MIRROR if handedness == LEFT else np.ones(3), list(KNUCKLES)
    palm, own_palm = (mirror[:, None] * posing.palm_frames(each, handedness) for each in (joints, rest[None]))
    fan = _unit((joints[:, knuckles] - joints[:, [WRIST]]) * mirror)
    own_fan = _unit((rest[knuckles] - rest[WRIST]) * mirror)
    turn, own_normals = palm @ own_palm[0].T, _unit(np.cross(own_fan[:-1], own_fan[1:]))
    normals = _unit(np.cross(fan[:, :-1], fan[:, 1:]) + _PALM_PART * own_normals @ np.swapaxes(turn, -1, -2))
    frames, own_frames = _metacarpal_frames(fan, normals), _metacarpal_frames(own_fan, own_normals)
    turns = np.concatenate([turn[:, None], frames @ np.swapaxes(own_frames, -1, -2)], 1)
    return mirror[:, None] * turns * mirror


def _metacarpal_frames(fan: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(..., 5, 3) directions and (..., 4, 3) normals of the planes between them -> (..., 5, 3, 3)."""
    of_finger = normals[..., [0, 1, 1, 2, 3], :] + normals[..., [0, 1, 2, 3, 3], :]
    y = _unit(np.cross(fan, of_finger))
    return np.stack([np.cross(y, fan), y, fan], -1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


def knuckle_ways(joints: np.ndarray, handedness: str, ways: np.ndarray, *, forearm: bool = False) -> np.ndarray:
    """By how much knuckles take the palm's skin along, where the bones of an armature do not: (5, 3, V, 3) ways of
    vertices per way of the knuckles of thumb to pinky along (5, 3, 3) directions, in rows, from (21, 3) joints at rest.
    JGHandFailure: bad_joints."""
    template, rest, shares = _template(handedness, forearm)
    moved, by_bones = np.zeros((len(KNUCKLES), 3, *joints.shape)), []
    for finger, (knuckle, directions) in enumerate(zip(KNUCKLES, ways, strict=True)):
        moved[finger, :, knuckle : knuckle + 4] = directions[:, None]
        by_bones.append(template.weights[:, knuckle : knuckle + 4].sum(1)[:, None] * directions[:, None])
    step = _STEP * np.linalg.norm(joints[list(KNUCKLES)] - joints[WRIST], axis=-1).repeat(3)[:, None, None]
    moved = moved.reshape(-1, *joints.shape)
    # all at once: one after the other takes a third of a second
    after, before = np.split(
        _maps_at(np.concatenate([joints + step * moved, joints - step * moved]), rest, handedness), 2
    )
    found = _carried(template, shares, (after - before) / (2 * step[..., None]))
    return found.reshape(len(KNUCKLES), 3, -1, 3) - np.array(by_bones)


def points_on(surface: Surface, count: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """(count, 3) places evenly on the surface of a hand, and the unit normals there."""
    corners, share = _points(count)
    normals = _unit(np.einsum("pk,pka->pa", share, surface.normals[corners]))
    return np.einsum("pk,pka->pa", share, surface.vertices[corners]), normals


def with_forearm_bone(weights: np.ndarray, handedness: str) -> np.ndarray:
    """(V, 21) weights of the hand with a forearm -> (V, 22): what followed the wrist goes over to the bone that this
    hangs on. Where it is bent, skin bends as the engine's; all of a twist is there, too."""
    surface, rest, _ = _template(handedness, True)
    wrist = rest[WRIST, :3, 3]
    way = wrist - posing.forearm_rest(rest, handedness)[:3, 3]
    behind = (wrist - surface.vertices) @ way / np.linalg.norm(way)
    part = ((behind - BEND_M[0]) / (BEND_M[1] - BEND_M[0])).clip(0, 1)
    forearm = weights[:, WRIST] * part * part * (3 - 2 * part)
    return np.column_stack([weights[:, WRIST] - forearm, weights[:, 1:], forearm])


@cache
def points_m(count: int = POINTS) -> np.ndarray:
    """(count, 3) float32, the same on the right hand of the template, meters: by these the engine knows them."""
    corners, share = _points(count)
    return np.einsum("pk,pka->pa", share, _template(RIGHT)[0].vertices[corners]).astype("<f4")


@cache
def _points(count: int) -> tuple[np.ndarray, np.ndarray]:
    """(count, 3) the corners of the faces in which points lie, and their shares: faces by area, places in them by a
    sequence (Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, 2018)."""
    surface = _template(RIGHT)[0]
    corners = surface.vertices[surface.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1).cumsum()
    number = np.arange(count) + 0.5
    within = (number[:, None] * [0.7548776662, 0.5698402910]) % 1.0
    beyond = within.sum(1) > 1
    within[beyond] = 1 - within[beyond]
    face = np.searchsorted(area, number / count * area[-1])
    return surface.faces[face], np.concatenate([1 - within.sum(1, keepdims=True), within], 1)


@cache
def _template(handedness: str, forearm: bool = False) -> tuple[Surface, np.ndarray, np.ndarray]:
    """The template's hand, meters, its (21, 4, 4) rest matrices, and the shares (V, 6) of the palm and the metacarpals
    in what follows the wrist."""
    package = Path(__file__).parents[1]
    built = package / "assets" / _NAME
    path = built if built.is_file() else package.parent / "jghand_engine" / "assets" / _NAME
    with np.load(path, allow_pickle=False) as arrays:
        vertices, faces, weights, joints = (arrays[name] for name in ("vertices", "faces", "weights", "joints"))
        if forearm:  # in the place of the wrist's cap, whose weights it has
            skin, behind = len(arrays["base_index"]), arrays["forearm_vertices"]
            vertices, faces = vertices[:skin], faces[: arrays["n_skin_faces"]]
            vertices, faces = np.concatenate([vertices, behind]), np.concatenate([faces, arrays["forearm_faces"]])
            weights = np.concatenate([weights[:skin], np.repeat(weights[skin:], len(behind), 0)])
    vertices, weights, joints = (each.astype(np.float64) for each in (vertices, weights, joints))
    weights /= weights.sum(1, keepdims=True)
    shares = _palm_shares(vertices, joints)
    if handedness == LEFT:
        vertices, faces, joints = vertices * _MIRROR, faces[:, ::-1], joints * _MIRROR
    return Surface(vertices, faces, weights), posing.rest_matrices(joints, handedness), shares


def _palm_shares(vertices: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """(V, 3) in the template's frame -> (V, 6); rows sum to 1."""
    vertices, bones = vertices - joints[WRIST], joints[list(KNUCKLES)] - joints[WRIST]
    part = (vertices @ bones.T / (bones * bones).sum(-1)).clip(0, 1)
    squared = ((vertices[:, None] - part[..., None] * bones) ** 2).sum(-1)
    share = np.exp((squared.min(1, keepdims=True) - squared) / (2 * _SPLIT_M**2))
    share /= share.sum(1, keepdims=True)
    height = (vertices[:, 1:2] / _WRIST_BLEND_M).clip(0, 1)
    of_metacarpals = height**2 * (3 - 2 * height)
    return np.concatenate([1 - of_metacarpals, share * of_metacarpals], 1)
