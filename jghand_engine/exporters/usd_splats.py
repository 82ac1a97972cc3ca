"""The layer with the posed Gaussians: a splat prim and, from the same numbers, points for clients without splats.

`/Splats` is a ParticleField3DGaussianSplat, `/_Points` a class prim that variant `points` brings in as `UsdGeomPoints`.
Crate stores equal arrays once per file, so the points cost nothing beside the splats; in a file of their own they
would double the export. As a class it stays invisible to whoever opens this layer alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, Vt

from jghand_engine.colour import srgb_to_linear
from jghand_engine.exporters.usd_layers import (
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
from jghand_engine.exporters.usd_values import floats, quatf, vec3f
from jghand_engine.limits import SH_C0, USD_SAVE_EVERY, USD_SPLAT_EXTENT_SIGMA

SPLATS_PATH = "/Splats"
POINTS_PATH = "/_Points"
HARMONICS = "radiance:sphericalHarmonicsCoefficients"


@dataclass(frozen=True)
class Cloud:
    """What does not change over time. rest_m (N, 3) centres in the rest pose, metres · sigma_m (N,) metres ·
    opacity (N,) 0..1 · rgb (N, 3) display-referred sRGB 0..1; float32."""

    rest_m: np.ndarray
    sigma_m: np.ndarray
    opacity: np.ndarray
    rgb: np.ndarray


class SplatLayer:
    """Writes the layer frame by frame; the file is complete after `finish`.

    What does not change is written once. radiance: "srgb" keeps the avatar's colours, "linear" writes light.
    width_factor: diameter of the points in two standard deviations.
    """

    def __init__(self, path: Path, cloud: Cloud, time: TimeRange, *, radiance: str, width_factor: float) -> None:
        self.stage, self._time = new_layer(path, time), time
        announce_fallback(self.stage)
        self._width_factor = width_factor
        splats, points = self._define_splats(cloud, radiance), self._define_points(cloud)
        # `points` and `widths` of the splats are read where the fallback turns the prim into points
        self._positions = [
            attribute(splats, "positions", TYPES.Point3fArray),
            attribute(splats, "points", TYPES.Point3fArray),
            points.CreatePointsAttr(),
        ]
        self._scales = attribute(splats, "scales", TYPES.Float3Array)
        self._widths = [attribute(splats, "widths", TYPES.FloatArray), points.CreateWidthsAttr()]
        self._widths[0].SetMetadata("interpolation", "vertex")
        points.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
        self._extents = [attribute(splats, "extent", TYPES.Float3Array), points.CreateExtentAttr()]
        self._colours = _Colours([splats, points.GetPrim()], radiance)
        self._sigma_m = cloud.sigma_m
        self._unsaved = 0
        # samples without a Default value show nothing in several readers
        self._put_sizes(cloud.sigma_m, Usd.TimeCode.Default())
        self._put_positions(cloud.rest_m, cloud.sigma_m, Usd.TimeCode.Default())

    def put(
        self,
        frame: int,
        positions_m: np.ndarray,
        sigma_m: np.ndarray | None = None,
        rgb: np.ndarray | None = None,
    ) -> None:
        """The time sample of a frame, counted from 0: centres (N, 3) and, unless they stay as they are, radii (N,),
        metres, and colours (N, 3), display-referred sRGB; float32."""
        time = self._time.code(frame)
        if rgb is not None:
            self._colours.put(rgb, time)
        if sigma_m is not None:
            self._put_sizes(sigma_m, time)
        self._put_positions(positions_m, self._sigma_m if sigma_m is None else sigma_m, time)
        self._unsaved += 1
        if self._unsaved == USD_SAVE_EVERY:
            self.stage.Save()
            self._unsaved = 0

    def finish(self) -> None:
        self.stage.Save()

    def _put_positions(self, positions_m: np.ndarray, sigma_m: np.ndarray, time: Usd.TimeCode) -> None:
        values = vec3f(positions_m)
        for target in self._positions:
            target.Set(values, time)
        for extent, factor in zip(self._extents, (USD_SPLAT_EXTENT_SIGMA, self._width_factor), strict=True):
            extent.Set(vec3f(bound(positions_m, factor * sigma_m)), time)

    def _put_sizes(self, sigma_m: np.ndarray, time: Usd.TimeCode) -> None:
        self._scales.Set(vec3f(np.repeat(sigma_m[:, None], 3, axis=1)), time)
        widths = floats(2 * self._width_factor * sigma_m)
        for target in self._widths:
            target.Set(widths, time)

    def _define_splats(self, cloud: Cloud, radiance: str) -> Usd.Prim:
        prim = self.stage.DefinePrim(SPLATS_PATH, SPLAT_TYPE)
        self.stage.SetDefaultPrim(prim)
        count = len(cloud.sigma_m)
        uniform(prim, "projectionModeHint", TYPES.Token, "perspective")
        uniform(prim, "sortingModeHint", TYPES.Token, "zDepth")
        # the schema falls back to degree 3 and would drop our single coefficient as too short
        uniform(prim, "radiance:sphericalHarmonicsDegree", TYPES.Int, 0)
        harmonics = attribute(prim, HARMONICS, TYPES.Float3Array, harmonics_of(cloud.rgb, radiance))
        harmonics.SetMetadata("interpolation", "vertex")
        harmonics.SetMetadata("elementSize", 1)
        Usd.ColorSpaceAPI.Apply(prim).CreateColorSpaceNameAttr(LINEAR if radiance == "linear" else SRGB)
        attribute(prim, "orientations", TYPES.QuatfArray, quatf(np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))))
        attribute(prim, "opacities", TYPES.FloatArray, floats(cloud.opacity))
        display_primvars(prim, cloud.rgb, cloud.opacity)
        return prim

    def _define_points(self, cloud: Cloud) -> UsdGeom.Points:
        prim = self.stage.CreateClassPrim(POINTS_PATH)
        prim.SetTypeName("Points")
        display_primvars(prim, cloud.rgb, cloud.opacity)
        return UsdGeom.Points(prim)


class _Colours:
    """The attributes that carry the colours of prims, which were written without times before."""

    def __init__(self, prims: list[Usd.Prim], radiance: str) -> None:
        self._radiance = radiance
        self._harmonics = [prim.GetAttribute(HARMONICS) for prim in prims if prim.HasAttribute(HARMONICS)]
        self._display = [UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor").GetAttr() for prim in prims]

    def put(self, rgb: np.ndarray, time: Usd.TimeCode) -> None:
        harmonics, display = harmonics_of(rgb, self._radiance), vec3f(srgb_to_linear(rgb))
        for target in self._harmonics:
            target.Set(harmonics, time)
        for target in self._display:
            target.Set(display, time)


def harmonics_of(rgb: np.ndarray, radiance: str) -> Vt.Vec3fArray:
    """The coefficient of degree 0 that gives a display-referred colour (N, 3), or its light."""
    colour = srgb_to_linear(rgb) if radiance == "linear" else rgb
    return vec3f((colour - 0.5) / SH_C0)


def bound(positions_m: np.ndarray, radius_m: np.ndarray) -> np.ndarray:
    """(2, 3) corners of the box that holds every ball, metres."""
    # one axis per row: thirty times faster than along rows of three numbers
    rows = np.ascontiguousarray(positions_m.T)
    return np.stack([(rows - radius_m).min(axis=1), (rows + radius_m).max(axis=1)])
