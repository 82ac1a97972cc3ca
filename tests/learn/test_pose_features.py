"""Joint angles become features: ranges, planes, the mix along the kinematic tree, the positional encoding."""

import math
from dataclasses import dataclass

import pytest
import torch
from small_hands import frames_of

from jghand_engine.avatar.correctives import PALM_NEIGHBOR_RANGES_DEG, PALM_PLANE_RANGES_DEG, positional_encoding
from jghand_engine.hand.kinematics import FRAME_RANGES_DEG
from jghand_engine.learn.pose_features import AnglePlanes, finger_angles, normalized, palm_angles

TEXELS = 5
RANGES = torch.from_numpy(FRAME_RANGES_DEG)
NEIGHBOR, PLANE = torch.tensor(PALM_NEIGHBOR_RANGES_DEG), torch.tensor(PALM_PLANE_RANGES_DEG)


@dataclass
class Angles:
    """Stands in for the frames of a hand that has exactly these angles, radians."""

    angles: torch.Tensor
    palm_p: torch.Tensor
    palm_n: torch.Tensor


def at_part(fingers: torch.Tensor, neighbor: torch.Tensor, plane: torch.Tensor) -> Angles:
    """Angles at these parts of their ranges: 0 the low end, 1 the high one."""

    def angle(ranges_deg: torch.Tensor, part: torch.Tensor) -> torch.Tensor:
        low, high = ranges_deg.double().unbind(-1)
        return torch.deg2rad(low + part * (high - low))

    return Angles(angle(RANGES, fingers), angle(NEIGHBOR, neighbor), angle(PLANE, plane))


def middle() -> Angles:
    return at_part(*(torch.full(size, 0.5, dtype=torch.float64) for size in ((15, 2), (4,), (3,))))


def random_angles(seed: int = 0) -> Angles:
    g = torch.Generator().manual_seed(seed)
    return at_part(*(torch.rand(size, dtype=torch.float64, generator=g) for size in ((15, 2), (4,), (3,))))


def planes_with(values: dict[int, float], *, level1: bool = True) -> AnglePlanes:
    """Planes that have one value everywhere: a number each, 0 where none is named."""
    planes = AnglePlanes(1, TEXELS, level1=level1)
    for index, value in values.items():
        planes.planes.data[index] = value
    return planes


# ---- ranges ----------------------------------------------------------------------------------------------------------


def test_ranges_become_minus_one_to_one():
    degrees = torch.tensor([[-30.0, 100.0], [0.0, 60.0]])
    for part, wanted in ((0.0, -1.0), (0.5, 0.0), (1.0, 1.0), (1.5, 2.0)):
        angle = torch.deg2rad(degrees[:, 0] + part * (degrees[:, 1] - degrees[:, 0]))
        torch.testing.assert_close(normalized(angle, degrees), torch.full((2,), wanted), atol=1e-6, rtol=0)


def test_every_finger_joint_has_its_own_range():
    part = torch.rand(15, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(4))
    hand = at_part(part, torch.zeros(4), torch.zeros(3))
    torch.testing.assert_close(finger_angles(hand), 2 * part - 1, atol=1e-12, rtol=0)
    # METHOD 4.1, in words: index PIP -10..115, pinky MCP abduction +-35, thumb -20..130
    angles = torch.zeros(15, 2, dtype=torch.float64)
    angles[6, 0], angles[4, 1], angles[0, 0] = math.radians(115), math.radians(-35), math.radians(130)
    ends = finger_angles(Angles(angles, hand.palm_p, hand.palm_n))
    assert [float(ends[6, 0]), float(ends[4, 1]), float(ends[0, 0])] == pytest.approx([1, -1, 1])


def test_metacarpals_read_the_angles_to_their_neighbors():
    """Finger f reads angle max(f - 1, 0) between palm bones and min(max(f - 1, 0), 2) between planes (METHOD 4.1)."""
    neighbor, plane = torch.tensor([0.1, 0.2, 0.3, 0.4]), torch.tensor([0.5, 0.6, 0.7])
    got = palm_angles(at_part(torch.zeros(15, 2), neighbor.double(), plane.double()))
    index = [max(finger - 1, 0) for finger in range(5)]
    wanted = torch.stack([2 * neighbor[index] - 1, 2 * plane[[min(k, 2) for k in index]] - 1], -1)
    torch.testing.assert_close(got.float(), wanted, atol=1e-6, rtol=0)


def test_ordinary_poses_lie_in_the_ranges_and_move_in_them():
    seen = torch.stack([torch.cat([finger_angles(f), palm_angles(f)]) for f in map(frames_of, ("open", "fist"))])
    # worst seen: 1.09, the pinky's PIP abduction in a fist
    assert float(seen.abs().max()) < 1.1
    bent = seen[1, :15, 0] - seen[0, :15, 0]
    assert float(bent[[1, 2, 3, 4, 6, 7, 8, 9]].min()) > 0.5


# ---- planes ----------------------------------------------------------------------------------------------------------


def test_the_angle_of_a_joint_weighs_half_a_quarter_an_eighth_an_eighth():
    """Of the tip's feature: its own angle 1/2, then 1/4, 1/8 and 1/8 (METHOD 4.1), for every finger apart."""
    hand = random_angles()
    for finger in range(5):
        for level, (plane, weights) in enumerate(
            [
                (0, (1.0, 0.5, 0.25, 0.125)),
                (1 + finger, (0.5, 0.25, 0.125)),
                (6 + finger, (0.5, 0.25)),
                (11 + finger, (0.5,)),
            ]
        ):
            got = planes_with({plane: 1.0})(hand)[:, 0]
            bones = [5 * step + 1 + finger for step in range(level, 4)]
            torch.testing.assert_close(got[bones], torch.tensor(weights))
            others = [bone for bone in range(1, 21) if bone % 5 != (1 + finger) % 5]
            if plane:
                assert not got[others].any()


def test_the_whole_hand_has_the_mean_of_the_metacarpals():
    planes = AnglePlanes(3, TEXELS, level1=True)
    torch.nn.init.normal_(planes.planes)
    features = planes(random_angles())
    assert features.shape == (21, 3)
    torch.testing.assert_close(features[0], features[1:6].mean(0))
    assert float(features[1:6].detach().std(0).min()) > 1e-3


def ramp(axis: int) -> AnglePlanes:
    """Every texel holds its own coordinate -1..1: that of flexion (0, along the columns) or of abduction (1)."""
    planes = AnglePlanes(1, TEXELS, level1=True)
    line = torch.linspace(-1, 1, TEXELS)
    planes.planes.data[:] = line if axis == 0 else line[:, None]
    return planes


@pytest.mark.parametrize("axis", [0, 1])
def test_planes_are_read_at_flexion_and_abduction(axis):
    hand = random_angles()
    features = ramp(axis)(hand)[:, 0]
    own, palm = finger_angles(hand)[:, axis].float(), palm_angles(hand)[:, axis].float()
    torch.testing.assert_close(features[1:6], palm, atol=1e-6, rtol=0)
    level = palm
    for first in (0, 5, 10):
        level = 0.5 * (level + own[first : first + 5])
        torch.testing.assert_close(features[6 + first : 11 + first], level, atol=1e-6, rtol=0)


@pytest.mark.parametrize("axis", [0, 1])
def test_beyond_the_border_the_features_stay_as_at_the_border(axis):
    planes = AnglePlanes(2, TEXELS, level1=True)
    torch.nn.init.normal_(planes.planes)
    for end, beyond in ((0.0, -0.4), (1.0, 1.7)):
        inside, outside = middle(), middle()
        for hand, part in ((inside, end), (outside, beyond)):
            low, high = RANGES[:, axis].unbind(-1)
            hand.angles[:, axis] = torch.deg2rad(low + part * (high - low))
            which, ranges = ("palm_p", NEIGHBOR) if axis == 0 else ("palm_n", PLANE)
            setattr(hand, which, torch.deg2rad((ranges[:, 0] + part * (ranges[:, 1] - ranges[:, 0])).double()))
        torch.testing.assert_close(planes(outside), planes(inside), atol=2e-6, rtol=0)
        assert float((planes(inside) - planes(middle())).detach().abs().max()) > 0.1


def test_metacarpals_may_stay_constant_as_in_the_paper():
    planes = AnglePlanes(2, TEXELS, level1=False)
    torch.nn.init.normal_(planes.planes)
    one, other = random_angles(1), random_angles(2)
    assert torch.equal(planes(one)[:6], planes(other)[:6])
    # ... with the value in the middle of their plane, which can still be learned
    torch.testing.assert_close(planes(one)[1], planes.planes[0, :, TEXELS // 2, TEXELS // 2])
    assert float((planes(one)[6:] - planes(other)[6:]).detach().abs().min()) > 0
    planes.level1 = True
    assert not torch.equal(planes(one)[:6], planes(other)[:6])


def test_gradients_of_the_planes_are_those_of_finite_differences():
    planes = AnglePlanes(2, 3, level1=True).double()
    torch.nn.init.normal_(planes.planes, generator=torch.Generator().manual_seed(5))
    hand = random_angles(3)
    assert torch.autograd.gradcheck(
        lambda texels: torch.func.functional_call(planes, {"planes": texels}, (hand,)), (planes.planes,)
    )


# ---- positional encoding ---------------------------------------------------------------------------------------------


def test_the_encoding_is_sine_and_cosine_octave_by_octave():
    uvd = torch.rand(7, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(6))
    octaves = (3, 1, 2)
    got = torch.from_numpy(positional_encoding(uvd.numpy(), octaves)).double()
    wanted = [
        [wave(2**k * math.pi * float(point[axis])) for axis in range(3) for k in range(octaves[axis])
         for wave in (math.sin, math.cos)]
        for point in uvd
    ]  # fmt: skip
    torch.testing.assert_close(got, torch.tensor(wanted, dtype=torch.float64), atol=3e-8, rtol=0)  # float32
