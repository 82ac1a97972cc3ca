"""`jghand evaluate` as people use it."""

import json
import shutil

import pytest
from command_line import run
from learn.lit_samples import write_lit_capture
from picture_sets import recorded, write_set

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.forearm import BUILTIN_TEMPLATE
from jghand_engine.avatar.relighting import estimated
from jghand_engine.captures.capture_folder import PLAN_FILE, open_capture
from jghand_engine.cli.learning import forearm_note
from jghand_engine.export.pictures import read_png
from jghand_engine.hand.joints import Handedness
from jghand_engine.template.builtin import WITH_FOREARM


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A set of two held-out poses and of two held-out cameras."""
    place = write_set(tmp_path_factory.mktemp("set"), recorded(frames=4, cameras=4))
    held_out = {"format": 1, "test_frames": {"ROM_JGHAND": [2006, 2018]}, "test_cameras": ["400262", "400265"]}
    (place / "splits.json").write_text(json.dumps(held_out))
    return place


def test_an_evaluation_leaves_figures_tables_and_sheets(folder, tmp_path, capsys):
    out = tmp_path / "evaluation"
    words = ("--out", out, "--limit", 1, "--preset", "draft", "--beside", "jghand_engine/assets/painted_right.jghand")
    assert run("evaluate", "builtin", folder, *words) == 0
    said = capsys.readouterr().out
    assert "Crops and perceptual metrics: off" in said
    content = json.loads((out / "evaluation.json").read_text())
    assert content["split"] == "splits.json of the capture; whether they were held out is not known"
    assert {"novel pose", "novel view", "both novel", "all"} <= set(content["means"])
    assert content["means"]["all"]["pictures"] == 3
    tables = (out / "tables.md").read_text(encoding="utf-8")
    assert "JGHand (paper)" in tables
    assert "data differ" in tables
    names = {"best_to_worst", "novel_pose", "novel_view", "both_novel", "views", "between"}
    assert {path.stem for path in out.glob("*.png")} == names
    assert all(min(read_png(path).shape[:2]) > 200 for path in out.glob("*.png"))


def test_a_forearm_that_pictures_show_and_an_avatar_has_not_is_told_beside_the_figures(folder, tmp_path, capsys):
    place, out = shutil.copytree(folder, tmp_path / "arm"), tmp_path / "out"
    words = ("--out", out, "--limit", 1, "--preset", "draft", "--figures-only")
    (place / PLAN_FILE).parent.mkdir()
    (place / PLAN_FILE).write_text('{"render": {"forearm": true}}')
    assert run("evaluate", "painted", place, *words) == 0
    for told in (capsys.readouterr().out, (out / "tables.md").read_text(encoding="utf-8")):
        assert "shows the forearm, and a hand on makehuman-soma-right-1 has none" in " ".join(told.split())
    assert forearm_note(open_capture(folder), BUILTIN_TEMPLATE) is None
    note = forearm_note(open_capture(folder), WITH_FOREARM)
    assert note is not None
    assert "ends at the wrist" in note
    assert forearm_note(open_capture(place), WITH_FOREARM) is None


def test_figures_alone_can_be_had(folder, tmp_path, capsys):
    words = ("--out", tmp_path, "--limit", 1, "--preset", "draft", "--figures-only", "--split", "train")
    assert run("evaluate", "builtin", folder, *words) == 0
    assert not list(tmp_path.glob("*.png"))
    means = json.loads((tmp_path / "evaluation.json").read_text())["means"]
    assert next(iter(means)) == "learnt"
    assert "Inference time" not in capsys.readouterr().out


def test_a_folder_of_test_pictures_alone_is_measured(folder, tmp_path, capsys):
    """Whoever keeps the held-out pictures apart has no other ones there: the split's frames are all that there is."""
    place = shutil.copytree(folder, tmp_path / "apart")
    (place / "splits.json").write_text(
        json.dumps({"format": 1, "test_frames": {"ROM_JGHAND": list(range(2000, 2100))}})
    )
    words = ("--out", tmp_path / "out", "--limit", 1, "--preset", "draft", "--figures-only")
    assert run("evaluate", "builtin", place, *words) == 0
    assert "no pictures to learn from beside those that are measured" in capsys.readouterr().out
    assert json.loads((tmp_path / "out" / "evaluation.json").read_text())["means"]["novel pose"]["pictures"] == 1
    assert run("evaluate", "builtin", place, "--split", "train", *words) == 2
    assert "pictures of the train split" in capsys.readouterr().err
    assert run("train", place, "--out", tmp_path / "hand.jghand") == 2
    assert "at least one image to learn from" in capsys.readouterr().err


def test_held_out_pictures_of_known_light_are_told_apart_by_what_of_it_is_new(tmp_path):
    """As the ablation has them: of the one light that is new its world alone, with its lamps, and its spot alone."""
    hand = estimated(load_builtin(handedness=Handedness.RIGHT)).prefix(1000)
    words = ("--split", "lights", "--limit", 1, "--preset", "draft", "--out", tmp_path / "out")
    assert run("evaluate", "builtin", write_lit_capture(tmp_path / "lit", hand), *words) == 0
    means = json.loads((tmp_path / "out" / "evaluation.json").read_text())["means"]
    kinds = ["new pose", "new camera", "new world", "new world and lamps", "spot from behind", "all new"]
    assert list(means)[: len(kinds) + 1] == [*kinds, "all"]
    assert len({means[kind]["psnr_box"] for kind in kinds}) == len(kinds)
    assert all(f"| {kind} | " in (tmp_path / "out" / "tables.md").read_text(encoding="utf-8") for kind in kinds)
    assert (tmp_path / "out" / "spot_from_behind.png").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--limit", "-1"), "0 or more"),
        (("--lpips-trunk", "nowhere.pth"), "no such file"),
        (("--split", "test", "--sequences", "NONE"), "NONE"),
        (("--split", "lights"), "--lights varied"),
    ],
)
def test_bad_options_are_refused(folder, tmp_path, capsys, words, said):
    assert run("evaluate", "builtin", folder, "--out", tmp_path, "--figures-only", *words) == 2
    assert said in capsys.readouterr().err
