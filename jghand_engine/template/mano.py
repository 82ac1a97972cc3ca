"""MANO, when the user brings the file: MANO_RIGHT.pkl or MANO_LEFT.pkl to a template.

MANO may not be passed on, so JGHand ships nothing of it. Its files are pickles with objects of chumpy and scipy; they
are read as data (`pickle_records`), so that a file of unknown origin cannot run anything, and neither chumpy nor the
module pickle is needed. Formats and numbers: DATA 3, METHOD 2.7.
"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.files import writing
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.limits import MANO_WEIGHT_SUM_TOLERANCE, PICKLE_BYTES_MAX
from jghand_engine.template.archives import read_arrays
from jghand_engine.template.checks import check_template, expect_shape
from jghand_engine.template.layout import obj_uv, projected_uv, room_for_disk
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.pickle_arrays import ALLOWED, to_array
from jghand_engine.template.pickle_records import read_pickle
from jghand_engine.template.surface import boundary_loop, disk_uv, fan_faces, unit
from jghand_engine.template.weights import bone_weights, columns_to_level

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
# parents of MANO's joints: wrist, index 1-3, middle 1-3, pinky 1-3, ring 1-3, thumb 1-3
PARENTS = (-1, *(parent for finger in range(5) for parent in (0, 1 + 3 * finger, 2 + 3 * finger)))


class TipVertices(StrEnum):
    """Whose choice of the five vertices that serve as finger tips. It moves tips by millimeters: store it with data."""

    MANOPTH = "manopth"
    SMPLX = "smplx"


# thumb, index, middle, ring, pinky
TIP_VERTICES = {
    (TipVertices.MANOPTH, Handedness.RIGHT): (745, 317, 444, 556, 673),
    (TipVertices.MANOPTH, Handedness.LEFT): (745, 317, 445, 556, 673),
    (TipVertices.SMPLX, Handedness.RIGHT): (744, 320, 443, 554, 671),
    (TipVertices.SMPLX, Handedness.LEFT): (744, 320, 443, 554, 671),
}


class ManoPose(StrEnum):
    """The pose in which MANO becomes the canonical hand."""

    MEAN = "mean"
    FLAT = "flat"


def load_mano(
    path: Path | str,
    *,
    handedness: Handedness,
    tips: TipVertices = TipVertices.MANOPTH,
    pose: ManoPose = ManoPose.MEAN,
    uv_path: Path | str | None = None,
) -> HandTemplate:
    """The user's own MANO file as a template: a right hand of mean shape in the canonical frame, closed at the wrist.

    handedness says which hand the file holds; a left one is mirrored, since one right-hand model serves both. uv_path
    is the .obj file of MANO's texture layout from its download page (MANO_UV_right.obj). Without it a simple projection
    is used (see `layout.projected_uv`): good for experiments, with squeezed finger sides and a seam around the hand.
    Raises InputError for a file that is not MANO's, or that asks for anything but arrays: such a file runs nothing.
    """
    handedness, tips, pose = Handedness(handedness), TipVertices(tips), ManoPose(pose)
    fields = read_mano(path)
    # what is left of rounding in a row would shrink the posed skin
    fields["weights"] = fields["weights"] / fields["weights"].sum(axis=1, keepdims=True)
    faces, mirror = fields["f"], np.ones(3)
    if handedness is Handedness.LEFT:
        faces, mirror = faces[:, ::-1], np.array([-1.0, 1.0, 1.0])
    tip_vertices = list(TIP_VERTICES[tips, handedness])
    posed = {}
    for which, rotation in ((ManoPose.FLAT, np.zeros((JOINTS, 3))), (ManoPose.MEAN, mean_pose(fields))):
        points, centers = _posed(fields, rotation)
        frame = _canonical(np.concatenate([centers, points[tip_vertices]]) * mirror)
        posed[which] = _move(points * mirror, frame)
    _check_side(posed[ManoPose.MEAN][1], path)
    flat_m, _ = posed[ManoPose.FLAT]
    vertices_m, joints_m = posed[pose]

    skin_uv = projected_uv(flat_m, faces) if uv_path is None else obj_uv(uv_path, faces)
    loop = boundary_loop(faces)
    cap_uv = disk_uv(len(loop), *room_for_disk(skin_uv))
    weights = np.concatenate([fields["weights"], np.zeros((VERTICES, 5))], axis=1)
    weights = np.concatenate([weights, np.eye(JOINTS + 5)[:1]])
    vertices_m = np.concatenate([vertices_m, vertices_m[loop].mean(axis=0, keepdims=True)])
    return check_template(
        HandTemplate(
            identifier=f"mano-{handedness}-{pose}-{tips}-{'projected' if uv_path is None else 'obj'}",
            vertices_m=vertices_m,
            faces=np.concatenate([faces, fan_faces(loop, VERTICES)]),
            face_uv=np.concatenate([skin_uv, cap_uv]),
            skin_face_count=FACES,
            joints_m=joints_m,
            bone_weights=bone_weights(columns_to_level(weights, JointOrder.MANO16_TIPS), vertices_m, joints_m),
        )
    )


def read_mano(path: Path | str) -> dict[str, np.ndarray]:
    """MANO's arrays by name, as in FIELDS: from its pickle, or from the .npz that `convert_mano` wrote."""
    path = Path(path)
    thing = f"MANO file {path}"
    if path.suffix.lower() == ".npz":
        fields = read_arrays(path, FIELDS, thing)
    else:
        whole = read_pickle(_read_bytes(path, thing), ALLOWED, thing)
        if not isinstance(whole, dict):
            raise InputError(thing, wanted="MANO's dictionary of arrays", came=f"a {type(whole).__name__}")
        missing = [name for name in FIELDS if name not in whole]
        if missing:
            raise InputError(thing, wanted=f"MANO's fields {', '.join(missing)}", came="a file without them")
        fields = {name: to_array(whole[name], f"{thing}, {name}", shape) for name, shape in FIELDS.items()}
    for name, shape in FIELDS.items():
        expect_shape(f"{thing}, {name}", fields[name], shape)
        if fields[name].dtype.kind not in "iuf" or not np.isfinite(fields[name]).all():
            raise InputError(f"{thing}, {name}", wanted="finite numbers", came="others")
        fields[name] = fields[name].astype(np.int64 if name in ("f", "kintree_table") else np.float64)
    if fields["f"].min() < 0 or fields["f"].max() >= VERTICES:
        raise InputError(f"{thing}, f", wanted=f"vertex numbers 0..{VERTICES - 1}", came="others")
    if tuple(fields["kintree_table"][0, 1:]) != PARENTS[1:]:
        raise InputError(f"{thing}, kintree_table", wanted="MANO's tree of joints", came="another")
    if fields["weights"].min() < 0:
        raise InputError(f"{thing}, weights", wanted="weights of at least 0", came="others")
    off = np.abs(fields["weights"].sum(axis=1) - 1).max()
    if off > MANO_WEIGHT_SUM_TOLERANCE:
        raise InputError(f"{thing}, weights", wanted="rows that sum to 1", came=f"a row that is off by {off:.2g}")
    return fields


def convert_mano(source: Path | str, target: Path | str) -> None:
    """Writes MANO's arrays as a plain .npz, which `load_mano` reads too. For the user's own use: MANO's license forbids
    to pass the result on. Raises InputError for another suffix: `read_mano` would take the file for a pickle."""
    if Path(target).suffix.lower() != ".npz":
        raise InputError(f"converted MANO file {target}", wanted="a name that ends in .npz", came="another")
    fields = read_mano(source)
    # given a name, numpy appends .npz to what does not end so exactly
    with writing(target) as path, open(path, "wb") as stream:
        np.savez_compressed(stream, **fields)  # pyright: ignore[reportArgumentType]


def mean_pose(fields: dict[str, np.ndarray]) -> np.ndarray:
    """(16, 3) axis-angle rotations of MANO's mean hand; the wrist's is 0."""
    return np.concatenate([np.zeros((1, 3)), fields["hands_mean"].reshape(-1, 3)])


def _posed(fields: dict[str, np.ndarray], pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (778, 3) and joints (16, 3) of the mean shape in `pose` (16, 3) axis-angle, by MANO's skinning."""
    rotation = rotations(pose)
    rest_joints = fields["J_regressor"] @ fields["v_template"]
    vertices = fields["v_template"] + fields["posedirs"] @ (rotation[1:] - np.eye(3)).ravel()
    world, joints = rotation.copy(), rest_joints.copy()
    for joint, parent in enumerate(PARENTS[1:], start=1):
        joints[joint] = joints[parent] + world[parent] @ (rest_joints[joint] - rest_joints[parent])
        world[joint] = world[parent] @ rotation[joint]
    offset = joints - np.einsum("jab,jb->ja", world, rest_joints)
    blended = np.einsum("vj,jab->vab", fields["weights"], world)
    return np.einsum("vab,vb->va", blended, vertices) + fields["weights"] @ offset, joints


def rotations(axis_angle: np.ndarray) -> np.ndarray:
    """(n, 3) axis-angle vectors to (n, 3, 3) rotation matrices (Rodrigues)."""
    angle = np.linalg.norm(axis_angle, axis=1)
    x, y, z = unit(axis_angle).T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    sine, versine = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
    return np.eye(3) + sine * cross + versine * (cross @ cross)


def _canonical(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, 3) as rows of the canonical frame, and all joints (21, 3) in MANO's order in the file's frame."""
    level = to_level(joints, JointOrder.MANO16_TIPS)
    y = unit(level[3] - level[0])
    x = level[2] - level[5]
    x = unit(x - y * (x @ y))
    return np.stack([x, y, np.cross(x, y)]), level


def _move(points: np.ndarray, frame: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Points and joints in the canonical frame: +y wrist to middle MCP, +x to the index side, +z out of the palm."""
    axes, joints = frame
    return (points - joints[0]) @ axes.T, (joints - joints[0]) @ axes.T


def _check_side(joints_m: np.ndarray, path: Path | str) -> None:
    """In the mean pose the fingers bend towards the palm: that tells a left hand from a right one. A flat hand does
    not, so it is the mean pose's joints that are looked at, whichever pose is wanted."""
    if (joints_m[17:21, 2] - joints_m[2:6, 2]).mean() < 0:
        raise InputError(
            f"MANO file {path}",
            wanted="fingers that bend towards the palm",
            came="fingers that bend backwards",
            remedy="Is it the file of the other hand?",
        )


def _read_bytes(path: Path, thing: str) -> bytes:
    try:
        if path.stat().st_size > PICKLE_BYTES_MAX:
            raise InputError(thing, wanted=f"at most {PICKLE_BYTES_MAX} bytes", came=f"{path.stat().st_size}")
        return path.read_bytes()
    except OSError as error:
        raise InputError(thing, wanted="a file that can be read", came=str(error)) from error
