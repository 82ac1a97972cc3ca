"""From what is being learned to an avatar of plain numbers, which goes on living apart from it."""

import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from painted_samples import mirrored, painted_samples
from small_hands import SMALL_MODEL
from small_trainings import SMALL, small_training

from jghand_engine.captures.sample import Sample
from jghand_engine.hand.joints import LEVEL_NAMES, PARENTS, Handedness
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.step import HandTraining
from jghand_engine.template.builtin import load_template

ANISO = replace(SMALL, model=replace(SMALL_MODEL, anisotropic=True))
TRANSFORM = JointTransform(load_template().joints_m, handedness=Handedness.RIGHT)


@pytest.fixture(scope="module")
def samples(tmp_path_factory) -> list[Sample]:
    return painted_samples(tmp_path_factory.mktemp("painted"))


@pytest.fixture
def training(monkeypatch, samples) -> HandTraining:
    """Has learned something, with everything that there is to be learned."""
    return small_training(monkeypatch, samples, ANISO)


def tensors_in(record: object) -> dict[str, torch.Tensor]:
    """Every tensor of an avatar by its place, those of its network too."""
    if isinstance(record, torch.Tensor):
        return {"": record}
    if isinstance(record, torch.nn.Module):
        own = {**dict(record.named_parameters()), **dict(record.named_buffers())}
        return {f".{name}": tensor for name, tensor in own.items()}
    if not dataclasses.is_dataclass(record):
        return {}
    fields = ((field.name, getattr(record, field.name)) for field in dataclasses.fields(record))
    return {f".{name}{place}": tensor for name, value in fields for place, tensor in tensors_in(value).items()}


def arrays_in(record: object) -> dict[str, np.ndarray]:
    """Every array of an avatar by its place."""
    if isinstance(record, np.ndarray):
        return {"": record}
    if isinstance(record, dict):
        entries = list(record.items())
    elif dataclasses.is_dataclass(record):
        entries = [(field.name, getattr(record, field.name)) for field in dataclasses.fields(record)]
    else:
        return {}
    return {f".{name}{place}": array for name, value in entries for place, array in arrays_in(value).items()}


# ---- apart from the training -----------------------------------------------------------------------------------------


def test_learning_on_does_not_change_a_finished_avatar(training):
    avatar = training.avatar()
    assert tensors_in(avatar) == {}
    before = {name: array.copy() for name, array in arrays_in(avatar).items()}
    assert len(before) > 20
    for number in range(3):
        training.step(number)
    with torch.no_grad():
        for parameter in training.hand.parameters():
            parameter.fill_(0.77)
        for tensor in tensors_in(training.hand.points).values():
            tensor.fill_(0.5)
        for buffer in training.hand.buffers():
            buffer.zero_()
    after = arrays_in(avatar)
    assert [name for name in before if not np.array_equal(after[name], before[name])] == []


# ---- what it holds ---------------------------------------------------------------------------------------------------


def test_a_finished_avatar_is_the_hand_that_was_learned(training):
    saved, live = training.avatar(), training._live()
    ours, theirs = arrays_in(saved), arrays_in(live.avatar())
    assert set(ours) == set(theirs)
    assert [name for name in ours if not np.array_equal(ours[name], theirs[name])] == []
    assert (saved.learned.shadow, saved.learned.world_offsets) == (live.learned.shadow, live.learned.world_offsets)


def test_all_gaussians_are_saved_whatever_the_training_has_reached(training):
    training.load_scalars({"count": 40})
    assert len(training.avatar()) == 300


@pytest.mark.parametrize("shadow", [False, True])
def test_the_look_of_the_shadow_is_kept_where_it_was_learned(monkeypatch, samples, shadow):
    avatar = small_training(monkeypatch, samples, replace(SMALL, shadow=shadow)).avatar()
    assert avatar.learned is not None
    assert (avatar.learned.shadow is not None) is shadow


# ---- the ranges of the angles ----------------------------------------------------------------------------------------


def test_ranges_of_the_angles_are_those_of_the_poses(training, samples):
    angles = np.stack([TRANSFORM.frames(torch.from_numpy(s.joints_m)).angles.numpy() for s in samples[::3]])
    ranges = training.avatar().info.pose_statistics
    assert len(ranges) == 30
    for bone in range(6, 21):
        for k, name in enumerate(("flexion", "abduction")):
            # the angle at a joint is that of the bone which begins there
            low, high = ranges[f"{LEVEL_NAMES[PARENTS[bone]]} {name}"]
            assert low == pytest.approx(angles[:, bone - 6, k].min(), abs=1e-12)
            assert high == pytest.approx(angles[:, bone - 6, k].max(), abs=1e-12)
    # an open hand and a fist: in words
    low, high = ranges["index2 flexion"]
    assert low < math.radians(15)
    assert high > math.radians(85)


def test_ranges_of_a_left_hand_are_those_of_its_mirror_image(monkeypatch, samples, tmp_path, training):
    left = small_training(monkeypatch, [mirrored(sample, tmp_path) for sample in samples], ANISO)
    assert left.avatar().handedness is Handedness.LEFT
    ours, theirs = (one.avatar().info.pose_statistics for one in (training, left))
    assert list(ours) == list(theirs)
    assert np.array(list(theirs.values())) == pytest.approx(np.array(list(ours.values())))
