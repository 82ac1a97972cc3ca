"""A capture: the images of one hand that belong together, from whatever data set."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from jghand_engine.captures.sample import Sample
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness


class Layout(StrEnum):
    """The arrangement of files on disk. Our own captures are stored as InterHand2.6M."""

    INTERHAND = "InterHand2.6M"
    HANCO = "HanCo"


@dataclass(frozen=True)
class CaptureChoice:
    """Which images of a data set are wanted; None: all, or the only ones that there are.

    split:       'train', 'val' or 'test' of InterHand2.6M
    capture:     one person's folder of InterHand2.6M, such as 'Capture0'
    sequences:   names of sequences, such as 'ROM04_RT_Occlusion', or '0191' of HanCo
    handedness:  needed only where both hands were recorded
    some:        leave out sequences that are not there, as long as one is
    """

    split: str | None = None
    capture: str | None = None
    sequences: tuple[str, ...] | None = None
    handedness: Handedness | None = None
    some: bool = False


@dataclass(frozen=True)
class Capture:
    """Images of one hand.

    name:       what to call it: the folder, and what of it was chosen
    folder:     where the data set lies
    layout:     how it is arranged
    samples:    the images, sorted by sequence, frame and camera
    handedness: of all samples
    protocol:   the name of the protocol by which they were chosen, or None
    train_sequences, test_sequences: what that protocol learns from and shows; empty: the split is found otherwise
    dropped:    why images of the choice were left out, with their number
    notes:      what a user should know, as sentences
    shows_forearm: whether its pictures go on behind the wrist, and its masks with them
    """

    name: str
    folder: Path
    layout: Layout
    samples: tuple[Sample, ...]
    handedness: Handedness
    protocol: str | None = None
    train_sequences: tuple[str, ...] = ()
    test_sequences: tuple[str, ...] = ()
    dropped: tuple[tuple[str, int], ...] = ()
    notes: tuple[str, ...] = ()
    shows_forearm: bool = False

    def __post_init__(self) -> None:
        if not self.samples:
            reasons = "; ".join(f"{why}: {count}" for why, count in self.dropped)
            raise InputError(
                f"capture {self.name} in {self.folder}",
                wanted="at least one image that can be used",
                came=f"none ({reasons})" if reasons else "none",
                remedy="Choose another sequence, capture or hand.",
            )

    def __len__(self) -> int:
        return len(self.samples)

    @property
    def poses(self) -> tuple[tuple[str, int], ...]:
        """(sequence, frame) of every pose, sorted."""
        return tuple(self.by_pose())

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras, sorted."""
        return tuple(sorted({sample.camera_name for sample in self.samples}))

    @property
    def sequences(self) -> tuple[str, ...]:
        """Names of the sequences, sorted."""
        return tuple(sorted({sample.sequence for sample in self.samples}))

    def by_pose(self) -> dict[tuple[str, int], tuple[Sample, ...]]:
        """The images of each pose, sorted: the same hand at the same moment, seen by several cameras."""
        return dict(sorted(by_pose(self.samples).items()))

    def joints_m(self) -> np.ndarray:
        """(P, 21, 3) joints of every pose, level order, world, meters, in the order of `poses`."""
        return np.stack([group[0].joints_m for group in self.by_pose().values()])

    def only(self, samples: Iterable[Sample]) -> Capture:
        """The same capture with these images alone."""
        return replace(self, samples=tuple(samples))


def by_pose(samples: Iterable[Sample]) -> dict[tuple[str, int], tuple[Sample, ...]]:
    """The images of each pose, poses and images in the order of `samples`."""
    groups: dict[tuple[str, int], list[Sample]] = {}
    for sample in samples:
        groups.setdefault(sample.pose, []).append(sample)
    return {pose: tuple(group) for pose, group in groups.items()}


def sorted_samples(samples: Iterable[Sample]) -> tuple[Sample, ...]:
    """In the order of sequence, frame and camera: the same on every machine."""
    return tuple(sorted(samples, key=lambda sample: (sample.sequence, sample.frame, sample.camera_name)))
