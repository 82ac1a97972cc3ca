"""Files of an export arrive together or not at all, and take the place of an earlier export's."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from jghand_engine.exporters.usd_options import LayerNames, Package
from jghand_engine.files import file_error, sync


@contextlib.contextmanager
def arriving(folder: Path, names: LayerNames, package: Package) -> Iterator[tuple[Path, Path]]:
    """Two temporary folders in `folder`, for layers that stay behind and for files that arrive; on success these take
    the place of an earlier export's, all or none. They are the same folder where the layers are what arrives."""
    for target in (folder / name for name in names.files(package)):
        if target.is_dir():
            raise file_error(target, IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR)))
    temporary = Path(tempfile.mkdtemp(prefix=f".{names.name}.", dir=folder))
    try:
        arrived = temporary
        if package is not Package.LAYERS:
            arrived = temporary / "single"
            arrived.mkdir()
        yield temporary, arrived
        for path in arrived.iterdir():
            sync(path)
        _exchange(arrived, folder, names, package)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _exchange(arrived: Path, folder: Path, names: LayerNames, package: Package) -> None:
    """Moves the files from `arrived` to `folder`. Layers of two exports must never stand together, so the earlier ones
    wait aside, and on any failure everything goes back. Where even that fails they stay in their hidden folder."""
    aside = Path(tempfile.mkdtemp(prefix=f".{names.name}.earlier.", dir=folder))
    earlier = [(path, aside / path.name) for path in names.of_earlier(folder, package)]
    # those that refer to others after them
    last = names.files(package)
    paths = sorted(arrived.iterdir(), key=lambda path: (last.index(path.name) if path.name in last else -1, path.name))
    moved = []
    try:
        for source, target in (*earlier, *((path, folder / path.name) for path in paths)):
            os.replace(source, target)
            moved.append((source, target))
    except BaseException:
        for source, target in reversed(moved):
            os.replace(target, source)
        aside.rmdir()
        raise
    shutil.rmtree(aside, ignore_errors=True)
