"""MANO, when the user brings the file: MANO_RIGHT.pkl or MANO_LEFT.pkl to a template.

MANO may not be passed on, so JGHand ships nothing of it. Its files are pickles of Python 2 with objects of chumpy and
scipy. A pickle is a program that may call anything; here it may only name what is listed below: numpy's own makers of
arrays, and inert records in the place of everybody else's classes. Neither chumpy nor an old scipy is needed.
Formats and numbers: DATA 3, METHOD 2.7.
"""

from __future__ import annotations

import pickle
from collections import OrderedDict, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import JointOrder, check_hand_size, check_order, to_level
from jghand_engine.hand.rotations import unit, vector_rotation
from jghand_engine.template.layout import obj_uv, projected_uv, room_for_disk
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.surface import boundary_loop, disk_uv, enclosed_volume, fan_faces, is_closed
from jghand_engine.template.weights import bone_weights, check_weight_rows, columns_to_level

VERTICES, FACES, JOINTS = 778, 1538, 16
FIELDS = {
    "v_template": (VERTICES, 3),
    "f": (FACES, 3),
    "weights": (VERTICES, JOINTS),
    "J_regressor": (JOINTS, VERTICES),
    "kintree_table": (2, JOINTS),
    "shapedirs": (VERTICES, 3, 10),
    "posedirs": (VERTICES, 3, 9 * (JOINTS - 1)),
    "hands_mean": (3 * (JOINTS - 1),),
    "hands_components": (45, 45),
}
# MANO's files have 4 MB; larger ones are not MANO
PICKLE_BYTES_MAX = 64 * 2**20
# rows of MANO's skin weights sum to 1 within rounding; further off they are no such weights
WEIGHT_SUM_TOLERANCE = 1e-3
# parents of MANO's joints: wrist, index 1-3, middle 1-3, pinky 1-3, ring 1-3, thumb 1-3
PARENTS = (-1, *(parent for finger in range(5) for parent in (0, 1 + 3 * finger, 2 + 3 * finger)))


# vertices that serve as tips of thumb, index, middle, ring, pinky: those of manopth; others are millimeters away
TIP_VERTICES = {Handedness.RIGHT: (745, 317, 444, 556, 673), Handedness.LEFT: (745, 317, 445, 556, 673)}


def load_mano(path: Path | str) -> HandTemplate:
    """The user's own MANO file as a template: a right hand of mean shape, in MANO's mean pose and the canonical frame,
    closed at the wrist. A left one, recognized by the way its fingers bend, is mirrored: one right-hand model serves
    both.

    The texture layout is MANO_UV_right.obj or MANO_UV_left.obj of MANO's download page beside the file, and where
    neither lies there a projection (`layout.projected_uv`): good for experiments, with squeezed finger sides and a seam
    around the hand.

    Raises InputError for a file that is not MANO's or that asks for anything but arrays.
    """
    fields = read_mano(path)
    handedness = Handedness.RIGHT
    (flat_m, _), (vertices_m, joints_m) = _canonical_poses(fields, handedness)
    if (joints_m[17:21, 2] - joints_m[2:6, 2]).mean() < 0:
        handedness = Handedness.LEFT
        (flat_m, _), (vertices_m, joints_m) = _canonical_poses(fields, handedness)
    faces = fields["f"] if handedness is Handedness.RIGHT else fields["f"][:, ::-1]
    uv_path = Path(path).with_name(f"MANO_UV_{handedness}.obj")
    skin_uv = obj_uv(uv_path, faces) if uv_path.is_file() else projected_uv(flat_m, faces)
    loop = boundary_loop(faces)
    cap_uv = disk_uv(len(loop), *room_for_disk(skin_uv))
    weights = np.concatenate([fields["weights"], np.zeros((VERTICES, 5))], axis=1)
    weights = np.concatenate([weights, np.eye(JOINTS + 5)[:1]])
    vertices_m = np.concatenate([vertices_m, vertices_m[loop].mean(axis=0, keepdims=True)])
    return check_template(
        HandTemplate(
            identifier=f"mano-{handedness}-mean-manopth-{'obj' if uv_path.is_file() else 'projected'}",
            vertices_m=vertices_m,
            faces=np.concatenate([faces, fan_faces(loop, VERTICES)]),
            face_uv=np.concatenate([skin_uv, cap_uv]),
            skin_face_count=FACES,
            joints_m=joints_m,
            bone_weights=bone_weights(columns_to_level(weights, JointOrder.MANO16_TIPS), vertices_m, joints_m),
        )
    )


def read_mano(path: Path | str) -> dict[str, np.ndarray]:
    """MANO's arrays by name, as in FIELDS, from its pickle. InputError says what is wrong with the file."""
    file = f"MANO file {path}"
    content = _unpickled(Path(path), file)
    missing = [name for name in FIELDS if not isinstance(content, dict) or name not in content]
    if missing:
        raise InputError(file, wanted=f"MANO's fields {', '.join(missing)}", came="a file without them")
    fields = {name: _array(content[name], f"{file}, {name}") for name in FIELDS}
    for name, shape in FIELDS.items():
        expect_shape(f"{file}, {name}", fields[name], shape)
        if fields[name].dtype.kind not in "iuf" or not np.isfinite(fields[name]).all():
            raise InputError(f"{file}, {name}", wanted="finite numbers", came="others")
        fields[name] = fields[name].astype(np.int64 if name in ("f", "kintree_table") else np.float64)
    if fields["f"].min() < 0 or fields["f"].max() >= VERTICES:
        raise InputError(f"{file}, f", wanted=f"vertex numbers 0..{VERTICES - 1}", came="others")
    if tuple(fields["kintree_table"][0, 1:]) != PARENTS[1:]:
        raise InputError(f"{file}, kintree_table", wanted="MANO's tree of joints", came="another")
    off = np.abs(fields["weights"].sum(axis=1) - 1).max()
    if fields["weights"].min() < 0 or off > WEIGHT_SUM_TOLERANCE:
        raise InputError(f"{file}, weights", wanted="rows of at least 0 that sum to 1", came=f"rows off by {off:.2g}")
    # what is left of rounding in a row would shrink the posed skin
    fields["weights"] /= fields["weights"].sum(axis=1, keepdims=True)
    return fields


def _posed(fields: dict[str, np.ndarray], pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (778, 3) and joints (16, 3) of the mean shape in `pose` (16, 3) axis-angle, by MANO's skinning."""
    rotation = vector_rotation(pose)
    rest_joints = fields["J_regressor"] @ fields["v_template"]
    vertices = fields["v_template"] + fields["posedirs"] @ (rotation[1:] - np.eye(3)).ravel()
    world, joints = rotation.copy(), rest_joints.copy()
    for joint, parent in enumerate(PARENTS[1:], start=1):
        joints[joint] = joints[parent] + world[parent] @ (rest_joints[joint] - rest_joints[parent])
        world[joint] = world[parent] @ rotation[joint]
    offset = joints - np.einsum("jab,jb->ja", world, rest_joints)
    blended = np.einsum("vj,jab->vab", fields["weights"], world)
    return np.einsum("vab,vb->va", blended, vertices) + fields["weights"] @ offset, joints


def _canonical(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, 3) as rows of the canonical frame (+y wrist to middle MCP, +x to the index side, +z out of the palm),
    and joints (21, 3) in level order in the file's frame; given in MANO's order."""
    level = to_level(joints, JointOrder.MANO16_TIPS)
    y = unit(level[3] - level[0])
    x = level[2] - level[5]
    x = unit(x - y * (x @ y))
    return np.stack([x, y, np.cross(x, y)]), level


def _canonical_poses(fields: dict[str, np.ndarray], handedness: Handedness) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vertices and joints of the flat and of the mean hand in the canonical frame, taken for a `handedness` one."""
    mirror = np.array([-1.0 if handedness is Handedness.LEFT else 1.0, 1.0, 1.0])
    poses = []
    for pose in (np.zeros((JOINTS, 3)), np.concatenate([np.zeros((1, 3)), fields["hands_mean"].reshape(-1, 3)])):
        points, centers = _posed(fields, pose)
        axes, joints = _canonical(np.concatenate([centers, points[list(TIP_VERTICES[handedness])]]) * mirror)
        poses.append(((points * mirror - joints[0]) @ axes.T, (joints - joints[0]) @ axes.T))
    return poses


# ---- the pickle -----------------------------------------------------------------------------------------------------


class _Record:
    """An object of a class that is only named: whatever it was made of, and the attributes it was given."""

    attributes: dict[str, Any]

    def __new__(cls, *_: Any) -> _Record:
        record = super().__new__(cls)
        record.attributes = {}
        return record

    def __setstate__(self, state: Any) -> None:
        self.attributes = state if isinstance(state, dict) else {}


class _Chumpy(_Record):
    """chumpy's Ch: a variable whose numbers are its attribute x."""


class _Select(_Record):
    """chumpy's Select: entries `idxs` of the flattened variable `a`, in a preferred shape."""


class _Csc(_Record):
    """scipy's matrix compressed by columns."""


class _Csr(_Record):
    """scipy's matrix compressed by rows."""


def _encoded(text: str, _: str = "latin1") -> bytes:
    """How Python 3 writes bytes into old protocols."""
    return text.encode("latin1")


def _reconstructed(kind: type, *_: Any) -> Any:
    """copyreg's maker of objects of a class, for the classes below alone."""
    return kind()


_MULTIARRAY = np._core.multiarray if hasattr(np, "_core") else np.core.multiarray  # pyright: ignore
# every global that a file may mention, and what stands in its place
_ALLOWED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    **{(f"numpy.{core}.multiarray", name): getattr(_MULTIARRAY, name)
       for core in ("core", "_core") for name in ("_reconstruct", "scalar")},
    **{(f"scipy.sparse.{module}", f"{module.strip('_')}_matrix"): kind
       for module, kind in (("csc", _Csc), ("_csc", _Csc), ("csr", _Csr), ("_csr", _Csr))},
    **{("chumpy.ch", name): _Chumpy for name in ("Ch", "ch", "MatVecMult")},
    ("chumpy.reordering", "Select"): _Select,
    **{("chumpy.reordering", name): _Record for name in ("vstack", "transpose")},
    **{(module, "_reconstructor"): _reconstructed for module in ("copy_reg", "copyreg")},
    **{(module, "object"): object for module in ("__builtin__", "builtins")},
    **{(module, "set"): set for module in ("__builtin__", "builtins")},
    ("_codecs", "encode"): _encoded,
    ("collections", "OrderedDict"): OrderedDict,
    ("collections", "defaultdict"): defaultdict,
}  # fmt: skip


class _ArraysOnly(pickle.Unpickler):
    """Reads a pickle in which nothing is called but what stands in `_ALLOWED`."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ALLOWED:
            raise pickle.UnpicklingError(f"the global {module}.{name}"[:200])
        return _ALLOWED[module, name]

    def persistent_load(self, pid: Any) -> Any:
        raise pickle.UnpicklingError(f"an object that lies elsewhere: {pid}"[:200])


def _unpickled(path: Path, file: str) -> Any:
    """What the pickle holds, with records in the place of objects."""
    try:
        if path.stat().st_size > PICKLE_BYTES_MAX:
            raise InputError(file, wanted=f"at most {PICKLE_BYTES_MAX} bytes", came=f"{path.stat().st_size}")
        with path.open("rb") as stream:
            return _ArraysOnly(stream, encoding="latin1").load()
    except OSError as error:
        raise InputError(file, wanted="a file that can be read", came=str(error)) from error
    # a damaged pickle makes the reader stumble in any way; it has called nothing but makers of arrays
    except Exception as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            file, wanted="MANO's pickle of arrays", came=f"{error or type(error).__name__}"[:200],
            remedy="Nothing in it was executed. Use the original file.",
        ) from error  # fmt: skip


def _array(value: Any, name: str) -> np.ndarray:
    """The array that a value of the pickle describes. InputError calls it `name`."""
    try:
        if isinstance(value, _Select):
            chosen = _array(value.attributes["a"], name).ravel()[_array(value.attributes["idxs"], name)]
            shape = value.attributes.get("preferred_shape")
            return chosen if shape is None else chosen.reshape(shape)
        if isinstance(value, _Csc | _Csr):
            of = {key.lstrip("_"): part for key, part in value.attributes.items()}
            matrix = csc_matrix if isinstance(value, _Csc) else csr_matrix
            sparse = matrix((of["data"], of["indices"], of["indptr"]), shape=of["shape"])
            sparse.check_format(full_check=True)
            return sparse.toarray()
        if isinstance(value, _Chumpy):
            return _array(value.attributes["x"], name)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError, MemoryError, RecursionError) as error:
        raise InputError(name, wanted="an array", came=f"a broken {type(value).__name__.strip('_')}") from error
    if isinstance(value, np.ndarray | np.generic | int | float):
        return np.asarray(value)
    raise InputError(name, wanted="an array", came=f"a {type(value).__name__.strip('_')}")


# ---- is it a usable hand surface? -----------------------------------------------------------------------------------


def check_template(template: HandTemplate) -> HandTemplate:
    """Returns the template, or raises an InputError that names what is wrong with it."""
    name = f"template {template.identifier!r}"
    vertices, faces, joints = template.vertices_m, template.faces, template.joints_m
    expect_shape(f"{name}, vertices", vertices, (None, 3))
    expect_shape(f"{name}, faces", faces, (None, 3))
    expect_shape(f"{name}, UV", template.face_uv, (len(faces), 3, 2))
    expect_shape(f"{name}, joints", joints, (JOINT_COUNT, 3))
    expect_shape(f"{name}, weights", template.bone_weights, (len(vertices), JOINT_COUNT))
    for part, array in (("vertices", vertices), ("joints", joints), ("UV", template.face_uv)):
        if not np.isfinite(array).all():
            raise InputError(f"{name}, {part}", wanted="finite numbers", came="NaN or infinity")
    if faces.size == 0 or faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{name}, faces", wanted=f"vertex numbers 0..{len(vertices) - 1}", came="others")
    if not 0 < template.skin_face_count <= len(faces):
        raise InputError(f"{name}, skin faces", wanted=f"1..{len(faces)}", came=str(template.skin_face_count))
    if template.face_uv.min() < 0 or template.face_uv.max() > 1:
        raise InputError(f"{name}, UV", wanted="coordinates 0..1", came="others")
    if not is_closed(faces):
        raise InputError(
            f"{name}, faces", wanted="a closed surface, all faces turned alike", came="an open or torn one"
        )
    if enclosed_volume(vertices, faces) <= 0:
        raise InputError(
            f"{name}, faces", wanted="corners counter-clockwise from outside", came="an inside-out surface"
        )
    check_weight_rows(template.bone_weights, f"{name}, weights")
    check_hand_size(joints)
    check_order(joints)
    return template


def expect_shape(name: str, array: np.ndarray, shape: tuple[int | None, ...]) -> None:
    """Raises InputError unless `array` has `shape`, where None stands for any number."""
    if array.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise InputError(name, wanted=f"shape ({wanted})", came=str(array.shape))
