"""Files of an export arrive together or not at all, and take the place of an earlier export's."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from jghand_engine.errors import InputError, RetryError
from jghand_engine.export.usd.options import LayerNames, Package
from jghand_engine.export.usd.seal import is_as_written
from jghand_engine.files import file_error, sync
from jghand_engine.limits import USD_LEFT_OVER_S
from jghand_engine.lock import locked

# in the temporary folder of an export, as long as its process lives
LOCK = "lock"
# in the name of a folder in which the files of an earlier export wait
_ASIDE = "earlier"


def check_earlier(folder: Path, names: LayerNames, package: Package) -> None:
    """InputError for a file in the way that is no earlier export's, or that somebody has changed since."""
    for path in names.of_earlier(folder, package):
        # another export may have taken it away meanwhile
        if path.is_file() and not is_as_written(path) and path.is_file():
            raise InputError(
                f"{path}",
                wanted="no file of that name, or one as JGHand wrote it",
                came="one that somebody else made, or changed",
                remedy="Choose another name or folder, or let it be replaced (--overwrite; in Blender Replace Others).",
            )


@contextlib.contextmanager
def arriving(folder: Path, names: LayerNames, package: Package) -> Iterator[tuple[Path, Path]]:
    """Two temporary folders in `folder`, for layers that stay behind and for files that arrive; on success these take
    the place of an earlier export's, all or none. They are the same folder where the layers are what arrives."""
    for target in (folder / name for name in names.files(package)):
        if target.is_dir():
            raise file_error(target, IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR)))
    _remove_left_over(folder, names)
    temporary = Path(tempfile.mkdtemp(prefix=f".{names.name}.", dir=folder))
    try:
        with _held_if_possible(temporary / LOCK):
            layers = arrived = temporary / "layers"
            layers.mkdir()
            if package is not Package.LAYERS:
                arrived = temporary / "single"
                arrived.mkdir()
            yield layers, arrived
            for path in arrived.iterdir():
                sync(path)
            _exchange(arrived, folder, names, package)
        _remove_earlier(folder, names)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextlib.contextmanager
def _held_if_possible(lock: Path) -> Iterator[None]:
    """Where a file system has no locks there is none, and nobody tidies up after a kill: the folder is this process's
    own all the same."""
    with contextlib.ExitStack() as held:
        try:
            held.enter_context(locked(lock))
        except InputError:
            lock.unlink(missing_ok=True)
        yield


def _remove_left_over(folder: Path, names: LayerNames) -> None:
    """The temporary folders of exports whose process was killed and could not."""
    for lock in folder.glob(f".{names.name}.????????/{LOCK}"):
        # one that is not there is tidied up by its export; one just made may not be held yet
        with contextlib.suppress(RetryError, InputError, FileNotFoundError):
            if _is_old(lock):
                with locked(lock):
                    pass
                # not while it is held: Windows removes no file that is open
                shutil.rmtree(lock.parent, ignore_errors=True)


def _remove_earlier(folder: Path, names: LayerNames) -> None:
    """What exports that were killed while they changed files put aside, once there is a whole one in its place."""
    for aside in folder.glob(f".{names.name}.{_ASIDE}.????????"):
        with contextlib.suppress(FileNotFoundError):
            files = [path.name for path in aside.iterdir()]
            # that of another package has nothing in its place
            if _is_old(aside) and (not files or any((folder / name).exists() for name in files)):
                shutil.rmtree(aside, ignore_errors=True)


def _is_old(path: Path) -> bool:
    return time.time() - path.stat().st_mtime > USD_LEFT_OVER_S


def _exchange(arrived: Path, folder: Path, names: LayerNames, package: Package) -> None:
    """Moves the files from `arrived` to `folder`. Layers of two exports must never stand together, so the earlier ones
    wait aside, and on any failure, Ctrl-C too, everything goes back. Where even that fails they stay in their hidden
    folder."""
    aside = Path(tempfile.mkdtemp(prefix=f".{names.name}.{_ASIDE}.", dir=folder))
    earlier = [(path, aside / path.name) for path in names.of_earlier(folder, package)]
    # those that refer to others after them
    last = names.files(package)
    paths = sorted(arrived.iterdir(), key=lambda path: (last.index(path.name) if path.name in last else -1, path.name))
    moves = [*earlier, *((path, folder / path.name) for path in paths)]
    try:
        for source, target in moves:
            os.replace(source, target)
    except BaseException:
        for source, target in reversed(moves):
            # what the disk says: an interruption may come between a move and any note of it
            if target.exists() and not source.exists():
                os.replace(target, source)
        with contextlib.suppress(OSError):
            aside.rmdir()
        raise
    shutil.rmtree(aside, ignore_errors=True)
