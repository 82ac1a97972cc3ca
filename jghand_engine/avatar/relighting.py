"""How a hand that was learned in a light that nobody knows may look in the light of a scene: a guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import SkinResponse
from jghand_engine.avatar.scene_light import CELLS
from jghand_engine.color import srgb_to_linear
from jghand_engine.errors import InputError

# of hands that were learned in known light, path traced: half width of the rounded corner of a cosine (red goes
# deepest), albedo of what throws light back, part of the world's light that no shadow takes
SOFTNESS = (0.24, 0.17, 0.11)
BOUNCE = (0.31, 0.15, 0.12)
AMBIENT = (0.017, 0.014, 0.013)
# GGX roughness of their skin and what it reflects at right angles
ROUGHNESS, REFLECTANCE = 0.45, 0.027
# mean albedo of skin, linear, that a hand of unknown light is brought to
MEAN_ALBEDO = (0.50, 0.33, 0.25)
# logarithms of display-referred colors become those of linear ones: the slope of sRGB's curve
SHADE_GAIN = 2.2
# the far side, which is dark, shows through gaps between Gaussians whose captured light was soft: wider ones close them
GAP_FILL = 1.15
# an albedo above throws back more than any skin
ALBEDO_MAX = 0.95


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
    albedo = srgb_to_linear(np.clip(avatar.rgb, 0, 1).astype(np.float64))
    # as much as each covers
    weight = (avatar.opacity * np.square(avatar.sigma_m)).astype(np.float64)
    mean = weight @ albedo / weight.sum()
    albedo = np.minimum(albedo * (np.array(MEAN_ALBEDO) / np.maximum(mean, 1e-6)), ALBEDO_MAX)
    count = len(avatar)
    response = SkinResponse(
        spread=np.ones(count, np.float32),
        roughness=np.full(count, ROUGHNESS, np.float32),
        reflectance=np.full(count, REFLECTANCE, np.float32),
        softness=np.array(SOFTNESS),
        bounce=np.array(BOUNCE),
        ambient=np.array(AMBIENT),
        shade_gain=SHADE_GAIN,
    )
    cast = replace(learned.cast, lamp_rgb=np.zeros((CELLS, 3), np.float32))
    # what it casts on itself on the screen is of its own light
    relit = replace(learned, cast=cast, response=response, shadow=None)
    sigma_m = (GAP_FILL * avatar.sigma_m).astype(np.float32)
    return replace(avatar, rgb=albedo.astype(np.float32), sigma_m=sigma_m, learned=relit)
