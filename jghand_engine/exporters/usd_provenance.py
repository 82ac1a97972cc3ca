"""What a stage says about where it comes from, and how one knows whether it is still as it was written."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import torch
from pxr import Sdf, Tf

from jghand_engine import __version__
from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.avatar.correctives import PoseNet
from jghand_engine.avatar.tiers import CachedNet
from jghand_engine.datasets.usd_files import TEXT
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.hand.sequence import PoseSequence

CREATOR = "JGHand"
_SEAL = re.compile(rb"# as JGHand wrote it: ([0-9a-f]{64})\n\Z")


def made_from(avatar: HandAvatar, sequence: PoseSequence) -> dict[str, str]:
    """What tells whether a stage is still that of an avatar and a motion: SHA-256 of all that an avatar's Gaussians
    follow from, and of the joints (F, 21, 3) float32 little-endian metres in standard order, and the engine's
    version."""
    joints_m = from_level(sequence.joints_m, JointOrder.STANDARD).astype("<f4")
    return {
        "engine_version": __version__,
        "avatar_sha256": _digest_of(avatar),
        "joints_sha256": hashlib.sha256(joints_m.tobytes()).hexdigest(),
    }


def _digest_of(avatar: HandAvatar) -> str:
    """Not of its names, nor of cheaper tiers and what they cost, nor of the hand that it is driven by."""
    digest = hashlib.sha256()
    tensors = (avatar.position_m, avatar.sigma_m, avatar.opacity, avatar.rgb, avatar.bone_weights)
    info = avatar.info
    learnt = None if avatar.learnt is None else replace(avatar.learnt, baked=None)
    for value in (*tensors, avatar.canonical_joints_m, info.swing, info.scale_mode, str(info.transform), learnt):
        _feed(digest, value)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    """Adds a value, and all that it holds in its order, to a digest of hashlib."""
    if isinstance(value, torch.Tensor):
        digest.update(f"{value.dtype} {tuple(value.shape)} ".encode())
        digest.update(value.detach().cpu().contiguous().numpy().tobytes())
    elif isinstance(value, CachedNet):
        _feed(digest, value.net)
    elif isinstance(value, torch.nn.Module):
        for name, tensor in value.state_dict().items():
            digest.update(name.encode())
            _feed(digest, tensor)
        _feed(digest, value.shape if isinstance(value, PoseNet) else None)
    elif is_dataclass(value):
        for entry in fields(value):
            digest.update(entry.name.encode())
            _feed(digest, getattr(value, entry.name))
    else:
        digest.update(f"{value!r} ".encode())


def provenance(info: AvatarInfo, stamp: Mapping[str, str]) -> dict[str, Any]:
    """customLayerData of every layer: who wrote it, of what, under which licence. stamp: what it was made from."""
    learnt_from = info.learnt_from
    about = {**stamp, "avatar": info.name, "template": info.template, "licence": info.licence}
    if learnt_from is not None:
        about |= {
            "learnt_from": learnt_from.capture,
            "learnt_from_pictures": learnt_from.pictures,
            "learnt_from_digest": learnt_from.digest,
        }
    return {"creator": f"{CREATOR} {__version__}", "jghand": about}


def seal(path: Path) -> None:
    """Adds a comment to a text layer by which `is_as_written` knows it. A program that saves the layer drops it."""
    content = path.read_bytes()
    with path.open("ab") as stream:
        stream.write(f"# as {CREATOR} wrote it: {hashlib.sha256(content).hexdigest()}\n".encode())


def is_as_written(path: Path) -> bool:
    """Whether a file is an export's, and no text layer that somebody has changed since, as one puts lights into the
    shot. Of binary files, which nobody edits by hand, it asks only who made them."""
    try:
        content = path.read_bytes() if path.suffix == ".usda" else b""
    except OSError:  # cannot be looked at
        return False
    if content.startswith(TEXT):
        last = _SEAL.search(content)
        return last is not None and hashlib.sha256(content[: last.start()]).hexdigest() == last.group(1).decode()
    try:
        layer = Sdf.Layer.OpenAsAnonymous(str(path), True)
    except Tf.ErrorException:
        return False
    return layer is not None and str(layer.customLayerData.get("creator", "")).startswith(f"{CREATOR} ")
