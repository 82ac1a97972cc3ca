"""How a detail lies in a file: arrays whose names begin with `detail.`, and the JSON that says their shapes.

| array        | exact        | compact               | price of compact, at most                     |
| ------------ | ------------ | --------------------- | --------------------------------------------- |
| position_m   | float32      | uint16 over their box | half a step: 1.5 µm for a box of 0.2 m        |
| bone_weights | float32 x 21 | the 7 largest, uint16 | as of Gaussians                               |
| face_uv      | float32      | uint16                | 1/131070: a thirtieth of a texel of 4096      |
| faces        | uint16       | uint16                | nothing                                       |
| texture      | deflated     | deflated              | nothing                                       |
| relief       | deflated     | deflated              | nothing                                       |
| direction    | deflated     | deflated              | nothing                                       |
| scale_m      | float32      | float32               | nothing                                       |

The texture is deflated as differences: red and blue as what they have more than green, then each row as what it has
more than the one above, modulo 256. Skin varies in all three together and little from row to row; unlike a PNG's best
predictors, these are undone by numpy alone, which is all that Blender has. So is the relief, which may be missing: its
heights where joints are bent as what they have more than where they are straight. Direction and scale are those of
`DetailCorrectives`, which may be missing too.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from jghand_engine.avatar.detail import Detail
from jghand_engine.avatar.detail_correctives import NUMBERS, DetailCorrectives
from jghand_engine.avatar.relief import Relief
from jghand_engine.avatar.storage import (
    STORED_WEIGHTS,
    UINT16_MAX,
    Storage,
    all_weights,
    from_grid,
    largest_weights,
    on_grid,
)
from jghand_engine.avatar.validation import (
    DETAIL_DEPTH_MAX_M,
    DETAIL_FACES_MAX,
    DETAIL_SIZE_MAX,
    DETAIL_SIZE_MIN,
    DETAIL_VERTICES_MAX,
    REMEDY,
)
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.orders import LEVEL_OF_STANDARD, STANDARD_OF_LEVEL
from jghand_engine.json_files import JsonObject

PREFIX = "detail."
# a texture of noise does not get smaller by deflating; zlib then adds less than this part
DEFLATED_MAX = 1.001
# 9 takes twice as long for less than a hundredth
DEFLATE_LEVEL = 6
# what a detail need not have
_MAY_LACK = ("relief_bytes", "direction_bytes", "ends_hand")
# no hand's vertices are farther from the template's origin, meters
BOX_MAX_M = 10.0


@dataclass(frozen=True)
class DetailAbout:
    """What the JSON says. size: of the texture · texture_bytes: of the deflated one · box_m: of the vertices, low and
    high corner · relief_bytes: as of the texture, 0 of no relief · direction_bytes: of the correctives, 0 of
    none · ends_hand: as of Detail"""

    vertices: int
    faces: int
    size: int
    texture_bytes: int
    depth_m: float
    box_m: list[list[float]]
    relief_bytes: int = 0
    direction_bytes: int = 0
    ends_hand: bool = False

    def as_dict(self) -> dict[str, Any]:
        """For JSON; of a detail that has none of what it need not have as it was before there was any."""
        return {name: value for name, value in asdict(self).items() if value or name not in _MAY_LACK}

    @classmethod
    def parsed(cls, of: JsonObject) -> DetailAbout:
        """The inverse of `as_dict`, every field looked at."""
        size, box_m = of.count("size", DETAIL_SIZE_MIN, DETAIL_SIZE_MAX), of.array("box_m", (2, 3))
        if not (np.abs(box_m) <= BOX_MAX_M).all():
            raise of.wrong("box_m", f"two corners within {BOX_MAX_M} m")
        about = cls(
            of.count("vertices", 3, DETAIL_VERTICES_MAX),
            of.count("faces", 1, DETAIL_FACES_MAX),
            size,
            of.count("texture_bytes", 1, _deflated_max(3, size**2)),
            of.number("depth_m", 0, DETAIL_DEPTH_MAX_M),
            box_m.tolist(),
        )
        most = {
            "relief_bytes": _deflated_max(2, size**2),
            "direction_bytes": _deflated_max(3 * NUMBERS, about.vertices),
        }
        sizes = {name: of.count(name, 1, limit) for name, limit in most.items() if name in of.fields}
        return replace(about, **sizes, ends_hand=of.flag("ends_hand", False))


def _deflated_max(channels: int, places: int) -> int:
    return int(DEFLATED_MAX * channels * places) + 64


def expected_detail_arrays(about: DetailAbout, storage: Storage) -> dict[str, tuple[str, tuple]]:
    """Name -> (safetensors dtype, shape)."""
    exact = storage is Storage.EXACT
    arrays: dict[str, tuple[str, tuple]] = {
        "faces": ("U16", (about.faces, 3)),
        "face_uv": ("F32" if exact else "U16", (about.faces, 3, 2)),
        "texture": ("U8", (about.texture_bytes,)),
    }
    if about.relief_bytes:
        arrays["relief"] = ("U8", (about.relief_bytes,))
    if about.direction_bytes:
        arrays |= {"direction": ("U8", (about.direction_bytes,)), "scale_m": ("F32", (about.vertices,))}
    if exact:
        arrays |= {"position_m": ("F32", (about.vertices, 3)), "bone_weights": ("F32", (about.vertices, JOINT_COUNT))}
    else:
        arrays["position"], shape = ("U16", (about.vertices, 3)), (about.vertices, STORED_WEIGHTS)
        arrays |= {"weight": ("U16", shape), "weight_bone": ("U8", shape)}
    return {PREFIX + name: kind for name, kind in arrays.items()}


def pack_detail(detail: Detail, storage: Storage) -> tuple[dict[str, np.ndarray], DetailAbout]:
    """Arrays as they stand in a file, and what is said of them."""
    if detail.whole is not None:
        remedy = "Save the avatar before `ended`, which lays it on an avatar that is to be seen."
        raise InputError(
            "detail of an avatar", wanted="one of the whole hand", came="one that fades away", remedy=remedy
        )
    position_m, weights = detail.position_m.astype(np.float32), detail.bone_weights[:, LEVEL_OF_STANDARD]
    box_m = [position_m.min(0).tolist(), position_m.max(0).tolist()]
    packed = {"faces": detail.faces.astype(np.uint16), "texture": _deflated(differences(detail.texture))}
    if storage is Storage.EXACT:
        packed |= {"position_m": position_m, "bone_weights": weights.astype(np.float32)}
        packed["face_uv"] = detail.face_uv.astype(np.float32)
    else:
        packed["position"] = on_grid(position_m, box_m)
        packed["weight_bone"], packed["weight"] = largest_weights(weights)
        packed["face_uv"] = np.rint(detail.face_uv * np.float64(UINT16_MAX)).astype(np.uint16)
    about = DetailAbout(
        len(position_m), len(detail.faces), detail.size, len(packed["texture"]), float(detail.depth_m), box_m,
        ends_hand=detail.ends_hand,
    )  # fmt: skip
    if detail.relief is not None:
        packed["relief"] = _deflated(height_differences(detail.relief.height))
        about = replace(about, relief_bytes=len(packed["relief"]))
    if detail.correctives is not None:
        # neighbors, which go the same way, lie together
        packed["direction"] = _deflated(np.moveaxis(detail.correctives.direction, 0, -1))
        packed["scale_m"] = detail.correctives.scale_m
        about = replace(about, direction_bytes=len(packed["direction"]))
    return {PREFIX + name: np.ascontiguousarray(array) for name, array in packed.items()}, about


def unpack_detail(packed: dict[str, np.ndarray], about: DetailAbout, thing: str) -> Detail:
    """The inverse of `pack_detail`. InputError naming `thing` for a texture of another size."""
    own = {name.removeprefix(PREFIX): array for name, array in packed.items() if name.startswith(PREFIX)}
    if "position_m" in own:
        position_m, face_uv = own["position_m"], own["face_uv"]
        weights = own["bone_weights"][:, STANDARD_OF_LEVEL]
    else:
        if int(own["weight_bone"].max()) >= JOINT_COUNT:
            came = str(int(own["weight_bone"].max()))
            raise InputError(
                f"{thing}: detail weight_bone", wanted=f"bones 0 to {JOINT_COUNT - 1}", came=came, remedy=REMEDY
            )
        position_m, face_uv = from_grid(own["position"], about.box_m), own["face_uv"] / np.float32(UINT16_MAX)
        weights = all_weights(own["weight"], own["weight_bone"])
    return Detail(
        position_m=np.ascontiguousarray(position_m, np.float32),
        bone_weights=np.ascontiguousarray(weights, np.float32),
        faces=np.ascontiguousarray(own["faces"], np.int32),
        face_uv=np.ascontiguousarray(face_uv, np.float32),
        texture=_colors(_inflated(own["texture"], (3, about.size, about.size), f"{thing}: texture of the detail")),
        depth_m=about.depth_m,
        relief=_relief(own["relief"], about.size, thing) if about.relief_bytes else None,
        correctives=_correctives(own, about.vertices, thing) if about.direction_bytes else None,
        ends_hand=about.ends_hand,
    )


def differences(texture: np.ndarray) -> np.ndarray:
    """(3, S, S) bytes of (S, S, 3), channel by channel: what is alike lies together."""
    shades = texture.copy()
    shades[..., ::2] -= texture[..., 1:2]
    shades[1:] -= shades[:-1].copy()
    return np.moveaxis(shades, -1, 0)


def _colors(shades: np.ndarray) -> np.ndarray:
    """The inverse of `differences`."""
    texture = np.moveaxis(np.add.accumulate(shades, axis=1, dtype=np.uint8), 0, -1).copy()
    texture[..., ::2] += texture[..., 1:2]
    return texture


def height_differences(height: np.ndarray) -> np.ndarray:
    """(2, S, S) bytes of (S, S, 2) heights."""
    steps = np.moveaxis(height, -1, 0).astype(np.uint8)
    steps[1] -= steps[0]
    steps[:, 1:] -= steps[:, :-1].copy()
    return steps


def _relief(deflated: np.ndarray, size: int, thing: str) -> Relief:
    steps = np.add.accumulate(_inflated(deflated, (2, size, size), f"{thing}: relief"), axis=1, dtype=np.uint8)
    steps[1] += steps[0]
    return Relief(np.ascontiguousarray(np.moveaxis(steps, 0, -1)).view(np.int8))


def _correctives(own: dict[str, np.ndarray], vertices: int, thing: str) -> DetailCorrectives:
    steps = _inflated(own["direction"], (NUMBERS, 3, vertices), f"{thing}: direction of the detail's correctives")
    return DetailCorrectives(np.ascontiguousarray(np.moveaxis(steps, -1, 0)).view(np.int8), own["scale_m"])


def _deflated(content: np.ndarray) -> np.ndarray:
    return np.frombuffer(zlib.compress(content.tobytes(), DEFLATE_LEVEL), np.uint8)


def _inflated(deflated: np.ndarray, shape: tuple[int, int, int], what: str) -> np.ndarray:
    """Bytes of a shape. InputError naming `what` for others."""
    wanted, came = math.prod(shape), "damaged"
    unpacker = zlib.decompressobj()
    try:
        # one byte more than there should be shows a larger one, and no more is unpacked of it
        content = unpacker.decompress(deflated.tobytes(), wanted + 1)
        came = f"{len(content)} or more bytes"
    except zlib.error:
        content = b""
    if len(content) != wanted or not unpacker.eof:
        raise InputError(what, wanted=f"{wanted} bytes", came=came, remedy=REMEDY)
    return np.frombuffer(content, np.uint8).reshape(shape)
