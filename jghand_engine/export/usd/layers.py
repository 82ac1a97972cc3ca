"""Layers of a stage: units and time, untyped attributes, saving, and what USD's errors mean to a user."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, Vt

from jghand_engine.color import srgb_to_linear
from jghand_engine.errors import RetryError
from jghand_engine.export.usd.values import floats, vec3f
from jghand_engine.files import file_error
from jghand_engine.motion.usd_files import usd_reason

SPLAT_TYPE = "ParticleField3DGaussianSplat"
LINEAR = "lin_rec709_scene"
SRGB = "srgb_rec709_scene"
TYPES: Any = Sdf.ValueTypeNames


@dataclass(frozen=True)
class TimeRange:
    """What all layers of an export agree on. frames: how many; one time code is one frame · first: number of the first
    one · up: the axis, y or z, that points up in the world of the motion; nothing is turned · provenance: what it was
    made from, by whom, under which license; every layer says it, for each may be given away alone."""

    frames: int
    fps: float
    first: int = 0
    up: str = "y"
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def code(self, index: int) -> Usd.TimeCode:
        """The time of the frame with this index, counted from 0."""
        return Usd.TimeCode(self.first + index)


def new_layer(path: Path, time: TimeRange) -> Usd.Stage:
    """A new stage on `path` in meters, with what all layers agree on, written on `Save()`."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z if time.up == "z" else UsdGeom.Tokens.y)
    stage.SetTimeCodesPerSecond(time.fps)
    stage.SetFramesPerSecond(time.fps)
    stage.SetStartTimeCode(time.first)
    stage.SetEndTimeCode(time.first + time.frames - 1)
    if time.provenance:
        stage.GetRootLayer().customLayerData = dict(time.provenance)
    return stage


def announce_fallback(stage: Usd.Stage) -> None:
    """Lets a USD that is too old for splats show the prim as points. Read from the root layer only, so every layer
    that somebody may open first must say it."""
    stage.SetMetadata("fallbackPrimTypes", {SPLAT_TYPE: Vt.TokenArray(["Points"])})


def attribute(prim: Usd.Prim, name: str, type_name: Sdf.ValueTypeName, value: Any = None) -> Usd.Attribute:
    """An attribute authored without its schema class: USD 25.08 does not know the splat schema, and `Imageable` does
    not accept a prim of unknown type."""
    return _authored(prim, name, type_name, value, Sdf.VariabilityVarying)


def uniform(prim: Usd.Prim, name: str, type_name: Sdf.ValueTypeName, value: Any) -> Usd.Attribute:
    """The same for an attribute that cannot change over time."""
    return _authored(prim, name, type_name, value, Sdf.VariabilityUniform)


def _authored(
    prim: Usd.Prim, name: str, type_name: Sdf.ValueTypeName, value: Any, variability: Sdf.Variability
) -> Usd.Attribute:
    attr = prim.CreateAttribute(name, type_name, False, variability)
    if value is not None:
        attr.Set(value)
    return attr


def display_primvars(prim: Usd.Prim, rgb: np.ndarray, opacity: np.ndarray | None = None) -> None:
    """Viewport colors from display-referred sRGB (N, 3), one per point; displayColor is linear by convention."""
    api = UsdGeom.PrimvarsAPI(prim)
    color = api.CreatePrimvar("displayColor", TYPES.Color3fArray, UsdGeom.Tokens.vertex)
    color.Set(vec3f(srgb_to_linear(rgb)))
    color.GetAttr().SetColorSpace(LINEAR)
    if opacity is not None:
        api.CreatePrimvar("displayOpacity", TYPES.FloatArray, UsdGeom.Tokens.vertex).Set(floats(opacity))


@contextlib.contextmanager
def usd_errors(folder: Path) -> Iterator[None]:
    """Turns what fails while a stage is written below `folder` into the engine's errors."""
    try:
        yield
    except OSError as error:
        raise file_error(folder, error) from error
    except Tf.ErrorException as error:
        text = str(error)
        for code in (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS):
            if os.strerror(code) in text:
                raise file_error(folder, OSError(code, os.strerror(code))) from error
        raise RetryError(
            f"cannot write the USD stage in {folder}: {usd_reason(error)}", remedy="Check the disk and try again."
        ) from error
