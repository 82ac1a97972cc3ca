"""The whole job through Blender: the script starts Blender's Python, which starts an engine."""

import json
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest

# a fifth of a second of motion
QUICK = ("--poses", "point", "--size", "64x64")
JOB = Path(__file__).parents[2] / "scripts" / "demo_job.py"


@pytest.fixture(scope="module")
def folder(engine_python, tmp_path_factory):
    out = tmp_path_factory.mktemp("demo")
    command = [engine_python, "-I", JOB, *QUICK, "--out", str(out)]
    done = subprocess.run(
        [*command, "--blender-python", sys.executable], capture_output=True, encoding="utf-8", check=False
    )
    assert done.returncode == 0, done.stderr
    return out


def test_everything_that_the_page_names_is_there(folder):
    page = (folder / "README.txt").read_text(encoding="utf-8")
    named = [line.split()[0] for line in page.splitlines()[2:] if line and not line.startswith(" ")]
    assert "hand.blend" in named
    for name in named:
        assert (folder / name).exists(), name


def test_pictures_came_through_blender(folder):
    figures = json.loads((folder / "report.json").read_text())
    assert figures["blender"] is True
    assert {"Blender's evaluation", "request (engine, transport)", "Blender's colors and the PNG"} <= set(
        figures["stages"]
    )
    assert figures["stages"]["whole frame"]["ran"] == 2 * figures["frames"]
    for camera in ("front", "back"):
        assert len(list((folder / "frames" / camera).glob("0*.png"))) == figures["frames"]


def test_the_armature_in_the_file_stands_where_the_motion_says(folder):
    joints = np.load(folder / "motion.npz", allow_pickle=False)["joints_m"]
    bpy.ops.wm.open_mainfile(filepath=str(folder / "hand.blend"))
    scene = bpy.context.scene
    armature = next(thing for thing in scene.objects if thing.type == "ARMATURE")
    scene.frame_set(scene.frame_end)
    evaluated = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    heads = np.array([evaluated.matrix_world @ bone.head for bone in evaluated.pose.bones])
    names = [bone.name for bone in evaluated.pose.bones]
    wrist, tip = names.index("wrist"), names.index("index4")
    assert scene.frame_end == len(joints)
    x, y, z = joints[-1][[0, 8]].T  # in motions +y is up
    assert np.abs(heads[[wrist, tip]] - np.stack([x, -z, y], -1)).max() < 1e-6
    assert not list(folder.glob("*.blend1"))
