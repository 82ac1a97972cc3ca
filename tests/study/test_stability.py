"""The rows of the stability study hold their bounds, and chance finds no worse: see docs/STABILITY.md."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from jghand_engine.avatar.avatar import FOREARM_WAY
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.tiers import Tier
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import FrameFlag
from jghand_engine.learn.baselines import transform_of
from jghand_engine.study import stability_curves as curves
from jghand_engine.study.stability_hands import GRADIENT_MAX, NUDGE_M, HandCase, hand_cases, posed, template_size_m
from jghand_engine.study.stability_measures import (
    GAUSSIANS,
    PRECISION_MAX_M,
    SIGNS_MAX_M,
    SKIN_MAX_M,
    Skin,
    as_shown,
    correctives_row,
    hand_row,
    levers_of,
    measure,
    moved_mm,
    ours,
    posed_avatar,
    random_nudges,
    transform_for,
    worst_signs,
)
from jghand_engine.study.stability_scenes import SCENES, scene_row

RIGHT = Handedness.RIGHT
# of the study's seven, as each takes 4 s: the worst that are flagged, in precision, and that are not, in steadiness,
FAR_TESTED = (
    "random points that are no hand",
    "middle finger sideways, +90 degrees",
    "index folded back at its knuckle",
)
# and those that come nearest to the bound by what was learned: the shown tier moves skin by 2.09 and 2.28 mm of 2.6
NEAREST = ("ordinary: fist", "bones +50 % and -50 % in turn")
row_of = cache(lambda name: correctives_row(hand_cases()[name]))


@pytest.mark.parametrize("name", hand_cases())
def test_a_hard_hand_is_finite_exact_and_continuous(name):
    row = hand_row(hand_cases()[name])
    assert row.ours.finite
    assert row.ours.gradient <= GRADIENT_MAX
    assert row.ours.precision_mm <= 1e3 * PRECISION_MAX_M
    assert row.picture.good
    if row.flags:
        return
    assert row.ours.nudged_mm <= 1e3 * SKIN_MAX_M
    assert row.ours.signs_mm <= 1e3 * SIGNS_MAX_M


@pytest.mark.parametrize("name", SCENES)
def test_a_hard_picture_is_finite_and_like_the_reference(name):
    row = scene_row(SCENES[name])
    assert row.missed == []


@pytest.mark.parametrize("name", [*FAR_TESTED, *NEAREST])
def test_the_trained_hand_far_outside_training_is_finite_and_drawn_right(name):
    row = row_of(name)
    assert row.ours.finite
    assert row.picture.good
    assert row.ours.gradient <= GRADIENT_MAX
    assert row.ours.precision_mm <= 1e3 * PRECISION_MAX_M
    assert row.flags or row.ours.nudged_mm <= 1e3 * SKIN_MAX_M


@pytest.mark.parametrize("name", [FAR_TESTED[1], *NEAREST])
def test_the_trained_hand_is_steady_where_every_coordinate_is_off(name):
    signs_mm = row_of(name).ours.signs_mm
    assert row_of(name).flags == []
    assert signs_mm <= 1e3 * SIGNS_MAX_M


@pytest.mark.parametrize("name", ["ordinary: relaxed", "ordinary: fist"])
def test_on_ordinary_poses_bones_move_skin_little_whatever_the_signs(name):
    case, bones = hand_cases()[name], partial(ours, handedness=RIGHT)
    # METHOD 2.11; observed 1.83 and 1.87
    assert moved_mm(bones, case, worst_signs(bones, case)) <= 1e3 * SKIN_MAX_M


def test_the_worst_signs_are_the_worst_of_all_signs():
    """Of skin that hangs on nine coordinates alone, whose signs can all be tried."""
    case, generator = HandCase("linear", posed("relaxed")), torch.Generator().manual_seed(3)
    way = torch.randn(40, 3, 9, dtype=torch.float64, generator=generator)

    def skin(joints_m, dtype):
        # where the wrist is, is added to what a formulation answers
        return Skin((joints_m[:, 4:7].flatten(1) @ way.mT).swapaxes(0, 1), torch.zeros((), dtype=dtype))

    of_nine = torch.cartesian_prod(*9 * [torch.tensor([-1.0, 1.0], dtype=torch.float64)]).reshape(-1, 3, 3)
    every = torch.zeros(len(of_nine), 21, 3, dtype=torch.float64)
    every[:, 4:7] = of_nine
    found = worst_signs(skin, case)
    assert set(found[:, 4:7].unique().tolist()) == {-1.0, 1.0}
    found[:, 0] = 0
    assert moved_mm(skin, case, found) == pytest.approx(moved_mm(skin, case, every), rel=1e-9)


def test_the_trained_network_itself_keeps_to_the_bound():
    """The tier of the presets final and reference, by the form that trainings differentiate."""
    case, avatar = hand_cases()["ordinary: relaxed"], load_builtin(handedness=RIGHT).prefix(GAUSSIANS)
    transform = transform_of(avatar)

    def network(joints_m, dtype):
        with torch.no_grad():
            posed = [posed_avatar(avatar, transform, one).position_m for one in joints_m - joints_m[:, :1]]
        return Skin(torch.stack(posed).to(dtype), torch.zeros(()))

    levers = levers_of(avatar)
    assert moved_mm(network, case, worst_signs(network, case, levers), levers) <= 1e3 * SIGNS_MAX_M


def test_a_forearm_moves_as_the_end_of_a_lever_does_and_nothing_else_may():
    """What its skin may move grows with the way behind the wrist, and is the hand's own before it."""
    avatar = load_builtin(handedness=RIGHT)
    wrist_m, levers = avatar.canonical_joints_m[0], levers_of(avatar)
    behind_m = torch.from_numpy((avatar.position_m - wrist_m) @ FOREARM_WAY)
    assert float(levers[behind_m <= 0].max()) == 1
    # the forearm ends 13 cm behind the wrist, and the palm is 8 cm long
    assert 2.4 < float(levers.max()) < 2.8
    case = hand_cases()["ordinary: relaxed"]
    bare = replace(avatar, learned=replace(avatar.learned, correctives=None, distilled=None))
    shown = as_shown(bare)
    assert moved_mm(shown, case, worst_signs(shown, case)) > 1e3 * SIGNS_MAX_M
    assert moved_mm(shown, case, worst_signs(shown, case, levers), levers) <= 1e3 * SKIN_MAX_M


def test_a_trained_hand_is_nudged_as_it_is_shown():
    """All of its Gaussians by the tier that `auto` takes: one that trembles, and the linear tier, are seen."""
    case = hand_cases()["ordinary: relaxed"]
    avatar = load_builtin(handedness=RIGHT)
    learned = avatar.learned
    assert learned is not None
    assert learned.distilled is not None
    linear = learned.distilled.linear
    assert linear is not None
    assert learned.with_tier(Tier.AUTO)[0].correctives is linear
    constant = linear.constant.copy()
    constant[-1, :3] += 0.01
    moved = replace(
        avatar,
        learned=replace(learned, distilled=replace(learned.distilled, linear=replace(linear, constant=constant))),
    )
    before, after = (as_shown(one)(case.joints_m[None], torch.float64).skin[0] for one in (avatar, moved))
    apart_m = (after - before).norm(dim=-1)
    assert len(apart_m) == len(avatar)
    assert float(apart_m[-1]) > 0.01
    assert float(apart_m[:-1].max()) == 0


@pytest.mark.parametrize("curve", curves.CURVES, ids=lambda curve: curve.__name__)
def test_ours_stays_finite_and_harmless_up_to_the_singularity(curve):
    """But for the one place where it has to lose its twist, which is shown, too: there up to the flag."""
    measured = curve()
    assert np.isfinite(measured.ours).all()
    apart = curve is not curves.folded
    assert measured.ours[measured.distance > (0 if apart else 30)].max() <= measured.visible
    assert apart or measured.ours[-1] > 5 * measured.usual[-1]


# ---- chance ---------------------------------------------------------------------------------------------------------

quickly = settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
# coordinates that coincide, line up and nearly do so
coordinate = st.sampled_from([0.0, 1e-12, 1e-7, 1e-3, 0.02, 0.02 + 1e-9, 0.05, -0.05, 0.1]) | st.floats(-0.15, 0.15)


@quickly
@given(st.lists(coordinate, min_size=63, max_size=63))
@example([0.0] * 63)
@example([0.02 * (k % 3 == 0) for k in range(63)])
def test_any_21_points_give_finite_values_and_bounded_gradients(values):
    case = HandCase("found", torch.tensor(values, dtype=torch.float64).reshape(21, 3))
    way = partial(ours, handedness=RIGHT)
    for dtype in (torch.float32, torch.float64):
        joints_m = case.joints_m[None].clone().requires_grad_()
        answer = way(joints_m, dtype)
        (gradient,) = torch.autograd.grad(answer.loss, joints_m)
        assert torch.isfinite(answer.skin).all()
        assert torch.isfinite(gradient).all()
        if dtype is torch.float32:
            assert float(gradient.abs().max()) * case.size_m <= GRADIENT_MAX


angle = st.floats(-1.5, 1.5) | st.sampled_from([0.0, 1e-9, -1e-9, 1e-4, 1.5707963, -1.5707963])


@quickly
@given(st.lists(angle, min_size=15, max_size=15), st.floats(0.5, 1.5))
@example([0.0] * 15, 1.0)
@example([1.5707963] * 15, 0.5)
def test_a_nudge_moves_the_skin_little_wherever_the_frames_are_certain(bends, size):
    """Fingers bent by any angles, straight and right-angled ones among them."""
    base = posed("flat")
    joints_m = base.clone()
    for finger in range(5):
        frame = transform_for(RIGHT).frames(base).S[finger]
        turned = 0.0
        for level in range(3):
            bone, parent = 6 + 5 * level + finger, 1 + 5 * level + finger
            turned += bends[5 * level + finger] if level == 0 else abs(bends[5 * level + finger]) / 2
            turned = max(-1.5707964, min(turned, 3.0 if level else 1.5707964))
            along = np.cos(turned) * frame[:, 2] + np.sin(turned) * frame[:, 0]
            joints_m[bone] = joints_m[parent] + (base[bone] - base[parent]).norm() * along
    joints_m = size * joints_m
    nudge = NUDGE_M * size * random_nudges(8)
    batch = torch.cat([joints_m[None], joints_m + nudge])
    flags = transform_for(RIGHT).frames(batch).flags
    if bool((flags & int(FrameFlag.PALM_CLAMPED | FrameFlag.SWING_POLE | FrameFlag.NO_PALM)).any()):
        return
    skin = ours(batch, torch.float64, handedness=RIGHT).skin + batch[:, :1]
    moved_mm = 1e3 * float((skin[1:] - skin[0]).norm(dim=-1).max()) / size
    assert moved_mm <= 1e3 * SKIN_MAX_M


def test_the_measure_sees_what_is_wrong():
    """A formulation that is not finite, or jumps, does not pass."""
    way = partial(ours, handedness=RIGHT)

    def broken(joints_m, dtype):
        answer = way(joints_m, dtype)
        jump = torch.where(joints_m[:, 7, 2:] > float(posed("relaxed")[7, 2]), 0.01, 0.0)[:, None].to(dtype)
        return type(answer)(answer.skin + jump, answer.loss / (answer.loss - answer.loss))

    measured = measure(broken, hand_cases()["ordinary: relaxed"])
    assert not measured.finite
    assert measured.nudged_mm > 9
    assert template_size_m() == pytest.approx(0.171, abs=0.01)
