"""What is in a splat file, ours or anybody's: PLY, .splat, GLB with KHR_gaussian_splatting, SPZ 3.

Of the harmonics only degree 0 is read. What can be read and is yet suspicious is listed.
"""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.export.splats import spz
from jghand_engine.export.splats.cloud import SH_C0, SplatCloud
from jghand_engine.export.splats.gltf import EXTENSION, MAGIC
from jghand_engine.export.splats.ply import SPLAT_ROW

# what parsing raises of files that lie; UnicodeDecodeError and JSONDecodeError are ValueErrors
_DAMAGE = (ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError, RecursionError, struct.error,
           zlib.error)  # fmt: skip
# times that an SPZ file may grow when it is unpacked: hands grow to 1.8 times their size, a bomb of zeros to 1000
SPZ_RATIO_MAX = 16
# a median size, and a distance between Gaussians, above which nobody meant meters
SIGMA_SANE_M, SIZE_SANE_M = 1.0, 1000.0
_PLY_TYPES = {"float": "<f4", "float32": "<f4", "double": "<f8", "uchar": "u1", "uint8": "u1", "int": "<i4"}


def read_splats(path: Path | str) -> SplatCloud:
    """The Gaussians of a file; axes "" where it does not say. InputError, which names it, for one that is damaged, and
    for numbers that are not finite."""
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path}", wanted=f"a splat file ({', '.join(_READERS)})", came=path.suffix or "no suffix")
    try:
        cloud = reader(path.read_bytes())
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}", remedy="Check the name.") from error
    except _DAMAGE as error:
        raise InputError(
            f"{path}", wanted=f"a whole {path.suffix[1:].lower()} file of Gaussians", came=str(error)[:200],
            remedy="Write the file again with the program that it came from.",
        ) from error  # fmt: skip
    for name in ("positions_m", "scales_m", "rotations_wxyz", "opacity", "rgb"):
        if not np.isfinite(getattr(cloud, name)).all():
            raise InputError(f"{path}, {name}", wanted="finite numbers", came="NaN or infinity")
    return cloud


def splat_findings(cloud: SplatCloud) -> Iterator[str]:
    if not len(cloud):
        yield "there are no Gaussians"
        return
    reach_m = float(np.ptp(cloud.positions_m.astype(np.float64), axis=0).max())
    if reach_m > SIZE_SANE_M:
        yield f"the Gaussians reach over {reach_m:.2g} m: some are probably damaged, or the unit is not the meter"
    if cloud.scales_m.min() <= 0:
        yield "sizes are not all above 0: they are probably logarithms where meters are wanted"
    elif np.median(cloud.scales_m) > SIGMA_SANE_M:
        yield "half of the Gaussians are wider than a meter: sizes are probably linear where logarithms are wanted"
    if cloud.opacity.min() < 0 or cloud.opacity.max() > 1:
        yield "opacities are not all from 0 to 1: they are probably logits"
    if (np.linalg.norm(cloud.rotations_wxyz, axis=1) < 1e-6).any():
        yield "some rotations have no length: readers drop those Gaussians or draw nothing"


def _ply(content: bytes) -> SplatCloud:
    found = re.match(rb"ply\r?\n(?s:.*?)\nend_header\r?\n", content[:65_536])
    if not found:
        raise ValueError("no PLY header")
    lines = [line.split() for line in found[0].decode("ascii").splitlines()]
    (element, count), *others = [words[1:] for words in lines if words[:1] == ["element"]]
    if ["format", "binary_little_endian", "1.0"] not in lines or element != "vertex" or others:
        raise ValueError("another layout than vertices alone in binary_little_endian 1.0")
    row = np.dtype([(words[2], _PLY_TYPES[words[1]]) for words in lines if words[:1] == ["property"]])
    if len(content) != found.end() + int(count) * row.itemsize:
        raise ValueError("not as many bytes as its header says")
    table = np.frombuffer(content, row, int(count), found.end())

    def columns(*names: str) -> np.ndarray:
        return np.stack([table[name].astype(np.float32) for name in names], -1)

    axes = re.search(rb"^comment JGHand .*axes=(rdf|rub)\b", found[0], re.MULTILINE)
    with np.errstate(over="ignore"):
        return SplatCloud(
            columns("x", "y", "z"),
            np.exp(columns("scale_0", "scale_1", "scale_2")),
            columns("rot_0", "rot_1", "rot_2", "rot_3"),
            1 / (1 + np.exp(-columns("opacity")[:, 0])),
            columns("f_dc_0", "f_dc_1", "f_dc_2") * np.float32(SH_C0) + np.float32(0.5),
            axes[1].decode() if axes else "",
        )


def _dot_splat(content: bytes) -> SplatCloud:
    if not content:
        raise ValueError("an empty file")
    table = np.frombuffer(content, SPLAT_ROW)
    rgba = table["rgba"] / np.float32(255)
    turns = (table["rotation"].astype(np.float32) - 128) / 128
    return SplatCloud(table["position"], table["scale"], turns, rgba[:, 3], rgba[:, :3], "")


def _glb(content: bytes) -> SplatCloud:
    magic, version, size, text_size = struct.unpack_from("<4sIII", content)
    if magic != MAGIC or version != 2 or size != len(content):
        raise ValueError("another header than that of a binary glTF 2")
    about = json.loads(content[20 : 20 + text_size])
    meshes = [one for mesh in about["meshes"] for one in mesh["primitives"] if EXTENSION in one.get("extensions", {})]
    if len(meshes) != 1:
        raise ValueError(f"{len(meshes)} primitives with {EXTENSION}")
    binary, attributes = content[28 + text_size :], meshes[0]["attributes"]
    names = ("POSITION", *(f"{EXTENSION}:{name}" for name in ("SCALE", "ROTATION", "OPACITY", "SH_DEGREE_0_COEF_0")))
    position, scale, turn, opacity, harmonics = (_gltf_rows(about, attributes[name], binary) for name in names)
    rgb = harmonics * np.float32(SH_C0) + np.float32(0.5)
    return SplatCloud(position, scale, turn[:, [3, 0, 1, 2]], opacity[:, 0], rgb, "rub")


def _gltf_rows(about: dict[str, Any], index: int, binary: bytes) -> np.ndarray:
    """(N, width) float32 of an accessor, in the file's own buffer."""
    accessor = about["accessors"][index]
    view = about["bufferViews"][accessor["bufferView"]]
    if view["buffer"] != 0 or "uri" in about["buffers"][0] or accessor["componentType"] != 5126:
        raise ValueError("numbers in another file, or that are no floats")
    shape = accessor["count"], {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return np.ndarray(shape, "<f4", binary, start, (view.get("byteStride", 4 * shape[1]), 4)).copy()


def _spz(content: bytes) -> SplatCloud:
    unpacker = zlib.decompressobj(16 + zlib.MAX_WBITS)
    data = unpacker.decompress(content, SPZ_RATIO_MAX * len(content))
    if not unpacker.eof or unpacker.unused_data:
        raise ValueError("a file that is cut off or too long, or unpacks to more than hands do")
    magic, version, count, _degree, bits, *_ = struct.unpack_from("<IIIBBBB", data)
    if magic != spz.MAGIC or version != spz.VERSION or bits > spz.POSITION_BITS:
        raise ValueError(f"a header of version {version}")
    tables, start = [], 16
    for width in (9, 1, 3, 3, 4):
        tables.append(np.frombuffer(data, np.uint8, count * width, start).reshape(count, width))
        start += count * width
    positions, alphas, colors, sizes, turns = tables
    whole = np.zeros((count, 3, 4), np.uint8)
    whole[..., 1:] = positions.reshape(-1, 3, 3)
    harmonics = (colors / np.float32(255) - np.float32(0.5)) / np.float32(spz.COLOR_SCALE)
    return SplatCloud(
        (whole.view("<i4")[..., 0] >> 8) / np.float32(2**bits),
        np.exp(sizes / np.float32(spz.STEPS_PER_LN) + np.float32(spz.LN_SIGMA_MIN)),
        spz.unpacked_smallest_three(np.ascontiguousarray(turns)),
        alphas[:, 0] / np.float32(255),
        harmonics * np.float32(SH_C0) + np.float32(0.5),
        "rub",
    )


_READERS: dict[str, Callable[[bytes], SplatCloud]] = {
    ".ply": _ply, ".splat": _dot_splat, ".glb": _glb, ".spz": _spz,
}  # fmt: skip
