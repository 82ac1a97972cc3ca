"""The avatar papers' choice of pictures: each rule leaves out what it names, and nothing else."""

import json
import shutil
from typing import get_args, get_type_hints

import numpy as np
import picture_sets as sets
import pytest
from picture_sets import edited, recorded, write_hanco, write_set
from PIL import Image

from jghand_engine.captures.capture_folder import PROTOCOLS, open_capture
from jghand_engine.captures.captures import CaptureChoice
from jghand_engine.captures.sample import MaskSource, load_image
from jghand_engine.captures.splits import split_capture
from jghand_engine.errors import InputError

LEARN, SHOW, OTHER = "ROM04_RT_Occlusion", "ROM03_RT_No_Occlusion", "ROM01_No_Interaction"


@pytest.fixture(scope="session")
def stored(tmp_path_factory):
    """test/Capture0 with three sequences, JPEGs and masks; another person beside it. Not to be changed."""
    folder = tmp_path_factory.mktemp("InterHand2.6M_5fps_batch1")
    hands = [
        recorded(split="test", suffix=".jpg", sequence=name, first_frame=1000 * k, frames=2 if name == LEARN else 1)
        for k, name in enumerate((LEARN, SHOW, OTHER))
    ]
    write_set(folder, *hands, recorded(split="test", suffix=".jpg", sequence=LEARN, capture=1, frames=1))
    for hand in hands:
        sets.write_masks(folder, hand)
    return folder


@pytest.fixture
def changeable(stored, tmp_path):
    return shutil.copytree(stored, tmp_path / "set")


def first_picture(folder):
    return folder / f"images/test/Capture0/{LEARN}/cam400262/image0.jpg"


def opened(folder):
    return open_capture(folder, protocol="test-capture0")


def test_one_sequence_is_learned_and_another_shown_of_one_person(stored):
    capture = opened(stored)
    assert (capture.sequences, capture.protocol, capture.dropped) == ((SHOW, LEARN), "test-capture0", ())
    split = split_capture(capture)
    assert {one.sequence for one in split.train} == {LEARN}
    assert len(split.train) == 4
    assert {one.sequence for one in split.novel_pose} == {SHOW}
    assert len(split.test) == 2
    assert split.origin == "protocol test-capture0"
    assert {one.mask_source for one in capture.samples} == {MaskSource.FILE}


def test_the_sequence_that_is_shown_can_be_there_alone(changeable):
    shutil.rmtree(changeable / f"images/test/Capture0/{LEARN}")
    capture = opened(changeable)
    assert capture.sequences == (SHOW,)
    split = split_capture(capture, to_learn=False)
    assert (len(split.train), len(split.test)) == (0, 2)
    with pytest.raises(InputError, match="at least one image to learn from"):
        split_capture(capture)


def dark(picture):
    return np.minimum(picture, 15)


def gray(picture):
    return np.repeat(picture.mean(axis=2, keepdims=True).astype(np.uint8), 3, axis=2)


@pytest.mark.parametrize(("change", "reason"), [(dark, "dark"), (gray, "gray camera")])
def test_dark_pictures_and_gray_cameras_are_left_out(changeable, change, reason):
    file = first_picture(changeable)
    Image.fromarray(change(np.asarray(Image.open(file)))).save(file, quality=100, subsampling=0)
    assert opened(changeable).dropped == ((reason, 1),)
    # without the protocol they stay
    assert not open_capture(changeable, choice=CaptureChoice("test", "Capture0", (LEARN,))).dropped


@pytest.mark.parametrize(
    ("bbox", "reason"),
    [
        ([9.0, 50, 100, 100], "hand near the border"), ([50, 9.0, 100, 100], "hand near the border"),
        ([225, 50, 100, 100], "hand near the border"), ([50, 403, 100, 100], "hand near the border"),
        ([50, 50, 79.0, 79.0], "small hand"), ([50, 50, 20, 80.0], None), ([10, 10, 314, 492], None),
    ],
)  # fmt: skip
def test_small_hands_and_hands_near_the_border_are_left_out(changeable, bbox, reason):
    with edited(changeable, "data", "test") as content:
        content["annotations"][0]["bbox"] = bbox
    assert opened(changeable).dropped == (((reason, 1),) if reason else ())


def test_small_masks_and_dark_hands_are_left_out(changeable):
    mask = next((changeable / f"masks_removeblack/test/Capture0/{LEARN}/cam400262").glob("image0.png"))
    Image.fromarray(np.zeros((512, 334), np.uint8)).save(mask)
    assert opened(changeable).dropped == (("small mask", 1),)
    shown = np.zeros((512, 334), np.uint8)
    shown[:100, :100] = 255
    Image.fromarray(shown).save(mask)
    picture = np.asarray(Image.open(first_picture(changeable))).copy()
    picture[:110, :110] = (3, 10, 6)
    Image.fromarray(picture).save(first_picture(changeable), quality=95)
    assert opened(changeable).dropped == (("dark hand", 1),)


def test_frames_without_a_mano_fit_are_left_out_where_the_set_has_fits(changeable):
    fits = {"0": {"0": {"right": {"pose": [0] * 48}, "left": None}, "6": {"right": None, "left": None}}}
    (changeable / "annotations/test/InterHand2.6M_test_MANO_NeuralAnnot.json").write_text(json.dumps(fits))
    capture = opened(changeable)
    assert (len(capture), capture.dropped) == (2, (("no MANO fit", 4),))


def test_without_masks_the_lit_part_of_the_projected_template_stands_in_and_that_is_said(changeable):
    shutil.rmtree(changeable / "masks_removeblack")
    capture = opened(changeable)
    assert {one.mask_source for one in capture.samples} == {MaskSource.TEMPLATE_LIT}
    assert "not those of the papers' protocol" in capture.notes[0]
    sample = capture.samples[0]
    whole = load_image(sample).mask
    glaring = np.asarray(Image.open(sample.image)).copy()
    row, column = np.argwhere(whole > 0).mean(axis=0).astype(int)
    glaring[row - 8 : row + 8, column - 8 : column + 8] = 255
    Image.fromarray(glaring).save(sample.image, quality=95)
    lit = load_image(sample).mask
    assert lit[row, column] == 0
    assert 150 < whole.sum() - lit.sum() < 400


def test_a_picture_whose_mask_is_missing_while_others_have_theirs_is_left_out(changeable):
    (changeable / f"masks_removeblack/test/Capture0/{LEARN}/cam400262/image0.png").unlink()
    assert opened(changeable).dropped == (("no mask", 1),)


def test_sequence_0191_of_hanco_is_a_protocol(tmp_path):
    write_hanco(tmp_path, (3, 191), frames=1)
    capture = open_capture(tmp_path, protocol="hanco-0191")
    assert capture.sequences == ("0191",)
    assert {one.camera_name for one in split_capture(capture).test} == {"cam5"}
    with pytest.raises(InputError, match=r"wanted InterHand2.6M, got HanCo"):
        open_capture(tmp_path, protocol="val-capture0")


def test_unknown_protocols_and_a_choice_beside_one_are_refused(stored):
    with pytest.raises(InputError, match="test-capture0, test-capture1, val-capture0, hanco-0191"):
        open_capture(stored, protocol="mine")
    with pytest.raises(InputError, match="a protocol or a choice"):
        open_capture(stored, protocol="val-capture0", choice=CaptureChoice())
    with pytest.raises(InputError, match="split 'val'"):
        open_capture(stored, protocol="val-capture0")


def test_the_command_line_knows_all_protocols():
    from jghand_engine.cli.picture_sets import PictureSetOptions

    offered = get_args(get_type_hints(PictureSetOptions)["protocol"])[0]
    assert get_args(offered) == tuple(PROTOCOLS)
