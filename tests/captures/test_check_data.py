"""Each mistake that people make with a data set is told, in words that say what to do."""

import dataclasses
import shutil

import numpy as np
import picture_sets as sets
import pytest
from picture_sets import LEFT, edited, recorded, write_hanco, write_set
from PIL import Image

from jghand_engine.captures.check_data import check_data, facts
from jghand_engine.captures.masks import template_mask
from jghand_engine.captures.projection import joints_on_mask, overlay, part_on_mask
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.motion.choose import curl_towards_palm


@pytest.fixture(scope="session")
def stored(tmp_path_factory):
    """Three poses before six cameras; not to be changed."""
    return write_set(tmp_path_factory.mktemp("sound"), recorded(frames=3, cameras=6))


@pytest.fixture
def changeable(stored, tmp_path):
    return shutil.copytree(stored, tmp_path / "set")


def errors(report):
    return [finding.text for finding in report.findings if finding.is_error]


def test_a_sound_set_is_told_to_be_one(stored):
    ticks = []
    report = check_data(stored, tick=lambda done, total: ticks.append((done, total)))
    assert report.is_usable
    assert not report.findings
    assert ticks[-1] == (18, 18)
    told = facts(report)
    assert (told["pictures"], told["poses"], told["cameras"]) == (18, 3, 6)
    assert told["joints on the mask %"] == 100.0
    assert told["hand length mm"] == pytest.approx(177.5, abs=3)


def in_meters(camera):
    camera["campos"] = {name: [x / 1000 for x in place] for name, place in camera["campos"].items()}


def in_centimeters(camera):
    camera["campos"] = {name: [x / 10 for x in place] for name, place in camera["campos"].items()}


def of_opengl(camera):
    for name, rotation in camera["camrot"].items():
        camera["camrot"][name] = (np.diag([1, -1, -1]) @ rotation).tolist()


def transposed(camera):
    for name, rotation in camera["camrot"].items():
        camera["camrot"][name] = np.transpose(rotation).tolist()


def translation_as_place(camera):
    for name, place in camera["campos"].items():
        camera["campos"][name] = (-np.array(camera["camrot"][name]) @ place).tolist()


def of_larger_pictures(camera):
    for name in camera["focal"]:
        camera["focal"][name] = [4 * x for x in camera["focal"][name]]
        camera["princpt"][name] = [4 * x for x in camera["princpt"][name]]


def turned(camera):
    for name in camera["focal"]:
        camera["princpt"][name] = camera["princpt"][name][::-1]


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (in_meters, "look like meters where millimeters are due"),
        (in_centimeters, "look like centimeters where millimeters are due"),
        (of_opengl, "OpenGL's or Blender's"),
        (transposed, "rotations look transposed"),
        (translation_as_place, "mistaken for each other"),
        (of_larger_pictures, "images of another size"),
        (turned, "exchanged, or the images turned"),
    ],
)
def test_a_mistake_in_the_cameras_is_recognized(changeable, mistake, words):
    with edited(changeable, "camera") as content:
        mistake(content["0"])
    report = check_data(changeable)
    assert not report.is_usable
    assert "Joints do not project onto the hand" in errors(report)[0]
    assert words in errors(report)[0]


def test_matrices_of_hanco_that_are_inverted_are_recognized(tmp_path):
    import json

    write_hanco(tmp_path, frames=1)
    file = tmp_path / "calib/0191/00000000.json"
    content = json.loads(file.read_text())
    content["M"] = [np.linalg.inv(matrix).tolist() for matrix in content["M"]]
    file.write_text(json.dumps(content))
    assert "matrices look inverted" in errors(check_data(tmp_path))[0]


def test_pictures_that_belong_to_other_cameras_are_told_without_a_guess(changeable):
    for file in changeable.rglob("*.png"):
        sets.write_picture(file, np.roll(np.asarray(Image.open(file))[..., 3], 120, axis=1) / 255)
    assert "Check units, camera convention" in errors(check_data(changeable))[0]


def test_a_left_hand_under_the_name_of_a_right_one_is_told(tmp_path):
    write_set(tmp_path, recorded(LEFT, frames=3))
    with edited(tmp_path, "data") as content:
        for entry in content["annotations"]:
            entry["hand_type"] = "right"
            entry["joint_valid"] = entry["joint_valid"][::-1]
    with edited(tmp_path, "joint_3d") as content:
        for entry in content["0"].values():
            entry["world_coord"] = entry["world_coord"][21:] + entry["world_coord"][:21]
            entry["joint_valid"] = entry["joint_valid"][::-1]
    assert "is this a left hand?" in errors(check_data(tmp_path))[0]


def test_the_real_motion_of_a_right_hand_bends_like_one(shared_data):
    standard = np.load(shared_data / "real" / "human_joint_right.npy")
    from jghand_engine.hand.orders import to_level

    joints = to_level(standard, JointOrder.STANDARD)
    # 0.33 seen
    assert curl_towards_palm(joints, Handedness.RIGHT) > 0.3
    assert curl_towards_palm(joints, Handedness.LEFT) < -0.3
    assert curl_towards_palm(joints * np.nan, Handedness.LEFT) is None


def test_all_broken_pictures_are_told_in_one_go(changeable):
    files = sorted(changeable.rglob("*.png"))
    files[0].unlink()
    files[1].write_bytes(b"no picture")
    # its head and its end are whole, its middle is not: only the checksum tells
    whole = bytearray(files[2].read_bytes())
    whole[len(whole) // 2 : len(whole) // 2 + 40] = bytes(40)
    files[2].write_bytes(whole)
    told = errors(check_data(changeable))
    assert [any(file.name in text and file.parent.name in text for text in told) for file in files[:3]] == [True] * 3


def test_a_thousand_missing_pictures_are_not_a_thousand_lines(changeable):
    for file in sorted(changeable.rglob("*.png"))[:12]:
        file.unlink()
    sorted(changeable.rglob("*.png"))[0].write_bytes(b"no picture")
    told = errors(check_data(changeable))
    assert len(told) == 10
    # ... and do not hide what else is wrong
    assert [text for text in told if "more like these" in text] == ["… and 4 more like these."]
    assert sum("no such file" in text for text in told) == 8


def test_empty_masks_and_masks_of_the_whole_picture_are_told(changeable):
    files = sorted(changeable.rglob("*.png"))
    for part, value, words in ((0, 0, "masks are empty"), (1, 1, "cover nearly the whole image")):
        file = files[part]
        sets.write_picture(file, np.full(np.asarray(Image.open(file)).shape[:2], value, np.float32))
        assert any(words in finding.text for finding in check_data(changeable).findings)


def test_a_close_up_that_skin_fills_is_no_mask_of_the_whole_picture(tmp_path):
    hand = recorded(frames=3, cameras=2)
    # of the second pose alone, around the knuckle of the middle finger
    near = sets.look(0.0, 334, 512).scaled(8.0)
    knuckle = near.project(hand.joints_m[2006])[0][3]
    near = dataclasses.replace(near, width=96, height=96, cx=near.cx - knuckle[0] + 48, cy=near.cy - knuckle[1] + 48)
    boxes = {**hand.boxes_px, (2006, "400900"): (0.0, 0.0, 96.0, 96.0)}
    hand = dataclasses.replace(hand, cameras={**hand.cameras, "400900": near}, boxes_px=boxes)
    report = check_data(write_set(tmp_path, hand))
    assert not report.findings[:-1], "the split holds out nothing"
    told = facts(report)
    assert (told["pictures"], told["sizes"]) == (7, "334 x 512 (3), 512 x 334 (3), 96 x 96 (1)")
    assert told["mask covers % of close-ups"] > 95 > 3 * told["mask covers % of whole hands"]


def test_bones_that_change_their_length_are_told(changeable):
    with edited(changeable, "joint_3d") as content:
        joints = np.array(content["0"]["2000"]["world_coord"])
        # the index finger's last bone
        joints[4] += 0.5 * (joints[4] - joints[5])
        content["0"]["2000"]["world_coord"] = joints.tolist()
    report = check_data(changeable)
    assert any("bone's length varies by 2" in finding.text for finding in report.findings)


def test_a_set_without_masks_says_that_joints_cannot_be_held_against_pictures(tmp_path):
    write_set(tmp_path, recorded(suffix=".jpg"))
    report = check_data(tmp_path)
    assert report.is_usable
    assert "No image has a mask" in report.findings[0].text
    assert "joints on the mask %" not in facts(report)


def test_a_folder_that_is_no_data_set_is_a_finding_too(tmp_path):
    report = check_data(tmp_path)
    assert not report.is_usable
    assert report.capture is None
    assert facts(report) == {}
    assert "InterHand2.6M, HanCo or our own capture" in errors(report)[0]


def test_a_few_pictures_of_many_are_spread_over_the_set(stored):
    report = check_data(stored, most=6)
    assert [one.sample.frame for one in report.seen] == [2000, 2000, 2006, 2006, 2012, 2012]
    assert len(report.worst_and_typical(4)) == 4
    assert len({one.sample for one in report.worst_and_typical(99)}) == 6


def test_the_overlay_shows_the_joints_where_they_are_and_rings_those_beside_the_hand(changeable):
    report = check_data(changeable)
    sample = report.seen[0].sample
    picture = overlay(sample)
    assert picture.shape == (1024, 668, 3)
    wrist = sets.look(-40, 334, 512).project(sample.joints_m)[0][0]
    column, row = (2 * wrist).astype(int)
    assert picture[row, column].tolist() == [255, 255, 255]
    red = (picture == [255, 0, 0]).all(-1)
    assert not red.any()
    sets.write_picture(sample.image, np.zeros((512, 334), np.float32))
    assert (overlay(sample) == [255, 0, 0]).all(-1).sum() > 100


def test_joints_beyond_the_picture_tell_nothing_only_where_the_hand_reaches_its_border():
    view, joints = sets.look(0.0, 334, 512), np.array(sets.pose(0))
    mask = template_mask(view, joints, Handedness.RIGHT)
    assert joints_on_mask(view, joints, mask).tolist() == [1.0] * 21
    # the picture ends above the wrist and the thumb's first joint
    wrist_row = int(view.project(joints)[0][0, 1])
    cut = dataclasses.replace(view, height=wrist_row - 20)
    on = joints_on_mask(cut, joints, mask[: cut.height])
    assert np.isnan(on[0])
    assert part_on_mask(cut, joints, mask[: cut.height]) == 1.0
    # the same joints, but the hand in the picture ends before the border
    shrunk = np.where(np.arange(cut.height)[:, None] < cut.height - 40, mask[: cut.height], 0)
    assert joints_on_mask(cut, joints, shrunk)[0] == 0
