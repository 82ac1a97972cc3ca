"""Exported files as arrays by name, read with little code that is nobody else's, and how exactly each must agree.

Of many Gaussians, vertices or numbers every so-manieth is taken; of time, all frames.
"""

from __future__ import annotations

import base64
import gzip
import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd
from scipy.spatial.transform import Rotation

Arrays = dict[str, np.ndarray]
ROWS = 200
SH_C0 = 0.28209479177387814
# by the first word that a name contains: meters, one step of 8 bits, or one step of what a format rounds to
TOLERANCES = {
    "spz.ln_sigma": 1 / 16,
    "spz.turn": 2**0.5 / 511,
    "spz.rgb": SH_C0 / 0.15 / 255,
    "splat.turn": 1 / 128,
    "sphericalHarmonics": 1 / 255 / SH_C0,
    "display": 1 / 255,
    "pacit": 1 / 255,
    "rgb": 1 / 255,
    "look": 1 / 255,
    "poses_deg": 1e-3,
    # a Gaussian has about 0.7 mm
    "widths": 2e-6,
    "scales": 1e-6,
    "sigma_m": 1e-6,
    "covariance_mm2": 2e-3,
}
POSITION_M = 1e-5


def tolerance(name: str, golden: np.ndarray) -> np.ndarray | float:
    """Per number, how far it may be from the golden one; half precision may round to the next number."""
    # the hundredth more is for steps that are no round numbers of float32
    most = 1.01 * next((each for word, each in TOLERANCES.items() if word in name), POSITION_M)
    return np.maximum(most, np.spacing(np.abs(golden)).astype(float)) if golden.dtype == np.float16 else most


def thinned(array: np.ndarray, axis: int = 0) -> np.ndarray:
    step = max(1, array.shape[axis] // ROWS) if array.ndim else 1
    return array[(slice(None),) * axis + (slice(None, None, step),)] if step > 1 else array


def narrowed(array: np.ndarray) -> np.ndarray:
    """Without bits that no tolerance sees."""
    return array.astype(np.float32) if array.dtype == np.float64 else array


def upright(turns_wxyz: np.ndarray) -> np.ndarray:
    """The same turns with w not below 0."""
    return turns_wxyz * np.where(turns_wxyz[..., :1] < 0, -1, 1)


def covariance_mm2(sigma_m: np.ndarray, turns_wxyz: np.ndarray) -> np.ndarray:
    """(N, 3, 3), which unlike axes and turns has no order and no signs."""
    axes = 1e3 * sigma_m[:, None, :] * Rotation.from_quat(turns_wxyz[:, [1, 2, 3, 0]]).as_matrix()
    return axes @ axes.swapaxes(1, 2)


# ---- splat files ----------------------------------------------------------------------------------------------------


def ply(content: bytes) -> Arrays:
    header, _, body = content.partition(b"end_header\n")
    names = re.findall(rb"property float (\w+)", header)
    table = dict(
        zip((name.decode() for name in names), np.frombuffer(body, "<f4").reshape(-1, len(names)).T, strict=True)
    )

    def columns(*names: str) -> np.ndarray:
        return np.stack([table[name] for name in names], -1).astype(float)

    sigma_m = np.exp(columns("scale_0", "scale_1", "scale_2"))
    return {
        "header": np.array([line for line in header.decode().splitlines() if not line.startswith("comment")]),
        "position_m": columns("x", "y", "z"),
        "rgb": 0.5 + SH_C0 * columns("f_dc_0", "f_dc_1", "f_dc_2"),
        "opacity": 1 / (1 + np.exp(-columns("opacity"))),
        "covariance_mm2": covariance_mm2(sigma_m, columns("rot_0", "rot_1", "rot_2", "rot_3")),
    }


def glb(content: bytes) -> Arrays:
    size = struct.unpack_from("<I", content, 12)[0]
    about, binary = json.loads(content[20 : 20 + size]), content[28 + size :]
    primitive = about["meshes"][0]["primitives"][0]
    table = {}
    for name, index in primitive["attributes"].items():
        view = about["bufferViews"][about["accessors"][index]["bufferView"]]
        kind = {5126: "<f4", 5121: "u1"}[about["accessors"][index]["componentType"]]
        rows = np.frombuffer(
            binary, kind, offset=view["byteOffset"], count=view["byteLength"] // np.dtype(kind).itemsize
        )
        table[name.rpartition(":")[2]] = rows.reshape(about["accessors"][index]["count"], -1)
    return {
        "primitive": np.array(json.dumps(primitive, sort_keys=True)),
        "position_m": table["POSITION"],
        "rgb": 0.5 + SH_C0 * table["SH_DEGREE_0_COEF_0"],
        "opacity": table["OPACITY"],
        "display": table["COLOR_0"] / 255,
        "covariance_mm2": covariance_mm2(table["SCALE"], table["ROTATION"][:, [3, 0, 1, 2]]),
    }


def spz(content: bytes) -> Arrays:
    content = gzip.decompress(content)
    *about, bits, _flags, _ = struct.unpack_from("<IIIBBBB", content)
    count = about[2]
    rows = np.frombuffer(content, np.uint8, offset=16)
    position, opacity, rgb, scale, turn = np.split(rows, np.cumsum(np.array([9, 1, 3, 3]) * count))
    fixed = np.pad(position.reshape(-1, 3), ((0, 0), (1, 0))).view("<i4") >> 8
    fields = turn.view("<u4")[:, None] >> np.array([20, 10, 0], "<u4")
    others = np.where(fields & 512, -1, 1) * (fields & 511) / (511 * 2**0.5)
    return {
        "about": np.array([*about, bits]),
        "position_m": fixed.reshape(-1, 3) / 2.0**bits,
        "opacity": opacity / 255,
        "spz.rgb": 0.5 + SH_C0 * (rgb.reshape(-1, 3) / 255 - 0.5) / 0.15,
        "spz.ln_sigma": scale.reshape(-1, 3) / 16 - 10,
        "spz.turn": others,
        "spz.largest": turn.view("<u4") >> 30,
    }


def splat(content: bytes) -> Arrays:
    row = np.dtype([("position", "<f4", 3), ("sigma", "<f4", 3), ("rgba", "u1", 4), ("turn", "u1", 4)])
    rows = np.frombuffer(content, row)
    return {
        "position_m": rows["position"],
        "sigma_m": rows["sigma"],
        "rgb": rows["rgba"][:, :3] / 255,
        "opacity": rows["rgba"][:, 3] / 255,
        "splat.turn": (rows["turn"] - 128.0) / 128,
    }


def splat_frames(folder: Path, decode: Callable[[bytes], Arrays]) -> Arrays:
    return {
        f"{path.name}.{name}": thinned(array)
        for path in sorted(folder.iterdir())
        for name, array in decode(path.read_bytes()).items()
    }


# ---- USD ------------------------------------------------------------------------------------------------------------


def usd(folder: Path) -> Arrays:
    """Every attribute of every variant: what it is by default, and at the times of the stage."""
    (path,) = [*folder.glob("*.shot.usda"), *folder.glob("*.usdc"), *folder.glob("*.usdz")][:1]
    stage = Usd.Stage.Open(str(path))
    stage.SetEditTarget(stage.GetSessionLayer())
    span = np.arange(stage.GetStartTimeCode(), stage.GetEndTimeCode() + 1)
    about = {name: stage.GetMetadata(name) for name in ("upAxis", "metersPerUnit", "timeCodesPerSecond")}
    arrays = {"stage": np.array(json.dumps(about)), "times": span}
    choices = [prim.GetVariantSets() for prim in stage.Traverse() if prim.GetVariantSets().GetNames()]
    variants = choices[0].GetVariantSet("representation") if choices else None
    arrays["shown"] = np.array(variants.GetVariantSelection() if variants else "")
    for variant in variants.GetVariantNames() if variants else [""]:
        if variants:
            variants.SetVariantSelection(variant)
        prims = [prim for prim in stage.Traverse() if prim.GetTypeName()]
        arrays[f"prims.{variant}"] = np.array(
            [f"{prim.GetPath()} {prim.GetTypeName()} {prim.GetAttribute('purpose').Get()}" for prim in prims]
        )
        for prim in prims:
            for attribute in prim.GetAttributes():
                name = f"{prim.GetPath()}.{attribute.GetName()}"
                if attribute.HasAuthoredValue() and name not in arrays and attribute.GetName() != "purpose":
                    arrays |= usd_values(name, attribute, span)
    return arrays


def usd_values(name: str, attribute: Usd.Attribute, span: np.ndarray) -> Arrays:
    arrays, still = {}, attribute.Get()
    if still is not None:
        arrays[name] = thinned(usd_array(name, still))
    if attribute.GetNumTimeSamples():
        moving = np.stack([usd_array(name, attribute.Get(time)) for time in span])
        arrays[f"{name}.moving"] = thinned(moving, axis=1) if moving.ndim > 1 else moving
    return arrays


def usd_array(name: str, value: Any) -> np.ndarray:
    array = np.array(value)
    is_turn = name.rpartition(".")[2] in ("rotations", "orientations", "orientationsh")
    return upright(array[..., [3, 0, 1, 2]]) if is_turn else array


# ---- others ---------------------------------------------------------------------------------------------------------

# what of a page's hand means something to others than its own script
WEB_ARRAYS = ("skin.rest", "skin.weight", "look", "irradiance", "lobe", "opacity", "constant", "cast.rest", "motion")
WEB_NUMBERS = ("fps", "origin_m", "reach_m", "gaussians", "rows", "handedness")


def web(folder: Path) -> Arrays:
    found = re.fullmatch(r'[\w.]+=\{description:(.*),arrays:"(.*)"\};\n', (folder / "hand.js").read_text(), re.DOTALL)
    assert found
    about, content = json.loads(found[1]), gzip.decompress(base64.b64decode(found[2]))
    arrays = {name: np.array(about[name]) for name in WEB_NUMBERS}
    arrays |= {f"view.{name}": np.array(value) for name, value in about["view"].items()}
    for name, value in about["articulated"].items():
        for part, numbers in value.items() if name == "poses_deg" else [("", value)]:
            arrays[f"{name}.{part}"] = np.array(numbers)
    for name in WEB_ARRAYS:
        one = about["arrays"][name]
        kind = "<u2" if one["kind"] == "rounded" else f"<{one['kind']}"
        values: Any = np.frombuffer(content, kind, offset=one["at"], count=int(np.prod(one["shape"]))).reshape(
            one["shape"]
        )
        if one["kind"] == "rounded":
            values = np.array(one["low"])[:, None] + np.array(one["step"])[:, None] * values
        arrays[name] = thinned(values.reshape(len(values), -1) if len(values) > 1 else values.ravel())
    arrays["files"] = np.array(sorted(path.name for path in folder.iterdir()))
    return arrays


def cameras(folder: Path) -> Arrays:
    arrays = {}
    for name in ("cameras", "images"):
        lines = [line for line in (folder / f"{name}.txt").read_text().splitlines() if line and line[0] != "#"]
        words = [line.split() for line in lines]
        arrays[f"{name}.words"] = np.array([[word for word in line if word[-1].isalpha()] for line in words])
        arrays[f"{name}.numbers"] = np.array([[float(word) for word in line if word[-1].isdigit()] for line in words])
    frames = json.loads((folder / "transforms.json").read_text())["frames"]
    for name in frames[0]:
        arrays[f"transforms.{name}"] = np.array([frame[name] for frame in frames])
    return arrays


def motion(folder: Path) -> Arrays:
    with np.load(folder / "motion.npz") as archive:
        return dict(archive)


# ---- all of them ----------------------------------------------------------------------------------------------------


def decoded(case: str, folder: Path) -> Arrays:
    """The arrays of an exported case."""
    own: dict[str, Callable[[Path], Arrays]] = {"web": web, "cameras": cameras, "motion": motion}
    files: dict[str, Callable[[bytes], Arrays]] = {"ply": ply, "glb": glb, "spz": spz, "splat": splat}
    arrays = splat_frames(folder, files[case]) if case in files else own.get(case, usd)(folder)
    return {name: narrowed(array) for name, array in arrays.items()}
