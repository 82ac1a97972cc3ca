"""Exported files as arrays by name, read with little code that is nobody else's, and how exactly each must agree.

Of many Gaussians, vertices or numbers every so-manieth is taken; of time, all frames.
"""

import base64
import gzip
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd

Arrays = dict[str, np.ndarray]
ROWS = 200
SH_C0 = 0.28209479177387814
# by the first word that a name contains: meters, or one step of 8 bits
TOLERANCES = {
    "sphericalHarmonics": 1 / 255 / SH_C0,
    "display": 1 / 255,
    "pacit": 1 / 255,
    "look": 1 / 255,
    "poses_deg": 1e-3,
    # a Gaussian has about 0.7 mm
    "widths": 2e-6,
    "scales": 1e-6,
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
    array = np.array(value.path if isinstance(value, Sdf.AssetPath) else value)
    is_turn = name.rpartition(".")[2] in ("rotations", "orientations", "orientationsh")
    return upright(array[..., [3, 0, 1, 2]]) if is_turn else array


# ---- the page -------------------------------------------------------------------------------------------------------

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


# ---- all of them ----------------------------------------------------------------------------------------------------


def decoded(case: str, folder: Path) -> Arrays:
    """The arrays of an exported case."""
    return {name: narrowed(array) for name, array in (web if case == "web" else usd)(folder).items()}
