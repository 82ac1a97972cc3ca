"""What of a scene's light an image calls for: the decisions about it. What they do, `avatar/lamp_rows.py` says."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.avatar.lamp_rows import LIMITS, TINY, Limits, fade, lamp_weights, shares_on, world_shade
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native.contract import Z_NEAR_M
from jghand_engine.native.scene_light_task import LAYERS_MAX, NUMBER, LampKind
from jghand_engine.render.camera import Camera
from jghand_engine.render.effect_plan import NOT_CHOSEN, Choice, Decision, Effect, Sharp
from jghand_engine.render.hand_facts import Ball, HandFacts
from jghand_engine.render.settings import RenderSettings

# estimated cost on one core, milliseconds per Gaussian, the anchors' part in it: of a lamp, of its shadow, of what is
# mirrored of it, of the world's shadow
LAMP_MS, LAMP_SHADOW_MS, MIRROR_MS, WORLD_SHADOW_MS = 2e-6, 8e-6, 1.4e-6, 3e-5
# ... and of light that stops at what stands before the skin that throws it
SWEEP_MS = 8e-5
# ... of a shadow with sharp edges, per Gaussian, and of the picture that it asks
SHARP_MS, PICTURE_MS = 2e-5, 2.4
# ... and at pixels: per Gaussian, whose light is drawn beside its color, and per pixel
LAYER_MS, PIXEL_MS = 5e-5, 3e-5
# lamps of which hands see half of an angle with this sine have them, larger ones fade out: from the middle of a large
# one its picture sees other skin than its rim does
SHARP_SINE, BLUNT_SINE = 0.16, 0.20
# of lamps from that part of the light on they fade in at pixels, which are so large on the hand, m: Gaussians are 1 mm
# apart, and neither fainter shadows nor coarser pixels show that they fray edges
PIXEL_LIGHT, PIXEL_FROM_M, PIXEL_WHOLE_M = 0.125, 8e-4, 5e-4
# radii of the ball around a hand, between which a lamp that comes nearer loses its picture: it sees less of the hand
APART_LEAST, APART_WHOLE = 1.3, 1.6
# what the world's reflections cost, in lamps
LOBES_AS_LAMPS = 6
# why nothing is decided about a hand
PAINTED = "a painted hand shines with its own colors"
# why something stays as it was drawn last
KEPT_LIGHT, KEPT_WORLD = "pose and light are kept", "pose and world are kept"


@dataclass(frozen=True)
class Lit:
    """How a scene lights the hands of an image.

    light:        all of it
    is_new:       whether the skin stands in another one
    has_new_world: whether in another world
    is_seen_anew: whether the last image was seen from elsewhere
    draws_layers: whether light can be drawn apart, to be shadowed at each pixel
    sharp:        `EffectPlan.sharp` of the last image
    """

    light: SceneLight
    is_new: bool = True
    has_new_world: bool = True
    is_seen_anew: bool = True
    draws_layers: bool = True
    sharp: tuple[Sharp, ...] = ()


def limits_of(choice: Choice) -> Limits:
    """Below which parts of all light something is left out, as it was chosen."""

    def limit(effect: Effect, usual: float) -> float:
        return 0.0 if choice.forces(effect) else usual if choice.allows(effect) else math.inf

    return Limits(
        # a lamp is no effect that anybody chooses
        0.0 if choice.forces(Effect.LAMPS) else LIMITS.lamp,
        limit(Effect.LAMP_SHADOW, LIMITS.lamp_shadow),
        limit(Effect.SHARP_SHADOW, LIMITS.sharp_shadow),
        limit(Effect.WORLD_SHADOW, LIMITS.world_shadow),
    )


def light_decisions(
    lit: Lit,
    moved_m: float | None,
    bones: Sequence[Bones],
    hands: Sequence[HandFacts],
    places: Sequence[int],
    settings: RenderSettings,
) -> list[Decision]:
    """About lamps, their shadows, that of the world, and gloss. moved_m, bones: see `effects.Scene` · places: of these
    hands in the image, their numbers"""
    lit_hands = [
        (place, one, hand.joints_m, hand.response, hand.count)
        for place, one, hand in zip(places, bones, hands, strict=True)
        if hand.response is not None
    ]
    names = (Effect.LAMPS, Effect.LAMP_SHADOW, Effect.WORLD_SHADOW, Effect.GLOSS)
    if not lit_hands:
        return [Decision(effect, False, PAINTED) for effect in names]
    choice = settings.effects
    light, limits, count = lit.light, limits_of(choice), sum(gaussians for *_, gaussians in lit_hands)
    each = [shares_on(light.on_hand(place), one, joints_m)[0] for place, one, joints_m, _, _ in lit_hands]
    # of several hands the one that gets the most
    most = each[0] if len(each) == 1 else np.max(each, axis=0)
    shares = most[:-1]
    world = max(
        world_shade(share, response.bounce, limits) for share, (*_, response, _) in zip(each, lit_hands, strict=True)
    )
    weight = lamp_weights(most, limits)
    mirrors = any(response.mirrors for *_, response, _ in lit_hands)
    decisions = [
        _lamps(shares, weight, count),
        _lamp_shadows(light, shares, weight, count, choice, limits.lamp_shadow),
        _world_shadow(*world, count, choice, sweeps=settings.swept_light and light.baked is None),
        _gloss(light, weight, count, choice) if mirrors else _matt(choice),
    ]
    if moved_m is not None:
        pose_and_light = _kept_light(lit)
        world_too = pose_and_light or (None if lit.has_new_world else KEPT_WORLD)
        view_too = None if lit.is_seen_anew else pose_and_light
        reasons = (pose_and_light, pose_and_light, world_too, view_too)
        decisions = [_kept(one, why, moved_m) for one, why in zip(decisions, reasons, strict=True)]
    return decisions


def _kept_light(lit: Lit) -> str | None:
    return None if lit.is_new else KEPT_LIGHT


def _kept(decision: Decision, why: str | None, moved_m: float) -> Decision:
    """Of what stays as it was drawn last, for the reason `why`; None where it does not."""
    if why is None or not decision.runs:
        return decision
    worst = None if moved_m else 0.0
    return Decision(decision.effect, False, why, "as of skin", worst, decision.estimated_ms)


def _lamps(shares: np.ndarray, weight: np.ndarray, count: int) -> Decision:
    drawn, figures = int((weight > 0).sum()), (100 * float(shares @ (1 - weight)),)
    out = len(shares) - drawn
    if not len(shares):
        return Decision(Effect.LAMPS, False, "the scene has no lamps")
    if not drawn:
        return Decision(Effect.LAMPS, False, f"{_counted(out)} too faint", "{0:.2g} % of the light", None, 0.0, figures)
    why = f"{_counted(drawn)} on the hand" + (f", {_counted(out)} left out: {{0:.2g}} % of the light" if out else "")
    return Decision(Effect.LAMPS, True, why, "dark", None, drawn * count * LAMP_MS, figures)


def _lamp_shadows(
    light: SceneLight, shares: np.ndarray, weight: np.ndarray, count: int, choice: Choice, limit: float
) -> Decision:
    casts = (weight > 0) & _have_shadows(light)
    shade = fade(shares, limit) * casts
    drawn, figures = int((shade > 0).sum()), (100 * float((shares * casts) @ (1 - shade)),)
    out, lost = int(casts.sum()) - drawn, "shadows in the light of lamps"
    if not choice.allows(Effect.LAMP_SHADOW):
        return Decision(Effect.LAMP_SHADOW, False, NOT_CHOSEN, lost, None)
    if not casts.any():
        return Decision(Effect.LAMP_SHADOW, False, "no lamp casts a shadow")
    if not drawn:
        why, lost = f"{_counted(out)} too faint for one", "{0:.2g} % of the light"
        return Decision(Effect.LAMP_SHADOW, False, why, lost, None, out * count * LAMP_SHADOW_MS, figures)
    why = f"of {_counted(drawn)}" + (f", {_counted(out)} too faint for one: {{0:.2g}} % of the light" if out else "")
    return Decision(Effect.LAMP_SHADOW, True, why, lost, None, drawn * count * LAMP_SHADOW_MS, figures)


def _have_shadows(light: SceneLight) -> np.ndarray:
    """(lamps,) bool"""
    return np.array([lamp.has_shadow for lamp in light.lamps], bool)


def sharp_shadows(
    lit: Lit,
    moved_m: float | None,
    bones: Sequence[Bones],
    hands: Sequence[HandFacts],
    seen: Sequence[bool],
    camera: Camera,
    settings: RenderSettings,
) -> tuple[tuple[Sharp, ...], Decision]:
    """`EffectPlan.sharp` of all hands, each by itself: none that comes or goes changes another's edges. seen: per hand
    whether it can be in the image"""
    choice, light = settings.effects, lit.light
    limits, lost = limits_of(choice), "edges of shadows up to 4 mm elsewhere"

    def skipped(why: str) -> tuple[tuple[Sharp, ...], Decision]:
        return (), Decision(Effect.SHARP_SHADOW, False, why, lost, None)

    if all(hand.response is None for hand in hands):
        return skipped(PAINTED)
    if not (choice.allows(Effect.SHARP_SHADOW) and choice.allows(Effect.LAMP_SHADOW)):
        return skipped(NOT_CHOSEN)
    if not settings.sharp_shadows:
        return skipped("presets final and reference ask for it")
    have_shadows, found, casts, cost_ms = _have_shadows(light), [], np.zeros(len(light.lamps), bool), 0.0
    each = [
        shares_on(light.on_hand(place), one, hand.joints_m)
        for place, (one, hand) in enumerate(zip(bones, hands, strict=True))
    ]
    limit = _pixel_light([shares[:-1] for (shares, _), is_seen in zip(each, seen, strict=True) if is_seen])
    # baked light has its shadows
    at_all = lit.draws_layers and light.baked is None
    for one, hand, (shares, points_m), is_seen in zip(bones, hands, each, seen, strict=True):
        ball = hand.ball(one)
        if ball is None or hand.response is None:
            return skipped("a hand has no surface")
        shaded = fade(shares[:-1], limits.lamp_shadow) * (lamp_weights(shares, limits) > 0) * have_shadows > 0
        weights = fade(shares[:-1], limits.sharp_shadow) * _suits_picture(light, points_m + one.root_m, ball) * shaded
        px_per_m = _px_per_m(camera, ball)
        by_size = _by_size(px_per_m * max(one.scale, TINY)) if at_all else 0.0
        at_pixels = fade(shares[:-1], limit) * (weights > 0) * by_size
        found.append(Sharp(tuple(weights.tolist()), ball, tuple(at_pixels.tolist())))
        casts |= shaded & is_seen
        cost_ms += is_seen * (weights > 0).sum() * (PICTURE_MS + hand.count * SHARP_MS)
        pixels = min((px_per_m * ball.radius_m) ** 2, camera.width * camera.height)
        cost_ms += is_seen * (at_pixels > 0).sum() * (hand.count * LAYER_MS + pixels * PIXEL_MS)
    drawn = int(np.any([np.array(one.weights) > 0 for one in found], axis=0).sum())
    if not drawn:
        return skipped("lamps are too large, too near or too faint" if casts.any() else "no lamp casts a shadow")
    sharp, fine = tuple(found), len(layers_of(found, seen))
    out = int(casts.sum()) - drawn
    why = f"of {_counted(drawn)}" + (f", of {fine} at each pixel" if fine else "")
    why += f", {_counted(out)} too large, too near or too faint" if out > 0 else ""
    decision = Decision(Effect.SHARP_SHADOW, True, why, lost, None, float(cost_ms))
    # what is shadowed at pixels is so in each image
    kept = None if moved_m is None or fine else _kept_light(lit)
    return sharp, _kept(decision, kept, moved_m or 0.0)


def layers_of(sharp: Sequence[Sharp], seen: Sequence[bool]) -> tuple[int, ...]:
    """Numbers of the lamps whose light is drawn apart, to be shadowed at each pixel. seen: per hand whether it can be
    in the image"""
    of_seen = itertools.compress((one.at_pixels for one in sharp), seen)
    return tuple(lamp for lamp, parts in enumerate(zip(*of_seen, strict=True)) if any(parts))


def with_layers(lit: Lit, sharp: Sequence[Sharp], seen: Sequence[bool]) -> Lit:
    """What is lit, or seen, anew where other light is drawn apart than in the last image."""
    parts, before = ([one.at_pixels for one in each] for each in (sharp, lit.sharp))
    other = layers_of(sharp, seen) != layers_of(lit.sharp, seen)
    return replace(lit, is_new=lit.is_new or other, is_seen_anew=lit.is_seen_anew or parts != before)


def _pixel_light(shares: Sequence[np.ndarray]) -> float:
    """From which part of a hand's light on shadows fade in at pixels: no more lamps give more than there can be layers.
    shares: (lamps,) per hand"""
    most = np.sort(np.max(shares, axis=0))[::-1] if shares else np.zeros(0)
    return max(PIXEL_LIGHT, float(most[LAYERS_MAX])) if len(most) > LAYERS_MAX else PIXEL_LIGHT


def _px_per_m(camera: Camera, ball: Ball) -> float:
    """How large a meter is drawn where a ball is the nearest; infinite where the camera is in it."""
    nearest_m = float(camera.camera_from_world[2] @ (*ball.middle_m, 1.0)) - ball.radius_m
    return camera.px_per_meter(nearest_m) if nearest_m > Z_NEAR_M or camera.orthographic else math.inf


def _by_size(px_per_m: float) -> float:
    """How much of shadows is found at pixels, 0..1, of so many on a meter of a hand of scale 1."""
    return min(max((PIXEL_FROM_M - 1 / max(px_per_m, TINY)) / (PIXEL_FROM_M - PIXEL_WHOLE_M), 0.0), 1.0)


def _suits_picture(light: SceneLight, points_m: np.ndarray, ball: Ball) -> np.ndarray:
    """(lamps,) 0..1: small as the nearest of a hand's points (K, 3) sees them, and not in the hand's ball."""
    rows = light.lamp_numbers
    is_sun, radius2 = rows[:, NUMBER["kind"]] == LampKind.SUN, rows[:, NUMBER["radius2"]]
    nearest2 = np.square(rows[:, None, :3] - points_m).sum(-1).min(1)
    sine = np.where(is_sun, rows[:, NUMBER["sun_sine"]], np.sqrt(radius2 / np.maximum(nearest2 + radius2, TINY)))
    apart = np.linalg.norm(rows[:, :3] - ball.middle_m, axis=1) / ball.radius_m
    small = np.clip((BLUNT_SINE - sine) / (BLUNT_SINE - SHARP_SINE), 0, 1)
    return small * np.where(is_sun, 1, np.clip((apart - APART_LEAST) / (APART_WHOLE - APART_LEAST), 0, 1))


def _world_shadow(shade: float, most: float, count: int, choice: Choice, *, sweeps: bool) -> Decision:
    cost, lost = count * (WORLD_SHADOW_MS + SWEEP_MS * sweeps), "{0:.2g} % of the light"
    why = "up to {0:.0f} % of the light is the world's or thrown back by skin"
    if not choice.allows(Effect.WORLD_SHADOW):
        return Decision(Effect.WORLD_SHADOW, False, NOT_CHOSEN, lost, None, cost, (100 * most,))
    if not most:
        return Decision(Effect.WORLD_SHADOW, False, "no light is on the hand", "0", 0.0, cost)
    return Decision(Effect.WORLD_SHADOW, shade > 0, why, lost, None, cost, (100 * most,))


def _gloss(light: SceneLight, weight: np.ndarray, count: int, choice: Choice) -> Decision:
    lamps = int(((weight > 0) & np.array([lamp.on_gloss for lamp in light.lamps], bool)).sum())
    mirrored = [*(["the world"] if light.world else []), *([_counted(lamps)] if lamps else [])]
    cost = (lamps + LOBES_AS_LAMPS * (light.world is not None)) * count * MIRROR_MS
    if not mirrored:
        return Decision(Effect.GLOSS, False, "no light is on the hand")
    return Decision(Effect.GLOSS, True, f"{' and '.join(mirrored)} in skin", "matt", None, cost)


def _matt(choice: Choice) -> Decision:
    if not choice.allows(Effect.GLOSS):
        return Decision(Effect.GLOSS, False, NOT_CHOSEN, "matt", None)
    return Decision(Effect.GLOSS, False, "the skin mirrors nothing")


def _counted(lamps: int) -> str:
    return f"{lamps} lamp{'' if lamps == 1 else 's'}"
