"""Training sets, trainings and avatars from Blender, with a stand-in for the engine's command line."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from recording_layout import draw
from test_avatar_cards import write_avatar  # pyright: ignore[reportMissingImports]
from waiting import wait_for_count, wait_until

from blender_addon.export import bakes
from blender_addon.hand import avatar_files, seen_hands
from blender_addon.hand import panel as hand_panel
from blender_addon.hand.ops import LoadAvatar
from blender_addon.render.properties import IDENTITIES
from blender_addon.renderer import runtime
from blender_addon.renderer.jobs import Job, JobTable, Phase
from blender_addon.train import panel as training
from blender_addon.train.ops import Train

ROOT = Path(__file__).resolve().parents[2]
STAND_IN = ROOT / "tests" / "addon_core" / "stand_in_job.py"
LONG_S = 20.0


@pytest.fixture
def place(extension, tmp_path, monkeypatch):
    """A saved file beside a folder of pictures; jobs are the stand-in, which counts until it is stopped, and operators
    return when they have started it, as with a window."""
    monkeypatch.setattr(runtime, "program", lambda **_: (sys.executable, "-I", str(STAND_IN), "long"))
    monkeypatch.setattr(runtime, "timers_fire", lambda: True)
    monkeypatch.setattr(runtime, "watch_jobs", lambda: None)
    monkeypatch.setattr(runtime, "jobs", JobTable())
    monkeypatch.setattr(training, "preferences", lambda: SimpleNamespace(show_training=True))
    (tmp_path / "pictures").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.context.scene.jghand.training.capture_folder = "//pictures"
    yield tmp_path
    for job in runtime.jobs.running:
        job.kill()


def running(key: str) -> Job:
    """The job of a key, once it has said how far it is."""
    job = runtime.jobs.get(key)
    assert job is not None
    wait_for_count(job)
    assert job.state.phase is Phase.RUNNING
    return job


def text_of(panel) -> str:
    return " ".join(draw(panel, bpy.context).texts)


def operators_of(panel) -> list[str]:
    return draw(panel, bpy.context).operators


# ---- training --------------------------------------------------------------------------------------------------------


def test_a_training_goes_on_while_another_file_is_opened_and_can_be_paused(place):
    assert bpy.ops.jghand.train() == {"FINISHED"}
    job = running(runtime.TRAINING)
    assert job.spec.folder == place / "my_hand.training"
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert job.tick() or job.state.phase is Phase.RUNNING
    assert runtime.jobs.get(runtime.TRAINING) is job
    assert bpy.ops.jghand.cancel_job(key=runtime.TRAINING) == {"FINISHED"}
    assert job.wait(LONG_S)
    assert job.state.phase is Phase.CANCELLED


def test_only_one_training_runs_at_a_time(place):
    bpy.ops.jghand.train()
    running(runtime.TRAINING)
    with pytest.raises(RuntimeError, match="running already"):
        bpy.ops.jghand.train()


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("capture_folder", "//none", "no images"),
        ("capture_folder", "", "no folder"),
        ("avatar_file", "//hand.ply", "ends with .jghand"),
    ],
)
def test_what_cannot_be_trained_is_told_before_anything_starts(place, name, value, told):
    setattr(bpy.context.scene.jghand.training, name, value)
    with pytest.raises(RuntimeError, match=told):
        bpy.ops.jghand.train()
    assert runtime.jobs.get(runtime.TRAINING) is None


def test_the_panel_offers_what_can_be_done_with_the_training(place):
    assert "jghand.train" in operators_of(training.TrainPanel)
    bpy.ops.jghand.train()
    job = running(runtime.TRAINING)
    assert text_of(training.TrainPanel).count("Counting") == 2, "in the bar, and whole below it"
    assert "jghand.train" not in operators_of(training.TrainPanel)
    a_training(place)
    job.cancel()
    job.wait(LONG_S)
    assert operators_of(training.TrainPanel).count("jghand.train") == 2, "resume, and restart"


def test_a_training_of_an_earlier_day_can_go_on(place):
    work = a_training(place)
    (work / "preview.jghand").write_bytes(b"")
    seen = draw(training.TrainPanel, bpy.context)
    assert seen.operators.count("jghand.train") == 2, "go on, and start anew"
    assert "5 steps" in seen.texts
    assert bpy.ops.jghand.train(start="resume") == {"FINISHED"}
    assert "--resume" in running(runtime.TRAINING).spec.command


def test_a_failed_job_says_why_until_the_next_one(place, monkeypatch):
    monkeypatch.setattr(runtime, "program", lambda **_: (sys.executable, "-I", str(STAND_IN), "disk full"))
    bpy.ops.jghand.train()
    job = runtime.jobs.get(runtime.TRAINING)
    assert job.wait(LONG_S)
    text = text_of(training.TrainPanel)
    assert "The disk is full" in text
    assert "cannot write x" in text
    assert "jghand.show_log" in operators_of(training.TrainPanel)


def a_training(place: Path, name: str = "my_hand") -> Path:
    """As one of an earlier day left it."""
    work = place / f"{name}.training"
    (work / "checkpoints").mkdir(parents=True)
    (work / "training.json").write_text("{}")
    (work / "checkpoints" / "step_00000005.safetensors").write_bytes(b"")
    return work


def overwritten(start: str) -> str:
    """What the button is asked about before it does anything."""
    return Train.overwritten(SimpleNamespace(start=start), bpy.context)


def test_a_training_and_an_avatars_file_are_not_thrown_away_by_one_click(place):
    assert overwritten("new") == overwritten("fresh") == ""
    (place / "my_hand.jghand").write_bytes(b"somebody's")
    assert overwritten("new") == f"{place / 'my_hand.jghand'} is replaced."
    a_training(place)
    assert overwritten("fresh") == "The training in my_hand.training is lost: 5 steps."
    assert overwritten("resume") == ""


def test_the_panel_shows_the_training_that_its_buttons_act_on(place):
    bpy.ops.jghand.train()
    job = running(runtime.TRAINING)
    a_training(place, "other")
    settings = bpy.context.scene.jghand.training
    settings.avatar_file = "//other.jghand"
    assert "5 steps" not in text_of(training.TrainPanel), "the other one runs"
    job.cancel()
    job.wait(LONG_S)
    seen = draw(training.TrainPanel, bpy.context)
    assert "5 steps" in seen.texts
    assert seen.operators.count("jghand.train") == 2


# ---- training set ----------------------------------------------------------------------------------------------------


def test_a_training_set_is_asked_for_in_the_engines_words(place):
    settings = bpy.context.scene.jghand.training
    settings.identity, settings.cameras, settings.poses, settings.size = "child", 4, 7, (64, 96)
    assert bpy.ops.jghand.render_training_set() == {"FINISHED"}
    words = " ".join(running(runtime.CAPTURE).spec.command)
    assert f"capture --out {place / 'pictures'} --identity child --cameras 4 --poses 7 --size 64x96" in words


def test_the_poses_of_a_training_set_may_be_those_of_a_hand(place):
    bpy.context.scene.jghand.training.use_motion = True
    with pytest.raises(RuntimeError, match="Select the hand"):
        bpy.ops.jghand.render_training_set()
    bpy.ops.jghand.add_hand(handedness="left")
    bpy.context.scene.frame_end = 3
    assert bpy.ops.jghand.render_training_set() == {"FINISHED"}
    words = running(runtime.CAPTURE).spec.command
    assert Path(words[words.index("--motion") + 1]).is_file()


def test_the_hands_to_choose_from_are_those_of_the_engine():
    said = (ROOT / "jghand_engine" / "cli" / "capture.py").read_text()
    numbered = re.findall(r"(\d) (\w+)", re.search(r"Whose hand: (.*)\.", said)[1])
    assert [(str(item[4]), item[0]) for item in IDENTITIES] == numbered


# ---- avatars ---------------------------------------------------------------------------------------------------------


def test_an_avatar_is_put_on_the_selected_hands(place):
    bpy.ops.jghand.add_hand(handedness="right")
    file = write_avatar(place / "ana.jghand", name="Ana", gaussians=7)
    assert bpy.ops.jghand.load_avatar(filepath=str(file)) == {"FINISHED"}
    assert bpy.context.object.jghand.avatar == str(file)


def test_the_path_of_an_avatar_is_relative_where_that_is_wanted(place):
    bpy.ops.jghand.add_hand(handedness="right")
    file = write_avatar(place / "ana.jghand", name="Ana", gaussians=7)
    bpy.ops.jghand.load_avatar(filepath=str(file), relative_path=True)
    assert bpy.context.object.jghand.avatar == "//ana.jghand"


@pytest.fixture
def library(place):
    """A file in a folder of its own with a hand whose avatar lies beside it; another file is open."""
    bpy.ops.jghand.add_hand(handedness="right")
    hand = bpy.context.object
    hand.name = "Lent"
    hand.jghand.avatar, hand.jghand.bake = "//ana.jghand", "//bakes/Lent/v0001"
    (place / "library").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(place / "library" / "hands.blend"), copy=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(place / "scene.blend"))
    return place / "library"


def lent(library: Path, *, link: bool) -> bpy.types.Object:
    bring = bpy.ops.wm.link if link else bpy.ops.wm.append
    bring(directory=str(library / "hands.blend" / "Object") + "/", filename="Lent")
    return bpy.data.objects["Lent"]


@pytest.mark.parametrize("how", ["appended", "linked", "overridden"])
def test_the_avatar_of_a_hand_from_another_file_lies_beside_that_file(library, how):
    hand = lent(library, link=how != "appended")
    if how == "overridden":
        hand = hand.override_create(remap_local_usages=True)
    assert Path(seen_hands.avatar_of(hand)).resolve() == library / "ana.jghand"
    assert bakes.folder_of(hand).resolve() == library / "bakes" / "Lent" / "v0001"


def test_the_own_avatar_of_an_overridden_hand_lies_beside_the_opened_file(library):
    hand = lent(library, link=True).override_create(remap_local_usages=True)
    hand.jghand.avatar = "//mine.jghand"
    assert Path(seen_hands.avatar_of(hand)) == library.parent / "mine.jghand"


def test_a_linked_hand_keeps_its_avatar(library):
    hand = lent(library, link=True)
    bpy.context.view_layer.objects.active = hand
    context = SimpleNamespace(object=hand, view_layer=bpy.context.view_layer)
    said = []
    assert not LoadAvatar.poll.__func__(SimpleNamespace(poll_message_set=said.append), context)
    assert "linked from another file" in said[0]


@pytest.mark.parametrize(("name", "why"), [("none.jghand", "does not exist"), ("scene.blend", "no JGHand avatar")])
def test_what_is_no_avatar_is_not_put_on_a_hand(place, name, why):
    bpy.ops.jghand.add_hand(handedness="right")
    with pytest.raises(RuntimeError, match=why):
        bpy.ops.jghand.load_avatar(filepath=str(place / name))
    assert bpy.context.object.jghand.avatar == ""


def test_a_whole_avatar_of_another_ending_is_refused_for_that(place):
    bpy.ops.jghand.add_hand(handedness="right")
    named = write_avatar(place / "ana.zip", name="Ana", gaussians=7)
    with pytest.raises(RuntimeError, match="does not end with"):
        bpy.ops.jghand.load_avatar(filepath=str(named))


def test_a_header_that_says_nonsense_is_told_without_pythons_words(place):
    bpy.ops.jghand.add_hand(handedness="right")
    file = write_avatar(place / "many.jghand", name="Ana", gaussians="many")
    with pytest.raises(RuntimeError, match="its header cannot be read"):
        bpy.ops.jghand.load_avatar(filepath=str(file))


def test_a_damaged_avatar_is_refused_by_name_and_the_good_one_stays(place):
    bpy.ops.jghand.add_hand(handedness="right")
    good = write_avatar(place / "ana.jghand", name="Ana", gaussians=7)
    bpy.ops.jghand.load_avatar(filepath=str(good))
    whole = ROOT / "jghand_engine" / "assets" / "painted_right.jghand"
    (place / "torn.jghand").write_bytes(whole.read_bytes()[:-5])
    with pytest.raises(RuntimeError, match=r"damaged[^(]*\(.*torn\.jghand\s+its end is missing"):
        bpy.ops.jghand.load_avatar(filepath=str(place / "torn.jghand"))
    assert bpy.context.object.jghand.avatar == str(good)


def test_the_card_is_shown_and_an_avatar_without_one_says_so(place, monkeypatch):
    monkeypatch.setattr(avatar_files, "LOOK_S", 0.0)
    bpy.ops.jghand.add_hand(handedness="right")
    assert "JGHand built-in" in text_of(hand_panel.CardPanel)
    file = place / "ana.jghand"
    header = json.dumps({"__metadata__": {"jghand": json.dumps({"name": "Ana's hand", "gaussians": 12345})}}).encode()
    file.write_bytes(len(header).to_bytes(8, "little") + header)
    bpy.context.object.jghand.avatar = str(file)
    text = text_of(hand_panel.CardPanel)
    assert "Ana's hand" in text
    assert "12345" in text
    file.write_bytes(b"another")
    assert "no JGHand avatar" in text_of(hand_panel.CardPanel)


# ---- the end of Blender ----------------------------------------------------------------------------------------------


def test_blender_that_ends_lets_a_training_write_its_checkpoint(tmp_path):
    code = f"""
import sys, time
sys.path[:0] = {[str(ROOT), str(ROOT / "tests" / "addon_core")]!r}
import bpy
import blender_addon
from blender_addon.renderer import runtime
from blender_addon.renderer.jobs import JobSpec
bpy.ops.wm.read_factory_settings(use_empty=True)
blender_addon.register()
words = (sys.executable, "-I", {str(STAND_IN)!r}, "long", {"file=" + str(tmp_path / "checkpoint")!r})
job = runtime.jobs.start("training", JobSpec("Training", words))
while not job.state.total:
    job.tick()
    time.sleep(0.02)
"""
    command = [sys.executable, "-c", code]
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path / "profile")}
    # however it ends: the module of 4.5 crashes at its exit when a handler is registered (BLENDER 5)
    subprocess.run(command, env=environment, check=False, timeout=120)
    wait_until((tmp_path / "checkpoint").exists, "its checkpoint")
    assert (tmp_path / "checkpoint").read_text() == "checkpoint"
