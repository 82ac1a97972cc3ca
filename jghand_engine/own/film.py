"""The film, or the photographs, that an avatar is made of: all pictures are looked at, the best of them are kept.

Best are sharp pictures that differ in the turn of the palm and in the pose: what one does not show, another one does.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from jghand_engine.errors import InputError
from jghand_engine.files import writing
from jghand_engine.hand.joints import Handedness
from jghand_engine.npz_files import read_arrays
from jghand_engine.track.detection import HandDetector, SeenHand
from jghand_engine.track.poses import Poses
from jghand_engine.track.track import CAMERA_ANGLES_DEG, Sightings
from jghand_engine.track.video import TRACK_EDGE_PX, Video, open_video, read_frames

PHOTOGRAPH_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff")
PHOTOGRAPHS_MIN, PHOTOGRAPHS_MAX = 3, 10
# at most so many pictures of a film: more show little that is new, and cost as much each
PICTURES_MAX = 60
# what is kept of a picture: the part in which the hand is in any of them, and so much around it, of the hand's size;
# no larger than this, and the hand no longer: a millimeter has two pixels then
WINDOW_MARGIN, PICTURE_EDGE_PX, HAND_SIZE_PX = 0.5, 960, 400.0
# pictures per second of a film that are looked at, at most: a hand moves little in between
LOOK_FPS_MAX = 15.0
# a photograph stands for a second: to the tracker it has nothing to do with the one before but the hand
PHOTOGRAPH_FPS = 1.0
# how different two pictures are: turns of the palm and bends of the fingers that count as much, degrees
TURN_STEP_DEG = 30.0
BEND_STEP_DEG = 40.0
# pictures that are less sharp about the hand than this part of the film's median are blurred
BLURRED_PART = 1 / 3
# a channel from here on is burnt out: what it shows is less than was there
BURNT_U8 = 250
# edge to which the hand is made smaller before its sharpness is measured, pixels: noise is no detail
SHARPNESS_EDGE_PX = 160
# half of the diagonal of a film of 36 x 24 mm, which "focal length in 35 mm" means, millimeters
HALF_DIAGONAL_MM = math.hypot(36, 24) / 2

_EXIF, _EXIF_FOCAL_35MM = 0x8769, 41989
_NPZ_BYTES_MAX = 2**30


@dataclass(frozen=True)
class Source:
    """A film or photographs, as they are looked at.

    name:             of the film, or of the first photograph, without its folder
    size_px:          height and width
    fps:              pictures per second
    count:            how many, about; None where a film does not say
    is_film:          else photographs, one after the other
    camera_angle_deg: angle of view across the longer edge; None where the file does not say
    is_mirrored:      whether left and right of its pictures are exchanged as they are read
    """

    name: str
    size_px: tuple[int, int]
    fps: float
    count: int | None
    is_film: bool
    camera_angle_deg: float | None
    _video: Video | None = None
    _photographs: tuple[np.ndarray, ...] = field(default=(), repr=False)
    is_mirrored: bool = False

    def showing_right(self, hand: Handedness) -> Source:
        """With a left hand's pictures mirrored: a right one is in them then."""
        return replace(self, is_mirrored=hand is Handedness.LEFT)

    def read(self, notes: list[str] | None = None, *, most: int | None = None) -> Iterator[np.ndarray]:
        """The pictures, (H, W, 3) uint8 sRGB; `notes` gets a sentence when the film is damaged. most: of a film, so
        many from its beginning"""
        pictures = self._photographs if self._video is None else read_frames(self._video, notes, most=most)
        for picture in pictures:
            yield np.ascontiguousarray(picture[:, ::-1]) if self.is_mirrored else picture


def open_source(paths: Sequence[Path]) -> Source:
    """One film, or 3 to 10 photographs of one size. InputError for anything else, and for files that are none."""
    photographs = [path for path in paths if path.suffix.lower() in PHOTOGRAPH_SUFFIXES]
    if not photographs and len(paths) == 1:
        return _film(paths[0])
    if len(photographs) < len(paths) or not PHOTOGRAPHS_MIN <= len(paths) <= PHOTOGRAPHS_MAX:
        came = f"{len(photographs)} photographs"
        remedy = "Photograph the flat palm, the flat back, the thumb's side and a fist from both sides."
        if others := sorted({path.suffix or path.name for path in paths if path not in photographs}):
            came += f" and other files ({', '.join(others)})"
            remedy = "Save photographs as JPEG, and name a film alone."
        raise InputError("hand", wanted=f"one film, or {PHOTOGRAPHS_MIN} to {PHOTOGRAPHS_MAX} photographs", came=came,
                         remedy=remedy)  # fmt: skip
    pictures = [_photograph(path) for path in photographs]
    sizes = {picture.shape[:2] for picture, _ in pictures}
    if len(sizes) > 1:
        listed = " and ".join(f"{width} x {height}" for height, width in sorted(sizes))
        raise InputError("photographs", wanted="all of one size, all upright or all across", came=listed,
                         remedy="Take all of them with one camera that is not turned.")  # fmt: skip
    angle = next((angle for _, angle in pictures if angle is not None), None)
    arrays = tuple(picture for picture, _ in pictures)
    return Source(paths[0].name, sizes.pop(), PHOTOGRAPH_FPS, len(paths), False, angle, None, arrays)


def _film(path: Path) -> Source:
    video = open_video(path)
    if video.fps > LOOK_FPS_MAX:
        # every second or third picture, so that each is one of the film's own
        video = open_video(path, video.fps / math.ceil(video.fps / LOOK_FPS_MAX))
    return source_of(video)


def source_of(video: Video) -> Source:
    """A film, all of whose pictures are looked at."""
    angle = told_angle_deg(video.focal_35mm, video.width, video.height)
    return Source(video.path.name, (video.height, video.width), video.fps, video.frames, True, angle, video)


def _photograph(path: Path) -> tuple[np.ndarray, float | None]:
    """The picture, upright and no larger than the tracker takes it, and the angle of view."""
    try:
        with Image.open(path) as image:
            focal = image.getexif().get_ifd(_EXIF).get(_EXIF_FOCAL_35MM)
            upright = ImageOps.exif_transpose(image).convert("RGB")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"photograph {path}", wanted="a picture", came=str(error)[:200],
                         remedy="Save it as JPEG.") from error  # fmt: skip
    angle = told_angle_deg(focal, *upright.size)
    return smaller(np.asarray(upright), TRACK_EDGE_PX), angle


def told_angle_deg(focal_35mm: object, width: int, height: int) -> float | None:
    """As `view_angle_deg`; None where a file does not say a lens, or one that cannot be."""
    if not isinstance(focal_35mm, Real) or not float(focal_35mm) > 0:
        return None
    angle = view_angle_deg(float(focal_35mm), width, height)
    return angle if CAMERA_ANGLES_DEG[0] <= angle <= CAMERA_ANGLES_DEG[1] else None


def view_angle_deg(focal_35mm: float, width: int, height: int) -> float:
    """Angle across the longer edge of a picture whose diagonal is as that of 36 x 24 mm behind such a lens."""
    half_edge_mm = HALF_DIAGONAL_MM * max(width, height) / math.hypot(width, height)
    return math.degrees(2 * math.atan(half_edge_mm / focal_35mm))


def smaller(rgb8: np.ndarray, edge_px: int) -> np.ndarray:
    """The picture with a longer edge of at most so many pixels; every pixel is the mean of those that it covers."""
    height, width = rgb8.shape[:2]
    part = edge_px / max(height, width)
    if part >= 1:
        return np.ascontiguousarray(rgb8)
    size = (max(1, round(width * part)), max(1, round(height * part)))
    return np.asarray(Image.fromarray(rgb8).resize(size, Image.Resampling.BOX))


# ---- how sharp -------------------------------------------------------------------------------------------------------


def _sharpness(rgb8: np.ndarray, hand: SeenHand) -> float:
    """Variance of the Laplacian of the gray picture where the hand is."""
    height, width = rgb8.shape[:2]
    left, top = np.clip(np.floor(hand.image_px.min(0)).astype(int), 0, (width - 1, height - 1))
    right, bottom = np.clip(np.ceil(hand.image_px.max(0)).astype(int), (left + 1, top + 1), (width, height))
    gray = smaller(rgb8[top:bottom, left:right], SHARPNESS_EDGE_PX).mean(-1)
    inside = gray[1:-1, 1:-1]
    if not inside.size:
        return 0.0
    around = gray[:-2, 1:-1] + gray[2:, 1:-1] + gray[1:-1, :-2] + gray[1:-1, 2:]
    return float((around - 4 * inside).var())


@dataclass(frozen=True, eq=False)
class Looked:
    """What was seen in all pictures of a source. sharpness: (F,) about the hands, NaN without one · is_film: else
    photographs"""

    sightings: Sightings
    sharpness: np.ndarray
    is_film: bool = True


def look(
    source: Source,
    detector: HandDetector,
    tick: Callable[[int], None] = lambda done: None,
    notes: list[str] | None = None,
    *,
    most: int | None = None,
) -> Looked:
    """Looks for hands in all pictures; tick is told how many were looked at, `notes` gets what is wrong with it. most:
    as of `Source.read`"""
    seen, sharpness = Sightings(source.fps, source.size_px), []
    for number, picture in enumerate(source.read(notes, most=most)):
        hands = detector.detect(picture, number / source.fps)
        seen.frames.append(hands)
        sharpness.append(max((_sharpness(picture, hand) for hand in hands), default=math.nan))
        tick(number + 1)
    return Looked(seen, np.array(sharpness), source.is_film)


def blurred(sharpness: np.ndarray) -> np.ndarray:
    """(F,) bool: pictures with a hand that are too blurred. sharpness: (F,), NaN without a hand"""
    if np.isnan(sharpness).all():
        return np.zeros(len(sharpness), bool)
    return sharpness < BLURRED_PART * np.nanmedian(sharpness)


# ---- which pictures --------------------------------------------------------------------------------------------------


def spread_pictures(poses: Poses, usable: np.ndarray, most: int = PICTURES_MAX) -> np.ndarray:
    """Numbers, rising, of at most `most` of the usable pictures that differ from one another as much as can be.

    Farthest point first, from the middle one of the usable on. usable: (F,) bool
    """
    left = np.flatnonzero(usable)
    if len(left) <= most:
        return left
    turns, bends = poses.turn[left], poses.angle_rad[left]
    chosen = [len(left) // 2]
    apart = np.full(len(left), np.inf)
    while len(chosen) < most:
        last = chosen[-1]
        turned = np.einsum("fij,ij->f", turns, turns[last])
        turn = np.arccos(np.clip((turned - 1) / 2, -1, 1)) / math.radians(TURN_STEP_DEG)
        bend = np.linalg.norm(bends - bends[last], axis=1) / math.radians(BEND_STEP_DEG)
        apart = np.minimum(apart, np.hypot(turn, bend))
        # never again, not even where all others are the same
        apart[last] = -1
        chosen.append(int(apart.argmax()))
    return left[np.sort(chosen)]


@dataclass(frozen=True)
class Window:
    """The part of pictures, pixels, that is kept, and the width and height in which it is kept."""

    left: int
    top: int
    width: int
    height: int
    size_px: tuple[int, int]

    @classmethod
    def around(
        cls, points_px: np.ndarray, hand_px: float, size_px: tuple[int, int], kept_px: float = HAND_SIZE_PX
    ) -> Window:
        """The part about points (N, 2) of pictures of this width and height, of hands that are so many pixels long;
        they are kept at most `kept_px` long."""
        width, height = size_px
        margin = WINDOW_MARGIN * hand_px
        low = np.clip(np.floor(points_px.min(0) - margin), 0, (width - 1, height - 1)).astype(int)
        high = np.clip(np.ceil(points_px.max(0) + margin), low + 1, (width, height)).astype(int)
        part = high - low
        scale = min(1.0, PICTURE_EDGE_PX / part.max(), kept_px / max(hand_px, 1.0))
        wide, high_px = np.maximum(1, np.round(scale * part)).astype(int).tolist()
        left, top, across, down = np.concatenate([low, part]).tolist()
        return cls(left, top, across, down, (wide, high_px))

    def cut(self, rgb8: np.ndarray) -> np.ndarray:
        """The part of a picture; every pixel is the mean of those that it covers."""
        part = rgb8[self.top : self.top + self.height, self.left : self.left + self.width]
        return np.asarray(Image.fromarray(np.ascontiguousarray(part)).resize(self.size_px, Image.Resampling.BOX))


@dataclass(frozen=True, eq=False)
class FilmPictures:
    """The pictures that an avatar is made of, always those of a right hand: a left one's are mirrored.

    rgb_u8:  (F, H, W, 3) uint8 sRGB
    time_s:  (F,) when they were taken, from the film's beginning on; of photographs their numbers
    index:   (F,) which of the film's pictures that were looked at they are
    source:  name of the film
    digest:  SHA-256 of all their pixels
    is_film: else photographs, which have nothing to do with one another
    """

    rgb_u8: np.ndarray
    time_s: np.ndarray
    index: np.ndarray
    source: str
    digest: str
    is_film: bool

    def __len__(self) -> int:
        return len(self.rgb_u8)

    def save(self, path: Path) -> None:
        """As .npz."""
        with writing(path) as temporary:
            np.savez(temporary, **{**vars(self), "is_film": np.array(self.is_film)})

    @classmethod
    def load(cls, path: Path) -> FilmPictures:
        """What `save` wrote. InputError for a file that is none."""
        names = ("rgb_u8", "time_s", "index", "source", "digest", "is_film")
        arrays = read_arrays(path, names, str(path), max_bytes=_NPZ_BYTES_MAX)
        texts = {name: str(arrays[name]) for name in ("source", "digest")}
        return cls(**{**arrays, **texts, "is_film": bool(arrays["is_film"])})


def read_pictures(source: Source, index: np.ndarray, window: Window) -> FilmPictures:
    """The pictures with these rising numbers, as far as the window shows them."""
    wanted = set(index.tolist())
    kept = []
    for number, picture in enumerate(source.read()):
        if number in wanted:
            kept.append(window.cut(picture))
            if len(kept) == len(wanted):
                break
    if len(kept) < len(wanted):
        raise InputError(source.name, wanted=f"at least {int(index[-1]) + 1} pictures", came="fewer than before",
                         remedy="Leave the film alone while it is read.")  # fmt: skip
    rgb = np.stack(kept)
    digest = hashlib.sha256(rgb.tobytes()).hexdigest()
    return FilmPictures(rgb, index / source.fps, index, source.name, digest, source.is_film)
