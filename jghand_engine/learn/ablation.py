"""The paper's ablation on any capture: the same training with a part of the method taken out, each time (PAPER 3).

Every variant has the same pictures, seed and budget, and is drawn by the same code (`LiveHand`; the renderer knows our
transform alone), so that the rows differ in nothing but what their name says. A variant has a folder of its own, with
checkpoints: an ablation that was stopped can be resumed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.file import load_avatar
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import Transform
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.options import TrainOptions, ablations
from jghand_engine.learn.progress import Display
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.run import RunOptions, train
from jghand_engine.learn.shadow import darken, printed_visibility
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.learn.trainable import Trainable
from jghand_engine.native.library import load
from jghand_engine.native.threads import thread_count
from jghand_engine.render.camera import Camera
from jghand_engine.render.gate import ShadowGate, extent_px, fade, fade_with_size
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.shadow import ShadowStyle


def chosen_variants(options: TrainOptions, names: tuple[str, ...]) -> dict[str, TrainOptions]:
    """The rows of the table by name, in the paper's order; none named: all. InputError lists them."""
    known = ablations(options)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError("variant", wanted=f"one of {', '.join(known)}", came=unknown[0])
    return {name: value for name, value in known.items() if not names or name in names}


def variant_folder(folder: Path, name: str) -> Path:
    """Where the training of a variant lies: `w/o trans` in without_trans."""
    return folder / name.replace("w/o ", "without_").replace("/", "_").replace(" ", "_")


def train_variant(build: Callable[[], Trainable], run: RunOptions, display: Display | None) -> HandAvatar | None:
    """Trains one variant, or resumes it; None when somebody stopped it. Errors as `run.train`."""
    try:
        outcome = train(build, run, display)
    except InputError as error:
        if "--fresh" not in (error.remedy or ""):
            raise
        remedy = "Take the options and pictures that it began with, or name another folder with --out."
        raise InputError(error.thing, wanted=error.wanted, came=error.came, remedy=remedy) from error
    return load_avatar(run.out) if outcome.finished else None


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

    def __call__(self, joints_m: np.ndarray, handedness: Handedness, camera: Camera) -> np.ndarray:
        """(21, 3) world joints -> (H, W, 4) float32 premultiplied sRGB. InputError for the other hand."""
        if handedness is not self._transform.handedness:
            raise InputError("hand to draw", wanted=self._transform.handedness, came=handedness)
        settings = self._settings
        with torch.no_grad():
            bones = self._transform.bones(torch.from_numpy(np.ascontiguousarray(joints_m)).float())
            gaussians = pose_gaussians(self._avatar, bones, frames=bones.frames, eye_m=torch.from_numpy(camera.eye_m))
            picture = rasterize(gaussians, camera, settings)
            planes = torch.cat([picture.rgb.permute(2, 0, 1), picture.alpha[None], picture.depth_sum[None]])
            large = fade_with_size(extent_px(*camera.project(joints_m), camera))
            strength = large * fade(self._gate.score(joints_m, float(bones.scale)))
            if self._look is not None and self._look.printed:
                seen = printed_visibility(picture.depth_sum, picture.alpha, settings.shadow_samples)
                dark = settings.shadow_strength * (1 - seen)
                planes[:3] *= 1 - dark * torch.tensor(self._look.tint)[:, None, None]
            elif self._look is not None and strength > 0:
                style = ShadowStyle(
                    samples=settings.shadow_samples,
                    strength=settings.shadow_strength * strength,
                    radius_m=settings.shadow_radius_m,
                    gain=self._look.gain,
                    tint=self._look.tint,
                )
                rgb = darken(planes, camera, style, library=self._library, threads=thread_count(settings.threads))
                planes = torch.cat([rgb, planes[3:]])
            return planes[:4].permute(1, 2, 0).contiguous().numpy()
