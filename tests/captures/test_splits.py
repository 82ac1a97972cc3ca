"""Which pictures are learned from: no picture twice, none lost, and the same ones on every machine."""

import json
from dataclasses import replace

import numpy as np
import pytest
from picture_sets import look, recorded, write_set

from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.captures import Capture, Layout
from jghand_engine.captures.sample import Sample
from jghand_engine.captures.splits import split_by_rule, split_capture
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness

VIEW = look(0.0, 64, 64)
JOINTS_M = np.zeros((21, 3))


def capture_of(folder, poses=10, cameras=12, sequences=("ROM_1",)):
    """A capture whose pictures nobody reads."""
    samples = tuple(
        Sample(folder / "x.png", VIEW, JOINTS_M, Handedness.RIGHT, "0", sequence, frame, f"{camera:02d}")
        for sequence in sequences
        for frame in range(poses)
        for camera in range(cameras)
    )  # fmt: skip
    return Capture("set", folder, Layout.INTERHAND, samples, Handedness.RIGHT)


def test_the_rule_holds_out_every_fifth_pose_of_a_sequence_and_every_sixth_camera(tmp_path):
    split = split_by_rule(capture_of(tmp_path, sequences=("ROM_1", "ROM_2")))
    assert {one.pose for one in split.novel_pose} == {(name, frame) for name in ("ROM_1", "ROM_2") for frame in (4, 9)}
    assert {one.camera_name for one in split.novel_view} == {"05", "11"}
    assert [len(kind) for kind in split.categories().values()] == [2 * 2 * 10, 2 * 8 * 2, 2 * 2 * 2]


def test_no_picture_is_lost_or_in_two_places_and_what_is_novel_was_not_learned(tmp_path):
    capture = capture_of(tmp_path)
    split = split_by_rule(capture)
    assert len({*split.train, *split.test}) == len(split.train) + len(split.test) == len(capture)
    poses, cameras = {one.pose for one in split.train}, {one.camera_name for one in split.train}
    for kind, pose_learned, camera_learned in (
        (split.novel_pose, False, True), (split.novel_view, True, False), (split.novel_both, False, False),
    ):  # fmt: skip
        assert all((one.pose in poses, one.camera_name in cameras) == (pose_learned, camera_learned) for one in kind)


def test_few_poses_or_cameras_are_not_held_out_and_the_rule_can_be_changed(tmp_path):
    capture = capture_of(tmp_path, poses=4, cameras=5)
    assert not split_by_rule(capture).test
    assert {one.camera_name for one in split_by_rule(capture, 9, 2).test} == {"01", "03"}


def test_a_protocol_holds_whole_sequences_out(tmp_path):
    capture = capture_of(tmp_path, sequences=("learn", "show", "neither"))
    split = split_capture(replace(capture, protocol="one", train_sequences=("learn",), test_sequences=("show",)))
    assert {one.sequence for one in split.train} == {"learn"}
    assert {one.sequence for one in split.test} == {"show"}
    assert list(split.categories()) == ["novel pose"]


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    return write_set(tmp_path_factory.mktemp("set"), recorded(frames=3, cameras=3))


@pytest.fixture
def folder(stored):
    """A set on disk, without a split of its own."""
    yield stored
    (stored / "splits.json").unlink(missing_ok=True)


def test_a_capture_brings_its_own_split(folder):
    (folder / "splits.json").write_text(
        json.dumps({"format": 1, "test_frames": {"ROM_JGHAND": [2006], "OTHER": [1]}, "test_cameras": ["400264"]})
    )
    split = split_capture(open_capture(folder))
    assert [len(part) for part in (split.train, split.novel_pose, split.novel_view, split.novel_both)] == [4, 2, 2, 1]
    assert "splits.json" in split.origin


def test_without_one_the_rule_is_taken(folder):
    assert "every 5th pose" in split_capture(open_capture(folder)).origin


@pytest.mark.parametrize(
    "content",
    [
        "{", "[]", "{}", '{"format": 2}', '{"format": 1, "test_cameras": [3]}', '{"format": 1, "test_frames": [1]}',
        '{"format": 1, "test_frames": {"ROM_JGHAND": ["2006"]}}', '{"format": 1, "test_frames": {"a": [true]}}',
        '{"format": 1, "test_cameras": ["400262", "400263", "400264"]}', "[" * 100_000,
    ],
)  # fmt: skip
def test_a_damaged_split_is_refused_by_name(folder, content):
    (folder / "splits.json").write_text(content)
    with pytest.raises(InputError, match=r"splits\.json"):
        split_capture(open_capture(folder))
