"""Accuracy against time: what is compared, errors against float64, front, words, curves. Never how long it takes."""

from dataclasses import replace

import numpy as np
import pytest
from learn.lit_samples import write_lit_capture
from learn.small_capture import write_small_capture
from small_avatars import coarse_builtin, ellipsoid_avatar, known_avatar, small_avatar, trained_avatar

from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.sample import load_image
from jghand_engine.learn.evaluate import AvatarPicturer
from jghand_engine.learn.metrics import psnr
from jghand_engine.native.library import runnable_variants
from jghand_engine.render.effect_plan import CHOOSABLE, OF_SCENE, Effect
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import PRESETS
from jghand_engine.render.subject import Subject, moving_subject
from jghand_engine.render.timing import Measurement, frame_case
from jghand_engine.study import accuracy_growth, accuracy_measures, accuracy_reference, accuracy_variants
from jghand_engine.study.accuracy import Accuracy, Row, TruthScore, faster_than, pareto_front
from jghand_engine.study.accuracy_growth import GAUSSIANS, HANDS, PIXELS, POSES, Reach
from jghand_engine.study.accuracy_measures import Plan, measure_accuracy
from jghand_engine.study.accuracy_reference import Error, ExactPictures64, spread_poses
from jghand_engine.study.accuracy_variants import (
    AXES,
    CORRECTIVES,
    LIGHT,
    PASSES,
    THREADS,
    THROWN_LIGHT_STOPS,
    TOGETHER,
    linear_tiers,
    variants,
)

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
                   "shadow": {"shadow", "shadow_samples"}, "stored as": set(),
                   THREADS: {"threads"}, LIGHT: {"effects", "swept_light"}}  # fmt: skip
        assert (one.light is not None) == (one.axis == LIGHT)
        assert one.axis == TOGETHER or changed <= allowed[one.axis]
    assert [one.name for one in found if one.axis == CORRECTIVES] == [
        "off", "linear, K = 2", "linear, K = 3", "exact"
    ]  # fmt: skip
    assert [one.name for one in found if one.axis == "Gaussians"] == ["0.05k", "0.1k"]


def test_a_painted_hand_has_neither_correctives_nor_a_scenes_light_to_compare():
    found = variants(small_avatar(100), SMALL, linear_tiers(small_avatar(100)))
    assert not [one for one in found if one.axis in (CORRECTIVES, LIGHT)]


def test_in_the_light_of_a_scene_each_row_leaves_out_its_pass():
    lit = [one for one in variants(trained_avatar(60), SMALL, {}) if one.light is not None]
    forbidden = {one.name: {each for each in CHOOSABLE if not one.settings.effects.allows(each)} for one in lit}
    none = {"whole": set(), f"without {THROWN_LIGHT_STOPS}": set()}
    assert forbidden == none | {f"without {name}": {effect} for name, effect in PASSES.items()}
    assert [one.name for one in lit if not one.settings.swept_light] == [f"without {THROWN_LIGHT_STOPS}"]
    assert set(PASSES.values()) == OF_SCENE - {Effect.LAMPS}


@needs_native
def test_the_light_of_a_scene_that_is_compared_calls_for_every_pass():
    subject = subject_of(coarse_builtin(1000, texels=64))
    whole = next(one for one in variants(subject.avatar, SMALL, {}) if one.light is not None)
    plan = (
        HandRenderer(subject.avatar, whole.settings, whole.light).render(subject.poses[0], subject.camera).report.plan
    )
    assert plan is not None
    assert all(plan.runs(each) for each in OF_SCENE)


# ---- errors ----------------------------------------------------------------------------------------------------------


@needs_native
@pytest.mark.parametrize(
    ("make", "psnr_db", "worst"),
    [
        *((make, 93, 0.00035) for make in (small_avatar, trained_avatar, ellipsoid_avatar)),
        # its normals are random: where a small part is seen from outside, that is drawn up to 25 times as bright
        (known_avatar, 81, 0.0024),
    ],
)
def test_the_renderers_own_reference_comes_near_the_picture_in_double_precision(make, psnr_db, worst):
    subject = subject_of(make(300))
    exact = ExactPictures64(subject, spread_poses(subject, 2))
    renderer = HandRenderer(subject.avatar, replace(PRESETS["reference"], reuse=False, antialias=False))
    error = exact.error(lambda pose_m: renderer.render(pose_m, subject.camera).rgba)
    # 93.7 dB and 0.0003 are the worst of three, 81.5 and 0.0023 those of the last
    assert error.psnr_db > psnr_db
    assert error.worst < worst
    assert exact.pictures[0].dtype == np.float64


@needs_native
def test_the_picture_in_double_precision_has_detail_and_ends_with_the_skin():
    subject = subject_of(coarse_builtin())
    exact = ExactPictures64(subject, spread_poses(subject, 2))
    settings, found = replace(PRESETS["reference"], reuse=False, antialias=False), []
    for avatar in (subject.avatar, replace(subject.avatar, detail=None)):
        drawn = HandRenderer(avatar, settings)
        pictures = {pose_m.tobytes(): drawn.render(pose_m, subject.camera).rgba for pose_m in exact.poses_m}
        found.append(exact.error(lambda pose_m, of=pictures: of[pose_m.tobytes()]).psnr_db)
    whole, plain = found
    assert whole > 50
    assert plain < 35


@needs_native
def test_an_error_is_that_of_all_pictures_together():
    subject = subject_of(small_avatar(50))
    exact = ExactPictures64(subject, spread_poses(subject, 2))
    off = iter([0.1, 0.0])
    error = exact.error(lambda pose_m: exact.pictures[int(not np.array_equal(pose_m, exact.poses_m[0]))] + next(off))
    assert error.worst == pytest.approx(0.1)
    assert error.psnr_db == pytest.approx(-10 * np.log10(0.005))


# ---- the whole -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def study():
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in SMALL_NUMBERS:
            patch.setattr(module, name, value)
        plan = Plan(trained_avatar(300), "small", SMALL, None, 2, SHORT)
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
    assert found.poses == 2
    assert found.gaussians == len(plan.avatar)


@needs_native
def test_in_the_light_of_a_scene_a_pass_that_is_left_out_is_seen(study):
    whole, *parts = [row.error.psnr_db for row in study[1].rows if row.axis == LIGHT]
    sharp, *others, through = parts
    # a hand without a surface has no sharp shadows
    assert whole == sharp > through > max(others) + 10
    table = next(one for one in study[1].tables() if one.title.startswith("In the light of a scene"))
    assert [row[0] for row in table.rows] == [
        "light: whole", *(f"light: without {name}" for name in (*PASSES, THROWN_LIGHT_STOPS))
    ]  # fmt: skip


@needs_native
@pytest.mark.parametrize("lit", [True, False])
def test_passes_of_a_scenes_light_are_compared_with_pictures_in_known_light_alone(tmp_path, lit):
    avatar = known_avatar(300)
    folder = write_lit_capture(tmp_path, avatar) if lit else write_small_capture(tmp_path)
    truth = accuracy_measures.held_out_truth(avatar, folder, lambda _: None, pictures=2)
    rows = measure_accuracy(Plan(avatar, "small", SMALL, truth, 1, SHORT)).rows
    gains = {row.name: row.truth.gain_db for row in rows if row.axis == LIGHT and row.truth is not None}
    assert len(gains) == lit * (2 + len(PASSES))
    assert all(row.truth is not None for row in rows if row.axis != LIGHT)
    if lit:
        assert gains["without lamps' shadows"] < gains["whole"] - 0.1


@needs_native
def test_the_curves_have_the_points_that_were_asked_for(study):
    growth = study[1].growth
    points = {
        panel: [point.x for point in growth if point.panel == panel] for panel in (GAUSSIANS, PIXELS, HANDS, POSES)
    }
    assert points == {GAUSSIANS: [200, 400], PIXELS: [384, 1536], HANDS: [1, 2], POSES: [1, 5]}


def test_the_front_has_nothing_that_is_both_slower_and_worse():
    rows = [(40, 90, "exact"), (30, 40, "worse and slower"), (10, 60, "good"), (4, 30, "quick")]
    assert pareto_front(rows) == ["quick", "good", "exact"]
    assert pareto_front([(1, 5, "a"), (1, 6, "b"), (2, 6, "c")]) == ["b"]


# ---- words and front -------------------------------------------------------------------------------------------------


def row(
    name: str, ms: float, psnr_db: float, *, looks: str = "", on_front: bool = True, disturbed: bool = False
) -> Row:
    return Row(
        TOGETHER, name, ms, 1.1 * ms, {"raster": ms / 2}, Error(psnr_db, 0.1), None, 9, 0, disturbed, looks, on_front
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


def test_the_headline_says_what_pictures_of_a_capture_say():
    """The quickest that certainly loses no more than a tenth of a decibel on them, however far from float64."""
    worse, near, exact = (
        replace(row(name, ms, psnr_db, looks="words"), truth=TruthScore(34.0, 0.3, gain, 0.04))
        for name, ms, psnr_db, gain in (("draft", 4, 36, -0.05), ("viewport", 6, 41, 0.2), ("reference", 12, 89, 0.0))
    )
    found = replace(made_up(worse, near, exact), truth="120 pictures of somebody (40 novel pose)")
    said = "As near to 120 pictures of somebody as preset reference: viewport, 6 ms (+0.20 ± 0.04 dB)"
    assert found.headline.endswith(said)
    assert found.tables()[0].rows[1][5:7] == ("34.00 ± 0.30", "+0.20 ± 0.04")


def test_a_score_against_pictures_is_a_mean_with_its_standard_error_and_the_gain_on_the_same_pictures():
    score = TruthScore.of(np.array([30.0, 34.0, 38.0]), np.array([29.0, 33.0, 38.0]))
    assert score.psnr_db == 34
    # a standard deviation of 4 over three pictures
    assert score.error_db == pytest.approx(4 / np.sqrt(3))
    assert score.gain_db == pytest.approx(2 / 3)
    assert score.gain_error_db == pytest.approx(np.std([1, 1, 0], ddof=1) / np.sqrt(3))
    assert score.as_near
    assert not TruthScore(34.0, 0.1, -0.05, 0.03).as_near


@needs_native
def test_every_setting_is_compared_with_the_same_pictures_of_a_capture(tmp_path, monkeypatch):
    avatar = small_avatar(200)
    truth = accuracy_measures.held_out_truth(avatar, write_small_capture(tmp_path), lambda _: None, pictures=4)
    assert len(truth.samples) == 4
    assert truth.origin.startswith("4 pictures of")
    compared = [one for one in variants(avatar, SMALL, {}) if one.axis == TOGETHER]
    scores = dict(
        zip([one.name for one in compared], accuracy_measures.truth_scores(compared, avatar, truth), strict=True)
    )
    assert (scores["reference"].gain_db, scores["reference"].gain_error_db) == (0, 0)
    pictures = [load_image(sample) for sample in truth.samples]
    draw = AvatarPicturer(avatar, next(one.settings for one in compared if one.name == "draft"))
    drawn = [draw(one.joints_m, one.handedness, one.camera)[..., :3] for one in truth.samples]
    own_db = [psnr(ours.clip(0, 1), picture.rgb) for ours, picture in zip(drawn, pictures, strict=True)]
    assert scores["draft"].psnr_db == pytest.approx(np.mean(own_db))


def test_of_a_capture_that_a_hand_did_not_learn_from_any_pictures_are_compared_with(tmp_path):
    folder, doubts = write_small_capture(tmp_path), []
    every = open_capture(folder).samples
    # of one that was not learned at all, those that the capture holds out
    held_out = accuracy_measures.held_out_truth(small_avatar(60), folder, doubts.append, pictures=1000)
    assert len(held_out.samples) < len(every)
    assert not doubts
    known = accuracy_measures.held_out_truth(trained_avatar(60), folder, doubts.append, pictures=1000)
    assert {one.image for one in known.samples} == {one.image for one in every}
    assert len(known.samples) == len(every)
    assert "whether they were held out is not known" in known.origin
    assert len(doubts) == 1


@needs_native
def test_pictures_that_are_each_in_a_light_of_their_own_are_drawn_in_it(tmp_path):
    """The hand that they are of, in any other light, is far from them."""
    avatar = known_avatar(1000)
    truth = accuracy_measures.held_out_truth(avatar, write_lit_capture(tmp_path, avatar), lambda _: None, pictures=4)
    compared = [one for one in variants(avatar, SMALL, {}) if one.axis == TOGETHER]
    scores = accuracy_measures.truth_scores(compared, avatar, truth)
    reference = next(score for one, score in zip(compared, scores, strict=True) if one.name == "reference")
    # observed 42.9: the groups were drawn by another preset, and are halves
    assert reference.psnr_db > 41
    elsewhere = [
        AvatarPicturer(avatar, PRESETS["reference"])(one.hand, one.handedness, one.camera) for one in truth.samples
    ]
    pictures = [load_image(sample) for sample in truth.samples]
    assert max(psnr(ours[..., :3].clip(0, 1), one.rgb) for ours, one in zip(elsewhere, pictures, strict=True)) < 35


@needs_native
def test_a_row_has_the_times_of_its_own_variant(monkeypatch):
    """Measurements are of made-up lengths; every row must have those of the case with its number."""
    avatar = small_avatar(60)

    def timed(cases, **_):
        for number, case in enumerate(cases):
            yield Measurement(case.section, case.name, 10.0 + number, 20.0 + number, 1.0, 7, 1, False)
            yield Measurement(case.section, "  raster", 5.0 + number, 6.0 + number, None, 7, 1, False)

    monkeypatch.setattr(accuracy_measures, "measure", lambda cases, **options: [*timed(cases, **options)])
    filtered = []
    monkeypatch.setattr(
        accuracy_measures, "frame_case",
        lambda subject, settings, name: filtered.append(settings.antialias) or frame_case(subject, settings, name),
    )  # fmt: skip
    found = measure_accuracy(Plan(avatar, "small", SMALL, None, 2, SHORT))
    assert not any(filtered), "nor are the pictures whose errors stand beside"
    for number, one in enumerate(found.rows):
        assert (one.median_ms, one.p95_ms, one.stages_ms) == (10.0 + number, 20.0 + number, {"raster": 5.0 + number})
    assert [one.median_ms for one in found.growth] == [10.0 + len(found.rows) + n for n in range(len(found.growth))]


def test_a_preset_is_beaten_by_what_is_faster_by_more_than_times_vary():
    final, other = row("final", 10, 70, on_front=False), row("other", 9.6, 70)
    assert faster_than(final, [final, other]) is None
    other = row("other", 9.4, 70)
    assert faster_than(final, [final, other]) is other
    assert "Preset final is not on the front: other is as accurate and takes 9.4 ms." in (
        made_up(final, other).tables()[0].notes
    )
    assert faster_than(final, [final, row("other", 1, 69)]) is None


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
