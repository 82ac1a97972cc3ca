"""Which images an avatar learns from and which it is judged by.

A test image shows a pose that was not learned, or is seen by a camera that was not, or both, or shows a light that was
not: figures of their own, because they fail for different reasons. Where they come from: the capture's own splits.json,
a protocol, or a fixed rule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from jghand_engine.captures.captures import Capture, sorted_samples
from jghand_engine.captures.sample import Sample
from jghand_engine.errors import InputError
from jghand_engine.json_files import JsonObject

# the rule by which a set without a split of its own is split: every n-th pose and every n-th camera is for the test
SPLIT_EVERY_POSE = 5
SPLIT_EVERY_CAMERA = 6

SPLITS_FILE = "splits.json"
SPLITS_FORMAT = 1


@dataclass(frozen=True)
class Split:
    """Images to learn from, and four kinds of images to be judged by.

    train:       learned poses, learned cameras
    novel_pose:  other poses, learned cameras
    novel_view:  learned poses, other cameras
    novel_both:  neither was learned
    novel_light: learned poses and cameras, other lights
    origin:      where the split comes from, to be printed beside figures
    """

    train: tuple[Sample, ...]
    novel_pose: tuple[Sample, ...]
    novel_view: tuple[Sample, ...]
    novel_both: tuple[Sample, ...]
    origin: str
    novel_light: tuple[Sample, ...] = ()

    @property
    def test(self) -> tuple[Sample, ...]:
        """All images that are not learned from."""
        return self.novel_pose + self.novel_view + self.novel_both + self.novel_light

    def all_learned(self) -> Split:
        """The same images, all of them to learn from and none to be judged by."""
        return Split(sorted_samples(self.train + self.test), (), (), (), "all images")

    def categories(self) -> dict[str, tuple[Sample, ...]]:
        """The kinds of test images by name, those that there are."""
        kinds = {
            "novel pose": self.novel_pose, "novel view": self.novel_view, "both novel": self.novel_both,
            "novel light": self.novel_light,
        }  # fmt: skip
        return {name: samples for name, samples in kinds.items() if samples}


def split_capture(capture: Capture, *, to_learn: bool = True) -> Split:
    """The split that belongs to a capture: its protocol's, else that of its splits.json, else the fixed rule.

    to_learn: InputError where nothing is left to learn from; else the folder may hold test images alone
    """
    file = capture.folder / SPLITS_FILE
    if capture.train_sequences:
        # whole sequences, all with the same cameras, as the papers do
        held_out = {pose for pose in capture.poses if pose[0] in capture.test_sequences}
        sequences = {*capture.train_sequences, *capture.test_sequences}
        kept = capture.only(sample for sample in capture.samples if sample.sequence in sequences)
        split = _split(kept, held_out, set(), f"protocol {capture.protocol}")
    else:
        split = split_from_file(capture, file) if file.exists() else split_by_rule(capture)
    if to_learn and not split.train:
        raise InputError(
            f"split of {capture.name} ({split.origin})",
            wanted="at least one image to learn from",
            came=f"{len(capture)} images, all of them held out",
            remedy="Hold out fewer poses or cameras.",
        )
    return split


def split_by_rule(
    capture: Capture, every_pose: int = SPLIT_EVERY_POSE, every_camera: int = SPLIT_EVERY_CAMERA
) -> Split:
    """Every n-th pose of a sequence and every n-th camera are for the test, in the order of their names and numbers.
    The same images give the same split on any machine. With fewer poses, or cameras, than n none is held out.
    """
    poses: set[tuple[str, int]] = set()
    for sequence in capture.sequences:
        poses.update([pose for pose in capture.poses if pose[0] == sequence][every_pose - 1 :: every_pose])
    cameras = set(capture.cameras[every_camera - 1 :: every_camera])
    origin = f"every {every_pose}th pose and every {every_camera}th camera held out"
    return _split(capture, poses, cameras, origin)


def split_from_file(capture: Capture, file: Path) -> Split:
    """The split that a capture was made with.

    {"format": 1, "test_frames": {"<sequence>": [frame, …]}, "test_cameras": ["<camera>", …],
    "test_lights": {"<sequence>": ["<frame>/<camera>", …]}}; each may be absent.
    Names that the capture does not have are ignored: it may be a part of the one that was split. InputError for a file
    that is damaged.
    """
    content = JsonObject.of_file(file, "Write the split again.")
    content.value("format", lambda value: value == SPLITS_FORMAT, str(SPLITS_FORMAT))
    frames, cameras = content.fields.get("test_frames", {}), content.fields.get("test_cameras", [])
    lights = content.fields.get("test_lights", {})
    if not (isinstance(frames, dict) and all(_is_list_of(numbers, int) for numbers in frames.values())):
        raise content.wrong("test_frames", "lists of frame numbers by sequence")
    if not (isinstance(lights, dict) and all(_is_list_of(keys, str) for keys in lights.values())):
        raise content.wrong("test_lights", "lists of frame/camera by sequence")
    if not _is_list_of(cameras, str):
        raise content.wrong("test_cameras", "names of cameras")
    poses = {(name, frame) for name, numbers in frames.items() for frame in numbers}
    split = _split(capture, poses, set(cameras), f"{SPLITS_FILE} of the capture")
    new = {(name, key) for name, keys in lights.items() for key in keys}

    def is_new(sample: Sample) -> bool:
        return (sample.sequence, f"{sample.frame}/{sample.camera_name}") in new

    lit_anew = tuple(filter(is_new, split.train))
    return replace(split, train=tuple(s for s in split.train if not is_new(s)), novel_light=lit_anew)


def _is_list_of(value: object, kind: type) -> bool:
    return isinstance(value, list) and all(isinstance(entry, kind) and not isinstance(entry, bool) for entry in value)


def _split(capture: Capture, test_poses: set[tuple[str, int]], test_cameras: set[str], origin: str) -> Split:
    def images(pose_is_new: bool, camera_is_new: bool) -> tuple[Sample, ...]:
        return tuple(
            sample
            for sample in capture.samples
            if (sample.pose in test_poses) is pose_is_new and (sample.camera_name in test_cameras) is camera_is_new
        )

    return Split(images(False, False), images(True, False), images(False, True), images(True, True), origin)
