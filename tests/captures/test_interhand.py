"""InterHand2.6M and our captures: every picture with its joints and its camera, whatever the folder looks like."""

import math
import shutil

import numpy as np
import picture_sets as sets
import pytest
from picture_sets import LEFT, RIGHT, edited, recorded, write_set

from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.captures import CaptureChoice, Layout
from jghand_engine.captures.interhand import read_interhand
from jghand_engine.captures.sample import MaskSource, load_image
from jghand_engine.errors import InputError
from jghand_engine.hand.orders import JointOrder, from_level


@pytest.fixture(scope="session")
def stored(tmp_path_factory):
    """A right hand as PNG with alpha; not to be changed."""
    return write_set(tmp_path_factory.mktemp("interhand"), recorded())


@pytest.fixture
def changeable(stored, tmp_path):
    return shutil.copytree(stored, tmp_path / "set")


def reprojection_error_px(sample, hand):
    """Largest distance between the joints as the loader's camera shows them and as the writer's does."""
    truth = hand.cameras[sample.camera_name].project(hand.joints_m[sample.frame])[0]
    return float(np.abs(sample.camera.project(sample.joints_m)[0] - truth).max())


@pytest.mark.parametrize("handedness", [RIGHT, LEFT])
def test_joints_of_either_hand_project_where_they_were_seen_in_portrait_and_landscape(handedness, tmp_path):
    hand = recorded(handedness)
    capture = open_capture(write_set(tmp_path, hand))
    assert (capture.layout, capture.handedness) == (Layout.INTERHAND, handedness)
    assert {(one.camera.width, one.camera.height) for one in capture.samples} == {(334, 512), (512, 334)}
    assert len(capture) == len(hand.boxes_px)
    # millimeters and back: 4e-13 px seen
    assert max(reprojection_error_px(sample, hand) for sample in capture.samples) < 1e-10


def test_poses_and_cameras_are_grouped_and_sorted(stored):
    capture = open_capture(stored)
    assert capture.poses == (("ROM_JGHAND", 2000), ("ROM_JGHAND", 2006))
    assert capture.cameras == ("400262", "400263")
    assert all(len(group) == 2 for group in capture.by_pose().values())
    assert [one.camera_name for one in capture.by_pose()[capture.poses[0]]] == list(capture.cameras)
    np.testing.assert_allclose(capture.joints_m()[1], sets.pose(1), atol=1e-15)


def test_the_hand_that_is_not_there_is_never_used(changeable):
    """Its places hold ones, or anything."""
    with edited(changeable, "joint_3d") as content:
        for entry in content["0"].values():
            entry["world_coord"][21:] = [[1e9, -3.0, 7.0]] * 21
    assert read_interhand(changeable).samples[0].joints_m == pytest.approx(sets.pose(0))
    with pytest.raises(InputError, match=r"none .right hand: 4"):
        read_interhand(changeable, CaptureChoice(handedness=LEFT))


def test_flags_of_joints_are_read_flat_and_nested(stored, tmp_path):
    flat = read_interhand(write_set(tmp_path, recorded(), joint_flags_flat=True))
    nested = read_interhand(stored)
    assert len(flat) == len(nested) == 4


@pytest.mark.parametrize("kind", ["data", "joint_3d"])
def test_a_picture_with_an_unknown_joint_is_left_out_and_counted(changeable, kind):
    tip_of_thumb = 0
    with edited(changeable, kind) as content:
        entry = content["annotations"][0] if kind == "data" else content["0"]["2000"]
        entry["joint_valid"][tip_of_thumb] = [0]
    hidden = 1 if kind == "data" else 2
    capture = read_interhand(changeable)
    assert (len(capture), capture.dropped) == (4 - hidden, (("not all 21 joints known", hidden),))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_joint_that_is_marked_as_valid_but_no_number_is_refused_by_its_frame(changeable, value):
    with edited(changeable, "joint_3d") as content:
        content["0"]["2000"]["world_coord"][5][1] = value
    with pytest.raises(InputError, match=r"2000 world_coord in .*: wanted finite numbers"):
        read_interhand(changeable)
    told = []
    assert len(read_interhand(changeable, report=told.append)) == 2
    assert len(told) == 2


def test_both_hands_in_a_set_must_be_told_apart_by_the_user(tmp_path):
    write_set(tmp_path, recorded(RIGHT), recorded(LEFT, sequence="ROM_LEFT", first_frame=3000))
    with pytest.raises(InputError, match="images of left and right hands"):
        read_interhand(tmp_path)
    assert read_interhand(tmp_path, CaptureChoice(handedness=LEFT)).sequences == ("ROM_LEFT",)
    assert read_interhand(tmp_path, CaptureChoice(sequences=("ROM_JGHAND",))).handedness is RIGHT


def test_pictures_of_two_hands_are_left_out(changeable):
    with edited(changeable, "data") as content:
        content["annotations"][0]["hand_type"] = "interacting"
    assert read_interhand(changeable).dropped == (("both hands", 1),)


def test_a_picture_whose_hand_is_doubtful_is_left_out(changeable):
    with edited(changeable, "data") as content:
        content["annotations"][2]["hand_type_valid"] = 0
    assert read_interhand(changeable).dropped == (("not sure which hand it is", 1),)


def test_the_mask_is_the_alpha_of_a_png_a_mask_file_or_else_the_template(stored, tmp_path):
    assert {one.mask_source for one in read_interhand(stored).samples} == {MaskSource.ALPHA}
    hand = recorded(suffix=".jpg")
    write_set(tmp_path, hand)
    without = read_interhand(tmp_path)
    assert {one.mask_source for one in without.samples} == {MaskSource.TEMPLATE}
    assert "not those of the papers' protocol" in without.notes[0]
    sets.write_masks(tmp_path, hand)
    capture = read_interhand(tmp_path)
    assert {one.mask_source for one in capture.samples} == {MaskSource.FILE}
    assert not capture.notes
    # the template is the truth of these pictures
    for source in (capture, without):
        picture = load_image(source.samples[0])
        assert picture.mask.mean() == pytest.approx(load_image(read_interhand(stored).samples[0]).mask.mean(), rel=0.01)
        assert picture.rgb[picture.mask == 1].mean(0) * 255 == pytest.approx(sets.SKIN, abs=3)
        assert not picture.rgb[picture.mask == 0].any()


# ---- folders --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("drop", ["all", "machine_annot", "human_annot", "."])
def test_older_arrangements_of_the_annotations_are_read(changeable, drop):
    target = changeable / "annotations" / drop
    target.mkdir(exist_ok=True)
    for file in (changeable / "annotations" / "train").iterdir():
        file.rename(target / file.name)
    (changeable / "annotations" / "train").rmdir()
    assert len(open_capture(changeable)) == 4


@pytest.mark.parametrize("inside", [".", "images", "images/train/Capture0/ROM_JGHAND/cam400262", "annotations/train"])
def test_a_folder_inside_the_set_is_understood(stored, inside):
    assert len(open_capture(stored / inside)) == 4


def test_a_folder_around_the_set_is_understood(tmp_path):
    write_set(tmp_path / "down" / "InterHand2.6M_5fps_batch1", recorded())
    assert len(open_capture(tmp_path)) == 4


def test_a_folder_around_two_sets_asks_for_one(tmp_path):
    for rate in (5, 30):
        write_set(tmp_path / f"InterHand2.6M_{rate}fps_batch1", recorded())
    with pytest.raises(InputError, match=r"InterHand2.6M_30fps_batch1, InterHand2.6M_5fps_batch1"):
        open_capture(tmp_path)
    assert len(open_capture(tmp_path / "InterHand2.6M_30fps_batch1")) == 4


def test_annotations_beside_the_batch_folder_are_found_as_the_avatar_papers_keep_them(changeable):
    batch = changeable / "InterHand2.6M_5fps_batch1"
    batch.mkdir()
    (changeable / "images").rename(batch / "images")
    (batch / "masks_removeblack" / "train").mkdir(parents=True)
    assert len(open_capture(changeable)) == 4
    assert len(open_capture(batch / "images" / "train" / "Capture0")) == 4


def test_a_set_of_several_persons_and_splits_asks_which_and_takes_the_folder_for_an_answer(tmp_path):
    write_set(tmp_path, recorded(split="test"), recorded(split="test", capture=1, sequence="ROM_1"))
    write_set(tmp_path, recorded(split="val"))
    with pytest.raises(InputError, match="annotations of val, test"):
        open_capture(tmp_path)
    with pytest.raises(InputError, match="2 captures: Capture0, Capture1"):
        open_capture(tmp_path, choice=CaptureChoice(split="test"))
    assert open_capture(tmp_path / "images/test/Capture1").sequences == ("ROM_1",)
    assert open_capture(tmp_path, choice=CaptureChoice("test", "Capture1")).sequences == ("ROM_1",)
    assert len(open_capture(tmp_path, choice=CaptureChoice("val"))) == 4
    for choice, named in (
        (CaptureChoice("test", "Capture7"), "those in .*: Capture0, Capture1"),
        (CaptureChoice("test", "Capture0", ("ROM_9",)), "ROM_JGHAND"),
        (CaptureChoice("train"), "split 'train'.*one of val, test"),
    ):
        with pytest.raises(InputError, match=named):
            open_capture(tmp_path, choice=choice)


def test_sequences_that_were_not_downloaded_are_left_out_and_counted(tmp_path):
    write_set(tmp_path, recorded(), recorded(sequence="ROM_2"))
    shutil.rmtree(tmp_path / "images/train/Capture0/ROM_2")
    capture = open_capture(tmp_path)
    assert (len(capture), capture.dropped) == (4, (("sequence not downloaded", 4),))
    shutil.rmtree(tmp_path / "images/train/Capture0/ROM_JGHAND")
    with pytest.raises(InputError, match="none of the 2 sequences"):
        open_capture(tmp_path)


@pytest.mark.parametrize("kind", ["data", "camera", "joint_3d"])
def test_a_missing_annotation_file_is_named(changeable, kind):
    file = changeable / f"annotations/train/InterHand2.6M_train_{kind}.json"
    file.unlink()
    with pytest.raises(InputError, match=rf"{kind}.json|_data.json"):
        open_capture(changeable)


def test_pictures_without_annotations_and_other_folders_are_named_as_what_they_are(stored, tmp_path):
    shutil.copytree(stored / "images", tmp_path / "set/images")
    with pytest.raises(InputError, match=r"images/, but no annotations/"):
        open_capture(tmp_path / "set")
    with pytest.raises(InputError, match="no such folder"):
        open_capture(tmp_path / "nowhere")
    (tmp_path / "holidays").mkdir()
    with pytest.raises(InputError, match="no folders"):
        open_capture(tmp_path / "holidays")
    with pytest.raises(InputError, match="a file"):
        open_capture(stored / "annotations/train/InterHand2.6M_train_data.json")


# ---- what would be silent -------------------------------------------------------------------------------------------


def listed(order, unit_per_m, hand=None):
    """Joints of the first two poses as a wrong file would list them."""
    return {
        str(frame): (from_level(np.array(joints), order) * unit_per_m).tolist()
        for frame, joints in (hand or recorded()).joints_m.items()
    }


def test_joints_listed_base_first_are_refused_and_their_order_is_named(changeable):
    wrong = listed(JointOrder.STANDARD, 1e3)
    with edited(changeable, "joint_3d") as content:
        for frame, entry in content["0"].items():
            entry["world_coord"][:21] = wrong[frame]
    with pytest.raises(InputError, match=r"joint_3d.json .joints read in interhand order.*order 'standard'"):
        open_capture(changeable)


@pytest.mark.parametrize(("unit_per_m", "name"), [(1.0, "meters"), (100.0, "centimeters")])
def test_joints_in_another_unit_are_refused_and_the_unit_is_named(changeable, unit_per_m, name):
    wrong = listed(JointOrder.INTERHAND, unit_per_m)
    with edited(changeable, "joint_3d") as content:
        for frame, entry in content["0"].items():
            entry["world_coord"][:21] = wrong[frame]
    with pytest.raises(InputError, match=rf"hand given in millimeters.*It looks like {name}"):
        open_capture(changeable)


def test_a_camera_that_is_no_rotation_is_refused(changeable):
    with edited(changeable, "camera") as content:
        content["0"]["camrot"]["400262"][0] = [1, 1, 0]
    with pytest.raises(InputError, match="rotation of camera 400262"):
        open_capture(changeable)
    with edited(changeable, "camera") as content:
        content["0"]["camrot"]["400262"] = np.diag([1.0, 1, -1]).tolist()
    with pytest.raises(InputError, match="a mirroring"):
        open_capture(changeable)


# ---- pictures -------------------------------------------------------------------------------------------------------


def first_picture(folder):
    return sorted(folder.rglob("image2000.png"))[0]


def test_a_missing_a_cut_off_and_a_resized_picture_are_found_on_opening(changeable):
    file = first_picture(changeable)
    whole = file.read_bytes()
    file.unlink()
    with pytest.raises(InputError, match=rf"{file.name}.*no such file"):
        open_capture(changeable)
    file.write_bytes(whole[:-30])
    with pytest.raises(InputError, match=r"cannot read the image .*image2000\.png"):
        open_capture(changeable)
    file.write_bytes(b"")
    with pytest.raises(InputError, match="cannot read the image"):
        open_capture(changeable)
    sets.write_picture(file, np.ones((256, 167), np.float32))
    with pytest.raises(InputError, match=r"wanted 334 x 512 pixels.*got 167 x 256"):
        open_capture(changeable)


def test_whoever_listens_gets_all_that_is_broken_and_the_rest_of_the_pictures(changeable):
    with edited(changeable, "joint_3d") as content:
        for entry in content["0"].values():
            entry["world_coord"][:21] = (np.array(entry["world_coord"][:21]) / 1000).tolist()
    first_picture(changeable).unlink()
    heard = []
    capture = open_capture(changeable, report=heard.append)
    assert (len(capture), capture.dropped) == (3, (("broken or missing", 1),))
    assert ["no such file" in str(heard[0]), "It looks like meters" in str(heard[1])] == [True, True]


def test_the_capture_of_other_scripts_is_read(shared_data):
    capture = open_capture(shared_data / "capture_old")
    assert (len(capture), len(capture.poses), len(capture.cameras)) == (360, 30, 12)
    assert capture.handedness is RIGHT
    assert not capture.dropped
    assert not capture.notes
    picture = load_image(capture.samples[100])
    assert picture.rgb.shape == (512, 334, 3)
    assert 0.02 < picture.mask.mean() < 0.3
