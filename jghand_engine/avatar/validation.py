"""Refusing avatars that cannot be rendered: every value of every array is looked at."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping

import numpy as np

from jghand_engine.avatar.avatar import SIGMA_MAX_M, SIGMA_MIN_M, HandAvatar
from jghand_engine.avatar.detail import Detail
from jghand_engine.avatar.detail_correctives import NUMBERS
from jghand_engine.avatar.learned import ANCHOR_NEIGHBORS, AVATAR_REACH_M, Learned
from jghand_engine.avatar.scene_light import CELLS
from jghand_engine.errors import InputError
from jghand_engine.hand.canonical import CanonicalHand
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.orders import check_hand_size, check_order
from jghand_engine.hand.skeleton import Swing, scale_exponent

# more Gaussians are refused before anything is allocated
AVATAR_MAX_GAUSSIANS = 1_000_000
# characters of one text in an avatar's description (name, template, license, an angle's name): they are shown in a line
AVATAR_TEXT_MAX = 500
# lobes of the gloss, and gain of the shadow: beyond these nothing was learned from pictures
LIGHT_LOBES_MAX = 64
SHADOW_GAIN_MAX = 100.0
# of a detail: vertices, which two bytes number, faces, texels along a side, and how deep the Gaussians may lie, meters
DETAIL_VERTICES_MAX, DETAIL_FACES_MAX, DETAIL_DEPTH_MAX_M = 65_536, 131_072, 0.01
DETAIL_SIZE_MIN, DETAIL_SIZE_MAX = 4, 4096
# by how much shares and weights of an anchor, of 8 and 16 bits, may sum to something else than 1
CAST_SUM_TOLERANCE = 5e-3
# a row of bone weights, of a template or an avatar, that is further from 1 than this was not meant as weights: float32
# rounding of 21 summands leaves less than 1e-6
WEIGHT_SUM_TOLERANCE = 1e-5

# by the name of an array: it, the shape it should have, and the least and the greatest of its numbers
Ranges = dict[str, tuple[np.ndarray, tuple[int, ...], float, float]]

REMEDY = "The avatar is damaged or was made by another program: export or download it again."


def check_avatar(avatar: HandAvatar, thing: str) -> None:
    """InputError naming `thing`, the array and the first offending Gaussian if the avatar cannot be rendered."""
    _check_shapes(avatar, thing)
    _check_joints(avatar, thing)
    for name in ("position_m", "sigma_m", "opacity", "rgb", "bone_weights", "uvd"):
        _refuse(thing, name, "finite values", ~np.isfinite(getattr(avatar, name)), getattr(avatar, name))
    sigma_m = avatar.sigma_m
    # a float16 on disk may lie half a step outside the limits
    outside = (sigma_m < SIGMA_MIN_M * (1 - 1e-3)) | (sigma_m > SIGMA_MAX_M * (1 + 1e-3))
    _refuse(thing, "sigma_m", f"radii of {SIGMA_MIN_M} to {SIGMA_MAX_M} m", outside, sigma_m)
    far = np.abs(avatar.position_m - avatar.canonical_joints_m[0]) > AVATAR_REACH_M
    _refuse(thing, "position_m", f"points within {AVATAR_REACH_M} m of the wrist", far, avatar.position_m)
    for name in ("opacity", "rgb", "uvd", "bone_weights"):
        values = getattr(avatar, name)
        _refuse(thing, name, "values of 0 to 1", (values < 0) | (values > 1), values)
    total = avatar.bone_weights.sum(1, dtype=np.float64)
    off = np.abs(total - 1) > WEIGHT_SUM_TOLERANCE
    _refuse(thing, "bone_weights", f"rows that sum to 1 within {WEIGHT_SUM_TOLERANCE}", off, total)
    if avatar.learned is not None:
        _check_learned(avatar.learned, len(avatar), avatar.canonical_joints_m[0], thing)
    if avatar.detail is not None:
        _check_detail(avatar.detail, avatar.canonical_joints_m[0], thing)


def _check_detail(detail: Detail, wrist_m: np.ndarray, thing: str) -> None:
    vertices, faces, side = len(detail.position_m), len(detail.faces), detail.size
    counts = {
        "vertices": (3 <= vertices <= DETAIL_VERTICES_MAX, f"3 to {DETAIL_VERTICES_MAX}", vertices),
        "faces": (1 <= faces <= DETAIL_FACES_MAX, f"1 to {DETAIL_FACES_MAX}", faces),
        "texture": (
            DETAIL_SIZE_MIN <= side <= DETAIL_SIZE_MAX and side & (side - 1) == 0 and detail.texture.dtype == np.uint8,
            f"bytes, a power of two of {DETAIL_SIZE_MIN} to {DETAIL_SIZE_MAX} along each side",
            f"{detail.texture.dtype} of {side}",
        ),
        "depth_m": (0 <= detail.depth_m <= DETAIL_DEPTH_MAX_M, f"0 to {DETAIL_DEPTH_MAX_M} m", detail.depth_m),
    }
    for name, (good, wanted, came) in counts.items():
        if not good:
            raise InputError(f"{thing}: {name} of the detail", wanted=wanted, came=str(came), remedy=REMEDY)
    _check_ranges(
        thing,
        {
            "detail position_m": (detail.position_m - wrist_m, (vertices, 3), -AVATAR_REACH_M, AVATAR_REACH_M),
            "detail bone_weights": (detail.bone_weights, (vertices, JOINT_COUNT), 0.0, 1.0),
            "detail faces": (detail.faces, (faces, 3), 0, vertices - 1),
            "detail face_uv": (detail.face_uv, (faces, 3, 2), 0.0, 1.0),
            "detail texture": (detail.texture, (side, side, 3), 0, 255),
        },
    )
    of_bytes: dict[str, tuple[np.ndarray, tuple[int, ...]]] = {}
    if detail.relief is not None:
        of_bytes["relief"] = (detail.relief.height, (side, side, 2))
    if detail.correctives is not None:
        of_bytes["direction"] = (detail.correctives.direction, (vertices, NUMBERS, 3))
        most_m = AVATAR_REACH_M / np.iinfo(np.int8).max
        _check_ranges(thing, {"detail scale_m": (detail.correctives.scale_m, (vertices,), 0.0, most_m)})
    for name, (values, shape) in of_bytes.items():
        if values.dtype != np.int8:
            raise InputError(f"{thing}: {name}", wanted="signed bytes", came=str(values.dtype), remedy=REMEDY)
        _check_ranges(thing, {f"detail {name}": (values, shape, -128, 127)})
    total = detail.bone_weights.sum(1, dtype=np.float64)
    off = np.abs(total - 1) > WEIGHT_SUM_TOLERANCE
    _refuse(thing, "detail bone_weights", f"rows that sum to 1 within {WEIGHT_SUM_TOLERANCE}", off, total, "vertex")


def _check_learned(learned: Learned, count: int, wrist_m: np.ndarray, thing: str) -> None:
    """What kernels rely on. Whether a light or a skin is a likely one is not asked; files hold finite numbers alone, of
    the shapes that they say."""
    if learned.response is not None and learned.response.film_light is not None:
        most = float(np.finfo(np.float32).max)
        _check_ranges(thing, {"film_light": (learned.response.film_light, (CELLS, 3), 0.0, most)})
    if learned.cast is None:
        return
    anchors = learned.cast.anchors
    ranges = {
        "cast nearest": (anchors.nearest, (count, ANCHOR_NEIGHBORS), 0, len(anchors) - 1),
        "cast position_m": (anchors.position_m - wrist_m, (len(anchors), 3), -AVATAR_REACH_M, AVATAR_REACH_M),
    }
    _check_ranges(thing, ranges)
    for name, rows in (("bone_weights", anchors.bone_weights), ("share", anchors.share)):
        total = rows.sum(1, dtype=np.float64)
        wanted = f"rows that sum to 1 within {CAST_SUM_TOLERANCE:g}"
        _refuse(thing, f"cast {name}", wanted, np.abs(total - 1) > CAST_SUM_TOLERANCE, total)


def check_finite(arrays: Mapping[str, np.ndarray], thing: str) -> None:
    """InputError naming the first array of a file that holds another number."""
    for name, array in arrays.items():
        if np.issubdtype(array.dtype, np.floating):
            flat = array.reshape(-1)
            _refuse(thing, name, "finite values", ~np.isfinite(flat), flat, of="number")


def _check_ranges(thing: str, ranges: Ranges) -> None:
    for name, (values, shape, low, high) in ranges.items():
        if tuple(values.shape) != shape:
            came = f"shape {tuple(values.shape)}"
            raise InputError(f"{thing}: {name}", wanted=f"shape {shape}", came=came, remedy=REMEDY)
        flat = values.reshape(-1)
        _refuse(thing, name, f"values of {low:g} to {high:g}", ~((flat >= low) & (flat <= high)), flat, of="number")


def _check_shapes(avatar: HandAvatar, thing: str) -> None:
    count = avatar.position_m.shape[0] if avatar.position_m.ndim else 0
    if not 1 <= count <= AVATAR_MAX_GAUSSIANS:
        raise InputError(
            f"{thing}: number of Gaussians", wanted=f"1 to {AVATAR_MAX_GAUSSIANS}", came=str(count), remedy=REMEDY
        )
    wanted = {
        "canonical_joints_m": (JOINT_COUNT, 3),
        "position_m": (count, 3),
        "sigma_m": (count,),
        "opacity": (count,),
        "rgb": (count, 3),
        "bone_weights": (count, JOINT_COUNT),
        "uvd": (count, 3),
    }
    for name, shape in wanted.items():
        came = tuple(getattr(avatar, name).shape)
        if came != shape:
            raise InputError(f"{thing}: {name}", wanted=f"shape {shape}", came=f"shape {came}", remedy=REMEDY)


def _check_joints(avatar: HandAvatar, thing: str) -> None:
    """A canonical hand that joints can drive: the same checks as of any other hand, and the transform is built once."""
    if not np.isfinite(avatar.canonical_joints_m).all():
        raise InputError(f"{thing}: canonical_joints_m", wanted="finite values", came="NaN or Inf", remedy=REMEDY)
    try:
        for joints_m in (avatar.canonical_joints_m, avatar.rest_joints_m):
            check_hand_size(joints_m)
            CanonicalHand.build(joints_m)
            check_order(joints_m)
        Swing(avatar.info.swing)
        scale_exponent(avatar.info.scale_mode)
    except InputError as error:
        raise InputError(
            f"{thing}: {error.thing}", wanted=error.wanted, came=error.came, remedy=error.remedy or REMEDY
        ) from error


def _refuse(thing: str, name: str, wanted: str, bad: np.ndarray, values: np.ndarray, of: str = "Gaussian") -> None:
    """InputError about the first row, which is called `of`, where `bad` (N,) or (N, C) holds."""
    if not bad.any():
        return
    first = np.argwhere(bad)[0]
    raise InputError(
        f"{thing}: {name}",
        wanted=wanted,
        came=f"{float(values[tuple(first)]):.6g} at {of} {int(first[0])} ({int(bad.sum())} such values)",
        remedy=REMEDY,
    )


def is_text(value: object) -> bool:
    """Whether `value` is a text that can be shown in a line and encoded: no control characters, no surrogates."""
    return (
        isinstance(value, str)
        and len(value) <= AVATAR_TEXT_MAX
        and not any(unicodedata.category(letter) in ("Cc", "Cs", "Zl", "Zp") for letter in value)
    )


def as_text(value: str) -> str:
    """`value` as `is_text` wants it: without what cannot be shown, and cut off."""
    return "".join(letter for letter in value if is_text(letter))[:AVATAR_TEXT_MAX]
