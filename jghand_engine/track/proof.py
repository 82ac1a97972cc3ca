"""What was seen and what came of it, side by side: the video with the landmarks, and the avatar before its camera."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.export.pictures import VIDEO_BACKGROUND, flatten
from jghand_engine.hand.joints import PARENTS, Handedness
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.settings import preset
from jghand_engine.track.poses import Pinhole
from jghand_engine.track.track import TrackedHand

# longer edge of each half of the side-by-side video
PROOF_EDGE_PX = 640
# how much is shown around the hands, and how far a small one is enlarged
PROOF_MARGIN = 1.3
PROOF_ENLARGED_MAX = 3.0

_SEEN, _FITTED, _FILLED = (255, 190, 40), (60, 220, 120), (240, 70, 60)


def side_by_side(
    pictures: Iterable[np.ndarray], hands: Mapping[Handedness, TrackedHand], pinhole: Pinhole, avatar: HandAvatar
) -> Iterator[np.ndarray]:
    """(H, W, 3) uint8 per picture, of the part of the video in which hands are.

    Left the picture with what the detector saw (yellow) and the motion (green, red where it was filled in); right the
    avatar as it would stand before that camera.
    """
    tracked = list(hands.values())
    renderer = SceneRenderer([avatar.for_hand(side) for side in hands], preset("viewport"))
    window: _Window | None = None
    for frame, picture in enumerate(pictures):
        if frame >= len(tracked[0].seen):
            return
        if window is None:
            window = _Window.around(tracked, pinhole, picture.shape[1], picture.shape[0])
        drawn = renderer.render([hand.in_view[frame] for hand in tracked], window.camera(pinhole))
        yield np.concatenate(
            [window.shown(picture, tracked, pinhole, frame), flatten(drawn.rgba, VIDEO_BACKGROUND)], axis=1
        )


@dataclass(frozen=True)
class _Window:
    """The part of the picture that is shown, pixels of the video, and the size that it is shown in."""

    left: int
    top: int
    width: int
    height: int
    scale: float

    @classmethod
    def around(cls, hands: list[TrackedHand], pinhole: Pinhole, width: int, height: int) -> _Window:
        """Everywhere that the hands come, and some of what is around them."""
        points = np.concatenate([pinhole.project(hand.in_view).reshape(-1, 2) for hand in hands])
        # a few frames in which the fit went astray shall not make the hand tiny in all
        low, high = np.percentile(points, (0.5, 99.5), axis=0)
        middle, half = (low + high) / 2, PROOF_MARGIN * (high - low) / 2
        half = np.maximum(half, half.max() / 2)
        left, top = np.clip(np.floor(middle - half), 0, (width - 16, height - 16)).astype(int)
        right, bottom = np.clip(np.ceil(middle + half), (left + 16, top + 16), (width, height)).astype(int)
        scale = PROOF_EDGE_PX / max(right - left, bottom - top)
        return cls(int(left), int(top), int(right - left), int(bottom - top), min(scale, PROOF_ENLARGED_MAX))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height as shown, even."""
        return tuple(max(16, 2 * round(edge * self.scale / 2)) for edge in (self.width, self.height))  # pyright: ignore[reportReturnType]

    def camera(self, pinhole: Pinhole) -> Camera:
        width, height = self.size
        x, y = width / self.width, height / self.height
        at = (pinhole.cx - self.left) * x, (pinhole.cy - self.top) * y
        focal = pinhole.focal_px
        return Camera(width, height, focal * x, focal * y, *at, np.eye(4))

    def shown(self, picture: np.ndarray, hands: list[TrackedHand], pinhole: Pinhole, frame: int) -> np.ndarray:
        """The picture's part with what was seen and what was fitted drawn on it."""
        part = picture[self.top : self.top + self.height, self.left : self.left + self.width]
        image = Image.fromarray(np.ascontiguousarray(part)).resize(self.size, Image.Resampling.BILINEAR)
        pen = ImageDraw.Draw(image)
        scale = np.array(self.size) / (self.width, self.height)
        corner = np.array([self.left, self.top])
        for hand in hands:
            fitted = ((pinhole.project(hand.in_view[frame]) - corner) * scale).tolist()
            color = _FITTED if hand.seen[frame] else _FILLED
            for joint in range(1, len(PARENTS)):
                pen.line([tuple(fitted[PARENTS[joint]]), tuple(fitted[joint])], fill=color, width=2)
            found = hand.hand.frames[frame]
            for x, y in () if found is None else (found.image_px - corner) * scale:
                pen.ellipse((x - 2, y - 2, x + 2, y + 2), fill=_SEEN)
        return np.asarray(image)
