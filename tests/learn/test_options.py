"""The options of a training: the paper's configuration, stages, and what the ablations leave out."""

from dataclasses import asdict, replace

import pytest

from jghand_engine.learn.model import OffsetFrame
from jghand_engine.learn.options import (
    PAPER_FAITHFUL,
    PRESETS,
    LossWeights,
    TrainOptions,
    Transform,
    ablations,
    at_part,
)
from jghand_engine.learn.work_folder import stamp_of


def differing(one, other, path: str = "") -> set[str]:
    """Names of the options in which the two differ."""
    if not isinstance(one, dict):
        return {path} if one != other else set()
    return set().union(*(differing(one[name], other[name], f"{path}.{name}".lstrip(".")) for name in one))


def test_the_paper_is_followed_where_it_says_something():
    """METHOD 4.2 and 4.3."""
    paper = PAPER_FAITHFUL
    assert (paper.model.gaussians, paper.model.swing, paper.model.scale_mode) == (60_000, "euler", "uniform")
    assert paper.model.offset_frame is OffsetFrame.WORLD
    assert not paper.model.anisotropic
    assert paper.model.area_power == 0  # as many for every bone
    model = paper.model
    assert (model.lit, model.glossy, model.pose.shaded, model.pose.level1) == (False, False, False, False)
    assert (paper.model.pose.octaves, paper.model.pose.hidden, paper.model.hidden) == ((6, 6, 6), 128, 128)
    assert (paper.model.pose.angle_channels, paper.model.pose.angle_texels) == (16, 16)
    assert (paper.model.plane_texels, paper.model.depth_texels) == (256, 32)
    assert (paper.model.identity_reach_m, paper.model.pose.reach_m, paper.model.opacity_bias) == (0.008, 0.005, -2.2)
    assert (paper.schedule.views, paper.schedule.rate, paper.schedule.plane_rate) == (1, 1e-3, 1e-3)
    assert paper.schedule.last_part == 1  # the rate does not fall
    assert (paper.shadow, paper.printed_shadow, paper.shadow_samples) == (True, True, 64)
    assert paper.joint_noise_m == 0
    assert paper.transform is Transform.JOINTS


def test_the_terms_have_the_papers_weights():
    ours = {"tone": 0.0, "roughness": 0.0, "angle_roughness": 0.0}
    assert PAPER_FAITHFUL.loss == LossWeights(l1=1.0, ssim=0.2, perceptual=0.2, mask=0.2, offset=1.0, **ours)


def test_a_stage_lasts_until_the_next_begins():
    stages = ((0.0, 0.4), (0.5, 0.7), (0.75, 1.0))
    values = [at_part(stages, part) for part in (0.0, 0.49, 0.5, 0.74, 0.75, 1.0)]
    assert values == [0.4, 0.4, 0.7, 0.7, 1.0, 1.0]


@pytest.mark.parametrize(
    ("row", "names"),
    [
        ("full", set()),
        ("w/o trans", {"transform"}),
        ("w/o screen shadow", {"shadow"}),
        ("w/o cast shadow", {"model.cast_shadow"}),
        ("w/o joint errors", {"joint_noise_m"}),
        ("w/o iso", {"model.anisotropic"}),
    ],
)
@pytest.mark.parametrize("preset", list(PRESETS))
def test_an_ablation_differs_in_nothing_but_what_it_leaves_out(preset, row, names):
    rows = ablations(PRESETS[preset])
    if row in ("w/o cast shadow", "w/o joint errors") and preset == "paper-faithful":
        assert row not in rows, "the paper has neither"
    else:
        assert differing(asdict(PRESETS[preset]), asdict(rows[row])) == names


@pytest.mark.parametrize(
    "change", [{"seed": 1}, {"shadow": False}, {"transform": Transform.HALO_LIKE}, {"loss": LossWeights(l1=0.9)}]
)
def test_a_training_goes_on_only_under_the_options_it_began_with(change):
    """Options are plain values that a stamp holds: another value is another stamp."""
    options = TrainOptions()
    assert stamp_of(options, []) == stamp_of(TrainOptions(), [])
    assert stamp_of(replace(options, **change), []) != stamp_of(options, [])
