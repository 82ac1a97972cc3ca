"""What skipping effects saves and costs: frames of a motion as the scene calls for them, beside frames on which one
effect is forced. `jghand study effects`.

Both are drawn in turn by one process, so that a busy machine hits both alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.captures.captures import Capture
from jghand_engine.captures.sample import Sample, load_picture
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import MotionOptions, named_pose, pose_names, pose_sequence_of_names
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.metrics import psnr
from jghand_engine.learn.shadow import darken
from jghand_engine.learn.tables import NONE, Table, number
from jghand_engine.native.library import load
from jghand_engine.render.blur import shutter_at
from jghand_engine.render.camera import Camera, Lens
from jghand_engine.render.effect_plan import Choice, Effect
from jghand_engine.render.gate import GATE_LOW, ShadowGate, fade
from jghand_engine.render.renderer import Frame, HandRenderer
from jghand_engine.render.settings import RenderSettings, ShadowMode, preset
from jghand_engine.render.shadow import ShadowStyle
from jghand_engine.render.subject import Subject

# occlusion that is seen: the part of the hand's pixels beyond it is what the gate is judged by (METHOD 5.4)
GATE_NEED = 0.2

POSES = ("open", "spread", "open", "relaxed", "fist", "point", "victory", "pinch", "open")
# a picture of a capture, or a name with joints (21, 3), meters, and a camera
GateSample = Sample | tuple[str, np.ndarray, Camera]
# effects that can be forced on every frame of a hand
FORCED = (Effect.SKIN, Effect.CORRECTIVES, Effect.SHADOW, Effect.WHOLE)
# frames on which shutter and lens are opened
OPENED_FRAMES = 8
# the gate: every so many frames of the motion, and at most so many pictures of a capture, evenly spread
GATE_STEP = 3
GATE_PICTURES = 200


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
    # as the receipts state them
    bounds: set[str] = field(default_factory=set)

    def as_dict(self) -> dict:
        """Plain data for JSON."""
        return {
            "effect": str(self.effect), "frames": self.frames, "skipped": self.skipped,
            "worst_error": max(self.errors, default=None), "saved_ms_median": self.saved_median_ms,
            "saved_ms": sum(self.saved_ms), "bounds": sorted(self.bounds),
        }  # fmt: skip

    @property
    def saved_median_ms(self) -> float | None:
        """Of the frames that skipped it; None without any."""
        return float(np.median(self.saved_ms)) if self.saved_ms else None


@dataclass(frozen=True)
class GateRow:
    """One picture of the calibration of the shadow's gate."""

    name: str
    # of the gate, and what it lets through
    score: float
    strength: float
    # part of the hand's pixels that the whole shadow darkens by over 0.2 of its tint
    occluded: float
    # largest difference of a channel between no shadow and the whole one
    darkest: float
    # PSNR of the hand without and with it; None without a picture
    truth_db: tuple[float, float] | None = None


# other thresholds of the gate's score that are tried: three octaves, and everything
CLOSED_BELOW = (2.0, 4.0, 8.0, 16.0, math.inf)


@dataclass(frozen=True)
class EffectsStudy:
    """Everything that was measured."""

    # in words
    subject: str
    rows: list[EffectRow]
    gate: list[GateRow]
    # what ran on each frame
    strip: dict[Effect, list[bool]]

    def as_dict(self) -> dict:
        """Plain data for JSON."""
        return {
            "subject": self.subject,
            "effects": [row.as_dict() for row in self.rows],
            "gate": [vars(row) for row in self.gate],
            "gate_closed_below": self.gate_rows(),
            "strip": {str(effect): runs for effect, runs in self.strip.items()},
        }

    def gate_rows(self) -> list[dict]:
        """What would be skipped, were the gate closed below a score: as it is, tighter, and always. Per threshold: the
        score (None: never open), the pictures skipped, the worst of them (part of the hand occluded, difference), and
        their mean PSNR against the captured pictures without the shadow and with it."""
        return [_skipped_below(self.gate, score) for score in (GATE_LOW, *CLOSED_BELOW)]

    @property
    def headline(self) -> str:
        """How often what saves the most is skipped."""
        saving = sorted((row for row in self.rows if row.saved_ms), key=lambda row: -sum(row.saved_ms))[:3]
        parts = [f"{row.effect} skipped on {100 * row.skipped / row.frames:.0f} % of frames" for row in saving]
        return f"{self.subject}: {', '.join(parts) or 'nothing could be skipped'}."

    def tables(self) -> list[Table]:
        """What is printed."""
        return [self._effects_table(), *([self._gate_table()] if self.gate else [])]

    def _effects_table(self) -> Table:
        rows = [
            (
                str(row.effect), f"{row.skipped} of {row.frames}",
                NONE if not row.errors else f"{255 * max(row.errors):.2g}", number(row.saved_median_ms, 2),
                "; ".join(sorted(row.bounds)) or NONE,
            )
            for row in self.rows
        ]  # fmt: skip
        columns = ("Effect", "Frames skipped", "Worst error, 8-bit steps", "ms saved a frame", "Bound")
        notes = (
            f"{self.subject}. Worst error: the largest difference of any channel of any pixel on the frames that skip "
            "the effect, from the same frames with it; - where it has nothing to do on them, even when it is forced.",
            "ms: median over those frames, the whole frame with the effect minus the whole frame without it.",
        )
        return Table("Effects skipped", columns, tuple(rows), notes)

    def _gate_table(self) -> Table:
        cells = [
            (
                "never open" if row["score"] is None else f"{row['score']:g}{', as it is' if place == 0 else ''}",
                f"{row['skipped']} of {len(self.gate)}",
                NONE if row["occluded"] is None else f"{100 * row['occluded']:.1f} %",
                NONE if row["darkest"] is None else f"{255 * row['darkest']:.1f}",
                number(row["db_without"], 2),
                number(row["db_with"], 2),
            )
            for place, row in enumerate(self.gate_rows())
        ]
        columns = ("Gate closed below a score of", "pictures skipped", "worst: pixels occluded by over 0.2",
                   "worst: 8-bit steps", "dB without", "dB with")  # fmt: skip
        notes = (
            "Worst: of the pictures skipped, what the whole shadow of this avatar would have changed.",
            "dB: of the pictures skipped, against the captured ones, on the hand alone, without and with the shadow.",
        )
        return Table("The gate against the whole shadow", columns, tuple(cells), notes)


def _skipped_below(rows: Sequence[GateRow], score: float) -> dict:
    skipped = [row for row in rows if row.score <= score]
    truth = [row.truth_db for row in skipped if row.truth_db is not None]
    without, with_it = np.mean(truth, axis=0).tolist() if truth else (None, None)
    return {
        "score": score if math.isfinite(score) else None,
        "skipped": len(skipped),
        "occluded": max((row.occluded for row in skipped), default=None),
        "darkest": max((row.darkest for row in skipped), default=None),
        "db_without": without,
        "db_with": with_it,
    }


# ---- scenes ---------------------------------------------------------------------------------------------------------


def named_motion(avatar: HandAvatar, poses: Sequence[str] = POSES) -> np.ndarray:
    """(F, 21, 3) named poses with ways between them; in the last third the hand moves as a whole."""
    options = MotionOptions(fps=15.0, hold_s=0.3, variation_deg=0.0)
    canonical = avatar.canonical_joints_m
    joints = pose_sequence_of_names(poses, canonical, handedness=avatar.handedness, options=options).joints_m
    still = joints[-1]
    part = np.linspace(0, 1, len(joints) // 3)[1:, None, None]
    return np.concatenate([joints, still + part * np.array([0.03, 0.02, 0.0])])


def measure_effects(
    subject: Subject, capture: Capture | None, tick: Callable[[], None], settings: RenderSettings
) -> EffectsStudy:
    """The study of a motion; with a capture the gate is also calibrated on its pictures, else on named poses."""
    avatar, camera = subject.avatar, subject.camera
    rows, strip = effects_of_motion(subject, settings, tick)
    rows += [opened(effect, subject, settings) for effect in (Effect.MOTION, Effect.FOCUS)]
    samples: list[GateSample] = [
        (f"motion/{index}", subject.poses[index], camera) for index in range(0, len(subject.poses), GATE_STEP)
    ]
    gate = _gate_rows(avatar, samples)
    if capture is None:
        canonical = avatar.canonical_joints_m
        poses = {name: named_pose(name, canonical, handedness=avatar.handedness) for name in pose_names()}
        gate += _gate_rows(avatar, [(name, joints_m, camera) for name, joints_m in poses.items()])
    else:
        step = -(-len(capture.samples) // GATE_PICTURES)
        gate += _gate_rows(avatar.for_hand(capture.handedness), capture.samples[::step])
    title = f"{avatar.info.name}, {subject.name}, {len(subject.poses)} frames of {camera.width} x {camera.height}"
    return EffectsStudy(title, rows, gate, strip)


def effects_of_motion(
    subject: Subject, settings: RenderSettings, tick: Callable[[], None]
) -> tuple[list[EffectRow], dict[Effect, list[bool]]]:
    """Frames as the scene calls for them against frames on which one effect is forced; and what ran on each frame."""
    plain = HandRenderer(subject.avatar, settings)
    others = {
        effect: HandRenderer(subject.avatar, replace(settings, effects=Choice(forced=frozenset([effect]))))
        for effect in FORCED
    }
    rows = {effect: EffectRow(effect) for effect in FORCED}
    strip: dict[Effect, list[bool]] = {effect: [] for effect in Effect}
    for joints in subject.poses:
        auto = plain.render(joints, subject.camera)
        for decision in auto.report.plan.decisions if auto.report.plan else ():
            strip[decision.effect].append(decision.runs)
        for effect, renderer in others.items():
            _compare(rows[effect], auto, renderer.render(joints, subject.camera))
        tick()
    return list(rows.values()), strip


def _compare(row: EffectRow, auto: Frame, other: Frame) -> None:
    """Adds a frame, and, where it skipped the effect, what that changed and saved."""
    row.frames += 1
    decision = auto.report.plan[row.effect] if auto.report.plan else None
    forced = other.report.plan[row.effect] if other.report.plan else None
    if decision is None or decision.runs:
        return
    row.skipped += 1
    row.bounds.add(decision.bound)
    if forced is not None and forced.runs:
        row.errors.append(float(np.abs(auto.rgba - other.rgba).max()))
        row.saved_ms.append(other.report.total_ms - auto.report.total_ms)


def opened(effect: Effect, subject: Subject, settings: RenderSettings) -> EffectRow:
    """What a shutter of half the time, or a lens of 8 mm, costs, which is saved where there is none."""
    row, camera = EffectRow(effect), subject.camera
    renderer = HandRenderer(subject.avatar, replace(settings, reuse=False, depth=False))
    for index in np.linspace(0, len(subject.poses) - 1, OPENED_FRAMES).astype(int):
        joints = subject.poses[index]
        still = renderer.render(joints, camera)
        if effect is Effect.MOTION:
            blurred = renderer.render(joints, camera, shutter_at(subject.poses, int(index), 0.5))
        else:
            depth_m = float(camera.project(joints[0])[1])
            blurred = renderer.render(joints, replace(camera, lens=Lens(0.008, depth_m)))
        row.frames += 1
        row.skipped += 1
        row.bounds.add(still.report.plan[effect].bound if still.report.plan else "")
        row.saved_ms.append(blurred.report.total_ms - still.report.total_ms)
    return row


# ---- the gate -------------------------------------------------------------------------------------------------------


def _gate_rows(avatar: HandAvatar, samples: Sequence[GateSample]) -> list[GateRow]:
    renderer = HandRenderer(avatar, replace(preset("viewport"), shadow=ShadowMode.OFF))
    return [gate_row(renderer, avatar, sample) for sample in samples]


def gate_row(renderer: HandRenderer, avatar: HandAvatar, sample: GateSample) -> GateRow:
    """renderer: of `avatar`, without shadow, with depth."""
    truth = None
    if isinstance(sample, Sample):
        name, joints_m, camera = f"{sample.sequence}/{sample.frame}", sample.joints_m, sample.camera
        truth = load_picture(sample)
    else:
        name, joints_m, camera = sample
    frame = renderer.render(joints_m, camera)
    look = ShadowLook() if avatar.learned is None else avatar.learned.shadow or ShadowLook()
    planes = torch.from_numpy(np.concatenate([frame.rgba, (frame.rgba[..., 3] * frame.depth_m)[..., None]], -1))
    planes = planes.permute(2, 0, 1).contiguous()
    style = ShadowStyle(gain=look.gain, tint=(1.0, 1.0, 1.0), samples=32)
    visible = (darken(planes, camera, style, library=load()) / planes[:3].clamp_min(1e-6))[1].numpy()
    hand = frame.rgba[..., 3] > 0.5
    occlusion = np.where(hand, 1 - visible, 0.0)
    shaded = frame.rgba[..., :3] * (1 - occlusion[..., None] * np.array(look.tint, np.float32))
    score = ShadowGate(avatar.canonical_joints_m).score(joints_m, _scale(avatar, joints_m))
    truth_db = None
    if truth is not None:
        inside = truth.mask >= 0.5
        truth_db = tuple(
            psnr(np.asarray(rgb[inside], np.float32), truth.rgb[inside]) for rgb in (frame.rgba[..., :3], shaded)
        )
    darkest = float(np.abs(shaded - frame.rgba[..., :3]).max())
    occluded = float((occlusion[hand] > GATE_NEED).mean()) if hand.any() else 0.0
    return GateRow(name, score, fade(score), occluded, darkest, truth_db)  # type: ignore[arg-type]


def _scale(avatar: HandAvatar, joints_m: np.ndarray) -> float:
    """s_g: how large the hand is beside its avatar."""
    bones = transform_of(avatar.for_hand(Handedness.RIGHT)).bones(torch.from_numpy(joints_m))
    return float(bones.scale)
