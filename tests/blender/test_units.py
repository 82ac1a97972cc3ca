"""Lengths, angles and times are Blender's own: shown with their unit, and typed in any."""

import re
from types import SimpleNamespace

import bpy
import pytest

from blender_addon.renderer import runtime
from blender_addon.train import ops as training

_NAMES = {"ROTATION": r"angle", "CAMERA": r"hand_length", "TIME_ABSOLUTE": r"time(out)?_s"}


def _properties():
    """Every float of the extension: of its operators, and of its settings of scenes and objects."""
    owners = [getattr(bpy.ops.jghand, name).get_rna_type() for name in dir(bpy.ops.jghand)]
    scene = bpy.types.Scene.bl_rna.properties["jghand"].fixed_type
    owners += [scene, *(one.fixed_type for one in scene.properties if one.type == "POINTER" and one.name != "RNA")]
    owners.append(bpy.types.Object.bl_rna.properties["jghand"].fixed_type)
    return [one for owner in owners for one in owner.properties if one.type == "FLOAT"]


@pytest.mark.parametrize("unit", _NAMES)
def test_what_has_a_unit_is_shown_with_it(extension, unit):
    found = [one for one in _properties() if re.search(_NAMES[unit], one.identifier)]
    assert found
    assert {one.unit for one in found} == {unit}
    assert not [one.identifier for one in _properties() if re.search("minutes|seconds|degrees", one.identifier)]


def test_the_engine_is_told_the_minutes_of_a_training(extension, tmp_path, monkeypatch):
    settings = extension.scene.jghand.training
    settings.capture_folder, settings.avatar_file = str(tmp_path), str(tmp_path / "mine.jghand")
    monkeypatch.setattr(runtime, "program", lambda **_how: ("engine",))
    for time_s, minutes in ((None, "60"), (5400.0, "90"), (30.0, "0.5")):
        if time_s is not None:
            settings.time_s = time_s
        command = training.Train.job(SimpleNamespace(start="new", confirmed=False), extension, []).command
        assert command[command.index("--minutes") + 1] == minutes
