"""`jghand check-data` as people use it."""

import json
import pickle

import numpy as np
import pytest
from mano_samples import mano_fields, mano_objects, python2_pickle
from picture_sets import RIGHT, edited, recorded, write_set
from PIL import Image

from jghand_engine.captures import capture_folder, check_data
from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.masks import template_mask
from jghand_engine.captures.sample import load_image
from jghand_engine.cli import main
from jghand_engine.errors import InputError
from jghand_engine.template.mano import load_mano


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


def test_masks_that_are_not_there_are_the_silhouette_of_the_users_own_mano(tmp_path, capsys, monkeypatch):
    """In check-data, evaluate and train alike: each hands its template to the loader."""
    folder = write_set(tmp_path / "set", recorded(suffix=".jpg"))
    mano, hostile = tmp_path / "MANO_RIGHT.pkl", tmp_path / "other.pkl"
    mano.write_bytes(python2_pickle(mano_objects(mano_fields())))
    hostile.write_bytes(pickle.dumps(print))
    commands = ["check-data", "--out"], ["evaluate", "builtin", "--out"], ["train", "--out"]
    for words in commands:
        verb, out = words[0], str(tmp_path / "out.jghand")
        assert main([*words, out, str(folder), "--template", str(hostile)]) == 2, verb
        assert "Nothing in it was executed" in capsys.readouterr().err
    handed = []

    def opened(*_, template, **__):
        handed.append(template.identifier)
        raise InputError("pictures", wanted="no more", came="some")

    with monkeypatch.context() as patched:
        for module in (capture_folder, check_data):
            patched.setattr(module, "open_capture", opened)
        for words in commands:
            assert main([*words, out, str(folder), "--template", str(mano)]) == 2
    assert handed == [load_mano(mano).identifier] * 3
    plain, capture = open_capture(folder), open_capture(folder, template=load_mano(mano))
    ours, theirs = (load_image(one.samples[0]).mask for one in (plain, capture))
    mitten = template_mask(capture.samples[0].camera, capture.samples[0].joints_m, RIGHT, load_mano(mano))
    np.testing.assert_array_equal(theirs, mitten)
    assert theirs.sum() > 1.3 * ours.sum(), "a mitten covers what is between the fingers"
    assert run(folder, "--out", tmp_path / "o.png", "--template", mano) == 0


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
