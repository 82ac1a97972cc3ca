"""Skeletons of USD that move: UsdSkel, in .usda, .usdc, .usd and .usdz.

Joints are found by the last word of their paths (`Hips/…/RightHand`). The stage says unit, up axis and rate. The
skeleton's own place in the world counts too. Only what UsdSkel binds to a skeleton as its animation moves it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine import limits
from jghand_engine.datasets.motions.bone_names import BoneMap
from jghand_engine.datasets.motions.content import HandTrack, MotionContent
from jghand_engine.datasets.motions.skeleton import hand_tracks

KIND = "USD"
SUFFIXES = (".usda", ".usdc", ".usd", ".usdz")


def read(file: Path, fps: float | None, bones: BoneMap | None = None) -> MotionContent:
    """The hands of all skeletons of a stage at `fps`, else at the rate of its samples. ValueError says why not."""
    from pxr import Tf, Usd, UsdGeom, UsdSkel

    try:
        stage = Usd.Stage.Open(str(file))
    except Tf.ErrorException as error:
        # the sentence in quotes behind file and line of USD's own source
        said = str(error).strip().rpartition(" : ")[2].strip("'")
        raise ValueError(f"USD cannot open it: {said}"[:300]) from error
    cache = UsdSkel.Cache()
    tracks: list[HandTrack] = []
    notes: list[str] = []
    rate = limits.DEFAULT_FPS
    prims = [prim for prim in stage.Traverse(Usd.TraverseInstanceProxies()) if prim.IsA(UsdSkel.Skeleton)]
    animations = _bound_animations(stage, cache)
    for prim in prims:
        query = cache.GetSkelQuery(UsdSkel.Skeleton(prim))
        if not query:
            raise ValueError(f"{prim.GetPath()} is no whole skeleton")
        skeleton = _UsdSkeleton(stage, query, animations.get(prim.GetPath()), fps)
        found, lacking = hand_tracks(skeleton, str(prim.GetPath()) if len(prims) > 1 else "", bones)
        if found:
            rate = skeleton.fps
            notes += skeleton.notes
        notes += lacking
        tracks += found
    metres = UsdGeom.GetStageMetersPerUnit(stage)
    if not (np.isfinite(metres) and metres > 0):
        raise ValueError(f"{metres} metres per unit")
    if not prims:
        notes.append("There is no UsdSkel skeleton in it.")
    up = "z" if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else "y"
    return MotionContent(KIND, tuple(tracks), metres, fps=rate, notes=tuple(notes), up=up, files=_files(stage))


def _files(stage: Any) -> tuple[Path, ...]:
    """All files of a stage: of layers in a package the package. What is only in memory has none."""
    from pxr import Ar

    places = {Ar.SplitPackageRelativePathOuter(layer.realPath)[0] for layer in stage.GetUsedLayers()}
    return tuple(Path(place) for place in sorted(places) if place)


def _bound_animations(stage: Any, cache: Any) -> dict[Any, Any]:
    """For each skeleton the animation that bindings around it give it."""
    from pxr import Usd, UsdSkel

    bound = {}
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdSkel.Root):
            root = UsdSkel.Root(prim)
            cache.Populate(root, Usd.TraverseInstanceProxies())
            for binding in cache.ComputeSkelBindings(root, Usd.TraverseInstanceProxies()):
                skeleton = binding.GetSkeleton()
                query = cache.GetSkelQuery(skeleton)
                if query and query.GetAnimQuery():
                    bound[skeleton.GetPath()] = query.GetAnimQuery()
    return bound


class _UsdSkeleton:
    """A skeleton of a stage, at even times."""

    def __init__(self, stage: Any, query: Any, animation: Any, fps: float | None) -> None:
        from pxr import UsdGeom

        self._query, self._xforms = query, UsdGeom.XformCache()
        self._prim = query.GetPrim()
        tokens = [str(token) for token in query.GetJointOrder()]
        if len(tokens) > limits.RIG_PARTS_MAX:
            raise ValueError(f"{len(tokens)} joints")
        self.names = tuple(token.rpartition("/")[2] for token in tokens)
        self.ends: dict[int, np.ndarray] = {}
        self.notes: list[str] = []
        animation = query.GetAnimQuery() or animation
        samples = list(animation.GetJointTransformTimeSamples()) if animation else []
        self.fps, self._codes = _codes(samples, stage.GetTimeCodesPerSecond(), fps)
        if not samples:
            self.notes.append(f"No animation moves {self._prim.GetPath()}: its pose is one frame.")
        rest = query.ComputeJointSkelTransforms(self._codes[0], True)
        self.rest = _columns(rest, len(tokens))

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


def _codes(samples: list[float], codes_per_second: float, fps: float | None) -> tuple[float, list[float]]:
    """Frames per second, and the time codes of the frames."""
    if not (np.isfinite(codes_per_second) and codes_per_second > 0):
        raise ValueError(f"{codes_per_second} time codes per second")
    if len(samples) < 2:
        return fps or limits.DEFAULT_FPS, samples or [0.0]
    steps = np.diff(np.array(samples))
    rate = codes_per_second / float(np.median(steps))
    # sparse samples are poses, not frames: USD's own rate is
    rate = codes_per_second if rate < limits.CLOCK_FPS_MIN * 4 else rate
    rate = rate if fps is None else fps
    count = (samples[-1] - samples[0]) / codes_per_second * rate
    if not 0 <= count <= limits.MOTION_FRAMES_MAX:
        raise ValueError(f"samples from {samples[0]:g} to {samples[-1]:g}")
    steps_taken = np.arange(int(count + limits.STEP_JITTER_MAX) + 1) / rate * codes_per_second
    return rate, (samples[0] + steps_taken).tolist()


def _columns(transforms: Any, count: int) -> np.ndarray:
    """USD's matrices, which act on rows, as (N, 4, 4) that act on columns."""
    array = np.array(transforms, dtype=np.float64)
    if array.shape != (count, 4, 4):
        raise ValueError("a skeleton without a transform of each joint")
    return array.transpose(0, 2, 1)
