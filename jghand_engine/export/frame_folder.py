"""How several processes share one folder of frames.

`made_from.json` says what all frames of a folder were made from: a run that adds to the folder (--shard,
--skip-existing) must be made from the same, and is refused otherwise.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jghand_engine.errors import InputError
from jghand_engine.files import file_error, remove_file
from jghand_engine.json_files import write_json

STAMP = "made_from.json"
# seconds in which another process has written the stamp that it has created
STAMP_WAIT_S = 0.5


@dataclass(frozen=True)
class Shard:
    """Which frames a process makes.

    number, count: every `count`-th frame from the `number`-th on, counted from 1
    skip_existing: keep those that are there already
    """

    number: int = 1
    count: int = 1
    skip_existing: bool = False

    @property
    def is_shared(self) -> bool:
        """Whether frames that this process does not make belong into the same folder."""
        return self.skip_existing or self.count > 1

    def indices(self, total: int) -> range:
        """The frames of this shard, of `total`."""
        return range(self.number - 1, total, self.count)


@dataclass
class Outcome:
    """What became of a shard.

    made: drawn now
    kept: there already
    broken: of those that were drawn, how many were there, but damaged
    complete: whether all frames are there now, those of the other shards too
    """

    made: int = 0
    kept: int = 0
    broken: int = 0
    complete: bool = False

    def sentence(self) -> str:
        text = f"{self.made} drawn" + (f", {self.kept} there already" if self.kept else "")
        text += f", {self.broken} of the drawn ones were there, but broken" if self.broken else ""
        return text + ("." if self.complete else "; others are still missing.")


def refuse_other_frames(folder: Path, frames: range) -> None:
    """InputError when the folder holds pictures of other frames than these: two motions might be mixed.

    They are not removed: nothing tells whether they are still wanted.
    """
    found = (re.fullmatch(r"frame_(\d{5,})\.png", path.name) for path in folder.glob("frame_*.png"))
    left = sorted(match[0] for match in found if match and int(match[1]) not in frames)
    if left:
        raise InputError(
            f"--out {folder}",
            wanted=f"a folder without pictures of other frames than {frames.start} to {frames[-1]}",
            came=f"{len(left)} of an earlier run ({left[0]} to {left[-1]})",
            remedy="Remove them or choose another folder; a motion is drawn in parts with --shard.",
        )


def settle_folder(folder: Path, stamp: Mapping[str, str], paths: Sequence[Path], shard: Shard) -> None:
    """Says in an existing folder what its frames `paths` are made from. InputError when a shared run finds frames of
    something else; a run that makes them all removes those first, so that none of them is ever kept."""
    path = folder / STAMP
    found = _read_stamp(path)
    old = [] if found == stamp else [frame for frame in paths if frame.exists()]
    if shard.is_shared:
        if not old and found is None:
            found = _put_stamp(path, stamp)
        if found != stamp:
            names = [name for name in {**stamp, **(found or {})} if (found or {}).get(name) != stamp.get(name)]
            raise InputError(
                f"--out {folder}",
                wanted="frames that this very command made",
                came=f"frames of another {', '.join(names)}" if found else "frames of an unknown render",
                remedy="Give all shards the same files and options, or choose another --out; a run without --shard and "
                "--skip-existing replaces what is there.",
            )
        return
    for frame in (*old, *folder.glob(".frame_*.png")):
        remove_file(frame)
    write_json(path, dict(stamp))


def _put_stamp(path: Path, stamp: Mapping[str, str]) -> Mapping[str, str] | None:
    """Writes the stamp unless another process does so at the same moment; gives what stands there then."""
    try:
        with path.open("x", encoding="utf-8") as stream:
            stream.write(json.dumps(stamp, indent=2) + "\n")
        return stamp
    except FileExistsError:
        # whoever made it may not have written it yet
        time.sleep(STAMP_WAIT_S)
        return _read_stamp(path)
    except OSError as error:
        raise file_error(path, error) from error


def _read_stamp(path: Path) -> dict[str, str] | None:
    """What a folder says; None where it says nothing, or nothing that can be read."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None
