"""Drawing an avatar that the renderer of users refuses: one whose bones follow the joints in another way.

Everything is drawn by the functions that training draws with (`avatar.skinning`, `splat`), at full accuracy and without
the shortcuts of frames that follow one another. All rows of an ablation are drawn by it, so that they differ in nothing
else.
"""

from __future__ import annotations

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.shadow import darken
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.native.library import load
from jghand_engine.native.threads import thread_count
from jghand_engine.render.camera import Camera
from jghand_engine.render.gate import ShadowGate, fade
from jghand_engine.render.settings import RenderSettings, ShadowMode
from jghand_engine.render.shadow import ShadowStyle
from jghand_engine.render.shadow_effects import extent_px, fade_with_size


class LiveHand:
    """A Picturer (training.evaluate). avatar: what was learned; its bones follow the joints as it names it."""

    def __init__(self, avatar: HandAvatar, settings: RenderSettings) -> None:
        self._avatar, self._transform, self._settings = avatar, avatar.bone_transform(), settings
        self._gate = ShadowGate(avatar.canonical_joints_m)
        self._library = load(settings.backend)

    def __call__(self, joints_m: np.ndarray, handedness: Handedness, camera: Camera) -> np.ndarray:
        """(21, 3) world joints -> (H, W, 4) float32 premultiplied sRGB. InputError for the other hand."""
        if handedness is not self._transform.handedness:
            raise InputError("hand to draw", wanted=self._transform.handedness, came=handedness)
        with torch.no_grad():
            bones = self._transform.bones(torch.from_numpy(np.ascontiguousarray(joints_m)).float())
            gaussians = pose_gaussians(self._avatar, bones, frames=bones.frames, eye_m=torch.from_numpy(camera.eye_m))
            picture = rasterize(gaussians, camera, self._settings)
            planes = torch.cat([picture.rgb.permute(2, 0, 1), picture.alpha[None], picture.depth_sum[None]])
            look = ShadowLook() if self._avatar.learned is None else self._avatar.learned.shadow
            strength = self._shadow_strength(joints_m, float(bones.scale), camera)
            if look is not None and strength > 0:
                style = ShadowStyle(
                    samples=self._settings.shadow_samples,
                    strength=strength,
                    radius_m=self._settings.shadow_radius_m,
                    gain=look.gain,
                    tint=look.tint,
                )
                rgb = darken(planes, camera, style, library=self._library, threads=thread_count(self._settings.threads))
                planes = torch.cat([rgb, planes[3:]])
            return planes[:4].permute(1, 2, 0).contiguous().numpy()

    def _shadow_strength(self, joints_m: np.ndarray, scale: float, camera: Camera) -> float:
        """As `splat.frame`: colors that were learned under a shadow that fades have in them what it leaves out."""
        if self._settings.shadow is ShadowMode.OFF:
            return 0.0
        always = self._settings.shadow is ShadowMode.ALWAYS
        if always and self._avatar.learned is None:
            return self._settings.shadow_strength
        large = 1.0 if always else fade_with_size(extent_px(*camera.project(joints_m), camera))
        return self._settings.shadow_strength * large * fade(self._gate.score(joints_m, scale))
