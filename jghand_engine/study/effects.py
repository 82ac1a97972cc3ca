"""`jghand study effects`: what skipping effects saves and costs.

Frames of a motion as the scene calls for them stand beside frames on which one effect is forced, and in the light of
scenes beside frames on which all are.

Both are drawn in turn by one process, so that a busy machine hits both alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.hand.poses import MotionOptions, pose_sequence_of_names
from jghand_engine.learn.tables import NONE, Table, number
from jghand_engine.render.blur import shutter_at
from jghand_engine.render.camera import Lens
from jghand_engine.render.effect_plan import OF_SCENE, Choice, Decision, Effect
from jghand_engine.render.renderer import Frame, HandRenderer
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.subject import Subject
from jghand_engine.study.effects_in_light import LightRow, light_table, measure_lights

POSES = ("open", "spread", "open", "relaxed", "fist", "point", "victory", "pinch", "open")
# effects that can be forced on every frame of a hand
FORCED = (Effect.SKIN, Effect.CORRECTIVES, Effect.SHADOW, Effect.WHOLE)
# part of a motion, from its beginning, that a quick study measures
QUICK_PART = 0.25
# frames on which shutter and lens are opened, the part of a frame's time that the shutter is open, and the opening of
# the lens, meters
OPENED_FRAMES, SHUTTER, APERTURE_M = 8, 0.5, 0.008


@dataclass
class EffectRow:
    """One effect."""

    effect: Effect
    frames: int = 0
    # of those frames
    skipped: int = 0
    # worst difference of a channel, 0..1, on each frame that skipped it and could be drawn with it
    errors: list[float] = field(default_factory=list)
    # how much longer the frame took with it
    saved_ms: list[float] = field(default_factory=list)
    # as the frames' reports state them: the largest numbers of each kind, by its template
    stated: dict[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def saved_median_ms(self) -> float | None:
        """Of the frames that skipped it; None without any."""
        return float(np.median(self.saved_ms)) if self.saved_ms else None

    @property
    def bounds(self) -> list[str]:
        return sorted(template.format(*figures) for template, figures in self.stated.items())

    def skip(self, decision: Decision) -> None:
        self.skipped += 1
        before = self.stated.get(decision.lost, decision.figures)
        self.stated[decision.lost] = tuple(map(max, before, decision.figures))


@dataclass(frozen=True)
class EffectsStudy:
    """Everything that was measured."""

    # in words
    subject: str
    effects: list[EffectRow]
    # what ran on each frame
    strip: dict[Effect, list[bool]]
    # in the light of scenes
    lights: list[LightRow] = field(default_factory=list)

    @property
    def headline(self) -> str:
        """How often what saves the most is skipped."""
        saving = sorted((row for row in self.effects if row.saved_ms), key=lambda row: -sum(row.saved_ms))[:3]
        parts = [f"{row.effect} skipped on {100 * row.skipped / row.frames:.0f} % of frames" for row in saving]
        return f"{self.subject}: {', '.join(parts) or 'nothing could be skipped'}."

    def tables(self) -> list[Table]:
        rows = [
            (
                str(row.effect), f"{row.skipped} of {row.frames}",
                NONE if not row.errors else f"{255 * max(row.errors):.2g}", number(row.saved_median_ms, 2),
                "; ".join(row.bounds) or NONE,
            )
            for row in self.effects
        ]  # fmt: skip
        columns = ("Effect", "Frames skipped", "Worst error, 8-bit steps", "ms saved a frame", "Bound")
        notes = (
            f"{self.subject}. Worst error: the largest difference of any channel of any pixel on the frames that skip "
            "the effect, from the same frames with it; - where it has nothing to do on them, even when it is forced.",
            "ms: median over those frames, the whole frame with the effect minus the whole frame without it.",
        )
        skipped = Table("Effects skipped", columns, tuple(rows), notes)
        return [skipped, light_table(self.lights)] if self.lights else [skipped]


def named_motion(avatar: HandAvatar, poses: Sequence[str] = POSES) -> np.ndarray:
    """(F, 21, 3) named poses with ways between them; in the last third the hand moves as a whole."""
    options = MotionOptions(fps=15.0, hold_s=0.3, variation_deg=0.0)
    canonical = avatar.canonical_joints_m
    joints = pose_sequence_of_names(poses, canonical, handedness=avatar.handedness, options=options).joints_m
    part = np.linspace(0, 1, len(joints) // 3)[1:, None, None]
    return np.concatenate([joints, joints[-1] + part * np.array([0.03, 0.02, 0.0])])


def measure_effects(subject: Subject, settings: RenderSettings, tick: Callable[[], None]) -> EffectsStudy:
    """The study of a motion. tick: called after every frame"""
    rows, strip = effects_of_motion(subject, settings, tick)
    rows += [opened(effect, subject, settings) for effect in (Effect.MOTION, Effect.FOCUS)]
    size = f"{len(subject.poses)} frames of {subject.camera.width} x {subject.camera.height}"
    name = f"{subject.avatar.info.name}, {subject.name}, {size}"
    return EffectsStudy(name, rows, strip, measure_lights(subject, settings))


def effects_of_motion(
    subject: Subject, settings: RenderSettings, tick: Callable[[], None]
) -> tuple[list[EffectRow], dict[Effect, list[bool]]]:
    """Frames as the scene calls for them against frames on which one effect is forced; and what ran on each frame."""
    auto = HandRenderer(subject.avatar, settings)
    forced = {
        effect: HandRenderer(subject.avatar, replace(settings, effects=Choice(forced=frozenset([effect]))))
        for effect in FORCED
    }
    rows = {effect: EffectRow(effect) for effect in FORCED}
    strip: dict[Effect, list[bool]] = {effect: [] for effect in Effect if effect not in OF_SCENE}
    for joints in subject.poses:
        frame = auto.render(joints, subject.camera)
        for decision in frame.report.plan.decisions if frame.report.plan else ():
            strip[decision.effect].append(decision.runs)
        for effect, renderer in forced.items():
            _compare(rows[effect], frame, renderer.render(joints, subject.camera))
        tick()
    return list(rows.values()), strip


def _compare(row: EffectRow, frame: Frame, other: Frame) -> None:
    """Adds a frame, and, where it skipped the effect, what that changed and saved."""
    row.frames += 1
    decision = frame.report.plan[row.effect] if frame.report.plan else None
    forced = other.report.plan[row.effect] if other.report.plan else None
    if decision is None or decision.runs:
        return
    row.skip(decision)
    if forced is not None and forced.runs:
        row.errors.append(float(np.abs(frame.rgba - other.rgba).max()))
        row.saved_ms.append(other.report.total_ms - frame.report.total_ms)


def opened(effect: Effect, subject: Subject, settings: RenderSettings) -> EffectRow:
    """What an open shutter or lens costs, which is saved where there is none."""
    row, camera = EffectRow(effect), subject.camera
    renderer = HandRenderer(subject.avatar, replace(settings, reuse=False, depth=False))
    for index in np.linspace(0, len(subject.poses) - 1, OPENED_FRAMES).astype(int):
        joints = subject.poses[index]
        still = renderer.render(joints, camera)
        if effect is Effect.MOTION:
            moments = shutter_at(list(subject.poses), int(index), SHUTTER, camera)
            blurred = renderer.render_moments(moments, [1.0] * len(moments))
        else:
            depth_m = float(camera.project(joints[0])[1])
            blurred = renderer.render(joints, replace(camera, lens=Lens(APERTURE_M, depth_m)))
        row.frames += 1
        if still.report.plan:
            row.skip(still.report.plan[effect])
        row.saved_ms.append(blurred.report.total_ms - still.report.total_ms)
    return row
