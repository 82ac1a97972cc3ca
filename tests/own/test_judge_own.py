"""The tables that say how good `jghand own` is, on a small film whose truth is known."""

import json
import math
from dataclasses import replace

import judge_own
import numpy as np
import pytest
from picture_sets import recorded, write_set
from shaped_films import FOCAL_PX, FPS, HEIGHT, PRIOR, WIDTH, film

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.file import save_avatar
from jghand_engine.avatar.relighting import covered_mean
from jghand_engine.avatar.scene_light import CELLS
from jghand_engine.errors import InputError
from jghand_engine.own.film import FilmPictures
from jghand_engine.own.hand_fit import FittedHand
from jghand_engine.track import mediapipe_hands

ANGLE_DEG = 2 * math.degrees(math.atan(HEIGHT / 2 / FOCAL_PX))


def lit(avatar: HandAvatar) -> HandAvatar:
    """As if it came from a film with light from everywhere."""
    learned = avatar.learned
    assert learned is not None
    assert learned.response is not None
    even = np.full((CELLS, 3), 4 * np.pi / CELLS, np.float32)
    return replace(avatar, learned=replace(learned, response=replace(learned.response, film_light=even)))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A film's truth, an avatar and a work folder that are right, and a capture to draw it in."""
    truth, place = film(4), tmp_path / "man"
    work = place / "own.own"
    work.mkdir(parents=True)
    np.savez(
        place / "truth.npz", joints_m=truth.joints_m, mask=truth.masks, time_s=truth.time_s, focal_px=FOCAL_PX,
        size_px=(WIDTH, HEIGHT), gain=np.ones(4),
    )  # fmt: skip
    (work / "own.json").write_text(json.dumps({"options": {"camera_angle_deg": ANGLE_DEG}}))
    (work / "report.json").write_text(json.dumps({"mean": {"psnr_full": 30.0, "psnr_box": 25.0, "psnr_mask": 24.0}}))
    FilmPictures(truth.rgb_u8, np.arange(4) / FPS, np.arange(4), "film.mp4", "ab", True).save(work / "pictures.npz")
    truth.start().save(work / "start.npz")
    found = FittedHand(truth.camera, truth.poses, truth.joints_m, truth.canonical_joints_m, truth.shape, np.zeros(4))
    found.save(work / "fit.npz")
    np.savez(work / "masks.npz", hand=truth.masks)
    save_avatar(place / "own.jghand", lit(PRIOR))
    # no network is needed
    monkeypatch.setattr(mediapipe_hands, "check_package", lambda: None)
    monkeypatch.setattr(mediapipe_hands, "model_file", lambda: None)
    write_set(place / "capture", recorded(frames=2, cameras=1))
    (place / "capture" / "splits.json").write_text(json.dumps({"format": 1, "test_cameras": ["400262"]}))
    return place


def test_a_right_hand_has_no_errors_and_covers_what_is_held_out(folder):
    found = judge_own.judge(folder, "own")
    assert found.motion is not None
    assert found.motion.wrist_mm == pytest.approx(0, abs=1e-6)
    assert found.motion.px == pytest.approx((0, 0), abs=1e-6)
    assert found.masks == (1, 1)
    assert found.fitted_db == (30, 25, 24)
    assert found.iou > 0.85
    assert found.whole[0] > found.cut[0] > 8


def test_what_is_wrong_is_counted(folder):
    work, right = folder / "own.own", judge_own.judge(folder, "own")
    found = FittedHand.load(work / "fit.npz")
    bent = found.joints_m.copy()
    bent[:, 16:] += (0, 0, 0.01)
    replace(found, joints_m=bent).save(work / "fit.npz")
    masks = np.load(work / "masks.npz")["hand"]
    masks[1, : HEIGHT // 2] = False
    np.savez(work / "masks.npz", hand=masks)
    save_avatar(folder / "own.jghand", replace(lit(PRIOR), sigma_m=np.minimum(2 * PRIOR.sigma_m, 4e-3)))
    wrong = judge_own.judge(folder, "own")
    assert wrong.motion is not None
    assert wrong.motion.wrist_mm == pytest.approx(10 * 5 / 21, rel=0.2)
    assert wrong.masks is not None
    assert wrong.masks[1] < 0.9 < wrong.masks[0]
    assert wrong.iou < right.iou - 0.02
    assert wrong.whole < right.whole


def test_the_tables_have_a_line_for_each_hand(folder, capsys):
    (folder / "own.judged.json").write_text(json.dumps({"seconds": [90.0, 80.0]}))
    judge_own.main(judge_own.Options(folder.parent))
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| man | film |")]
    assert len(said) == 2
    assert "| 30.0 / 25.0 / 24.0 |" in said[0]
    assert "| 1.000 / 1.000 | 90 / 80 |" in said[1]
    assert json.loads((folder / "own.judged.json").read_text())["fitted_db"] == [30, 25, 24]


def test_the_built_in_hand_has_lines_of_its_own_in_its_color_and_in_the_films(folder, capsys):
    reddish = replace(lit(PRIOR), rgb=PRIOR.rgb * np.array([0.9, 0.4, 0.3], np.float32))
    save_avatar(folder / "own.jghand", reddish)
    hands = judge_own.built_in_hands(folder)
    tinted, wanted = (covered_mean(hand, hand.rgb) for hand in (hands["built-in, tinted"], reddish))
    np.testing.assert_allclose(tinted, wanted, rtol=1e-3)
    judge_own.main(judge_own.Options(folder.parent, built_in=True))
    said = [line.split("|")[2].strip() for line in capsys.readouterr().out.splitlines() if line.startswith("| man |")]
    assert said == ["film", "built-in", "built-in, tinted", "film"]


def refusing(monkeypatch, error: Exception) -> None:
    def run(_: judge_own.Own) -> None:
        raise error

    monkeypatch.setattr(judge_own.Own, "run", run)


def test_a_film_that_is_refused_is_named_with_its_reason_and_has_no_exact_row(folder, capsys, monkeypatch):
    (folder / "own.jghand").unlink()
    refusing(monkeypatch, InputError("Two hands are seen"))
    judge_own.main(judge_own.Options(folder.parent, exact=True))
    said = capsys.readouterr().out
    assert "Refused: man, film (Two hands are seen.)" in said
    assert "| man |" not in said
    assert "exact" not in said
