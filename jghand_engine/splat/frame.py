"""The frame: 21 joints and a camera to a finished picture, with a receipt of what was done and what was left out.

    renderer = HandRenderer(load_builtin(handedness=Handedness.RIGHT), preset("viewport"))
    frame = renderer.render(joints_m, camera)

Every stage that can be skipped has a cheap test, a reason and a bound in the report (RENDERING 11). Positions are kept
relative to the first hand's root and the root is added in double precision: a hand 1 km away loses nothing.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from jghand_engine import limits
from jghand_engine.avatar.avatar import HandAvatar, check_follows_joints
from jghand_engine.avatar.learnt import ShadowLook
from jghand_engine.avatar.pose_features import Angles
from jghand_engine.avatar.pose_range import outside, trained_range
from jghand_engine.avatar.tiers import Tier
from jghand_engine.errors import InputError
from jghand_engine.hand.fast_transform import FastBones, FastTransform
from jghand_engine.hand.frames import describe_flags
from jghand_engine.hand.joints import JOINT_COUNT, LEVEL_NAMES
from jghand_engine.hand.orders import check_joint_shape
from jghand_engine.native import library as native_library
from jghand_engine.splat.camera import Camera
from jghand_engine.splat.gate import ShadowGate, contact_between, fade
from jghand_engine.splat.painter import SHADOW, SKIN, Canvas, Painter, Pose, TorchPainter
from jghand_engine.splat.painter_native import NativePainter
from jghand_engine.splat.report import FrameReport
from jghand_engine.splat.settings import RenderSettings, ShadowMode
from jghand_engine.splat.shadow import ShadowStyle

TRANSFORM, GATE = "transform", "shadow gate"


@dataclass(frozen=True)
class Frame:
    """A finished picture. It belongs to the caller; the renderer keeps nothing of it.

    rgba:    (H, W, 4) float32, premultiplied, display-referred sRGB, row 0 at the top
    depth_m: (H, W) float32, metres along the view axis, 0 where there is nothing (everywhere with settings.depth off)
    """

    rgba: np.ndarray
    depth_m: np.ndarray
    report: FrameReport


class SceneRenderer:
    """Renders any number of hands into one picture, each driven by its own joints. One picture at a time.

    avatars: one per hand, each with its handedness · settings: how (splat.settings); `settings.gaussians` is per hand.
    InputError for an avatar whose bones do not follow the joints by `JointTransform`.
    """

    def __init__(self, avatars: Sequence[HandAvatar], settings: RenderSettings | None = None) -> None:
        self.settings = settings or RenderSettings()
        if not avatars:
            raise InputError("hands of a picture", wanted="at least one avatar", came="none")
        for avatar in avatars:
            check_follows_joints(avatar)
        chosen = [_with_tier(avatar.prefix(self.settings.gaussians), self.settings.correctives) for avatar in avatars]
        self._avatars = [avatar for avatar, _ in chosen]
        self._tiers = ", ".join(dict.fromkeys(told for _, told in chosen if told))
        self._transforms = [
            FastTransform(
                avatar.canonical_joints_m,
                handedness=avatar.handedness,
                swing=avatar.info.swing,
                scale_mode=avatar.info.scale_mode,
                variant=self.settings.backend,
            )
            for avatar in self._avatars
        ]
        self._ranges = [trained_range(avatar.info) for avatar in self._avatars]
        looks = [ShadowLook() if avatar.learnt is None else avatar.learnt.shadow for avatar in self._avatars]
        self._looks = [look for look in looks if look is not None]
        # colours that were learnt under a shadow that fades with the pose have in them what it leaves out
        self._is_learnt = any(avatar.learnt is not None for avatar in self._avatars)
        self._gates = [ShadowGate(avatar.canonical_joints_m.numpy()) for avatar in self._avatars]
        self._painter = self._new_painter()
        self._posed: _Posed | None = None

    def _new_painter(self) -> Painter:
        library = native_library.load(self.settings.backend)
        if library is None:
            return TorchPainter(self._avatars, self.settings)
        return NativePainter(library, self._avatars, self.settings)

    def render(self, joints_m: Sequence[np.ndarray | torch.Tensor], camera: Camera) -> Frame:
        """One picture. joints_m: per hand (21, 3), level order, metres, in the frame the camera is given in.

        InputError names a joint that is not finite; to hold the last good pose is the motion's business
        (`PoseSequence.with_gaps_held`).
        """
        started = time.perf_counter()
        report = FrameReport(backend=self._painter.backend, threads=self._painter.threads)
        report.gaussians = sum(map(len, self._avatars))
        hands = self._checked(joints_m)
        posed, moved = self._pose(hands, report)
        canvas = self._canvas(posed, camera, report)
        if not moved:
            report.skipped(SKIN, "same transforms", report.stages[0].bound)
        # a picture that fails half way may leave the painter with half of these Gaussians: then the next one poses anew
        self._posed = None
        rgba, depth_m = self._painter.paint(posed.poses if moved else None, canvas, report)
        report.explain(SKIN, self._tiers)
        self._posed = posed
        if depth_m is None:
            report.skipped("depth", "not requested", "")
            depth_m = np.zeros(rgba.shape[:2], np.float32)
        report.total_ms = 1e3 * (time.perf_counter() - started)
        return Frame(rgba, depth_m, report)

    def _checked(self, joints_m: Sequence[np.ndarray | torch.Tensor]) -> list[np.ndarray]:
        if len(joints_m) != len(self._avatars):
            raise InputError("hands of a picture", wanted=f"joints of {len(self._avatars)}", came=str(len(joints_m)))
        return [_checked_hand(joints) for joints in joints_m]

    def _pose(self, hands: list[np.ndarray], report: FrameReport) -> tuple[_Posed, bool]:
        """The bone transforms, and whether they are new."""
        started = time.perf_counter()
        if self._posed is not None and self.settings.reuse:
            distance_m = max(float(np.abs(new - old).max()) for new, old in zip(hands, self._posed.hands, strict=True))
            # per axis, so that no joint moves farther than the limit; the skin of a flagged hand may turn without bound
            most_m = 0.0 if self._posed.notes else limits.REUSE_JOINTS_M
            if distance_m * np.sqrt(3.0) <= most_m:
                bound = f"{1e3 * limits.REUSE_SKIN_M:g} mm of skin" if distance_m > 0 else "0"
                report.skipped(TRANSFORM, f"joints moved {1e3 * distance_m:.3f} mm", bound)
                report.notes += self._posed.notes + self._posed.unseen
                return self._posed, False
        origin_m = hands[0][0]
        bones = [transform.bones(joints) for transform, joints in zip(self._transforms, hands, strict=True)]
        unseen = [note for place, own in enumerate(bones) for note in self._unseen(place, own)]
        poses = [Pose(one, one.root_m - origin_m) for one in bones]
        notes = [sentence for one in bones for sentence in describe_flags(one.flags)]
        posed = _Posed([joints.copy() for joints in hands], poses, notes, unseen)
        report.ran(TRANSFORM, 1e3 * (time.perf_counter() - started))
        report.notes += notes + unseen
        return posed, True

    def _unseen(self, place: int, bones: FastBones) -> list[str]:
        """Sentences about joints that are bent as the avatar never saw them."""
        trained = self._ranges[place]
        if trained is None:
            return []
        return [one.sentence() for one in outside(Angles.of(torch.from_numpy(bones.angles_rad)).angles, trained)]

    def _canvas(self, posed: _Posed, camera: Camera, report: FrameReport) -> Canvas:
        # the origin of what was posed, also when the hand has moved by less than the limit since
        from_origin = camera.camera_from_world.clone()
        from_origin[:3, 3] += from_origin[:3, :3] @ torch.from_numpy(posed.hands[0][0])
        strength = self._shadow_strength(posed, camera, report)
        style = self._shadow_style(strength) if strength > 0 else None
        return Canvas(replace(camera, camera_from_world=from_origin), float(from_origin[2, 3]), style)

    def _shadow_style(self, strength: float) -> ShadowStyle:
        """One pass shades all hands: hands of different looks get the mean of them."""
        gain = float(np.mean([look.gain for look in self._looks]))
        red, green, blue = np.mean([look.tint for look in self._looks], axis=0).tolist()
        return ShadowStyle(self.settings.shadow_samples, strength, gain=gain, tint=(red, green, blue))

    def _shadow_strength(self, posed: _Posed, camera: Camera, report: FrameReport) -> float:
        """0..1; decided by mode, size on the picture and the gate, with a line in the report."""
        settings = self.settings
        if settings.shadow is ShadowMode.OFF or settings.shadow_strength == 0:
            report.skipped(SHADOW, "switched off", "")
            return 0.0
        if not self._looks:
            report.skipped(SHADOW, "the avatar was learnt without one", "0")
            return 0.0
        if settings.shadow is ShadowMode.ALWAYS and not self._is_learnt:
            return settings.shadow_strength
        size_px = max(_extent_px(joints, camera) for joints in posed.hands)
        if size_px < limits.SHADOW_HAND_MIN_PX and settings.shadow is not ShadowMode.ALWAYS:
            report.skipped(SHADOW, f"hand {size_px:.0f} px", "a few pixels of crease")
            return 0.0
        started = time.perf_counter()
        scores = [
            gate.score(joints, pose.bones.scale)
            for gate, joints, pose in zip(self._gates, posed.hands, posed.poses, strict=True)
        ]
        score = max(scores) + contact_between(posed.hands)
        report.ran(GATE, 1e3 * (time.perf_counter() - started), f"score {score:.2f}")
        if (strength := fade(score)) == 0:
            report.skipped(SHADOW, f"gate {score:.2f}", "1 % of the hand's pixels occluded by over 0.2 (METHOD 5.4)")
        return strength * settings.shadow_strength


class HandRenderer:
    """Renders one hand. avatar: which, with its handedness · settings: how (splat.settings)."""

    def __init__(self, avatar: HandAvatar, settings: RenderSettings | None = None) -> None:
        self._scene = SceneRenderer([avatar], settings)
        self.settings = self._scene.settings

    def render(self, joints_m: np.ndarray | torch.Tensor, camera: Camera) -> Frame:
        """One picture. joints_m: (21, 3), level order, metres, in the frame the camera is given in.

        InputError names a joint that is not finite; to hold the last good pose is the motion's business
        (`PoseSequence.with_gaps_held`).
        """
        return self._scene.render([joints_m], camera)


@dataclass(frozen=True)
class _Posed:
    """The hands of the last finished picture: joints (21, 3) each, transforms, notes for the report: of what is wrong
    with a hand, and of what its avatar never saw."""

    hands: list[np.ndarray]
    poses: list[Pose]
    notes: list[str]
    unseen: list[str]


def _with_tier(avatar: HandAvatar, wanted: Tier) -> tuple[HandAvatar, str]:
    """The avatar with the correctives to draw it with, and a phrase about them; the phrase is empty without any."""
    if avatar.learnt is None or avatar.learnt.correctives is None:
        return avatar, ""
    learnt, price = avatar.learnt.with_tier(wanted)
    told = str(Tier.EXACT) if price is None else f"{price.name} ({price.lost_db:.2f} dB lost)"
    return replace(avatar, learnt=learnt), f"correctives {told}"


def _checked_hand(joints_m: np.ndarray | torch.Tensor) -> np.ndarray:
    """(21, 3) float64; InputError for another shape or a joint that is not finite."""
    joints = joints_m.detach().cpu().numpy() if isinstance(joints_m, torch.Tensor) else np.asarray(joints_m)
    joints = np.ascontiguousarray(joints, np.float64)
    if joints.shape != (JOINT_COUNT, 3):
        check_joint_shape(joints)
        raise InputError("joints of one hand", wanted="shape (21, 3)", came=str(joints.shape))
    if not np.isfinite(joints).all():
        names = [name for name, joint in zip(LEVEL_NAMES, joints, strict=True) if not np.isfinite(joint).all()]
        raise InputError(
            "joints",
            wanted="finite metres",
            came=f"{', '.join(names)} not finite",
            remedy="Hold the last good pose: PoseSequence.with_gaps_held().",
        )
    return joints


def _extent_px(joints_m: np.ndarray, camera: Camera) -> float:
    """The longer side of the box around the hand on the picture; infinite when the camera is inside it."""
    pixels, depth = camera.project(torch.from_numpy(joints_m))
    if not bool((depth > limits.Z_NEAR_M).all()):
        return float("inf")
    flesh_px = 2e-3 * max(limits.GATE_CAPSULE_RADII_MM) * max(camera.fx, camera.fy) / float(depth.min())
    return float((pixels.amax(0) - pixels.amin(0)).max()) + flesh_px
