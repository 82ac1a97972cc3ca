"""What an export was made from, as digests, whatever its format."""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from jghand_engine import __version__
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.hand.sequence import PoseSequence


def made_from(avatar: HandAvatar, sequence: PoseSequence) -> dict[str, str]:
    """What tells whether a stage is still that of an avatar and a motion: SHA-256 of all that an avatar's Gaussians
    follow from, and of the joints (F, 21, 3) float32 little-endian meters in standard order, of how a forearm is turned
    (F, 4) where the motion says it, and the engine's version."""
    numbers = {"joints": from_level(sequence.joints_m, JointOrder.STANDARD)}
    if sequence.forearm is not None:
        numbers["forearm"] = sequence.forearm
    digests = {f"{name}_sha256": hashlib.sha256(each.astype("<f4").tobytes()) for name, each in numbers.items()}
    return {
        "engine_version": __version__,
        "avatar_sha256": _digest_of(avatar),
        **{name: digest.hexdigest() for name, digest in digests.items()},
    }


def _digest_of(avatar: HandAvatar) -> str:
    """Not of its names, nor of cheaper tiers and what they cost, nor of the hand that it is driven by."""
    digest = hashlib.sha256()
    arrays = (avatar.position_m, avatar.sigma_m, avatar.opacity, avatar.rgb, avatar.bone_weights)
    info = avatar.info
    learned = None if avatar.learned is None else replace(avatar.learned, distilled=None)
    for value in (*arrays, avatar.canonical_joints_m, info.swing, info.scale_mode, str(info.transform), learned):
        _feed(digest, value)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype} {value.shape} ".encode() + value.tobytes())
    elif isinstance(value, dict):
        for name, entry in value.items():
            digest.update(name.encode())
            _feed(digest, entry)
    elif is_dataclass(value):
        for entry in fields(value):
            digest.update(entry.name.encode())
            _feed(digest, getattr(value, entry.name))
    else:
        digest.update(f"{value!r} ".encode())
