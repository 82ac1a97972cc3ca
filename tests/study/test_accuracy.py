"""Accuracy against time: what is compared, errors against float64, front, words, curves. Never how long it takes."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from small_avatars import ellipsoid_avatar, small_avatar, trained_avatar

from jghand_engine.errors import InputError
from jghand_engine.native.library import runnable_variants
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import PRESETS, ShadowMode
from jghand_engine.render.subject import Subject, moving_subject
from jghand_engine.render.timing import measure
from jghand_engine.study import accuracy_growth, accuracy_measures, accuracy_reference, accuracy_variants
from jghand_engine.study.accuracy import Accuracy, Row, faster_than
from jghand_engine.study.accuracy_growth import GAUSSIANS, HANDS, PIXELS, POSES, Growth, Reach, growth_cases
from jghand_engine.study.accuracy_measures import (
    Plan,
    learning_curve,
    measure_accuracy,
    profile_of,
)
from jghand_engine.study.accuracy_reference import Error, ExactPictures64, pose_count, spread_poses
from jghand_engine.study.accuracy_variants import (
    AXES,
    CORRECTIVES,
    THREADS,
    TOGETHER,
    linear_tiers,
    variants,
)
from jghand_engine.study.report import plain

SMALL = (48, 32)
SHORT = Reach((200, 400), ((24, 16), (48, 32)), (1, 2), (1, 5))
# for what otherwise takes seconds
SMALL_NUMBERS = (
    (accuracy_variants, "DISTIL_POSES", 8), (accuracy_variants, "BASES", (2, 3)),
    (accuracy_variants, "COUNTS", (50, 900)),
    (accuracy_reference, "POSES", 2), (accuracy_growth, "GROWTH_ROUNDS", 1), (accuracy_measures, "WARM_UP", 1),
)  # fmt: skip
needs_native = pytest.mark.skipif(not runnable_variants(), reason="no native variant runs on this processor")


@pytest.fixture(autouse=True)
def few(monkeypatch):
    for module, name, value in SMALL_NUMBERS:
        monkeypatch.setattr(module, name, value)


def subject_of(avatar) -> Subject:
    return moving_subject("small", avatar, *SMALL)


# ---- what is compared ------------------------------------------------------------------------------------------------


def test_every_axis_is_compared_and_changes_only_itself():
    avatar = trained_avatar(100)
    found = variants(avatar, SMALL, linear_tiers(avatar))
    assert {one.axis for one in found} == set(AXES)
    names = [(one.axis, one.name) for one in found]
    assert len(set(names)) == len(names)
    assert not any(one.settings.reuse for one in found)
    final = replace(PRESETS["final"], reuse=False)
    for one in found:
        changed = {name for name in vars(final) if getattr(one.settings, name) != getattr(final, name)}
        allowed = {"Gaussians": {"gaussians"}, CORRECTIVES: {"effects"}, "blend": {"alpha_min", "t_stop"},
                   "resolution": {"half"}, "shadow": {"shadow", "shadow_samples"}, "stored as": set(),
                   THREADS: {"threads"}}  # fmt: skip
        assert one.axis == TOGETHER or changed <= allowed[one.axis]
    assert [one.name for one in found if one.axis == CORRECTIVES] == [
        "off", "linear, K = 2", "linear, K = 3", "exact"
    ]  # fmt: skip
    assert [one.name for one in found if one.axis == "Gaussians"] == ["0.05k", "0.1k"]


def test_a_painted_hand_has_no_correctives_to_compare():
    found = variants(small_avatar(100), SMALL, linear_tiers(small_avatar(100)))
    assert not [one for one in found if one.axis == CORRECTIVES]


def test_what_nobody_can_choose_is_no_choice():
    avatar = trained_avatar(100)
    assert all(one.avatar is None for one in variants(avatar, SMALL, {}) if one.axis == TOGETHER)


# ---- errors ----------------------------------------------------------------------------------------------------------


@needs_native
@pytest.mark.parametrize("make", [small_avatar, trained_avatar, ellipsoid_avatar])
def test_the_renderers_own_reference_comes_near_the_picture_in_double_precision(make):
    subject = subject_of(make(300))
    exact = ExactPictures64(subject, spread_poses(subject, 2))
    renderer = HandRenderer(subject.avatar, replace(PRESETS["reference"], reuse=False, antialias=False))
    error = exact.error(lambda pose_m: renderer.render(pose_m, subject.camera).rgba)
    # 93.7 dB and 0.0003 are the worst of the three
    assert error.psnr_db > 93
    assert error.worst < 0.00035
    assert exact.pictures[0].dtype == np.float64


@needs_native
def test_an_error_is_that_of_all_pictures_together():
    subject = subject_of(small_avatar(50))
    exact = ExactPictures64(subject, spread_poses(subject, 2))
    off = iter([0.1, 0.0])
    error = exact.error(lambda pose_m: exact.pictures[int(not np.array_equal(pose_m, exact.poses_m[0]))] + next(off))
    assert error.worst == pytest.approx(0.1)
    assert error.psnr_db == pytest.approx(-10 * np.log10(0.005))


def test_large_pictures_are_drawn_in_double_precision_less_often(monkeypatch):
    assert pose_count((512, 334)) == 2  # as set above
    monkeypatch.setattr(accuracy_reference, "POSES", 6)
    assert pose_count((512, 334)) == 6
    assert pose_count((3840, 2160)) == 2


# ---- the whole -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    file = tmp_path_factory.mktemp("training") / "log.jsonl"
    lines = [
        {"step": 0, "psnr": 13.0},
        {"step": 5, "seconds": 60.0},
        {"step": 6, "psnr": 21.5},
        {"step": 7, "psnr": None},
    ]
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return file


@pytest.fixture(scope="module")
def study(log):
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in SMALL_NUMBERS:
            patch.setattr(module, name, value)
        plan = Plan(trained_avatar(300), "small", SMALL, None, 2, SHORT, log)
        return plan, measure_accuracy(plan)


@needs_native
def test_everything_is_measured_together(study):
    plan, found = study
    assert {row.axis for row in found.rows} == set(AXES)
    assert all(row.samples + row.dropped == 2 and row.median_ms <= row.p95_ms for row in found.rows)
    assert all("raster" in row.stages_ms and "skin" in row.stages_ms for row in found.rows)
    by_name = {row.name: row for row in found.rows if row.axis == TOGETHER}
    assert by_name["reference"].error.psnr_db > by_name["final"].error.psnr_db > by_name["draft"].error.psnr_db
    assert by_name["reference"].on_front
    assert by_name["reference"].looks == "looks the same"
    assert by_name["draft"].crop is not None
    assert found.learning == ((0.0, 13.0), (1.0, 21.5))
    assert found.poses == 2
    assert found.gaussians == len(plan.avatar)


@needs_native
def test_the_curves_have_the_points_that_were_asked_for(study):
    growth = study[1].growth
    points = {
        panel: [point.x for point in growth if point.panel == panel] for panel in (GAUSSIANS, PIXELS, HANDS, POSES)
    }
    assert points == {GAUSSIANS: [200, 400], PIXELS: [384, 1536], HANDS: [1, 2], POSES: [1, 5]}


@needs_native
def test_the_profile_holds_what_can_be_chosen(study):
    plan, found = study
    rows = profile_of(found, plan).rows
    assert {row.name for row in rows} == {row.name for row in found.rows if row.axis == TOGETHER}
    assert next(row.settings for row in rows if row.name == "draft").shadow is ShadowMode.OFF


@needs_native
def test_figures_are_plain_data(study):
    content = json.loads(json.dumps(plain(study[1]), allow_nan=False))
    assert {"rows", "growth", "machine", "learning"} <= set(content)
    assert "crop" not in content["rows"][0]


@needs_native
def test_many_hands_are_all_in_the_picture():
    cases = list(growth_cases(small_avatar(60), SMALL, replace(PRESETS["viewport"], reuse=False), SHORT))
    reports = {case.name: case.run() for case in cases if case.section.endswith(HANDS)}
    assert {name: report.gaussians for name, report in reports.items() if report} == {"1": 60, "2": 120}
    points = Growth.of(measure(cases, rounds=1, warm_up=0))
    assert len(points) == len(cases)


# ---- words and front -------------------------------------------------------------------------------------------------


def row(
    name: str, ms: float, psnr_db: float, *, looks: str = "", on_front: bool = True, disturbed: bool = False
) -> Row:
    return Row(
        TOGETHER, name, ms, 1.1 * ms, {"raster": ms / 2}, Error(psnr_db, 0.1), {}, 9, 0, disturbed, looks, on_front
    )


def made_up(*rows: Row) -> Accuracy:
    facts = {"processor": "a processor", "threads": 2, "cores": 2, "backend": "v3"}
    return Accuracy("hand", 1000, (512, 334), facts, rows, (), 6, "")


def test_the_headline_says_what_less_time_takes_away():
    rows = [row("quick", 3, 30, looks="soft fingertips"), row("draft", 6, 31, looks="soft fingertips"),
            row("good", 14, 60, looks="looks the same"), row("exact", 30, 90, looks="looks the same")]  # fmt: skip
    assert made_up(*rows).headline == "14 ms: looks the same; 6 ms: soft fingertips"
    assert made_up(rows[0]).headline == "3 ms: soft fingertips"
    assert made_up().headline == "nothing can be chosen"


def test_a_preset_is_beaten_by_what_is_faster_by_more_than_times_vary():
    final, other = row("final", 10, 70, on_front=False), row("other", 9.6, 70)
    assert faster_than(final, [final, other]) is None
    other = row("other", 9.4, 70)
    assert faster_than(final, [final, other]) is other
    assert "Preset final is not on the front: other is as accurate and takes 9.4 ms." in (
        made_up(final, other).tables()[0].notes
    )
    assert faster_than(final, [final, row("other", 1, 69)]) is None


def test_disturbed_times_are_marked():
    quiet, busy = made_up(row("final", 10, 70)), made_up(row("final", 10, 70, disturbed=True))
    assert not quiet.disturbed
    assert busy.disturbed
    assert "other work" in busy.tables()[0].markdown()
    assert "10.0 ✗" in busy.tables()[0].markdown()


def test_a_log_without_accuracy_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        learning_curve(tmp_path / "nowhere.jsonl")
    (tmp_path / "log.jsonl").write_text('{"step": 1, "loss": 2}\n')
    with pytest.raises(InputError, match="psnr"):
        learning_curve(tmp_path / "log.jsonl")


def test_the_finger_tips_are_in_their_picture():
    subject = subject_of(small_avatar(10))
    pose_m = subject.poses[0]
    picture = np.zeros((32, 48, 4), np.float32)
    pixels, _ = subject.camera.project(pose_m[-4:])
    column, line = (int(value) for value in pixels.mean(0))
    picture[line, column] = (1, 0, 0, 1)
    part = accuracy_measures.finger_tips(picture, pose_m, subject)
    assert part.shape[0] == part.shape[1]
    assert (part == (255, 0, 0)).all(-1).sum() == 1
