"""The hands that captures show: the mesh of the built-in hand in other shapes, none of them its own. DATA 2.

The shapes are made by scripts/build_identities.py. Faces, UV and skin weights are those of the built-in hand's file,
with its rig of 25 joints: its metacarpals move, which no hand of 21 joints can follow exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.npz_files import read_arrays
from jghand_engine.template.builtin import ASSETS, load_fields
from jghand_engine.template.checks import expect_shape

# places in the rig of the 21 joints in standard order; the four others are the bases of the metacarpals
RIG_OF_STANDARD = (0, 1, 2, 3, 4, 6, 7, 8, 9, 11, 12, 13, 14, 16, 17, 18, 19, 21, 22, 23, 24)
METACARPAL_BASES = (5, 10, 15, 20)
RIG_JOINTS = 25


@dataclass(frozen=True)
class Identity:
    """A rigged right hand in its canonical frame; meters.

    vertices_m (V, 3), faces (F, 3), face_uv (F, 3, 2), skin_face_count as in HandTemplate; joints25_m (25, 3),
    parents25 (25,), weights25 (V, 25): weights of joints, rows sum to 1.
    """

    name: str
    vertices_m: np.ndarray
    faces: np.ndarray
    face_uv: np.ndarray
    skin_face_count: int
    joints25_m: np.ndarray
    parents25: np.ndarray
    weights25: np.ndarray

    @property
    def joints_m(self) -> np.ndarray:
        """(21, 3) canonical joints, level order."""
        return joints21(self.joints25_m)


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


def load_identity(wanted: str) -> Identity:
    """The identity of a name or of a number from 0; InputError lists them."""
    name = identity_name(wanted)
    place = identity_names().index(name)
    shapes, rig = _shapes(), load_fields()
    # the wrist took what was left to 1: round-off below 0
    weights = rig["weights25"].astype(np.float64).clip(0)
    return Identity(
        name=name,
        vertices_m=shapes["vertices"][place].astype(np.float64),
        faces=rig["faces"].astype(np.int64),
        face_uv=rig["face_uv"].astype(np.float64),
        skin_face_count=int(rig["n_skin_faces"]),
        joints25_m=shapes["joints25"][place].astype(np.float64),
        parents25=rig["parents25"].astype(np.int64),
        weights25=weights / weights.sum(axis=1, keepdims=True),
    )


def _shapes() -> dict[str, np.ndarray]:
    thing = "the identities that come with JGHand"
    shapes = read_arrays(ASSETS / "identities.npz", ("names", "vertices", "joints25"), thing)
    count, vertices = len(shapes["names"]), len(load_fields()["vertices"])
    expect_shape(f"{thing}, vertices", shapes["vertices"], (count, vertices, 3))
    expect_shape(f"{thing}, joints25", shapes["joints25"], (count, RIG_JOINTS, 3))
    return shapes
