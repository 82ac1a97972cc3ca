"""The layer with the posed Gaussians: a splat prim and, from the same numbers, points for clients without splats.

`/Splats` is a ParticleField3DGaussianSplat, `/_Points` a class prim that variant `points` brings in as `UsdGeomPoints`.
Crate stores equal arrays once per file, so the points cost nothing beside the splats; in a file of their own they
would double the export. As a class it stays invisible to whoever opens this layer alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd

from jghand_engine.avatar.relighting import Material
from jghand_engine.color import srgb_to_linear
from jghand_engine.export.splats.cloud import SH_C0
from jghand_engine.export.usd.stage import (
    LINEAR,
    POINTS_PATH,
    SPLAT_TYPE,
    SPLATS_PATH,
    SRGB,
    TYPES,
    TimeRange,
    announce_fallback,
    attribute,
    bound,
    floats,
    new_layer,
    quatf,
    set_display,
    set_uniform,
    vec3f,
)

DEGREE = "radiance:sphericalHarmonicsDegree"
HARMONICS = "radiance:sphericalHarmonicsCoefficients"
DEFAULT = Usd.TimeCode.Default()
# frames between two saves: a take's Gaussians then never stand in memory together, and no slower (EXPORT 5)
SAVE_EVERY = 24
# half width of a splat's bound in standard deviations: 99.7 % of the kernel
EXTENT_SIGMA = 3.0


@dataclass(frozen=True)
class Cloud:
    """What does not change over time, float32.

    rest_m: (N, 3) centers in the rest pose, meters
    sigma_m: (N,) radii, meters
    opacity: (N,) 0..1
    rgb: (N, 3) display-referred sRGB 0..1
    material: what light of other programs falls on, whose albedo is `rgb` then; None where colors carry their light
    """

    rest_m: np.ndarray
    sigma_m: np.ndarray
    opacity: np.ndarray
    rgb: np.ndarray
    material: Material | None = None

    @property
    def display(self) -> tuple[np.ndarray, np.ndarray, Material | None]:
        """What `set_display` takes."""
        return srgb_to_linear(self.rgb), self.opacity, self.material

    def every(self, step: int) -> Cloud:
        """Every so many-th of them."""
        some, material = slice(None, None, step), self.material
        if material is not None:
            material = Material(material.albedo[some], material.roughness[some], material.reflectance[some])
        return Cloud(self.rest_m[some], self.sigma_m[some], self.opacity[some], self.rgb[some], material)


@dataclass(frozen=True)
class Sample:
    """The Gaussians at one time, float32.

    positions_m: (N, 3) meters
    sigma_m: (N,) radii, meters; None: as they are
    rgb: (N, 3) display-referred sRGB; None: as it is
    """

    positions_m: np.ndarray
    sigma_m: np.ndarray | None = None
    rgb: np.ndarray | None = None


@dataclass(frozen=True)
class Look:
    """How Gaussians are written.

    linear: whether the splats' colors are, too
    width_factor: diameter of the points in two standard deviations
    """

    linear: bool = False
    width_factor: float = 1.0


class SplatLayer:
    """Writes the Gaussians of one file. What does not change comes first, frame after frame follows, `finish` saves.

    splats, points: paths of the two prims; None: it is not there
    """

    def __init__(
        self,
        stage: Usd.Stage,
        time: TimeRange,
        look: Look,
        sigma_m: np.ndarray,
        splats: str | None = SPLATS_PATH,
        points: str | None = POINTS_PATH,
    ) -> None:
        self._stage, self._time, self._look, self._sigma_m = stage, time, look, sigma_m
        self._splats, self._points = splats, points
        # prims that are points to somebody: the splats are where an older USD falls back on points
        self._point_paths = tuple(path for path in (splats, points) if path is not None)
        self._attributes: dict[tuple[str, str], Usd.Attribute] = {}
        self._unsaved = 0

    @classmethod
    def new(cls, path: Path, cloud: Cloud, time: TimeRange, look: Look) -> SplatLayer:
        """A new layer, with what does not change and the rest pose: samples without a Default value show nothing in
        several readers."""
        stage = new_layer(path, time)
        announce_fallback(stage)
        layer = cls(stage, time, look, cloud.sigma_m)
        layer._define_splats(SPLATS_PATH, cloud)
        points = stage.CreateClassPrim(POINTS_PATH)
        points.SetTypeName("Points")
        set_display(points, *cloud.display)
        layer._put_sizes(cloud.sigma_m, DEFAULT)
        layer._put_positions(cloud.rest_m, cloud.sigma_m, DEFAULT)
        for path_ in layer._point_paths:
            layer._attributes[path_, "widths"].SetMetadata("interpolation", "vertex")
        return layer

    def put(self, frame: int, sample: Sample) -> None:
        time = self._time.code(frame)
        sigma_m = self._sigma_m if sample.sigma_m is None else sample.sigma_m
        if sample.rgb is not None:
            self._put_colors(sample.rgb, time)
        if sample.sigma_m is not None:
            self._put_sizes(sigma_m, time)
        self._put_positions(sample.positions_m, sigma_m, time)
        self._unsaved += 1
        if self._unsaved == SAVE_EVERY:
            self.finish()

    def finish(self) -> None:
        self._stage.Save()
        self._unsaved = 0

    def _put_positions(self, positions_m: np.ndarray, sigma_m: np.ndarray, time: Usd.TimeCode) -> None:
        values = vec3f(positions_m)
        if self._splats is not None:
            self._set(self._splats, "positions", TYPES.Point3fArray, values, time)
            box = bound(positions_m, EXTENT_SIGMA * sigma_m)
            self._set(self._splats, "extent", TYPES.Float3Array, box, time)
        for path in self._point_paths:
            self._set(path, "points", TYPES.Point3fArray, values, time)
        if self._points is not None:
            box = bound(positions_m, self._look.width_factor * sigma_m)
            self._set(self._points, "extent", TYPES.Float3Array, box, time)

    def _put_sizes(self, sigma_m: np.ndarray, time: Usd.TimeCode) -> None:
        if self._splats is not None:
            self._set(self._splats, "scales", TYPES.Float3Array, vec3f(np.repeat(sigma_m[:, None], 3, axis=1)), time)
        widths = floats(2 * self._look.width_factor * sigma_m)
        for path in self._point_paths:
            self._set(path, "widths", TYPES.FloatArray, widths, time)

    def _put_colors(self, rgb: np.ndarray, time: Usd.TimeCode) -> None:
        if self._splats is not None:
            self._put_harmonics(self._splats, rgb, time)
        display = vec3f(srgb_to_linear(rgb))
        for path in self._point_paths:
            self._set(path, "primvars:displayColor", TYPES.Color3fArray, display, time)

    def _put_harmonics(self, path: str, rgb: np.ndarray, time: Usd.TimeCode) -> None:
        color = srgb_to_linear(rgb) if self._look.linear else rgb
        self._set(path, HARMONICS, TYPES.Float3Array, vec3f((color - 0.5) / SH_C0), time)

    def _set(self, path: str, name: str, kind: Sdf.ValueTypeName, value: object, time: Usd.TimeCode) -> None:
        """Attributes are made when they get their first value."""
        attr = self._attributes.get((path, name))
        if attr is None:
            attr = self._attributes[path, name] = attribute(self._stage.GetPrimAtPath(path), name, kind)
        attr.Set(value, time)

    def _define_splats(self, path: str, cloud: Cloud) -> None:
        prim = self._stage.DefinePrim(path, SPLAT_TYPE)
        self._stage.SetDefaultPrim(prim)
        set_uniform(prim, "projectionModeHint", TYPES.Token, "perspective")
        set_uniform(prim, "sortingModeHint", TYPES.Token, "zDepth")
        # the schema falls back to degree 3 and would drop our single coefficient as too short
        set_uniform(prim, DEGREE, TYPES.Int, 0)
        self._put_harmonics(path, cloud.rgb, DEFAULT)
        harmonics = prim.GetAttribute(HARMONICS)
        harmonics.SetMetadata("interpolation", "vertex")
        harmonics.SetMetadata("elementSize", 1)
        Usd.ColorSpaceAPI.Apply(prim).CreateColorSpaceNameAttr(LINEAR if self._look.linear else SRGB)
        straight = np.tile([0.0, 0.0, 0.0, 1.0], (len(cloud.sigma_m), 1))
        self._set(path, "orientations", TYPES.QuatfArray, quatf(straight), DEFAULT)
        self._set(path, "opacities", TYPES.FloatArray, floats(cloud.opacity), DEFAULT)
        set_display(prim, *cloud.display)
