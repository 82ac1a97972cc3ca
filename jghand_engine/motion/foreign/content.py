"""What every reader of a motion file gives: joints of the hands in it, as the file has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.motion.foreign.clocks import UNITS


@dataclass(frozen=True)
class HandTrack:
    """One hand of a file over time.

    joints:     (F, n, 3) in the file's unit and axes, NaN where missing; n as `order` has it
    handedness: which hand it is, None where the file does not say
    order:      of the joints, None where the file does not say
    part:       what to call it where a file holds several hands: a skeleton, a person, a capture; may be ""
    labeled:   the side is the label of a detector, which a mirrored picture or an older package turns round: what the
                user says counts more. A side that stands in names of bones is no label
    notes:      sentences about this hand
    times:      of its frames, where they are not those of all hands of the file; as in MotionContent
    """

    joints: np.ndarray
    handedness: Handedness | None
    order: JointOrder | None = JointOrder.STANDARD
    part: str = ""
    labeled: bool = False
    notes: tuple[str, ...] = ()
    times: Sequence[float | None] = ()

    @property
    def frames_seen(self) -> int:
        """Frames in which any joint is there."""
        return int(np.isfinite(self.joints).all(axis=-1).any(axis=-1).sum())


@dataclass(frozen=True)
class MotionContent:
    """A motion file as it is.

    kind:            the format, for people
    tracks:          its hands
    meters_per_unit: None where neither the file nor its format says it
    declared_unit:   whether the file itself says the unit, so that another one is a contradiction
    fps:             frames per second, None where the file does not say
    times:           of the frames (F,), which count more, as the file has them, in one of `time_units`; () without
    notes:           sentences about what was read, and how
    up:              the axis that points up, UP_AXES; None where neither the file nor its format says it
    filled:          (F,) bool, frames that nobody measured; None: none
    is_plain:        JGHand's own formats and plain arrays, whose defaults (meters, 30 fps) are documented
    files:           all that it was read from, where that is not one file alone
    animations:      names of the animations of which one was read
    """

    kind: str
    tracks: tuple[HandTrack, ...]
    meters_per_unit: float | None = None
    declared_unit: bool = False
    fps: float | None = None
    times: Sequence[float | None] = ()
    time_units: tuple[str, ...] = tuple(UNITS)
    notes: tuple[str, ...] = ()
    up: str | None = None
    filled: np.ndarray | None = None
    is_plain: bool = False
    files: tuple[Path, ...] = ()
    animations: tuple[str, ...] = ()


def named(part: str, names: Sequence[str]) -> list[int]:
    """The places of the names that people mean by `part`: those that it is, up to a comma; else those it is part of."""
    wanted = part.casefold().strip()
    known = [name.casefold() for name in names]
    exact = [place for place, name in enumerate(known) if f"{name},".startswith(f"{wanted},")]
    return exact or [place for place, name in enumerate(known) if wanted in name]
