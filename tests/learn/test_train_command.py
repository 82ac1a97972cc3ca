"""`jghand train` as people use it: on a folder, stopped, gone on with, refused."""

import json
import os
import shutil
import signal

import numpy as np
import pytest
from mano_samples import mano_fields, mano_objects, python2_pickle

from jghand_engine.avatar.file import load_avatar
from jghand_engine.captures.capture_folder import PLAN_FILE
from jghand_engine.cli import main
from jghand_engine.cli.failures import STOPPED
from jghand_engine.learn import step
from jghand_engine.learn.canonical_points import place_points
from jghand_engine.learn.step import HandTraining
from jghand_engine.template.mano import load_mano


@pytest.fixture
def train(small_capture, tiny, tmp_path, capsys):
    """Runs the command on the tiny capture; returns exit code, standard output and standard error."""

    def run(*words, folder=small_capture):
        code = main(["train", str(folder), "--out", str(tmp_path / "tiny.jghand"), *map(str, words)])
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        return code, said.out, said.err

    return run


@pytest.fixture
def refused(train):
    """Runs the command where it is bad input, which it says in these words."""

    def run(*words, says, **where):
        code, _, err = train(*words, **where)
        assert code == 2
        for each in [says] if isinstance(says, str) else says:
            assert each in err

    return run


def in_step(monkeypatch, number, act):
    """Does something in a step of the real training, before or instead of it."""
    step = HandTraining.step

    def changed(self, at):
        if at == number:
            act(self)
        return step(self, at)

    monkeypatch.setattr(HandTraining, "step", changed)


def test_a_folder_becomes_an_avatar(train, tmp_path):
    code, out, err = train("--steps", 5, "--json", tmp_path / "figures.json")
    assert code == 0
    assert "20 of 24 pictures to learn from" in out
    assert "jghand evaluate" in out
    assert "step 5 of 5" in err
    avatar = load_avatar(tmp_path / "tiny.jghand")
    assert avatar.info.name == "tiny"
    assert "small" in avatar.info.license
    learned_from = avatar.info.learned_from
    assert learned_from is not None
    assert (learned_from.pictures, len(learned_from.digest)) == (20, 16)
    assert (tmp_path / "tiny.training" / "pictures" / "step_00000005.png").exists()
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert (figures["finished"], figures["steps"], figures["stamp"]["options"]["seed"]) == (True, 5, 0)


def test_a_hand_is_learned_and_exported_on_the_users_own_mano(small_capture, tiny, tmp_path, capsys, monkeypatch):
    """From a made-up file of MANO's structure to the avatar, its picture and its mesh."""
    monkeypatch.setattr(step, "place_points", place_points)
    mano, avatar, out = tmp_path / "MANO_RIGHT.pkl", tmp_path / "mine.jghand", tmp_path / "out"
    mano.write_bytes(python2_pickle(mano_objects(mano_fields())))
    folder = shutil.copytree(small_capture, tmp_path / "small")
    (folder / "plan").mkdir()
    (folder / PLAN_FILE).write_text('{"render": {"forearm": true}}')
    words = ["train", str(folder), "--out", str(avatar), "--steps", "2"]
    assert main([*words, "--template", str(mano)]) == 0
    said = capsys.readouterr().out
    assert f"jghand evaluate {avatar} {folder} --template {mano}\n" in said
    assert "shows the forearm, and a hand on mano-right-mean-manopth-projected has none" in " ".join(said.split())
    learned, template = load_avatar(avatar), load_mano(mano)
    assert learned.info.template == template.identifier == "mano-right-mean-manopth-projected"
    np.testing.assert_allclose(np.asarray(learned.canonical_joints_m), template.joints_m, atol=1e-7)
    small = ["--size", "64x64"]
    assert main(["render", "--poses", "open", "--avatar", str(avatar), "--out", str(out / "pictures"), *small]) == 0
    export = ["export", "--poses", "open", "--avatar", str(avatar), "--out", str(out / "usd")]
    assert main([*export, "--template", str(mano)]) == 0
    capsys.readouterr()
    # on another surface the skin would follow other joints
    assert main(export) == 2
    assert "mano-right-mean-manopth-projected" in capsys.readouterr().err
    assert main([*words, "--resume", "--steps", "3"]) == 2
    assert "template" in capsys.readouterr().err


def test_ctrl_c_is_answered_by_how_to_go_on_and_resume_does(train, tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        in_step(patched, 3, lambda training: os.kill(os.getpid(), signal.SIGINT))
        code, out, _ = train("--steps", 6)
    assert code == STOPPED
    assert "4 steps" in out
    assert "--resume" in out
    assert not (tmp_path / "tiny.jghand").exists()
    # it lasts as long as it was to, whatever was refused meanwhile
    assert train("--resume", "--steps", 5, "--seed", 3)[0] == 2
    code, _, err = train("--resume")
    assert code == 0
    assert "Resuming at step 4" in err
    assert json.loads((tmp_path / "tiny.training" / "training.json").read_text())["budget"]["steps"] == 6
    assert (tmp_path / "tiny.jghand").exists()


def test_a_second_training_must_say_what_it_means(train, refused):
    train("--steps", 2)
    refused("--steps", 2, says=("--resume", "--fresh"))
    assert train("--steps", 2, "--fresh")[0] == 0
    words = ("--steps", 4, "--resume")
    refused(*words, "--seed", 3, says="options.seed: wanted 0, as this training began, got 3")
    refused(*words, "--all-pictures", says="pictures: wanted 20, as this training began, got 24")


def test_somebodys_file_is_not_replaced(train, refused, tmp_path):
    (tmp_path / "tiny.jghand").write_text("somebody's")
    refused("--steps", 2, says="--overwrite")
    assert (tmp_path / "tiny.jghand").read_text() == "somebody's"
    assert not (tmp_path / "tiny.training").exists()
    assert train("--steps", 2, "--overwrite")[0] == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--steps", 0), "--steps"),
        (("--minutes", 0), "--minutes"),
        (("--steps", 1, "--seed", -1), "--seed"),
        (("--minutes", "nan"), "--minutes"),
        (("--resume", "--fresh"), "--resume and --fresh"),
        (("--resume",), "Leave out --resume"),
        (("--out", "hand.txt"), ".jghand"),
    ],
)
def test_options_that_make_no_sense_are_refused(refused, words, said):
    refused(*words, says=said)


def test_a_folder_without_pictures_is_refused_before_anything_is_written(refused, tmp_path):
    refused("--steps", 2, says=str(tmp_path), folder=tmp_path)
    assert not (tmp_path / "tiny.training").exists()


def test_without_steps_or_minutes_there_is_a_budget(small_capture, tmp_path):
    from jghand_engine.cli.train import Train

    assert Train(small_capture, tmp_path / "a.jghand")._budget().seconds == 3600
    assert Train(small_capture, tmp_path / "a.jghand", preset="paper-faithful")._budget(20).steps == 600
    both = Train(small_capture, tmp_path / "a.jghand", steps=7, minutes=2.0)._budget()
    assert (both.steps, both.seconds) == (7, 120.0)
