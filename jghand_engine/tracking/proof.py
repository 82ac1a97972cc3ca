"""What was seen and what came of it, side by side: the video with the landmarks, and the avatar before its camera."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import torch
from PIL import Image, ImageDraw

from jghand_engine import limits
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.exporters.pictures import flatten
from jghand_engine.hand.joints import PARENTS, Handedness
from jghand_engine.splat.camera import Camera
from jghand_engine.splat.frame import SceneRenderer
from jghand_engine.splat.settings import preset
from jghand_engine.tracking.fit import Pinhole
from jghand_engine.tracking.track import TrackedHand

_BACKGROUND = (0.91, 0.90, 0.89)
_SEEN, _FITTED, _FILLED = (255, 190, 40), (60, 220, 120), (240, 70, 60)


def side_by_side(
    pictures: Iterable[np.ndarray], hands: Mapping[Handedness, TrackedHand], pinhole: Pinhole, avatar: HandAvatar
) -> Iterator[np.ndarray]:
    """(H, W, 3) uint8 per picture. Left the picture with what the detector saw (yellow) and the motion (green, red
    where it was filled in); right the avatar as it would stand before that camera."""
    tracked = list(hands.values())
    quick = replace(preset("viewport"), antialias=True)
    renderer = SceneRenderer([avatar.for_hand(side) for side in hands], quick)
    camera: Camera | None = None
    for frame, picture in enumerate(pictures):
        if tracked and frame >= len(tracked[0].seen):
            return
        if camera is None:
            camera = _camera(pinhole, picture.shape[1], picture.shape[0])
        drawn = renderer.render([hand.in_view[frame] for hand in tracked], camera)
        left = _with_bones(picture, (camera.height, camera.width), tracked, pinhole, frame)
        yield np.concatenate([left, flatten(drawn.rgba, _BACKGROUND)], axis=1)


def _camera(pinhole: Pinhole, width: int, height: int) -> Camera:
    """The camera of the video, no larger than a proof needs to be."""
    axes = torch.eye(4, dtype=torch.float64)
    whole = Camera(width, height, pinhole.focal_px, pinhole.focal_px, pinhole.cx, pinhole.cy, axes)
    return whole.scaled(min(1.0, limits.PROOF_EDGE_PX / max(width, height)))


def _with_bones(
    picture: np.ndarray, size: tuple[int, int], hands: list[TrackedHand], pinhole: Pinhole, frame: int
) -> np.ndarray:
    height, width = size
    image = Image.fromarray(picture).resize((width, height), Image.Resampling.BOX)
    scale = width / picture.shape[1]
    pen = ImageDraw.Draw(image)
    for hand in hands:
        fitted = pinhole.project(hand.in_view[frame]) * scale
        colour = _FITTED if hand.seen[frame] else _FILLED
        for joint in range(1, len(PARENTS)):
            ends = [tuple(float(x) for x in fitted[end]) for end in (PARENTS[joint], joint)]
            pen.line(ends, fill=colour, width=2)  # pyright: ignore[reportArgumentType]
        found = hand.hand.frames[frame]
        for x, y in () if found is None else found.image_px * scale:
            pen.ellipse((x - 2, y - 2, x + 2, y + 2), fill=_SEEN)
    return np.asarray(image)
