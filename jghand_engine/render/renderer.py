"""From 21 joints and a camera to a finished image, with a receipt of what was done and what was left out.

    renderer = HandRenderer(load_builtin(handedness=Handedness.RIGHT), preset("viewport"))
    frame = renderer.render(joints_m, camera)

A Moment is hands and a camera. Those that an image is the mean of (`blur.py`) are posed (_Posed), planned (Scene to
EffectPlan, `effects.py`), drawn one after the other through a pinhole by the kernels (Canvas to Image, `backend.py`),
averaged, and finished as a Frame with a FrameReport. Positions are kept relative to the first hand's root and the root
is added in double precision: a hand 1 km away loses nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar, bone_numbers, check_follows_joints
from jghand_engine.avatar.pose_range import outside, trained_range
from jghand_engine.avatar.relighting import detail_power, in_studio, relightable
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.avatar.tiers import Tier
from jghand_engine.color import displayed
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, LEVEL_NAMES
from jghand_engine.hand.orders import check_joint_shape
from jghand_engine.hand.sequence import HandPose
from jghand_engine.hand.skeleton import Bones, Skeleton, describe_flags
from jghand_engine.native import contract
from jghand_engine.native.rasterizer import check_image_size
from jghand_engine.render.backend import Backend, Canvas, Pose
from jghand_engine.render.blur import Hand, Moment, check_moments, middle
from jghand_engine.render.camera import Camera
from jghand_engine.render.crop import NOWHERE, View, views_box
from jghand_engine.render.effect_plan import Decision, Effect, EffectPlan
from jghand_engine.render.effects import (
    Scene,
    plan_blur,
    plan_effects,
    reusable,
    same_shape,
    strip_disabled,
)
from jghand_engine.render.gate import capsules_beside
from jghand_engine.render.hand_facts import HandFacts
from jghand_engine.render.image import Box, Image
from jghand_engine.render.light_effects import Lit
from jghand_engine.render.passes import surface_normals
from jghand_engine.render.report import FrameReport, summed
from jghand_engine.render.settings import RenderSettings, ShadowMode
from jghand_engine.render.shadow import ShadowStyle

TRANSFORM, PLAN, NORMALS, IDS = "transform", "plan", "normals", "ids"


@dataclass(frozen=True)
class Frame:
    """A finished image. It belongs to the caller; the renderer keeps nothing of it.

    rgba:    (H, W, 4) float32, premultiplied, row 0 at the top: display-referred sRGB, or scene-linear with Rec.709
             primaries, 0 and up
    linear:  whether it is scene-linear: so are hands in the light of a scene
    depth_m: (H, W) float32, meters along the view axis, 0 where there is nothing (everywhere with settings.depth off)
    covered_depth_m: the same as a mean of all that covers a pixel, blur too: what a combination by depth needs
    normal:  (H, W, 3) float32 unit, towards the camera, in its axes, 0 where there is nothing; None unless requested
    ids:     (H, W) uint8, 0 = nothing, k = the k-th hand covers most of what is covered; None unless requested
    """

    rgba: np.ndarray
    depth_m: np.ndarray
    covered_depth_m: np.ndarray
    report: FrameReport
    normal: np.ndarray | None = None
    ids: np.ndarray | None = None
    linear: bool = False

    def displayed(self) -> np.ndarray:
        """(H, W, 4) premultiplied, display-referred: what is scene-linear through sRGB's curve, without exposure."""
        return displayed(self.rgba) if self.linear else self.rgba


class SceneRenderer:
    """Renders any number of hands into one image, each driven by its own joints. One image at a time.

    avatars:  one per hand, each with its handedness
    settings: how; `settings.gaussians` is per hand
    light:    of the scene, in the frame of the joints; None for the light that each avatar was captured in, and a
              studio's for one that learned in known light. It may be set to another one between images.
    InputError for an avatar whose bones do not follow the joints by `Skeleton`, or that no scene can light.
    """

    def __init__(
        self, avatars: Sequence[HandAvatar], settings: RenderSettings | None = None, light: SceneLight | None = None
    ) -> None:
        self.settings, self.light = settings or RenderSettings(), light
        if not avatars:
            raise InputError("hands of an image", wanted="at least one avatar", came="none")
        for avatar in avatars:
            check_follows_joints(avatar)
        powers = [detail_power(avatar, in_scene=light is not None) for avatar in avatars]
        if light is not None:
            avatars = [relightable(avatar) for avatar in avatars]
            # what fingers hide of lamps and world is found for each of them
            self.settings = replace(self.settings, shadow=ShadowMode.OFF)
        else:
            avatars = [in_studio(avatar) for avatar in avatars]
        allowed = [strip_disabled(avatar.prefix(self.settings.gaussians), self.settings) for avatar in avatars]
        chosen = [_with_tier(avatar, self.settings.correctives) for avatar in allowed]
        self._avatars = [avatar for avatar, _ in chosen]
        self._tiers = ", ".join(dict.fromkeys(told for _, told in chosen if told))
        self._facts = [HandFacts(avatar, power) for avatar, power in zip(self._avatars, powers, strict=True)]
        self._transforms = [avatar.skeleton(self.settings.backend) for avatar in self._avatars]
        self._ranges = [trained_range(avatar.info) for avatar in self._avatars]
        self._looks = [facts.look for facts in self._facts if facts.look is not None]
        self._backend = Backend(self._avatars, self.settings, powers)
        self._posed: _Posed | None = None
        self._empty = False  # whether the last image shows no hand, and the backend still has the pose before it
        self._drawn: Canvas | None = None  # what the backend's image shows
        self._bones: list[np.ndarray] | None = None  # per hand the bone of each Gaussian, once somebody asks

    def render(
        self, hands: Sequence[Hand], camera: Camera, *, check_canceled: Callable[[], None] = lambda: None
    ) -> Frame:
        """One image of a moment. hands: in the order of the avatars, each its pose, or its joints (21, 3), level order,
        meters, in the frame the camera is given in. check_canceled: called between the parts of the image that take
        long; may raise to end it.

        InputError names a joint that is not finite; to hold the last good pose is the motion's business
        (`PoseSequence.with_gaps_held`).
        """
        return self.render_moments([Moment(hands, camera)], (1.0,), check_canceled=check_canceled)

    def render_moments(
        self,
        moments: Sequence[Moment],
        weights: Sequence[float],
        *,
        check_canceled: Callable[[], None] = lambda: None,
    ) -> Frame:
        """The mean of all moments, each with its own pose and its own camera, as an open shutter or a scene between two
        frames gives them. Where they are too far from each other to look like a movement, more are put between them.
        Depth, normals and ids are those of the middle one, through the middle of its lens, and the renderer is left
        with its hands.

        weights: one per moment, 0 or more, some above · check_canceled: as of `render`, and before each image of the
        mean.
        InputError as of `render`, for moments of different sizes, or weights that are none.
        """
        check_moments(moments, weights)
        started, camera = time.perf_counter(), middle(moments).camera.pinhole
        # what is drawn may be the hand's box alone
        check_image_size(camera.width, camera.height)
        moments = [replace(moment, hands=self._checked(moment.hands)) for moment in moments]
        exposures, decisions = self._exposures(moments, weights)
        mean, reports = None, []
        if len(exposures) > 1:
            mean = self._backend.mean(camera.width, camera.height, linear=self.light is not None)
            for moment, share in exposures:
                reports.append(FrameReport())
                mean.add(self._expose(moment, reports[-1], check_canceled), share)
        reports.append(FrameReport())
        sharp = self._expose(replace(middle(moments), camera=camera), reports[-1], check_canceled)
        check_canceled()
        frame = self._finished(sharp, camera, reports[-1])
        if mean is not None:
            whole = mean.image()
            frame = replace(frame, rgba=whole.rgba, covered_depth_m=whole.depth_m)
        plans = [report.plan for report in reports if report.plan is not None]
        # the middle one shows no hand where it has left the image by then, or comes later
        plan = next((one for one in reversed(plans) if one.box.width), plans[-1])
        report = summed(reports, plan.with_averages(decisions, len(exposures)))
        report.total_ms = 1e3 * (time.perf_counter() - started)
        return replace(frame, report=report)

    def rest(self) -> None:
        """Gives back the memory that has the size of the last image; the next one takes it anew."""
        self._drawn = None
        self._backend.rest()

    def _exposures(
        self, moments: Sequence[Moment], weights: Sequence[float]
    ) -> tuple[list[tuple[Moment, float]], list[Decision]]:
        """What one image is the mean of, as of `plan_blur`; the middle moment where no hand is in the image."""
        center = middle(moments)
        if len(moments) == 1 and center.camera.lens is None:
            return [(center, 1.0)], []
        seen = self._seen_hands(moments)
        if not seen:
            return [(center, 1.0)], []
        bones = self._bones_of(center.hands)
        return plan_blur(moments, weights, self._facts, seen, self.settings, max(one.scale for one in bones))

    def _expose(self, moment: Moment, report: FrameReport, check_canceled: Callable[[], None]) -> Image:
        """One moment through a pinhole."""
        check_canceled()
        report.backend, report.threads = self._backend.variant, self._backend.threads
        report.gaussians = sum(map(len, self._avatars))
        hands = list(map(HandPose.of, moment.hands))
        posed = self._pose(hands, report)
        plan = self._plan(posed, moment.camera, report)
        if posed.moved_m is not None and any(now and not had for now, had in zip(plan.seen, posed.seen, strict=True)):
            # a hand has come into the image
            posed = self._pose(hands, report, anew=True)
            plan = self._plan(posed, moment.camera, report)
        report.tier = self._tiers if posed.moved_m is None else ""
        report.plan = plan
        report.notes += posed.notes
        return self._draw(posed, moment.camera, plan, report, check_canceled)

    def bone_ids(self, camera: Camera) -> np.ndarray:
        """(H, W) uint8: which bone covers most of a pixel, of the hands as they were drawn last, through the middle of
        the camera's lens: the number, 1..20, of the joint of the standard order at which it ends; 0 for nothing. Of
        the Gaussians, which may reach farther than the picture's alpha.

        InputError when nothing was drawn yet.
        """
        check_image_size(camera.width, camera.height)
        if self._posed is None and not self._empty:
            raise InputError("bones of an image", wanted="an image drawn before", came="none")
        if self._empty:
            return np.zeros((camera.height, camera.width), np.uint8)
        if self._bones is None:
            self._bones = [bone_numbers(avatar) for avatar in self._avatars]
        assert self._posed is not None
        canvas = self._canvas(self._posed, camera.pinhole, 0.0, contract.ALPHA_MIN)
        return self._backend.part_map(canvas, self._bones)

    def _checked(self, hands: Sequence[Hand]) -> list[HandPose]:
        if len(hands) != len(self._avatars):
            raise InputError("hands of an image", wanted=f"joints of {len(self._avatars)}", came=str(len(hands)))
        return [_checked_hand(HandPose.of(hand)) for hand in hands]

    def _bones_of(self, hands: Sequence[Hand]) -> list[Bones]:
        return [_bones(transform, HandPose.of(hand)) for transform, hand in zip(self._transforms, hands, strict=True)]

    # ---- the pose ----------------------------------------------------------------------------------------------------

    def _pose(self, hands: list[HandPose], report: FrameReport, *, anew: bool = False) -> _Posed:
        """The bone transforms, and whether they are new, or taken to be. Nothing is kept of it before it is painted."""
        started, last, settings = time.perf_counter(), self._posed, self.settings
        bones, joints_m = self._bones_of(hands), [hand.joints_m for hand in hands]
        if last is not None and not anew:
            moved_m = reusable(bones, last.bones, last.corrected_rad, self._facts, settings)
            if moved_m is not None:
                return replace(last, moved_m=moved_m)
        origin_m = joints_m[0][0]
        corrected = self._corrected_rad(last)
        poses = [
            Pose(one, one.root_m - origin_m, same_shape(facts, one, angles_rad, settings), others)
            for facts, one, angles_rad, others in zip(
                self._facts, bones, corrected, capsules_beside(joints_m, bones), strict=True
            )
        ]
        unseen = _by_hand([_unseen(trained, pose) for trained, pose in zip(self._ranges, poses, strict=True)])
        notes = _by_hand(
            [describe_flags(one.flags) + facts.notes for one, facts in zip(bones, self._facts, strict=True)]
        )
        angles = [
            old if pose.keep_correctives and old is not None else pose.bones.angles_rad
            for pose, old in zip(poses, corrected, strict=True)
        ]
        report.ran(TRANSFORM, 1e3 * (time.perf_counter() - started))
        return _Posed([joints.copy() for joints in joints_m], poses, angles, notes + unseen)

    def _corrected_rad(self, last: _Posed | None) -> list[np.ndarray | None]:
        """Per hand the angles of correctives that can be used again; None for none."""
        if last is None:
            return [None] * len(self._facts)
        had = zip(self._facts, last.corrected_rad, last.seen, strict=True)
        return [angles_rad if facts.keeps_correctives and seen else None for facts, angles_rad, seen in had]

    def _plan(self, posed: _Posed, camera: Camera, report: FrameReport) -> EffectPlan:
        started = time.perf_counter()
        scene = posed.scene(camera, self._lit(posed, camera))
        plan = plan_effects(scene, self._facts, self.settings)
        report.ran(PLAN, 1e3 * (time.perf_counter() - started))
        return plan

    def _lit(self, posed: _Posed, camera: Camera) -> Lit | None:
        if self.light is None:
            return None
        before, drawn = self._backend.light, self._drawn
        new_world = before is None or before.world is not self.light.world
        # a new pose is seen anew in any case
        seen_anew = True
        if posed.moved_m is not None and drawn is not None:
            seen_anew = not np.array_equal(drawn.camera.eye_m, _at_origin(posed, camera).eye_m)
        sharp = () if drawn is None else drawn.sharp
        return Lit(self.light, before != self.light, new_world, seen_anew, self._backend.draws_layers, sharp)

    def _seen_hands(self, moments: Sequence[Moment]) -> list[int]:
        """Numbers of the hands that are in the image at some of the moments, or pass it between them."""
        at, alpha_min = [(moment, _rays(moment.camera)) for moment in moments], self.settings.alpha_min

        def views(hand: int) -> Iterator[View]:
            for moment, cameras in at:
                bones, joints_m = _bones(self._transforms[hand], HandPose.of(moment.hands[hand])), moment.joints_m[hand]
                yield from (View(joints_m, bones, self._facts[hand], camera, alpha_min) for camera in cameras)

        return [hand for hand in range(len(self._facts)) if views_box(list(views(hand)), alpha_min).width]

    # ---- the image -------------------------------------------------------------------------------------------------

    def _draw(
        self, posed: _Posed, camera: Camera, plan: EffectPlan, report: FrameReport, check_canceled: Callable[[], None]
    ) -> Image:
        """One moment through one pinhole: of the whole image or of the hands' box in it."""
        box = plan.box
        self._empty = not box.width
        if self._empty:
            return self._nothing()
        if posed.moved_m is None:
            posed = replace(posed, seen=plan.seen)
        part, drawn = camera.part(*box), []
        if plan.plain > 0:
            check_canceled()
            drawn.append((self._painted(posed, part, box, plan, report), plan.plain))
        if plan.plain < 1:
            # what was posed for the image above stays
            again = posed if plan.plain == 0 else replace(posed, moved_m=0.0)
            check_canceled()
            large = self._painted(again, part.scaled(plan.enlarged), box, plan, report)
            check_canceled()
            drawn.append((large.averaged_down(plan.enlarged), 1 - plan.plain))
        if len(drawn) == 1:
            return drawn[0][0]
        mean = self._backend.mean(camera.width, camera.height, linear=self.light is not None)
        for one, weight in drawn:
            mean.add(one, weight)
        return mean.image()

    def _nothing(self) -> Image:
        """No hand in the image: nothing is posed for it."""
        depth_m = np.zeros((0, 0), np.float32) if self.settings.depth or self.settings.normals else None
        weights = np.zeros((0, 0, len(self._avatars)), np.float32) if self.settings.ids else None
        return Image(NOWHERE, np.zeros((0, 0, 4), np.float32), depth_m, weights)

    def _painted(self, posed: _Posed, camera: Camera, box: Box, plan: EffectPlan, report: FrameReport) -> Image:
        settings = self.settings
        # normals are those of the depth
        depth = settings.depth or settings.normals
        canvas = self._canvas(posed, camera, plan.strength, settings.alpha_min)
        canvas = replace(canvas, depth=depth, seen=plan.seen, detail=plan.detail, sharp=plan.sharp)
        poses = None if posed.moved_m is not None else posed.poses
        keeps = poses is None and not settings.effects.forces(Effect.SKIN) and canvas.same_view(self._drawn)
        # an image that fails half way may leave the backend with half of these Gaussians: then the next one poses anew
        self._posed = self._drawn = None
        rgba, depth_m = self._backend.draw(poses, canvas, report, keep_image=keeps)
        weights = self._hand_weights(rgba, canvas, report) if settings.ids else None
        self._posed, self._drawn = posed, canvas
        return Image(box, rgba, depth_m, weights)

    def _hand_weights(self, rgba: np.ndarray, canvas: Canvas, report: FrameReport) -> np.ndarray:
        """(H, W, hands) how much of the pixel each hand covers."""
        started = time.perf_counter()
        weights = rgba[..., 3:] if len(self._avatars) == 1 else self._backend.hand_weights(canvas)
        report.ran(IDS, 1e3 * (time.perf_counter() - started))
        return weights

    def _canvas(self, posed: _Posed, camera: Camera, strength: float, alpha_min: float) -> Canvas:
        style, at_origin = self._shadow_style(strength) if strength > 0 else None, _at_origin(posed, camera)
        near_m = float(at_origin.camera_from_world[2, 3])
        return Canvas(at_origin, near_m, style, posed.seen, alpha_min, light=self.light)

    def _shadow_style(self, strength: float) -> ShadowStyle:
        """One pass shades all hands: hands of different looks get the mean of them."""
        gain = float(np.mean([look.gain for look in self._looks]))
        red, green, blue = np.mean([look.tint for look in self._looks], axis=0).tolist()
        return ShadowStyle(self.settings.shadow_samples, strength, gain=gain, tint=(red, green, blue))

    def _finished(self, drawn: Image, camera: Camera, report: FrameReport) -> Frame:
        whole, settings = drawn.laid_out(camera.width, camera.height), self.settings
        normal = ids = None
        if settings.normals and whole.depth_m is not None:
            started = time.perf_counter()
            normal = surface_normals(whole.depth_m, camera)
            report.ran(NORMALS, 1e3 * (time.perf_counter() - started))
        if settings.ids and whole.weights is not None:
            covered = whole.rgba[..., 3] > contract.DEPTH_ALPHA_MIN
            ids = np.where(covered, 1 + whole.weights.argmax(-1), 0).astype(np.uint8)
        depth_m = whole.depth_m if settings.depth else None
        if depth_m is None:
            depth_m = np.zeros(whole.rgba.shape[:2], np.float32)
        return Frame(whole.rgba, depth_m, depth_m, report, normal, ids, self.light is not None)


class HandRenderer:
    """Renders one hand. avatar: which, with its handedness · settings, light: as for SceneRenderer."""

    def __init__(
        self, avatar: HandAvatar, settings: RenderSettings | None = None, light: SceneLight | None = None
    ) -> None:
        self._scene = SceneRenderer([avatar], settings, light)
        self.settings = self._scene.settings

    def render(self, hand: Hand, camera: Camera) -> Frame:
        """As SceneRenderer's, of one hand."""
        return self._scene.render([hand], camera)

    def render_moments(self, moments: Sequence[Moment], weights: Sequence[float]) -> Frame:
        """As SceneRenderer's."""
        return self._scene.render_moments(moments, weights)

    def bone_ids(self, camera: Camera) -> np.ndarray:
        """As SceneRenderer's."""
        return self._scene.bone_ids(camera)


def _rays(camera: Camera) -> list[Camera]:
    """The pinholes at the corners around its lens: what none of them sees is not seen through the lens either."""
    if camera.lens is None:
        return [camera]
    half_m = camera.lens.aperture_m / 2
    return [camera.through(x_m, y_m) for x_m in (-half_m, half_m) for y_m in (-half_m, half_m)]


def _at_origin(posed: _Posed, camera: Camera) -> Camera:
    """The camera in the frame of the Gaussians: its origin is that of what was posed, also when the hand has moved by
    less than the limit since."""
    return camera.about(posed.joints_m[0][0])


@dataclass(frozen=True)
class _Posed:
    """Hands in a pose.

    joints_m:      per hand (21, 3) as they were posed
    poses:         transforms
    corrected_rad: per hand the angles (37,) of its correctives
    notes:         of what is wrong with a hand, and of what its avatar never saw
    moved_m:       how far the skin can be from where the backend has it; None where it has another pose, or none
    seen:          per hand whether the backend holds its pose: a hand outside the image is not posed; empty before
    """

    joints_m: list[np.ndarray]
    poses: list[Pose]
    corrected_rad: list[np.ndarray]
    notes: list[str]
    moved_m: float | None = None
    seen: tuple[bool, ...] = ()

    @property
    def bones(self) -> list[Bones]:
        return [pose.bones for pose in self.poses]

    def scene(self, camera: Camera, lit: Lit | None = None) -> Scene:
        """As it is seen by a camera."""
        reshaped = not all(pose.keep_correctives for pose in self.poses)
        return Scene(self.joints_m, self.bones, camera, self.moved_m, reshaped, lit)


def _with_tier(avatar: HandAvatar, wanted: Tier) -> tuple[HandAvatar, str]:
    """The avatar with the correctives to draw it with, and a phrase about them; the phrase is empty without any."""
    if avatar.learned is None or avatar.learned.correctives is None:
        return avatar, ""
    learned, price = avatar.learned.with_tier(wanted)
    told = str(Tier.EXACT) if price is None else f"{price.name} ({price.lost_db:.2f} dB lost)"
    return replace(avatar, learned=learned), f"correctives {told}"


def _by_hand(notes: Sequence[Sequence[str]]) -> list[str]:
    """The notes of all hands; of several each says which it is about, counted from 1."""
    several = len(notes) > 1
    return [f"hand {number}: {note}" if several else note for number, of in enumerate(notes, 1) for note in of]


def _unseen(trained: np.ndarray | None, pose: Pose) -> list[str]:
    """Sentences about joints that are bent as the avatar never saw them."""
    return [] if trained is None else [one.sentence() for one in outside(pose.bones.phalanx_angles_rad, trained)]


def _bones(skeleton: Skeleton, hand: HandPose) -> Bones:
    return skeleton.bones(hand.joints_m, forearm=hand.forearm)


def _checked_hand(hand: HandPose) -> HandPose:
    """float64; InputError for another shape or a joint that is not finite."""
    joints = np.asarray(hand.joints_m)
    joints = np.ascontiguousarray(joints, np.float64)
    if joints.shape != (JOINT_COUNT, 3):
        check_joint_shape(joints)
        raise InputError("joints of one hand", wanted="shape (21, 3)", came=str(joints.shape))
    if not np.isfinite(joints).all():
        names = [name for name, joint in zip(LEVEL_NAMES, joints, strict=True) if not np.isfinite(joint).all()]
        raise InputError(
            "joints",
            wanted="finite meters",
            came=f"{', '.join(names)} not finite",
            remedy="Hold the last good pose: PoseSequence.with_gaps_held().",
        )
    return HandPose(joints, hand.forearm)
