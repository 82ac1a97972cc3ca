"""Shadows that the fingers cast on the hand, in the light that the hand was learned in.

The distant light is a set of lamps all around, in fixed directions of the world, each with a learned color. A point of
the skin loses those that a bone's flesh, a soft capsule, stands before:

    exponent = LIGHT_TO_DISPLAY * log( (sum_k color_k max(n.w_k, 0) seen_k + bounced)
                                       / (sum_k color_k max(n.w_k, 0) + bounced) )

It is added to the exponent of `light.lit`: the harmonics say how bright a lone surface is, the lamps what is missing.
What skin throws back onto skin is the same everywhere, and learned too; it is redder than the lamps.
Soft shadows change little over a few millimeters, so this is computed at anchors and spread to the Gaussians by fixed
weights. What a bone hides in the canonical pose from the skin around it is in the colors already, and left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from jghand_engine.avatar.cast_task import (
    BOUNCED_MIN,
    CAPSULE_SINE2_MIN,
    CAPSULE_WIDTH_MIN_M,
    FLESH_SOFTNESS,
    LAMP_HALF_WIDTH,
    LIGHT_TO_DISPLAY,
    Capsules,
)
from jghand_engine.avatar.learned import (
    ANCHOR_NEIGHBORS,
    CAPSULE_LENGTH2_MIN,
    SHARE_UNITS,
    Anchors,
    CastShadow,
    lamp_directions,
    mixed_of,
)
from jghand_engine.learn.light import smooth
from jghand_engine.learn.planes import weighted_rows


@dataclass(frozen=True)
class AnchorTensors(Anchors[Tensor]):
    def spread(self, values: Tensor) -> Tensor:
        """(N, C) at the Gaussians of values (A, C) at the anchors."""
        return weighted_rows(values, self.nearest.T, self.share.T.to(values.dtype))


def place_anchors(position_m: Tensor, normal: Tensor, bone_weights: Tensor, count: int) -> AnchorTensors:
    """Anchors at the first `count` of N canonical points, whose every prefix covers the hand.

    position_m: (N, 3), normal: (N, 3) unit, bone_weights: (N, 21)
    """
    count = min(count, len(position_m))
    tree = KDTree(position_m[:count].double().numpy())
    around = list(range(1, min(ANCHOR_NEIGHBORS + 1, count) + 1))
    distance_m, nearest = tree.query(position_m.double().numpy(), k=around)  # type: ignore[arg-type]
    nearest, share = mixed_of(np.asarray(nearest), distance_m)
    # eight bits, as a file holds them: what is drawn from the file is what was learned
    share = np.rint(SHARE_UNITS * share)
    share[:, 0] += SHARE_UNITS - share.sum(1)
    return AnchorTensors(
        position_m[:count].float(),
        normal[:count].float(),
        bone_weights[:count].float(),
        torch.from_numpy(nearest),
        torch.from_numpy(share / SHARE_UNITS).float(),
    )


@dataclass(frozen=True)
class CastTensors(CastShadow[Tensor]):
    anchors: AnchorTensors


@dataclass(frozen=True)
class LampsSeen:
    """What anchors see of the lamps in one pose. open: (A, K) cosine towards each, 0 and up, as if nothing stood
    before it · seen: (A, K) the same times the part 0..1 that is seen"""

    open: Tensor
    seen: Tensor


def lamps_seen(
    shadow: CastTensors,
    position_m: Tensor,
    normal: Tensor,
    ends_m: Tensor,
    hand_scale: Tensor,
    others: Capsules | None = None,
) -> LampsSeen:
    """position_m, normal: (A, 3) of the posed anchors · ends_m: (2, 20, 3) of the posed flesh · hand_scale: () ·
    others: the flesh of hands beside this one, all in one frame."""
    direction = torch.from_numpy(lamp_directions(len(shadow.lamp_rgb))).to(normal)
    cosine = (normal @ direction.T).clamp_min(0)
    flesh = Flesh.of(shadow, ends_m, hand_scale, others)
    return LampsSeen(
        cosine, cosine * past_flesh(Skin(position_m, normal), flesh, direction, FLESH_SOFTNESS, LAMP_HALF_WIDTH)
    )


@dataclass(frozen=True)
class Skin:
    """Points of posed skin. position_m, normal: (N, 3)"""

    position_m: Tensor
    normal: Tensor


@dataclass(frozen=True)
class Flesh:
    """Capsules that stand before lamps.

    start_m, end_m: (C, 3)
    radius_m:       (C,)
    hides:          (A, C) how much each counts for each anchor
    far:            (C,) whether it is of another hand, see `past_capsule`
    """

    start_m: Tensor
    end_m: Tensor
    radius_m: Tensor
    hides: Tensor
    far: Tensor

    @classmethod
    def of(cls, cast: CastTensors, ends_m: Tensor, scale: Tensor, others: Capsules | None = None) -> Flesh:
        """ends_m: (2, 20, 3) of its capsules' axes, posed · others: of hands beside this one"""
        start_m, end_m, radius_m = *ends_m, cast.flesh[:, 6].to(ends_m) * scale
        hides, far = 1 - cast.own.to(ends_m), torch.zeros(len(start_m), dtype=torch.bool)
        if others is not None:
            start, end, radius, part = (torch.from_numpy(values).to(ends_m) for values in vars(others).values())
            start_m, end_m, radius_m = (torch.cat(p) for p in ((start_m, start), (end_m, end), (radius_m, radius)))
            hides = torch.cat([hides, part.expand(len(hides), -1)], 1)
            far = torch.arange(len(start_m)) >= len(far)
        return cls(start_m, end_m, radius_m, hides, far)


def past_flesh(skin: Skin, flesh: Flesh, towards: Tensor, softness: float, half_width: Tensor | float) -> Tensor:
    """(A, K) part that is seen past all flesh. The rest as of `past_capsule`."""
    visible = torch.ones(len(skin.position_m), towards.shape[-2]).to(towards)
    each = zip(flesh.start_m, flesh.end_m, flesh.radius_m, flesh.hides.T, flesh.far.tolist(), strict=True)
    for start, end, radius_m, hides, far in each:
        # with gradients, what lies between is computed again in the backward pass: it would be twice the memory
        stands_free: Tensor = checkpoint(
            past_capsule, skin.position_m, towards, start, end, radius_m, softness, half_width, far,
            use_reentrant=False, preserve_rng_state=False,
        )  # type: ignore[assignment]  # fmt: skip
        visible = visible * (1 - hides[:, None] * (1 - stands_free))
    return visible


def past_capsule(
    position_m: Tensor,
    towards: Tensor,
    start: Tensor,
    end: Tensor,
    radius_m: Tensor,
    softness: float,
    half_width: Tensor | float,
    far: bool = False,
) -> Tensor:
    """(A, K) how much of each lamp shines past one capsule: 0 behind it, 1 well beside it, smooth between.

    The least distance between ray and axis decides, by two rounds of alternating projection, which are exact where
    neither end of the axis nor the ray's own start is nearest. The edge widens with the way to the capsule.
    position_m: (A, 3) · towards: unit, (K, 3) or of each point (A, K, 3) · start, end: (3,) · half_width: of a lamp
    per distance, one number or (A, K)
    far: a capsule that is smaller than the lamp, as the point sees it, hides only its share of the lamp, radius over
    half width; within a hand that is in what was learned.
    """
    axis, from_start = end - start, position_m - start
    length2 = (axis * axis).sum().clamp_min(CAPSULE_LENGTH2_MIN)
    axis_along, point_along_axis = towards @ axis, (from_start @ axis)[:, None]
    along_ray = from_start @ towards.T if towards.ndim == 2 else (towards * from_start[:, None]).sum(-1)
    # |from_start + t towards - s axis|^2 is least over all t at this s
    sine2 = (length2 - axis_along * axis_along).clamp_min(CAPSULE_SINE2_MIN * length2)
    s = ((point_along_axis - axis_along * along_ray) / sine2).clamp(0, 1)
    t = (s * axis_along - along_ray).clamp_min(0)
    s = ((point_along_axis + t * axis_along) / length2).clamp(0, 1)
    # |m|^2 + t^2 + s^2 |a|^2 + 2 t m.d - 2 s m.a - 2 s t a.d, without any (A, K, 3)
    distance2 = (
        (from_start * from_start).sum(-1, keepdim=True)
        + t * (t + 2 * along_ray - 2 * s * axis_along)
        + s * (s * length2 - 2 * point_along_axis)
    )
    distance = distance2.clamp_min(CAPSULE_LENGTH2_MIN).sqrt()
    width = (softness * radius_m + half_width * t).clamp_min(CAPSULE_WIDTH_MIN_M)
    stands_free = smooth(0.5 + 0.5 * (distance - radius_m) / width)
    if not far:
        return stands_free
    return 1 - (1 - stands_free) * (radius_m / (half_width * t).clamp_min(CAPSULE_WIDTH_MIN_M)).clamp_max(1)


def exponent(shadow: CastTensors, seen: LampsSeen) -> Tensor:
    """(N, 3) what the cast shadow adds to the exponent of `light.lit`, 0 where all lamps are seen."""
    rgb = shadow.lamp_rgb.to(seen.open.dtype)
    bounced = shadow.bounced_rgb.to(rgb.dtype).clamp_min(BOUNCED_MIN)
    left = (seen.seen @ rgb + bounced) / (seen.open @ rgb + bounced)
    return shadow.anchors.spread(LIGHT_TO_DISPLAY * left.log())
