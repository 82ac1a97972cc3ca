"""Where the files of an InterHand2.6M download lie, in any of the arrangements in which people have it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from jghand_engine.captures.folders import find_roots, one_root, subfolders
from jghand_engine.errors import InputError

SPLITS = ("train", "val", "test")
# where a split's annotations are: version 1.0, and then the older drops, the most complete one first
_DROPS = ("{split}", "all", "machine_annot", "human_annot", ".")
_BATCH = "InterHand2.6M_*fps_batch*"
_DATA_FILE = re.compile(r"InterHand2\.6M_(train|val|test)_(data|camera|joint_3d)\.json")
_DOWNLOAD = "Download InterHand2.6M's annotations again, and unpack them as annotations/<split>/."


@dataclass(frozen=True)
class InterHandFiles:
    """The files of one split.

    root:     the folder that holds `annotations`
    images:   the folder of the split's Capture folders
    masks:    the same for `masks_removeblack`, or None
    mano:     the annotations of MANO fits, or None
    capture, sequence: what the folder that the user named stands for, when it is inside the data set; else None
    """

    root: Path
    split: str
    images: Path
    masks: Path | None
    data: Path
    camera: Path
    joint_3d: Path
    mano: Path | None
    capture: str | None = None
    sequence: str | None = None


def is_interhand(folder: Path) -> bool:
    """Whether `folder` holds annotations named as InterHand2.6M names them, whole or not."""
    annotations = folder / "annotations"
    return annotations.is_dir() and any(
        _DATA_FILE.fullmatch(entry.name)
        for place in [annotations, *subfolders(annotations)]
        for entry in place.iterdir()
    )


def find_files(folder: Path, split: str | None = None) -> InterHandFiles:
    """The files that belong to `folder`: the data set itself, the folder around it, or one inside it.

    split: which one; None: the only one, or the one that `folder` lies in. InputError says what is missing.
    """
    root = one_root(folder, find_roots(folder, is_interhand) or [_no_root(folder)])
    named_split, capture, sequence = _named(root, folder.resolve())
    split = _split(root, split or named_split)
    annotations = _annotations(root, split)
    images = _images(root, split)
    masks = images.parent.with_name("masks_removeblack") / split
    mano = annotations / f"InterHand2.6M_{split}_MANO_NeuralAnnot.json"
    return InterHandFiles(
        root=root,
        split=split,
        images=images,
        masks=masks if masks.is_dir() else None,
        data=_annotation(annotations, split, "data"),
        camera=_annotation(annotations, split, "camera"),
        joint_3d=_annotation(annotations, split, "joint_3d"),
        mano=mano if mano.is_file() else None,
        capture=capture,
        sequence=sequence,
    )


def _no_root(folder: Path) -> Path:
    """Raises the InputError that says what is not as it should be."""
    if (folder / "images").is_dir():
        came = "images, but no annotations"
    else:
        names = [entry.name for entry in subfolders(folder)][:6]
        came = f"folders {', '.join(names)}" if names else "no folders"
    raise InputError(
        f"data set {folder}",
        wanted="a folder with images/ and annotations/, as InterHand2.6M has them",
        came=came,
        remedy=_DOWNLOAD if "annotations" in came else "Name the folder that holds both.",
    )


def _named(root: Path, folder: Path) -> tuple[str | None, str | None, str | None]:
    """(split, capture, sequence) that a folder inside the data set stands for, such as images/test/Capture0."""
    if not folder.is_relative_to(root):
        return None, None, None
    parts = [part for part in folder.relative_to(root).parts if not Path(part).match(_BATCH)][1:4]
    return tuple(parts[k] if k < len(parts) and (k or parts[k] in SPLITS) else None for k in range(3))  # type: ignore[return-value]


def _split(root: Path, wanted: str | None) -> str:
    present = [split for split in SPLITS if _annotations_or_none(root, split) is not None]
    if wanted is not None and wanted not in present:
        raise InputError(
            f"split '{wanted}' of {root}",
            wanted=f"one of {', '.join(present)}" if present else "annotations of a split",
            came=f"'{wanted}'" if wanted in SPLITS else f"'{wanted}', which InterHand2.6M does not have",
            remedy=_DOWNLOAD,
        )
    if wanted is not None:
        return wanted
    with_pictures = [split for split in present if _images_or_none(root, split) is not None]
    if len(with_pictures) == 1:
        return with_pictures[0]
    if len(present) == 1:
        return present[0]
    if not present:
        raise InputError(f"annotations of {root}", wanted="a file …_data.json", came="none", remedy=_DOWNLOAD)
    raise InputError(
        f"data set {root}",
        wanted="the name of one split",
        came=f"annotations of {', '.join(present)}",
        remedy="Name the split (--subset), or a protocol.",
    )


def _annotations_or_none(root: Path, split: str) -> Path | None:
    places = [root / "annotations" / drop.format(split=split) for drop in _DROPS]
    return next((place for place in places if (place / f"InterHand2.6M_{split}_data.json").is_file()), None)


def _annotations(root: Path, split: str) -> Path:
    place = _annotations_or_none(root, split)
    if place is None:
        raise InputError(f"annotations of {root}, split {split}", came="no …_data.json", remedy=_DOWNLOAD)
    return place


def _annotation(place: Path, split: str, kind: str) -> Path:
    file = place / f"InterHand2.6M_{split}_{kind}.json"
    if not file.is_file():
        raise InputError(f"annotations in {place}", wanted=file.name, came="no such file", remedy=_DOWNLOAD)
    return file


def _images_or_none(root: Path, split: str) -> Path | None:
    places = [root / "images" / split, *sorted(root.glob(f"{_BATCH}/images/{split}"))]
    return next((place for place in places if place.is_dir()), None)


def _images(root: Path, split: str) -> Path:
    place = _images_or_none(root, split)
    if place is None:
        raise InputError(
            f"pictures of {root}",
            wanted=f"a folder images/{split}",
            came="none",
            remedy="Put the folder images beside the folder annotations.",
        )
    return place
