"""The network of the pose: what it computes, how far it may go, and its prefixes."""

from dataclasses import replace

import pytest
import torch
from small_avatars import small_tensors
from small_hands import SMALL_NET, frames_of, stirred
from torch.nn import functional

from jghand_engine.avatar.correctives import SHADE_MAX, PoseNetShape, positional_encoding
from jghand_engine.learn.pose_net import PoseNet

AVATAR = small_tensors(60)


def net_of(shape: PoseNetShape = SMALL_NET, *, by: float = 0.4) -> PoseNet:
    net = PoseNet(AVATAR.bone_weights, AVATAR.uvd, shape)
    stirred(net, by=by)
    return net


def plain_network(net: PoseNet, frames, wave_weight=None) -> torch.Tensor:
    """(N, 6) of the network as METHOD 4.1 has it: encoding and each Gaussian's own mix of pose features side by side
    into one first layer."""
    encoding = torch.from_numpy(positional_encoding(AVATAR.uvd.numpy(), net.shape.octaves))
    if wave_weight is not None:
        encoding = encoding * wave_weight
    features = AVATAR.bone_weights @ net.angles(frames)
    first = torch.cat([net.encoding_in.weight, net.angles_in.weight], 1)
    hidden = functional.relu(torch.cat([encoding, features], 1) @ first.T + net.encoding_in.bias)
    return net.out(functional.relu(net.middle(hidden)))


@pytest.mark.parametrize("annealed", [False, True])
def test_the_split_first_layer_is_the_plain_network(annealed):
    net, frames = net_of(), frames_of("fist")
    weight = torch.linspace(0, 1, 2 * sum(SMALL_NET.octaves)) if annealed else None
    out = plain_network(net, frames, weight)
    got = net(frames, wave_weight=weight)
    # worst seen over 24 networks and poses: 1.7e-8 m and 8e-7
    torch.testing.assert_close(got.offset_m, SMALL_NET.reach_m * torch.tanh(out[:, :3]), atol=2e-8, rtol=0)
    torch.testing.assert_close(got.shade, SHADE_MAX * torch.tanh(out[:, 3:]), atol=9e-7, rtol=0)
    assert float(got.offset_m.detach().abs().mean()) > 1e-4


def test_no_weight_carries_an_offset_beyond_its_reach_nor_a_shade_beyond_its_limit():
    net = net_of(replace(SMALL_NET, reach_m=0.004), by=30.0)
    got = net(frames_of("claw"))
    for values, limit in ((got.offset_m, 0.004), (got.shade, SHADE_MAX)):
        # 0.004 in float32 is a little more than 0.004
        assert 0.99 * limit < float(values.detach().abs().max()) <= limit * (1 + 6e-8)


def test_a_network_without_shade_gives_none():
    net = net_of(replace(SMALL_NET, shaded=False))
    assert net.out.out_features == 3
    got = net(frames_of())
    assert got.shade.shape == (60, 3)
    assert not got.shade.any()
    assert got.offset_m.any()


# ---- prefixes --------------------------------------------------------------------------------------------------------


def test_a_prefix_says_the_same_of_the_first_gaussians():
    net, frames = net_of(), frames_of()
    whole = net(frames)
    for shorter in (net(frames, 17), net.prefix(17)(frames)):
        # no difference seen; a matrix product of another height may add up in another order
        torch.testing.assert_close(shorter.offset_m, whole.offset_m[:17], atol=2e-8, rtol=0)
        torch.testing.assert_close(shorter.shade, whole.shade[:17], atol=9e-7, rtol=0)


# ---- gradients -------------------------------------------------------------------------------------------------------


def test_gradients_of_every_parameter_are_those_of_finite_differences():
    shape = PoseNetShape(octaves=(1, 1, 1), angle_channels=2, angle_texels=2, hidden=4)
    avatar = small_tensors(6)
    net = PoseNet(avatar.bone_weights, avatar.uvd, shape)
    stirred(net)
    net, frames = net.double(), frames_of("relaxed")
    names = [name for name, _ in net.named_parameters()]

    def correction(*parameters: torch.Tensor) -> torch.Tensor:
        got = torch.func.functional_call(net, dict(zip(names, parameters, strict=True)), (frames,))
        return torch.cat([100 * got.offset_m, got.shade], 1)

    assert torch.autograd.gradcheck(correction, tuple(net.parameters()), eps=1e-6, atol=1e-5, rtol=1e-3)
