"""When frames are: clocks with holes and in whole milliseconds, rates of video, samples of a stage."""

import dataclasses
import json

import motion_samples as samples
import numpy as np
import pytest

from jghand_engine.errors import InputError
from jghand_engine.motion.clocks import clock_s, even_frames, whole_rate
from jghand_engine.motion.content import MotionFormat
from jghand_engine.motion.files import write_motion
from jghand_engine.motion.read import read_motion_file
from jghand_engine.motion.repair import fill_gaps


@pytest.fixture(scope="module")
def motion():
    return samples.motion()


def dumped(path, content):
    path.write_text(json.dumps(content))
    return path


def tasks(motion, times=None):
    """Results of MediaPipe at these times, milliseconds."""
    frames = samples.mediapipe_tasks(samples.standard(motion))
    for frame, time in zip(frames, times if times is not None else [], strict=False):
        frame["timestamp"] = time
    return frames


# ---- clocks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
def test_clocks_of_any_unit_give_the_same_rate(tmp_path, motion, factor):
    frames = tasks(motion)
    for frame in frames:
        frame["timestamp"] *= factor
    assert read_motion_file(dumped(tmp_path / "a.json", frames)).sequence.fps == 30.0


def test_frames_that_a_detector_dropped_are_gaps(tmp_path, motion):
    """In live mode it leaves out results: what the hand did there is filled in later, and stays marked."""
    kept = [number for number in range(len(motion)) if number not in (4, 5, 11, *range(20, 36))]
    frames = tasks(motion)
    read = read_motion_file(dumped(tmp_path / "a.json", [frames[number] for number in kept]))
    assert len(read.sequence) == len(motion)
    assert np.flatnonzero(read.sequence.valid.all(axis=1)).tolist() == kept
    assert np.abs(read.sequence.joints_m[kept] - motion.joints_m[kept]).max() < 1e-15
    filled = fill_gaps(read.sequence)
    assert filled.sequence.filled.sum() == 19
    assert "longest gap has 0.5 s" in filled.sentence()


def test_frames_that_come_unevenly_are_taken_anew_and_holes_between_them_are_gaps(tmp_path, motion):
    random = np.random.default_rng(3)
    times = (1000 * np.arange(40) / 30 + random.uniform(-6, 6, 40)).tolist()
    frames = tasks(motion, times)
    read = read_motion_file(dumped(tmp_path / "a.json", frames[:15] + frames[25:]))
    assert any("evenly" in note for note in read.notes)
    missing = np.flatnonzero(~read.sequence.valid.all(axis=1))
    assert 8 <= len(missing) <= 10
    assert np.ptp(missing) == len(missing) - 1


@pytest.mark.parametrize("fps", [24, 25, 30, 60, 90, 120, 125, 144, 240, 30000 / 1001, 60000 / 1001])
@pytest.mark.parametrize("dropped", [(), (100,), (7, 8, 100, 200)])
def test_clocks_in_whole_milliseconds_tell_the_rate(fps, dropped):
    numbers = np.delete(np.arange(400), dropped)
    rate, places = even_frames(np.round(1000 * numbers / fps) / 1000)
    assert rate == pytest.approx(fps, rel=1e-12)
    assert places.tolist() == numbers.tolist()


@pytest.mark.parametrize("late_ms", [0, 1])
def test_a_camera_seen_by_the_pictures_of_a_page_has_its_own_rate_and_no_holes(tmp_path, motion, late_ms):
    """25 frames a second, each at the next of 60 pictures a second: steps of 33 and 50 milliseconds."""
    places = np.ceil(np.arange(40) / 25 * 60 - 1e-9) / 60
    times = np.floor(1000 * places) + late_ms * (np.arange(40) % 2)
    read = read_motion_file(dumped(tmp_path / "a.json", tasks(motion, times.tolist())))
    assert read.sequence.fps == pytest.approx(25.0, abs=0.7)
    assert not read.sequence.gaps


@pytest.mark.parametrize("count", [3, 4, 5, 6, 8, 11])
@pytest.mark.parametrize("fps", [24, 25, 30, 60, 120])
def test_a_few_frames_in_whole_milliseconds_have_a_usual_rate(fps, count):
    rounded = [np.round, np.floor, np.ceil]
    for start in (0.0, 0.3, 0.7):
        for whole in rounded:
            times_ms = whole(1000 * np.arange(count) / fps + start)
            assert even_frames((times_ms - times_ms[0]) / 1000)[0] == fps


@pytest.mark.parametrize("times", [[0, 33, 67, 30_000_000], [0, *(1_700_000_000_000 + 33 * np.arange(1, 40)).tolist()]])
def test_one_time_hours_away_is_refused_with_its_frame_and_a_way_out(tmp_path, motion, times):
    file = dumped(tmp_path / "a.json", tasks(motion, times)[: len(times)])
    with pytest.raises(InputError, match=r"a\.json.*before frame (3|1)\b.*--fps"):
        read_motion_file(file)
    assert len(read_motion_file(file, MotionFormat(fps=30.0)).sequence) == len(times)


@pytest.mark.parametrize("uneven_s", [0.0, 0.006])
def test_filled_frames_stay_marked_where_the_clock_has_a_hole(tmp_path, motion, uneven_s):
    whole = dataclasses.replace(motion, filled=np.isin(np.arange(40), [5, 6, 30]))
    write_motion(tmp_path / "a.csv", whole)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    comments = [line.replace("5 6 30", "5 6 28") for line in lines if line.startswith("#") and "fps" not in line]
    rows = [line for line in lines if not line.startswith("#")]
    times = np.arange(40) / 30 + uneven_s * (np.arange(40) % 2)
    rows = [f"{rows[0]},time_s", *(f"{row},{time}" for row, time in zip(rows[1:], times, strict=True))]
    del rows[11:13]
    (tmp_path / "a.csv").write_text("\n".join([*comments, *rows]))
    read = read_motion_file(tmp_path / "a.csv").sequence
    assert read.gaps
    marked = np.flatnonzero(read.filled).tolist()
    assert {5, 6, 30} <= set(marked)
    # a frame between one that was filled and another is filled too
    assert set(marked) <= ({5, 6, 30} if uneven_s == 0 else {4, 5, 6, 7, 29, 30, 31})


def test_a_frame_without_a_result_leaves_the_clock_in_use(tmp_path, motion):
    frames = tasks(motion, (1000 * np.arange(40) / 60).tolist())
    frames[7] = None
    frames[39] = None
    read = read_motion_file(dumped(tmp_path / "a.json", frames))
    assert read.sequence.fps == 60.0
    assert read.sequence.gaps.frames == (7, 39)
    assert not any("does not say" in note for note in read.notes)


def test_one_time_that_does_not_rise_is_taken_from_its_neighbors():
    times, said = clock_s([0, 33, 33, 100, None, 167, 200, float("nan"), 267])
    np.testing.assert_allclose(times, [0, 0.033, 0.0665, 0.1, 0.1335, 0.167, 0.2, 0.2335, 0.267], atol=1e-12)
    assert "milliseconds" in said


@pytest.mark.parametrize("times", [[5] * 40, list(range(40, 0, -1)), [None] * 30 + list(range(10)), [0, 1e12, 2e12]])
def test_times_that_are_no_clock_are_said_to_be_unused(times):
    used, said = clock_s(times)
    assert used is None
    assert "not used" in said


# ---- rates -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fps", [24.0, 30.0, 60.0, 24000 / 1001, 30000 / 1001, 60000 / 1001, 120000 / 1001])
def test_rates_of_video_are_not_rounded_to_those_of_film(tmp_path, motion, fps):
    assert whole_rate(fps * (1 + 2e-4)) == pytest.approx(fps, rel=1e-15)
    slow = samples.motion(fps=fps)
    samples.write_bvh(tmp_path / "a.bvh", samples.rig(slow, scale=100))
    read = read_motion_file(tmp_path / "a.bvh").sequence
    assert read.fps == pytest.approx(fps, rel=1e-15)
    assert len(read) == len(slow)


@pytest.mark.parametrize("fps", [31.5, 0.2, 87.3, 28.77])
def test_a_rate_that_is_none_of_these_stays(fps):
    assert whole_rate(fps) == fps


# ---- samples of USD --------------------------------------------------------------------------------------------------


def test_usd_takes_the_rate_of_the_stage_where_samples_are_sparse(tmp_path, motion):
    from pxr import Usd

    samples.write_usd(tmp_path / "a.usda", samples.rig(motion))
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    take = stage.GetPrimAtPath("/Character/Skeleton/Take")
    for attribute in (take.GetAttribute("rotations"), take.GetAttribute("translations")):
        for code in set(range(40)) - {0, 5, 10, 20, 25, 26, 27, 39}:
            attribute.ClearAtTime(code)
    stage.Save()
    read = read_motion_file(tmp_path / "a.usda").sequence
    assert (len(read), read.fps) == (40, 30.0)
    assert np.abs(read.joints_m[[5, 26, 39]] - motion.joints_m[[5, 26, 39]]).max() < 2e-7


def test_a_usd_skeleton_without_a_rest_pose_is_a_whole_one(tmp_path, motion):
    from pxr import Usd, UsdSkel

    for with_tips in (True, False):
        path = tmp_path / f"{with_tips}.usda"
        samples.write_usd(path, samples.rig(motion, samples.MIXAMO_TIPS if with_tips else samples.MIXAMO))
        wanted = read_motion_file(path, MotionFormat()).sequence.joints_m
        stage = Usd.Stage.Open(str(path))
        skeleton = UsdSkel.Skeleton.Get(stage, "/Character/Skeleton")
        skeleton.GetRestTransformsAttr().Clear()
        stage.Save()
        assert np.abs(read_motion_file(path).sequence.joints_m - wanted).max() < 2e-7
        skeleton.GetBindTransformsAttr().Clear()
        stage.Save()
        # the first frame is no rest: tips that are made up lie elsewhere then
        assert np.isfinite(read_motion_file(path).sequence.joints_m).all()
