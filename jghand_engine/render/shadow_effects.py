"""Whether and how strongly a picture is shaded: the part of `plan_effects` about self-shadow and shadow between hands.

One pass shades all hands, with one strength: it fades in with the gates and with the size of the hands, so that nothing
pops. A shadow that nobody would see, as it was measured, is left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from jghand_engine.avatar.learned import CAPSULE_RADII_MM, SHADOW_UNSEEN, ShadowLook
from jghand_engine.native import contract
from jghand_engine.render.camera import Camera
from jghand_engine.render.effect_plan import NOT_ALLOWED, Decision, Effect
from jghand_engine.render.gate import GATE_RADIUS_M, contact_between, fade, gap_between, smoothstep
from jghand_engine.render.settings import RenderSettings, ShadowMode

# hands smaller than this on the image get no shadow pass, px; it fades in up to the second size
SHADOW_HAND_MIN_PX = 64.0
SHADOW_HAND_FULL_PX = 96.0
# estimated cost on one core, milliseconds per pixel and sample
SHADOW_MS = 3e-7

if TYPE_CHECKING:
    from jghand_engine.render.effects import HandFacts, Scene


@dataclass(frozen=True)
class _Loss:
    """What a picture lacks without a shadow: in words, and 0..1 of the worst channel."""

    bound: str
    worst: float


_NOTHING = _Loss("0", 0.0)
# colors that were learned under a shadow that fades with the pose have in them what it leaves out
_LEARNED = _Loss("0: learned as it is drawn", 0.0)
_GATED = "mostly 1 % of the hand's pixels occluded by over 0.2 (METHOD 5.4)"


def plan_shadows(
    scene: Scene, hands: Sequence[HandFacts], settings: RenderSettings
) -> tuple[float, tuple[Decision, Decision]]:
    """Strength 0..1 of the pass that shades all hands, and why: parts of a hand, and hands, near each other."""
    looks = [hand.look for hand in hands if hand.look is not None]
    extents_px = [extent_px(pixels, depth, scene.camera) for pixels, depth in scene.seen_joints]
    cost = _hand_pixels(extents_px, scene.camera) * settings.shadow_samples * SHADOW_MS
    darkest = settings.shadow_strength * max((max(look.tint) for look in looks), default=0.0)
    dark = _Loss(f"darker by up to {100 * darkest:.0f} %", darkest)
    several = len(hands) > 1

    def neither(reason: str, loss: _Loss) -> tuple[float, tuple[Decision, Decision]]:
        own = Decision(Effect.SHADOW, False, reason, loss.bound, loss.worst, cost)
        return 0.0, (own, replace(own, effect=Effect.BETWEEN, estimated_ms=0.0) if several else _ALONE)

    if settings.shadow is ShadowMode.OFF or settings.shadow_strength == 0:
        return neither("switched off", dark)
    if not looks:
        return neither("the avatar was learned without one", _NOTHING)
    may_own, may_between = (settings.effects.allows(effect) for effect in (Effect.SHADOW, Effect.BETWEEN))
    if not (may_own or may_between):
        return neither(NOT_ALLOWED, dark)
    always = settings.shadow is ShadowMode.ALWAYS or settings.effects.forces(Effect.SHADOW)
    gap_m = gap_between(scene.joints_m) if may_between else math.inf
    alone = gap_m >= GATE_RADIUS_M
    if alone and not always and (seen := _unseen(looks, settings)) is not None:
        return neither(f"seen by {255 * seen:.1f} of 255 steps", _Loss("the most that `jghand distill` measured", seen))
    size_px = max(extents_px)
    large = 1.0 if always else fade_with_size(size_px)
    if large == 0:
        return neither(f"hand {size_px:.0f} px", _Loss("a few pixels of crease", darkest))
    own = _own_score(scene, hands) if may_own else 0.0
    contact = 0.0 if alone else contact_between(scene.joints_m)
    learned = [hand.learned is not None for hand in hands]
    full = always and may_own and not any(learned)
    strength = (1.0 if full else large * fade(own + contact)) * settings.shadow_strength
    closed = _LEARNED if all(learned) else _Loss(_GATED, darkest)

    def decided(effect: Effect, called_for: bool, reason: str, cost_ms: float) -> Decision:
        runs = strength > 0 and called_for
        loss = dark if runs else closed
        return Decision(effect, runs, reason, loss.bound, loss.worst, cost_ms)

    def left_out(effect: Effect, reason: str, loss: _Loss, cost_ms: float) -> Decision:
        return Decision(effect, False, reason, loss.bound, loss.worst, cost_ms)

    if may_own:
        mine = decided(Effect.SHADOW, full or own > 0, "on every frame" if full else f"gate {own:.2f}", cost)
    else:
        mine = left_out(Effect.SHADOW, NOT_ALLOWED, dark, cost)
    if not several:
        return strength, (mine, _ALONE)
    if not may_between:
        return strength, (mine, left_out(Effect.BETWEEN, NOT_ALLOWED, dark, 0.0))
    if contact == 0:
        # a shadow of the usual reach ends long before the gate; a longer one may not
        loss = _NOTHING if gap_m >= settings.shadow_radius_m else dark
        return strength, (mine, left_out(Effect.BETWEEN, f"next hand {1e3 * gap_m:.0f} mm away", loss, 0.0))
    return strength, (mine, decided(Effect.BETWEEN, True, f"hands touch, score {contact:.2f}", 0.0))


def fade_with_size(size_px: float) -> float:
    """0..1: how much of the shadow the largest hand, of that extent, gets."""
    return smoothstep(size_px, SHADOW_HAND_MIN_PX, SHADOW_HAND_FULL_PX)


_ALONE = Decision(Effect.BETWEEN, False, "one hand", _NOTHING.bound, _NOTHING.worst)


def _unseen(looks: Sequence[ShadowLook], settings: RenderSettings) -> float | None:
    """The most that these shadows change a pixel of a hand alone, where that is known and too little to see."""
    if settings.shadow_radius_m != contract.SHADOW_RADIUS_M:
        return None  # it was measured at the usual reach
    seen = settings.shadow_strength * max(math.inf if look.seen is None else look.seen for look in looks)
    return seen if seen <= SHADOW_UNSEEN else None


def _own_score(scene: Scene, hands: Sequence[HandFacts]) -> float:
    pairs = zip(hands, scene.joints_m, scene.bones, strict=True)
    return max(hand.gate.score(joints, bones.scale) for hand, joints, bones in pairs)


def extent_px(pixels: np.ndarray, depth: np.ndarray, camera: Camera) -> float:
    """The longer side of the box around a hand on the picture, of joints that `camera.project` put there; infinite when
    the camera is inside the hand."""
    if not (depth > contract.Z_NEAR_M).all():
        return math.inf
    flesh_px = 2e-3 * max(CAPSULE_RADII_MM) * camera.px_per_meter(float(depth.min()))
    return float((pixels.max(0) - pixels.min(0)).max()) + flesh_px


def _hand_pixels(extents_px: Sequence[float], camera: Camera) -> float:
    """Pixels that hands of these extents cover, roughly: the boxes of their joints, half filled."""
    sides = [min(extent_px, max(camera.width, camera.height)) for extent_px in extents_px]
    return sum(0.5 * side * min(side, camera.height) for side in sides)
