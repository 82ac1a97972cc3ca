"""HanCo, the multi-view video of FreiHAND. Layout: DATA 5, which follows the set's own example script.

    meta.json                              {"is_valid": [sequence][frame], "subject_id": …}
    rgb/{sequence:04d}/cam{c}/{frame:08d}.jpg     224 x 224, c = 0..7; rgb_merged/ and others: other backgrounds
    mask_hand/{sequence:04d}/cam{c}/{frame:08d}.jpg
    calib/{sequence:04d}/{frame:08d}.json  {"K": 8 of 3 x 3, "M": 8 of 4 x 4, world -> camera}
    xyz/{sequence:04d}/{frame:08d}.json    21 x 3, meters, world, standard order

Its meters and standard order need no conversion but that to level order. The set shows right hands and says so nowhere.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.captures.captures import Capture, CaptureChoice, Layout, sorted_samples
from jghand_engine.captures.image_files import probe_sized
from jghand_engine.captures.masks import template_note
from jghand_engine.captures.reading import (
    Report,
    Sieve,
    calibrated_camera,
    find_roots,
    one_root,
    subfolders,
)
from jghand_engine.captures.sample import MaskSource, Sample
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.json_files import JsonObject, numbers, read_json_file
from jghand_engine.render.camera import Camera

# width and height of HanCo's images
HANCO_SIZE_PX = (224, 224)
HANCO_CAMERAS = 8

# the recording itself first; the others show the same hand on other backgrounds
_IMAGES = ("rgb", "rgb_merged", "rgb_homo")
_DOWNLOAD = "Download and unpack that part of HanCo again, beside meta.json."


def is_hanco(folder: Path) -> bool:
    """Whether `folder` looks like HanCo, whole or not."""
    named = ("meta.json", "calib", "xyz", "mask_hand")
    return sum((folder / name).exists() for name in named) >= 2 and any((folder / name).is_dir() for name in _IMAGES)


def read_hanco(folder: Path | str, choice: CaptureChoice | None = None, *, report: Report | None = None) -> Capture:
    """The images of one person in a folder of the HanCo layout; frames that are not valid are left out.

    choice: `sequences` such as '0191' (needed unless there is only one), `handedness` (right). Errors and `report` as
    in `read_interhand`.
    """
    root = one_root(Path(folder), find_roots(Path(folder), is_hanco))
    return _Reader(root, Path(folder).resolve(), choice or CaptureChoice(), Sieve(report)).capture()


class _Reader:
    """One reading of some sequences of one person."""

    def __init__(self, root: Path, named: Path, choice: CaptureChoice, sieve: Sieve) -> None:
        self.root, self.named, self.choice, self.sieve = root, named, choice, sieve
        self.handedness = choice.handedness or Handedness.RIGHT
        self.images = next(root / name for name in _IMAGES if (root / name).is_dir())
        self.meta = JsonObject.of_file(root / "meta.json", _DOWNLOAD).fields

    def capture(self) -> Capture:
        sequences = self._sequences()
        samples = sorted_samples(sample for sequence in sequences for sample in self._samples(sequence))
        subject = self._one_subject(sequences)
        notes = template_note(sum(sample.mask_source.is_projected for sample in samples), len(samples))
        if self.images.name != _IMAGES[0]:
            notes += (f"Images are those of {self.images.name}, for there is no folder {_IMAGES[0]}.",)
        capture = Capture(
            name=f"{self.root.name} {'+'.join(sequences)} (subject {subject})",
            folder=self.root,
            layout=Layout.HANCO,
            samples=samples,
            handedness=self.handedness,
            dropped=self.sieve.dropped,
            notes=notes,
        )
        self.sieve.check_joints(capture.joints_m(), JointOrder.STANDARD, "m", str(self.root / "xyz"))
        return capture

    def _sequences(self) -> tuple[str, ...]:
        """The wanted sequences as folder names. InputError when one is not there, or many are and none is named."""
        present = [folder.name for folder in subfolders(self.images)]
        wanted = self.choice.sequences
        if wanted is None and self.named.is_relative_to(self.root):
            # the user named rgb/0191 or a folder in it
            wanted = self.named.relative_to(self.root).parts[1:2] or None
        wanted = tuple(f"{int(name):04d}" if name.isdecimal() else name for name in wanted or present)
        if self.choice.sequences is None and len(wanted) > 1:
            raise InputError(
                f"data set {self.root}",
                wanted="a sequence",
                came=f"{len(present)} sequences, {present[0]} to {present[-1]}",
                remedy="Name the sequence, such as 0191, or a protocol.",
            )
        if not wanted or not set(wanted) <= set(present):
            raise InputError(
                f"sequences in {self.images}", wanted=", ".join(sorted(wanted)) or "folders of sequences",
                came=", ".join(present[:10]) + (" …" if len(present) > 10 else "") or "none", remedy=_DOWNLOAD,
            )  # fmt: skip
        return wanted

    def _one_subject(self, sequences: tuple[str, ...]) -> Any:
        subjects = {str(self._meta("subject_id", sequence)[0]) for sequence in sequences}
        if len(subjects) > 1:
            raise InputError(
                f"sequences {', '.join(sequences)}",
                wanted="sequences of one person",
                came=f"subjects {', '.join(sorted(subjects))}",
                remedy="Choose sequences that meta.json gives the same subject_id.",
            )
        return subjects.pop()

    def _meta(self, what: str, sequence: str) -> list[Any]:
        """What meta.json says of the frames of a sequence."""
        where = f"{what} of sequence {sequence} in {self.root / 'meta.json'}"
        try:
            frames = self.meta[what][int(sequence)]
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise InputError(where, wanted="an entry", came="none", remedy=_DOWNLOAD) from error
        if not isinstance(frames, list) or not frames:
            raise InputError(where, wanted="a list over its frames", came=type(frames).__name__, remedy=_DOWNLOAD)
        return frames

    def _samples(self, sequence: str) -> list[Sample]:
        samples: list[Sample] = []
        for frame, is_valid in enumerate(self._meta("is_valid", sequence)):
            if not is_valid:
                self.sieve.drop("not valid", HANCO_CAMERAS)
                continue
            try:
                joints_m = self._joints(sequence, frame)
                cameras = self._cameras(sequence, frame)
            except InputError as error:
                self.sieve.broken(error)
                continue
            for number, camera in enumerate(cameras):
                try:
                    samples.append(self._sample(sequence, frame, f"cam{number}", camera, joints_m))
                except InputError as error:
                    self.sieve.broken(error)
        return samples

    def _sample(self, sequence: str, frame: int, camera_name: str, camera: Camera, joints_m: np.ndarray) -> Sample:
        name = Path(sequence, camera_name, f"{frame:08d}.jpg")
        mask = self.root / "mask_hand" / name
        has_mask = mask.is_file()
        probe_sized(self.images / name, HANCO_SIZE_PX, "the layout")
        return Sample(
            image=self.images / name,
            camera=camera,
            joints_m=joints_m,
            handedness=self.handedness,
            capture=self.root.name,
            sequence=sequence,
            frame=frame,
            camera_name=camera_name,
            mask_source=MaskSource.FILE if has_mask else MaskSource.TEMPLATE,
            mask=mask if has_mask else None,
        )

    def _joints(self, sequence: str, frame: int) -> np.ndarray:
        file = self.root / "xyz" / sequence / f"{frame:08d}.json"
        joints_m = numbers(read_json_file(file, _DOWNLOAD), (JOINT_COUNT, 3), str(file), _DOWNLOAD)
        if not np.isfinite(joints_m).all():
            raise InputError(f"{file}", wanted="finite numbers", came="NaN or infinity", remedy=_DOWNLOAD)
        return to_level(joints_m, JointOrder.STANDARD)

    def _cameras(self, sequence: str, frame: int) -> list[Camera]:
        file = self.root / "calib" / sequence / f"{frame:08d}.json"
        content = JsonObject.of_file(file, _DOWNLOAD)
        intrinsics, matrices = (content.array(name, (HANCO_CAMERAS, k, k)) for name, k in (("K", 3), ("M", 4)))
        return [
            calibrated_camera(f"camera {c} in {file}", HANCO_SIZE_PX, k, m[:3, :3], m[:3, 3])
            for c, (k, m) in enumerate(zip(intrinsics, matrices, strict=True))
        ]
