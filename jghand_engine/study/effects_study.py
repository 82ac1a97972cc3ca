"""What skipping effects saves and costs: frames of a motion as the scene calls for them, beside frames on which one
effect is forced. `jghand study effects`.

Both are drawn in turn by one process, so that a busy machine hits both alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from jghand_engine import limits
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.captures.sample import Sample, load_picture
from jghand_engine.hand.anatomy import MotionOptions, pose_sequence_of_names
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.metrics import psnr
from jghand_engine.learn.tables import NONE, Table, number
from jghand_engine.native.library import load
from jghand_engine.render.camera import Camera, Lens
from jghand_engine.render.effect_plan import Choice, Effect
from jghand_engine.render.exposure import shutter_at
from jghand_engine.render.frame import Frame, HandRenderer, SceneRenderer
from jghand_engine.render.gate import ShadowGate, fade
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.shadow import ShadowStyle
from jghand_engine.render.shadow_native import darken

POSES = ("open", "spread", "open", "relaxed", "fist", "point", "victory", "pinch", "open")
# a picture of a capture, or a name with joints (21, 3), meters, and a camera
GateSample = Sample | tuple[str, np.ndarray, Camera]
# effects that can be forced on every frame of a hand alone; the others are measured in scenes of their own
FORCED = (Effect.SKIN, Effect.CORRECTIVES, Effect.SHADOW, Effect.TAIL, Effect.WHOLE)


@dataclass(frozen=True)
class Subject:
    """A hand in motion before a camera. poses: (F, 21, 3) meters · cameras: one per frame"""

    name: str
    avatar: HandAvatar
    poses: np.ndarray
    cameras: Sequence[Camera]


@dataclass
class EffectRow:
    """One effect in one scene. skipped: of so many frames · errors: worst difference of a channel, 0..1, on each frame
    that skipped it and could be drawn with it · saved_ms: how much longer it took then · bounds: as the receipts state
    them"""

    effect: Effect
    scene: str
    frames: int = 0
    skipped: int = 0
    errors: list[float] = field(default_factory=list)
    saved_ms: list[float] = field(default_factory=list)
    bounds: set[str] = field(default_factory=set)

    def as_dict(self) -> dict:
        """Plain data for JSON."""
        return {
            "effect": str(self.effect), "scene": self.scene, "frames": self.frames, "skipped": self.skipped,
            "worst_error": max(self.errors, default=None), "saved_ms_median": self.saved_median_ms,
            "saved_ms": sum(self.saved_ms), "bounds": sorted(self.bounds),
        }  # fmt: skip

    @property
    def saved_median_ms(self) -> float | None:
        """Of the frames that skipped it; None without any."""
        return float(np.median(self.saved_ms)) if self.saved_ms else None


@dataclass(frozen=True)
class GateRow:
    """One picture of the calibration. score: of the gate · strength: what it lets through · occluded: part of the
    hand's pixels that the whole shadow darkens by over 0.2 of its tint · darkest: largest difference of a channel
    between no shadow and the whole one · truth_db: PSNR of the hand without and with it; None without a picture"""

    name: str
    score: float
    strength: float
    occluded: float
    darkest: float
    truth_db: tuple[float, float] | None = None


# other thresholds of the gate's score that are tried: three octaves, and everything
CLOSED_BELOW = (2.0, 4.0, 8.0, 16.0, math.inf)


@dataclass(frozen=True)
class EffectsStudy:
    """Everything that was measured. subject: in words · strip: for the picture: per frame what ran"""

    subject: str
    rows: list[EffectRow]
    gate: list[GateRow]
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
        return [_skipped_below(self.gate, score) for score in (limits.GATE_LOW, *CLOSED_BELOW)]

    def tables(self) -> list[Table]:
        """What is printed."""
        return [self._effects_table(), *([self._gate_table()] if self.gate else [])]

    def _effects_table(self) -> Table:
        rows = [
            (
                row.effect, row.scene, str(row.frames), f"{100 * row.skipped / max(row.frames, 1):.0f} %",
                NONE if not row.errors else f"{255 * max(row.errors):.2g}", number(row.saved_median_ms, 2),
                number(sum(row.saved_ms), 0) if row.saved_ms else NONE, "; ".join(sorted(row.bounds)) or NONE,
            )
            for row in self.rows
        ]  # fmt: skip
        columns = ("Effect", "Scene", "frames", "skipped", "worst error, 8-bit steps", "ms saved a frame",
                   "ms saved in all", "Bound")  # fmt: skip
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
    canonical = avatar.canonical_joints_m.numpy()
    joints = pose_sequence_of_names(poses, canonical, handedness=avatar.handedness, options=options).joints_m
    still = joints[-1]
    part = np.linspace(0, 1, len(joints) // 3)[1:, None, None]
    return np.concatenate([joints, still + part * np.array([0.03, 0.02, 0.0])])


def effects_of_motion(
    subject: Subject, settings: RenderSettings, tick: Callable[[], None]
) -> tuple[list[EffectRow], dict[Effect, list[bool]]]:
    """Frames as the scene calls for them against frames on which one effect is forced; and what ran on each frame."""
    plain = HandRenderer(subject.avatar, settings)
    others = {
        effect: HandRenderer(subject.avatar, replace(settings, effects=Choice(forced=frozenset([effect]))))
        for effect in FORCED
    }
    rows = {effect: EffectRow(effect, subject.name) for effect in FORCED}
    strip: dict[Effect, list[bool]] = {effect: [] for effect in Effect}
    for joints, camera in zip(subject.poses, subject.cameras, strict=True):
        auto = plain.render(joints, camera)
        for decision in auto.report.plan.decisions if auto.report.plan else ():
            strip[decision.effect].append(decision.runs)
        for effect, renderer in others.items():
            _compare(rows[effect], auto, renderer.render(joints, camera))
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


def maps_and_cameras(subject: Subject, settings: RenderSettings, tick: Callable[[], None]) -> list[EffectRow]:
    """Maps that nobody asked for, a shutter and a lens that the scene does not have, a hand that is large enough."""
    rows = []
    depth = replace(settings, depth=False)
    askers = {
        Effect.DEPTH: replace(depth, depth=True),
        Effect.NORMALS: replace(depth, normals=True),
        Effect.IDS: replace(depth, ids=True),
    }
    bare = HandRenderer(subject.avatar, replace(depth, reuse=False))
    for effect, asking in askers.items():
        row, asked = EffectRow(effect, subject.name), HandRenderer(subject.avatar, replace(asking, reuse=False))
        for joints, camera in _few(subject):
            _compare(row, bare.render(joints, camera), asked.render(joints, camera))
            tick()
        rows.append(row)
    rows.append(_opened(Effect.MOTION, subject, bare, tick))
    rows.append(_opened(Effect.FOCUS, subject, bare, tick))
    return rows


SOME = 8


def _few(subject: Subject) -> Iterator[tuple[np.ndarray, Camera]]:
    """SOME frames, evenly spread."""
    for index in np.linspace(0, len(subject.poses) - 1, SOME).astype(int):
        yield subject.poses[index], subject.cameras[index]


def _opened(effect: Effect, subject: Subject, renderer: HandRenderer, tick: Callable[[], None]) -> EffectRow:
    """What a shutter of half the time, or a lens of 8 mm, costs, which is saved where there is none."""
    row = EffectRow(effect, subject.name)
    for index in np.linspace(0, len(subject.poses) - 1, SOME).astype(int):
        joints, camera = subject.poses[index], subject.cameras[index]
        still = renderer.render(joints, camera)
        if effect is Effect.MOTION:
            opened = renderer.render(joints, camera, shutter_at(subject.poses, int(index), 0.5))
        else:
            depth_m = float(camera.project(torch.from_numpy(joints[0]))[1])
            opened = renderer.render(joints, replace(camera, lens=Lens(0.008, depth_m)))
        row.frames += 1
        row.skipped += 1
        row.bounds.add(still.report.plan[effect].bound if still.report.plan else "")
        row.saved_ms.append(opened.report.total_ms - still.report.total_ms)
        tick()
    return row


def hands_approaching(avatar: HandAvatar, pose: np.ndarray, camera: Camera, settings: RenderSettings) -> EffectRow:
    """Two hands at distances from touching to apart: when the shadow between them is left out."""
    row, renderer = EffectRow(Effect.BETWEEN, "two hands"), SceneRenderer([avatar, avatar], settings)
    for gap_m in np.linspace(0.1, 0.4, SOME):
        plan = renderer.render([pose, pose + np.array([gap_m, 0.0, 0.0])], camera).report.plan
        row.frames += 1
        if plan is not None and not plan.runs(Effect.BETWEEN):
            row.skipped += 1
            row.bounds.add(plan[Effect.BETWEEN].bound)
    return row


# ---- the gate -------------------------------------------------------------------------------------------------------


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
    score = ShadowGate(avatar.canonical_joints_m.numpy()).score(joints_m, _scale(avatar, joints_m))
    truth_db = None
    if truth is not None:
        inside = truth.mask >= 0.5
        truth_db = tuple(
            psnr(np.asarray(rgb[inside], np.float32), truth.rgb[inside]) for rgb in (frame.rgba[..., :3], shaded)
        )
    darkest = float(np.abs(shaded - frame.rgba[..., :3]).max())
    occluded = float((occlusion[hand] > limits.GATE_NEED).mean()) if hand.any() else 0.0
    return GateRow(name, score, fade(score), occluded, darkest, truth_db)  # type: ignore[arg-type]


def _scale(avatar: HandAvatar, joints_m: np.ndarray) -> float:
    """s_g: how large the hand is beside its avatar."""
    bones = avatar.for_hand(Handedness.RIGHT).bone_transform().bones(torch.from_numpy(joints_m))
    return float(bones.scale)
