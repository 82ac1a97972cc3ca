"""Motion blur and depth of field: the poses and the pinholes that one image is the mean of, and that mean.

Images are averaged in linear light, premultiplied: what a camera's sensor adds up. They come in and go out
display-referred, as they are blended.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from jghand_engine.avatar.learned import CAPSULE_RADII_MM
from jghand_engine.errors import InputError
from jghand_engine.hand.rotations import slerp_rotation
from jghand_engine.hand.sequence import HandPose
from jghand_engine.native import contract
from jghand_engine.native.binding import Library
from jghand_engine.native.mean import NativeMean
from jghand_engine.render.camera import Camera, Lens
from jghand_engine.render.image import Box, Image
from jghand_engine.render.shadow import vogel_disc

# a hand of an image: its pose, or its joints (21, 3), level order, meters, in the frame of the camera
Hand: TypeAlias = np.ndarray | HandPose

# what may be missing from an image that moves, or is out of focus, as a part of the contrast; more exposures cost more
MOTION_ERROR_MAX = 1 / 64
FOCUS_ERROR_MAX = 1 / 20
# an edge of a splatted image: largest slope per px and change of slope per px^2. The low pass alone makes 0.73 and
# 0.81; layers of Gaussians over each other are steeper. With these the bounds held on the built-in hand
EDGE_SLOPE = 1.2
EDGE_CURVATURE = 2.4
# edges that pass over one pixel leave stairs each: those of up to five fingers, both sides; they add up the more, the
# longer the steps are (built-in and painted hand, 49 to 400 px: 0.5 / n up to steps of 2 px, 0.62 of 3, 1.2 of 5)
EDGES, STAIR_PX = 10.0, 2.0
# images of a moving hand at most
MOTION_COUNT_MAX = 128
# what a disc of n sunflower samples misjudges of a half plane: at most 1.4 / n^0.75 (worst of n = 4 to 256)
DISC_DISCREPANCY = 1.4

# ---- how many exposures ---------------------------------------------------------------------------------------------


def motion_error(length_px: float, count: int) -> float:
    """What `count` evenly spread images miss of an edge that moves by `length_px`, as a part of its contrast.

    Steps of up to a pixel: the midpoint rule on an edge as steep as splats make it. Longer ones leave stairs of
    1 / count, which are off by half of that, at every edge that passes.
    """
    step = length_px / count
    stairs = 0.5 / count * min(max(1.0, step / STAIR_PX), EDGES)
    if step > 1.0:
        return stairs
    smooth = step * step / 24 * min(EDGE_CURVATURE, 2 * EDGE_SLOPE / max(length_px, 1e-9))
    return min(smooth, stairs) if count > 1 else smooth


def focus_error(disc_px: float, count: int) -> float:
    """What `count` pinholes miss of an edge that is out of focus by a disc of `disc_px`, as a part of its contrast."""
    step = disc_px * math.sqrt(math.pi / 4 / count)
    smooth = step * step / 24 * EDGE_CURVATURE if step <= 1.0 else math.inf
    return min(DISC_DISCREPANCY / count**0.75, smooth)


def motion_count(length_px: float) -> int:
    """The least number of images within MOTION_ERROR_MAX, but no more than MOTION_COUNT_MAX."""
    numbers = range(1, MOTION_COUNT_MAX)
    return next((n for n in numbers if motion_error(length_px, n) <= MOTION_ERROR_MAX), MOTION_COUNT_MAX)


def focus_count(disc_px: float) -> int:
    """The least number of pinholes within FOCUS_ERROR_MAX."""
    most = math.ceil((DISC_DISCREPANCY / FOCUS_ERROR_MAX) ** (4 / 3))
    return next((n for n in range(1, most) if focus_error(disc_px, n) <= FOCUS_ERROR_MAX), most)


def disc_px(camera: Camera, joints_m: Sequence[np.ndarray], scale: float = 1.0) -> float:
    """Diameter of the largest disc that a point of the hands (21, 3), meters, becomes; 0 without hands. scale: of the
    largest hand."""
    if camera.lens is None or not joints_m:
        return 0.0
    depth_m = camera.project(np.concatenate(joints_m))[1]
    flesh_m = 1e-3 * max(CAPSULE_RADII_MM) * scale
    ends = (float(depth_m.min()) - flesh_m, float(depth_m.max()) + flesh_m)
    return max(camera.lens.blur_px(max(camera.fx, camera.fy), max(end, contract.Z_NEAR_M)) for end in ends)


# ---- moments of a scene ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Moment:
    """One moment of a scene that somebody else knows, such as Blender.

    hands:  in the order of their avatars
    camera: with its lens
    """

    hands: Sequence[Hand]
    camera: Camera

    @property
    def joints_m(self) -> list[np.ndarray]:
        """Per hand (21, 3)."""
        return [HandPose.of(hand).joints_m for hand in self.hands]


def shutter_at(hands: Sequence[Hand], index: int, open_for: float, camera: Camera) -> list[Moment]:
    """The moments of one frame of a motion, a hand for each frame, while a shutter is open around it for a part, 0..1,
    of the time between frames: the middles of its thirds. For 0 the frame alone. Before the first frame and after the
    last one nothing moves."""
    before, here, after = (HandPose.of(hands[min(max(index + k, 0), len(hands) - 1)]) for k in (-1, 0, 1))
    if open_for == 0:
        return [Moment([here], camera)]
    third = open_for / 3
    return [Moment([each], camera) for each in (here.between(before, third), here, here.between(after, third))]


def check_moments(moments: Sequence[Moment], weights: Sequence[float]) -> None:
    """InputError for moments of different sizes, or weights that are none."""
    sizes = {(moment.camera.width, moment.camera.height) for moment in moments}
    if len(sizes) != 1:
        raise InputError("moments of an image", wanted="at least one, all of one size", came=str(sorted(sizes)))
    good = len(weights) == len(moments) and all(0 <= weight < np.inf for weight in weights) and sum(weights) > 0
    if not good:
        raise InputError("weights of moments", wanted=f"{len(moments)} of 0 or more, not all 0", came=str(weights)[:80])


def middle(moments: Sequence[Moment]) -> Moment:
    """The moment that the image is of, but for its blur."""
    return moments[(len(moments) - 1) // 2]


def filled(
    moments: Sequence[Moment], weights: Sequence[float], seen: Sequence[int]
) -> tuple[list[Moment], list[float]]:
    """As many moments as the movement needs on the image (`motion_count`), evenly spread over the same time, and their
    shares, which sum to 1; those that are given where they are enough, the middle one where it is. Between two that are
    given bones turn, and cameras too; before the first and after the last one, by half a step, they go on so. seen: as
    of `way_px`."""
    count, needed = len(moments), motion_count(way_px(moments, seen))
    if needed == 1:
        return [middle(moments)], [1.0]
    if needed <= count:
        return list(moments), [weight / sum(weights) for weight in weights]
    between, shares = [], []
    for place in range(needed):
        at = (place + 0.5) * count / needed - 0.5
        first = min(max(math.floor(at), 0), count - 2)
        part = at - first
        between.append(_moment_between(moments[first], moments[first + 1], part))
        shares.append(max(0.0, (1 - part) * weights[first] + part * weights[first + 1]))
    return between, [share / sum(shares) for share in shares]


def way_px(moments: Sequence[Moment], seen: Sequence[int]) -> float:
    """The longest way of a joint on the image, as if it went all the time as fast as between the two moments where it
    is fastest, since images are evenly spread in time; infinite when it passes the near plane. seen: the numbers of the
    hands that are in the image at some moment; where the others go makes no difference."""
    if len(moments) == 1 or not seen:
        return 0.0
    places = [one.camera.project(np.concatenate([one.joints_m[hand] for hand in seen])) for one in moments]
    if not all((depth_m > contract.Z_NEAR_M).all() for _, depth_m in places):
        return math.inf
    steps_px = np.linalg.norm(np.diff(np.stack([pixels for pixels, _ in places]), axis=0), axis=-1)
    return len(moments) * float(steps_px.max())


def _moment_between(first: Moment, second: Moment, part: float) -> Moment:
    pairs = zip(first.hands, second.hands, strict=True)
    hands = [HandPose.of(a).between(HandPose.of(b), part) for a, b in pairs]
    return Moment(hands, _camera_between(first.camera, second.camera, part))


def _camera_between(first: Camera, second: Camera, part: float) -> Camera:
    """Numbers and places linear, directions along the shortest turn."""
    a, b = first.camera_from_world, second.camera_from_world
    matrix = np.eye(4)
    matrix[:3, :3] = turn = slerp_rotation(a[:3, :3], b[:3, :3], np.array(part))
    matrix[:3, 3] = turn @ ((1 - part) * a[:3, :3].T @ a[:3, 3] + part * b[:3, :3].T @ b[:3, 3])

    def mixed(x: float, y: float) -> float:
        return (1 - part) * x + part * y

    numbers = {name: mixed(getattr(first, name), getattr(second, name)) for name in ("fx", "fy", "cx", "cy")}
    lens = first.lens
    if first.lens is not None and second.lens is not None:
        focus_m = mixed(first.lens.focus_m, second.lens.focus_m)
        lens = Lens(max(0.0, mixed(first.lens.aperture_m, second.lens.aperture_m)), focus_m)
    return replace(first, camera_from_world=matrix, lens=lens, **numbers)


def pinholes(camera: Camera, index: int, each: int, moments: int) -> list[Camera]:
    """The `each` pinholes on the lens of moment `index`: its share of a sunflower over the whole lens, the places of
    which have nothing to do with time."""
    if camera.lens is None:
        return [camera] * each
    count = each * moments
    places_m = camera.lens.aperture_m / 2 * vogel_disc(count)
    # a stride near the golden section that visits every place
    stride = max(1, round(count * 0.618))
    while math.gcd(stride, count) != 1:
        stride += 1
    chosen = [places_m[(index * each + turn) * stride % count] for turn in range(each)]
    return [camera.through(float(x), float(y)) for x, y in chosen]


# ---- the mean -------------------------------------------------------------------------------------------------------


class LinearMean:
    """The mean of images of one size in linear light, with weights that sum to 1. linear: whether they are
    scene-linear"""

    def __init__(self, library: Library, threads: int, width: int, height: int, *, linear: bool = False) -> None:
        self._box, self._mean = Box(0, 0, width, height), NativeMean(library, threads, width, height, linear=linear)
        self._weights: np.ndarray | None = None

    def add(self, image: Image, weight: float) -> None:
        """Adds an image; an empty one is black."""
        if image.box.width:
            self._mean.add(image.rgba, image.depth_m, image.box.left, image.box.top, weight)
        if image.weights is not None:
            if self._weights is None:
                self._weights = np.zeros((self._box.height, self._box.width, image.weights.shape[2]), np.float32)
            self._weights[image.box.slices] += np.float32(weight) * image.weights

    def image(self) -> Image:
        """The mean, in the colors of the images. Its depth is the mean of all that covers a pixel."""
        return Image(self._box, *self._mean.finish(), self._weights)
