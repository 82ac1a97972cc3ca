"""Hands in a light that they were not made for: one learned in unknown light, in that of a scene, which is a guess; one
learned in known light, where no scene lights it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.cast_task import LIGHT_TO_DISPLAY
from jghand_engine.avatar.learned import Light, SkinResponse, no_light
from jghand_engine.avatar.scene_light import CELLS, LOBE_ROWS, WORLD_FLOOR, World, harmonics
from jghand_engine.avatar.scene_light_step import mirrored
from jghand_engine.color import linear_to_srgb, srgb_to_linear
from jghand_engine.errors import InputError

# of hands that were learned in known light, path traced: half width of the rounded corner of a cosine (red goes
# deepest)
SOFTNESS = (0.24, 0.17, 0.11)
# part of the albedo with which skin throws light onto skin: tried from 0.5 to 1, with the least error on 40 pictures of
# the built-in hand's capture, and on 24 others. Some of what is thrown meets flesh on its way
THROWN_BACK = 0.8
# GGX roughness of their skin and what it reflects at right angles
ROUGHNESS, REFLECTANCE = 0.45, 0.027
# mean albedo of skin, linear, that a hand of unknown light is brought to
MEAN_ALBEDO = (0.50, 0.33, 0.25)
# logarithms of display-referred colors become those of linear ones: the slope of sRGB's curve
SHADE_GAIN = 2.2
# the far side, which is dark, shows through gaps between Gaussians whose captured light was soft: wider ones close them
GAP_FILL = 1.15
# the studio in which a hand of known light stands where no scene is given: light from everywhere, a little more from
# above, and a wide lamp up in front to the left. W/(m2 sr): skin that faces the lamp gets 1.3 pi W/m2
STUDIO_SKY, STUDIO_RISE = 0.6, 0.15
STUDIO_KEY, STUDIO_KEY_SHARPNESS, STUDIO_KEY_TOWARDS = 3.0, 8.0, (-0.45, 0.65, 0.61)
# an albedo above throws back more than any skin
ALBEDO_MAX = 0.95


@dataclass(frozen=True)
class Material:
    """What light of other programs falls on.

    albedo:      (N, 3) linear
    roughness:   (N,) of GGX, whose alpha is its square
    reflectance: (N,) at right angles
    """

    albedo: np.ndarray
    roughness: np.ndarray
    reflectance: np.ndarray


def material_of(avatar: HandAvatar) -> Material:
    """Of the avatar's Gaussians, without any light: what it learned in known light; else a guess from its colors."""
    learned, count = avatar.learned, len(avatar)
    if learned is not None and learned.response is not None:
        return Material(avatar.rgb, learned.response.roughness, learned.response.reflectance)
    albedo = srgb_to_linear(np.clip(avatar.rgb, 0, 1).astype(np.float64))
    if learned is not None:
        albedo = np.minimum(albedo * albedo_gain(avatar), ALBEDO_MAX)
    guesses = (np.full(count, guess, np.float32) for guess in (ROUGHNESS, REFLECTANCE))
    return Material(albedo.astype(np.float32), *guesses)


def covered_mean(avatar: HandAvatar, values: np.ndarray) -> np.ndarray:
    """(C,) float32 mean of values (N, C), each Gaussian's as much as it covers."""
    weight = (avatar.opacity * np.square(avatar.sigma_m)).astype(np.float64)
    return (weight @ values / max(weight.sum(), np.finfo(float).tiny)).astype(np.float32)


def thrown_back(avatar: HandAvatar, albedo: np.ndarray) -> np.ndarray:
    """(3,) `bounce` of a SkinResponse. albedo: (N, 3) linear"""
    return np.float32(THROWN_BACK) * covered_mean(avatar, albedo)


def albedo_gain(avatar: HandAvatar) -> np.ndarray:
    """(3,) that brings the colors of an avatar of unknown light, made linear, to the mean of skin, each Gaussian as
    much as it covers."""
    linear = srgb_to_linear(np.clip(avatar.rgb, 0, 1).astype(np.float64))
    return np.array(MEAN_ALBEDO) / np.maximum(covered_mean(avatar, linear), 1e-6)


def detail_power(avatar: HandAvatar, *, in_scene: bool) -> float:
    """Of the ratios of an avatar's detail: those of light are to be ones of display-referred colors, or the other way
    round, where it is drawn in other light than it learned in. A power stands in for sRGB's curve."""
    of_light = avatar.learned is not None and avatar.learned.response is not None
    return 1.0 if of_light == in_scene else SHADE_GAIN if in_scene else LIGHT_TO_DISPLAY


def relightable(avatar: HandAvatar) -> HandAvatar:
    """The avatar as the light of a scene lights it: as it is, if it learned in known light; else `estimated`. A painted
    hand has no skin that light falls on: it shines with its own colors, made linear."""
    learned = avatar.learned
    if learned is None:
        return replace(avatar, rgb=srgb_to_linear(avatar.rgb))
    return avatar if learned.response is not None else estimated(avatar)


def estimated(avatar: HandAvatar) -> HandAvatar:
    """An avatar of unknown light with a guessed linear albedo for its colors, and a guessed response.

    The albedo keeps its differences and gets the mean of skin; the light it was learned in is dropped. What a capture
    had in shadow in every pose stays dark.
    InputError for a hand that learned no cast shadow: its fingers could not shade it.
    """
    learned = avatar.learned
    if learned is None or learned.cast is None:
        raise InputError(
            f"hand {avatar.info.name!r} in the light of a scene",
            wanted="one that was learned with the shadows of its fingers",
            came="a painted one" if learned is None else "one without",
            remedy="Show it in the light of its capture.",
        )
    material = material_of(avatar)
    response = SkinResponse(
        spread=np.ones(len(avatar), np.float32),
        roughness=material.roughness,
        reflectance=material.reflectance,
        softness=np.array(SOFTNESS),
        bounce=thrown_back(avatar, material.albedo),
        shade_gain=SHADE_GAIN,
    )
    cast = replace(learned.cast, lamp_rgb=np.zeros((CELLS, 3), np.float32))
    # what it casts on itself on the screen is of its own light
    shine = np.zeros_like(learned.shine)
    relit = replace(learned, light=no_light(), shine=shine, cast=cast, response=response, shadow=None)
    sigma_m = (GAP_FILL * avatar.sigma_m).astype(np.float32)
    return replace(avatar, rgb=material.albedo, sigma_m=sigma_m, learned=relit)


@cache
def studio() -> World:
    """The light of a hand of known light where no scene is given, in the axes of the joints, y up."""
    direction, _ = World(np.ones((LOBE_ROWS, 2 * LOBE_ROWS, 3))).samples
    cosine = direction @ (np.array(STUDIO_KEY_TOWARDS) / np.linalg.norm(STUDIO_KEY_TOWARDS))
    key = STUDIO_KEY * np.exp(STUDIO_KEY_SHARPNESS * (cosine - 1))
    return World(np.repeat((STUDIO_SKY + STUDIO_RISE * direction[..., 1] + key)[..., None], 3, -1))


def in_studio(avatar: HandAvatar) -> HandAvatar:
    """The avatar as it looks where nobody gives a light: as it is, unless it learned in known light. Then it gets the
    light of its film, else of the `studio`, as others carry that of their capture, display-referred, so that all that
    draws or exports those shows it too. Powers stand in for sRGB's curve, as in what was learned so."""
    learned = avatar.learned
    if learned is None or learned.response is None or learned.cast is None:
        return avatar
    response = learned.response
    world = studio() if response.film_light is None else World.of_cells(response.film_light)
    terms, mean = world.terms, world.terms.mean_irradiance
    direction = world.samples[0].reshape(-1, 3)
    wave = harmonics(direction)
    irradiance = np.maximum(wave @ terms.irradiance(response.softness), WORLD_FLOOR * mean)
    exponent, *_ = np.linalg.lstsq(wave, LIGHT_TO_DISPLAY * np.log(irradiance / np.pi), rcond=None)
    lobe, reflected = mirrored(world, response.roughness), float(response.reflectance.mean())
    light = Light(exponent, lobe[:, :3], lobe[:, 3], reflected * lobe[:, 4:], np.zeros(()))
    light = Light(**{name: np.asarray(values, np.float32) for name, values in vars(light).items()})
    # skin that sees nothing of the light gets what skin around it throws back: once, for a fist lit by the studio as a
    # scene is darker than with a series of throws
    bounced = response.bounce * mean
    cast = replace(learned.cast, lamp_rgb=terms.light.astype(np.float32), bounced_rgb=bounced.astype(np.float32))
    shine = (response.reflectance / max(reflected, 1e-6)).astype(np.float32)
    shown = replace(learned, light=light, shine=shine, cast=cast, response=None, in_studio=True)
    return replace(avatar, rgb=linear_to_srgb(avatar.rgb), learned=shown)
