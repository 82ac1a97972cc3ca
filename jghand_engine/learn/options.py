"""What decides what is learned: the model, the losses and the schedule. METHOD 4.2 and 4.3."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from jghand_engine.avatar.correctives import PoseNetShape
from jghand_engine.errors import InputError
from jghand_engine.hand.skeleton import Transform
from jghand_engine.learn.model import LightPart, ModelOptions, OffsetFrame
from jghand_engine.template.sampling import SHELL_DEPTH_MAX_M


@dataclass(frozen=True)
class LossWeights:
    """Of the terms of METHOD 4.3, and of the roughness of the feature planes (METHOD 4.2).

    tone:            of what the pose's shade colors all skin alike
    roughness:       of the identity planes
    angle_roughness: of the angle planes, whose texels that no pose touched would stay as random as they began
    """

    l1: float = 1.0
    ssim: float = 0.2
    perceptual: float = 0.0
    mask: float = 0.2
    offset: float = 0.1
    tone: float = 0.1
    roughness: float = 1e-4
    angle_roughness: float = 1e-4


@dataclass(frozen=True)
class Schedule:
    """Everything that changes while training; parts are of the planned steps, 0..1.

    views:           pictures of one pose per step; decoding once for all of them is what makes a step cheap
    rate:            learning rate of Adam for networks
    plane_rate:      the same for planes, radii and light
    last_part:       of both rates at the end, to which they fall exponentially
    settle_steps:    planned steps from which on they fall so far; the fewer are planned, the less they fall: what is
                     still far from its goal has nothing to settle
    warm_up_steps:   over which the rates rise
    warm_up_part:    of the planned steps, which that takes at most
    gradient_norm:   above which gradients are shortened; None: never
    levels:          (from part, part of the Gaussians) in rising order
    strides:         (from part, pixels averaged into one along each axis)
    waves:           (from part, to part) over which the octaves of the encoding come in; None: all from the start
    perceptual_from: part from which the perceptual term counts
    detail_from:     part from which detail is learned, where pictures have any (`learn.detail`); None: never
    texture_rate:    learning rate of its log ratios; a texel that is seldom seen goes ten times as far in a step
    """

    views: int = 3
    rate: float = 2e-3
    plane_rate: float = 1e-2
    last_part: float = 0.05
    settle_steps: int = 2000
    warm_up_steps: int = 50
    warm_up_part: float = 0.05
    gradient_norm: float | None = 1.0
    levels: tuple[tuple[float, float], ...] = ((0.0, 0.4), (0.5, 1.0))
    strides: tuple[tuple[float, int], ...] = ((0.0, 2), (0.08, 1))
    waves: tuple[float, float] | None = (0.0, 0.15)
    perceptual_from: float = 0.1
    detail_from: float | None = 0.6
    texture_rate: float = 3e-3


@dataclass(frozen=True)
class TrainOptions:
    """Everything that decides what is learned.

    model:          what is learned
    loss:           what counts as good
    schedule:       in which order
    shadow:         whether the screen-space self-shadow is part of the picture; the cast one is the model's
    printed_shadow: whether it has the paper's own form, in every pose, instead of that of METHOD 5.2 under its gate
    shadow_samples: its taps
    joint_noise_m:  standard deviation, along each axis, of an error of the joints in the angles that the pose's network
                    reads, new in every step; the bones stay exact. What the network adds then answers to the pose and
                    not to the last half millimeter of a joint
    transform:      how the bones follow the joints
    seed:           of all that is random
    """

    model: ModelOptions = field(default_factory=ModelOptions)
    loss: LossWeights = field(default_factory=LossWeights)
    schedule: Schedule = field(default_factory=Schedule)
    shadow: bool = True
    printed_shadow: bool = False
    shadow_samples: int = 16
    joint_noise_m: float = 5e-4
    transform: Transform = Transform.JOINTS
    seed: int = 0


# The paper's configuration as far as it says (METHOD 4.2); what it leaves open is as METHOD fills it in. What differs
# still: posed radii follow the skin (METHOD 2.8), pictures are cut to the hand, and the perceptual term is ST-LPIPS
# unless the user brings the trunk of LPIPS.
PAPER_FAITHFUL = TrainOptions(
    model=ModelOptions(
        gaussians=60_000,
        shell_depth_m=SHELL_DEPTH_MAX_M,
        area_power=0.0,
        depth_of_points=True,
        one_decoder=False,
        swing="euler",
        scale_mode="uniform",
        offset_frame=OffsetFrame.WORLD,
        pose=PoseNetShape(octaves=(6, 6, 6), level1=False, reach_m=0.005, shaded=False),
        opacity_bias=-2.2,
        lit=False,
        glossy=False,
        cast_shadow=False,
    ),
    loss=LossWeights(perceptual=0.2, offset=1.0, tone=0.0, roughness=0.0, angle_roughness=0.0),
    schedule=Schedule(
        views=1, rate=1e-3, plane_rate=1e-3, last_part=1.0, warm_up_steps=1, gradient_norm=None,
        levels=((0.0, 1.0),), strides=((0.0, 1),), waves=None, perceptual_from=0.0, detail_from=None,
    ),
    printed_shadow=True,
    shadow_samples=64,
    joint_noise_m=0.0,
)  # fmt: skip


def in_known_light(options: TrainOptions) -> TrainOptions:
    """The same for pictures whose light is known: how skin answers it is learned, and no light with the skin.
    InputError for options without the shadows that fingers cast."""
    if not options.model.cast_shadow:
        raise InputError("pictures in known light", wanted="the preset default", came="one without shadows of fingers",
                         remedy="Take --preset default, or pictures of a hand in one light.")  # fmt: skip
    return replace(options, shadow=False, model=replace(options.model, known_light=True, lit=False, glossy=False))


PRESETS = {"default": TrainOptions(), "paper-faithful": PAPER_FAITHFUL}


# of the ablation of known light, whose rows differ in light and not in detail
LIGHT_GAUSSIANS = 16_000
ONE_LIGHT = "one light"


def light_ablations(options: TrainOptions) -> dict[str, TrainOptions]:
    """The rows of the table of known light: a hand that learns one light for all pictures, hands that learn without a
    part of the light, and the whole. InputError as `in_known_light`."""
    few = replace(options, model=replace(options.model, gaussians=min(LIGHT_GAUSSIANS, options.model.gaussians)))
    full = in_known_light(few)
    rows = {f"w/o {part}": replace(full, model=replace(full.model, left_out=part)) for part in LightPart}
    return {ONE_LIGHT: few, **rows, "full": full}


def at_part(stages: tuple[tuple[float, float], ...], part: float) -> float:
    """The value of the last stage that has begun at `part` of the training."""
    return [value for start, value in stages if start <= part][-1]


def ablations(options: TrainOptions) -> dict[str, TrainOptions]:
    """The rows of the paper's ablation table, from the full configuration (PAPER 3), and two more of what the paper has
    not: the shadow that fingers cast, and joints that err while the pose's network learns."""
    rows = {
        "w/o trans": replace(options, transform=Transform.HALO_LIKE),
        "w/o screen shadow": replace(options, shadow=False),
        "w/o cast shadow": replace(options, model=replace(options.model, cast_shadow=False)),
        "w/o joint errors": replace(options, joint_noise_m=0.0),
        "w/o iso": replace(options, model=replace(options.model, anisotropic=True)),
        "full": options,
    }
    return {name: row for name, row in rows.items() if name == "full" or row != options}
