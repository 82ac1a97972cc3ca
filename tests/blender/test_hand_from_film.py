"""My Hand from a Film: the engine is a stand-in that leaves what `jghand own` and `jghand render` leave."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import pytest
from recording_layout import RecordingLayout, draw
from test_avatar_cards import write_avatar  # pyright: ignore[reportMissingImports]
from waiting import wait_for_count

from blender_addon import folders
from blender_addon.errors import JGHandFailure
from blender_addon.hand import properties
from blender_addon.renderer import runtime
from blender_addon.renderer.jobs import Job, JobTable, Phase
from blender_addon.train import ops
from blender_addon.train.panel import FilmPanel

LONG_S = 20.0
_ENGINE = """
import json, pathlib, shutil, sys, time
arguments = sys.argv[1:]
here = pathlib.Path(__file__).parent
(here / f"asked_{arguments[0]}.json").write_text(json.dumps(arguments))
told = {"jghand": "progress", "text": "Fitting the hand", "done": 2, "total": 5}
print(json.dumps(told), file=sys.stderr, flush=True)
while (here / "wait").exists():
    time.sleep(0.01)
if (here / "error.json").exists():
    print((here / "error.json").read_text(), file=sys.stderr)
    sys.exit(2)
out = pathlib.Path(arguments[arguments.index("--out") + 1])
if arguments[0] == "own":
    shutil.copy(here / "hand.jghand", out)
    told = {"findings": [{"check": "views", "sentence": "The back of the hand is never seen.", "refuses": False}]}
    pathlib.Path(arguments[arguments.index("--json") + 1]).write_text(json.dumps(told))
    out.with_suffix(".own").mkdir(exist_ok=True)
    (out.with_suffix(".own") / "sheet.png").write_bytes(b"film and hand")
else:
    (out / "frame_00000.png").write_bytes(b"picture")
"""


@pytest.fixture
def engine(extension, tmp_path, monkeypatch):
    """A folder in which the stand-in finds what it shall do."""
    folder = tmp_path / "engine"
    folder.mkdir()
    (folder / "engine.py").write_text(_ENGINE)
    write_avatar(folder / "hand.jghand", name="Hand of me.mp4", gaussians=9)
    monkeypatch.setattr(runtime, "program", lambda **_: (sys.executable, str(folder / "engine.py")))
    monkeypatch.setattr(runtime, "timers_fire", lambda: True)
    monkeypatch.setattr(runtime, "watch_jobs", lambda: None)
    monkeypatch.setattr(runtime, "jobs", JobTable())
    monkeypatch.setattr(folders, "user_folder", lambda name, make=True: made(tmp_path / name))
    yield folder
    for job in runtime.jobs.running:
        job.kill()


def made(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture
def film(tmp_path) -> Path:
    """A name is enough for the stand-in."""
    path = tmp_path / "IMG 01.MOV"
    path.write_bytes(b"film")
    return path


def started(film: Path, **chosen: object) -> Job:
    assert bpy.ops.jghand.hand_from_film(filepath=str(film), **chosen) == {"FINISHED"}
    job = runtime.jobs.get(runtime.OWN)
    assert job is not None
    return job


def panel() -> RecordingLayout:
    layout = draw(FilmPanel, bpy.context)
    assert layout is not None
    return layout


def test_the_hand_of_a_film_is_made_while_blender_is_free_and_can_be_added_then(engine, film, tmp_path):
    (engine / "wait").touch()
    job = started(film, hand="left", hand_length=187.0)
    wait_for_count(job)
    assert "Fitting the hand 2 of 5" in panel().texts, "the stage is seen"
    with pytest.raises(RuntimeError, match="running already"):
        bpy.ops.jghand.hand_from_film(filepath=str(film))
    (engine / "wait").unlink()
    assert job.wait(LONG_S)
    assert job.state.phase is Phase.DONE
    avatar = tmp_path / "hands" / "my_img_01.jghand"
    asked = json.loads((engine / "asked_own.json").read_text())
    assert asked[:4] == ["own", str(film), "--out", str(avatar)]
    assert asked[6:10] == ["--hand", "left", "--hand-length", "187"]
    assert "--overwrite" not in asked
    assert avatar.with_suffix(".png").read_bytes() == b"picture"
    assert str(avatar) in json.loads((engine / "asked_render.json").read_text())
    assert not list((tmp_path / "jobs").iterdir()), "what the job needed is taken away"
    shown = panel()
    files = [one.settings.get("filepath") for one in shown.drawn if one.function == "operator"]
    assert "The back of the hand is never seen." in " ".join(shown.texts), "what does not refuse is told, too"
    assert str(avatar.with_suffix(".own") / "sheet.png") in files, "the proof"
    assert str(avatar) in files, "on hands that are there"
    assert [one.settings for one in shown.drawn if one.function == "operator_menu_enum"] == [{"avatar": "my_img_01"}]
    assert "my_img_01" in [item[0] for item in properties.hand_items()]
    assert bpy.ops.jghand.add_hand(handedness="left", avatar="my_img_01") == {"FINISHED"}
    assert bpy.context.object.jghand.avatar == "my_img_01"


def test_the_panel_says_how_to_film_and_what_is_missing(engine, monkeypatch):
    texts = " ".join(panel().texts)
    assert "it must not move" in texts
    assert "jghand.hand_from_film" in panel().operators

    def nothing(**_: object) -> None:
        raise JGHandFailure("no_tools")

    monkeypatch.setattr(runtime, "program", nothing)
    monkeypatch.setattr(runtime, "tools_state", lambda: "missing")
    shown = panel()
    assert " ".join(shown.texts).count("need PyTorch") == 1
    assert "jghand.install_tools" in shown.operators
    assert "jghand.hand_from_film" not in shown.operators


def test_a_hand_of_an_earlier_film_is_not_replaced_by_one_click(engine, film, tmp_path):
    operator: Any = SimpleNamespace(filepath=str(film), _out=lambda: tmp_path / "hands" / "my_img_01.jghand")
    assert ops.HandFromFilm.overwritten(operator, bpy.context) == ""
    assert started(film).wait(LONG_S)
    assert ops.HandFromFilm.overwritten(operator, bpy.context).endswith("my_img_01.jghand is replaced.")
    assert started(film, confirmed=True).wait(LONG_S)
    assert "--overwrite" in json.loads((engine / "asked_own.json").read_text())


def test_what_is_wrong_with_a_film_is_told_in_the_panel(engine, film, tmp_path):
    text = "The skin is burnt out, most at 0:03. Film it with less light, and lock the exposure on the hand."
    (engine / "error.json").write_text(json.dumps({"jghand": "error", "kind": "bad_input", "text": text}))
    job = started(film)
    assert job.wait(LONG_S)
    assert job.state.phase is Phase.FAILED
    assert "The skin is burnt out" in " ".join(panel().texts)
    assert not (tmp_path / "hands" / "my_img_01.jghand").exists()


def test_the_real_engine_takes_these_words(engine, engine_python, film, tmp_path, monkeypatch):
    """It gets as far as the film, which is none."""
    monkeypatch.setattr(runtime, "program", lambda **_: (engine_python, "-I", "-m", "jghand_engine"))
    monkeypatch.setattr(runtime, "is_online", lambda: False)
    job = started(film, hand="right", hand_length=187.0)
    # a program that imports PyTorch, on a machine that may be busy
    assert job.wait(300.0)
    assert job.state.failure is not None
    assert "IMG 01.MOV" in job.state.failure.detail
