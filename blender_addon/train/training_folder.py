# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training leaves in its folder, read while it runs and after Blender was started anew. Does not use bpy.

training.json                          there is a training, and it can go on
checkpoints/step_00000500.safetensors  from where
pictures/step_00000500.png             truth beside the avatar
preview.jghand                         the avatar so far
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

_SUFFIX = ".training"
# what `jghand render` calls its first picture
PICTURE = "frame_00000.png"
# beside the proof of a hand from a film: what `jghand own --json` says of it
TOLD = "told.json"


@dataclass(frozen=True)
class TrainingFolder:
    """What lies in it.

    can_go_on:       whether it holds a training
    steps:           that are kept of it
    picture, avatar: the newest preview and avatar, None where there is none yet
    """

    path: Path
    can_go_on: bool = False
    steps: int = 0
    picture: Path | None = None
    avatar: Path | None = None

    @classmethod
    def look(cls, path: Path) -> TrainingFolder:
        """What is there now. A folder that cannot be read is one without a training."""
        pictures = sorted((path / "pictures").glob("step_*.png"))
        kept = sorted((path / "checkpoints").glob("step_????????.safetensors"))
        avatar = path / "preview.jghand"
        return cls(
            path,
            can_go_on=(path / "training.json").is_file(),
            steps=int(kept[-1].stem.removeprefix("step_")) if kept else 0,
            picture=pictures[-1] if pictures else None,
            avatar=avatar if avatar.is_file() else None,
        )

    def sentence(self) -> str:
        """How much of it there is."""
        return f"{self.steps} steps"


def folder_of(out: Path) -> Path:
    """Where the training of an avatar file keeps its work; as `jghand train` chooses it."""
    return out.with_suffix(_SUFFIX)


def capture_words(out: Path, settings: Any, motion: Path | None = None) -> tuple[str, ...]:
    """`jghand capture`; the same words again go on where it was stopped. settings: as `scene.jghand.training`; motion:
    its poses instead of made-up ones."""
    width, height = settings.size
    return (
        *("capture", "--out", str(out), "--identity", settings.identity),
        *("--cameras", str(settings.cameras), "--poses", str(settings.poses)),
        *("--size", f"{width}x{height}", "--samples", str(settings.samples), "--seed", str(settings.seed)),
        *(("--motion", str(motion)) if motion is not None else ()),
    )


def picture_words(avatar: Path, folder: Path) -> tuple[str, ...]:
    """`jghand render`: the picture that a hand is chosen by, `folder`/PICTURE."""
    places = ("--avatar", str(avatar), "--out", str(folder))
    return ("render", "--poses", "open", "--frames", "0", "--size", "256x256", *places)


def train_words(pictures: Path, out: Path, settings: Any, start: str = "", *, overwrite: bool) -> tuple[str, ...]:
    """`jghand train`. start: "resume" goes on, "fresh" forgets what there is; overwrite: an avatar file that is not of
    this training."""
    return (
        *("train", str(pictures), "--out", str(out), "--preset", settings.preset),
        *("--minutes", f"{settings.time_s / 60:g}", "--seed", str(settings.seed)),
        *(("--all-pictures",) if settings.all_pictures else ()),
        *(("--overwrite",) if overwrite else ()),
        *((f"--{start}",) if start else ()),
    )
