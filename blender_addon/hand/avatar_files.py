# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of avatars: whether one changed, its card (whose hand, under which license, from when, how good), and packs.

A `.jghand` file is safetensors: 8 bytes with the length of a JSON header, and in its metadata a JSON description. Only
that is read here, and texts in it are somebody else's. Does not use bpy.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import re
import struct
import time
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from ..core import kinematics
from ..core.joints import NAMES
from ..core.view import BUILTIN_AVATAR, avatar_stamp
from ..errors import JGHandFailure

# seconds: views and panels are drawn again and again, and ask the disk no more often than this
LOOK_S = 1.0
# bytes of a header: what the renderer takes, too
_HEADER_MAX_BYTES = 65_536
# mean albedo of skin, the engine's, linear Rec.709
MEAN_ALBEDO = (0.50, 0.33, 0.25)
# letters of a text on a card
_TEXT_MAX = 300
# what a hand file has of its skin: the part of its mean albedo that it throws onto itself, which is always this part
# where there is no ambient light; beside one, in files of other versions, it was learned
_BOUNCE, _AMBIENT, _THROWN_BACK = "response.bounce", "response.ambient", 0.8
# of hands that answer any light, by the kind of light that they learned in
_IN_SCENE_LIGHT = {
    "known": "Lit by lamps and world",
    "estimated": "Lit by lamps and world: its skin was estimated together with the light of its film",
}


@dataclass(frozen=True)
class Card:
    """What a panel says of an avatar.

    name:         what its maker called it
    license:      "" where the file does not say
    learned_from: which pictures; "" when nothing was learned
    written:      date of the file; "" for an avatar that comes with JGHand
    accuracy:     in words; "" when nothing was learned
    gaussians:    how many there are
    learned:      whether its colors change with the pose
    light:        that it learned in: known, so that it answers any; estimated together with its skin, of a film, and
                  answers any too; learnt with its colors, so that its answer is estimated
    has_forearm:  whether its skin goes on behind the wrist
    joints_m:     21 places, standard order, of its right hand at rest; None where they are the canonical hand's
    albedo:       mean of its skin, linear Rec.709; None where it is not known
    fist:         what its skin changes in named poses, see the engine's `Fist`
    """

    name: str
    license: str
    learned_from: str
    written: str
    accuracy: str
    gaussians: int
    learned: bool
    light: str = "learnt"
    has_forearm: bool = False
    joints_m: tuple[tuple[float, float, float], ...] | None = None
    albedo: tuple[float, float, float] | None = None
    fist: kinematics.Fist = kinematics.NO_FIST

    @property
    def in_scene_light(self) -> str:
        """How it answers the light of a scene, in a sentence."""
        if not self.learned:
            return "Shines with its own colors: lamps do not light it"
        return _IN_SCENE_LIGHT.get(
            self.light, "Lit by lamps and world, as is estimated: the light of its pictures is unknown"
        )

    @property
    def answers_light(self) -> bool:
        """Whether it is made for the light of a scene: an own hand as one of known light."""
        return self.light in _IN_SCENE_LIGHT

    def lines(self) -> list[tuple[str, str]]:
        rows = [
            ("Name", self.name),
            ("Learned From", self.learned_from or "nothing: it is painted"),
            ("License", self.license or "not stated"),
            ("Written", self.written),
            ("PSNR", self.accuracy),
            ("Splats", f"{self.gaussians}"),
        ]
        return [(name, value) for name, value in rows if value]


# Of the avatars that come with the renderer, wherever that lies; a test compares them with their files
SHIPPED_CARDS = {
    BUILTIN_AVATAR: Card(
        name="JGHand built-in",
        license="CC0-1.0 AND Apache-2.0, see NOTICE: learned from path-traced pictures of MakeHuman's hand (CC0-1.0) "
        "on a rig with SOMA's joints (Apache-2.0), in the light of Blender's worlds (CC0-1.0)",
        learned_from="348 images of capture train/Capture0",
        written="",
        accuracy="29.52 on held-out pictures of new train/Capture0 (24 of other poses, cameras, worlds and lamps), "
        "preset final; times on Intel(R) Xeon(R) Processor (family 6), 2 threads",
        gaussians=40_000,
        learned=True,
        light="known",
        has_forearm=True,
        albedo=(0.655, 0.349, 0.254),
        fist=kinematics.Fist((0.2136, 1.2678, 6.0), (-0.0055, -0.0099, -0.0039)),
    ),
    "painted": Card(
        name="JGHand painted",
        license="MIT AND CC0-1.0 AND Apache-2.0, see NOTICE",
        learned_from="",
        written="",
        accuracy="",
        gaussians=60_000,
        learned=False,
    ),
}

# path -> when its disk was asked last, on the clock of time.monotonic(), and the stamp that it had
_stamps: dict[str, tuple[float, str]] = {}
# path -> the stamp that its file had, and its card, or why there is none
_cards: dict[str, tuple[str, Card | JGHandFailure]] = {}


def stamp(avatar: str) -> str:
    """`avatar_stamp`, which is asked once a second."""
    now_s = time.monotonic()
    looked_s, known = _stamps.get(avatar, (float("-inf"), ""))
    if now_s - looked_s >= LOOK_S:
        known = avatar_stamp(avatar)
        _stamps[avatar] = (now_s, known)
    return known


def card_of(avatar: str) -> Card:
    """The card of an avatar; its file is read again when it changed. JGHandFailure: bad_avatar, no_avatar."""
    if avatar in SHIPPED_CARDS:
        return SHIPPED_CARDS[avatar]
    now = stamp(avatar)
    if _cards.get(avatar, ("",))[0] != now:
        try:
            _cards[avatar] = (now, read_card(Path(avatar)))
        except JGHandFailure as failure:
            _cards[avatar] = (now, failure)
    found = _cards[avatar][1]
    if isinstance(found, JGHandFailure):
        raise found
    return found


def albedo_of(avatar: str) -> tuple[float, float, float]:
    """Mean albedo of an avatar's skin, linear Rec.709; where it is not known that which hands of unknown light have."""
    with contextlib.suppress(JGHandFailure):
        return card_of(avatar).albedo or MEAN_ALBEDO
    return MEAN_ALBEDO


def fist_of(avatar: str) -> kinematics.Fist:
    """What the skin of an avatar changes in named poses; nothing for one that cannot be read."""
    with contextlib.suppress(JGHandFailure):
        return card_of(avatar).fist
    return kinematics.NO_FIST


def has_forearm(avatar: str) -> bool:
    """Whether an avatar has one; no for one that cannot be read."""
    try:
        return card_of(avatar).has_forearm
    except JGHandFailure:
        return False


class _NoCardError(ValueError):
    """Says what a file lacks."""


def read_card(path: Path) -> Card:
    """The card of a `.jghand` file. JGHandFailure: bad_avatar, no_avatar."""
    try:
        with path.open("rb") as file:
            (length,) = struct.unpack("<Q", file.read(8))
            if length > _HEADER_MAX_BYTES:
                raise _NoCardError("its beginning is not that of an avatar")
            header = json.loads(file.read(length))
            ends = [about["data_offsets"][1] for name, about in header.items() if name != "__metadata__"]
            if path.stat().st_size < 8 + length + max(ends, default=0):
                raise _NoCardError("its end is missing")
            albedo = _albedo(file, header, 8 + length)
        written = time.strftime("%Y-%m-%d", time.localtime(path.stat().st_mtime))
        return _card(json.loads(header["__metadata__"]["jghand"]), written, albedo)
    except FileNotFoundError as error:
        raise JGHandFailure("no_avatar", str(path)) from error
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError, struct.error) as error:
        # what Python says of JSON, of bytes and of keys helps nobody here
        of_rights = "it may not be read" if isinstance(error, PermissionError) else "its header cannot be read"
        reason = str(error) if isinstance(error, _NoCardError) else of_rights
        raise JGHandFailure("bad_avatar", f"{path}\n{reason}") from error


def _albedo(file: IO[bytes], header: Mapping[str, Any], begin: int) -> tuple[float, float, float] | None:
    """Mean of the skin, linear Rec.709; None where the file does not tell. begin: of the arrays, bytes"""
    if not {_BOUNCE, _AMBIENT} <= header.keys():
        return None
    numbers = []
    for name in (_BOUNCE, _AMBIENT):
        file.seek(begin + header[name]["data_offsets"][0])
        numbers.append(struct.unpack("<3f", file.read(12)))
    bounce, ambient = numbers
    if any(ambient) or not any(bounce) or not all(0 <= part < math.inf for part in bounce):  # false for NaN too
        return None
    red, green, blue = (min(part / _THROWN_BACK, 1.0) for part in bounce)
    return red, green, blue


def _card(about: Mapping[str, Any], written: str, albedo: tuple[float, float, float] | None) -> Card:
    source, learned = about.get("learnt_from") or {}, about.get("learnt") or {}
    return Card(
        name=_text(about["name"]),
        license=_text(about.get("licence", "")),
        learned_from=_text(f"{source['pictures']} images of {source['capture']}") if source else "",
        written=written,
        accuracy=_accuracy(learned.get("baked") or {}) if learned else "",
        gaussians=int(about["gaussians"]),
        learned=bool(learned),
        light=_text((learned.get("light") or {}).get("kind", "learnt")),
        has_forearm=str(about.get("template")).endswith("-forearm"),
        joints_m=_joints(about.get("own_joints_m")),
        albedo=albedo,
        fist=_fist(about.get("fist")),
    )


def _joints(value: Any) -> tuple[tuple[float, float, float], ...] | None:
    if value is None:
        return None
    joints = tuple((float(x), float(y), float(z)) for x, y, z in value)
    if len(joints) != len(NAMES) or not all(math.isfinite(x) for joint in joints for x in joint):
        raise _NoCardError("its joints are no 21 places")
    return joints


def _fist(value: Any) -> kinematics.Fist:
    if value is None:
        return kinematics.NO_FIST
    turns, rooms = (tuple(map(float, value[name])) for name in ("turns_deg", "room_parts"))
    thumb = float(value["thumb_part"])
    ranges = [kinematics.FIST_TURN_RANGE_DEG] * 3 + [kinematics.FIST_ROOM_RANGE_PARTS] * 4
    within = (low <= number <= high for number, (low, high) in zip((*turns, *rooms, thumb), ranges, strict=True))
    if len(turns) != 3 or not all(within):
        raise _NoCardError("its fist is none")
    return kinematics.Fist(turns, rooms, thumb)


def _accuracy(distilled: Mapping[str, Any]) -> str:
    """What was measured of the exact tier, and on which pictures."""
    exact = [price["psnr_db"] for price in distilled.get("prices", ()) if price["tier"] == "exact"]
    return _text(f"{exact[0]:.2f} on {distilled['measured_on']}") if exact else "not measured"


def _text(value: Any) -> str:
    return " ".join(str(value).split())[:_TEXT_MAX]


# ---- hands that are chosen by picture: files NAME.jghand beside NAME.png, in a folder or in a zip --------------------
# a hand of a name is found wherever its file lies, so that a scene that has the name is the same on another machine

SUFFIX, PICTURE = ".jghand", ".png"
# bytes of a file in a zip: five times the largest hand that JGHand makes
FILE_MAX_BYTES = 40_000_000
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,40}")


@dataclass(frozen=True)
class PackedHand:
    """name: as scenes have it · file: the avatar · picture: None where it has none"""

    name: str
    file: Path
    picture: Path | None

    @property
    def title(self) -> str:
        return self.name.replace("_", " ").capitalize()


def is_name(text: str) -> bool:
    """Whether it names a hand, and is no path."""
    return _NAME.fullmatch(text) is not None


def name_of_film(film: Path) -> str:
    """The name of the hand in somebody's film: none of a hand that comes with JGHand. Films whose names hold what such
    a name cannot, or are too long, have different ones all the same."""
    plain = film.stem.lower().replace(" ", "_")
    if is_name(f"my_{plain}"):
        return f"my_{plain}"
    digits = hashlib.sha256(film.stem.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    return "my_" + f"{re.sub(r'[^a-z0-9_-]+', '_', plain)[:29]}_{digits}".lstrip("_")


def hands_in(folders: Iterable[Path]) -> list[PackedHand]:
    """Those in these folders whose files can be read, in the order of their names; the first of a name counts."""
    found: dict[str, PackedHand] = {}
    for folder in folders:
        for file in sorted(folder.glob(f"*{SUFFIX}")) if folder.is_dir() else ():
            if file.stem in found or not is_name(file.stem):
                continue
            with contextlib.suppress(JGHandFailure):
                card_of(str(file))
                picture = file.with_suffix(PICTURE)
                found[file.stem] = PackedHand(file.stem, file, picture if picture.is_file() else None)
    return [found[name] for name in sorted(found)]


def unpack(path: Path, folder: Path) -> tuple[list[str], list[str]]:
    """Puts the hands of a zip into a folder: their names, and the files that are none and were left out.

    A hand of the same name is replaced. JGHandFailure: bad_pack, for no zip or one without hands; cannot_write.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = {Path(info.filename).name: info for info in archive.infolist() if _is_wanted(info)}
            files = [name for name in sorted(entries) if name.endswith(SUFFIX)]
            if not files:
                raise JGHandFailure("bad_pack", str(path))
            broken = [name for name in files if not _unpacked(archive, entries, Path(name), folder)]
    except (zipfile.BadZipFile, RuntimeError, EOFError) as error:  # RuntimeError: encrypted, or compressed unknown
        raise JGHandFailure("bad_pack", f"{path}\n{str(error)[:200]}") from error
    except OSError as error:
        raise JGHandFailure("cannot_write", f"{folder}: {error.strerror or error}") from error
    return [Path(name).stem for name in files if name not in broken], broken


def _is_wanted(info: zipfile.ZipInfo) -> bool:
    name = Path(info.filename)
    return is_name(name.stem) and name.suffix in (SUFFIX, PICTURE) and info.file_size <= FILE_MAX_BYTES


def _unpacked(archive: zipfile.ZipFile, entries: dict[str, zipfile.ZipInfo], name: Path, folder: Path) -> bool:
    """Whether a hand is one, and now lies in the folder with its picture: whole or not at all."""
    files = [file.name for file in (name, name.with_suffix(PICTURE)) if file.name in entries]
    drafts = [folder / f"{file}.new" for file in files]
    try:
        for file, draft in zip(files, drafts, strict=True):
            draft.write_bytes(archive.read(entries[file]))
        read_card(drafts[0])  # a hand as far as that says; the renderer reads all of it
        for file, draft in zip(files, drafts, strict=True):
            draft.replace(folder / file)
    except (JGHandFailure, zipfile.BadZipFile, zlib.error):  # or its checksum is another, or it cannot be decompressed
        return False
    finally:
        for draft in drafts:
            draft.unlink(missing_ok=True)
    return True
