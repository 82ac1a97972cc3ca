"""The hand that JGHand ships: read from the package's own file."""

from __future__ import annotations

import functools
from importlib.resources import files
from importlib.resources.abc import Traversable

import numpy as np

from jghand_engine.avatar.avatar import FOREARM_SUFFIX
from jghand_engine.avatar.forearm import BUILTIN_TEMPLATE
from jghand_engine.errors import InputError
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.npz_files import read_arrays
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.weights import bone_weights, columns_to_level

IDENTIFIER = BUILTIN_TEMPLATE
WITH_FOREARM = BUILTIN_TEMPLATE + FOREARM_SUFFIX
ASSETS = files("jghand_engine") / "assets"

# assets/README.md says what they are
FIELDS = (
    *("vertices", "faces", "face_uv", "face_uv_makehuman", "n_skin_faces", "joints", "parents", "joint_names"),
    *("weights", "joints25", "parents25", "names25", "weights25", "base_index"),
    *("forearm_vertices", "forearm_faces", "forearm_face_uv", "n_forearm_faces"),
)
_WEIGHTS = ("weights", "weights25")


@functools.cache
def load_template() -> HandTemplate:
    """The built-in right hand; read once, arrays read-only. A damaged installation raises InputError."""
    return _template(IDENTIFIER, _fields_of_installation())


@functools.cache
def load_template_with_forearm() -> HandTemplate:
    """The same hand, to the bit, whose skin goes on to the middle of the forearm; as above."""
    return _template(WITH_FOREARM, with_forearm(_fields_of_installation()))


def template_called(identifier: str) -> HandTemplate:
    """The built-in hand, with its forearm where an avatar was made on that one."""
    return load_template_with_forearm() if identifier == WITH_FOREARM else load_template()


def _fields_of_installation() -> dict[str, np.ndarray]:
    try:
        return load_fields()
    except InputError as error:
        raise InputError("the built-in hand", came=str(error), remedy="Install JGHand again.") from error


def _template(identifier: str, fields: dict[str, np.ndarray]) -> HandTemplate:
    vertices = fields["vertices"].astype(np.float64)
    joints = to_level(fields["joints"].astype(np.float64), JointOrder.STANDARD)
    weights = columns_to_level(fields["weights"].astype(np.float64), JointOrder.STANDARD)
    weights /= weights.sum(axis=1, keepdims=True)
    template = HandTemplate(
        identifier=identifier,
        vertices_m=vertices,
        faces=fields["faces"].astype(np.int64),
        face_uv=fields["face_uv"].astype(np.float64),
        skin_face_count=int(fields["n_skin_faces"]),
        joints_m=joints,
        bone_weights=bone_weights(weights, vertices, joints),
        forearm_face_count=int(fields["n_forearm_faces"]) if identifier == WITH_FOREARM else 0,
    )
    return _read_only(template)


def with_forearm(fields: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The fields of a template file with the forearm in the place of the wrist's cap. It moves with the wrist alone.

    The hand's skin keeps its numbers: vertices 0..S-1 and faces 0..n_skin_faces-1.
    """
    skin, faces = len(fields["base_index"]), int(fields["n_skin_faces"])
    # of the wrist, as the middle of its cap has them
    follow = {name: np.repeat(fields[name][skin:], len(fields["forearm_vertices"]), 0) for name in _WEIGHTS}
    return {
        **fields,
        "vertices": np.concatenate([fields["vertices"][:skin], fields["forearm_vertices"]]),
        "faces": np.concatenate([fields["faces"][:faces], fields["forearm_faces"]]),
        "face_uv": np.concatenate([fields["face_uv"][:faces], fields["forearm_face_uv"]]),
        "n_skin_faces": fields["n_skin_faces"] + fields["n_forearm_faces"],
        **{name: np.concatenate([fields[name][:skin], follow[name]]) for name in _WEIGHTS},
    }


def load_fields(source: Traversable = ASSETS / "hand_right.npz") -> dict[str, np.ndarray]:
    """All fields of a template file as they are stored (standard order, float32); see assets/README.md.

    Beside what `load_template` uses they hold the UV of the full-body atlas, for photographic skins, and a rig of 25
    joints with metacarpals, for making captures that our 21 joints cannot follow exactly. InputError for a file that is
    damaged: its checksums tell.
    """
    return read_arrays(source, FIELDS, f"template file {source.name}")


def _read_only(template: HandTemplate) -> HandTemplate:
    """Everybody shares the cached template, so nobody may change it."""
    for array in vars(template).values():
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
    return template
