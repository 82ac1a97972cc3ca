"""The hand that JGHand ships: read from the package's own file, with every value checked."""

from __future__ import annotations

import functools
from importlib.resources import files
from importlib.resources.abc import Traversable

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import STANDARD_NAMES
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.npz_files import read_arrays
from jghand_engine.template.checks import check_template, expect_shape
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.weights import bone_weights, columns_to_level

IDENTIFIER = "makehuman-soma-right-1"
ASSETS = files("jghand_engine") / "assets"

# field: (kinds of dtype, shape with V vertices, F faces, S skin vertices)
FIELDS = {
    "vertices": ("f", ("V", 3)),
    "faces": ("i", ("F", 3)),
    "face_uv": ("f", ("F", 3, 2)),
    "face_uv_makehuman": ("f", ("F", 3, 2)),
    "n_skin_faces": ("i", ()),
    "joints": ("f", (21, 3)),
    "parents": ("i", (21,)),
    "joint_names": ("U", (21,)),
    "weights": ("f", ("V", 21)),
    "joints25": ("f", (25, 3)),
    "parents25": ("i", (25,)),
    "names25": ("U", (25,)),
    "weights25": ("f", ("V", 25)),
    "base_index": ("i", ("S",)),
}


@functools.cache
def load_template() -> HandTemplate:
    """The built-in right hand; read once, arrays read-only. A damaged installation raises InputError."""
    try:
        fields = load_fields()
    except InputError as error:
        raise InputError("the built-in hand", came=str(error), remedy="Install JGHand again.") from error
    vertices = fields["vertices"].astype(np.float64)
    joints = to_level(fields["joints"].astype(np.float64), JointOrder.STANDARD)
    weights = columns_to_level(fields["weights"].astype(np.float64), JointOrder.STANDARD)
    weights /= weights.sum(axis=1, keepdims=True)
    template = HandTemplate(
        identifier=IDENTIFIER,
        vertices_m=vertices,
        faces=fields["faces"].astype(np.int64),
        face_uv=fields["face_uv"].astype(np.float64),
        skin_face_count=int(fields["n_skin_faces"]),
        joints_m=joints,
        bone_weights=bone_weights(weights, vertices, joints),
    )
    return _read_only(check_template(template))


def load_fields(source: Traversable = ASSETS / "hand_right.npz") -> dict[str, np.ndarray]:
    """All fields of a template file as they are stored (standard order, float32); see assets/README.md.

    Beside what `load_template` uses they hold the UV of the full-body atlas, for photographic skins, and a rig of 25
    joints with metacarpals, for making captures that our 21 joints cannot follow exactly. Raises InputError.
    """
    name = source.name
    fields = read_arrays(source, FIELDS, f"template file {name}")
    counted = {"V": "vertices", "F": "faces", "S": "base_index"}
    sizes = {letter: len(np.atleast_1d(fields[field])) for letter, field in counted.items()}
    for field, (kind, shape) in FIELDS.items():
        array = fields[field]
        if array.dtype.kind != kind:
            raise InputError(f"template file {name}, {field}", wanted=f"type '{kind}'", came=str(array.dtype))
        expect_shape(f"template file {name}, {field}", array, tuple(sizes.get(n, n) for n in shape))  # type: ignore[arg-type]
        if kind == "f" and not np.isfinite(array).all():
            raise InputError(f"template file {name}, {field}", wanted="finite numbers", came="NaN or infinity")
    if tuple(fields["joint_names"]) != STANDARD_NAMES:
        raise InputError(f"template file {name}, joint_names", wanted="the standard order", came="another")
    return fields


def _read_only(template: HandTemplate) -> HandTemplate:
    """Everybody shares the cached template, so nobody may change it."""
    for array in vars(template).values():
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
    return template
