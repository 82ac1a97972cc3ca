"""One picture of several moments, each with its own pose and its own camera: motion blur and depth of field for whoever
knows the scene between two frames, as Blender does.

    frame = render_moments(renderer, moments, weights, middle=1)

Moments are averaged in linear light, premultiplied: what a camera's sensor adds up, and what a compositor that works in
linear light makes of the picture afterwards is then right at its edges too. (`exposure`, for motions that the engine
knows itself, averages as pictures are blended, display-referred: those are laid over backgrounds as they are.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jghand_engine import limits
from jghand_engine.color import linear_to_srgb, srgb_to_linear
from jghand_engine.errors import InputError
from jghand_engine.hand.rotations import slerp_rotation
from jghand_engine.hand.sequence import pose_between
from jghand_engine.render.camera import Camera, Lens
from jghand_engine.render.effect_plan import Decision, Effect, EffectPlan
from jghand_engine.render.exposure import (
    coprime_near,
    disc_of_depths,
    focus_count,
    focus_error,
    motion_count,
    motion_error,
)
from jghand_engine.render.frame import Frame, SceneRenderer
from jghand_engine.render.report import FrameReport
from jghand_engine.render.shadow import vogel_disc


@dataclass(frozen=True)
class Moment:
    """joints_m: per hand (21, 3), level order, meters, in the frame of the camera · camera: with its lens"""

    joints_m: Sequence[np.ndarray]
    camera: Camera


def render_moments(
    renderer: SceneRenderer,
    moments: Sequence[Moment],
    weights: Sequence[float] = (1.0,),
    *,
    middle: int = 0,
    between: Callable[[], None] = lambda: None,
) -> tuple[Frame, np.ndarray]:
    """The mean of all moments. Where they are too far from each other to look like a movement, more are put between
    them. Depth is that of the middle one, through the middle of its lens, and the renderer is left with its hands.
    Besides, (H, W) float32: the mean depth, meters, of all that covers a pixel, blur too: what a combination by depth
    needs.

    weights: one per moment, 0 or more, some above · between: called before each picture and between the parts of one;
    may raise to end it all.
    InputError for moments of different sizes, or weights that are none.
    """
    _check(moments, weights)
    seen, shares = filled(moments, weights)
    lens_px = _disc_px(moments[middle])
    needed = focus_count(lens_px) if _has_lens(moments) else 1
    each = -(-needed // len(seen))
    sharp = Moment(moments[middle].joints_m, replace(moments[middle].camera, lens=None))
    if len(seen) == 1 and each == 1:
        between()
        frame = renderer.render(sharp.joints_m, sharp.camera, between=between)
        return frame, frame.depth_m
    mean, reports = _LinearMean(sharp.camera), []
    for index, (moment, share) in enumerate(zip(seen, shares, strict=True)):
        for pinhole in _pinholes(moment.camera, index, each, len(seen)):
            between()
            frame = renderer.render(moment.joints_m, pinhole, between=between)
            mean.add(frame, share / each)
            reports.append(frame.report)
    between()
    last = renderer.render(sharp.joints_m, sharp.camera, between=between)
    reports.append(last.report)
    plan = _told(last.report.plan, seen, each, lens_px)
    return Frame(mean.rgba(), last.depth_m, _summed(reports, plan)), mean.depth_m()


def filled(moments: Sequence[Moment], weights: Sequence[float]) -> tuple[list[Moment], list[float]]:
    """As many moments as the movement needs on the picture (`exposure.motion_count`), evenly spread over the same time,
    and their shares, which sum to 1. Between two that are given bones turn, and cameras too; before the first and after
    the last one, by half a step, they go on so."""
    count = len(moments)
    steps = -(-motion_count(_travel_px(moments)) // count) if count > 1 else 1
    if steps == 1:
        return list(moments), [weight / sum(weights) for weight in weights]
    seen, shares = [], []
    for place in range(count * steps):
        at = (place + 0.5) / steps - 0.5
        first = min(max(math.floor(at), 0), count - 2)
        part = at - first
        seen.append(_moment_between(moments[first], moments[first + 1], part))
        shares.append(max(0.0, (1 - part) * weights[first] + part * weights[first + 1]))
    total = sum(shares)
    return seen, [share / total for share in shares]


def _moment_between(first: Moment, second: Moment, part: float) -> Moment:
    joints = [pose_between(a, b, part) for a, b in zip(first.joints_m, second.joints_m, strict=True)]
    return Moment(joints, _camera_between(first.camera, second.camera, part))


def _camera_between(first: Camera, second: Camera, part: float) -> Camera:
    """Numbers and places linear, directions along the shortest turn."""
    a, b = first.camera_from_world, second.camera_from_world
    turn = slerp_rotation(a[:3, :3], b[:3, :3], np.array(part))
    eye_m = (part - 1) * a[:3, :3].T @ a[:3, 3] - part * b[:3, :3].T @ b[:3, 3]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, -turn @ eye_m

    def mixed(x: float, y: float) -> float:
        return (1 - part) * x + part * y

    numbers = {name: mixed(getattr(first, name), getattr(second, name)) for name in ("fx", "fy", "cx", "cy")}
    lens = first.lens
    if first.lens is not None and second.lens is not None:
        focus_m = mixed(first.lens.focus_m, second.lens.focus_m)
        lens = Lens(max(0.0, mixed(first.lens.aperture_m, second.lens.aperture_m)), focus_m)
    return replace(first, camera_from_world=matrix, lens=lens, **numbers)


def _check(moments: Sequence[Moment], weights: Sequence[float]) -> None:
    sizes = {(moment.camera.width, moment.camera.height) for moment in moments}
    if len(sizes) != 1:
        raise InputError("moments of a picture", wanted="at least one, all of one size", came=str(sorted(sizes)))
    good = len(weights) == len(moments) and all(0 <= weight < np.inf for weight in weights) and sum(weights) > 0
    if not good:
        raise InputError("weights of moments", wanted=f"{len(moments)} of 0 or more, not all 0", came=str(weights)[:80])


def _has_lens(moments: Sequence[Moment]) -> bool:
    return any(moment.camera.lens is not None and moment.camera.lens.aperture_m > 0 for moment in moments)


def _pinholes(camera: Camera, index: int, each: int, moments: int) -> list[Camera]:
    """So many pinholes on the lens of one moment: its share of a sunflower over the whole lens, the places of which
    have nothing to do with time."""
    if camera.lens is None:
        return [camera] * each
    count = each * moments
    places = camera.lens.aperture_m / 2 * vogel_disc(count)
    stride = coprime_near(count)
    chosen = [places[(index * each + turn) * stride % count] for turn in range(each)]
    return [camera.through(float(x), float(y)) for x, y in chosen]


def _disc_px(moment: Moment) -> float:
    """Diameter of the largest disc that a point of the hands becomes."""
    if moment.camera.lens is None:
        return 0.0
    depths_m = np.concatenate([moment.camera.project(joints)[1] for joints in moment.joints_m])
    flesh_m = 1e-3 * max(limits.GATE_CAPSULE_RADII_MM)
    return disc_of_depths(moment.camera, float(depths_m.min()) - flesh_m, float(depths_m.max()) + flesh_m)


class _LinearMean:
    """Sums pictures in linear light. Where there is nothing nothing is computed."""

    def __init__(self, camera: Camera) -> None:
        self._sum = np.zeros((camera.height, camera.width, 4), np.float32)
        self._depth_sum, self._depth_weight = np.zeros((2, camera.height, camera.width), np.float32)

    def add(self, frame: Frame, weight: float) -> None:
        """Adds a picture."""
        covered = frame.rgba[..., 3] > 0
        values, depth_m = frame.rgba[covered], frame.depth_m[covered]
        counts = np.float32(weight) * values[:, 3] * (depth_m > 0)
        self._depth_sum[covered] += counts * depth_m
        self._depth_weight[covered] += counts
        alpha = values[:, 3:]
        values[:, :3] = srgb_to_linear(values[:, :3] / alpha) * alpha
        self._sum[covered] += np.float32(weight) * values

    def rgba(self) -> np.ndarray:
        """(H, W, 4) the mean, premultiplied and display-referred as the pictures were."""
        covered = self._sum[..., 3] > 0
        values = self._sum[covered]
        alpha = values[:, 3:]
        values[:, :3] = linear_to_srgb(values[:, :3] / alpha) * alpha
        out = np.zeros_like(self._sum)
        out[covered] = values
        return out

    def depth_m(self) -> np.ndarray:
        """(H, W) the mean depth of what covers each pixel; 0 where hardly anything does."""
        seen = self._depth_weight > limits.DEPTH_ALPHA_MIN
        return np.where(seen, self._depth_sum / np.where(seen, self._depth_weight, 1), 0).astype(np.float32)


# ---- the receipt ----------------------------------------------------------------------------------------------------


def _summed(reports: Sequence[FrameReport], plan: EffectPlan | None) -> FrameReport:
    """One receipt of all pictures: times are added, notes said once, the rest is that of the last one."""
    last = reports[-1]
    whole = replace(last, stages=[], notes=[], plan=plan)
    for report in reports:
        for stage in report.stages:
            if stage.ran:
                whole.ran(stage.name, stage.milliseconds, stage.reason)
            else:
                whole.skipped(stage.name, stage.reason, stage.bound)
    whole.notes = list(dict.fromkeys(note for report in reports for note in report.notes))
    whole.total_ms = sum(report.total_ms for report in reports)
    return whole


def _told(plan: EffectPlan | None, moments: Sequence[Moment], each: int, lens_px: float) -> EffectPlan | None:
    """The plan of one picture with what was averaged."""
    if plan is None:
        return None
    count = len(moments) * each
    told = {}
    if len(moments) > 1:
        length_px = _travel_px(moments)
        missed = motion_error(length_px, len(moments))
        told[Effect.MOTION] = _averaged(Effect.MOTION, len(moments), f"joints travel {length_px:.1f} px", missed)
    if _has_lens(moments):
        missed = focus_error(lens_px, count)
        told[Effect.FOCUS] = _averaged(Effect.FOCUS, count, f"discs of {lens_px:.1f} px", missed)
    decisions = tuple(told.get(one.effect, one) for one in plan.decisions)
    return replace(plan, decisions=decisions, exposures=count)


def _averaged(effect: Effect, count: int, reason: str, error: float) -> Decision:
    missed = f"{reason}, {count} pictures, which miss {100 * error:.1g} % of an edge's contrast"
    return Decision(effect, True, missed, "sharp edges", 1.0)


def _travel_px(moments: Sequence[Moment]) -> float:
    """The longest way of a joint on the picture; infinite when it passes the near plane."""
    seen = [moment.camera.project(np.stack(moment.joints_m)) for moment in moments]
    if not all((depth > limits.Z_NEAR_M).all() for _, depth in seen):
        return float("inf")
    pixels = np.stack([place for place, _ in seen])
    return float(np.linalg.norm(np.diff(pixels, axis=0), axis=-1).sum(0).max())
