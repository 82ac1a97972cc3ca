"""What of a scene's light an image calls for: the decisions about it. What they do, `avatar/lamp_rows.py` says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.lamp_rows import LIMITS, TINY, Limits, fade, lamp_weights, shares_on, world_shade
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native.scene_light_task import NUMBER, LampKind
from jghand_engine.render.effect_plan import NOT_CHOSEN, Choice, Decision, Effect
from jghand_engine.render.hand_facts import HandFacts
from jghand_engine.render.settings import RenderSettings

# estimated cost on one core, milliseconds per Gaussian, the anchors' part in it: of a lamp, of its shadow, of what is
# mirrored of it, of the world's shadow
LAMP_MS, LAMP_SHADOW_MS, MIRROR_MS, WORLD_SHADOW_MS = 2e-6, 8e-6, 1.4e-6, 3e-5
# ... of a shadow with sharp edges, per Gaussian, and of the picture that it asks
SHARP_MS, PICTURE_MS = 2e-5, 1.3
# part of all light from which on the edges of a lamp's shadow are sharp ones; fades in up to twice that
SHARP_LIMIT = 0.02
# lamps of which hands see half of an angle with this sine have them, larger ones fade out: from the middle of a large
# one its picture sees other skin than its rim does
SHARP_SINE, BLUNT_SINE = 0.14, 0.18
# what the world's reflections cost, in lamps
LOBES_AS_LAMPS = 6
# why something stays as it was drawn last
KEPT_LIGHT, KEPT_WORLD = "pose and light are kept", "pose and world are kept"


@dataclass(frozen=True)
class Lit:
    """How a scene lights the hands of an image.

    light:        all of it
    is_new:       whether the skin stands in another one
    has_new_world: whether in another world
    is_seen_anew: whether the last image was seen from elsewhere
    """

    light: SceneLight
    is_new: bool = True
    has_new_world: bool = True
    is_seen_anew: bool = True


def limits_of(choice: Choice) -> Limits:
    """Below which parts of all light something is left out, as it was chosen."""

    def limit(effect: Effect, usual: float) -> float:
        return 0.0 if choice.forces(effect) else usual if choice.allows(effect) else math.inf

    return Limits(
        # a lamp is no effect that anybody chooses
        0.0 if choice.forces(Effect.LAMPS) else LIMITS.lamp,
        limit(Effect.LAMP_SHADOW, LIMITS.lamp_shadow),
        limit(Effect.WORLD_SHADOW, LIMITS.world_shadow),
    )


def light_decisions(
    lit: Lit, moved_m: float | None, bones: Sequence[Bones], hands: Sequence[HandFacts], settings: RenderSettings
) -> tuple[list[Decision], tuple[float, ...]]:
    """About lamps, their shadows, that of the world, and gloss; and `EffectPlan.sharp`. moved_m, bones: see
    `effects.Scene`"""
    choice = settings.effects
    lit_hands = [
        (one, hand.joints_m, hand.learned.response, hand.count)
        for one, hand in zip(bones, hands, strict=True)
        if hand.learned is not None and hand.learned.response is not None
    ]
    names = (Effect.LAMPS, Effect.LAMP_SHADOW, Effect.SHARP_SHADOW, Effect.WORLD_SHADOW, Effect.GLOSS)
    if not lit_hands:
        return [Decision(effect, False, "a painted hand shines with its own colors") for effect in names], ()
    light, limits, count = lit.light, limits_of(choice), sum(gaussians for *_, gaussians in lit_hands)
    each = [shares_on(light, one, joints_m)[0] for one, joints_m, _, _ in lit_hands]
    # of several hands the one that gets the most
    most = each[0] if len(each) == 1 else np.max(each, axis=0)
    shares = most[:-1]
    world = max(
        world_shade(share, response.bounce, limits) for share, (_, _, response, _) in zip(each, lit_hands, strict=True)
    )
    weight = lamp_weights(most, limits)
    has_shadow = np.array([lamp.has_shadow for lamp in light.lamps], bool)
    shade = fade(shares, limits.lamp_shadow) * (weight > 0) * has_shadow
    sharp, sharpens = _sharp_shadows(light, shares, shade, bones, hands, settings)
    mirrors = any(response.mirrors for _, _, response, _ in lit_hands)
    decisions = [
        _lamps(shares, weight, count),
        _lamp_shadows(shares, weight, has_shadow, shade, count, choice),
        sharpens,
        _world_shadow(*world, count, choice),
        _gloss(light, weight, count, choice) if mirrors else _matt(choice),
    ]
    if moved_m is not None:
        pose_and_light = KEPT_LIGHT if not lit.is_new else None
        world_too = pose_and_light or (None if lit.has_new_world else KEPT_WORLD)
        view_too = None if lit.is_seen_anew else pose_and_light
        reasons = (pose_and_light, pose_and_light, pose_and_light, world_too, view_too)
        decisions = [_kept(one, why, moved_m) for one, why in zip(decisions, reasons, strict=True)]
    return decisions, sharp


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
    shares: np.ndarray, weight: np.ndarray, has_shadow: np.ndarray, shade: np.ndarray, count: int, choice: Choice
) -> Decision:
    casts = (weight > 0) & has_shadow
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


def _sharp_shadows(
    light: SceneLight,
    shares: np.ndarray,
    shade: np.ndarray,
    bones: Sequence[Bones],
    hands: Sequence[HandFacts],
    settings: RenderSettings,
) -> tuple[tuple[float, ...], Decision]:
    """Which shadows have the edges of the surface. shade: (lamps,) how much of each is drawn"""
    choice, lost = settings.effects, "edges of shadows up to 4 mm elsewhere"

    def skipped(why: str, cost: float = 0.0) -> tuple[tuple[float, ...], Decision]:
        return (), Decision(Effect.SHARP_SHADOW, False, why, lost, None, cost)

    if not choice.allows(Effect.SHARP_SHADOW):
        return skipped(NOT_CHOSEN)
    if not shade.any():
        return skipped("no lamp casts a shadow")
    if not settings.sharp_shadows:
        return skipped("presets final and reference ask for it")
    if not all(hand.avatar.detail is not None and hand.avatar.detail.ends_hand for hand in hands):
        return skipped("a hand has no surface")
    limit = 0.0 if choice.forces(Effect.SHARP_SHADOW) else SHARP_LIMIT
    sine = np.max([_sines(light, one.root_m) for one in bones], axis=0, initial=0.0)
    narrow = np.clip((BLUNT_SINE - sine) / (BLUNT_SINE - SHARP_SINE), 0, 1)
    weight = fade(shares, limit) * narrow * (shade > 0)
    drawn, casts = int((weight > 0).sum()), int((shade > 0).sum())
    cost = PICTURE_MS + sum(hand.count for hand in hands) * SHARP_MS
    if not drawn:
        return skipped("lamps are too large or too faint")
    why = f"of {_counted(drawn)}" + (f", {_counted(casts - drawn)} too large or too faint" if casts > drawn else "")
    return tuple(weight.tolist()), Decision(Effect.SHARP_SHADOW, True, why, lost, None, drawn * cost)


def _sines(light: SceneLight, place_m: np.ndarray) -> np.ndarray:
    """(lamps,) sines of half the angle of each, as a place (3,) sees them."""
    rows = light.lamp_numbers
    radius2, sun_sine = rows[:, NUMBER["radius2"]], rows[:, NUMBER["sun_sine"]]
    distance2 = np.square(rows[:, :3] - place_m).sum(1)
    of_lamp = np.sqrt(radius2 / np.maximum(distance2 + radius2, TINY))
    return np.where(rows[:, NUMBER["kind"]] == LampKind.SUN, sun_sine, of_lamp)


def _world_shadow(shade: float, most: float, count: int, choice: Choice) -> Decision:
    cost, lost = count * WORLD_SHADOW_MS, "{0:.2g} % of the light"
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
