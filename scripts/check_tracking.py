"""Measures `jghand track` against motions that are known, which are the tables of docs/TRACKING.md.

    python scripts/check_tracking.py                            videos rendered here, about five minutes
    python scripts/check_tracking.py --capture FOLDER           also single pictures whose joints are exact
    python scripts/check_tracking.py --exact                    the table of `jghand track --exact` alone, half an hour
    python scripts/check_tracking.py --films palm               only videos of these names
    python scripts/check_tracking.py --page docs/TRACKING.md    puts the tables into the page

Wants the extra `track` and the networks (`jghand track --fetch-model`). The rendered videos show the built-in avatar
with bones of other lengths than those it is tracked with, in known motion before a known camera; the detector looks at
the compressed video, as at any other. Everything that is printed is measured in this run.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from other_programs import put_into_page, table

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.sample import Sample, load_image
from jghand_engine.export.video import write_video
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import bone_lengths, hand_length
from jghand_engine.hand.poses import MotionOptions, named_pose, pose_sequence_of_names
from jghand_engine.hand.rotations import alignment, vector_rotation
from jghand_engine.hand.sequence import bone_directions, rebuilt
from jghand_engine.own.film import look, source_of
from jghand_engine.own.make import exact_track
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset
from jghand_engine.track.detection import SecondLook, SeenHand
from jghand_engine.track.hands_over_time import HandOverTime, hands_over_time
from jghand_engine.track.mediapipe_hands import MediaPipeHands, video_detector
from jghand_engine.track.poses import Pinhole
from jghand_engine.track.track import (
    FINGER_BONES,
    MOTION_FROM_CAMERA,
    Sightings,
    TrackOptions,
    angles_between_deg,
    camera_of,
    jitter_deg,
    track,
    track_hand,
)
from jghand_engine.track.video import open_video

FPS, SIZE_PX, ANGLE_DEG, DISTANCE_M = 30.0, (640, 480), 60.0, 0.45
# angle of view of the camera that sees hands at its border
WIDE_DEG = 90.0
POSES = ("open", "relaxed", "point", "victory", "open", "three", "pinch", "open", "claw", "fist", "relaxed", "spread")
# bones of the hand that is shown, relative to those of the hand that it is tracked with
OTHER_BONES_SIGMA, SEED = 0.08, 5
# how long the hand is for the picture's height, where it is looked for that is small
SMALL = (1 / 3, 1 / 5, 1 / 7, 1 / 9, 1 / 12)
# how far a lag is looked for, seconds, and in which steps
LAG_MAX_S, LAG_STEP_S = 0.25, 0.001
# the one-euro filter's usual setting for hands: least cut-off in Hz, how it grows with speed, cut-off of the speed
ONE_EURO = (1.0, 0.5, 1.0)


@dataclass(frozen=True)
class Truth:
    """A known motion. joints_m: (F, 21, 3) level order, before a camera at the origin: y up, z towards it · angle_deg:
    of view of that camera, across the picture"""

    name: str
    joints_m: np.ndarray
    handedness: Handedness
    angle_deg: float = ANGLE_DEG

    @property
    def pinhole(self) -> Pinhole:
        width, height = SIZE_PX
        return Pinhole(width / (2 * math.tan(math.radians(self.angle_deg) / 2)), width / 2, height / 2)


@dataclass(frozen=True)
class Row:
    """One line of the table. errors in degrees, of finger bones."""

    case: str
    method: str
    seen: str
    in_palm: tuple[float, float]
    in_space: tuple[float, float]
    jitter: float
    lag_ms: float

    def cells(self) -> list[str]:
        def number(value: float, digits: int) -> str:
            return "-" if not math.isfinite(value) else f"{value:.{digits}f}"

        return [
            self.case, self.method, self.seen, *(number(value, 1) for value in (*self.in_palm, *self.in_space)),
            number(self.jitter, 2), number(self.lag_ms, 0),
        ]  # fmt: skip


HEADER = (
    "what is shown",
    "method",
    "found",
    "palm median",
    "palm 95 %",
    "camera median",
    "camera 95 %",
    "jitter",
    "lag",
)


# ---- what is shown ---------------------------------------------------------------------------------------------------


def truths(canonical_m: np.ndarray) -> Iterator[Truth]:
    """Motions through named poses while the hand turns and moves."""
    random = np.random.default_rng(SEED)
    factors = np.exp(OTHER_BONES_SIGMA * random.standard_normal(20))
    other = rebuilt(np.zeros((1, 3)), bone_directions(canonical_m[None]), bone_lengths(canonical_m) * factors)[0]
    right, left = Handedness
    middle = (0.0, 0.0)
    for name, turn_deg, side, off_m, angle_deg in (
        ("palm", 0.0, right, middle, ANGLE_DEG),
        ("palm, left hand", 0.0, left, middle, ANGLE_DEG),
        ("from the thumb's side", -50.0, right, middle, ANGLE_DEG),
        ("back of the hand", 180.0, right, middle, ANGLE_DEG),
        ("palm, at the left border", 0.0, right, (-0.28, 0.0), WIDE_DEG),
        ("palm, at the right border", 0.0, right, (0.28, 0.0), WIDE_DEG),
        ("palm, in the upper left corner", 0.0, right, (-0.26, 0.15), WIDE_DEG),
    ):
        options = MotionOptions(fps=FPS, move_s=0.5, hold_s=0.2, variation_deg=2.0, seed=SEED)
        sequence = pose_sequence_of_names(POSES, other, handedness=Handedness.RIGHT, options=options)
        joints = sequence.joints_m - sequence.joints_m[:, :1]
        time = np.arange(len(joints)) / FPS
        sway = np.stack([0.25 * np.sin(1.1 * time), 0.3 * np.sin(0.7 * time), 0.25 * np.sin(0.9 * time)], -1)
        turn = vector_rotation(sway) @ vector_rotation(np.array([[0.0, math.radians(turn_deg), 0.0]]))
        joints = joints @ np.swapaxes(turn, -1, -2)
        place = np.stack([0.04 * np.sin(0.8 * time), -0.08 + 0.02 * np.sin(time), 0.03 * np.sin(0.5 * time)], -1)
        joints = joints + place[:, None] + (*off_m, -DISTANCE_M)
        mirror = (1, 1, 1) if side is Handedness.RIGHT else (-1, 1, 1)
        yield Truth(name, joints * mirror, side, angle_deg)


def film(truth: Truth) -> Iterator[np.ndarray]:
    """Pictures of the avatar in that motion, on a background that is not even."""
    width, height = SIZE_PX
    focal_px = truth.pinhole.focal_px
    world = np.diag([*MOTION_FROM_CAMERA, 1.0])
    camera = Camera(width, height, focal_px, focal_px, width / 2, height / 2, world)
    renderer = HandRenderer(load_builtin(handedness=truth.handedness), preset("viewport"))
    x, y = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
    random = np.random.default_rng(SEED)
    wall = 0.35 + 0.25 * x + 0.1 * y + 0.01 * random.standard_normal((height, width))
    background = np.clip(255 * wall[..., None] * (0.92, 0.97, 1.0), 0, 255)
    for joints in truth.joints_m:
        rgba = renderer.render(joints, camera).rgba
        flat = 255 * rgba[..., :3] + (1 - rgba[..., 3:]) * background
        yield np.clip(flat, 0, 255).astype(np.uint8)


# ---- what is measured ------------------------------------------------------------------------------------------------


def measured(case: str, method: str, joints_m: np.ndarray, truth_m: np.ndarray, seen: np.ndarray, fps: float) -> Row:
    """Errors over the frames in which the hand was found; jitter and lag over all of them."""
    canonical = load_builtin(handedness=Handedness.RIGHT).canonical_joints_m
    in_palm = [directions_in_palm(joints, canonical) for joints in (joints_m, truth_m)]
    in_space = [bone_directions(joints) for joints in (joints_m, truth_m)]
    whole = bool(seen.all())
    return Row(
        case, method, f"{seen.sum()} of {len(seen)}",
        _median_and_95(in_palm[0], in_palm[1], seen), _median_and_95(in_space[0], in_space[1], seen),
        jitter_deg(joints_m) if fps else math.nan,
        lag_ms(in_palm[0], in_palm[1], fps) if fps and whole else math.nan,
    )  # fmt: skip


def directions_in_palm(joints_m: np.ndarray, canonical_joints_m: np.ndarray) -> np.ndarray:
    """(F, 21, 3) level-order joints -> (F, 20, 3) directions of the bones, the palm turned onto a canonical one."""
    directions = bone_directions(joints_m)
    palm = bone_directions(canonical_joints_m[None])[:, :5]
    turn = alignment(directions[:, :5], np.broadcast_to(palm, (len(directions), 5, 3)))
    return directions @ np.swapaxes(turn, -1, -2)


def lag_ms(tracked: np.ndarray, truth: np.ndarray, fps: float) -> float:
    """How much later than the truth a motion is, milliseconds: the shift in time at which finger bones differ least.

    Both (F, 20, 3) directions in the palm. NaN for motions too short to shift.
    """
    count = len(truth)
    reach = min(LAG_MAX_S, (count - 3) / (2 * fps))
    if reach <= 0:
        return float("nan")
    time = np.arange(count) / fps
    inner = (time >= reach) & (time <= time[-1] - reach)
    wanted = truth[inner][:, FINGER_BONES]
    shifts = np.arange(-reach, reach, LAG_STEP_S)
    costs = []
    for shift in shifts:
        at = (time[inner] + shift) * fps
        before = np.clip(np.floor(at).astype(int), 0, count - 2)
        part = (at - before)[:, None, None]
        there = (1 - part) * tracked[before][:, FINGER_BONES] + part * tracked[before + 1][:, FINGER_BONES]
        costs.append(np.square(there - wanted).sum(-1).mean())
    return float(1000 * shifts[int(np.argmin(costs))])


def _median_and_95(came: np.ndarray, truth: np.ndarray, seen: np.ndarray) -> tuple[float, float]:
    error = angles_between_deg(came, truth)[seen][:, FINGER_BONES]
    return float(np.median(error)), float(np.percentile(error, 95))


def one_euro(directions: np.ndarray, fps: float) -> np.ndarray:
    """The usual filter of live tracking on (F, n, 3), for comparison (Casiez 2012)."""
    least, growth, speed_cutoff = ONE_EURO

    def share(cutoff_hz: np.ndarray | float) -> np.ndarray:
        return np.asarray(1 / (1 + fps / (2 * math.pi * np.asarray(cutoff_hz))))

    smooth, speed = [directions[0]], np.zeros_like(directions[0])
    for now in directions[1:]:
        speed = speed + share(speed_cutoff) * ((now - smooth[-1]) * fps - speed)
        part = share(least + growth * np.linalg.norm(speed, axis=-1, keepdims=True))
        smooth.append(smooth[-1] + part * (now - smooth[-1]))
    return np.stack(smooth)


def detector_alone(hand: HandOverTime) -> np.ndarray:
    """(F, 21, 3) what the detector says in space, y up; the last one where it says nothing."""
    last = next(one for one in hand.frames if one is not None)
    joints = []
    for one in hand.frames:
        last = last if one is None else one
        joints.append(last.space_m * MOTION_FROM_CAMERA)
    return np.stack(joints)


def rows_of_video(truth: Truth, canonical_m: np.ndarray, model: Path | None) -> Iterator[Row]:
    """All methods on one rendered video."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        write_video(path, film(truth), FPS)
        video = open_video(path)
        with video_detector(model) as detector:
            sightings = look(source_of(video), detector).sightings
    yield from rows_of_sightings(truth, sightings, canonical_m)


def rows_of_sightings(truth: Truth, sightings: Sightings, canonical_m: np.ndarray) -> Iterator[Row]:
    """Every method on what the detector saw."""
    exact = TrackOptions(camera_angle_deg=truth.angle_deg)
    found = track(sightings, canonical_m, exact)
    if truth.handedness not in found:
        yield Row(truth.name, "not found, or taken for the other hand", f"0 of {len(truth.joints_m)}",
                  (math.nan, math.nan), (math.nan, math.nan), math.nan, math.nan)  # fmt: skip
        return
    hand = found[truth.handedness]

    def row(method: str, joints_m: np.ndarray) -> Row:
        return measured(truth.name, method, joints_m, truth.joints_m, hand.seen, FPS)

    raw = detector_alone(hand.hand)
    yield row("the truth itself", truth.joints_m)
    yield row("detector alone", raw)
    slow = one_euro(bone_directions(raw), FPS)
    slow = slow / np.linalg.norm(slow, axis=-1, keepdims=True)
    yield row("detector, one-euro filter", rebuilt(np.zeros((len(raw), 3)), slow, bone_lengths(canonical_m)))
    variants = {
        "fit, no smoothing": replace(exact, smoothing=0.0),
        "**jghand track**": exact,
        "the same, angle of view taken for three quarters": replace(exact, camera_angle_deg=0.75 * truth.angle_deg),
    }
    for method, options in variants.items():
        yield row(method, track(sightings, canonical_m, options)[truth.handedness].sequence.joints_m)


def exact_rows(truth: Truth, canonical_m: np.ndarray, model: Path | None) -> Iterator[Row]:
    """The quick motion and the exact one of one rendered video."""
    options = TrackOptions(camera_angle_deg=truth.angle_deg)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        write_video(path, film(truth), FPS)
        source = source_of(open_video(path))
        with video_detector(model) as detector:
            looked = look(source, detector)
        hand = hands_over_time(looked.sightings.frames, source.fps).hands[truth.handedness]
        camera = camera_of(looked.sightings, truth.angle_deg)
        found = {
            "jghand track": track_hand(hand, camera, source.fps, canonical_m, options),
            "**jghand track --exact**": exact_track(source, looked, hand, canonical_m, options, lambda *_: None),
        }
    for method, one in found.items():
        yield measured(truth.name, method, one.sequence.joints_m, truth.joints_m, one.seen, FPS)


def rows_of_capture(folder: Path, canonical_m: np.ndarray, model: Path | None) -> Iterator[Row]:
    """Single pictures: each is looked at and fitted for itself."""
    samples = open_capture(folder).samples
    with MediaPipeHands(model, follows=False) as detector:
        # each picture for itself, as the first of a film
        found = [_largest(SecondLook(detector, detector).detect(_on_gray(sample), 0.0)) for sample in samples]
    right = [
        one is not None and one.handedness is sample.handedness for one, sample in zip(found, samples, strict=True)
    ]
    raw, fitted, truth = [], [], []
    for sample, one, good in zip(samples, found, right, strict=True):
        if one is None or not good:
            continue
        camera = sample.camera
        pinhole = Pinhole(camera.fx, camera.cx, camera.cy)
        hand = HandOverTime(sample.handedness, (one,), 1.0, 0)
        fitted.append(track_hand(hand, pinhole, FPS, canonical_m, TrackOptions(smoothing=0.0)).in_view[0])
        matrix = camera.camera_from_world
        truth.append(sample.joints_m @ matrix[:3, :3].T + matrix[:3, 3])
        raw.append(one.space_m)
    all_seen = np.ones(len(raw), dtype=bool)
    name = f"{len(samples)} single pictures of a capture, {sum(one is not None for one in found)} found"
    for method, joints in (("detector alone", raw), ("**jghand track**, each picture alone", fitted)):
        row = measured(name, method, np.stack(joints), np.stack(truth), all_seen, 0.0)
        yield replace(row, seen=f"{len(raw)} of {len(samples)}, as the right hand")


def _on_gray(sample: Sample) -> np.ndarray:
    picture = load_image(sample)
    flat = picture.rgb + 0.5 * (1 - picture.mask[..., None])
    return np.clip(255 * flat, 0, 255).astype(np.uint8)


def _largest(hands: Sequence[SeenHand]) -> SeenHand | None:
    return max(hands, key=lambda hand: hand.size_px, default=None)


def small_hands(canonical_m: np.ndarray, model: Path | None) -> Iterator[list[str]]:
    """In how many pictures of small hands, one of each pose, they are found: by one look, and with the second one."""
    names = sorted(set(POSES))
    pinhole = Truth("", np.zeros((0, 21, 3)), Handedness.RIGHT).pinhole
    with MediaPipeHands(model, follows=False) as detector:
        for share in SMALL:
            distance = pinhole.focal_px * hand_length(canonical_m) / (share * SIZE_PX[1])
            joints = np.stack([named_pose(name, canonical_m, handedness=Handedness.RIGHT) for name in names])
            joints = joints - joints.mean(1, keepdims=True) - (0.0, 0.0, distance)
            once = twice = 0
            for picture in film(Truth("", joints, Handedness.RIGHT)):
                once += bool(detector.detect(picture, 0.0))
                twice += bool(SecondLook(detector, detector).detect(picture, 0.0))
            yield [f"1/{1 / share:.0f}", f"{once} of {len(names)}", f"{twice} of {len(names)}"]


# ---- the table -------------------------------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--capture", type=Path)
    parser.add_argument("--exact", action="store_true", help="only the table of `jghand track --exact`")
    parser.add_argument("--films", nargs="+", metavar="NAME", help="only these videos, and no table of small hands")
    parser.add_argument("--model", type=Path)
    parser.add_argument("--page", type=Path, help="write the tables into this page, between its marks")
    options = parser.parse_args()
    canonical = load_builtin(handedness=Handedness.RIGHT).canonical_joints_m
    rows_of, marks = (
        (exact_rows, "check_tracking.py --exact") if options.exact else (rows_of_video, "check_tracking.py")
    )
    # the exact motion is no other at the border
    shown = [truth for truth in truths(canonical) if not (options.exact and truth.angle_deg == WIDE_DEG)]
    names = [truth.name for truth in shown]
    if unknown := set(options.films or ()) - set(names):
        parser.error(f"--films: wanted names among {'; '.join(names)}; got {'; '.join(sorted(unknown))}")
    sources: list[Callable[[], Iterator[Row]]] = [
        lambda truth=truth: rows_of(truth, canonical, options.model)
        for truth in shown
        if truth.name in (options.films or names)
    ]
    if options.capture:
        sources.append(lambda: rows_of_capture(options.capture, canonical, options.model))
    rows = []
    for source in sources:
        for row in source():
            rows.append(row.cells())
            print(" | ".join(rows[-1]), flush=True)
    tables = [table(HEADER, rows, words=2)]
    if not (options.exact or options.films):
        small = list(small_hands(canonical, options.model))
        heads = ["hand's length, of the picture's height", "found by one look", "with the second look"]
        tables.append(table(heads, small))
    text = "\n\n".join(tables)
    print(f"\n{text}")
    if options.page:
        put_into_page(options.page, marks, text)


if __name__ == "__main__":
    main()
