"""One object that says how an image is made. Nothing else does."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from jghand_engine.avatar.tiers import Tier
from jghand_engine.errors import InputError
from jghand_engine.native import contract
from jghand_engine.render.effect_plan import AUTO, Choice


class ShadowMode(StrEnum):
    """off: never; gated: fades in when the pose brings parts of the hand together; always: on every frame.

    A trained avatar has learned its colors under the shadow that fades: `always` only draws it on small images too.
    """

    OFF = "off"
    GATED = "gated"
    ALWAYS = "always"


@dataclass(frozen=True)
class RenderSettings:
    """How an image is made.

    gaussians:         how many of the avatar's Gaussians: a prefix; 0 = all
    alpha_min, t_stop: cut-offs of the blend; of hands in known light a pixel ends once it is covered, whatever t_stop
    shadow, shadow_samples: the self-shadow pass
    outline_px:        how far corners of a surface that ends a hand may be from the round outline of a finger, at the
                       depth of the wrist, before its faces are made finer
    sharp_shadows:     whether shadows of small lamps end where those of the surface do (`lamp_depth`), or of capsules
    swept_light:       whether light that skin throws stops at the skin before it, or goes by form factors alone
    correctives:       how the corrections of a trained avatar's pose are found (avatar.tiers)
    threads:           0 = as many as is sensible
    backend:           "auto", "v3", "v4" or "neon": the variant of the kernels
    depth, normals, ids: maps that the frame carries
    effects:           which may run
    antialias:         whether hands that are much smaller than they were learned are drawn larger and averaged; off
                       where an image is compared with the pictures it was learned from
    reuse:             whether stages whose input has hardly changed keep their last result, within the bound in the
                       report
    repeatable:        whether they keep it only when nothing changed at all: an image then depends on nothing that was
                       drawn before it, and its bits are the same in every part of an animation
    """

    gaussians: int = 0
    alpha_min: float = contract.ALPHA_MIN
    t_stop: float = contract.T_STOP
    shadow: ShadowMode = ShadowMode.GATED
    shadow_samples: int = 16
    outline_px: float = 1.0
    sharp_shadows: bool = False
    swept_light: bool = False
    correctives: Tier = Tier.AUTO
    threads: int = 0
    backend: str = "auto"
    depth: bool = True
    normals: bool = False
    ids: bool = False
    effects: Choice = AUTO
    antialias: bool = True
    reuse: bool = True
    repeatable: bool = False

    def __post_init__(self) -> None:
        checks = (
            ("gaussians", self.gaussians >= 0, "0 (all) or a positive count"),
            ("alpha_min", 0 < self.alpha_min < 1, "a value between 0 and 1"),
            ("t_stop", 0 <= self.t_stop < 1, "a value from 0 to below 1"),
            (
                "shadow_samples",
                1 <= self.shadow_samples <= contract.SHADOW_SAMPLES_MAX,
                f"1 to {contract.SHADOW_SAMPLES_MAX}",
            ),
            ("outline_px", self.outline_px > 0, "a positive number of pixels"),
            ("correctives", self.correctives in tuple(Tier), " | ".join(Tier)),
            ("threads", self.threads >= 0, "0 (automatic) or a positive count"),
        )
        for name, good, wanted in checks:
            if not good:
                raise InputError(f"render setting {name}", wanted=wanted, came=str(getattr(self, name)))

    def as_dict(self) -> dict[str, Any]:
        """For JSON: every setting by its name; effects in the words that `Choice.parse` takes."""
        return {**vars(self), "effects": str(self.effects)}


# the presets of RENDERING 9.3; `viewport` is the default
PRESETS: dict[str, RenderSettings] = {
    "draft": RenderSettings(gaussians=20_000, alpha_min=1 / 64, t_stop=1e-2, shadow=ShadowMode.OFF),
    "viewport": RenderSettings(),
    "final": RenderSettings(
        alpha_min=1 / 1024,
        shadow_samples=64,
        outline_px=0.25,
        sharp_shadows=True,
        swept_light=True,
        correctives=Tier.EXACT,
    ),
    "reference": RenderSettings(
        alpha_min=1 / 16384,
        t_stop=1e-6,
        shadow=ShadowMode.ALWAYS,
        shadow_samples=64,
        outline_px=0.25,
        sharp_shadows=True,
        swept_light=True,
        correctives=Tier.EXACT,
        reuse=False,
    ),
}


def preset(name: str) -> RenderSettings:
    """The settings of a named preset; an unknown name is an InputError."""
    if name not in PRESETS:
        raise InputError("preset", wanted=" | ".join(PRESETS), came=name)
    return PRESETS[name]
