"""The hands that captures show: the mesh of the built-in hand in other shapes, none of them its own, and their rig of
25 joints, with metacarpals that cup the palm, and plain linear blend skinning. DATA 2.

The shapes are made by scripts/build_identities.py; their fingers get flesh here. Faces, UV and skin weights are those
of the built-in hand's file.

The rig shares no rotation with the transform that learns from the images: bones turn about hinge axes (or follow
directions of a motion), knuckles draw together and those of ring and pinky sink when fingers bend, and each joint's own
rotation carries its skin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import FINGERS
from jghand_engine.hand.kinematics import RANGES_DEG, ArticulatedHand
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.hand.rotations import alignment, axis_rotation, half_turns, minimal_rotation, unit
from jghand_engine.hand.sequence import forearm_turns
from jghand_engine.hand.shapes import angles_on
from jghand_engine.npz_files import read_arrays
from jghand_engine.template.builtin import ASSETS, load_fields, with_forearm
from jghand_engine.template.weights import bone_weights, columns_to_level

# places in the rig of the 21 joints in standard order; the four others are the bases of the metacarpals
RIG_OF_STANDARD = (0, 1, 2, 3, 4, 6, 7, 8, 9, 11, 12, 13, 14, 16, 17, 18, 19, 21, 22, 23, 24)
METACARPAL_BASES = (5, 10, 15, 20)
RIG_JOINTS = 25
# largest turn of the metacarpals of index, middle, ring and pinky, degrees: the first two hardly move, the others make
# the hollow of the palm (6 and 12: DATA 4)
CUP_DEG = (0.5, 1.0, 6.0, 12.0)
# part of it for a finger that is fully bent at its knuckle, for a thumb wholly across the palm, and for a hand at rest
CUP_FLEXION = 0.65
CUP_OPPOSITION = 0.30
CUP_REST = 0.05
# how far below flat a stretched finger may press its metacarpal, as a part of the largest turn
CUP_FLATTEN = 0.25
# knuckles draw together when fingers bend: the turn of the metacarpals in the palm's plane at a right angle of the
# knuckle, degrees, towards the thumb's side below 0. First phalanges then touch, as they do in a fist
ARCH_DEG, ARCH_FLEXION_DEG = (2.6, 0.0, -2.0, -7.0), 90.0
# fingers are so much thicker about their bones than those of the file, which are slim for the breadth of its palm; from
# no change to all of it where the finger's share of the skin's weights is between these
FLESH, FLESH_SHARES = 1.10, (0.5, 1.0)
# first joint of each finger in the rig: thumb CMC, MCP of the others
FIRST_JOINTS = (1, 6, 11, 16, 21)
# wrist, thumb CMC, index and middle MCP: what cupping does not move
STIFF_PALM = slice(0, 4)
CUP_LARGEST_DEG = np.array(CUP_DEG)


@dataclass(frozen=True)
class Identity:
    """A rigged right hand in its canonical frame; mesh and UV as in HandTemplate.

    vertices_m: (V, 3)
    faces:      (F, 3)
    face_uv:    (F, 3, 2)
    joints25_m: (25, 3)
    weights25:  (V, 25) of the joints, rows sum to 1
    skin_face_count: number of skin faces, which come first
    """

    name: str
    vertices_m: np.ndarray
    faces: np.ndarray
    face_uv: np.ndarray
    joints25_m: np.ndarray
    weights25: np.ndarray
    skin_face_count: int

    @property
    def joints_m(self) -> np.ndarray:
        """(21, 3) canonical joints, level order."""
        return joints21(self.joints25_m)

    @property
    def bone_weights(self) -> np.ndarray:
        """(V, 21) of bones, as an avatar of this hand has them: metacarpals count as the wrist."""
        lumped = self.weights25.copy()
        lumped[:, 0] += lumped[:, list(METACARPAL_BASES)].sum(1)
        of_joints = columns_to_level(lumped[:, list(RIG_OF_STANDARD)], JointOrder.STANDARD)
        return bone_weights(of_joints, self.vertices_m, self.joints_m)


def joints21(joints25: np.ndarray) -> np.ndarray:
    """(..., 25, 3) joints of the rig -> (..., 21, 3), level order."""
    return to_level(joints25[..., list(RIG_OF_STANDARD), :], JointOrder.STANDARD)


def identity_names() -> tuple[str, ...]:
    """Names of the hands that there are, in the order of their numbers."""
    return tuple(str(name) for name in _shapes()["names"])


def identity_name(wanted: str) -> str:
    """The name of the identity that is called so or has that number from 0; InputError lists them."""
    names = identity_names()
    if wanted.isdecimal() and int(wanted) < len(names):
        return names[int(wanted)]
    if wanted in names:
        return wanted
    known = ", ".join(f"{number} {name}" for number, name in enumerate(names))
    raise InputError("identity", wanted=f"a number or a name of {known}", came=repr(wanted))


def load_identity(wanted: str, *, forearm: bool = False) -> Identity:
    """The identity of a name or of a number from 0; InputError lists them. forearm: with it, which goes on where the
    hand's skin ends"""
    name = identity_name(wanted)
    place = identity_names().index(name)
    shapes, rig = _shapes(), load_fields()
    vertices_m, skin = shapes["vertices"][place], len(rig["base_index"])
    if forearm:
        rig = with_forearm(rig)
        vertices_m = np.concatenate([vertices_m[:skin], shapes["forearm_vertices"][place]])
    # the wrist took what was left to 1: round-off below 0
    weights = rig["weights25"].astype(np.float64).clip(0)
    weights /= weights.sum(axis=1, keepdims=True)
    joints25_m = shapes["joints25"][place].astype(np.float64)
    return Identity(
        name=name,
        vertices_m=_fleshed(vertices_m.astype(np.float64), joints25_m, weights),
        faces=rig["faces"].astype(np.int64),
        face_uv=rig["face_uv"].astype(np.float64),
        joints25_m=joints25_m,
        weights25=weights,
        skin_face_count=int(rig["n_skin_faces"]),
    )


def _fleshed(vertices_m: np.ndarray, joints25_m: np.ndarray, weights25: np.ndarray) -> np.ndarray:
    """The vertices (V, 3) with the skin of index..pinky FLESH times as far from the nearest point of their bones."""
    fleshed = vertices_m.copy()
    for first in FIRST_JOINTS[1:]:
        starts, bones = joints25_m[first : first + 3], np.diff(joints25_m[first : first + 4], axis=0)
        from_start = vertices_m[:, None] - starts
        along = ((from_start * bones).sum(-1) / (bones**2).sum(-1)).clip(0, 1)
        from_bone = from_start - along[..., None] * bones
        nearest = np.linalg.norm(from_bone, axis=-1).argmin(1)
        share = np.interp(weights25[:, first : first + 4].sum(1), FLESH_SHARES, (0, 1))
        amount = (FLESH - 1) * share**2 * (3 - 2 * share)
        fleshed += amount[:, None] * from_bone[np.arange(len(vertices_m)), nearest]
    return fleshed


def _shapes() -> dict[str, np.ndarray]:
    thing = "the identities that come with JGHand"
    return read_arrays(ASSETS / "identities.npz", ("names", "vertices", "joints25", "forearm_vertices"), thing)


@dataclass(frozen=True)
class RigPose:
    """turn (F, 25, 3, 3): rotation of each joint's skin from the canonical hand; joints25_m (F, 25, 3), meters."""

    turn: np.ndarray
    joints25_m: np.ndarray

    @property
    def joints_m(self) -> np.ndarray:
        """(F, 21, 3) level order."""
        return joints21(self.joints25_m)

    def moved(self, turn: np.ndarray, center_m: np.ndarray) -> RigPose:
        """The whole hand turned by `turn` (F, 3, 3) about the point `center_m` (3,)."""
        joints = np.einsum("fab,fjb->fja", turn, self.joints25_m - center_m) + center_m
        return RigPose(turn[:, None] @ self.turn, joints)


class RiggedHand(ArticulatedHand):
    """An identity that can be posed by anatomical angles, or along the bones of a motion."""

    def __init__(self, identity: Identity) -> None:
        super().__init__(identity.joints_m)
        self.identity = identity
        rest = identity.joints25_m
        # (3 bones, 5 fingers, 3): the moving bones as they lie in the canonical hand
        self._rest_bones = np.stack([[rest[f + k + 1] - rest[f + k] for f in FIRST_JOINTS] for k in range(3)])
        straight = self.straight_joints_m
        self._straightening = chain_turns(self._rest_bones, (straight[6:] - straight[1:16]).reshape(3, 5, 3)[None])[0]

    def joints(self, angles_deg: np.ndarray) -> np.ndarray:
        """(F, 5, 4) angles -> (F, 21, 3) level-order joints of the rig, its palm cupped; meters."""
        return self.pose(angles_deg).joints_m

    def pose(self, angles_deg: np.ndarray) -> RigPose:
        """(F, 5, 4) anatomical angles, degrees, clamped to their ranges -> the rig's pose."""
        palm = self._cupping(np.asarray(angles_deg, dtype=np.float64))
        fingers = palm[:, None] @ self.turns(angles_deg) @ self._straightening
        return self._chained(palm, fingers)

    def angles_of(self, name: str) -> np.ndarray:
        """(5, 4) angles of a named pose, degrees, that touch by bones; what of its skin touches is for `closing`."""
        return angles_on(self, name)

    def follow(self, joints_m: np.ndarray, *, upright: bool = False) -> RigPose:
        """(F, 21, 3) level-order joints of any right hand -> the pose whose bones point the same way.

        The stiff part of the palm is aligned as a whole (least squares), then every finger bone swings from where its
        parent carries it, without twist. Bone lengths stay the identity's. upright: the hand as a whole stays in the
        canonical frame instead of turning with the motion.
        """
        world = alignment(_stiff_palm(self.identity.joints_m[None]), _stiff_palm(joints_m))
        local = np.einsum("fba,fjb->fja", world, joints_m - joints_m[:, :1])
        directions = (local[:, 6:] - local[:, 1:16]).reshape(-1, 3, 5, 3)
        flexion = np.zeros((len(local), 5, 4))
        palmar = np.einsum("fkc,c->fk", unit(directions[:, 0]), [0.0, 0.0, 1.0])
        flexion[:, :, 0] = np.degrees(np.arcsin(np.clip(palmar, -1, 1)))
        palm = self._cupping(flexion)
        carried = palm[:, None] @ np.broadcast_to(np.eye(3), (len(local), 3, 5, 3, 3))
        pose = self._chained(palm, chain_turns(self._rest_bones, directions, start=carried[:, 0]))
        return pose if upright else pose.moved(world, np.zeros(3))

    def skin(self, pose: RigPose) -> np.ndarray:
        """(F, V, 3) posed vertices: linear blend skinning with the rig's weights."""
        hand = self.identity
        moved_m = pose.joints25_m - np.einsum("fjab,jb->fja", pose.turn, hand.joints25_m)
        frames = []
        for turn, offset in zip(pose.turn, moved_m, strict=True):
            blended = np.einsum("vj,jab->vab", hand.weights25, turn)
            frames.append(np.einsum("vab,vb->va", blended, hand.vertices_m) + hand.weights25 @ offset)
        return np.stack(frames)

    def forearm(self, pose: RigPose) -> np.ndarray:
        """(F, 4) how its forearm is turned, see `HandPose`: it goes with the wrist, and not with the knuckles, which
        arch the palm."""
        return forearm_turns(pose.joints_m, self.identity.joints_m, pose.turn[:, 0])

    def _cupping(self, angles_deg: np.ndarray) -> np.ndarray:
        """(F, 5, 4) -> (F, 5, 3, 3) rotations of the metacarpals (the thumb's has none): the palm hollows when fingers
        bend and when the thumb comes across, and flattens when they stretch; bent knuckles draw together."""
        bent = (angles_deg[:, 1:, 0] / RANGES_DEG[1:, 0, 1]).clip(-1, 1)
        across = (angles_deg[:, :1, 0] / RANGES_DEG[0, 0, 1]).clip(0, 1)
        amount = CUP_FLEXION * bent + CUP_OPPOSITION * across + CUP_REST
        cup = np.radians(CUP_LARGEST_DEG) * amount.clip(-CUP_FLATTEN, 1)
        bones = self.identity.joints25_m[[base + 1 for base in METACARPAL_BASES]]
        bones = bones - self.identity.joints25_m[list(METACARPAL_BASES)]
        # positive rotation about cross(bone, out of the palm) is flexion
        axes = unit(np.cross(bones, [0.0, 0.0, 1.0]))
        arch = np.radians(ARCH_DEG) * (angles_deg[:, 1:, 0] / ARCH_FLEXION_DEG).clip(0, 1)
        turns = axis_rotation(np.array([0.0, 0.0, 1.0]), arch) @ axis_rotation(axes, cup)
        still = np.broadcast_to(np.eye(3), (len(angles_deg), 1, 3, 3))
        return np.concatenate([still, turns], axis=1)

    def _chained(self, palm: np.ndarray, fingers: np.ndarray) -> RigPose:
        """Metacarpals (F, 5, 3, 3) and finger bones (F, 3, 5, 3, 3) to the whole rig."""
        frames, rest = len(palm), self.identity.joints25_m
        turn = np.tile(np.eye(3), (frames, RIG_JOINTS, 1, 1))
        joints = np.tile(rest, (frames, 1, 1))
        for finger in range(len(FINGERS)):
            first = FIRST_JOINTS[finger]
            if finger:
                base = METACARPAL_BASES[finger - 1]
                turn[:, base] = palm[:, finger]
                joints[:, first] = rest[base] + palm[:, finger] @ (rest[first] - rest[base])
            for bone in range(3):
                turn[:, first + bone] = fingers[:, bone, finger]
                step = fingers[:, bone, finger] @ self._rest_bones[bone, finger]
                joints[:, first + bone + 1] = joints[:, first + bone] + step
            # a tip carries no skin; its rotation is that of the bone that ends there
            turn[:, first + 3] = fingers[:, 2, finger]
        return RigPose(turn, joints)


def chain_turns(rest: np.ndarray, directions: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Rotations (F, 3, 5, 3, 3) that carry the bones `rest` (3, 5, 3) to `directions` (F, 3, 5, 3).

    Each bone swings by the smallest rotation from where its parent carries it; `start` (F, 5, 3, 3) carries the first.
    """
    frames = len(directions)
    carried = np.broadcast_to(np.eye(3), (frames, 5, 3, 3)) if start is None else start
    turns = []
    for bone in range(3):
        came = unit(np.einsum("fkab,kb->fka", carried, rest[bone]))
        wanted = unit(directions[:, bone])
        helper = np.where(np.abs(came[..., :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        swing = minimal_rotation(came, wanted, half_turns(unit(np.cross(came, helper))))
        carried = swing @ carried
        turns.append(carried)
    return np.stack(turns, axis=1)


def _stiff_palm(joints_m: np.ndarray) -> np.ndarray:
    """The stiff part of palms (F, 21, 3), about its middle."""
    palm = joints_m[:, STIFF_PALM]
    return palm - palm.mean(1, keepdims=True)
