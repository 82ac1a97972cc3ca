"""The .jghand file: one avatar as safetensors with a JSON description. Reading it never runs code.

The safetensors metadata holds one key, `jghand`, a JSON object: format_version, name, template, licence, units (the
word metres), handedness, joint_names (the order of the joints and of the weight columns), swing, scale_mode, transform,
storage, gaussians, position_box_m, pose_statistics. own_joints_m, which may be left out, are its joints in standard
order; fist, which may be, too, is that of `HandAvatar`; so may checksum, the CRC-32 of the bytes of all arrays, in the
order of their names. A scale mode is a name or
the number of the blended one. transform is that of `AvatarInfo`; `joints` where it is left out. learnt_from, which may
be left out, is its `learned_from`. The arrays are those of `storage.expected_arrays` and canonical_joints_m (21, 3)
float64. Files keep the standard joint order; the engine's level order ends here.

A trained avatar has format_version 2, a description `learnt` and the arrays of `learned_storage`. One that was learned
in known light has version 3: older JGHands refuse it, who would draw its albedo as its colors. One with a detail,
trained or not, has version 4, a description `detail` and the arrays of `detail_storage`; one whose detail has a relief,
correctives, or the hand's end version 5. Avatars that were not trained are still written as version 1.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar, LearnedFrom
from jghand_engine.avatar.detail_storage import DetailAbout, expected_detail_arrays, pack_detail, unpack_detail
from jghand_engine.avatar.learned_storage import LearnedAbout, expected_learned_arrays, pack_learned, unpack_learned
from jghand_engine.avatar.relighting import thrown_back
from jghand_engine.avatar.storage import (
    ARRAY_NAMES,
    Arrays,
    Storage,
    expected_arrays,
    pack,
    unpack,
)
from jghand_engine.avatar.validation import (
    AVATAR_MAX_GAUSSIANS,
    AVATAR_TEXT_MAX,
    REMEDY,
    check_avatar,
    check_finite,
    is_text,
)
from jghand_engine.errors import InputError
from jghand_engine.files import writing
from jghand_engine.hand.joints import JOINT_COUNT, STANDARD_NAMES, Handedness
from jghand_engine.hand.kinematics import FIST_ROOM_RANGE_PARTS, FIST_TURN_RANGE_DEG, NO_FIST, Fist
from jghand_engine.hand.orders import JointOrder, from_level, to_level
from jghand_engine.hand.skeleton import ScaleMode, Swing, Transform, scale_exponent
from jghand_engine.json_files import JsonObject

FORMAT_VERSION = 5
# the newest without what came last of a detail (a relief, correctives, the hand's end), without a detail, without a
# known light, and without anything learned
DETAIL_VERSION, LIT_VERSION, LEARNED_VERSION, PAINTED_VERSION = 4, 3, 2, 1
METADATA_KEY = "jghand"


def save_avatar(path: Path | str, avatar: HandAvatar, *, storage: Storage = Storage.EXACT) -> None:
    """Writes `avatar` to `path`, whole or not at all.

    What `load_avatar` gives back is `stored_form(avatar, storage)`, bit for bit: the file is read once before it gets
    its name. InputError if the avatar cannot be rendered or would not be read, or if the path cannot be written;
    RetryError if the disk is full.
    """
    thing = f"avatar for {path}"
    check_avatar(avatar, thing)
    packed, box_m = pack(_arrays(avatar), storage, linear=_is_linear(avatar))
    joints_m = from_level(avatar.canonical_joints_m, JointOrder.STANDARD)
    packed["canonical_joints_m"] = np.ascontiguousarray(joints_m, np.float64)
    description: dict[str, Any] = {
        "format_version": _version(avatar),
        "name": avatar.info.name,
        "template": avatar.info.template,
        "licence": avatar.info.license,
        "units": "metres",
        "handedness": avatar.handedness.value,
        "joint_names": list(STANDARD_NAMES),
        "swing": avatar.info.swing,
        "scale_mode": avatar.info.scale_mode,
        "transform": avatar.info.transform,
        "storage": storage.value,
        "gaussians": len(avatar),
        "position_box_m": box_m,
        "pose_statistics": {name: list(range_) for name, range_ in avatar.info.pose_statistics.items()},
    }
    if avatar.own_joints_m is not None:
        description["own_joints_m"] = from_level(avatar.own_joints_m, JointOrder.STANDARD).tolist()
    if avatar.fist != NO_FIST:
        description["fist"] = asdict(avatar.fist)
    if avatar.info.learned_from is not None:
        description["learnt_from"] = asdict(avatar.info.learned_from)
    if avatar.learned is not None:
        description["learnt"] = asdict(LearnedAbout.of(avatar.learned))
        packed |= pack_learned(avatar.learned, storage)
    if avatar.detail is not None:
        arrays, about = pack_detail(avatar.detail, storage)
        packed |= arrays
        description["detail"] = about.as_dict()
    description["checksum"] = _checksum(packed)
    try:
        text = json.dumps(description, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(
            f"{thing}: its description", wanted="texts and finite numbers", came=f"{error}"[:200]
        ) from error
    with writing(path) as temporary:
        temporary.write_bytes(safetensors.numpy.save(packed, metadata={METADATA_KEY: text}))
        try:
            _load(temporary, thing)
        except InputError as error:
            raise InputError(error.thing, wanted=error.wanted, came=error.came, remedy="Change it and save.") from error


def stored_form(avatar: HandAvatar, storage: Storage) -> HandAvatar:
    """The avatar that a reader gets back when `avatar` is saved with `storage`."""
    packed, box_m = pack(_arrays(avatar), storage, linear=_is_linear(avatar))
    stored = _avatar(avatar.info, avatar.handedness, avatar.canonical_joints_m, unpack(packed, storage, box_m))
    stored = replace(stored, own_joints_m=avatar.own_joints_m, fist=avatar.fist)
    if avatar.detail is not None:
        stored = replace(stored, detail=unpack_detail(*pack_detail(avatar.detail, storage), avatar.info.name))
    if avatar.learned is None:
        return stored
    return _with_learned(stored, pack_learned(avatar.learned, storage), LearnedAbout.of(avatar.learned))


def load_avatar(path: Path | str) -> HandAvatar:
    """Reads and checks an avatar. InputError names the file, what is wrong with it and what to do."""
    return _load(Path(path), str(path))


def _load(file: Path, thing: str) -> HandAvatar:
    """`load_avatar`, which errors call `thing`."""
    try:
        # safetensors calls a file that may not be read missing, and a folder a device
        file.open("rb").close()
        with safetensors.safe_open(file, framework="numpy") as content:
            about = _Description(thing, (content.metadata() or {}).get(METADATA_KEY))
            packed = _read_arrays(thing, content, about)
            is_damaged = about.checksum is not None and about.checksum != _checksum(packed)
            check_finite(packed, thing)
    except safetensors.SafetensorError as error:
        raise InputError(thing, wanted="a .jghand file", came=f"{error}"[:200], remedy=REMEDY) from error
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        came = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"cannot read {thing}", came=came, remedy="Check the name and that you may read it."
        ) from error
    joints_m = to_level(packed.pop("canonical_joints_m"), JointOrder.STANDARD)
    if about.storage is Storage.COMPACT and int(packed["weight_bone"].max()) >= JOINT_COUNT:
        came = str(int(packed["weight_bone"].max()))
        raise InputError(f"{thing}: weight_bone", wanted=f"bones 0 to {JOINT_COUNT - 1}", came=came, remedy=REMEDY)
    plain = {name: packed.pop(name) for name in expected_arrays(about.storage, linear=about.is_linear)}
    avatar = _avatar(about.info, about.handedness, joints_m, unpack(plain, about.storage, about.box_m))
    avatar = replace(avatar, own_joints_m=about.own_joints_m, fist=about.fist)
    if about.learned is not None:
        avatar = _with_learned(avatar, packed, about.learned)
    if about.detail is not None:
        avatar = replace(avatar, detail=unpack_detail(packed, about.detail, thing))
    check_avatar(avatar, thing)
    # what can be said in more words was said by then
    if is_damaged:
        raise InputError(thing, wanted="the numbers that were written", came="some others", remedy=REMEDY)
    return avatar


class _Description:
    """The checked JSON description of a file; InputError names the field that is missing or wrong."""

    def __init__(self, thing: str, text: str | None) -> None:
        def wrong(name: str, wanted: str, came: object) -> InputError:
            return InputError(f"{thing}: {name}", wanted=wanted, came=repr(came)[:200], remedy=REMEDY)

        try:
            content = json.loads(text) if text is not None else None
        except (ValueError, RecursionError) as error:
            raise wrong("its description", "JSON", str(error)) from error
        if not isinstance(content, dict):
            raise wrong("its description", "the metadata of a .jghand file", "none")
        of = JsonObject(content, wrong)
        if of.count("format_version", 1, 2**31) > FORMAT_VERSION:
            raise InputError(
                f"{thing}: format version",
                wanted=f"at most {FORMAT_VERSION}, the newest this JGHand knows",
                came=str(content["format_version"]),
                remedy="The file was written by a newer JGHand: update JGHand.",
            )
        of.one_of("units", ("metres",))
        of.value("joint_names", lambda names: names == list(STANDARD_NAMES), "the 21 joints in standard order")
        self.storage = Storage(of.one_of("storage", tuple(Storage)))
        self.handedness = Handedness(of.one_of("handedness", tuple(Handedness)))
        self.gaussians = of.count("gaussians", 1, AVATAR_MAX_GAUSSIANS)
        box_m = of.array("position_box_m", (2, 3))
        if not (np.abs(box_m) <= _FINITE_MAX).all():
            raise of.wrong("position_box_m", "two corners of three finite numbers")
        self.box_m = box_m.tolist()
        self.info = AvatarInfo(
            name=_text(of, "name"),
            template=_text(of, "template"),
            license=_text(of, "licence"),
            swing=of.one_of("swing", tuple(Swing)),
            scale_mode=_scale_mode(of),
            transform=Transform(of.one_of("transform", tuple(Transform), "joints")),
            pose_statistics=_pose_statistics(of),
            learned_from=_learned_from(of.object("learnt_from")),
        )
        self.checksum = of.count("checksum", 0, 2**32 - 1) if "checksum" in content else None
        self.own_joints_m = None
        if "own_joints_m" in content:
            self.own_joints_m = to_level(of.array("own_joints_m", (JOINT_COUNT, 3)), JointOrder.STANDARD)
        self.fist = _fist(of.object("fist"))
        version = content["format_version"]
        is_learned = PAINTED_VERSION < version <= LIT_VERSION or (version > LIT_VERSION and "learnt" in content)
        learned = of.needed("learnt") if is_learned else None
        self.detail = DetailAbout.parsed(of.needed("detail")) if version > LIT_VERSION else None
        self.learned = None if learned is None else LearnedAbout.parsed(learned)
        self.is_linear = self.learned is not None and self.learned.light.is_known


def _text(of: JsonObject, name: str) -> str:
    return of.value(name, is_text, f"a text of one line, at most {AVATAR_TEXT_MAX} characters")


def _scale_mode(of: JsonObject) -> ScaleMode:
    value: Any = of.fields.get("scale_mode")
    try:
        scale_exponent(value)
    except InputError as error:
        raise of.wrong("scale_mode", error.wanted) from error
    return value


def _fist(of: JsonObject | None) -> Fist:
    if of is None:
        return NO_FIST
    turns_deg = of.numbers("turns_deg", 3, *FIST_TURN_RANGE_DEG)
    room_parts = of.numbers("room_parts", 3, *FIST_ROOM_RANGE_PARTS)
    return Fist(turns_deg, room_parts, of.number("thumb_part", *FIST_ROOM_RANGE_PARTS))


def _learned_from(of: JsonObject | None) -> LearnedFrom | None:
    if of is None:
        return None
    pixel_m = of.number("pixel_m", 0.0, PIXEL_MAX_M) if "pixel_m" in of.fields else 0.0
    return LearnedFrom(
        _text(of, "capture"), _text(of, "split"), of.count("pictures", 1, 2**53), _text(of, "digest"), pixel_m
    )


def _pose_statistics(of: JsonObject) -> dict[str, tuple[float, float]]:
    statistics = of.inner(of.fields.get("pose_statistics"), "pose_statistics")
    for name in statistics.fields:
        if not is_text(name):
            raise of.wrong("pose_statistics", f"names of at most {AVATAR_TEXT_MAX} characters")
    ranges = {name: statistics.numbers(name, 2, -_FINITE_MAX, _FINITE_MAX) for name in statistics.fields}
    for name, (low, high) in ranges.items():
        if low > high:
            raise statistics.wrong(name, "minimum and maximum")
    return {name: (low, high) for name, (low, high) in ranges.items()}


# what a float64 holds with room to calculate
_FINITE_MAX = 1e300
# meters; coarser pixels show no hand
PIXEL_MAX_M = 0.1


def _read_arrays(thing: str, content: Any, about: _Description) -> dict[str, np.ndarray]:
    """All arrays of a file; their names, types and shapes are checked before any is read."""
    plain = expected_arrays(about.storage, linear=about.is_linear)
    wanted = {name: (dtype, (about.gaussians, *rest)) for name, (dtype, rest) in plain.items()}
    wanted["canonical_joints_m"] = ("F64", (JOINT_COUNT, 3))
    if about.learned is not None:
        wanted |= expected_learned_arrays(about.learned, about.gaussians, about.storage)
    if about.detail is not None:
        wanted |= expected_detail_arrays(about.detail, about.storage)
    names = set(content.keys())
    if names != set(wanted):
        missing, unknown = sorted(set(wanted) - names), sorted(names - set(wanted))
        came = f"missing {missing}, unknown {unknown}"
        raise InputError(f"{thing}: arrays", wanted=", ".join(sorted(wanted)), came=came[:300], remedy=REMEDY)
    for name, (dtype, shape) in wanted.items():
        part = content.get_slice(name)
        came = (part.get_dtype(), tuple(part.get_shape()))
        if came != (dtype, shape):
            raise InputError(f"{thing}: {name}", wanted=f"{dtype} {shape}", came=f"{came[0]} {came[1]}", remedy=REMEDY)
    return {name: content.get_tensor(name) for name in wanted}


def _checksum(arrays: Arrays) -> int:
    """Of damage: it does not say who wrote them."""
    checksum = 0
    for name in sorted(arrays):
        checksum = zlib.crc32(np.ascontiguousarray(arrays[name]).data, checksum)
    return checksum


def _is_linear(avatar: HandAvatar) -> bool:
    return avatar.learned is not None and avatar.learned.response is not None


def _version(avatar: HandAvatar) -> int:
    if avatar.detail is not None:
        detail = avatar.detail
        is_old = detail.relief is None and detail.correctives is None and not detail.ends_hand
        return DETAIL_VERSION if is_old else FORMAT_VERSION
    if avatar.learned is None:
        return PAINTED_VERSION
    return LIT_VERSION if _is_linear(avatar) else LEARNED_VERSION


def _arrays(avatar: HandAvatar) -> Arrays:
    return {name: np.asarray(getattr(avatar, name), np.float32) for name in ARRAY_NAMES}


def _avatar(info: AvatarInfo, handedness: Handedness, joints_m: np.ndarray, arrays: Arrays) -> HandAvatar:
    values: dict[str, Any] = {name: np.ascontiguousarray(arrays[name]) for name in ARRAY_NAMES}
    return HandAvatar(info, handedness, np.asarray(joints_m, np.float64), **values)


def _with_learned(avatar: HandAvatar, packed: dict[str, np.ndarray], about: LearnedAbout) -> HandAvatar:
    bounce = thrown_back(avatar, avatar.rgb)
    return replace(avatar, learned=unpack_learned(packed, about, avatar.canonical_joints_m, bounce))
