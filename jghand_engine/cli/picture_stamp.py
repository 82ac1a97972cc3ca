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
from jghand_engine.captures.pictures_in import picture_texts
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from jghand_engine.cli.inputs import Motion
    from jghand_engine.cli.options import MotionOptions
    from jghand_engine.render.settings import RenderSettings

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
    avatar_sha256: str, options: MotionOptions, motion: Motion, settings: RenderSettings, look: Mapping[str, Any],
    *, whole: bool,
) -> MadeFrom:  # fmt: skip
    """motion: what `options` mean. look: everything else that decides the pictures, as plain values, files as
    `file_digest`. whole: whether a picture depends on which other frames were chosen: the camera that frames them all,
    a shutter between two of them.

    InputError for a file that cannot be read.
    """
    frames, count = motion.frames, len(motion.sequence)
    first, step = frames.start, frames.step if count > 1 else 1
    # how many threads draw never shows
    drawn = {name: str(value) for name, value in settings.as_dict().items() if name != "threads"}
    parts = {
        "JGHand": __version__,
        "avatar": avatar_sha256[:_DIGITS],
        "motion": digest(_motion_facts(options, motion)),
        "settings": digest(drawn),
        "look": digest(dict(look)),
    }
    if whole:
        parts["choice of frames"] = digest([first, count, step])
    return MadeFrom(parts, first, step)


def _motion_facts(options: MotionOptions, motion: Motion) -> dict[str, Any]:
    """What decides the motion: options by their value, all files by their content. The name of the file that the user
    gave says nothing, but in some formats which hand it is; those of the others are how they are found."""
    facts = dataclasses.asdict(options)
    del facts["frames"]
    bones = options.format.bones
    given = None if options.motion is None else options.motion.resolve()
    files = [("" if file.resolve() == given else file.name, file_digest(file)) for file in motion.files]
    facts["motion"] = [motion.sequence.handedness, sorted(files)]
    facts["format"]["bones"] = None if bones is None else file_digest(bones)
    return facts


def digest(content: Any) -> str:
    """Of plain values; anything else counts as its text."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:_DIGITS]


def file_digest(path: Path) -> str:
    """Of a file's content. InputError when it cannot be read."""
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()[:_DIGITS]
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}", remedy="Check the name.") from error


def check_stamp(path: Path, stamp: str) -> bool:
    """Whether the picture `path` says what it was made from; False where it is missing or its head is broken.
    InputError when that is not what `stamp` says, or when somebody else made it."""
    try:
        found = picture_texts(path).get(STAMP_KEY)
    except InputError:
        return False
    refuse_other(path, found, stamp)
    return True


def refuse_other(path: Path, found: str | None, stamp: str) -> None:
    """InputError unless the stamp that was found in `path`, None for none, is the one that is wanted."""
    if found != stamp:
        raise InputError(
            f"{path}",
            wanted="what this very command made",
            came=_difference(found, stamp),
            remedy="Give all shards the same files and options, choose another --out, or remove what is there: a run "
            "without --shard and --skip-existing replaces it.",
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
