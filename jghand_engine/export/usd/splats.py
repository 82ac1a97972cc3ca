"""The layer with the posed Gaussians: a splat prim and, from the same numbers, points for clients without splats.

`/Splats` is a ParticleField3DGaussianSplat, `/_Points` a class prim that variant `points` brings in as `UsdGeomPoints`.
Crate stores equal arrays once per file, so the points cost nothing beside the splats; in a file of their own they
would double the export. As a class it stays invisible to whoever opens this layer alone.

In half precision (EXPORT 6) centers are relative to the wrist, which moves as a transform of the prim: they are then
small numbers wherever the hand is. Points know no half precision and are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, Vt

from jghand_engine.color import srgb_to_linear
from jghand_engine.export.usd.half import HalfPrice
from jghand_engine.export.usd.layers import (
    LINEAR,
    SPLAT_TYPE,
    SRGB,
    TYPES,
    TimeRange,
    announce_fallback,
    attribute,
    display_primvars,
    new_layer,
    uniform,
)
from jghand_engine.export.usd.values import floats, halves, quatf, quath, vec3f, vec3h
from jghand_engine.limits import SH_C0, USD_SAVE_EVERY, USD_SPLAT_EXTENT_SIGMA

SPLATS_PATH = "/Splats"
POINTS_PATH = "/_Points"
DEGREE = "radiance:sphericalHarmonicsDegree"
HARMONICS = "radiance:sphericalHarmonicsCoefficients"
WRIST = "xformOp:translate"
DEFAULT = Usd.TimeCode.Default()


@dataclass(frozen=True)
class Cloud:
    """What does not change over time. rest_m (N, 3) centers in the rest pose, meters · sigma_m (N,) meters ·
    opacity (N,) 0..1 · rgb (N, 3) display-referred sRGB 0..1; float32."""

    rest_m: np.ndarray
    sigma_m: np.ndarray
    opacity: np.ndarray
    rgb: np.ndarray


@dataclass(frozen=True)
class Sample:
    """The Gaussians at one time, float32. positions_m: (N, 3) meters · sigma_m: (N,) mean radii, meters, rgb: (N, 3)
    display-referred sRGB, None: as they are · scales_m, turns_xyzw: (N, 3) and (N, 4) of ellipsoids, None: balls ·
    wrist_m: (3,) float64, meters, used in half precision."""

    positions_m: np.ndarray
    sigma_m: np.ndarray | None = None
    rgb: np.ndarray | None = None
    scales_m: np.ndarray | None = None
    turns_xyzw: np.ndarray | None = None
    wrist_m: np.ndarray | None = None


@dataclass(frozen=True)
class Look:
    """How Gaussians are written. radiance: "srgb" keeps the avatar's colors, "linear" writes light · width_factor:
    diameter of the points in two standard deviations · half: in half precision."""

    radiance: str = "srgb"
    width_factor: float = 1.0
    half: bool = False

    def sample_bytes(self, count: int, *, colored: bool, sized: bool, turned: bool) -> int:
        """What `SplatPrims.put` adds to a file for a frame of so many Gaussians with colors, sizes and turns of its
        own, beside some hundred bytes: equal arrays are stored once."""
        number = 2 if self.half else 4
        numbers = 3 + 3 * colored + 3 * sized + 4 * turned
        # of what points have of their own, and know in whole precision alone
        of_points = 0 if self.half else 4 * sized + 12 * colored
        return count * (number * numbers + of_points)


# attributes of the splats: type and values in whole and in half precision, whose name has an h at its end
_STORED: dict[str, tuple[Any, Callable[[np.ndarray], Any], Any, Callable[[np.ndarray], Any]]] = {
    "positions": (TYPES.Point3fArray, vec3f, TYPES.Point3hArray, vec3h),
    "orientations": (TYPES.QuatfArray, quatf, TYPES.QuathArray, quath),
    "scales": (TYPES.Float3Array, vec3f, TYPES.Half3Array, vec3h),
    "opacities": (TYPES.FloatArray, floats, TYPES.HalfArray, halves),
    HARMONICS: (TYPES.Float3Array, vec3f, TYPES.Half3Array, vec3h),
}


@dataclass(frozen=True)
class Places:
    """Paths of the two prims on a stage; None: it is not there."""

    splats: str | None = SPLATS_PATH
    points: str | None = POINTS_PATH


class SplatLayer:
    """Writes the frames of one file, which is complete after `finish`. What does not change was written before.

    stage: on the file · prims: on it
    """

    def __init__(self, stage: Usd.Stage, prims: SplatPrims, time: TimeRange) -> None:
        self.stage, self.prims, self._time = stage, prims, time
        self._unsaved = 0

    @classmethod
    def new(cls, path: Path, cloud: Cloud, time: TimeRange, look: Look, rest: Sample) -> SplatLayer:
        """A new layer, with what does not change."""
        stage = new_layer(path, time)
        announce_fallback(stage)
        prims = SplatPrims(stage, look, cloud.sigma_m)
        prims.define(cloud, rest)
        return cls(stage, prims, time)

    def put(self, frame: int, sample: Sample) -> None:
        """The time sample of a frame, counted from 0."""
        self.prims.put(sample, self._time.code(frame))
        self._unsaved += 1
        if self._unsaved == USD_SAVE_EVERY:
            self.stage.Save()
            self._unsaved = 0

    def finish(self) -> HalfPrice | None:
        """Saves; what half precision lost, where it was asked for."""
        self.stage.Save()
        return self.prims.price


class SplatPrims:
    """The splats and the points on one stage. Attributes are made when they get their first value.

    sigma_m: (N,) radii that hold where a sample brings none · price: what half precision lost so far
    """

    def __init__(self, stage: Usd.Stage, look: Look, sigma_m: np.ndarray, places: Places | None = None) -> None:
        places = places or Places()
        self._stage, self._look, self._sigma_m = stage, look, sigma_m
        self._splats, self._points = places.splats, None if look.half else places.points
        self.price = HalfPrice() if look.half else None
        self._attributes: dict[tuple[str, str], Usd.Attribute] = {}

    def define(self, cloud: Cloud, rest: Sample) -> None:
        """The prims with what does not change, and the rest pose: samples without a Default value show nothing in
        several readers."""
        if self._splats is not None:
            self._define_splats(self._splats, cloud, turned=rest.turns_xyzw is not None)
        if self._points is not None:
            points = self._stage.CreateClassPrim(self._points)
            points.SetTypeName("Points")
            display_primvars(points, cloud.rgb, cloud.opacity)
        self._put_sizes(rest, cloud.sigma_m, DEFAULT)
        self._put_positions(rest, cloud.sigma_m, DEFAULT)
        for path in self._point_paths:
            self._attributes[path, "widths"].SetMetadata("interpolation", "vertex")

    def elsewhere(self, stage: Usd.Stage, places: Places | None = None) -> SplatPrims:
        """The same Gaussians for time samples on another stage; what half precision loses is added up together."""
        other = SplatPrims(stage, self._look, self._sigma_m, places)
        other.price = self.price
        return other

    def override(self) -> None:
        """The prims without anything, for a layer that holds time samples alone."""
        for path in (self._splats, self._points):
            if path is not None:
                self._stage.OverridePrim(path)

    def put(self, sample: Sample, time: Usd.TimeCode) -> None:
        """What moves, at a time."""
        sigma_m = self._sigma_m if sample.sigma_m is None else sample.sigma_m
        if sample.rgb is not None:
            self._put_colors(sample.rgb, time)
        if sample.sigma_m is not None or sample.scales_m is not None:
            self._put_sizes(sample, sigma_m, time)
        self._put_positions(sample, sigma_m, time)

    @property
    def _point_paths(self) -> tuple[str, ...]:
        """Prims that are points to somebody: the splats are where an older USD falls back on points."""
        return () if self._look.half else tuple(path for path in (self._splats, self._points) if path is not None)

    def _put_positions(self, sample: Sample, sigma_m: np.ndarray, time: Usd.TimeCode) -> None:
        values = vec3f(sample.positions_m)
        if self._splats is not None:
            values = self._put_splat_positions(self._splats, sample, sigma_m, time)
        for path in self._point_paths:
            self._set(path, "points", TYPES.Point3fArray, values, time)
        if self._points is not None:
            self._set_extent(self._points, sample.positions_m, self._look.width_factor * sigma_m, time)

    def _put_splat_positions(self, path: str, sample: Sample, sigma_m: np.ndarray, time: Usd.TimeCode) -> Any:
        """Centers and bound; the values that USD got."""
        positions_m = sample.positions_m
        radii_m = sigma_m if sample.scales_m is None else sample.scales_m.max(axis=1)
        if self.price is not None:
            wrist_m = np.zeros(3) if sample.wrist_m is None else sample.wrist_m
            positions_m = (positions_m - wrist_m).astype(np.float32)
            self._set(path, WRIST, TYPES.Double3, Gf.Vec3d(*wrist_m.tolist()), time)
            self.price.add_positions(positions_m)
        values = self._set_stored("positions", positions_m, time)
        if self.price is not None:
            # the bound of what readers will see
            positions_m = np.asarray(values, np.float32)
        self._set_extent(path, positions_m, USD_SPLAT_EXTENT_SIGMA * radii_m, time)
        return values

    def _set_extent(self, path: str, positions_m: np.ndarray, radii_m: np.ndarray, time: Usd.TimeCode) -> None:
        self._set(path, "extent", TYPES.Float3Array, vec3f(bound(positions_m, radii_m)), time)

    def _put_sizes(self, sample: Sample, sigma_m: np.ndarray, time: Usd.TimeCode) -> None:
        if self._splats is not None:
            scales_m = np.repeat(sigma_m[:, None], 3, axis=1) if sample.scales_m is None else sample.scales_m
            if self.price is not None:
                self.price.add_sizes(scales_m)
            self._set_stored("scales", scales_m, time)
            if sample.turns_xyzw is not None:
                if self.price is not None:
                    self.price.add_turns(sample.turns_xyzw)
                self._set_stored("orientations", sample.turns_xyzw, time)
        widths = floats(2 * self._look.width_factor * sigma_m)
        for path in self._point_paths:
            self._set(path, "widths", TYPES.FloatArray, widths, time)

    def _put_colors(self, rgb: np.ndarray, time: Usd.TimeCode) -> None:
        if self._splats is not None:
            self._put_harmonics(rgb, time)
        if not self._point_paths:
            return  # displayColor knows no half precision: who reads it gets the first frame's
        display = vec3f(srgb_to_linear(rgb))
        for path in self._point_paths:
            self._set(path, "primvars:displayColor", TYPES.Color3fArray, display, time)

    def _put_harmonics(self, rgb: np.ndarray, time: Usd.TimeCode) -> None:
        color = srgb_to_linear(rgb) if self._look.radiance == "linear" else rgb
        harmonics = (color - 0.5) / SH_C0
        if self.price is not None:
            self.price.add_colors(color, harmonics, SH_C0)
        self._set_stored(HARMONICS, harmonics, time)

    def _set_stored(self, name: str, array: np.ndarray, time: Usd.TimeCode) -> Any:
        """Sets an attribute of the splats in their precision; the values that USD got."""
        kind, values_of, half_kind, halves_of = _STORED[name]
        if self._look.half:
            name, kind, values_of = f"{name}h", half_kind, halves_of
        values = values_of(array)
        self._set(str(self._splats), name, kind, values, time)
        return values

    def _set(self, path: str, name: str, kind: Sdf.ValueTypeName, value: Any, time: Usd.TimeCode) -> None:
        attr = self._attributes.get((path, name))
        if attr is None:
            attr = self._attributes[path, name] = attribute(self._stage.GetPrimAtPath(path), name, kind)
        attr.Set(value, time)

    def _define_splats(self, path: str, cloud: Cloud, *, turned: bool) -> None:
        prim = self._stage.DefinePrim(path, SPLAT_TYPE)
        self._stage.SetDefaultPrim(prim)
        uniform(prim, "projectionModeHint", TYPES.Token, "perspective")
        uniform(prim, "sortingModeHint", TYPES.Token, "zDepth")
        # the schema falls back to degree 3 and would drop our single coefficient as too short
        uniform(prim, DEGREE, TYPES.Int, 0)
        self._put_harmonics(cloud.rgb, DEFAULT)
        harmonics = prim.GetAttribute(f"{HARMONICS}h" if self._look.half else HARMONICS)
        harmonics.SetMetadata("interpolation", "vertex")
        harmonics.SetMetadata("elementSize", 1)
        Usd.ColorSpaceAPI.Apply(prim).CreateColorSpaceNameAttr(LINEAR if self._look.radiance == "linear" else SRGB)
        if self._look.half:
            # not by its schema: a USD that does not know the prim's type does not know that it can be moved
            uniform(prim, "xformOpOrder", TYPES.TokenArray, Vt.TokenArray([WRIST]))
        if not turned:
            self._set_stored("orientations", np.tile([0.0, 0.0, 0.0, 1.0], (len(cloud.sigma_m), 1)), DEFAULT)
        self._set_stored("opacities", cloud.opacity, DEFAULT)
        if self.price is not None:
            self.price.add_opacities(cloud.opacity)
        display_primvars(prim, cloud.rgb, cloud.opacity)


def bound(positions_m: np.ndarray, radius_m: np.ndarray) -> np.ndarray:
    """(2, 3) corners of the box that holds every ball, meters."""
    # one axis per row: thirty times faster than along rows of three numbers
    rows = np.ascontiguousarray(positions_m.T)
    return np.stack([(rows - radius_m).min(axis=1), (rows + radius_m).max(axis=1)])
