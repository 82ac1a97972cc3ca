"""`jghand check-data` as people use it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from picture_sets import edited, recorded, write_set
from PIL import Image

from jghand_engine.cli import main


@pytest.fixture
def folder(tmp_path):
    return write_set(tmp_path / "set", recorded())


def run(*words):
    return main(["check-data", *(str(word) for word in words)])


def test_a_sound_set_gets_a_table_a_picture_and_exit_code_0(folder, tmp_path, capsys):
    out, figures = tmp_path / "overlay.png", tmp_path / "check.json"
    assert run(folder, "--out", out, "--json", figures) == 0
    said = capsys.readouterr().out
    assert "The data can be learned from." in said
    assert "334 x 512 (2), 512 x 334 (2)" in said
    assert np.asarray(Image.open(out)).shape[2] == 3
    content = json.loads(figures.read_text())
    assert (content["usable"], content["errors"], content["pictures"]) == (True, [], 4)


def test_a_broken_set_ends_with_the_exit_code_of_bad_input_and_still_shows_pictures(folder, tmp_path, capsys):
    with edited(folder, "camera") as content:
        content["0"]["campos"] = {name: [x / 1e3 for x in place] for name, place in content["0"]["campos"].items()}
    out = tmp_path / "overlay.png"
    assert run(folder, "--out", out) == 2
    said = capsys.readouterr().out
    assert "ERROR: Joints do not project onto the hand" in said
    assert "look like meters" in said
    assert out.exists()


def test_a_wrong_folder_ends_with_the_exit_code_of_bad_input(tmp_path, capsys):
    assert run(tmp_path / "nowhere", "--out", tmp_path / "o.png") == 2
    assert "no such folder" in capsys.readouterr().out
    assert not (tmp_path / "o.png").exists()


def test_the_choice_of_pictures_reaches_the_loader(folder, tmp_path, capsys):
    assert run(folder, "--out", tmp_path / "o.png", "--hand", "left") == 2
    assert "right hand: 4" in capsys.readouterr().out
    assert run(folder, "--out", tmp_path / "o.png", "--sequences", "NONE") == 2
    assert "ROM_JGHAND" in capsys.readouterr().out
    assert run(folder, "--protocol", "test-capture0", "--hand", "left") == 2
    assert "Drop one of them" in capsys.readouterr().err
