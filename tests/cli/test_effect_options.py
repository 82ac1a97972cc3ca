"""`jghand render` with effects chosen, a shutter, a lens, and receipts."""

import json

import numpy as np
from command_line import run

from jghand_engine.export.pictures import read_png

SMALL = ("--size", "64x48", "--preset", "draft", "--avatar", "painted")


def test_explain_prints_a_line_for_every_effect_and_the_sum(tmp_path, capsys):
    words = ("render", "--poses", "open,fist", "--frames", "10:11", "--out", tmp_path, "--json", tmp_path / "f.json")
    assert run(*words, *SMALL, "--explain", "--shutter", "1", "--aperture", "20") == 0
    shown = capsys.readouterr().out
    for name in ("skin", "correctives", "self-shadow", "motion-blur", "depth-of-field", "whole-picture"):
        assert shown.count(f"{name} ") >= 2, name
    effects = json.loads((tmp_path / "f.json").read_text())["effects"]
    assert effects["correctives"]["skipped"] == 2
    assert effects["filter"]["ran"] == 2


def test_a_lens_softens_the_picture(tmp_path):
    words = ("render", "--poses", "spread", "--frames", "0", *SMALL, "--effects", "depth-of-field")
    assert run(*words, "--out", tmp_path / "sharp") == 0
    assert run(*words, "--out", tmp_path / "soft", "--aperture", "60", "--focus", "0.1") == 0
    sharp, soft = (read_png(tmp_path / name / "frame_00000.png")[..., 3].astype(float) for name in ("sharp", "soft"))
    assert np.abs(np.diff(soft, axis=1)).max() < 0.7 * np.abs(np.diff(sharp, axis=1)).max()
