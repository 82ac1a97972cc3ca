"""Frames of a motion as numbered PNG files, and how several processes share one folder of them.

A file is renamed into place when it is whole, and `made_from.json` says what all frames of a folder were made from: a
run that adds to the folder (--shard, --skip-existing) must be made from the same, and is refused otherwise.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jghand_engine import __version__
from jghand_engine.captures.image_files import probe_image
from jghand_engine.cli.console import progress, write_json
from jghand_engine.errors import InputError
from jghand_engine.export.pictures import VIDEO_BACKGROUND, flatten, premultiplied, read_png, write_png
from jghand_engine.files import file_error
from jghand_engine.render.blur import shutter_at

if TYPE_CHECKING:
    from jghand_engine.cli.inputs import Motion
    from jghand_engine.cli.options import MotionOptions
    from jghand_engine.cli.render_passes import PassWriter
    from jghand_engine.cli.timings import Receipts, Timings
    from jghand_engine.render.camera import Camera
    from jghand_engine.render.renderer import HandRenderer
    from jghand_engine.render.settings import RenderSettings

STAMP = "made_from.json"
# seconds in which another process has written the stamp that it has created
STAMP_WAIT_S = 0.5
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
class Shard:
    """Which frames a process makes.

    number, count: every `count`-th frame from the `number`-th on, counted from 1
    skip_existing: keep those that are there already
    """

    number: int = 1
    count: int = 1
    skip_existing: bool = False

    @property
    def is_shared(self) -> bool:
        """Whether frames that this process does not make belong into the same folder."""
        return self.skip_existing or self.count > 1

    def indices(self, total: int) -> range:
        """The frames of this shard, of `total`."""
        return range(self.number - 1, total, self.count)


@dataclass
class Outcome:
    """What became of a shard.

    made: drawn now
    kept: there already
    broken: of those that were drawn, how many were there, but damaged
    complete: whether all frames are there now, those of the other shards too
    """

    made: int = 0
    kept: int = 0
    broken: int = 0
    complete: bool = False

    def sentence(self) -> str:
        text = f"{self.made} drawn" + (f", {self.kept} there already" if self.kept else "")
        text += f", {self.broken} of the drawn ones were there, but broken" if self.broken else ""
        return text + ("." if self.complete else "; others are still missing.")


@dataclass(frozen=True)
class FrameWriter:
    """Draws the frames of a motion through one camera into files, with passes beside them.

    joints_m: (F, 21, 3) level order, world, meters
    shutter: part of the time between frames that it is open
    """

    renderer: HandRenderer
    joints_m: np.ndarray
    camera: Camera
    files: FrameFiles
    timings: Timings
    receipts: Receipts | None = None
    passes: PassWriter | None = None
    shutter: float = 0.0

    def write(self, index: int) -> None:
        """Draws one frame and writes its files, the picture last: where it is, the others are."""
        path, background, texts = self.files.path(index), self.files.background, {}
        frame = self.renderer.render(self.joints_m[index], self.camera, shutter_at(self.joints_m, index, self.shutter))
        self.timings.add(frame.report.as_dict())
        if self.receipts is not None:
            self.receipts.add(frame.report)
        if self.passes is not None:
            started = time.perf_counter()
            texts = self.passes.add(index, frame, path)
            self.timings.add_ms("passes", 1e3 * (time.perf_counter() - started))
        started = time.perf_counter()
        write_png(path, frame.rgba if background is None else flatten(frame.rgba, background), texts)
        self.timings.add_ms("writing the PNG", 1e3 * (time.perf_counter() - started))

    def write_all(self, shard: Shard | None = None) -> Outcome:
        """Draws the frames of a shard, or all, one after the other."""
        shard, outcome, total = shard or Shard(), Outcome(), len(self.joints_m)
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
                bar.advance(bar.task_ids[0])
        outcome.complete = all(self.files.path(index).exists() for index in range(total))
        return outcome

    def shown(self) -> Iterator[np.ndarray]:
        """The frames that lie there, as a video wants them: (H, W, 3) uint8, transparent ones on a background."""
        with progress("Writing the video", len(self.joints_m)) as bar:
            for index in range(len(self.joints_m)):
                yield flatten(premultiplied(read_png(self.files.path(index))), VIDEO_BACKGROUND)
                bar.advance(bar.task_ids[0])

    def _is_whole(self, index: int) -> bool:
        """Whether picture and maps are there, undamaged."""
        path = self.files.path(index)
        try:
            probe_image(path)
        except InputError:
            return False
        return self.passes is None or self.passes.is_whole(path)


def refuse_other_frames(folder: Path, frames: range) -> None:
    """InputError when the folder holds pictures of other frames than these: two motions might be mixed.

    They are not removed: nothing tells whether they are still wanted.
    """
    found = (re.fullmatch(r"frame_(\d{5,})\.png", path.name) for path in folder.glob("frame_*.png"))
    left = sorted(match[0] for match in found if match and int(match[1]) not in frames)
    if left:
        raise InputError(
            f"--out {folder}",
            wanted=f"a folder without pictures of other frames than {frames.start} to {frames[-1]}",
            came=f"{len(left)} of an earlier run ({left[0]} to {left[-1]})",
            remedy="Remove them or choose another folder; a motion is drawn in parts with --shard.",
        )


def settle_folder(folder: Path, made_from: Mapping[str, str], paths: Sequence[Path], shard: Shard) -> None:
    """Says in an existing folder what its frames `paths` are made from. InputError when a shared run finds frames of
    something else; a run that makes them all removes those first, so that none of them is ever kept."""
    stamp = folder / STAMP
    found = _read_stamp(stamp)
    old = [] if found == made_from else [path for path in paths if path.exists()]
    if shard.is_shared:
        if not old and found is None:
            found = _put_stamp(stamp, made_from)
        if found != made_from:
            names = [name for name in {**made_from, **(found or {})} if (found or {}).get(name) != made_from.get(name)]
            raise InputError(
                f"--out {folder}",
                wanted="frames that this very command made",
                came=f"frames of another {', '.join(names)}" if found else "frames of an unknown render",
                remedy="Give all shards the same files and options, or choose another --out; a run without --shard and "
                "--skip-existing replaces what is there.",
            )
        return
    for path in (*old, *folder.glob(".frame_*.png")):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise file_error(path, error) from error
    write_json(stamp, dict(made_from))


def _put_stamp(path: Path, made_from: Mapping[str, str]) -> Mapping[str, str] | None:
    """Writes the stamp unless another process does so at the same moment; gives what stands there then."""
    try:
        with path.open("x", encoding="utf-8") as stream:
            stream.write(json.dumps(made_from, indent=2) + "\n")
        return made_from
    except FileExistsError:
        # whoever made it may not have written it yet
        time.sleep(STAMP_WAIT_S)
        return _read_stamp(path)
    except OSError as error:
        raise file_error(path, error) from error


def _read_stamp(path: Path) -> dict[str, str] | None:
    """What a folder says; None where it says nothing, or nothing that can be read."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def made_from(
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
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()[:_DIGITS]
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}", remedy="Check the name.") from error
