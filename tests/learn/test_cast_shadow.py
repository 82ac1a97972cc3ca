"""Shadows that fingers cast: which lamps a point of the skin sees past soft capsules, and what it loses with them."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from small_avatars import trained_tensors

from jghand_engine.avatar import learned
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.cast_task import FLESH_SOFTNESS, LAMP_HALF_WIDTH, LIGHT_TO_DISPLAY
from jghand_engine.avatar.learned import OWN_FLESH_RADII, bone_flesh, fitted_flesh, own_flesh
from jghand_engine.avatar.learned import lamp_directions as lamp_directions_of
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import PARENTS, Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.learn.cast_shadow import (
    CastTensors,
    LampsSeen,
    exponent,
    lamps_seen,
    past_capsule,
    place_anchors,
)
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.skinning import see_lamps

AVATAR = trained_tensors(300)
CAST: CastTensors = AVATAR.learned.cast  # type: ignore[union-attr,assignment]
CANONICAL_M = AVATAR.canonical_joints_m
FLESH = bone_flesh(CANONICAL_M.numpy())
EDGE = FLESH_SOFTNESS, LAMP_HALF_WIDTH


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def lamp_directions(count: int) -> torch.Tensor:
    return torch.from_numpy(lamp_directions_of(count))


def unit(vector: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.normalize(vector, dim=-1)


def bones_of(name: str, dtype: torch.dtype = torch.float64):
    joints_m = named_pose(name, CANONICAL_M.numpy(), handedness=AVATAR.handedness)
    return JointTransform(CANONICAL_M, handedness=AVATAR.handedness).bones(torch.from_numpy(joints_m).to(dtype))


# ---- lamps and capsules ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [2, 20, 64, 256])
def test_lamps_stand_all_around(count):
    direction = lamp_directions(count)
    torch.testing.assert_close(direction.norm(dim=1), torch.ones(count, dtype=torch.float64))
    # no side has more of them: an evenly lit sphere has no mean direction
    assert float(direction.mean(0).norm()) < 1.8 / count  # observed 1.73 / count for 2, 1.08 for more
    second = direction.T @ direction / count
    # observed 0.318 for 2, 0.025 for 20, less for more
    assert float((second - torch.eye(3) / 3).abs().max()) < (0.33 if count == 2 else 0.026)


def test_an_odd_number_of_lamps_has_no_mirror_image():
    with pytest.raises(InputError, match="an even number"):
        lamp_directions(7)


def least_distance(point: torch.Tensor, direction: torch.Tensor, start: torch.Tensor, end: torch.Tensor) -> float:
    """Between a ray and a segment, by brute force."""
    s = torch.linspace(0, 1, 4001, dtype=torch.float64)[:, None]
    spot = start + s * (end - start) - point
    t = (spot @ direction).clamp_min(0)[:, None]
    return float((spot - t * direction).norm(dim=1).min())


def test_rays_pass_a_capsule_as_far_as_they_truly_do():
    """Where the edge is: half of the light passes at a distance of one radius, all of it well beside, none inside."""
    start, end, radius = 0.1 * random(3, seed=1), 0.1 * random(3, seed=2), torch.tensor(0.03, dtype=torch.float64)
    point, direction = 0.3 * random(60, 3, seed=3), unit(random(40, 3, seed=4))
    passed = past_capsule(point, direction, start, end, radius, *EDGE)
    wrong = 0
    for a in range(60):
        for k in range(40):
            distance = least_distance(point[a], direction[k], start, end)
            if distance < 0.5 * float(radius):
                wrong += float(passed[a, k]) > 0.5
            if distance > 2.5 * float(radius) + 0.15 * 1.5:
                wrong += float(passed[a, k]) < 1.0
    # two rounds of projection do not find the least distance of every ray
    assert wrong <= 0.002 * 60 * 40, wrong


def test_a_ray_that_leaves_the_capsule_behind_passes_it():
    start, end = torch.tensor([0.0, -1.0, 0.0]).double(), torch.tensor([0.0, 1.0, 0.0]).double()
    point = torch.tensor([[0.5, 0.0, 0.0]]).double()
    towards, away = torch.tensor([[-1.0, 0.0, 0.0]]).double(), torch.tensor([[1.0, 0.0, 0.0]]).double()
    radius = torch.tensor(0.1).double()
    assert float(past_capsule(point, towards, start, end, radius, *EDGE)) == 0.0
    assert float(past_capsule(point, away, start, end, radius, *EDGE)) == 1.0


def test_edges_are_soft_and_widen_with_the_distance():
    start, end = torch.tensor([0.0, -9.0, 1.0]).double(), torch.tensor([0.0, 9.0, 1.0]).double()
    radius, up = torch.tensor(0.01).double(), torch.tensor([[0.0, 0.0, 1.0]]).double()
    beside = torch.linspace(0, 0.6, 601, dtype=torch.float64)

    def partly(height: float) -> int:
        point = torch.stack([beside, torch.zeros_like(beside), torch.full_like(beside, height)], -1)
        passed = past_capsule(point, up, start, end, radius, *EDGE)[:, 0]
        assert bool((passed.diff() >= 0).all())
        return int(((passed > 0) & (passed < 1)).sum())

    near, far = partly(0.8), partly(-1.0)
    assert 0 < near < far
    # half a lamp's width per meter of way
    assert far == pytest.approx(1e3 * (LAMP_HALF_WIDTH * 2.0 + 2e-3 + 0.01), abs=15)


# ---- what is one's own -----------------------------------------------------------------------------------------------


def test_flesh_is_ones_own_on_its_bone_and_not_elsewhere():
    own = torch.from_numpy(own_flesh(CAST.anchors.position_m.numpy(), FLESH))
    assert own.shape == (60, 20)
    start, end, radius_m = torch.from_numpy(FLESH).double().split([3, 3, 1], 1)
    for a, point in enumerate(CAST.anchors.position_m.double()):
        along = torch.linspace(0, 1, 201, dtype=torch.float64)[:, None, None]
        distance = (start + along * (end - start) - point).norm(dim=-1).amin(0) / radius_m[:, 0]
        near, far = OWN_FLESH_RADII
        assert bool((own[a][distance < near] == 1).all())
        assert bool((own[a][distance > far + 1e-4] == 0).all())


BUILTIN = load_builtin(handedness=Handedness.RIGHT)
SKIN_M = BUILTIN.learned.cast.anchors.position_m  # type: ignore[union-attr]
REST_M = BUILTIN.canonical_joints_m


def test_fitted_flesh_is_where_the_skin_is_and_none_of_it_in_the_forearm():
    fitted, along_bones, way = fitted_flesh(SKIN_M, REST_M), bone_flesh(REST_M), REST_M[3] - REST_M[0]
    skin_m = SKIN_M[(SKIN_M - REST_M[0]) @ way > 0].astype(np.float64)

    def off_m(flesh: np.ndarray) -> float:
        start, end, radius_m = np.split(flesh.astype(np.float64), [3, 6], 1)
        along = np.linspace(0, 1, 51)[:, None, None]
        distance_m = np.linalg.norm((start + along * (end - start))[:, None] - skin_m[:, None], axis=-1).min(0)
        return float(np.sqrt(np.square((distance_m - radius_m[:, 0]).min(1)).mean()))

    # observed 1.4 and 3.3 mm
    assert off_m(fitted) < 0.5 * off_m(along_bones)
    # no axis leaves its finger, nor the hand (observed 12 mm off, and 0.8 behind the wrist)
    ends_m = fitted[:, :6].reshape(-1, 3)
    assert np.linalg.norm(ends_m - along_bones[:, :6].reshape(-1, 3), axis=1).max() < 0.015
    assert ((ends_m - REST_M[0]) @ way / np.linalg.norm(way)).min() > -0.003


def test_flesh_has_found_its_place_when_it_is_taken(monkeypatch):
    fitted = fitted_flesh(SKIN_M, REST_M)
    monkeypatch.setattr(learned, "FIT_ROUNDS", learned.FIT_ROUNDS + 1)
    # observed 0.2 mm
    assert np.abs(fitted_flesh(SKIN_M, REST_M) - fitted).max() < 5e-4


def test_one_anchor_that_is_nowhere_moves_no_flesh():
    """And neither do bones without a length, or without skin, make numbers that are none."""
    lost = SKIN_M.copy()
    lost[::400] = [[0.4, 0.4, 0.4], [3e38, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0], [0, -0.4, 0], [0, 0.4, 0]]
    assert np.abs(fitted_flesh(lost, REST_M) - fitted_flesh(SKIN_M, REST_M)).max() < 1e-3
    for skin_m, joints_m in ((SKIN_M, np.zeros_like(REST_M)), (SKIN_M[:1], REST_M), (REST_M[:5], REST_M)):
        flesh = fitted_flesh(skin_m, joints_m)
        assert np.isfinite(flesh).all()
        assert (flesh[:, 6] > 0).all()
        assert np.isfinite(own_flesh(skin_m, flesh)).all()


# ---- the loss of light -----------------------------------------------------------------------------------------------


def seen_of(name: str, cast: CastTensors = CAST) -> LampsSeen:
    return see_lamps(cast, bones_of(name))


def test_a_fist_takes_more_light_than_a_flat_hand():
    """Also here, where the anchors lie in the flesh and look anywhere."""
    loss = {name: exponent(CAST, seen_of(name)) for name in ("flat", "fist")}
    assert bool((loss["fist"] <= 1e-6).all())
    # observed 1.89 times
    assert float(loss["fist"].mean()) < 1.8 * float(loss["flat"].mean())
    assert float(loss["fist"].min()) < -0.3


def test_only_the_hidden_lamp_and_its_color_are_missing():
    """Lamp 3 is red and hidden from everybody, lamp 5 is green and seen."""
    rgb = torch.zeros(20, 3, dtype=torch.float64)
    rgb[3, 0] = rgb[5, 1] = 1.0
    open_ = torch.rand(60, 20, dtype=torch.float64, generator=torch.Generator().manual_seed(5)) + 0.1
    seen = open_.clone()
    seen[:, 3] = 0.0
    bounced = torch.tensor([0.05, 0.02, 0.01], dtype=torch.float64)
    loss = exponent(replace(CAST, lamp_rgb=rgb, bounced_rgb=bounced), LampsSeen(open_, seen))
    alone = CAST.anchors.spread((0.05 / (open_[:, 3:4] + 0.05)).log() * LIGHT_TO_DISPLAY)
    torch.testing.assert_close(loss[:, :1], alone)
    assert not loss[:, 1:].any()


def test_the_shadow_is_that_of_a_hand_anywhere_and_of_any_size():
    joints_m = named_pose("fist", CANONICAL_M.numpy(), handedness=AVATAR.handedness)
    transform = JointTransform(CANONICAL_M, handedness=AVATAR.handedness)
    wanted = seen_of("fist")
    for moved_m in (joints_m + 1000.0, 1.3 * joints_m):
        got = see_lamps(CAST, transform.bones(torch.from_numpy(moved_m)))
        # observed 1.2e-11, a kilometer away
        torch.testing.assert_close(got.seen, wanted.seen, atol=4e-11, rtol=0)


def test_gradients_of_the_joints_are_those_of_differences():
    position, normal = 0.1 * random(4, 3, seed=7), unit(random(4, 3, seed=8))
    small = replace(CAST, lamp_rgb=torch.rand(4, 3), own=torch.zeros(4, 20), anchors=CAST.anchors.prefix(5))
    joints_m = CANONICAL_M + 0.01 * random(21, 3, seed=9)

    def loss(joints: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
        ends_m = torch.stack([joints[list(PARENTS[1:])], joints[1:]])
        seen = lamps_seen(small, points, normal, ends_m, torch.tensor(1.0).double())
        return ((seen.seen + 0.1) / (seen.open + 0.1)).log()

    inputs = (joints_m.requires_grad_(), position.requires_grad_())
    # the differences themselves are known to some 1e-7
    assert torch.autograd.gradcheck(loss, inputs, eps=1e-7, atol=1e-6)


def test_bones_of_no_length_cast_the_shadow_of_a_ball():
    point = torch.tensor([[0.0, 0.0, 0.0]]).double()
    center = torch.tensor([0.0, 0.0, 0.2], dtype=torch.float64, requires_grad=True)
    direction = lamp_directions(64)
    passed = past_capsule(point, direction, center, center, torch.tensor(0.05).double(), *EDGE)
    passed.sum().backward()
    assert bool(torch.isfinite(passed).all())
    assert bool(torch.isfinite(center.grad).all())
    hidden = direction[:, 2] > math.cos(math.asin(0.02 / 0.2))
    assert bool((passed[0, hidden] < 0.5).all())
    assert bool((passed[0, direction[:, 2] < 0.5] == 1).all())


# ---- spreading -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 3, 60])
def test_shares_are_whole_255ths_that_sum_to_one(count):
    anchors = place_anchors(AVATAR.position_m, random(300, 3).float(), AVATAR.bone_weights, count)
    assert len(anchors) == count
    units = 255 * anchors.share.double()
    assert float((units - units.round()).abs().max()) < 8e-6  # observed 7.6e-6: float32
    assert bool((units.round().sum(1) == 255).all())
    assert bool((anchors.share >= 0).all())
    torch.testing.assert_close(anchors.spread(torch.ones(count, 3)), torch.ones(300, 3))


def test_an_anchor_counts_most_where_it_stands_and_others_mix_their_nearest():
    anchors = CAST.anchors
    nearest, most = anchors.nearest[:60].gather(1, anchors.share[:60].argmax(1, keepdim=True)), torch.arange(60)
    assert torch.equal(nearest[:, 0], most)
    distance = torch.cdist(AVATAR.position_m, anchors.position_m)
    assert torch.equal(anchors.nearest.sort(1).values, distance.topk(3, largest=False).indices.sort(1).values)


def test_what_anchors_say_changes_without_a_step_on_the_way_over_the_skin():
    """Whatever anchors come and go: a third neighbor that became another at once made steps of a fifth."""
    grid = torch.stack(torch.meshgrid(torch.arange(8.0), torch.arange(8.0), torch.zeros(1), indexing="ij"), -1)
    skin = 4e-3 * (grid.reshape(64, 3).double() + 0.3 * random(64, 3) * torch.tensor([1, 1, 0]))
    way = torch.lerp(skin[9], skin[54], torch.linspace(0, 1, 4001).double()[:, None])
    every = torch.cat([skin, way])
    anchors = place_anchors(every, torch.ones_like(every), torch.zeros(len(every), 21), 64)
    steps = anchors.spread(random(64, 1).double())[64:].diff(dim=0).abs()
    assert float(steps.max()) < 0.05
