"""The engine's own pictures for the service: avatars from files, one renderer per (avatar, handedness, preset).

torch and the renderer are imported with the first request that needs them, so that the handshake comes at once and a
broken installation is an answer that Blender can show.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.service.commands import Hand, HandPicture, LoadedAvatar, View

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.splat.frame import HandRenderer

# the name on the wire of the avatar that comes with JGHand
BUILTIN = "builtin"


class EngineHands:
    """A PictureSource (commands.py). Renderers are kept for the life of the process, as are the avatars."""

    device = "cpu"

    def __init__(self) -> None:
        self._avatars: dict[str, HandAvatar] = {}
        self._renderers: dict[tuple[str, str, str], HandRenderer] = {}

    def load(self, avatar: str) -> LoadedAvatar:
        """Reads the file anew, so that a changed file is seen; renderers of the old one are dropped."""
        from jghand_engine.hand.orders import JointOrder, from_level

        loaded = self._read(avatar)
        self._avatars[avatar] = loaded
        self._renderers = {key: value for key, value in self._renderers.items() if key[0] != avatar}
        facts = {
            "avatar": avatar,
            "name": loaded.info.name,
            "template": loaded.info.template,
            "licence": loaded.info.licence,
            "handedness": str(loaded.handedness),
            "gaussians": len(loaded),
        }
        return LoadedAvatar(facts, from_level(loaded.canonical_joints_m.numpy(), JointOrder.STANDARD))

    def render(self, hand: Hand, view: View) -> HandPicture:
        """One hand of one picture."""
        import torch

        from jghand_engine.hand.orders import JointOrder, to_level
        from jghand_engine.splat.camera import Camera

        camera = Camera(
            view.width, view.height, view.fx, view.fy, view.cx, view.cy, torch.from_numpy(hand.camera_from_hand)
        )
        frame = self._renderer(hand, view.preset).render(to_level(hand.joints_m, JointOrder.STANDARD), camera)
        return HandPicture(frame.rgba, frame.depth_m, frame.report.as_dict())

    def encode_png(self, rgba: np.ndarray) -> bytes:
        """(H, W, 4) premultiplied float32 -> the bytes of a PNG with straight alpha."""
        from jghand_engine.exporters.pictures import encode_png

        return encode_png(rgba)

    def _renderer(self, hand: Hand, preset_name: str) -> HandRenderer:
        from jghand_engine.hand.joints import Handedness
        from jghand_engine.splat.frame import HandRenderer
        from jghand_engine.splat.settings import preset

        settings = preset(preset_name)
        if hand.handedness not in list(Handedness):
            raise InputError("handedness", wanted=" | ".join(Handedness), came=hand.handedness)
        if hand.avatar not in self._avatars:
            self.load(hand.avatar)
        key = (hand.avatar, hand.handedness, preset_name)
        if key not in self._renderers:
            avatar = self._avatars[hand.avatar].for_hand(Handedness(hand.handedness))
            self._renderers[key] = HandRenderer(avatar, settings)
        return self._renderers[key]

    def _read(self, avatar: str) -> HandAvatar:
        if avatar == BUILTIN:
            from jghand_engine.avatar.builtin import load_builtin
            from jghand_engine.hand.joints import Handedness

            return load_builtin(handedness=Handedness.RIGHT)
        from jghand_engine.avatar.file import load_avatar

        return load_avatar(avatar)
