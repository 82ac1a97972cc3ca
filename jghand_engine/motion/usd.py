"""Skeletons of USD that move: UsdSkel, in .usda, .usdc, .usd and .usdz. And opening anybody's stage.

Joints are found by the last word of their paths (`Hips/…/RightHand`). The stage says unit, up axis and rate. The
skeleton's own place in the world counts too. Only what UsdSkel binds to a skeleton as its animation moves it.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.motion.bone_names import BoneMap
from jghand_engine.motion.clocks import DEFAULT_FPS, frame_times, key_frames
from jghand_engine.motion.content import HandTrack, MotionContent
from jghand_engine.motion.skeleton import hand_tracks

SUFFIXES = (".usda", ".usdc", ".usd", ".usdz")
CRATE, TEXT = b"PXR-USDC", b"#usda"
# a crate's first bytes: what it is, its version, and where its table of contents stands
_CRATE_HEADER_BYTES = 88


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
    if head.startswith(CRATE) and not _CRATE_HEADER_BYTES <= contents < path.stat().st_size:
        raise InputError(name, wanted="a whole file", came="one that was cut off", remedy="Copy or export it again.")
    try:
        yield
    except Tf.ErrorException as error:
        came = f"a damaged one, or one with damaged layers: {usd_reason(error)}"
        raise InputError(name, wanted="one that USD can read", came=came) from error


def usd_reason(error: Exception) -> str:
    """What went wrong first, of a Tf.ErrorException, without where in USD's source."""
    text = str(error).strip()
    quoted = re.search(r" in file \S+ : '(.*?)'\s*(?:\n\tError in '|\Z)", text, re.DOTALL)
    return (quoted.group(1) if quoted else text).strip()


def read(file: Path, fps: float | None, bones: BoneMap | None = None) -> MotionContent:
    """The hands of all skeletons of a stage at `fps`, else at the rate of its samples. ValueError says why not;
    InputError where USD cannot read it."""
    from pxr import Usd

    with reading(file):
        return _content(Usd.Stage.Open(str(file)), fps, bones)


def _content(stage: Any, fps: float | None, bones: BoneMap | None) -> MotionContent:
    from pxr import Usd, UsdGeom, UsdSkel

    cache = UsdSkel.Cache()
    tracks: list[HandTrack] = []
    notes: list[str] = []
    rate = DEFAULT_FPS
    prims = [prim for prim in stage.Traverse(Usd.TraverseInstanceProxies()) if prim.IsA(UsdSkel.Skeleton)]
    for prim in prims:
        query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
        if not query:
            raise ValueError(f"{prim.GetPath()} is no whole skeleton")
        skeleton = _UsdSkeleton(stage, query, fps)
        found, lacking = hand_tracks(skeleton, str(prim.GetPath()) if len(prims) > 1 else "", bones)
        if found:
            rate = skeleton.fps
            notes += skeleton.notes
        notes += lacking
        tracks += found
    meters = UsdGeom.GetStageMetersPerUnit(stage)
    if not (np.isfinite(meters) and meters > 0):
        raise ValueError(f"{meters} meters per unit")
    if not prims:
        notes.append("There is no UsdSkel skeleton in it.")
    up = "z" if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else "y"
    return MotionContent(
        "USD", tuple(tracks), meters, fps=rate, notes=tuple(notes), up=up, files=_files(stage), is_skeleton=True
    )


def _files(stage: Any) -> tuple[Path, ...]:
    """All files of a stage: of layers in a package the package. What is only in memory has none."""
    from pxr import Ar

    places = {Ar.SplitPackageRelativePathOuter(layer.realPath)[0] for layer in stage.GetUsedLayers()}
    return tuple(Path(place) for place in sorted(places) if place)


class _UsdSkeleton:
    """A skeleton of a stage, at even times."""

    def __init__(self, stage: Any, query: Any, fps: float | None) -> None:
        from pxr import UsdGeom

        self._query, self._xforms = query, UsdGeom.XformCache()
        self._prim = query.GetPrim()
        tokens = [str(token) for token in query.GetJointOrder()]
        self.names = tuple(token.rpartition("/")[2] for token in tokens)
        self.ends: dict[int, np.ndarray] = {}
        self.notes: list[str] = []
        per_second = stage.GetTimeCodesPerSecond()
        if not (np.isfinite(per_second) and per_second > 0):
            raise ValueError(f"{per_second} time codes per second")
        samples = np.array(self._samples())
        self.fps, said = (fps, []) if fps is not None else key_frames(samples / per_second, per_second)
        self.notes += said
        self._codes = (frame_times(samples / per_second, self.fps) * per_second).tolist()
        if not len(samples):
            self.notes.append(f"No animation moves {self._prim.GetPath()}: its pose is one frame.")
        self.rest = _columns(self._at_rest(), len(tokens))

    def _samples(self) -> list[float]:
        """The time codes at which its joints, or it itself in the world, are said to be somewhere else."""
        from pxr import UsdGeom

        animation, prim = self._query.GetAnimQuery(), self._prim
        codes = set(animation.GetJointTransformTimeSamples()) if animation else set()
        while prim:
            codes.update(UsdGeom.Xformable(prim).GetTimeSamples() if prim.IsA(UsdGeom.Xformable) else ())
            prim = prim.GetParent()
        return sorted(codes)

    def _at_rest(self) -> Any:
        """Where joints are at rest; a skeleton without a rest pose has one to which it is bound, or its first frame."""
        if self._query.HasRestPose():
            return self._query.ComputeJointSkelTransforms(self._codes[0], True)
        if self._query.HasBindPose():
            return self._query.GetJointWorldBindTransforms()
        return self._query.ComputeJointSkelTransforms(self._codes[0])

    @property
    def frame_count(self) -> int:
        return len(self._codes)

    def world(self, joints: list[int], first: int, last: int) -> np.ndarray:
        """See AnimatedSkeleton."""
        result = np.empty((last - first, len(joints), 4, 4))
        for row, code in enumerate(self._codes[first:last]):
            transforms = _columns(self._query.ComputeJointSkelTransforms(code), len(self.names))
            self._xforms.SetTime(code)
            placed = np.array(self._xforms.GetLocalToWorldTransform(self._prim)).T
            result[row] = placed @ transforms[joints]
        if not np.isfinite(result).all():
            raise ValueError("transforms that are no finite numbers")
        return result


def _columns(transforms: Any, count: int) -> np.ndarray:
    """USD's matrices, which act on rows, as (N, 4, 4) that act on columns."""
    array = np.array(transforms, dtype=np.float64)
    if array.shape != (count, 4, 4):
        raise ValueError("a skeleton without a transform of each joint")
    return array.transpose(0, 2, 1)
