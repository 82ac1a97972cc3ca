"""A list of trainings: a TOML file whose tables are what `jghand train` is told.

minutes = 60                      # what holds for all of them

[[training]]
folder = "captures/id3"           # from where the list lies

[[training]]
folder = "captures/id4"
name = "second"                   # of the avatar; left out: that of the folder
minutes = 120
"""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jghand_engine.errors import InputError
from jghand_engine.limits import LIST_BYTES_MAX, TRAININGS_MAX

# options of `jghand train` that a list may give, and what each takes
OPTIONS: dict[str, tuple[type, ...]] = {
    "preset": (str,), "minutes": (int, float), "steps": (int,), "seed": (int,), "all_pictures": (bool,),
    "tensorboard": (bool,), "device": (str,), "protocol": (str,), "subset": (str,), "capture": (str,),
    "sequences": (list,), "hand": (str,), "interacting": (bool,), "overwrite": (bool,),
}  # fmt: skip
_SIGNS = set(" .-_()+,")


@dataclass(frozen=True)
class Training:
    """name: of the avatar and of everything about it · words: what `jghand train` is told, but where to and how to
    begin: "train", the folder, options."""

    name: str
    words: tuple[str, ...]


def read_trainings(path: Path) -> list[Training]:
    """The trainings of a list, in its order. InputError names the table and the entry that is wrong."""
    content = _content(path)
    tables = content.pop("training", None)
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables) or not tables:
        raise InputError(f"{path}", wanted="[[training]] tables", came="none" if tables is None else "something else")
    if len(tables) > TRAININGS_MAX:
        raise InputError(f"{path}", wanted=f"at most {TRAININGS_MAX} trainings", came=str(len(tables)))
    found = [
        _training({**content, **table}, path.parent, f"{path}: training {number}")
        for number, table in enumerate(tables, 1)
    ]
    # a disk may know no capital letters
    names = Counter(training.name.casefold() for training in found)
    if twice := sorted(name for name, count in names.items() if count > 1):
        raise InputError(
            f"{path}", wanted="a name for each training", came=f"{', '.join(twice[:5])} more than once",
            remedy="Give them a name of their own: name = \"…\".",
        )  # fmt: skip
    return found


def _content(path: Path) -> dict[str, Any]:
    try:
        with open(path, "rb") as stream:
            # one more than there may be: what a device or a pipe holds its size does not say
            content = stream.read(LIST_BYTES_MAX + 1)
        if len(content) > LIST_BYTES_MAX:
            raise InputError(f"{path}", wanted=f"a list of at most {LIST_BYTES_MAX} bytes", came="more")
        return tomllib.loads(content.decode("utf-8"))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}", remedy="Check the name.") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{path}", wanted="TOML", came=str(error)[:200] or "tables too deep in each other") from error


def _training(table: Mapping[str, Any], base: Path, thing: str) -> Training:
    options = dict(table)
    folder = options.pop("folder", None)
    if not isinstance(folder, str) or not folder:
        raise InputError(thing, wanted='folder = "…", the pictures', came=repr(folder)[:80])
    place = (base / folder).resolve()
    if not place.is_dir():
        raise InputError(f"{thing}: folder", wanted="a folder of pictures", came=f"{place}, which is none")
    name = options.pop("name", place.name)
    if not isinstance(name, str) or not name.strip(" .") or not all(sign.isalnum() or sign in _SIGNS for sign in name):
        raise InputError(f"{thing}: name", wanted="letters, digits and signs of file names", came=repr(name)[:80])
    for key in options.keys() - OPTIONS.keys():
        wanted = f"folder, name and options of jghand train: {', '.join(OPTIONS)}"
        raise InputError(f"{thing}: {key}", wanted=wanted, came="another entry")
    words = ["train", str(place)]
    # not in the order of the list: the same options are to be the same words
    for key in (key for key in OPTIONS if key in options):
        words += _words(key, options[key], thing)
    return Training(name, tuple(words))


def _words(key: str, value: Any, thing: str) -> list[str]:
    """An entry as words of the command line."""
    kinds, option = OPTIONS[key], "--" + key.replace("_", "-")
    # True is an int to Python
    if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        raise InputError(f"{thing}: {key}", wanted=" or ".join(kind.__name__ for kind in kinds), came=repr(value)[:80])
    if isinstance(value, bool):
        return [option] if value else []
    if isinstance(value, list):
        if not value or not all(isinstance(one, str) for one in value):
            raise InputError(f"{thing}: {key}", wanted="a list of texts", came=repr(value)[:80])
        return [option, *value]
    return [option, str(value)]
