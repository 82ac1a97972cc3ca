"""One step of learning a hand: what it draws, in which order things come in, the terms of the loss, the update."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from painted_samples import mirrored, painted_samples
from small_hands import SMALL_MODEL
from small_trainings import SMALL, parameters_of, small_training

from jghand_engine.captures.sample import Sample
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.sequence import HandPose
from jghand_engine.learn.ablation import LiveHand
from jghand_engine.learn.baselines import HaloLikeTransform
from jghand_engine.learn.options import PAPER_FAITHFUL, LossWeights, TrainOptions, Transform
from jghand_engine.learn.step import HandTraining
from jghand_engine.learn.tensors import HandTensors
from jghand_engine.render.settings import RenderSettings

EVERYTHING = LossWeights(l1=1.0, ssim=0.2, perceptual=0.3, mask=0.2, offset=0.1, roughness=1e-2, angle_roughness=1e-2)


@pytest.fixture(scope="module")
def samples(tmp_path_factory) -> list[Sample]:
    """Three poses, three cameras."""
    return painted_samples(tmp_path_factory.mktemp("painted"))


@pytest.fixture
def build(monkeypatch, samples):
    """Makes trainings of the painted pictures."""

    def make(options: TrainOptions = SMALL, chosen: list[Sample] | None = None, **how) -> HandTraining:
        return small_training(monkeypatch, samples if chosen is None else chosen, options, **how)

    return make


def scheduled(**changes) -> TrainOptions:
    return replace(SMALL, schedule=replace(SMALL.schedule, **changes))


def drawn(training: HandTraining, numbers: range) -> list[list[str]]:
    """Names of the pictures of these steps."""
    return [[sample.image.name for sample in training._draw(number)] for number in numbers]


# ---- what is drawn ---------------------------------------------------------------------------------------------------


def test_what_a_step_draws_follows_from_seed_and_number(build):
    training = build()
    straight = drawn(training, range(24))
    # another training, asked in another order
    other = build()
    assert [drawn(other, range(number, number + 1))[0] for number in reversed(range(24))] == straight[::-1]
    assert drawn(build(replace(SMALL, seed=1)), range(24)) != straight


def test_pictures_of_a_step_are_of_different_cameras_and_all_cameras_have_their_turn(build):
    training = build()
    steps = [training._draw(number) for number in range(60)]
    assert all(len({sample.camera_name for sample in step}) == 2 for step in steps)
    for frame in range(3):
        firsts = [step[0].camera_name for step in steps if step[0].frame == frame]
        assert set(firsts) == {"front", "side", "back"}


def test_a_pose_with_fewer_cameras_than_wanted_gives_those_it_has(build, samples):
    few = [samples[0], *samples[3:]]
    training = build(scheduled(views=8), few)
    counts = {training._draw(number)[0].frame: len(training._draw(number)) for number in range(3)}
    assert counts == {0: 1, 1: 3, 2: 3}


@pytest.mark.parametrize("views", [1, 2, 3])
def test_an_epoch_shows_every_picture_once(build, samples, views):
    """Of three cameras two views leave one over: the pose's last step shows one of them again."""
    few = samples[1:]  # the first pose has a camera less
    training = build(scheduled(views=views), few)
    epoch = {1: 8, 2: 5, 3: 3}[views]
    for first in (0, epoch, 2 * epoch):
        names = [name for step in drawn(training, range(first, first + epoch)) for name in step]
        assert set(names) == {sample.image.name for sample in few}
        assert len(names) == 8 or views == 2
    assert drawn(training, range(epoch)) != drawn(training, range(epoch, 2 * epoch))


# ---- stages ----------------------------------------------------------------------------------------------------------


def test_levels_of_detail_only_rise(build):
    training = build(scheduled(levels=((0.0, 0.2), (0.3, 0.5), (0.6, 1.0))), moved=False)
    training.plan(10)
    counts = [training.step(number)["gaussians"] for number in (0, 1, 3, 5, 6)]
    assert counts == [60, 60, 150, 150, 300]
    # a time budget that turns out longer puts the step back into an earlier stage
    training.plan(1000)
    assert training.step(7)["gaussians"] == 300


def test_gaussians_that_join_have_the_growth_of_their_nearest(build):
    training = build(scheduled(levels=((0.0, 0.2), (0.5, 1.0))), moved=False)
    points = training.hand.points
    training._refine(0.0)
    growth = 0.1 * torch.randn(60, generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        training.hand.log_sigma[:60] += growth
    training._refine(0.5)
    apart = torch.cdist(points.position_m[60:].double(), points.position_m[:60].double())
    wanted = points.sigma_m[60:].log() + growth[apart.argmin(1)]
    torch.testing.assert_close(training.hand.log_sigma.detach()[60:], wanted, atol=1e-6, rtol=0)


def test_gaussians_that_wait_are_not_changed(build):
    training = build(scheduled(levels=((0.0, 0.2), (0.9, 1.0))), moved=False)
    training.plan(100)
    before = training.hand.log_sigma.detach().clone()
    for number in range(4):
        training.step(number)
    assert torch.equal(training.hand.log_sigma.detach()[60:], before[60:])
    assert not torch.equal(training.hand.log_sigma.detach()[:60], before[:60])


def test_pictures_get_finer(build):
    training = build(scheduled(strides=((0.0, 2), (0.4, 1))))
    training.plan(10)
    strides, view = [], training._pictures.view

    def noted(sample, stride=1, seed=None):
        strides.append(stride)
        return view(sample, stride, seed)

    training._pictures.view = noted  # type: ignore[method-assign]
    for number in (0, 3, 4, 9):
        training.step(number)
    assert strides == [2, 2, 2, 2, 1, 1, 1, 1]


def rates(training: HandTraining, number: int) -> tuple[float, float]:
    """Of networks and of planes, after step `number`."""
    training.step(number)
    slow, fast = (group["lr"] for group in training._optimizer.param_groups)
    return slow, fast


def test_rates_rise_at_first_and_fall_exponentially(build):
    training = build(scheduled(rate=2e-3, plane_rate=1e-2, last_part=0.04, warm_up_steps=5, settle_steps=100))
    training.plan(100)
    for number, factor in ((0, 1 / 5), (3, 4 / 5 * 0.04**0.03), (4, 0.04**0.04), (50, 0.2), (100, 0.04), (130, 0.04)):
        assert rates(training, number) == pytest.approx((2e-3 * factor, 1e-2 * factor))


def test_the_rates_of_a_short_plan_rise_within_a_twentieth_of_it_and_fall_the_less_the_shorter_it_is(build):
    """A tenth of the steps from which on they settle falls to the tenth root of what those fall to."""
    training = build(scheduled(rate=2e-3, last_part=0.05, settle_steps=1000))
    for planned, number, factor in ((100, 0, 1 / 5), (100, 100, 0.05**0.1), (500, 500, 0.05**0.5), (3000, 3000, 0.05)):
        training.plan(planned)
        assert rates(training, number)[0] == pytest.approx(2e-3 * factor)
    training.plan(3000)
    assert rates(training, 24)[0] == pytest.approx(2e-3 * 0.5, rel=0.05)


def test_octaves_of_the_encoding_come_in_one_after_the_other(build):
    """Of octaves (2, 2, 1), from 0.1 to 0.5 of the training: the first by 0.3, the second from there."""
    training = build(scheduled(waves=(0.1, 0.5)))
    weight = training._wave_weight
    first, second = ([0, 1, 4, 5, 8, 9], [2, 3, 6, 7])
    for part in (0.0, 0.05, 0.1):
        assert not weight(part).any()
    for part, low, high in ((0.2, 0.5, 0.0), (0.3, 1.0, 0.0), (0.4, 1.0, 0.5), (0.4999999, 1.0, 1.0)):
        got = weight(part)
        torch.testing.assert_close(got[first], torch.full((6,), low), atol=1e-6, rtol=0)
        torch.testing.assert_close(got[second], torch.full((4,), high), atol=1e-6, rtol=0)
    assert weight(0.5) is None
    assert weight(1.0) is None
    rising = torch.stack([weight(part) for part in np.linspace(0, 0.499, 60)])
    assert bool((rising.diff(dim=0) >= 0).all())
    # never a jump: half a cosine of 0.2 changes by at most pi / 2 * 0.4 / 59 / 0.2 between two of them
    assert float(rising.diff(dim=0).max()) < math.pi / 2 * 0.499 / 59 / 0.2 + 1e-6


def test_octaves_that_do_not_count_yet_are_not_learned(build):
    for waves, silent in (((0.0, 1.0), True), (None, False)):
        training = build(scheduled(waves=waves))
        training.plan(1000)
        training.step(0)
        gradient = training.gradients()["pose_net.encoding_in.weight"]
        assert bool((gradient == 0).all()) is silent


# ---- the loss --------------------------------------------------------------------------------------------------------


class Brightness:
    """Stands in for a perceptual metric."""

    def distance(self, rgb: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
        return (rgb.mean() - truth.mean()).square() + 0.01


def terms_of(training: HandTraining, samples: list[Sample], part: float = 1.0) -> dict[str, float]:
    views = [training._pictures.view(sample) for sample in samples]
    with torch.no_grad():
        training.hand.pose_net.out.bias[3:] = 0.1  # no pose shades anything before the first step
        return {name: float(term) for name, term in training._terms(samples[0], views, part).items()}


def test_every_term_counts_by_its_weight(build, samples):
    """Doubling a weight doubles its term and leaves the others."""
    plain = terms_of(build(replace(SMALL, loss=EVERYTHING), perceptual=Brightness()), samples[3:5])
    assert set(plain) == {"l1", "ssim", "perceptual", "mask", "offset", "tone", "roughness", "angle_roughness"}
    assert all(value > 0 for value in plain.values())
    for name in plain:
        doubled = replace(EVERYTHING, **{name: 2 * getattr(EVERYTHING, name)})
        got = terms_of(build(replace(SMALL, loss=doubled), perceptual=Brightness()), samples[3:5])
        assert got == pytest.approx({**plain, name: 2 * plain[name]})


def test_the_loss_is_the_sum_of_its_terms(build):
    figures = build(replace(SMALL, loss=EVERYTHING), perceptual=Brightness()).step(0)
    terms = {name: value for name, value in figures.items() if name not in ("loss", "gaussians", "gradient")}
    assert len(terms) == 7  # the perceptual one comes later
    assert figures["loss"] == pytest.approx(sum(terms.values()))


def test_the_perceptual_term_comes_when_it_is_time(build, samples):
    training = build(replace(SMALL, loss=EVERYTHING), perceptual=Brightness())
    late = training.options.schedule.perceptual_from
    assert "perceptual" not in terms_of(training, samples[:1], late - 1e-6)
    assert "perceptual" in terms_of(training, samples[:1], late)


def test_offsets_are_measured_as_part_of_the_hand(build, samples):
    """METHOD 4.3: both offsets, over wrist to middle tip of the canonical hand."""
    training = build(replace(SMALL, loss=replace(EVERYTHING, offset=1.0)))
    joints_m = training.hand.points.joints_m
    size_m = float(torch.linalg.vector_norm(joints_m[18] - joints_m[0]))
    assert 0.15 < size_m < 0.22
    with torch.no_grad():
        avatar = training._live()
        pose_m = training.hand.pose_net(training._posed_bones(samples[0]).bones.frames).offset_m
        identity_m = avatar.position_m - training.hand.points.position_m
        wanted = (identity_m.norm(dim=1).mean() + pose_m.norm(dim=1).mean()) / size_m
    # the smooth length lacks at most a hundredth of a millimeter
    assert terms_of(training, samples[:1])["offset"] == pytest.approx(float(wanted), abs=2e-5 / size_m)


def test_errors_of_the_joints_reach_the_pose_network_alone(build, samples):
    """New ones in every step, the same ones in the same step; the bones stay where they are."""
    still, shaken = build(replace(SMALL, joint_noise_m=0.0)), build(replace(SMALL, joint_noise_m=5e-4))
    assert still._read_frames(samples[0], 7) is None
    first, again, other = (shaken._read_frames(samples[0], number) for number in (7, 7, 8))
    exact = shaken._posed_bones(samples[0]).bones.frames
    assert torch.equal(first.angles, again.angles)
    for frames in (first, other):
        # half a millimeter is a degree or two
        assert 0.2 < math.degrees(float((frames.angles - exact.angles).square().mean().sqrt())) < 4
    assert not torch.equal(first.angles, other.angles)
    posed, avatar = shaken._posed_bones(samples[0]), shaken._live()
    with torch.no_grad():
        plain, noisy = (shaken._pose(avatar, posed, 1.0, read)[0].matt.position_m for read in (None, first))
        shaken.hand.pose_net.out.weight.zero_()
        shaken.hand.pose_net.out.bias.zero_()
        bare = [shaken._pose(avatar, posed, 1.0, read)[0].matt.position_m for read in (None, first)]
    assert not torch.equal(plain, noisy)
    assert torch.equal(*bare)


# ---- the update ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("anisotropic", [False, True])
def test_a_step_moves_every_parameter(build, samples, anisotropic):
    """Of a fist, where the shadow is; only what no camera sees may stay."""
    options = replace(SMALL, model=replace(SMALL_MODEL, anisotropic=anisotropic), loss=EVERYTHING)
    training = build(options, [sample for sample in samples if sample.frame == 1])
    assert training._posed_bones(samples[3]).shadow > 0.5
    training.plan(1)
    before = parameters_of(training)
    training.step(1)
    stayed = [name for name, tensor in parameters_of(training).items() if torch.equal(tensor, before[name])]
    assert stayed == []
    assert all(bool(torch.isfinite(gradient).all()) for gradient in training.gradients().values())


def test_without_shadow_nothing_of_it_is_learned(build, samples):
    training = build(replace(SMALL, shadow=False), samples[3:6])
    training.step(0)
    assert not set(training.gradients()) & {"raw_shadow_gain", "raw_shadow_tint"}


def test_the_papers_preset_has_its_own_shadow_in_every_pose_and_no_cast_one(build, samples):
    """The open hand of the first pose is below the gate. Offset, color and opacity have networks of their own."""
    model = replace(PAPER_FAITHFUL.model, gaussians=300, plane_texels=12, depth_texels=4, hidden=10)
    options = replace(PAPER_FAITHFUL, model=model, shadow_samples=8)
    training = build(options)
    posed = training._posed_bones(samples[0])
    assert posed.seen is None
    assert (posed.shadow, build()._posed_bones(samples[0]).shadow) == (1, 0)
    learned = training.avatar().learned
    assert learned.cast is None
    assert learned.shadow.printed
    assert not build().avatar().learned.shadow.printed
    assert [decoder[-1].out_features for decoder in training.hand.decoders] == [3, 3, 1]
    training.plan(4)
    training.step(0)
    assert training.hand.raw_shadow_tint.grad.abs().sum() > 0
    assert training.hand.raw_shadow_gain.grad is None, "V = 1 - S has no gain"
    # what the training shows is what `jghand evaluate` draws of the avatar
    view, ours = training._drawn(samples[0])
    drawn = LiveHand(training.avatar(), RenderSettings(shadow_samples=8))
    rgba = drawn(samples[0].joints_m, samples[0].handedness, view.camera)
    np.testing.assert_allclose(rgba[..., :3], ours.numpy(), atol=2e-5)


def test_the_shadow_of_a_small_hand_comes_with_the_same_poses_as_that_of_a_large_one(build):
    training = build()
    canonical_m = training._points.joints_m.numpy()
    for name, strength in (("open", 0.0), ("fist", 1.0)):
        joints_m = named_pose(name, canonical_m, handedness=Handedness.RIGHT)
        for scale in (0.5, 1.0, 2.0):
            assert training._new_posed_bones(HandPose(scale * joints_m)).shadow == pytest.approx(strength, abs=1e-6)


def test_long_gradients_are_shortened(build):
    training = build(scheduled(gradient_norm=1e-3))
    figures = training.step(0)
    norm = torch.stack([gradient.norm() for gradient in training.gradients().values()]).norm()
    assert figures["gradient"] > 1e-3
    assert float(norm) == pytest.approx(1e-3, rel=1e-3)
    free = build(scheduled(gradient_norm=1e9))
    figures = free.step(0)
    norm = torch.stack([gradient.norm() for gradient in free.gradients().values()]).norm()
    assert float(norm) == pytest.approx(figures["gradient"], rel=1e-4)


def test_a_gradient_that_is_not_finite_changes_nothing(build):
    training = build()
    training.step(0)
    before = {name: tensor.clone() for name, tensor in training.tensors().items()}
    training.hand.raw_rim.register_hook(lambda gradient: gradient * math.nan)
    figures = training.step(1)
    assert math.isnan(figures["gradient"])
    assert [name for name, tensor in training.tensors().items() if not torch.equal(tensor, before[name])] == []


# ---- conventions -----------------------------------------------------------------------------------------------------


def test_a_left_hand_is_learned_like_its_mirror_image(build, samples, tmp_path):
    """At its first step, where the lamps stand symmetrically still."""
    # at stride 2 the odd line is dropped at the right of both
    options = replace(scheduled(strides=((0.0, 1),)), shadow=False)
    right = build(options, samples, moved=False)
    left = build(options, [mirrored(sample, tmp_path) for sample in samples], moved=False)
    ours, theirs = right.step(0), left.step(0)
    # worst seen over four seeds: 1.6e-7 of a figure
    assert theirs == pytest.approx(ours, rel=3e-7)


def test_the_ablation_follows_the_joints_in_its_own_way(build, samples):
    plain, halo = (build(replace(SMALL, transform=transform)) for transform in Transform)
    assert not isinstance(plain._transform, HaloLikeTransform)
    assert isinstance(halo._transform, HaloLikeTransform)
    # of a hand of other proportions; of the canonical bones both make the same
    sample = replace(samples[3], joints_m=samples[3].joints_m * np.array([1.1, 0.9, 1.0]))
    maps = [training._posed_bones(sample).maps.offset_m for training in (plain, halo)]
    assert float((maps[0] - maps[1]).abs().max()) > 1e-3


def test_the_fixed_view_stands_beside_the_truth(build, samples):
    training = build()
    picture = training.preview()
    height, width = training._pictures.view(samples[0]).rgb.shape[:2]
    assert picture.shape == (height, 2 * width, 3)
    assert 0 <= picture.min() <= picture.max() <= 1
    truth, ours = picture[:, :width], picture[:, width:]
    assert np.array_equal(truth, training._pictures.view(samples[0]).rgb.numpy())
    error = float(((truth.astype(np.float64) - ours) ** 2).mean())
    assert training.fixed_psnr() == pytest.approx(-10 * math.log10(error), abs=1e-4)


def test_what_is_shown_and_saved_early_is_what_is_being_learned(build, samples):
    """Octaves that have not come in yet have random weights: they are left out, not added as noise."""
    training = build(scheduled(waves=(0.0, 1.0)), samples[3:6])
    training.plan(10)
    training.step(3)
    frames, weight = training._posed_bones(samples[3]).bones.frames, training._wave_weight(0.3)
    with torch.no_grad():
        learned, all_waves = training.hand.pose_net(frames, None, weight), training.hand.pose_net(frames)
        saved = HandTensors.of(training.avatar()).learned.correctives(frames)
    torch.testing.assert_close(saved.offset_m, learned.offset_m, atol=2e-8, rtol=0)
    assert float((saved.offset_m - all_waves.offset_m).abs().max()) > 1e-3
    shown = training.fixed_psnr()
    # a training that goes on from there shows the same, before its next step
    again = build(scheduled(waves=(0.0, 1.0)), samples[3:6])
    again.load_tensors(training.tensors())
    again.load_scalars(training.scalars())
    assert again.fixed_psnr() == shown
    training.load_scalars({**training.scalars(), "part": 1.0})
    assert training.fixed_psnr() != shown


def test_looking_at_the_fixed_view_changes_nothing(build):
    one, other = build(), build()
    for training in (one, other):
        training.step(0)
    one.preview()
    one.fixed_psnr()
    one.avatar()
    assert one.step(1) == other.step(1)
