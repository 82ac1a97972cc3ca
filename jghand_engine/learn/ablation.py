"""The paper's ablation on any capture: the same training with a part of the method taken out, each time (PAPER 3). Of
pictures whose light is known, parts of the light.

Every variant has the same pictures, seed and budget, and is drawn by the same code (`LiveHand`; the renderer knows our
transform alone), so that the rows differ in nothing but what their name says. A variant has a folder of its own, with
checkpoints: an ablation that was stopped can be resumed.

Hands in known light share the first part of their training, that of the whole light, and go their own way from there;
each is drawn in the light that it learned in by the renderer that users have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.file import load_avatar
from jghand_engine.avatar.scene_light import Lamp, SceneLight
from jghand_engine.captures.sample import Sample
from jghand_engine.captures.splits import Split
from jghand_engine.color import srgb_to_linear
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import HandPose
from jghand_engine.hand.skeleton import Transform
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.evaluate import AvatarPicturer, Picturer, categories_of, judged_mix, spread
from jghand_engine.learn.known_light import LAMPS_IN_WORLD, lamps_in_world
from jghand_engine.learn.model import LightPart
from jghand_engine.learn.options import ONE_LIGHT, TrainOptions, ablations, light_ablations
from jghand_engine.learn.progress import Display
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.run import RunOptions, train
from jghand_engine.learn.shadow import darken, printed_visibility
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.learn.trainable import Trainable
from jghand_engine.learn.work_folder import Start, WorkFolder
from jghand_engine.native.library import load
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.native.threads import thread_count
from jghand_engine.render.blur import Hand
from jghand_engine.render.camera import Camera
from jghand_engine.render.effect_plan import Choice, Effect
from jghand_engine.render.gate import ShadowGate, extent_px, fade, fade_with_size
from jghand_engine.render.settings import RenderSettings, preset
from jghand_engine.render.shadow import ShadowStyle

# of the steps of a training in known light, those that all variants share
SHARED_PART = 0.75
SHARED = "shared"


def chosen_variants(
    options: TrainOptions, names: tuple[str, ...], *, known_light: bool = False
) -> dict[str, TrainOptions]:
    """The rows of the table by name, in its order; none named: all. Before them SHARED, where they go on from it.
    InputError lists them."""
    # of Gaussians alone: a texture would hide what a row lacks, and not every row can have one
    options = replace(options, schedule=replace(options.schedule, detail_from=None))
    known = light_ablations(options) if known_light else ablations(options)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError("variant", wanted=f"one of {', '.join(known)}", came=unknown[0])
    rows = {name: value for name, value in known.items() if not names or name in names}
    return {SHARED: known["full"], **rows} if known_light and set(rows) - {ONE_LIGHT} else rows


def variant_folder(folder: Path, name: str) -> Path:
    """Where the training of a variant lies: `w/o trans` in without_trans."""
    return folder / name.replace("w/o ", "without_").replace("/", "_").replace(" ", "_")


def train_variant(
    build: Callable[[], Trainable], run: RunOptions, display: Display | None, first: RunOptions | None = None
) -> HandAvatar | None:
    """Trains one variant, or resumes it; None when somebody stopped it. first: the training that it goes on from, if
    it has not begun yet. Errors as `run.train`."""
    try:
        if first is not None:
            _branch(first, run)
            run = replace(run, start=Start.RESUME)
        outcome = train(build, run, display)
    except InputError as error:
        if "--fresh" not in (error.remedy or ""):
            raise
        remedy = "Take the options and pictures that it began with, or name another folder with --out."
        raise InputError(error.thing, wanted=error.wanted, came=error.came, remedy=remedy) from error
    return load_avatar(run.out) if outcome.finished else None


def _branch(first: RunOptions, run: RunOptions) -> None:
    work = WorkFolder(run.work, run.stamp, run.budget)
    begun, _ = work.checkpoints.newest()
    if begun is None:
        snapshot, _ = WorkFolder(first.work, first.stamp, first.budget).checkpoints.newest()
        assert snapshot is not None
        with work.opened(Start.FRESH):
            work.checkpoints.save(snapshot)


def drawn_as_learned(avatar: HandAvatar) -> bool:
    """Whether the renderer moves and shades the avatar as its training did; else `LiveHand` does."""
    look = None if avatar.learned is None else avatar.learned.shadow
    return avatar.info.transform is Transform.JOINTS and not (look is not None and look.printed)


class LiveHand:
    """A Picturer (learn.evaluate). avatar: a trained one; its bones follow the joints as it names it, and its shadow is
    the one that it was learned with: under a gate, or the paper's own in every pose."""

    def __init__(self, avatar: HandAvatar, settings: RenderSettings) -> None:
        self._avatar, self._transform, self._settings = avatar, transform_of(avatar), settings
        self._look = None if avatar.learned is None else avatar.learned.shadow
        self._gate = ShadowGate(avatar.canonical_joints_m)
        self._library = load(settings.backend)

    def __call__(self, hand: Hand, handedness: Handedness, camera: Camera) -> np.ndarray:
        """A pose, or (21, 3) world joints -> (H, W, 4) float32 premultiplied sRGB. InputError for the other hand."""
        if handedness is not self._transform.handedness:
            raise InputError("hand to draw", wanted=self._transform.handedness, came=handedness)
        settings, pose = self._settings, HandPose.of(hand)
        joints_m = np.ascontiguousarray(pose.joints_m)
        with torch.no_grad():
            bones = self._transform.bones(torch.from_numpy(joints_m).float(), pose.forearm)
            gaussians = pose_gaussians(self._avatar, bones, frames=bones.frames, eye_m=torch.from_numpy(camera.eye_m))
            picture = rasterize(gaussians, camera, settings)
            planes = torch.cat([picture.rgb.permute(2, 0, 1), picture.alpha[None], picture.depth_sum[None]])
            pixels, depth_m = camera.project(joints_m)
            large = fade_with_size(extent_px(float(np.ptp(pixels, 0).max()), float(depth_m.min()), camera))
            strength = large * fade(self._gate.score(joints_m, float(bones.scale)))
            if self._look is not None and self._look.printed:
                seen = printed_visibility(picture.depth_sum, picture.alpha, settings.shadow_samples)
                planes[:3] *= 1 - (1 - seen) * torch.tensor(self._look.tint)[:, None, None]
            elif self._look is not None and strength > 0:
                look = self._look
                style = ShadowStyle(settings.shadow_samples, strength, gain=look.gain, tint=look.tint)
                rgb = darken(planes, camera, style, library=self._library, threads=thread_count(settings.threads))
                planes = torch.cat([rgb, planes[3:]])
            return planes[:4].permute(1, 2, 0).contiguous().numpy()


# ---- known light -----------------------------------------------------------------------------------------------------


def light_categories(split: Split, limit: int) -> dict[str, tuple[Sample, ...]]:
    """The pictures to measure of a capture in known light, by what of them is new. Those of a new light are shown in
    its world, with its lamps as well, and in its small spot alone, which stands behind the hand. limit: at most so many
    of each, evenly spread; 0: all. InputError as `categories_of`."""
    categories_of(split, "test")
    if all(sample.light is None for sample in split.test):
        raise InputError(f"pictures of the test split ({split.origin})", wanted="light groups", came="none",
                         remedy="Take a capture with --lights varied.")  # fmt: skip
    kinds: dict[str, list[Sample]] = {
        "new pose": list(split.novel_pose), "new camera": list(split.novel_view), "new world": [],
        "new world and lamps": [], "spot from behind": [], "all new": [],
    }  # fmt: skip
    for sample in split.novel_light:
        kinds["new world"].append(_in_groups(sample, lambda lamp: False))
        kinds["new world and lamps"].append(_in_groups(sample, lambda lamp: True))
        if sample.light is not None and any(lamp.kind is LampKind.SPOT for lamp in sample.light.lamps):
            spot = _in_groups(sample, lambda lamp: lamp.kind is LampKind.SPOT, world=False)
            kinds["spot from behind"].append(spot)
    kinds["all new"] += split.novel_both
    return {name: spread(samples, limit) for name, samples in kinds.items() if samples}


def _in_groups(sample: Sample, is_on: Callable[[Lamp], bool], *, world: bool = True) -> Sample:
    light = sample.light
    assert light is not None
    on = [world] * (light.world is not None) + [is_on(lamp) for lamp in light.lamps]
    return replace(sample, light=replace(light, judged_in=tuple(map(float, on))))


def light_drawers(name: str, avatar: HandAvatar, options: TrainOptions) -> dict[str, Picturer]:
    """What draws the rows of the table that come of one variant, by name: of a hand that learned one light two."""
    if name == ONE_LIGHT:
        return {name: _BalancedHand(avatar, preset("final")), "estimated": AvatarPicturer(avatar, preset("final"))}
    return {name: _HandWithout(avatar, options.model.left_out)}


class _BalancedHand(AvatarPicturer):
    """A hand in the light that it carries, in the white balance that fits each picture best, by least squares of linear
    light: as near to that picture as a hand comes that no light changes."""

    def in_light(self, sample: Sample, light: SceneLight) -> np.ndarray:
        rgba = self(sample.hand, sample.handedness, sample.camera)
        rgb, truth = srgb_to_linear(rgba[..., :3]), judged_mix(sample).rgb
        gain = (rgb * truth).sum((0, 1)) / np.maximum(np.square(rgb).sum((0, 1)), 1e-9)
        return np.concatenate([rgb * gain, rgba[..., 3:]], -1).astype(np.float32)


class _HandWithout(AvatarPicturer):
    """A hand that learned without a part of the light, without that part."""

    def __init__(self, avatar: HandAvatar, left_out: LightPart | None) -> None:
        settings = preset("final")
        if left_out in (LightPart.SHADOWS, LightPart.SHADOWS_AND_LAMPS):
            shadows = {Effect.LAMP_SHADOW, Effect.WORLD_SHADOW}
            settings = replace(settings, effects=Choice(frozenset(Effect) - shadows))
        super().__init__(avatar, settings)
        self._in_world = left_out in LAMPS_IN_WORLD

    def in_light(self, sample: Sample, light: SceneLight) -> np.ndarray:
        return super().in_light(sample, lamps_in_world(light, sample.joints_m.mean(0)) if self._in_world else light)
