"""Frames of a motion as numbered PNG files, and what they are made from: each is renamed into place when whole."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jghand_engine import __version__
from jghand_engine.captures.image_files import probe_image
from jghand_engine.cli.console import progress
from jghand_engine.errors import InputError
from jghand_engine.export.frame_folder import Outcome, Shard
from jghand_engine.export.pictures import VIDEO_BACKGROUND, flatten, premultiplied, read_png, write_png
from jghand_engine.files import read_bytes
from jghand_engine.hand.sequence import HandPose
from jghand_engine.render.blur import shutter_at

if TYPE_CHECKING:
    from jghand_engine.cli.inputs import Motion
    from jghand_engine.cli.options import MotionOptions
    from jghand_engine.cli.timings import Receipts, Timings
    from jghand_engine.export.pass_writer import PassWriter
    from jghand_engine.render.camera import Camera
    from jghand_engine.render.renderer import HandRenderer
    from jghand_engine.render.settings import RenderSettings

# hexadecimal digits of a digest that are kept: 64 bits
_DIGITS = 16


@dataclass(frozen=True)
class FrameFiles:
    """Where the frames go.

    background:  sRGB 0..1 that frames are laid on; None keeps them transparent
    name:        pattern of the file names, filled with the number of the frame
    first, step: numbers of the frames
    text:        of the progress bar
    """

    folder: Path
    background: tuple[float, float, float] | None = None
    name: str = "frame_{:05d}.png"
    first: int = 0
    step: int = 1
    text: str = "Rendering"

    def path(self, index: int) -> Path:
        return self.folder / self.name.format(self.first + index * self.step)


@dataclass(frozen=True)
class FrameWriter:
    """Draws the frames of a motion through one camera into files, with passes beside them.

    hands: one for each frame, in the world
    shutter: part of the time between frames that it is open
    """

    renderer: HandRenderer
    hands: Sequence[HandPose]
    camera: Camera
    files: FrameFiles
    timings: Timings
    receipts: Receipts | None = None
    passes: PassWriter | None = None
    shutter: float = 0.0

    def write(self, index: int) -> None:
        """Draws one frame and writes its files, the picture last: where it is, the others are."""
        path, background, texts = self.files.path(index), self.files.background, {}
        moments = shutter_at(self.hands, index, self.shutter, self.camera)
        frame = self.renderer.render_moments(moments, [1.0] * len(moments))
        self.timings.add(frame.report.as_dict())
        if self.receipts is not None:
            self.receipts.add(frame.report)
        if self.passes is not None:
            started = time.perf_counter()
            texts = self.passes.add(index, frame, path)
            self.timings.add_ms("passes", 1e3 * (time.perf_counter() - started))
        started = time.perf_counter()
        rgba = frame.displayed()
        write_png(path, rgba if background is None else flatten(rgba, background), texts)
        self.timings.add_ms("writing the PNG", 1e3 * (time.perf_counter() - started))

    def write_all(self, shard: Shard | None = None) -> Outcome:
        """Draws the frames of a shard, or all, one after the other."""
        shard, outcome, total = shard or Shard(), Outcome(), len(self.hands)
        indices = shard.indices(total)
        with progress(self.files.text, len(indices)) as bar:
            for index in indices:
                there = shard.skip_existing and self.files.path(index).exists()
                if there and self._is_whole(index):
                    outcome.kept += 1
                else:
                    self.write(index)
                    outcome.made += 1
                    outcome.broken += there
                bar.advance()
        outcome.complete = all(self.files.path(index).exists() for index in range(total))
        return outcome

    def shown(self) -> Iterator[np.ndarray]:
        """The frames that lie there, as a video wants them: (H, W, 3) uint8, transparent ones on a background."""
        with progress("Writing the video", len(self.hands)) as bar:
            for index in range(len(self.hands)):
                yield flatten(premultiplied(read_png(self.files.path(index))), VIDEO_BACKGROUND)
                bar.advance()

    def _is_whole(self, index: int) -> bool:
        """Whether picture and maps are there, undamaged."""
        path = self.files.path(index)
        try:
            probe_image(path)
        except InputError:
            return False
        return self.passes is None or self.passes.is_whole(path)


def render_stamp(
    avatar_sha256: str, options: MotionOptions, motion: Motion, settings: RenderSettings, look: Mapping[str, Any],
    *, whole: bool,
) -> dict[str, str]:  # fmt: skip
    """Name -> digest of everything that decides the frames of a render. It is made of what the user gave (files by
    their content, options by their value), not of what was computed from it: machines whose arithmetic differs in the
    last bit agree on it.

    motion: what `options` mean
    look: all else that decides the frames, as plain values, files as `file_digest`
    whole: whether a frame depends on which others were chosen, as of a camera that frames them all
    InputError for a file that cannot be read.
    """
    # how many threads draw never shows
    drawn = {name: str(value) for name, value in settings.as_dict().items() if name != "threads"}
    frames, count = motion.frames, len(motion.sequence)
    chosen = [frames.start, count, frames.step if count > 1 else 1]
    return {
        "JGHand": __version__,
        "avatar": avatar_sha256[:_DIGITS],
        "motion": digest(_motion_facts(options, motion)),
        "settings": digest(drawn),
        "look": digest(dict(look)),
        **({"choice of frames": digest(chosen)} if whole else {}),
    }


def _motion_facts(options: MotionOptions, motion: Motion) -> dict[str, Any]:
    """What decides the motion: options by their value, all files by their content. The name of the file that the user
    gave says nothing, but in some formats which hand it is; those of the others are how they are found."""
    facts = dataclasses.asdict(options)
    del facts["frames"]
    given = None if options.motion is None else options.motion.resolve()
    files = [("" if file.resolve() == given else file.name, file_digest(file)) for file in motion.files]
    facts["motion"] = [motion.sequence.handedness, sorted(files)]
    return facts


def digest(content: Any) -> str:
    """Of plain values; anything else counts as its text."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:_DIGITS]


def file_digest(path: Path) -> str:
    """Of a file's content. InputError when it cannot be read."""
    return hashlib.sha256(read_bytes(path)).hexdigest()[:_DIGITS]
