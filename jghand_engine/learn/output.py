"""The avatar that a training leaves at its end, and the promise not to overwrite somebody else's file."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.file import save_avatar
from jghand_engine.files import check_place, writing


class Output:
    """The file `path`. `record` remembers what this training wrote there, so that it may replace its own work.

    The record is written first and names both the file to come and the one before: whenever a process is killed, what
    lies at `path` is known.
    """

    def __init__(self, path: Path, record: Path, *, overwrite: bool = False) -> None:
        self.path, self._record, self._overwrite = path, record, overwrite

    def check(self) -> None:
        """InputError when a file is in the way that this training did not write, unless overwriting was asked for;
        errors as `check_place` where nothing can be written."""
        ours = self.path.is_file() and _hash(self.path) in self._recorded()
        wanted = "a new file, or the result of this very training"
        check_place(self.path, overwrite=self._overwrite or ours, wanted=wanted)

    def write(self, avatar: HandAvatar) -> None:
        """Saves `avatar`. Errors as `check`, which looks again: hours may have passed."""
        self.check()
        staged = self._record.with_name("finished.jghand")
        try:
            save_avatar(staged, avatar)
            content = staged.read_bytes()
            before = [_hash(self.path)] if self.path.is_file() else []
            self._remember([hashlib.sha256(content).hexdigest(), *before])
            with writing(self.path) as temporary:
                temporary.write_bytes(content)
        finally:
            staged.unlink(missing_ok=True)

    def _remember(self, hashes: list[str]) -> None:
        with writing(self._record) as temporary:
            temporary.write_text(json.dumps({"sha256": hashes}) + "\n", encoding="utf-8")

    def _recorded(self) -> list[str]:
        try:
            hashes = json.loads(self._record.read_text(encoding="utf-8"))["sha256"]
        except (OSError, ValueError, KeyError, TypeError):
            return []
        return hashes if isinstance(hashes, list) else [hashes]


def _hash(path: Path) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
