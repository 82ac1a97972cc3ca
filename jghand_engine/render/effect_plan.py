"""What may be done for an image beyond the least, which of it was requested, and what was decided: plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, NamedTuple

from jghand_engine.errors import InputError
from jghand_engine.render.hand_facts import Ball
from jghand_engine.render.image import Box


class Effect(StrEnum):
    """A pass over the hand or the image that a scene may do without."""

    SKIN = "skin"
    CORRECTIVES = "correctives"
    CAST = "cast-shadow"
    DETAIL = "detail"
    FILTER = "filter"
    SHADOW = "self-shadow"
    MOTION = "motion-blur"
    FOCUS = "depth-of-field"
    WHOLE = "whole-picture"
    LAMPS = "lamps"
    LAMP_SHADOW = "lamp-shadow"
    SHARP_SHADOW = "sharp-shadow"
    WORLD_SHADOW = "world-shadow"
    GLOSS = "gloss"


# without a skin or a light there is no image; the one is only reused, of the other what nobody sees is left out
CHOOSABLE = tuple(effect for effect in Effect if effect not in (Effect.SKIN, Effect.LAMPS))
# what a hand has in the light of its capture alone, and in that of a scene alone; nothing is decided about the others
OF_CAPTURE = frozenset({Effect.CAST, Effect.SHADOW})
OF_SCENE = frozenset({Effect.LAMPS, Effect.LAMP_SHADOW, Effect.SHARP_SHADOW, Effect.WORLD_SHADOW, Effect.GLOSS})


@dataclass(frozen=True)
class Choice:
    """Which effects may run.

    named:  None: all of them
    forced: those that run on every frame, called for or not; the forced skin and correctives are never reused
    """

    named: frozenset[Effect] | None = None
    forced: frozenset[Effect] = frozenset()

    @classmethod
    def parse(cls, text: str) -> Choice:
        """auto (what a scene calls for), all (everything, always), none, or names of effects with commas, which run
        when they are called for. InputError names an unknown one."""
        words = [word.strip() for word in text.split(",") if word.strip()]
        special = {"auto": cls(), "all": cls(forced=frozenset(Effect)), "none": cls(frozenset())}
        if len(words) == 1 and words[0] in special:
            return special[words[0]]
        unknown = [word for word in words if word not in CHOOSABLE]
        if unknown or not words:
            wanted = f"auto | all | none | names of {', '.join(CHOOSABLE)}"
            raise InputError("effects", wanted=wanted, came=", ".join(unknown) or repr(text))
        return cls(frozenset(map(Effect, words)))

    def __str__(self) -> str:
        """The words that `parse` takes."""
        if self.forced:
            return "all"
        return "auto" if self.named is None else ",".join(sorted(self.named)) or "none"

    def allows(self, effect: Effect) -> bool:
        """Whether the effect may run at all."""
        return self.named is None or effect in self.named

    def forces(self, effect: Effect) -> bool:
        """Whether the effect runs on every frame on which it can."""
        return effect in self.forced


AUTO = Choice()
# why an effect does not run
NOT_CHOSEN = "not among the chosen effects"


class Decision(NamedTuple):
    """About one effect. Its words are put together when somebody reads them, which few frames meet.

    why:          template of the reason
    lost:         template of how far the image may be from one with (or, of what runs, without) the effect
    worst:        the same as the largest difference of a channel, 0..1; None where none is known
    estimated_ms: of running it, on one core
    figures:      the numbers of the templates
    """

    effect: Effect
    runs: bool
    why: str
    lost: str = "0"
    worst: float | None = 0.0
    estimated_ms: float = 0.0
    figures: tuple[float, ...] = ()

    @property
    def reason(self) -> str:
        return self.why.format(*self.figures)

    @property
    def bound(self) -> str:
        return self.lost.format(*self.figures)

    def line(self, measured_ms: float | None = None) -> str:
        """One line of the receipt: `self-shadow   skipped  gate 0.21; at most …; would be about 0.4 ms`."""
        if self.runs:
            cost = f"{measured_ms:.2f} ms" if measured_ms is not None else f"about {self.estimated_ms:.2g} ms"
        else:
            cost = f"saved about {self.estimated_ms:.2g} ms" if self.estimated_ms else ""
        words = "; ".join(filter(None, (self.reason, f"{'without' if self.runs else 'off by'}: {self.bound}", cost)))
        return f"{self.effect:<15}{'ran' if self.runs else 'skipped':<9}{words}"

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON and for the wire."""
        numbers = {"worst": self.worst, "estimated_ms": self.estimated_ms}
        return {"effect": str(self.effect), "runs": self.runs, "reason": self.reason, "bound": self.bound} | numbers


@dataclass(frozen=True)
class Sharp:
    """Shadows on a hand with the edges of surfaces.

    weights:   per lamp how much they count beside those of capsules, 0..1; empty for none
    ball:      around the hand's surface
    at_pixels: per lamp how much of them is found at pixels instead of at Gaussians, 0..1
    """

    weights: tuple[float, ...]
    ball: Ball
    at_pixels: tuple[float, ...]


@dataclass(frozen=True)
class EffectPlan:
    """How one image is made.

    decisions: one per effect that the light has
    box:       what is drawn of the image, empty where no hand can be seen
    seen:      per hand whether it can be
    strength:  of the shadow pass, 0..1
    enlarged:  how many times larger a small hand is drawn, and averaged; 1 = not
    plain:     share, 0..1, of the image that is not
    exposures: images that are averaged for motion and focus
    detail:    strength of each hand's detail, 0..1, 0 outside the image; empty where none is drawn
    sharp:     per hand which shadows on it have the edges of surfaces; empty where none have
    """

    decisions: tuple[Decision, ...]
    box: Box
    seen: tuple[bool, ...]
    strength: float = 0.0
    enlarged: int = 1
    plain: float = 1.0
    exposures: int = 1
    detail: tuple[float, ...] = ()
    sharp: tuple[Sharp, ...] = ()

    def __getitem__(self, effect: Effect) -> Decision:
        return next(decision for decision in self.decisions if decision.effect is effect)

    def runs(self, effect: Effect) -> bool:
        """Whether it was decided to run the effect."""
        return self[effect].runs

    def with_averages(self, decisions: Sequence[Decision], exposures: int) -> EffectPlan:
        """The plan of one image with those of the mean that it is a part of."""
        if not decisions and exposures == self.exposures:
            return self
        changed = {one.effect: one for one in decisions}
        merged = tuple(changed.get(one.effect, one) for one in self.decisions)
        return replace(self, decisions=merged, exposures=exposures)
