"""Frames of a motion as numbered picture files."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jghand_engine.cli.console import progress
from jghand_engine.cli.picture_stamp import STAMP_KEY
from jghand_engine.errors import InputError
from jghand_engine.export.pictures import VIDEO_BACKGROUND, flatten, premultiplied, read_png, write_png
from jghand_engine.render.exposure import shutter_at

if TYPE_CHECKING:
    from jghand_engine.cli.picture_stamp import MadeFrom
    from jghand_engine.cli.receipts import Receipts
    from jghand_engine.cli.render_passes import PassWriter
    from jghand_engine.cli.timings import Timings
    from jghand_engine.render.camera import Camera
    from jghand_engine.render.frame import HandRenderer


@dataclass(frozen=True)
class Target:
    """Where pictures go. background: sRGB 0..1 that they are laid on, None keeps them transparent · name: pattern of
    the files, filled with the frame's number · first, step: numbers of the frames · text: of the progress bar ·
    shutter: the part of the time between frames that it is open."""

    folder: Path
    background: tuple[float, float, float] | None = None
    name: str = "frame_{:05d}.png"
    first: int = 0
    step: int = 1
    text: str = "Rendering"
    shutter: float = 0.0

    def path(self, index: int) -> Path:
        return self.folder / self.name.format(self.first + index * self.step)


@dataclass(frozen=True)
class Shooting:
    """Frames of a motion, (F, 21, 3) level-order joints, through one camera into files; passes beside them, and in
    their heads what they were made from, where these are given."""

    renderer: HandRenderer
    joints_m: np.ndarray
    camera: Camera
    target: Target
    timings: Timings
    receipts: Receipts | None = None
    passes: PassWriter | None = None
    made_from: MadeFrom | None = None

    def stamp(self, index: int) -> str:
        """What picture `index` says it was made from, '' for nothing."""
        return "" if self.made_from is None else self.made_from.stamp(index)

    def make(self, index: int) -> None:
        """Draws one frame and writes its files, the picture last: where it is, the others are."""
        path, background = self.target.path(index), self.target.background
        frame = self.renderer.render(
            self.joints_m[index], self.camera, shutter_at(self.joints_m, index, self.target.shutter)
        )
        self.timings.add(frame.report.as_dict())
        if self.receipts is not None:
            self.receipts.add(frame.report)
        stamp = self.stamp(index)
        texts = {STAMP_KEY: stamp} if stamp else {}
        if self.passes is not None:
            started = time.perf_counter()
            texts |= self.passes.add(index, frame, path, texts)
            self.timings.add_ms("passes", 1e3 * (time.perf_counter() - started))
        started = time.perf_counter()
        write_png(path, frame.rgba if background is None else flatten(frame.rgba, background), texts)
        self.timings.add_ms("writing the PNG", 1e3 * (time.perf_counter() - started))

    def make_all(self) -> None:
        """Draws all frames, one after the other."""
        with progress(self.target.text, len(self.joints_m)) as bar:
            for index in range(len(self.joints_m)):
                self.make(index)
                bar.advance(bar.task_ids[0])

    def shown(self) -> Iterator[np.ndarray]:
        """The pictures that lie there, as a video wants them: (H, W, 3) uint8, transparent ones on a background."""
        with progress("Writing the video", len(self.joints_m)) as bar:
            for index in range(len(self.joints_m)):
                yield flatten(premultiplied(read_png(self.target.path(index))), VIDEO_BACKGROUND)
                bar.advance(bar.task_ids[0])


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
