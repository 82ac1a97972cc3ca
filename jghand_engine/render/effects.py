"""Which effects a scene calls for: every decision about an image stands here.

    plan = plan_effects(scene, hands, settings)

What pays is to draw nothing of a hand that is not in the image, to reuse the skin, to draw the hand's box alone, to
leave out a shadow that nobody sees, and to average no more images than blur needs. Each has a cheap test, a bound on
what is lost, and an estimate of its cost. What does not run is neither computed nor allocated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import SHADOW_UNSEEN
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native import contract
from jghand_engine.render.blur import (
    Moment,
    disc_px,
    filled,
    focus_count,
    focus_error,
    middle,
    motion_error,
    pinholes,
    way_px,
)
from jghand_engine.render.camera import Camera
from jghand_engine.render.crop import View, seen_hands
from jghand_engine.render.effect_plan import NOT_CHOSEN, OF_CAPTURE, OF_SCENE, Decision, Effect, EffectPlan
from jghand_engine.render.gate import GATE_RADIUS_M, contact_between, fade, fade_with_size, gap_between
from jghand_engine.render.hand_facts import HandFacts
from jghand_engine.render.image import Box
from jghand_engine.render.light_effects import Lit, light_decisions, sharp_shadows, with_layers
from jghand_engine.render.settings import RenderSettings, ShadowMode

# a skin is reused when no point of it can have moved farther, and the correctives of a hand that moved as a whole when
# no offset can differ by more, meters: a tenth of a pixel of a hand that fills 512 x 334
REUSE_SKIN_M = 5e-5
# ... and when no shade, the logarithm of a color of 1 at most, can differ by more: half an 8-bit step
REUSE_SHADE = 0.5 / 255
# a hand whose median Gaussian is smaller than this on the image is drawn larger and averaged, px: the low pass of
# 0.55 px would swell it. It fades in down to the second size, and is never switched
FILTER_SIGMA_PX = 0.5
FILTER_SIGMA_FULL_PX = 0.35
# times larger at most, and pixels of such a drawing at most
FILTER_FACTOR_MAX = 8
FILTER_PIXELS_MAX = 4_000_000
# when the hand's box is smaller than this part of the image, only the box is drawn
CROP_PART_MAX = 0.5
# ... and the shadow of single pixels then differs by at most this, where a sample falls on another pixel (worst seen:
# 0.014)
CROP_SHADOW = 0.015
# what a shadow would darken at most where its gate is closed or the hand too small for it (painted hand, worst seen
# 0.27, 3 cm from the skin)
SHADOW_MISSED = 0.35
# detail that changes no color, of 1 at most, by more is left out: half an 8-bit step. From twice that on it is whole
DETAIL_UNSEEN = 0.5 / 255
# of one moment through a pinhole; what it is averaged with is decided by `plan_blur`
NO_BLUR = (Decision(Effect.MOTION, False, "no shutter"), Decision(Effect.FOCUS, False, "a pinhole"))
# estimated cost on one core, milliseconds per Gaussian, per pixel, and per pixel and sample of the shadow
SKIN_MS, NETWORK_MS, LINEAR_MS, CAST_MS, RASTER_MS = 5e-6, 2.7e-4, 2e-5, 2e-5, 1.3e-4
MAP_MS, SHADOW_MS = 1e-6, 3e-7
# ... of detail, per face and per pixel, and per pixel with a relief
FACE_MS, TEXEL_MS, RELIEF_TEXEL_MS = 1e-4, 5e-6, 7e-6


def strip_disabled(avatar: HandAvatar, settings: RenderSettings) -> HandAvatar:
    """The avatar without what may not be drawn of it: no memory is taken for that, and no time."""
    learned, allows = avatar.learned, settings.effects.allows
    if learned is not None and not allows(Effect.CORRECTIVES):
        learned = replace(learned, correctives=None, distilled=None)
    # in the light of a scene it is found at the anchors of the cast shadow
    if learned is not None and learned.response is None and not allows(Effect.CAST):
        learned = replace(learned, cast=None)
    if learned is not None and learned.response is not None and not allows(Effect.GLOSS):
        matt = replace(learned.response, reflectance=np.zeros_like(learned.response.reflectance))
        learned = replace(learned, response=matt)
    return replace(avatar, learned=learned, detail=avatar.detail if allows(Effect.DETAIL) else None)


# ---- reuse ----------------------------------------------------------------------------------------------------------


def reusable(
    bones: Sequence[Bones],
    before: Sequence[Bones],
    corrected_rad: Sequence[np.ndarray],
    hands: Sequence[HandFacts],
    settings: RenderSettings,
) -> float | None:
    """How far any point of the skin can be from where it was posed, meters; None when it has to be posed again.

    before: as it was posed · corrected_rad: per hand the angles (37,) of its correctives
    """
    if not settings.reuse or settings.effects.forces(Effect.SKIN):
        return None
    most_m, moved_m = 0.0 if settings.repeatable else REUSE_SKIN_M, 0.0
    for hand, new, old, angles_rad in zip(hands, bones, before, corrected_rad, strict=True):
        skin_m = hand.skin_change_m(new, old)
        # what a flagged hand's blended maps do to normals and offsets is not known
        if not skin_m <= (0.0 if new.flags or old.flags else most_m):
            return None
        moved_m = max(moved_m, skin_m + _kept_offset_m(hand, angles_rad, new.angles_rad, settings))
    return moved_m if moved_m <= most_m else None


def same_shape(hand: HandFacts, bones: Bones, corrected_rad: np.ndarray | None, settings: RenderSettings) -> bool:
    """Whether a hand moved as a whole: its correctives stay."""
    if corrected_rad is None or not settings.reuse or settings.effects.forces(Effect.CORRECTIVES):
        return False
    return _kept_offset_m(hand, corrected_rad, bones.angles_rad, settings) <= REUSE_SKIN_M


def _kept_offset_m(hand: HandFacts, before_rad: np.ndarray, after_rad: np.ndarray, settings: RenderSettings) -> float:
    """How far offsets can be from where they should be when correctives of other angles are kept, meters; infinite
    where those may not be kept."""
    if np.array_equal(before_rad, after_rad):
        return 0.0
    offset_m, shade = hand.corrective_change(before_rad, after_rad)
    return math.inf if settings.repeatable or not shade <= REUSE_SHADE else offset_m


# ---- the plan -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scene:
    """What is to be drawn.

    joints_m: per hand (21, 3), level order, meters
    bones:    their transforms
    camera:   a pinhole
    moved_m:  of a pose that is reused, how far its skin can have moved; None for a new one
    reshaped: whether the correctives of any hand have to be computed
    lit:      how a scene lights it; None in the light of the capture
    """

    joints_m: Sequence[np.ndarray]
    bones: Sequence[Bones]
    camera: Camera
    moved_m: float | None
    reshaped: bool
    lit: Lit | None

    def views(self, hands: Sequence[HandFacts], alpha_min: float) -> list[View]:
        """Per hand where its skin may be."""
        triples = zip(self.joints_m, self.bones, hands, strict=True)
        return [View(*one, self.camera, alpha_min) for one in triples]


def plan_effects(scene: Scene, hands: Sequence[HandFacts], settings: RenderSettings) -> EffectPlan:
    """Decides about every effect of one image through a pinhole."""
    views = scene.views(hands, settings.alpha_min)
    box, seen = seen_hands(views, settings.alpha_min)
    if not box.width and not settings.effects.forced:
        other = OF_SCENE if scene.lit is None else OF_CAPTURE
        nothing = tuple(Decision(effect, False, "no hand is in the image") for effect in Effect if effect not in other)
        return EffectPlan(nothing, box, seen)
    # what costs and what is lost are told of those in the image; that shadow and filter do not pop as a hand leaves it,
    # they are decided for all
    shown = [place for place, is_seen in enumerate(seen) if is_seen or not box.width]
    drawn, bones = [hands[place] for place in shown], [scene.bones[place] for place in shown]
    if scene.lit is None:
        strength, shadow = plan_shadow(scene, views, settings)
        light, sharp = [shadow], ()
    else:
        strength = 0.0
        sharp, edges = sharp_shadows(scene.lit, scene.moved_m, scene.bones, hands, seen, scene.camera, settings)
        lit = with_layers(scene.lit, sharp, seen)
        lamps, shadows, *others = light_decisions(lit, scene.moved_m, bones, drawn, shown, settings)
        light = [lamps, shadows, edges, *others]
    enlarged, plain, smooth = _filter(views, settings, box)
    crop = _crop(scene, settings, box, strength > 0)
    if crop.runs and enlarged == 1:
        box = Box(0, 0, scene.camera.width, scene.camera.height)
    detail, textured = plan_detail(scene, [views[place] for place in shown], settings)
    if detail:
        strengths = dict(zip(shown, detail, strict=True))
        detail = tuple(strengths.get(place, 0.0) for place in range(len(hands)))
    decisions = (*_reuse(scene, drawn, settings), textured, smooth, *light, *NO_BLUR, crop)
    return EffectPlan(decisions, box, seen, strength, enlarged, plain, detail=detail, sharp=sharp)


def _count(hands: Sequence[HandFacts]) -> int:
    return sum(hand.count for hand in hands)


def _reuse(scene: Scene, hands: Sequence[HandFacts], settings: RenderSettings) -> list[Decision]:
    """The skin, and what training added to it: not computed when nothing moved."""
    cost, moved_m = _count(hands) * SKIN_MS, scene.moved_m
    worst = None if moved_m else 0.0
    if moved_m is None:
        decisions = [Decision(Effect.SKIN, True, "new pose", "no image", None, cost)]
    else:
        lost = "{0:.2g} mm of skin" if moved_m else "0"
        decisions = [Decision(Effect.SKIN, False, "nearly the same pose", lost, worst, cost, (1e3 * moved_m,))]
    learned = [(hand, hand.learned) for hand in hands if hand.learned is not None]
    network_ms = sum(hand.count * (NETWORK_MS if hand.keeps_correctives else LINEAR_MS) for hand, _ in learned)
    cast_ms = CAST_MS * sum(hand.count for hand, _ in learned)
    for effect, has_any, lost, cost in (
        (Effect.CORRECTIVES, any(one.correctives for _, one in learned), "skin and shade of creases", network_ms),
        (Effect.CAST, any(one.cast for _, one in learned), "shadows of the fingers on the hand", cast_ms),
    ):
        if effect in OF_CAPTURE and scene.lit is not None:
            continue
        if not settings.effects.allows(effect):
            decisions.append(Decision(effect, False, NOT_CHOSEN, lost, None))
        elif not has_any:
            decisions.append(Decision(effect, False, "no avatar has learned any"))
        elif moved_m is not None:
            decisions.append(Decision(effect, False, "the skin is kept", "as of skin", worst, cost))
        elif effect is Effect.CORRECTIVES and not scene.reshaped:
            why, figures = "the hand moved as a whole", (1e3 * REUSE_SKIN_M,)
            decisions.append(Decision(effect, False, why, "{:g} mm of skin", None, cost, figures))
        else:
            decisions.append(Decision(effect, True, "new pose", lost, 1.0, cost))
    return decisions


def _filter(views: Sequence[View], settings: RenderSettings, box: Box) -> tuple[int, float, Decision]:
    """How many times larger the hand is drawn, the share of the image that is not, and why."""
    sigma_px = min(
        # infinite when the camera is inside the hand
        view.hand.sigma_m * view.bones.scale * view.camera.px_per_meter(view.nearest_m)
        if view.nearest_m > contract.Z_NEAR_M
        else math.inf
        for view in views
    )
    cost, figures = _count([view.hand for view in views]) * RASTER_MS, (sigma_px,)
    if sigma_px >= FILTER_SIGMA_PX:
        return 1, 1.0, Decision(Effect.FILTER, False, "Gaussians of {0:.2g} px", "0", 0.0, cost, figures)
    most = math.isqrt(max(FILTER_PIXELS_MAX // max(box.width * box.height, 1), 1))
    enlarged = min(math.ceil(FILTER_SIGMA_PX / max(sigma_px, 1e-9)), FILTER_FACTOR_MAX, most)
    why = "Gaussians of {0:.2g} px, " + ("drawn {1} times larger" if enlarged > 1 else "but the image is too large")
    if not settings.antialias or not settings.effects.allows(Effect.FILTER):
        enlarged, why = 1, "images as they were learned" if not settings.antialias else NOT_CHOSEN
    part = (sigma_px - FILTER_SIGMA_FULL_PX) / (FILTER_SIGMA_PX - FILTER_SIGMA_FULL_PX)
    plain, worst = (max(part, 0.0), 1.0) if enlarged > 1 else (1.0, None)
    lost = "hands swell by up to 2 px"
    return enlarged, plain, Decision(Effect.FILTER, enlarged > 1, why, lost, worst, cost, (*figures, enlarged))


def plan_detail(scene: Scene, views: Sequence[View], settings: RenderSettings) -> tuple[tuple[float, ...], Decision]:
    """Strength of each hand's detail, 0..1, and why: a pixel that covers much skin sees a mean of its texture, of which
    nothing may be left."""
    effects = settings.effects
    if not effects.allows(Effect.DETAIL):
        return (), Decision(Effect.DETAIL, False, NOT_CHOSEN, "smooth skin", None)
    if all(view.hand.avatar.detail is None for view in views):
        return (), Decision(Effect.DETAIL, False, "no hand has a texture of it")
    seen, spans, cost = [], [], 0.0
    for view in views:
        detail = view.hand.avatar.detail
        if detail is None:
            seen.append(0.0)
            continue
        # of the boxes in which the skin is, a forearm's behind the wrist too; from within them it is seen at any size
        nearest_m = view.lows_m[2] - view.splat_m - view.offset_by_m
        size = view.bones.scale * scene.camera.px_per_meter(nearest_m) if nearest_m > contract.Z_NEAR_M else math.inf
        spans.append(detail.texels_per_m / max(size, 1e-9))
        hand = view.hand
        color = math.expm1(detail.strongest(spans[-1], hand.detail_power, is_lit=hand.learned is not None))
        # outlines are seen at any size
        seen.append(1.0 if detail.ends_hand else color)
        side = min(view.extent_px, scene.camera.width, scene.camera.height)
        cost += len(detail.faces) * FACE_MS + 0.5 * side**2 * (TEXEL_MS if detail.relief is None else RELIEF_TEXEL_MS)
    strengths = tuple(1.0 if effects.forces(Effect.DETAIL) else min(max(s / DETAIL_UNSEEN - 1, 0.0), 1.0) for s in seen)
    worst, figures = max(seen), (min(spans), 100 * max(seen))
    if not any(strengths):
        return (), Decision(Effect.DETAIL, False, "a pixel covers {0:.0f} texels", "{1:.2g} %", worst, cost, figures)
    why = "a pixel covers {0:.2g} texels" if figures[0] >= 1 else "a texel is larger than a pixel"
    return strengths, Decision(Effect.DETAIL, True, why, "{1:.3g} %", min(worst, 1.0), cost, figures)


def _crop(scene: Scene, settings: RenderSettings, box: Box, shaded: bool) -> Decision:
    """Whether more than the hand's box is drawn."""
    pixels = scene.camera.width * scene.camera.height
    part, cost = box.width * box.height / pixels, pixels * MAP_MS
    if settings.effects.forces(Effect.WHOLE):
        return Decision(Effect.WHOLE, True, "on every frame", "0", 0.0, cost)
    # centers of pixels are rounded elsewhere in a box: a contribution at the cut may fall on its other side, and so may
    # a sample of the shadow
    worst = settings.alpha_min + (CROP_SHADOW if shaded else 0.0)
    why, figures = "the hand's box is {0:.0f} % of it", (100 * part, 255 * worst)
    if part > CROP_PART_MAX:
        return Decision(Effect.WHOLE, True, why, "0", 0.0, cost, figures)
    lost = "{1:.1f} 8-bit steps, on single pixels"
    return Decision(Effect.WHOLE, False, why, lost, worst, (1 - part) * cost, figures)


def plan_shadow(scene: Scene, views: Sequence[View], settings: RenderSettings) -> tuple[float, Decision]:
    """Strength 0..1 of the pass that shades all hands, and why.

    It fades in with the gate, parts of a hand or hands near each other, and with the size of the hands, so that nothing
    pops. A shadow that nobody would see, as it was measured, is left out.
    """
    hands, extents_px = [view.hand for view in views], [view.extent_px for view in views]
    looks = [hand.look for hand in hands if hand.look is not None]
    always = settings.shadow is ShadowMode.ALWAYS or settings.effects.forces(Effect.SHADOW)
    darkest = max((max(look.tint) for look in looks), default=0.0)
    near = len(hands) > 1 and gap_between(scene.joints_m) < GATE_RADIUS_M
    seen = max((_seen(hand, near=near) for hand in hands), default=0.0)
    large = 1.0 if always else fade_with_size(max(extents_px))
    gated = [hand.gated for hand in hands]
    strength, worst, figure = 0.0, darkest, 0.0
    if settings.shadow is ShadowMode.OFF:
        why = "switched off"
    elif not looks:
        why = "the avatar was learned without one"
    elif not settings.effects.allows(Effect.SHADOW):
        why = NOT_CHOSEN
    elif seen <= SHADOW_UNSEEN and not always:
        why, figure, worst = "seen by {0:.1f} of 255 steps", 255 * seen, seen
    elif large == 0:
        why, figure, worst = "hand {0:.0f} px", max(extents_px), min(darkest, SHADOW_MISSED)
    elif always and not any(gated):
        why, strength = "on every frame", 1.0
    else:
        triples = zip(hands, scene.joints_m, scene.bones, strict=True)
        figure = max(hand.gate.score(joints, bones.scale) for hand, joints, bones in triples)
        figure += contact_between(scene.joints_m) if near else 0.0
        why, strength = "gate {0:.2f}", large * fade(figure)
        if strength == 0:
            # colors that were learned under a shadow that fades with the pose have in them what it leaves out
            worst = 0.0 if all(gated) else min(darkest, SHADOW_MISSED)
    sides = [min(extent, max(scene.camera.width, scene.camera.height)) for extent in extents_px]
    # the boxes of the joints, half filled
    cost = 0.5 * sum(side * min(side, scene.camera.height) for side in sides) * settings.shadow_samples * SHADOW_MS
    lost = "darker by up to {1:.0f} %"
    return strength, Decision(Effect.SHADOW, strength > 0, why, lost, worst, cost, (figure, 100 * worst))


def _seen(hand: HandFacts, *, near: bool) -> float:
    """The most that the shadow changes a pixel of a hand, as it was measured of one hand alone: two
    near each other do without it where each casts its shadow on the other. Infinite where that is not known."""
    if hand.look is None:
        return 0.0
    casts = hand.learned is not None and hand.learned.cast is not None
    return math.inf if hand.look.seen is None or (near and not casts) else hand.look.seen


# ---- blur -----------------------------------------------------------------------------------------------------------


def plan_blur(
    moments: Sequence[Moment],
    weights: Sequence[float],
    hands: Sequence[HandFacts],
    seen: Sequence[int],
    settings: RenderSettings,
    scale: float,
) -> tuple[list[tuple[Moment, float]], list[Decision]]:
    """The moments through pinholes that one image is the mean of, with their shares, which sum to 1, and why so many.

    seen: as of `way_px` · scale: of the largest hand
    """
    allows, once_ms = settings.effects.allows, _count(hands) * (RASTER_MS + SKIN_MS)
    center, shares, each, decisions = middle(moments), [1.0], 1, []
    lens = any(moment.camera.lens is not None and moment.camera.lens.aperture_m > 0 for moment in moments)
    if len(moments) > 1 and not allows(Effect.MOTION):
        moments = [center]
        decisions.append(Decision(Effect.MOTION, False, NOT_CHOSEN, "moving edges are sharp", 1.0))
    elif len(moments) > 1:
        travel_px = way_px(moments, seen)
        moments, shares = filled(moments, weights, seen)
        decisions.append(averaged(Effect.MOTION, len(moments), travel_px, once_ms))
    if lens and not allows(Effect.FOCUS):
        lens = False
        decisions.append(Decision(Effect.FOCUS, False, NOT_CHOSEN, "everything is sharp", 1.0))
    elif lens:
        wide_px = disc_px(center.camera, [center.joints_m[hand] for hand in seen], scale)
        each = -(-focus_count(wide_px) // len(moments))
        decisions.append(averaged(Effect.FOCUS, len(moments) * each, wide_px, once_ms))
    if not lens or len(moments) * each == 1:
        moments = [replace(moment, camera=replace(moment.camera, lens=None)) for moment in moments]
    exposures = [
        (replace(moment, camera=pinhole), share / each)
        for index, (moment, share) in enumerate(zip(moments, shares, strict=True))
        for pinhole in pinholes(moment.camera, index, each, len(moments))
    ]
    return exposures, decisions


def averaged(effect: Effect, count: int, size_px: float, once_ms: float = 0.0) -> Decision:
    """Of averaging `count` images for a way or a disc of `size_px`."""
    moves = effect is Effect.MOTION
    error = motion_error(size_px, count) if moves else focus_error(size_px, count)
    why = "joints travel {0:.1f} px" if moves else "discs of {0:.1f} px"
    missed, figures = "{1:.1g} % of an edge's contrast", (size_px, 100 * error, count)
    if count == 1:
        return Decision(effect, False, why, missed, error, once_ms, figures)
    why += ", {2:.0f} images, which miss " + missed
    return Decision(effect, True, why, "sharp edges", 1.0, (count - 1) * once_ms, figures)
