"""The folder of a training is read while it is written, and whatever lies in it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from blender_addon.train.training_folder import Curve, TrainingReader, curve_picture, folder_of


def write(path, *lines, end="\n"):
    with (path / "log.jsonl").open("a") as stream:
        stream.write("\n".join(line if isinstance(line, str) else json.dumps(line) for line in lines) + end)


def test_a_folder_without_a_training_has_none(tmp_path):
    seen = TrainingReader(tmp_path / "none").look()
    assert not seen.can_go_on
    assert (seen.sentence(), seen.picture, seen.avatar) == ("", None, None)


def test_figures_previews_and_the_avatar_are_found(tmp_path):
    (tmp_path / "training.json").write_text("{}")
    (tmp_path / "pictures").mkdir()
    for step in (0, 500):
        (tmp_path / "pictures" / f"step_{step:08d}.png").write_bytes(b"")
    (tmp_path / "preview.jghand").write_bytes(b"")
    write(tmp_path, {"step": 0, "psnr": 18.0}, {"step": 10, "loss": 0.5}, {"step": 20, "loss": 0.25, "psnr": None})
    seen = TrainingReader(tmp_path).look()
    assert seen.can_go_on
    assert seen.loss == Curve((10, 20), (0.5, 0.25))
    assert seen.psnr == Curve((0,), (18.0,))
    assert seen.picture is not None
    assert seen.picture.name == "step_00000500.png"
    assert "step 20, loss 0.2500" in seen.sentence()
    words = {
        "step {step}, loss {loss:.4f}": "Schritt {step}: Fehler {loss:.4f}",
        "fixed view {psnr:.2f} dB (best {best:.2f})": "feste Ansicht {psnr:.2f} dB",
        "{count} steps": "{count} Schritte",
        "fixed view {best:.2f} dB": "feste Ansicht {best:.2f} dB",
    }.__getitem__
    assert seen.sentence(words) == "Schritt 20: Fehler 0.2500, feste Ansicht 18.00 dB"
    assert seen.lost_sentence(words) == "20 Schritte, feste Ansicht 18.00 dB"


def test_a_line_that_is_half_written_is_read_when_it_is_whole(tmp_path):
    reader = TrainingReader(tmp_path)
    write(tmp_path, {"step": 1, "loss": 3.0}, '{"step": 2, "lo', end="")
    assert reader.look().loss.steps == (1,)
    write(tmp_path, 'ss": 2.0}')
    assert reader.look().loss == Curve((1, 2), (3.0, 2.0))


def test_a_log_that_went_back_to_a_checkpoint_is_read_anew(tmp_path):
    reader = TrainingReader(tmp_path)
    write(tmp_path, *({"step": step, "loss": 1.0} for step in range(50)))
    assert len(reader.look().loss.steps) == 50
    (tmp_path / "log.jsonl").unlink()
    write(tmp_path, {"step": 1, "loss": 9.0})
    assert reader.look().loss == Curve((1,), (9.0,))
    write(tmp_path, {"step": 5, "loss": 8.0}, {"step": 3, "loss": 7.0})
    assert reader.look().loss == Curve((1, 3), (9.0, 7.0))


@pytest.mark.parametrize("line", ["", "{", "[]", "3", '{"step": "x", "loss": 1}', '{"step": 1, "loss": "x"}', "\x00"])
def test_lines_that_make_no_sense_are_left_out(tmp_path, line):
    write(tmp_path, line, {"step": 4, "loss": 1.0})
    assert TrainingReader(tmp_path).look().loss.steps == (4,)


def test_the_work_of_a_training_lies_beside_its_avatar(tmp_path):
    assert folder_of(tmp_path / "id3.jghand").name == "id3.training"


def test_a_falling_loss_is_drawn_from_the_upper_left_to_the_lower_right():
    curve = Curve(tuple(range(0, 1000, 10)), tuple(1.0 / (1 + step) for step in range(100)))
    picture = curve_picture(curve, 200, 80)
    bright = picture[..., 0] > 0.5
    rows = [np.flatnonzero(bright[:, column]).mean() for column in (10, 60, 120, 190)]
    assert rows == sorted(rows)
    assert rows[0] < 40
    assert rows[-1] > 60


@pytest.mark.parametrize("curve", [Curve(), Curve((3,), (1.0,)), Curve((1, 2), (0.0, 0.0)), Curve((1, 2), (-1.0, 5.0))])
def test_any_curve_is_a_picture(curve):
    picture = curve_picture(curve, 64, 32)
    assert picture.shape == (32, 64, 4)
    assert np.isfinite(picture).all()
    assert (picture[..., 3].max() > 0) == bool(curve.steps)
