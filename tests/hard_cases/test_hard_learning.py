"""Learning from what is degenerate: hands, pictures and views that teach nothing must not break anything."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from painted_samples import camera_at, discs, painted_samples, sample_of, write_rgba
from small_hands import INFO, SMALL_MODEL, bones_of, joints_of, small_hand
from small_trainings import SMALL, parameters_of, small_training

from jghand_engine.errors import InputError
from jghand_engine.learn.guard import find_non_finite
from jghand_engine.learn.model import LearnedHand
from jghand_engine.learn.skinning import pose_skin, seen_from
from jghand_engine.study.stability_hands import hand_cases

ANISO = replace(SMALL_MODEL, anisotropic=True)
CASES = [case for case in hand_cases().values() if not case.name.startswith("units")]


def all_finite(tensors) -> bool:
    return all(bool(torch.isfinite(tensor).all()) for tensor in tensors)


# ---- hands -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def learned() -> LearnedHand:
    return small_hand(replace(ANISO, gaussians=60))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_degenerate_hand_teaches_finite_gradients(learned, case, dtype):
    """Features, network, skin, light and gloss of a hand that has learned something; to the joints, too."""
    joints_m = case.joints_m.clone().to(dtype).requires_grad_(True)
    bones = bones_of(joints_m, case.handedness)
    learned.zero_grad()
    avatar = learned.avatar(INFO, handedness=case.handedness)
    correction = learned.pose_net(bones.frames)
    eye_m = bones.root_m.detach() + torch.tensor([0.1, 0.2, 0.5], dtype=dtype)
    skin = pose_skin(avatar, bones, correction)
    drawn = seen_from(skin, eye_m, avatar)
    assert drawn.covariance_m2 is not None
    values = [drawn.position_m, drawn.sigma_m, drawn.rgb, drawn.opacity, drawn.covariance_m2]
    assert all_finite(values)
    torch.stack([value.sum().to(dtype) for value in values]).sum().backward()
    taught = [parameter.grad for parameter in learned.parameters() if parameter.grad is not None]
    assert len(taught) > 20
    assert joints_m.grad is not None
    assert all_finite([*taught, joints_m.grad])


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("joint", [0, 3, 20])
def test_joints_that_are_no_numbers_are_noticed_and_teach_nothing(monkeypatch, tmp_path, value, joint):
    """Neither loaders nor the training let one in; should one come all the same, the step changes nothing."""
    good = painted_samples(tmp_path, ("open",))
    training = small_training(monkeypatch, good)
    for sample in good:
        sample.joints_m[joint] = value
    with pytest.raises(InputError, match=re.escape(str(good[0].image))):
        small_training(monkeypatch, good)
    before = parameters_of(training)
    assert find_non_finite(training.step(0), training) != []
    assert [name for name, tensor in parameters_of(training).items() if not torch.equal(tensor, before[name])] == []


@pytest.mark.parametrize(
    "name", ["all joints at one point", "all joints on a line", "index folded back at its middle joint"]
)
def test_a_step_on_a_degenerate_hand_is_finite(monkeypatch, tmp_path, name):
    camera, joints_m = camera_at(), joints_of("open")
    picture = write_rgba(tmp_path / "hand.png", discs(camera, joints_m))
    sample = sample_of(picture, camera, hand_cases()[name].joints_m.numpy())
    training = small_training(monkeypatch, [sample])
    assert find_non_finite(training.step(0), training) == []
    assert all_finite(parameters_of(training).values())


# ---- the start -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("anisotropic", [False, True])
def test_the_first_step_from_offsets_of_length_zero_is_finite(monkeypatch, tmp_path, anisotropic):
    options = replace(SMALL, model=replace(SMALL_MODEL, anisotropic=anisotropic))
    training = small_training(monkeypatch, painted_samples(tmp_path, ("fist",)), options, moved=False)
    figures = training.step(0)
    assert figures["offset"] == 0
    assert find_non_finite(figures, training) == []
    assert all_finite(training.gradients().values())
    assert all_finite(training.tensors().values())


# ---- pictures and views ----------------------------------------------------------------------------------------------


def test_a_mask_of_one_pixel_can_be_learned_from(monkeypatch, tmp_path):
    """In every corner, at both strides."""
    camera, joints_m = camera_at(), joints_of("fist")
    for row, column in ((0, 0), (39, 47), (0, 47), (20, 24)):
        mask = np.zeros((40, 48), np.uint8)
        mask[row, column] = 255
        picture = write_rgba(tmp_path / f"{row}_{column}.png", mask)
        training = small_training(monkeypatch, [sample_of(picture, camera, joints_m)])
        for number, steps in ((0, 10), (9, 10)):
            training.plan(steps)
            assert find_non_finite(training.step(number), training) == []


def test_a_hand_beside_the_picture_teaches_nothing_but_harms_nothing(monkeypatch, tmp_path):
    """The mask says that there is a hand, the joints that it is elsewhere: a black picture with finite gradients."""
    joints_m = joints_of("fist") + np.array([3.0, 0.0, 0.0])
    mask = np.zeros((40, 48), np.uint8)
    mask[10:30, 10:30] = 255
    sample = sample_of(write_rgba(tmp_path / "beside.png", mask), camera_at(), joints_m)
    training = small_training(monkeypatch, [sample])
    _, ours = training._drawn(training._material.judged[0])
    assert not ours.any()
    figures = training.step(0)
    assert find_non_finite(figures, training) == []
    # what it cost is what the picture shows
    assert figures["mask"] > 0.05
    for name in ("irradiance", "lobe_raw_rgb", "raw_shadow_gain", "raw_lamps", "raw_bounced", "log_sigma"):
        gradient = training.gradients().get(name)
        assert gradient is None or not gradient.any()


@pytest.mark.parametrize("where", ["behind", "inside the hand"])
def test_a_camera_that_cannot_see_the_hand_harms_nothing(monkeypatch, tmp_path, where):
    joints_m = joints_of("fist")
    eye_m = joints_m.mean(0) if where == "inside the hand" else np.array([0.0, 0.09, 0.5])
    camera = camera_at(tuple(eye_m))
    if where == "behind":
        joints_m = joints_m + np.array([0.0, 0.0, 1.0])
    mask = np.full((40, 48), 255, np.uint8)
    sample = sample_of(write_rgba(tmp_path / "hand.png", mask), camera, joints_m)
    training = small_training(monkeypatch, [sample])
    assert find_non_finite(training.step(0), training) == []
    assert all_finite(parameters_of(training).values())


def test_a_picture_of_the_smallest_size_can_be_learned_from(monkeypatch, tmp_path):
    """22 x 22 pixels: half of it is as large as the window of SSIM."""
    camera = camera_at(size=(22, 22), focal_px=40.0)
    sample = sample_of(write_rgba(tmp_path / "small.png", np.full((22, 22), 255, np.uint8)), camera, joints_of("claw"))
    training = small_training(monkeypatch, [sample])
    training.plan(100)
    assert find_non_finite(training.step(0), training) == []
