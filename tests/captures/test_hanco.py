"""HanCo: meters, eight cameras, one sequence of one person."""

import json
import shutil

import numpy as np
import picture_sets as sets
import pytest
from picture_sets import LEFT, RIGHT, write_hanco

from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.captures import CaptureChoice, Layout
from jghand_engine.captures.sample import MaskSource, load_image
from jghand_engine.errors import InputError
from jghand_engine.hand.orders import JointOrder, from_level


@pytest.fixture(scope="session")
def stored(tmp_path_factory):
    """Sequence 191 with two valid frames and two that are not; not to be changed."""
    return write_hanco(tmp_path_factory.mktemp("HanCo"))


@pytest.fixture
def changeable(stored, tmp_path):
    return shutil.copytree(stored, tmp_path / "HanCo")


def frame_file(folder, part, frame=0):
    return folder / part / "0191" / f"{frame:08d}.json"


def test_joints_project_where_eight_cameras_saw_them(stored):
    capture = open_capture(stored)
    assert (capture.layout, capture.handedness, capture.sequences) == (Layout.HANCO, RIGHT, ("0191",))
    assert capture.cameras == tuple(f"cam{c}" for c in range(8))
    assert len(capture.poses) == 2
    worst = 0.0
    for sample in capture.samples:
        view = sets.look(45.0 * int(sample.camera_name[-1]), 224, 224)
        truth = view.project(sets.pose(sample.frame))[0]
        worst = max(worst, float(np.abs(sample.camera.project(sample.joints_m)[0] - truth).max()))
    # no conversion but the order: exact
    assert worst == 0.0


def test_frames_that_are_not_valid_are_left_out_and_counted(stored):
    assert open_capture(stored).dropped == (("not valid", 16),)


def test_smeared_masks_are_cut_at_half(stored):
    capture = open_capture(stored)
    assert {one.mask_source for one in capture.samples} == {MaskSource.FILE}
    picture = load_image(capture.samples[0])
    assert set(np.unique(picture.mask)) == {0.0, 1.0}
    assert picture.mask.mean() == pytest.approx(sets._hanco_mask(0, 0).mean(), rel=0.01)


def test_a_hand_without_a_mask_file_gets_the_projected_template(changeable):
    shutil.rmtree(changeable / "mask_hand" / "0191" / "cam3")
    capture = open_capture(changeable)
    assert [one.camera_name for one in capture.samples if one.mask_source is MaskSource.TEMPLATE] == ["cam3"] * 2
    assert "2 of 16 images have no mask" in capture.notes[0]


@pytest.mark.parametrize("inside", [".", "rgb", "rgb/0191", "rgb/0191/cam2", "xyz/0191", ".."])
def test_folders_inside_and_around_are_understood(stored, tmp_path, inside):
    folder = shutil.copytree(stored, tmp_path / "only" / "HanCo") if inside == ".." else stored
    assert len(open_capture(folder / inside)) == 16


def test_of_many_sequences_one_must_be_named_in_any_spelling(tmp_path):
    write_hanco(tmp_path, (3, 191), frames=1)
    with pytest.raises(InputError, match="2 sequences, 0003 to 0191"):
        open_capture(tmp_path)
    for name in ("3", "0003"):
        assert open_capture(tmp_path, choice=CaptureChoice(sequences=(name,))).sequences == ("0003",)
    assert open_capture(tmp_path / "rgb" / "0003").sequences == ("0003",)
    assert open_capture(tmp_path, choice=CaptureChoice(sequences=("3", "191"))).sequences == ("0003", "0191")
    with pytest.raises(InputError, match="wanted 0004, got 0003, 0191"):
        open_capture(tmp_path, choice=CaptureChoice(sequences=("4",)))


def test_sequences_of_two_persons_are_not_mixed(tmp_path):
    write_hanco(tmp_path, (3, 4), frames=1, subjects={3: 1, 4: 2})
    with pytest.raises(InputError, match="subjects 1, 2"):
        open_capture(tmp_path, choice=CaptureChoice(sequences=("3", "4")))


def test_other_backgrounds_are_taken_where_the_recording_is_missing_and_that_is_said(changeable):
    (changeable / "rgb").rename(changeable / "rgb_merged")
    assert "rgb_merged" in open_capture(changeable).notes[-1]


@pytest.mark.parametrize("part", ["meta.json", "calib", "xyz", "rgb"])
def test_a_missing_part_is_named(changeable, part):
    target = changeable / part
    target.unlink() if target.is_file() else shutil.rmtree(target)
    with pytest.raises(InputError, match=part):
        open_capture(changeable)


def test_joints_in_millimeters_and_in_another_order_are_refused(changeable):
    for frame in range(2):
        frame_file(changeable, "xyz", frame).write_text(
            json.dumps((from_level(sets.pose(frame), JointOrder.STANDARD) * 1e3).tolist())
        )
    with pytest.raises(InputError, match="It looks like millimeters"):
        open_capture(changeable)
    for frame in range(2):
        frame_file(changeable, "xyz", frame).write_text(
            json.dumps(from_level(sets.pose(frame), JointOrder.INTERHAND).tolist())
        )
    with pytest.raises(InputError, match="order 'interhand'"):
        open_capture(changeable)


@pytest.mark.parametrize(
    ("part", "content", "named"),
    [
        ("xyz", [[0, 0, 0]] * 20, r"shape \(21, 3\)"),
        ("xyz", "nothing", r"shape \(21, 3\)"),
        ("xyz", [[None, 0, 0]] * 21, "wanted finite numbers"),
        ("calib", {"K": [], "M": []}, r"K in .*shape \(8, 3, 3\)"),
        ("calib", {"K": [[[1] * 3] * 3] * 8, "M": [0] * 8}, r"M in .*shape \(8, 4, 4\)"),
        ("calib", [], "a JSON object"),
    ],
)
def test_damaged_frames_are_named(changeable, part, content, named):
    frame_file(changeable, part).write_text(json.dumps(content))
    with pytest.raises(InputError, match=named):
        open_capture(changeable)
    heard = []
    # the other frame is still there
    assert len(open_capture(changeable, report=heard.append)) == 8
    assert str(frame_file(changeable, part).name) in str(heard[0])


def test_the_hand_may_be_said_to_be_a_left_one(stored):
    assert open_capture(stored, choice=CaptureChoice(handedness=LEFT)).handedness is LEFT
