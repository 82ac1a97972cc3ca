"""`jghand own`: an avatar of the user's own hand, from a film or a few photographs."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jghand_engine.cli.console import say, stages, write_figures
from jghand_engine.cli.options import FiguresFile, HandName, check_places
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from jghand_engine.own.checks import Finding
    from jghand_engine.own.make import Begun, OwnOptions

DESCRIPTION = """Make an avatar of your own hand, from one film of a telephone or 3 to 10 photographs.

How to film: lay the telephone down or lean it on something, so that it does not move, 30 to 60 cm away; the hand fills
half of the picture, with the wrist and some bare forearm, without ring and watch. Light from the front or the side, a
wall of another color than the skin, nothing else that moves. Hold exposure and focus (a long press on the picture);
1080p at 30 per second, no beauty or night mode, no flash. Film 12 to 20 seconds, slowly: the flat hand, fingers apart,
palm to the camera, two seconds; a fist, and open; turn the hand over the thumb's side in three seconds; the flat back,
two seconds; a fist, and open; finger tips to the camera and away; turn back. Photographs: the flat palm, the flat back,
the thumb's side, a fist from both sides. docs/OWN_HAND.md says why.

Needs the extra track (pip install 'jghand[track]', with the pip beside this program) and, once, --fetch-model.
Nothing leaves this machine.

Examples:
  jghand own hand.mp4 --check                        says in words what is wrong with the film
  jghand own hand.mp4 --out me.jghand --fetch-model
  jghand own palm.jpg back.jpg side.jpg fist.jpg --out me.jghand --hand-length 187
  jghand render --poses open,fist,point --avatar me.jghand --out pictures"""


@dataclass(frozen=True)
class Own:
    pictures: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILM|PHOTOGRAPH…", help_behavior_hint="")
    ]
    """A film that ffmpeg can read, or 3 to 10 photographs."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE.jghand", help_behavior_hint="")] = None
    """The avatar. What is found on the way is kept beside it, in a folder that ends in .own."""
    check: bool = False
    """Only look at the film, and say what is wrong with it; nothing is written."""
    hand: Annotated[HandName | None, tyro.conf.arg(help_behavior_hint="")] = None
    """Which hand is meant. Left out: the one that is seen."""
    hand_length: Annotated[float | None, tyro.conf.arg(metavar="MM", help_behavior_hint="")] = None
    """Length of the hand in millimeters, wrist to tip of the straight middle finger. Left out: the built-in hand's, as
    one camera cannot tell a small hand from a far one."""
    camera_angle: Annotated[float | None, tyro.conf.arg(metavar="DEGREES", help_behavior_hint="")] = None
    """Angle of view across the longer edge of the picture. Left out: what the file says, else a telephone's."""
    minutes: Annotated[float, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="")] = 0.0
    """Let the fit by pictures go on for so long: colors are found anew, and poses by them, again and again. Left out,
    or where it is too short: five times, with --motion ten."""
    motion: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Also write the motion of the hand in the film, as exact as `jghand track --exact`: .npz, .json or .csv."""
    resume: bool = False
    """Go on with a film that was stopped, after the last stage, or round of colors, that ended."""
    overwrite: bool = False
    """Replace --out and --motion if they are there."""
    fetch_model: bool = False
    """Fetch the networks that find a hand, as `jghand track` does."""
    json: FiguresFile = None

    def run(self) -> None:
        from jghand_engine.hand.joints import Handedness
        from jghand_engine.own.make import OwnOptions
        from jghand_engine.track.mediapipe_hands import check_package, fetch_model

        if self.check == (self.out is not None):
            came = "both" if self.check else "none"
            raise InputError("jghand own", wanted="either --out FILE.jghand or --check", came=came)
        options = OwnOptions(
            None if self.hand is None else Handedness(self.hand),
            None if self.hand_length is None else 1e-3 * self.hand_length,
            self.camera_angle,
            60 * self.minutes,
            self.motion is not None,
        )
        options.check()
        self._check_words()
        if self.fetch_model:
            check_package()
            say(f"The networks that find a hand: {fetch_model()}")
        if self.out is None:
            self._look(options)
        else:
            self._make(self.out, options)

    def _check_words(self) -> None:
        """InputError for options that mean nothing, and files that cannot be written."""
        from jghand_engine.motion.files import check_written_suffix

        meant = {"--motion": self.motion, "--minutes": self.minutes, "--resume": self.resume,
                 "--overwrite": self.overwrite}  # fmt: skip
        idle = [name for name, value in meant.items() if value]
        if self.check and idle:
            raise InputError("--check", wanted=f"no {idle[0]}", came="both", remedy="It looks, and makes nothing.")
        if self.out is not None and self.out.suffix != ".jghand":
            raise InputError("--out", wanted="a file that ends with .jghand", came=str(self.out))
        if self.motion is not None:
            check_written_suffix(self.motion)
        named = (("--out", self.out), ("--motion", self.motion), ("--json", self.json))
        written = [(name, path) for name, path in named if path is not None]
        check_places(written, self.pictures, overwrite=self.overwrite)

    def _look(self, options: OwnOptions) -> None:
        """What is wrong with the film, in words."""
        from jghand_engine.avatar.builtin import load_builtin
        from jghand_engine.hand.joints import Handedness
        from jghand_engine.own.film import open_source
        from jghand_engine.own.make import begin
        from jghand_engine.track.mediapipe_hands import video_detector

        source = open_source(self.pictures)
        with stages() as told:
            begun = begin(source, load_builtin(handedness=Handedness.RIGHT), options, video_detector, told)
        refused = self._looked_at(begun)
        if not begun.findings:
            say("Nothing is wrong with it.")
        elif not refused:
            say("An avatar can be made of it.")
        if refused:
            raise InputError(source.name, wanted="a film of which an avatar can be made", came="the above")

    def _make(self, out: Path, options: OwnOptions) -> None:
        from jghand_engine.avatar.builtin import load_builtin
        from jghand_engine.avatar.file import save_avatar
        from jghand_engine.hand.joints import Handedness
        from jghand_engine.motion.files import write_motion
        from jghand_engine.own.film import open_source
        from jghand_engine.own.make import check_has_motion, explain, hand_of, motion_of, work_folder
        from jghand_engine.track.mediapipe_hands import video_detector

        # what is no film is refused before a folder of work is made
        open_source(self.pictures)
        if self.motion is not None:
            check_has_motion(self.pictures)
        work, prior, started = out.with_suffix(".own"), load_builtin(handedness=Handedness.RIGHT), time.perf_counter()
        with work_folder(work, self.pictures, options, resume=self.resume), stages() as told:
            explained = explain(self.pictures, prior, options, work, video_detector, told, self._looked_at)
            avatar, judged = hand_of(explained, prior, work, told)
            save_avatar(out, avatar)
            if self.motion is not None:
                write_motion(self.motion, motion_of(self.pictures, explained, prior, told))
        self._tell(judged)
        side, learned_from = explained.begun.start.handedness, avatar.info.learned_from
        assert learned_from is not None
        count = learned_from.pictures
        say(f"{out}: a {side} hand, from {count} pictures, in {time.perf_counter() - started:.0f} s.")
        if self.motion is not None:
            say(f"{self.motion}: its motion. jghand render --motion {self.motion} --avatar {out} --out pictures")
        say(f"Film and avatar side by side: {work / 'sheet.png'}")
        say(f"See it: jghand render --poses open,fist,point --hand {side} --avatar {out} --out pictures")
        write_figures(self.json, {
            "command": "own", "pictures": [str(path) for path in self.pictures], "check": False, "out": str(out),
            "work": str(work), "hand": side, "pictures_used": count,
            "motion": None if self.motion is None else str(self.motion),
            "findings": [asdict(finding) for finding in (*explained.begun.findings, *judged)],
        })  # fmt: skip

    def _looked_at(self, begun: Begun) -> bool:
        """Tells what is wrong with the film before the work, and whether it is refused: these are all its figures then,
        as they are of --check."""
        self._tell(begun.findings)
        refused = any(finding.refuses for finding in begun.findings)
        if self.check or refused:
            write_figures(self.json, {
                "command": "own", "pictures": [str(path) for path in self.pictures], "check": self.check,
                "refused": refused, "hand": begun.start.handedness,
                "findings": [asdict(finding) for finding in begun.findings],
            })  # fmt: skip
        return refused

    def _tell(self, findings: list[Finding]) -> None:
        for finding in findings:
            say(f"{finding.check}: {finding.sentence}")
