"""`jghand track`: a video of hands becomes motion files."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jghand_engine.cli.console import progress, say, stages, write_figures
from jghand_engine.cli.options import AvatarOptions, FiguresFile, File, check_places
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.json_files import write_json
from jghand_engine.track import CAMERA_ANGLE_DEG
from jghand_engine.track.hands_over_time import HAND_SEEN_FRAMES_MIN

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import numpy as np

    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.own.film import Looked
    from jghand_engine.track.hands_over_time import FoundHands, HandOverTime
    from jghand_engine.track.track import Sightings, TrackedHand, TrackOptions
    from jghand_engine.track.video import Video

# below this certainty, 0..1, of which hand it is, that is told
HAND_CERTAINTY_LOW = 0.3

DESCRIPTION = """Track the hands in a video: a motion file that `jghand render --motion` plays.

Needs the extra track (pip install 'jghand[track]', with the pip beside this program) and, once, --fetch-model.
Nothing leaves this machine.

Examples:
  jghand track hand.mp4 --out motion.npz --fetch-model --proof side_by_side.mp4
  jghand track both_hands.mp4 --out motion.npz          writes motion_right.npz and motion_left.npz
  jghand track hand.mp4 --out motion.npz --hand right --hand-length 190
  jghand track hand.mp4 --out motion.npz --exact          minutes instead of seconds, and fingers are nearer
  jghand render --motion motion.npz --out pictures --video hand_again.mp4
  jghand track hand.mp4 --out motion.npz --film-camera camera.json
  jghand render --motion motion.npz --camera camera.json --out pictures          seen as in the film"""


@dataclass(frozen=True)
class FitOptions:
    """How the motion is made of what was seen."""

    exact: bool = False
    """Fit a hand to outlines and colors, too: bones and thickness to the best pictures, then the pose in each. One hand
    in at most 900 pictures."""
    hand_length: Annotated[float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="")] = None
    """Length of the true hand in millimeters, wrist to tip of the straight middle finger. Left out: the avatar's, as
    one camera cannot tell a small hand from a far one."""
    bones: Literal["avatar", "own"] = "avatar"
    """Bones of the avatar, or those of the hand in the video, estimated."""
    smoothing: Annotated[float, tyro.conf.arg(metavar="NUMBER")] = 1.0
    """More is smoother, less is livelier, 0 takes every frame alone. It never lags: it looks ahead as far as back."""
    camera_angle: Annotated[float, tyro.conf.arg(metavar="DEGREES")] = CAMERA_ANGLE_DEG
    """Angle of view across the longer edge of the picture; 60 to 70 of most telephones and webcams."""
    up: Literal["y", "z"] = "y"
    """Which axis points up in the motion."""
    gaps: Literal["fill", "leave"] = "fill"
    """Frames in which the hand was not seen: fill them in from both sides, and mark them; or leave their joints
    missing."""


@dataclass(frozen=True)
class Track:
    video: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="VIDEO")]
    """A film that ffmpeg can read: MP4, MOV, MKV, WebM, AVI and so on."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """The motion: .npz, .json or .csv. Of two hands _right and _left are added to the name."""
    hand: Literal["auto", "right", "left", "both"] = "auto"
    """Which hand is wanted. auto: every hand that is there."""
    proof: File = None
    """Also write a video of the input and the avatar side by side (.mp4)."""
    film_camera: File = None
    """Also write the camera of the film (.json). `jghand render --camera` shows the hand from there, as the film
    did; from other sides one sees how deep the detector took it to be."""
    fps: Annotated[float | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="")] = None
    """Frames per second of the motion. Left out: the video's own, made even if they are not."""
    most: Annotated[int | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: all)")] = None
    """Only so many frames from the start."""
    overwrite: bool = False
    """Replace motions, a proof and a camera that are there."""
    fetch_model: bool = False
    """Fetch the networks that find a hand with pip if they are not here yet (35 MB, once, MediaPipe's, Apache-2.0)."""
    fit: FitOptions = field(default_factory=FitOptions)
    avatar: AvatarOptions = field(default_factory=AvatarOptions)
    json: FiguresFile = None

    def run(self) -> None:
        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.motion.files import write_motion
        from jghand_engine.motion.tools import turned_up
        from jghand_engine.track.hands_over_time import hands_over_time
        from jghand_engine.track.track import track
        from jghand_engine.track.video import open_video

        options = self._checked()
        video = open_video(self.video, self.fps, most=self.most)
        avatar = load_avatar_called(self.avatar.avatar)
        if self.fit.exact:
            self._warn_of_length(video)
        notes: list[str] = []
        if video.uneven:
            notes.append(
                f"The times between the pictures of {self.video} vary: they were brought to an even rate of "
                f"{video.fps:g} per second."
            )
        started = time.perf_counter()
        looked = self._look(video, notes)
        sightings = looked.sightings
        seconds_looking = time.perf_counter() - started
        found = hands_over_time(sightings.frames, sightings.fps)
        wanted = self._wanted(found)
        if self.fit.exact:
            hands = self._exactly(video, looked, wanted, avatar, options)
        else:
            hands = track(sightings, avatar.rest_joints_m, options, wanted)
        notes += [
            f"{_doubt(side, hand)}, and taken for a mistake."
            for side, hand in found.doubted.items()
            if hand.seen.sum() >= HAND_SEEN_FRAMES_MIN
        ]
        seconds_fitting = time.perf_counter() - started - seconds_looking
        files = {side: self._file(side, len(hands)) for side in hands}
        for side, hand in hands.items():
            write_motion(files[side], turned_up(hand.sequence, "y", self.fit.up))
        if self.film_camera is not None:
            write_json(self.film_camera, self._film_camera(sightings, options))
        if self.proof is not None:
            self._write_proof(video, sightings, hands, avatar, options)
        for sentence in notes:
            say(sentence)
        for side, hand in hands.items():
            say(_sentence(side, hand, files[side]))
        others = " and ".join(str(path) for path in (self.proof, self.film_camera) if path)
        say(f"Done in {time.perf_counter() - started:.1f} s" + (f": {others}" if others else "."))
        write_figures(self.json, {
            "command": "track", "video": str(self.video), "fps": video.fps, "frames": len(sightings.frames),
            "size_px": [video.width, video.height], "notes": notes,
            "seconds_looking": seconds_looking, "seconds_fitting": seconds_fitting,
            "hands": [_figures(side, hand, files[side]) for side, hand in hands.items()],
            "film_camera": None if self.film_camera is None else str(self.film_camera),
        })  # fmt: skip

    def _checked(self) -> TrackOptions:
        """The options of the fit. InputError for what can be refused before the work, their places included."""
        from jghand_engine.export.video import check_video_name, ffmpeg_program
        from jghand_engine.motion.files import check_written_suffix
        from jghand_engine.track.track import TrackOptions

        check_written_suffix(self.out)
        if self.proof is not None:
            check_video_name("--proof", self.proof)
        if self.most is not None and self.most < 1:
            raise InputError("--most", wanted="1 or more", came=str(self.most))
        if self.film_camera is not None and self.film_camera.suffix.lower() != ".json":
            raise InputError("--film-camera", wanted="a name that ends in .json", came=self.film_camera.name)
        ffmpeg_program()
        fit = self.fit
        options = TrackOptions(
            None if fit.hand_length is None else 1e-3 * fit.hand_length,
            fit.bones == "own",
            fit.smoothing,
            fit.camera_angle,
            fit.gaps == "fill",
        )
        options.check()
        if fit.exact and self.hand == "both":
            raise _exact_of_both()
        if fit.exact and fit.smoothing != 1:
            raise InputError("--smoothing", wanted="none with --exact, which has its own", came=f"{fit.smoothing:g}")
        self._check_places()
        return options

    def _check_places(self) -> None:
        """InputError where a motion, a proof or a camera is there, or the film itself would be written over."""
        sides = {"right": 1, "left": 1, "both": 2}
        counts = (sides[self.hand],) if self.hand in sides else (1, 2)
        motions = dict.fromkeys(self._file(side, count) for count in counts for side in Handedness)
        written = [("--out", path) for path in motions]
        written += [("--proof", self.proof)] if self.proof is not None else []
        written += [("--film-camera", self.film_camera)] if self.film_camera is not None else []
        written += [("--json", self.json)] if self.json is not None else []
        check_places(written, (self.video,), overwrite=self.overwrite)

    def _warn_of_length(self, video: Video) -> None:
        """Says before the work where it may come to nothing: pictures without the hand do not count."""
        from jghand_engine.own.exact import PICTURES_MAX

        count = min(self.most or sys.maxsize, video.frames or 0)
        if count > PICTURES_MAX:
            say(f"--exact takes {PICTURES_MAX} pictures of the hand at most, and the film has {count}: where it shows "
                "more of them, that is refused once all were looked at. --most or --fps take fewer.")  # fmt: skip

    def _look(self, video: Video, notes: list[str]) -> Looked:
        from jghand_engine.own.film import look, source_of
        from jghand_engine.track.mediapipe_hands import check_package, fetch_model, video_detector

        if self.fetch_model:
            check_package()
            say(f"The networks that find a hand: {fetch_model()}")
        total = video.frames if self.most is None else min(self.most, video.frames or self.most)
        with video_detector() as detector, progress("Looking for hands", total or 1) as bar:
            return look(
                source_of(video),
                detector,
                lambda done: bar.reach(done, max(done, total or 0)),
                notes,
                most=self.most,
            )

    def _exactly(
        self,
        video: Video,
        looked: Looked,
        wanted: dict[Handedness, HandOverTime],
        avatar: HandAvatar,
        options: TrackOptions,
    ) -> dict[Handedness, TrackedHand]:
        """What --exact makes of the one hand that is wanted."""
        from jghand_engine.own.film import source_of
        from jghand_engine.own.make import exact_track

        if len(wanted) > 1:
            raise _exact_of_both()
        ((side, hand),) = wanted.items()
        with stages() as told:
            return {side: exact_track(source_of(video), looked, hand, avatar.rest_joints_m, options, told)}

    def _wanted(self, found: FoundHands) -> dict[Handedness, HandOverTime]:
        """The hands of the film that are asked for; InputError says what there is instead."""
        doubts = [_doubt(side, hand) for side, hand in found.doubted.items()]
        few = f" ({'; '.join(doubts)}: too few to believe it)" if doubts else ""
        thing, hands = f"video {self.video}", found.hands
        if not hands:
            raise InputError(
                thing, wanted="a hand", came=f"none{few}" if few else "none in any picture",
                remedy="The hand should be large, well lit and not cut off by the edge.",
            )  # fmt: skip
        alone = f"the {next(iter(hands))} one alone{few}"
        if self.hand == "auto":
            return hands
        if self.hand == "both":
            if len(hands) < 2:
                raise InputError(thing, wanted="both hands", came=alone)
            return hands
        if self.hand not in hands:
            raise InputError(thing, wanted=f"a {self.hand} hand", came=alone,
                             remedy="A film of a mirror shows the other hand: name the side that is seen.")  # fmt: skip
        return {side: hand for side, hand in hands.items() if side == self.hand}

    def _file(self, side: Handedness, count: int) -> Path:
        return self.out if count == 1 else self.out.with_name(f"{self.out.stem}_{side}{self.out.suffix}")

    def _film_camera(self, sightings: Sightings, options: TrackOptions) -> dict[str, Any]:
        """The camera before which the motion is what the film shows."""
        import numpy as np

        from jghand_engine.export.camera_file import camera_to_dict
        from jghand_engine.motion.tools import up_rotation
        from jghand_engine.render.camera import Camera
        from jghand_engine.track.track import MOTION_FROM_CAMERA, camera_of

        pinhole, (height, width) = camera_of(sightings, options.camera_angle_deg), sightings.size_px
        camera_from_world = np.eye(4)
        camera_from_world[:3, :3] = MOTION_FROM_CAMERA[:, None] * up_rotation(self.fit.up, "y")
        focal = pinhole.focal_px
        return camera_to_dict(Camera(width, height, focal, focal, pinhole.cx, pinhole.cy, camera_from_world))

    def _write_proof(
        self,
        video: Video,
        sightings: Sightings,
        hands: Mapping[Handedness, TrackedHand],
        avatar: HandAvatar,
        options: TrackOptions,
    ) -> None:
        from jghand_engine.avatar.forearm import ended
        from jghand_engine.export.video import write_video
        from jghand_engine.track.proof import side_by_side
        from jghand_engine.track.track import camera_of
        from jghand_engine.track.video import read_frames

        assert self.proof is not None
        count = len(sightings.frames)
        pinhole = camera_of(sightings, options.camera_angle_deg)
        frames = side_by_side(read_frames(video, most=count), hands, pinhole, ended(avatar))
        with progress("Writing the proof", count) as bar:

            def told() -> Iterator[np.ndarray]:
                for frame in frames:
                    yield frame
                    bar.advance()

            write_video(self.proof, told(), video.fps)


def _exact_of_both() -> InputError:
    return InputError("--exact", wanted="one hand", came="both", remedy="Say --hand right or --hand left.")


def _doubt(side: Handedness, hand: HandOverTime) -> str:
    return f"A {side} hand was seen in {hand.seen.sum()} of {len(hand.seen)} pictures"


def _sentence(side: Handedness, hand: TrackedHand, file: Path) -> str:
    found, count = int(hand.seen.sum()), len(hand.seen)
    missed = hand.sequence.filled.sum()
    text = f"{side} hand: seen in {found} of {count} frames"
    if missed:
        text += f", {missed} filled and marked"
    elif found < count:
        text += f", {count - found} left without joints"
    if hand.hand.relabeled:
        text += f"; in {hand.hand.relabeled} it was taken for the other hand"
    if hand.hand.certainty < HAND_CERTAINTY_LOW:
        text += f"; that it is the {side} one is not sure (certainty {hand.hand.certainty:.2f} of 1)"
    if hand.jitter_after_deg == hand.jitter_after_deg:
        text += f"; jitter {hand.jitter_before_deg:.2f} to {hand.jitter_after_deg:.2f} degrees"
    return f"{text}: {file}"


def _figures(side: Handedness, hand: TrackedHand, file: Path) -> dict[str, Any]:
    def number(value: float) -> float | None:
        return None if value != value else value

    return {
        "hand": str(side), "file": str(file), "frames_seen": int(hand.seen.sum()),
        "frames_filled": int(hand.sequence.filled.sum()), "frames_relabeled": hand.hand.relabeled,
        "certainty": hand.hand.certainty, "jitter_before_deg": number(hand.jitter_before_deg),
        "jitter_after_deg": number(hand.jitter_after_deg),
    }  # fmt: skip
