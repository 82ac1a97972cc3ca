"""Which effects a scene calls for: every decision about a picture stands here (RENDERING 11).

    plan = plan_effects(scene, hands, settings)

Each effect has a cheap test, a bound on what is lost without it and an estimate of its cost. `frame.py` and the
painters obey. What does not run is neither computed nor allocated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.correctives import LinearCorrectives
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.avatar.skin_task import SIGMA_STRETCH_MAX
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native import contract
from jghand_engine.render.blur import Shutter, disc_px, focus_count, focus_error, motion_count, motion_error
from jghand_engine.render.camera import Camera
from jghand_engine.render.effect_plan import NOT_ALLOWED, Decision, Effect, EffectPlan
from jghand_engine.render.gate import ShadowGate
from jghand_engine.render.image import Box
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.shadow_effects import plan_shadows

# matrices are reused when no joint moved more than this, meters
REUSE_JOINTS_M = 5e-5
# ... and the skin then lacks at most this, meters. Joints that move against each other turn bones: the skin of the
# trained hand moves by up to 5 times their movement in usual poses (0.25 mm), and by up to 11 times where bones are
# half and one and a half times as long in turn
REUSE_SKIN_M = 6e-4
# ... but where a finger is bent further than any hand can, radians, by up to 14 times: such hands are reused only when
# nothing moved at all
REUSE_BENT_MAX = 2.4
# ... and the correctives when no angle changed more than this, radians: a hand that moves as a whole keeps them
REUSE_ANGLE_RAD = 2e-4
# ... and the skin then lacks at most this, meters (the built-in hand's named poses: 0.06 mm, every angle at its limit)
REUSE_CORRECTION_M = 1e-4
# a hand whose median Gaussian is smaller than this on the image is drawn larger and averaged, px: the low pass of
# 0.55 px would swell it. It fades in down to the second size, and is never switched
FILTER_SIGMA_PX = 0.5
FILTER_SIGMA_FULL_PX = 0.35
# times larger at most, and pixels of such a drawing at most
FILTER_FACTOR_MAX = 8
FILTER_PIXELS_MAX = 4_000_000
# when the hand's box is smaller than this part of the image, only the box is drawn
CROP_PART_MAX = 0.5
# ... and the shadow of single pixels then differs by at most this, where a sample falls on another pixel (worst seen:
# 0.014)
CROP_SHADOW = 0.015
# ... and offsets of the correctives are stretched by at most this: where two bones at 112 degrees share the skin, their
# mean map keeps its volume by stretching along the axis by cos(56 degrees)^(-2/3) = 1.47
OFFSET_STRETCH = 1.5
# its edges stand at multiples of this, px: tiles stay where they were, and buffers are seldom made anew
CROP_STEP_PX = 64
# the faint tail: contributions between 1/255 and this, and what the image keeps without them, dB (the shipped hands:
# 51 to 57; RENDERING 9.1 has 59 for a shell of fewer layers)
TAIL_ALPHA_MIN = 1.0 / 1024.0
TAIL_PSNR_DB = 50.0
# estimated cost on one core of the machine of RENDERING, milliseconds per Gaussian, per pixel
SKIN_MS = 5e-6
NETWORK_MS = 2.7e-4
LINEAR_MS = 2e-5
CAST_MS = 2e-5
RASTER_MS = 1.3e-4
TAIL_MS = 1.3e-5
MAP_MS = 1e-6


class HandFacts:
    """What plans need to know of an avatar, found once.

    avatar: as it is drawn, see `strip_disabled` · look: of its shadow, None where it was learned without one ·
    keeps_correctives: whether it is worth while to use those of the last pose again · sigma_m: of its median Gaussian ·
    offset_m: the longest offset of its correctives along an axis · log_stretch: the largest of an axis of its
    ellipsoids, None for spheres
    """

    def __init__(self, avatar: HandAvatar) -> None:
        self.avatar, self.learned = avatar, avatar.learned
        self.gate = ShadowGate(avatar.canonical_joints_m)
        self.look = ShadowLook() if self.learned is None else self.learned.shadow
        net = None if self.learned is None else self.learned.correctives
        # a linear tier is found as fast as it is read
        self.keeps_correctives = net is not None and not isinstance(net, LinearCorrectives)
        self.sigma_m = float(np.median(avatar.sigma_m)) if len(avatar) else 0.0
        self._moving, self._corners_m = _corners(avatar)
        self.offset_m = 0.0 if net is None else net.longest_offset_m()
        ellipsoid = None if self.learned is None else self.learned.ellipsoid
        self.log_stretch = float(np.abs(ellipsoid.log_stretch).max()) if ellipsoid is not None and len(avatar) else None
        self._sigma_max_m = self._longest_radius_m()

    def _longest_radius_m(self) -> float:
        """The largest standard deviation that a pose of scale 1 gives a Gaussian."""
        if not len(self.avatar):
            return 0.0
        if self.learned is None or self.learned.ellipsoid is None:
            return float(self.avatar.sigma_m.max()) * SIGMA_STRETCH_MAX
        # the blended map stretches these like the corners; twice is more than it does to the skin of a hand
        return 2 * float((self.avatar.sigma_m * np.exp(self.learned.ellipsoid.log_stretch.max(1))).max())

    def reach_m(self, bones: Bones, alpha_min: float) -> float:
        """How far from its skinned place a Gaussian of that pose may touch a picture with this cut-off."""
        seen = math.sqrt(2 * math.log(1 / alpha_min)) * self._sigma_max_m
        return (seen + OFFSET_STRETCH * math.sqrt(3) * self.offset_m) * max(bones.scale, 1.0)

    def corners_m(self, bones: Bones) -> np.ndarray:
        """(K, 3) points relative to the hand's root whose hull holds every skinned place."""
        maps = bones.linear_offset[self._moving]
        moved = np.einsum("ijk,ick->icj", maps[:, :, :3], self._corners_m)
        return (moved + maps[:, None, :, 3]).reshape(-1, 3)


def _corners(avatar: HandAvatar) -> tuple[np.ndarray, np.ndarray]:
    """(21,) bool which bones move anything; (bones, 8, 3) corners of the boxes around it, canonical, root-relative.

    A skinned point is a mean of the places where its bones would carry it, each inside its bone's box: all of them lie
    in the hull of the boxes.
    """
    relative = avatar.position_m.astype(np.float64) - avatar.canonical_joints_m[0]
    moves = (avatar.bone_weights != 0).T
    moving = np.asarray(moves.any(1))
    ends = [(relative[rows].min(0), relative[rows].max(0)) for rows in moves[moving]]
    corners = [np.stack(np.meshgrid(*np.stack(pair, 1), indexing="ij"), -1).reshape(8, 3) for pair in ends]
    return moving, np.array(corners).reshape(-1, 8, 3)


def strip_disabled(avatar: HandAvatar, settings: RenderSettings) -> HandAvatar:
    """The avatar without what may not be drawn of it: no memory is taken for that, and no time."""
    learned, allows = avatar.learned, settings.effects.allows
    if learned is None:
        return avatar
    without = {
        Effect.CORRECTIVES: {"correctives": None, "distilled": None},
        Effect.CAST: {"cast": None},
        Effect.ANISOTROPY: {"ellipsoid": None},
    }
    for effect, change in without.items():
        if not allows(effect):
            learned = replace(learned, **change)
    return replace(avatar, learned=learned)


# ---- reuse ----------------------------------------------------------------------------------------------------------


class Kept(NamedTuple):
    """What the last picture leaves. joints_m: per hand (21, 3) as they were posed · flagged: whether a hand was odd ·
    corrected_rad: per hand the angles (37,) of its correctives"""

    joints_m: list[np.ndarray]
    flagged: bool
    corrected_rad: list[np.ndarray]


def reusable(joints_m: Sequence[np.ndarray], kept: Kept | None, settings: RenderSettings) -> float | None:
    """How far the joints moved along an axis since they were posed, meters; None when they have to be posed again."""
    if kept is None or not settings.reuse or settings.effects.forces(Effect.SKIN):
        return None
    distance_m = max(float(np.abs(new - old).max()) for new, old in zip(joints_m, kept.joints_m, strict=True))
    # per axis, so that no joint moves farther than the limit; the skin of a flagged hand may turn without bound
    most_m = 0.0 if kept.flagged or settings.repeatable else REUSE_JOINTS_M
    return distance_m if distance_m * math.sqrt(3.0) <= most_m else None


def same_shape(bones: Bones, corrected_rad: np.ndarray | None, settings: RenderSettings) -> bool:
    """Whether a hand moved as a whole: its correctives stay."""
    if corrected_rad is None or not settings.reuse or settings.effects.forces(Effect.CORRECTIVES):
        return False
    most_rad = 0.0 if settings.repeatable else REUSE_ANGLE_RAD
    return bool(np.abs(bones.angles_rad - corrected_rad).max() <= most_rad)


# ---- the plan -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scene:
    """What is to be drawn. joints_m: per hand (21, 3), level order, meters · bones: their transforms · camera, shutter:
    None for a moment · moved_m: of a pose that is reused, how far its joints moved; None for a new one · reshaped:
    whether the correctives of any hand have to be computed"""

    joints_m: Sequence[np.ndarray]
    bones: Sequence[Bones]
    camera: Camera
    shutter: Shutter | None = None
    moved_m: float | None = None
    reshaped: bool = True

    @cached_property
    def seen_joints(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Per hand pixels (21, 2) and depths (21,), meters, of its joints: found once for all effects."""
        return [self.camera.project(joints) for joints in self.joints_m]


def plan_effects(scene: Scene, hands: Sequence[HandFacts], settings: RenderSettings) -> EffectPlan:
    """Decides about every effect of one picture."""
    skin = _skin(scene, hands)
    strength, shadows = plan_shadows(scene, hands, settings)
    alpha_min, tail = _tail(hands, settings)
    (enlarged, plain), smooth = _filter(scene, hands, settings, alpha_min)
    exposures, time_and_lens = _exposures(scene, hands, settings)
    decisions = (
        skin,
        _correctives(scene, hands, settings),
        _cast(scene, hands, settings),
        _anisotropy(hands, settings),
        smooth,
        *shadows,
        *_maps(scene, settings),
        *time_and_lens,
        tail,
        _whole(scene, hands, settings, alpha_min, strength > 0),
    )
    return EffectPlan(decisions, strength, alpha_min, enlarged, plain, exposures)


def _count(hands: Sequence[HandFacts]) -> int:
    return sum(len(hand.avatar) for hand in hands)


def _skin(scene: Scene, hands: Sequence[HandFacts]) -> Decision:
    cost = _count(hands) * SKIN_MS
    if scene.moved_m is None:
        return Decision(Effect.SKIN, True, "new pose", "no picture", None, cost)
    bound = f"{1e3 * REUSE_SKIN_M:g} mm of skin" if scene.moved_m > 0 else "0"
    reason = f"joints moved {1e3 * scene.moved_m:.3f} mm"
    return Decision(Effect.SKIN, False, reason, bound, 0.0 if scene.moved_m == 0 else None, cost)


def _correctives(scene: Scene, hands: Sequence[HandFacts], settings: RenderSettings) -> Decision:
    if not settings.effects.allows(Effect.CORRECTIVES):
        return Decision(Effect.CORRECTIVES, False, NOT_ALLOWED, "up to 10 mm of skin, and the shade of creases")
    corrected = [hand for hand in hands if hand.learned is not None and hand.learned.correctives is not None]
    if not corrected:
        return Decision(Effect.CORRECTIVES, False, "no avatar has any", "0", 0.0)
    cost = sum(len(hand.avatar) * (NETWORK_MS if hand.keeps_correctives else LINEAR_MS) for hand in corrected)
    reach = max(hand.offset_m for hand in corrected)
    if scene.moved_m is not None:
        return Decision(Effect.CORRECTIVES, False, "the skin is kept", "as of skin", None, cost)
    if not scene.reshaped:
        bound = f"{1e3 * REUSE_CORRECTION_M:g} mm of skin"
        return Decision(Effect.CORRECTIVES, False, "the hand moved as a whole", bound, None, cost)
    return Decision(Effect.CORRECTIVES, True, "joints turned", f"up to {1e3 * reach:g} mm along an axis", None, cost)


def _cast(scene: Scene, hands: Sequence[HandFacts], settings: RenderSettings) -> Decision:
    if not settings.effects.allows(Effect.CAST):
        return Decision(Effect.CAST, False, NOT_ALLOWED, "shadows of the fingers on the hand")
    casting = [hand for hand in hands if hand.learned is not None and hand.learned.cast is not None]
    if not casting:
        return Decision(Effect.CAST, False, "no avatar has learned any", "0", 0.0)
    cost = sum(len(hand.avatar) for hand in casting) * CAST_MS
    if scene.moved_m is not None:
        return Decision(Effect.CAST, False, "the skin is kept", "as of skin", None, cost)
    return Decision(Effect.CAST, True, "hands turn in their light", "shadows of the fingers", 1.0, cost)


def _anisotropy(hands: Sequence[HandFacts], settings: RenderSettings) -> Decision:
    stretched = [hand.log_stretch for hand in hands if hand.log_stretch is not None]
    if not settings.effects.allows(Effect.ANISOTROPY):
        return Decision(Effect.ANISOTROPY, False, NOT_ALLOWED, "spheres in place of ellipsoids")
    if not stretched:
        return Decision(Effect.ANISOTROPY, False, "all Gaussians are spheres, projected exactly", "0", 0.0)
    longest = math.exp(max(stretched))
    return Decision(Effect.ANISOTROPY, True, "ellipsoids", f"axes up to {longest:.1f} times as long", 1.0)


# ---- picture --------------------------------------------------------------------------------------------------------


def _tail(hands: Sequence[HandFacts], settings: RenderSettings) -> tuple[float, Decision]:
    """The cut-off, and whether that keeps what is fainter than one 8-bit step."""
    alpha_min, cost = settings.alpha_min, _count(hands) * TAIL_MS
    if settings.effects.forces(Effect.TAIL):
        alpha_min = min(alpha_min, TAIL_ALPHA_MIN)
    elif not settings.effects.allows(Effect.TAIL):
        alpha_min = max(alpha_min, contract.ALPHA_MIN)
    runs = alpha_min < contract.ALPHA_MIN
    bound = f"not below {TAIL_PSNR_DB:g} dB" if alpha_min <= contract.ALPHA_MIN else "see `jghand study accuracy`"
    return alpha_min, Decision(Effect.TAIL, runs, f"cut 1/{1 / alpha_min:.0f}", bound, None, cost)


def _filter(
    scene: Scene, hands: Sequence[HandFacts], settings: RenderSettings, alpha_min: float
) -> tuple[tuple[int, float], Decision]:
    """How many times larger the hand is drawn, and the share of the picture that is not."""
    cost = _count(hands) * RASTER_MS

    def not_run(reason: str, bound: str, worst: float | None = None) -> tuple[tuple[int, float], Decision]:
        return (1, 1.0), Decision(Effect.FILTER, False, reason, bound, worst, cost)

    trios = zip(hands, scene.seen_joints, scene.bones, strict=True)
    sigma_px = min(_sigma_px(hand, float(depth.min()), bones, scene.camera) for hand, (_, depth), bones in trios)
    if sigma_px >= FILTER_SIGMA_PX:
        return not_run(f"Gaussians of {sigma_px:.2g} px", "0: as learned", 0.0)
    if not settings.antialias:
        return not_run("pictures as they were learned", "hands swell by up to 2 px")
    if not settings.effects.allows(Effect.FILTER):
        return not_run(NOT_ALLOWED, "hands swell by up to 2 px")
    camera = scene.camera
    box = hand_box(scene.joints_m, scene.bones, hands, camera, alpha_min) or Box(0, 0, camera.width, camera.height)
    most = math.isqrt(max(FILTER_PIXELS_MAX // max(box.width * box.height, 1), 1))
    wanted = math.ceil(FILTER_SIGMA_PX / max(sigma_px, 1e-9))
    enlarged = min(wanted, FILTER_FACTOR_MAX, most)
    if enlarged < 2:
        return not_run(f"Gaussians of {sigma_px:.2g} px, but the picture is too large", "hands swell by up to 2 px")
    part = (sigma_px - FILTER_SIGMA_FULL_PX) / (FILTER_SIGMA_PX - FILTER_SIGMA_FULL_PX)
    plain = min(max(part, 0.0), 1.0)
    reason = f"Gaussians of {sigma_px:.2g} px, drawn {enlarged} times larger"
    return (enlarged, plain), Decision(Effect.FILTER, True, reason, "the hand swells by up to 2 px", 1.0, cost)


def _sigma_px(hand: HandFacts, nearest_m: float, bones: Bones, camera: Camera) -> float:
    """The hand's median Gaussian on the picture, at the depth of its nearest joint; infinite when the camera is inside
    the hand."""
    if not nearest_m > contract.Z_NEAR_M:
        return math.inf
    return hand.sigma_m * bones.scale * camera.px_per_meter(nearest_m)


def _maps(scene: Scene, settings: RenderSettings) -> list[Decision]:
    cost = scene.camera.width * scene.camera.height * MAP_MS
    decisions = []
    for effect, wanted in (
        (Effect.DEPTH, settings.depth),
        (Effect.NORMALS, settings.normals),
        (Effect.IDS, settings.ids),
    ):
        runs = wanted and settings.effects.allows(effect)
        reason = "requested" if runs else (NOT_ALLOWED if wanted else "not requested")
        decisions.append(Decision(effect, runs, reason, "" if not wanted else "no map", 0.0, cost))
    return decisions


def _exposures(
    scene: Scene, hands: Sequence[HandFacts], settings: RenderSettings
) -> tuple[int, tuple[Decision, Decision]]:
    """How many pictures are averaged, and what for."""
    allows, once = settings.effects.allows, _count(hands) * (RASTER_MS + SKIN_MS)
    times, lenses = 1, 1
    if scene.shutter is None:
        motion = Decision(Effect.MOTION, False, "no shutter", "0", 0.0)
    elif not allows(Effect.MOTION):
        motion = Decision(Effect.MOTION, False, NOT_ALLOWED, "moving edges are sharp", 1.0)
    else:
        length_px = scene.shutter.travel_px(scene.joints_m, scene.camera)
        times = motion_count(length_px)
        error = motion_error(length_px, times)
        motion = averaged(Effect.MOTION, times, f"joints travel {length_px:.1f} px", error, once)
    lens = scene.camera.lens
    if lens is None or lens.aperture_m == 0:
        focus = Decision(Effect.FOCUS, False, "a pinhole", "0", 0.0)
    elif not allows(Effect.FOCUS):
        focus = Decision(Effect.FOCUS, False, NOT_ALLOWED, "everything is sharp", 1.0)
    else:
        wide_px = disc_px(scene.camera, scene.joints_m, max(bones.scale for bones in scene.bones))
        lenses = focus_count(wide_px)
        focus = averaged(Effect.FOCUS, lenses, f"discs of {wide_px:.1f} px", focus_error(wide_px, lenses), once)
    return max(times, lenses), (motion, focus)


def averaged(effect: Effect, count: int, reason: str, error: float, once_ms: float = 0.0) -> Decision:
    """Of averaging `count` pictures, which misses `error` of the contrast of an edge."""
    missed = f"{100 * error:.1g} % of an edge's contrast"
    if count == 1:
        return Decision(effect, False, reason, missed, error, once_ms)
    told = f"{reason}, {count} pictures, which miss {missed}"
    return Decision(effect, True, told, "sharp edges", 1.0, (count - 1) * once_ms)


def _whole(
    scene: Scene, hands: Sequence[HandFacts], settings: RenderSettings, alpha_min: float, shaded: bool
) -> Decision:
    """Whether more than the hand's box is drawn."""
    camera = scene.camera
    pixels = camera.width * camera.height
    if settings.effects.forces(Effect.WHOLE):
        return Decision(Effect.WHOLE, True, "on every frame", "0", 0.0, pixels * MAP_MS)
    box = hand_box(scene.joints_m, scene.bones, hands, camera, alpha_min)
    part = 1.0 if box is None else box.width * box.height / pixels
    reason = f"the hand's box is {100 * part:.0f} % of it"
    if part > CROP_PART_MAX:
        return Decision(Effect.WHOLE, True, reason, "0", 0.0, pixels * MAP_MS)
    # centers of pixels are rounded elsewhere: a contribution at the cut may fall on its other side, and so may a sample
    # of the shadow
    worst = alpha_min + (CROP_SHADOW if shaded else 0.0)
    bound = f"{255 * worst:.1f} 8-bit steps, on single pixels"
    return Decision(Effect.WHOLE, False, reason, bound, worst, (1 - part) * pixels * MAP_MS)


def hand_box(
    joints_m: Sequence[np.ndarray],
    bones: Sequence[Bones],
    hands: Sequence[HandFacts],
    camera: Camera,
    alpha_min: float,
) -> Box | None:
    """The part of the picture outside of which nothing of the hands is seen; None when that is not known, as for a
    camera between the fingers. Its edges stand at multiples of CROP_STEP_PX."""
    origin = camera.camera_from_world
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for joints, own, hand in zip(joints_m, bones, hands, strict=True):
        if own.flags:
            return None  # such hands stretch their skin beyond what is known
        corners, reach_m = hand.corners_m(own), hand.reach_m(own, alpha_min)
        if not len(corners):
            continue
        points = (corners + joints[0]) @ origin[:3, :3].T + origin[:3, 3]
        nearest_m = float(points[:, 2].min()) - reach_m
        if not (np.isfinite(points).all() and contract.Z_NEAR_M < nearest_m < math.inf):
            return None
        slope = points[:, :2] if camera.orthographic else points[:, :2] / points[:, 2:]
        focal = np.array([camera.fx, camera.fy])
        pixels = slope * focal + np.array([camera.cx, camera.cy])
        # a ball of radius r at depth z covers r (1 + tan) / (z - r) of the plane at depth 1, and the low pass comes on
        # top: a Gaussian of opacity 1 is cut where its exponent is ln(1 / alpha_min)
        margin = focal * reach_m * (1.0 if camera.orthographic else (1 + np.abs(slope).max(0)) / nearest_m)
        margin += math.sqrt(2 * math.log(1 / alpha_min) * contract.BLUR_PX2) + 1
        low, high = np.minimum(low, pixels.min(0) - margin), np.maximum(high, pixels.max(0) + margin)
    return _on_grid(low, high, camera)


def _on_grid(low: np.ndarray, high: np.ndarray, camera: Camera) -> Box:
    """The rectangle from `low` to `high`, pixels, widened to the grid and cut to the picture; at least a step wide."""
    size, step = np.array([camera.width, camera.height]), CROP_STEP_PX
    last = (size - 1) // step * step
    first = np.clip(np.floor(np.clip(low, 0, size) / step) * step, 0, last).astype(int)
    end = np.minimum(np.maximum(np.ceil(np.clip(high, 0, size) / step) * step, first + step), size).astype(int)
    return Box(int(first[0]), int(first[1]), int(end[0] - first[0]), int(end[1] - first[1]))
