"""Damaged and malicious motion files of other programs: one sentence, soon, and little memory."""

from __future__ import annotations

import contextlib
import json

import motion_samples as samples
import numpy as np
import pytest

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.motion.content import MotionFormat
from jghand_engine.motion.read import read_motion_file

TOLD = MotionFormat(handedness=Handedness.RIGHT)


def _written(folder, kind):
    """A good file of a kind."""
    motion = samples.motion(frames=6)
    joints = samples.standard(motion)
    rig = samples.rig(motion)
    path = folder / f"motion.{kind.split()[0]}"
    if kind == "bvh":
        samples.write_bvh(path, rig)
    elif kind in ("usda", "usdc"):
        samples.write_usd(path, rig)
    else:
        content = {
            "json mediapipe": lambda: samples.mediapipe_tasks(joints),
            "json openpose": lambda: samples.openpose_frame(joints[0]),
            "json iwer": lambda: samples.iwer_recording(motion),
            "json webxr": lambda: {"frames": [{"right": frame} for frame in samples.webxr_joints(motion).tolist()]},
            "json interhand": lambda: samples.interhand_document(motion),
        }[kind]()
        path.write_text(json.dumps(content))
    return path


KINDS = (
    *("bvh", "usda", "usdc", "json mediapipe", "json openpose", "json iwer", "json webxr"),
    "json interhand",
)


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_cut_anywhere_is_an_input_error(tmp_path, kind):
    path = _written(tmp_path, kind)
    whole = path.read_bytes()
    assert len(read_motion_file(path, TOLD).sequence) >= 1
    # USD's text parser is slow, and its crate has its table of contents at the end
    for part in np.linspace(0, len(whole) - 2, 12 if kind.startswith("usd") else 40).astype(int):
        # the last digits of a text, or its last line end, are nothing that anybody could miss
        if kind in ("bvh", "usda") and part > len(whole) - 12:
            continue
        path.write_bytes(whole[:part])
        with pytest.raises(InputError, match="motion") as caught:
            read_motion_file(path, TOLD)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if not kind.startswith("usd")])
def test_flipped_bits_never_crash(tmp_path, kind):
    path = _written(tmp_path, kind)
    for broken in samples.flipped(path.read_bytes(), 120):
        path.write_bytes(broken)
        with contextlib.suppress(InputError):
            read_motion_file(path, MotionFormat(handedness=Handedness.RIGHT, check_hand=False))


HEAD = (
    "HIERARCHY\nROOT RightHand\n{\nOFFSET 0 0 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n"
    "End Site\n{\nOFFSET 0 1 0\n}\n}\n"
)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("HIERARCHY\n", "no MOTION"),
        (HEAD + "MOTION\nFrames: -3\nFrame Time: 0.033\n", "-3 frames"),
        (HEAD + "MOTION\nFrames: 900000\nFrame Time: 0.033\n1 2 3\n", "1 there"),
        (HEAD + "MOTION\nFrames: many\nFrame Time: 0.033\n", "many"),
        (HEAD + "MOTION\nFrames: 1\nFrame Time: nan\n1 2 3\n", "frame time"),
        (HEAD + "MOTION\nFrames: 2\nFrame Time: 0.033\n1 2 3\n1 2\n", "frame 1 has not the 3 numbers"),
        (HEAD + "MOTION\nFrames: 2\nFrame Time: 0.033\n1 2 3\n         \n", "2 frames declared, 1 there"),
        (HEAD + "MOTION\nFrames: 1\nFrame Time: 0.033\n1 x 3\n", "could not convert"),
        (HEAD + "MOTION\nFrames: 1\nFrame Time: 0.033\n1 nan 3\n", "no finite numbers"),
        (HEAD + "MOTION\nFrames: 1\nFrame Time: 0.033\n1 2 3\n", "a hand"),
        (HEAD.replace("3 X", "4 X"), "CHANNELS"),
        (HEAD.replace("OFFSET 0 1 0", "OFFSET 0 1"), "OFFSET"),
        (HEAD + "}\n", "brace too many"),
        ("HIERARCHY\nJOINT a\n", "JOINT"),
        ("HIERARCHY\nSCRIPT import os\n", "SCRIPT"),
    ],
)
def test_bvh_that_is_none_says_what_is_wrong(tmp_path, text, says):
    path = tmp_path / "motion.bvh"
    path.write_text(text)
    with pytest.raises(InputError, match=says):
        read_motion_file(path, TOLD)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000 + "]" * 100_000,
        '{"frames": ' + "[" * 100_000 + "]" * 100_000 + "}",
        '{"frames": [{"right": [[1e999, 0, 0]]}]}',
        json.dumps({"frames": [{"right": [[10**400, 0, 0]] * 21}]}),
        json.dumps(
            [{"worldLandmarks": [[{"x": "1", "y": 2, "z": 3}] * 21], "handedness": [[{"categoryName": "Right"}]]}]
        ),
        json.dumps([{"worldLandmarks": [[{"x": True, "y": 2, "z": 3}] * 21]}]),
        json.dumps([{"worldLandmarks": 5, "handedness": {"a": {}}}]),
        json.dumps({"people": [{"hand_right_keypoints_3d": [1, 2, 3]}]}),
        json.dumps({"schema": [[0, 1]], "frames": []}),
        json.dumps(
            {"schema": [[0, {"hasHand": True, "jointSequence": ["wrist"]}]], "frames": [[1] * 8 + [[0] * 8 + [[1]]]]}
        ),
        json.dumps({"0": {"1": {"world_coord": [[1, 2, 3]]}}}),
        json.dumps({"asset": {"version": "2.0"}}),
        '{"frames": [1, 2, 3]}',
        '{"frames": [{"right": [[0, 0, 0]]}]} trailing ]}',
    ],
)
def test_json_that_is_no_motion_is_an_input_error(tmp_path, text):
    path = tmp_path / "motion.json"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_motion_file(path, TOLD)
    assert len(str(caught.value)) < 700


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "empty"),
        (b"  \n ", "empty"),
        (b"Kaydara FBX Binary  \x00\x1a\x00", "FBX.*Blender"),
        (b"; FBX 7.4.0 project file", "FBX"),
        (b"BLENDER-v405", "blend"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "no motion file"),
        (b"just some text", "no motion file"),
        (b"PK\x03\x04nothing behind it", "not a zip file"),
        (b"PXR-USDC" + b"\x00" * 100, "motion"),
        (b"#usda 1.0\n(((", "motion"),
        (b"glTF" + b"\xff" * 100, "glTF is not read: export BVH or USD"),
        (b'{"asset": {"version": "2.0"}, "nodes": []}', "glTF is not read: export BVH or USD"),
    ],
)
def test_what_is_no_motion_at_all_is_named(tmp_path, content, says):
    path = tmp_path / "motion.any"
    path.write_bytes(content)
    with pytest.raises(InputError, match=says):
        read_motion_file(path, TOLD)


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(InputError, match="OpenPose"):
        read_motion_file(tmp_path, TOLD)
    with pytest.raises(InputError, match="absent"):
        read_motion_file(tmp_path / "absent.bvh", TOLD)


def test_openpose_frames_a_trillion_apart_are_refused(tmp_path):
    for number in (1, 10**12):
        (tmp_path / f"v_{number:012d}_keypoints.json").write_text('{"people": []}')
    with pytest.raises(InputError, match="frames from 1 to"):
        read_motion_file(tmp_path, TOLD)
