"""Torch's part of a training on another device than the CPU.

Where there is no other, torch's meta device stands in: its tensors have shapes and no values, and every operation is
looked at for tensors of two devices, as a GPU would refuse them.
"""

import contextlib
from dataclasses import replace
from typing import Any

import pytest
import torch
from painted_samples import painted_samples
from small_hands import INFO, SMALL_MODEL, bones_of, joints_of, small_hand
from small_trainings import SMALL, parameters_of, small_training
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from jghand_engine.cli import main
from jghand_engine.cli.learning import device_called
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.losses import offset_loss
from jghand_engine.learn.model import LearnedHand
from jghand_engine.learn.pose_features import octave_of_wave
from jghand_engine.learn.skinning import pose_skin, see_lamps, seen_from, skin_maps
from jghand_engine.learn.tensors import mapped

META = torch.device("meta")
MODELS = {
    "iso": SMALL_MODEL,
    "aniso": replace(SMALL_MODEL, anisotropic=True),
    "in its light": replace(SMALL_MODEL, lit=False, glossy=False),
}
# what may bring a tensor from one device to another
MOVES = ("_to_copy", "copy_")


class OneDevice(TorchDispatchMode):
    """Refuses operations on tensors of two devices; a number without axes on the CPU is at home everywhere."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None) -> Any:
        name = func.overloadpacket.__name__
        tensors = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, torch.Tensor)]
        devices = {tensor.device.type for tensor in tensors if tensor.dim() or tensor.device.type != "cpu"}
        if len(devices) > 1 and name not in MOVES:
            raise RuntimeError(f"{name}: two devices, {devices}")
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize("name", MODELS)
def test_nothing_of_a_step_mixes_devices_before_the_gaussians_come_to_the_cpu(monkeypatch, name):
    # plain numbers, which the meta device does not have
    monkeypatch.setattr(LearnedHand, "shadow_look", lambda self: None)
    # nor does it have autocast to be switched off
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: contextlib.nullcontext())
    hand, bones = small_hand(MODELS[name]), bones_of(torch.from_numpy(joints_of("claw")).float())
    maps = skin_maps(hand.points.bone_weights, bones)
    cast = hand.cast_shadow(1)
    with torch.no_grad():
        seen = None if cast is None else see_lamps(cast, bones)
    waves = octave_of_wave(SMALL_MODEL.pose.octaves).float().to(META)
    eye_m = torch.tensor([0.1, 0.2, 0.6], dtype=torch.float64)
    hand = hand.on(META)
    bones, maps = (mapped(one, lambda tensor: tensor.to(META)) for one in (bones, maps))
    seen = seen and mapped(seen, lambda tensor: tensor.to(META))
    with OneDevice():
        avatar = hand.avatar(INFO, handedness=Handedness.LEFT)
        correction = hand.pose_net(bones.frames, len(avatar), waves)
        gaussians = seen_from(pose_skin(avatar, bones, correction, maps=maps, seen=seen), eye_m, avatar)
        drawn = [gaussians.position_m, gaussians.sigma_m, gaussians.rgb, gaussians.opacity]
        drawn += [] if gaussians.covariance_m2 is None else [gaussians.covariance_m2]
        moved_m = avatar.position_m - hand.points.position_m
        terms = [offset_loss(moved_m, correction.offset_m, hand_size_m=0.18), hand.planes.roughness()]
        assert {part.device for part in [*drawn, *terms]} == {META}
        torch.stack([part.sum() for part in [*drawn, *terms]]).sum().backward()
        taught = [parameter.grad for parameter in hand.parameters() if parameter.grad is not None]
        assert len(taught) > 20
        assert {gradient.device for gradient in taught} == {META}
        hand.spread_radii(100, torch.zeros(len(hand.points) - 100, dtype=torch.long))


@pytest.mark.parametrize("name", ["cuda", "mps"])
def test_a_device_that_is_not_there_is_refused_before_anything_else(tmp_path, name, capsys):
    if torch.cuda.is_available() if name == "cuda" else torch.backends.mps.is_available():
        pytest.skip(f"there is {name}")
    assert main(["train", str(tmp_path / "nowhere"), "--out", str(tmp_path / "x.jghand"), "--device", name]) == 2
    assert "--device cpu" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA here")
def test_a_training_on_a_gpu_follows_that_on_the_cpu(monkeypatch, tmp_path):
    """And goes on with its state; sums in another order grow apart slowly."""
    samples = painted_samples(tmp_path, ("open", "fist"))
    here = small_training(monkeypatch, samples, SMALL)
    there = small_training(monkeypatch, samples, SMALL, device=torch.device("cuda"))
    for number in range(3):
        ours, theirs = here.step(number), there.step(number)
        assert theirs["loss"] == pytest.approx(ours["loss"], rel=1e-3)
    here.load_tensors({name: tensor.cpu() for name, tensor in there.tensors().items()})
    for name, tensor in parameters_of(there).items():
        assert torch.equal(parameters_of(here)[name], tensor.cpu())
    assert here.avatar().position_m.device == there.avatar().position_m.device


def test_a_device_that_was_never_tried_is_not_taken_unasked(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert device_called("auto") == torch.device("cpu")
    assert device_called("cuda") == torch.device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match="--device cpu"):
        device_called("cuda")
