"""What a picture of `jghand render` was made from, in its own head: so that a run goes on among its own pictures only.

The stamp is made of what the user gave (files by their content, options by their value), not of what was computed from
it: machines whose arithmetic differs in the last bit agree on it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jghand_engine import __version__
from jghand_engine.datasets.pictures_in import picture_texts
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from jghand_engine.cli.options import MotionOptions
    from jghand_engine.splat.settings import RenderSettings

STAMP_KEY = "jghand-made-from"
_DIGITS = 16


@dataclass(frozen=True)
class MadeFrom:
    """What all pictures of a render share. parts: name -> digest · first, step: which frames of the motion they are."""

    parts: Mapping[str, str]
    first: int
    step: int

    def stamp(self, index: int) -> str:
        """Of picture `index`, JSON."""
        return json.dumps({**self.parts, "frame": self.first + index * self.step})


def made_from(
    avatar_sha256: str, motion: MotionOptions, settings: RenderSettings, look: Mapping[str, Any], *, whole: bool
) -> MadeFrom:
    """look: everything else that decides the pictures, as plain values, files as `file_digest`. whole: whether a
    picture depends on which other frames were chosen: the camera that frames them all, a shutter between two of them.

    InputError for a motion that cannot be read.
    """
    part = motion.frame_slice()
    # how many threads draw never shows
    drawn = {name: str(value) for name, value in settings.as_dict().items() if name != "threads"}
    parts = {
        "JGHand": __version__,
        "avatar": avatar_sha256[:_DIGITS],
        "motion": digest(_motion_facts(motion)),
        "settings": digest(drawn),
        "look": digest(dict(look)),
    }
    if whole:
        parts["choice of frames"] = digest([part.start, part.stop, part.step])
    return MadeFrom(parts, part.start or 0, part.step or 1)


def _motion_facts(motion: MotionOptions) -> dict[str, Any]:
    facts = dataclasses.asdict(motion)
    del facts["frames"]
    facts["motion"] = None if motion.motion is None else file_digest(motion.motion)
    return facts


def digest(content: Any) -> str:
    """Of plain values; anything else counts as its text."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:_DIGITS]


def file_digest(path: Path) -> str:
    """Of a file's content, or of all files of a folder. InputError when it cannot be read."""
    if path.is_dir():
        return digest({file.name: file_digest(file) for file in path.iterdir() if file.is_file()})
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()[:_DIGITS]
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}", remedy="Check the name.") from error


def refuse_foreign(path: Path, stamp: str) -> None:
    """InputError when `path` is a picture that was made from something else than `stamp` says, or by somebody else.

    One that is missing or whose head is broken passes: nothing is lost with it.
    """
    try:
        found = picture_texts(path).get(STAMP_KEY)
    except InputError:
        return
    refuse_other(path, found, stamp)


def is_made_from(path: Path, stamp: str) -> bool:
    """Whether `path` is a picture that says it was made from what `stamp` says."""
    try:
        return picture_texts(path).get(STAMP_KEY) == stamp
    except InputError:
        return False


def refuse_other(path: Path, found: str | None, stamp: str) -> None:
    """InputError unless the stamp that was found in `path`, None for none, is the one that is wanted."""
    if found != stamp:
        raise InputError(
            f"--skip-existing: {path}",
            wanted="what this very command made",
            came=_difference(found, stamp),
            remedy="Leave out --skip-existing to replace what is there, or choose another --out.",
        )


def _difference(found: str | None, stamp: str) -> str:
    if found is None:
        return "what does not say how it was made"
    try:
        before = dict(json.loads(found))
    except (TypeError, ValueError):
        return "what cannot say how it was made"
    other = [name for name, value in json.loads(stamp).items() if before.pop(name, None) != value]
    return "what is of another " + ", ".join([*other, *before])
