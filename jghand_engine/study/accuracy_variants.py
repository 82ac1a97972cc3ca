"""What `jghand study accuracy` compares: each axis of accuracy alone, beside preset `final`, and what can be chosen.

Axes: number of Gaussians, correctives of the pose, rules of the blend, resolution, shadow, stored precision, threads,
passes of a scene's light.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.correctives import LinearCorrectives, PoseNetwork, largest_basis
from jghand_engine.avatar.file import stored_form
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.avatar.storage import Storage
from jghand_engine.learn.distill import distill, poses_near
from jghand_engine.learn.tier_prices import known_poses, with_correctives
from jghand_engine.native.threads import thread_count
from jghand_engine.render.budget import NO_CORRECTIVES, candidates, has_seen_shadow
from jghand_engine.render.effect_plan import CHOOSABLE, Choice, Effect
from jghand_engine.render.settings import PRESETS, RenderSettings, ShadowMode
from jghand_engine.study.effects_in_light import world_and_lamps

TOGETHER = "all together"
GAUSSIANS, CORRECTIVES, BLEND, SHADOW, STORED, THREADS, LIGHT = (
    "Gaussians", "correctives", "blend", "shadow", "stored as", "threads", "light"
)  # fmt: skip
AXES = (TOGETHER, GAUSSIANS, CORRECTIVES, BLEND, SHADOW, STORED, THREADS, LIGHT)
# passes of a scene's light that are left out, by what then is missing
PASSES = {
    "sharp shadows": Effect.SHARP_SHADOW, "lamps' shadows": Effect.LAMP_SHADOW,
    "the world's shadow and bounced light": Effect.WORLD_SHADOW, "gloss": Effect.GLOSS,
}  # fmt: skip
# not a pass of its own: `RenderSettings.swept_light`
THROWN_LIGHT_STOPS = "skin that stops thrown light"
_SHADOW_SAMPLES = (8, 16, 32, 64)
# prefixes of an avatar's Gaussians, and sizes of the linear form of its correctives, that are compared
COUNTS = (10_000, 20_000, 30_000, 40_000, 60_000, 120_000)
BASES = (4, 8, 16, 32)
# made-up poses that the linear forms are fitted to: fewer than a distillation takes, for time
DISTIL_POSES = 60


@dataclass(frozen=True)
class Variant:
    """One way of making a picture."""

    # one of AXES
    axis: str
    name: str
    settings: RenderSettings
    # None for the one that is studied; of another, the settings alone do not make the picture
    avatar: HandAvatar | None = None
    # the command that makes that avatar, where it can be had
    made_by: str = ""
    # of the scene that it stands in; None: the hand's own
    light: SceneLight | None = None


def variants(avatar: HandAvatar, size_px: tuple[int, int], linear: Mapping[int, LinearCorrectives]) -> list[Variant]:
    """All variants, those in the light of a scene last. linear: tiers of the correctives by size, see `linear_tiers`"""
    own = replace(PRESETS["final"], reuse=False)
    found = [
        Variant(TOGETHER, name, replace(settings, reuse=False))
        for name, settings in candidates(avatar, size_px).items()
    ]
    for basis, tier in sorted(linear.items()):
        made_by, viewport = f"jghand distill --basis {basis}", replace(PRESETS["viewport"], reuse=False)
        name = f"viewport, linear correctives, K = {basis}"
        found.append(Variant(TOGETHER, name, viewport, with_correctives(avatar, tier), made_by))
    counts = [count for count in COUNTS if count < len(avatar)] + [len(avatar)]
    found += [Variant(GAUSSIANS, f"{count / 1000:g}k", replace(own, gaussians=count)) for count in counts]
    found += _correctives(avatar, own, linear)
    for name, rule in PRESETS.items():
        changed = replace(own, alpha_min=rule.alpha_min, t_stop=rule.t_stop)
        found.append(
            Variant(BLEND, f"{name}: cut at 1/{round(1 / rule.alpha_min)}, stop at {rule.t_stop:.0e}", changed)
        )
    found += _shadows(avatar, own)
    found.append(Variant(STORED, "float32", own))
    found.append(Variant(STORED, "float16 and smaller", own, stored_form(avatar, Storage.COMPACT)))
    found += [Variant(THREADS, str(count), replace(own, threads=count)) for count in _thread_counts()]
    return [*found, *_lights(avatar, own)]


def _shadows(avatar: HandAvatar, own: RenderSettings) -> Iterator[Variant]:
    yield Variant(SHADOW, "off", replace(own, shadow=ShadowMode.OFF))
    if has_seen_shadow(avatar):
        for samples in _SHADOW_SAMPLES:
            yield Variant(SHADOW, f"gated, {samples} samples", replace(own, shadow_samples=samples))
        yield Variant(SHADOW, "always, 64 samples", replace(own, shadow=ShadowMode.ALWAYS))
    elif avatar.learned is not None and avatar.learned.shadow is not None:
        for samples in _SHADOW_SAMPLES:
            settings = replace(own, shadow=ShadowMode.ALWAYS, shadow_samples=samples)
            yield Variant(SHADOW, f"drawn although nobody sees it, {samples} samples", settings)


def _lights(avatar: HandAvatar, own: RenderSettings) -> Iterator[Variant]:
    if avatar.learned is None or avatar.learned.cast is None:
        return  # no scene can light it
    light = world_and_lamps()
    yield Variant(LIGHT, "whole", own, light=light)
    for name, effect in PASSES.items():
        without = replace(own, effects=Choice(frozenset(CHOOSABLE) - {effect}))
        yield Variant(LIGHT, f"without {name}", without, light=light)
    yield Variant(LIGHT, f"without {THROWN_LIGHT_STOPS}", replace(own, swept_light=False), light=light)


def linear_tiers(avatar: HandAvatar) -> dict[int, LinearCorrectives]:
    """The linear form of its correctives by size, fitted to made-up poses; none where it has no network."""
    net = None if avatar.learned is None else avatar.learned.correctives
    if not isinstance(net, PoseNetwork):
        return {}
    known = known_poses(avatar)
    poses = torch.cat([known, poses_near(known, DISTIL_POSES, seed=0)])
    return distill(avatar, poses, [k for k in BASES if k <= largest_basis(net.shape)])


def _correctives(avatar: HandAvatar, own: RenderSettings, linear: Mapping[int, LinearCorrectives]) -> Iterator[Variant]:
    net = None if avatar.learned is None else avatar.learned.correctives
    if net is None:
        return
    yield Variant(CORRECTIVES, "off", replace(own, effects=NO_CORRECTIVES))
    for basis, tier in sorted(linear.items()):
        yield Variant(CORRECTIVES, f"linear, K = {basis}", own, with_correctives(avatar, tier))
    yield Variant(CORRECTIVES, "exact", own)


def _thread_counts() -> list[int]:
    most, count, found = thread_count(0), 1, []
    while count < most:
        found.append(count)
        count *= 2
    return [*found, most]
