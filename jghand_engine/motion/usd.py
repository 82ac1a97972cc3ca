"""Skeletons of USD that move: UsdSkel, in .usda, .usdc, .usd and .usdz. And opening anybody's stage.

Joints are found by the last word of their paths (`Hips/…/RightHand`). The stage says unit, up axis and rate. The
skeleton's own place in the world counts too. Only what UsdSkel binds to a skeleton as its animation moves it.
"""

from __future__ import annotations

import contextlib
import math
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.motion.clocks import DEFAULT_FPS, STEP_JITTER_MAX, is_one_motion, whole_rate
from jghand_engine.motion.content import HandTrack, MotionContent, MotionFormat, NoMotionError, Reader, Source
from jghand_engine.motion.skeleton import Skeleton, hand_tracks

SUFFIXES = (".usda", ".usdc", ".usd", ".usdz")
CRATE, TEXT = b"PXR-USDC", b"#usda"
# a crate's first bytes: what it is, its version, and where its table of contents stands
_CRATE_HEADER_BYTES = 88
# samples that come more seldom, per second, are poses, no frames; a rate above the other is none
_SAMPLES_FPS_MIN, _SAMPLES_FPS_MAX = 6.0, 240.0
# part of a frame by which a sample may miss one: times in single precision
_FRAME_EPS = 0.05


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Meanwhile USD may open the stage at `path`. InputError for a file that is absent, of another kind, or cut off,
    and for what USD says itself: it finds much of what is damaged only when it comes to it."""
    from pxr import Tf

    name = f"USD file {path}"
    if not path.is_file():
        raise InputError(name, wanted="a file", came="none of that name", remedy="Check the name.")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(name, wanted=" or ".join(SUFFIXES), came=path.suffix or "no suffix")
    try:
        with path.open("rb") as stream:
            head = stream.read(_CRATE_HEADER_BYTES)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}", remedy="Check its rights.") from error
    # USD looks for the table of contents where the header says, also behind the end of the file
    contents = int.from_bytes(head[16:24], "little")
    cut_off = head.startswith(CRATE) and not _CRATE_HEADER_BYTES <= contents < path.stat().st_size
    # USD opens an archive whose end is missing, without the layers that are missing with it
    cut_off = cut_off or (path.suffix.lower() == ".usdz" and head.startswith(b"PK") and not zipfile.is_zipfile(path))
    if cut_off:
        raise InputError(name, wanted="a whole file", came="one that was cut off", remedy="Copy or export it again.")
    try:
        yield
    except Tf.ErrorException as error:
        came = f"a damaged one, or one with damaged layers: {usd_reason(error)}"
        raise InputError(name, wanted="one that USD can read", came=came) from error


def usd_reason(error: Exception) -> str:
    """What went wrong first, of a Tf.ErrorException, without where in USD's source."""
    try:
        text = str(error).strip()
    except UnicodeDecodeError:
        return "its names are no text"
    quoted = re.search(r" in file \S+ : '(.*?)'\s*(?:\n\tError in '|\Z)", text, re.DOTALL)
    return (quoted.group(1) if quoted else text).strip()


def _recognizes(source: Source) -> bool:
    if source.head.startswith(b"PK\x03\x04") and zipfile.is_zipfile(source.path):
        with zipfile.ZipFile(source.path) as archive:
            return any(name.casefold().endswith(SUFFIXES) for name in archive.namelist()[:1])
    return source.head.startswith((CRATE, TEXT))


def _read(source: Source, wanted: MotionFormat) -> MotionContent:
    from pxr import Usd

    with reading(source.path):
        return _content(Usd.Stage.Open(str(source.path)), wanted)


def _content(stage: Any, wanted: MotionFormat) -> MotionContent:
    """The hands of all skeletons of a stage at the wanted rate, else at that of their samples."""
    from pxr import Ar, Usd, UsdGeom, UsdSkel

    cache = UsdSkel.Cache()
    tracks: list[HandTrack] = []
    notes: list[str] = []
    rate = DEFAULT_FPS
    prims = [prim for prim in stage.Traverse(Usd.TraverseInstanceProxies()) if prim.IsA(UsdSkel.Skeleton)]
    for prim in prims:
        query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
        if not query:
            raise ValueError(f"{prim.GetPath()} is no whole skeleton")
        codes, fps = _frames(query, wanted.fps)
        found, more = hand_tracks(_skeleton(query, codes), str(prim.GetPath()) if len(prims) > 1 else "", wanted.bones)
        if found:
            rate = fps
            if len(codes) == 1:
                notes.append(f"No animation moves {prim.GetPath()}: its pose is one frame.")
        notes += more
        tracks += found
    meters = UsdGeom.GetStageMetersPerUnit(stage)
    if not (np.isfinite(meters) and meters > 0):
        raise ValueError(f"{meters} meters per unit")
    if not prims:
        notes.append("There is no UsdSkel skeleton in it.")
    up = "z" if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else "y"
    # of layers in a package the package; what is only in memory has none
    places = {Ar.SplitPackageRelativePathOuter(layer.realPath)[0] for layer in stage.GetUsedLayers()}
    files = tuple(Path(place) for place in sorted(places) if place)
    return MotionContent("USD", tuple(tracks), meters, fps=rate, notes=tuple(notes), up=up, files=files)


def _frames(query: Any, wanted_fps: float | None) -> tuple[list[float], float]:
    """Time codes of even frames from the first sample to the last, and their rate per second: that of samples which
    come evenly, else that of the stage's time codes."""
    samples, per_second = _samples(query), query.GetPrim().GetStage().GetTimeCodesPerSecond()
    if not (np.isfinite(per_second) and per_second > 0):
        raise ValueError(f"{per_second} time codes per second")
    fps = per_second if _SAMPLES_FPS_MIN <= per_second <= _SAMPLES_FPS_MAX else DEFAULT_FPS
    if len(samples) < 2:
        return [samples[0] if len(samples) else 0.0], wanted_fps or fps
    steps_s = np.diff(samples) / per_second
    mean_s = float(steps_s.mean())
    if (np.abs(steps_s - mean_s) <= STEP_JITTER_MAX * mean_s).all() and _SAMPLES_FPS_MIN * mean_s <= 1:
        fps = whole_rate(1 / mean_s)
    fps, seconds = wanted_fps or fps, float(steps_s.sum())
    if not is_one_motion(len(samples), seconds, fps):
        raise NoMotionError(f"{len(samples)} samples over {seconds:g} s, which is no motion of a hand")
    count = math.ceil(seconds * fps - _FRAME_EPS) + 1
    return (samples[0] + np.arange(count) / fps * per_second).tolist(), fps


def _samples(query: Any) -> np.ndarray:
    """The time codes at which a skeleton's joints, or it itself in the world, are said to be somewhere else."""
    from pxr import UsdGeom

    animation, prim = query.GetAnimQuery(), query.GetPrim()
    codes = set(animation.GetJointTransformTimeSamples()) if animation else set()
    while prim:
        codes.update(UsdGeom.Xformable(prim).GetTimeSamples() if prim.IsA(UsdGeom.Xformable) else ())
        prim = prim.GetParent()
    return np.array(sorted(codes))


def _skeleton(query: Any, codes: list[float]) -> Skeleton:
    """A skeleton without a rest pose has one to which it is bound, or its first frame."""
    from pxr import UsdGeom

    tokens = [str(token) for token in query.GetJointOrder()]
    if query.HasRestPose():
        rest = query.ComputeJointSkelTransforms(codes[0], True)
    elif query.HasBindPose():
        rest = query.GetJointWorldBindTransforms()
    else:
        rest = query.ComputeJointSkelTransforms(codes[0])
    xforms = UsdGeom.XformCache()

    def world(joints: list[int], first: int, last: int) -> np.ndarray:
        result = np.empty((last - first, len(joints), 4, 4))
        for row, code in enumerate(codes[first:last]):
            xforms.SetTime(code)
            placed = np.array(xforms.GetLocalToWorldTransform(query.GetPrim())).T
            result[row] = placed @ _columns(query.ComputeJointSkelTransforms(code), len(tokens))[joints]
        if not np.isfinite(result).all():
            raise ValueError("transforms that are no finite numbers")
        return result

    return Skeleton([token.rpartition("/")[2] for token in tokens], _columns(rest, len(tokens)), len(codes), world)


def _columns(transforms: Any, count: int) -> np.ndarray:
    """USD's matrices, which act on rows, as (N, 4, 4) that act on columns."""
    array = np.array(transforms, dtype=np.float64)
    if array.shape != (count, 4, 4):
        raise ValueError("a skeleton without a transform of each joint")
    return array.transpose(0, 2, 1)


READER = Reader(SUFFIXES, _recognizes, _read)
