"""The engine's own pictures for the service: avatars from files, one renderer per set of hands and settings.

torch and the renderer are imported with the first request that needs them, so that the handshake comes at once and a
broken installation is an answer that Blender can show.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jghand_engine import limits
from jghand_engine.errors import InputError
from jghand_engine.service.commands import Hand, LoadedAvatar, Painting, View

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.splat.frame import SceneRenderer

# the name on the wire of the avatar that comes with JGHand


class _Key(NamedTuple):
    """What a renderer is made for: (avatar, handedness) of every hand, a preset, and whether it draws depth."""

    hands: tuple[tuple[str, str], ...]
    preset: str
    depth: bool


class EngineHands:
    """A PictureSource (commands.py). Avatars are kept for the life of the process, the last few renderers too."""

    device = "cpu"

    def __init__(self) -> None:
        self._avatars: dict[str, HandAvatar] = {}
        self._renderers: OrderedDict[_Key, SceneRenderer] = OrderedDict()

    def load(self, avatar: str) -> LoadedAvatar:
        """Reads the file anew, so that a changed file is seen; renderers of the old one are dropped."""
        from jghand_engine.hand.orders import JointOrder, from_level

        loaded = self._read(avatar)
        self._avatars[avatar] = loaded
        for key in [key for key in self._renderers if avatar in dict(key.hands)]:
            del self._renderers[key]
        facts = {
            "avatar": avatar,
            "name": loaded.info.name,
            "template": loaded.info.template,
            "licence": loaded.info.licence,
            "handedness": str(loaded.handedness),
            "gaussians": len(loaded),
        }
        return LoadedAvatar(facts, from_level(loaded.canonical_joints_m.numpy(), JointOrder.STANDARD))

    def render(self, hands: list[Hand], view: View) -> Painting:
        """All hands in one picture: their Gaussians are drawn together, so that hands may interlock.

        The first hand's space is the picture's world; the others are brought into it.
        """
        import torch

        from jghand_engine.hand.orders import JointOrder, to_level
        from jghand_engine.splat.camera import Camera

        camera_from_world = hands[0].camera_from_hand
        joints_m = []
        for hand in hands:
            world_from_hand = np.linalg.solve(camera_from_world, hand.camera_from_hand)
            joints = hand.joints_m @ world_from_hand[:3, :3].T + world_from_hand[:3, 3]
            joints_m.append(to_level(joints, JointOrder.STANDARD))
        camera = Camera(
            view.width, view.height, view.fx, view.fy, view.cx, view.cy, torch.from_numpy(camera_from_world)
        )
        key = _Key(tuple((hand.avatar, hand.handedness) for hand in hands), view.preset, view.depth)
        frame = self._renderer(key).render(joints_m, camera)
        return Painting(frame.rgba, frame.depth_m, frame.report.as_dict())

    def encode_png(self, rgba: np.ndarray) -> bytes:
        """(H, W, 4) premultiplied float32 -> the bytes of a PNG with straight alpha."""
        from jghand_engine.exporters.pictures import encode_png

        return encode_png(rgba)

    def _renderer(self, key: _Key) -> SceneRenderer:
        from jghand_engine.splat.frame import SceneRenderer
        from jghand_engine.splat.settings import preset

        if key not in self._renderers:
            settings = replace(preset(key.preset), depth=key.depth)
            avatars = [self._avatar(name, handedness) for name, handedness in key.hands]
            while len(self._renderers) >= limits.RENDERERS_MAX:
                self._renderers.popitem(last=False)
            self._renderers[key] = SceneRenderer(avatars, settings)
        self._renderers.move_to_end(key)
        return self._renderers[key]

    def _avatar(self, name: str, handedness: str) -> HandAvatar:
        from jghand_engine.hand.joints import Handedness

        if handedness not in list(Handedness):
            raise InputError("handedness", wanted=" | ".join(Handedness), came=handedness)
        if name not in self._avatars:
            self.load(name)
        return self._avatars[name].for_hand(Handedness(handedness))

    def _read(self, avatar: str) -> HandAvatar:
        from jghand_engine.avatar.builtin import load_avatar_called

        return load_avatar_called(avatar)
