"""Previews of a training: the first fixed view as a picture, truth beside ours, and the avatar as it is so far."""

from __future__ import annotations

from pathlib import Path

from jghand_engine.avatar.file import save_avatar
from jghand_engine.export.pictures import to_bytes, write_png
from jghand_engine.learn.trainable import Trainable


class Previews:
    """pictures/step_00000500.png for every preview, and preview.jghand, always the newest, in one folder."""

    def __init__(self, folder: Path) -> None:
        self.pictures, self.avatar = folder / "pictures", folder / "preview.jghand"

    def write_picture(self, step: int, trainable: Trainable) -> Path:
        """Writes the first fixed view. InputError or RetryError when the disk does not let it."""
        path = self.pictures / f"step_{step:08d}.png"
        write_png(path, to_bytes(trainable.preview()))
        return path

    def write_avatar(self, trainable: Trainable) -> Path:
        """Writes the avatar over the last preview of it; errors as `write_picture`."""
        save_avatar(self.avatar, trainable.avatar())
        return self.avatar
