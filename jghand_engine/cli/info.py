"""`jghand info`: what is inside an avatar, a motion or a USD file."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from jghand_engine.avatar import SHIPPED
from jghand_engine.cli.console import say, write_figures
from jghand_engine.cli.options import FiguresFile, FormatOptions
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.avatar.learned import Learned
    from jghand_engine.avatar.tiers import Distilled

DESCRIPTION = """Say what is inside an avatar, a motion or a USD file, and what is wrong with the last.

Examples:
  jghand info hand.jghand
  jghand info builtin
  jghand info capture.npy --hand right
  jghand info dance.bvh --hand left
  jghand info demo_output/usd/hand.usda"""

FINDINGS = "what_is_wrong"
MOTION_SUFFIXES = (".npz", ".npy", ".json", ".csv", ".bvh")
USD_SUFFIXES = (".usda", ".usdc", ".usd", ".usdz")


@dataclass(frozen=True)
class Info:
    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """A .jghand avatar (or the word builtin or painted), a motion (docs/MOTION.md) or a USD file."""
    format: FormatOptions = field(default_factory=FormatOptions)
    json: FiguresFile = None

    def run(self) -> None:
        facts = self._facts()
        width = max(len(name) for name in facts)
        for name, value in facts.items():
            # whole sentences, one per line
            lines = value if name in (FINDINGS, "notes") and value else [_text(value)]
            for index, line in enumerate(lines):
                say(f"{'' if index else name.replace('_', ' '):<{width}}  {line}")
        write_figures(self.json, {"command": "info", "file": self.file, **facts})

    def _facts(self) -> dict[str, Any]:
        if self.file in SHIPPED:
            return avatar_facts(self.file)
        path = Path(self.file)
        if path.is_dir():
            return motion_facts(path, self.format)
        if not path.is_file():
            raise InputError(f"cannot find {path}", remedy="Check the name.")
        suffix = path.suffix.lower()
        if suffix == ".jghand":
            facts = avatar_facts(self.file)
        elif suffix in MOTION_SUFFIXES:
            facts = motion_facts(path, self.format)
        elif suffix in USD_SUFFIXES:
            facts = usd_facts(path)
            # a rig that moves, of another program
            if "SkelAnimation" in facts["prims"] and not facts["splats"]:
                facts = motion_facts(path, self.format)
        else:
            wanted = ", ".join((".jghand", *MOTION_SUFFIXES, *USD_SUFFIXES))
            raise InputError(f"{path}", wanted=f"a file of the kind {wanted}", came=suffix or "no suffix")
        about = path.stat()
        return {**facts, "bytes": about.st_size, "written": time.strftime("%Y-%m-%d", time.localtime(about.st_mtime))}


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_text(entry)}" for name, entry in value.items()) or "none"
    if isinstance(value, list):
        return ", ".join(_text(entry) for entry in value) or "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def avatar_facts(avatar: str) -> dict[str, Any]:
    """What an avatar is; reading it checks every value."""
    import numpy as np

    from jghand_engine.avatar.builtin import load_avatar_called
    from jghand_engine.hand.orders import hand_length

    loaded = load_avatar_called(avatar)
    extent_m = np.ptp(loaded.position_m, axis=0)
    return {
        "kind": "avatar",
        "name": loaded.info.name,
        "template": loaded.info.template,
        "license": loaded.info.license,
        "gaussians": len(loaded),
        "radius_mm": {
            "smallest": 1e3 * float(loaded.sigma_m.min()),
            "median": 1e3 * float(np.median(loaded.sigma_m)),
            "largest": 1e3 * float(loaded.sigma_m.max()),
        },
        "size_mm": [1e3 * float(edge) for edge in extent_m],
        "hand_length_mm": 1e3 * hand_length(loaded.rest_joints_m),
        "conventions": {
            "swing": loaded.info.swing,
            "scale": loaded.info.scale_mode,
            "transform": str(loaded.info.transform),
        },
        "learned_from": {} if loaded.info.learned_from is None else vars(loaded.info.learned_from),
        "angles_seen_in_training": len(loaded.info.pose_statistics),
        "learned": learned_facts(loaded),
    }


def learned_facts(avatar: HandAvatar) -> dict[str, Any]:
    """What training added to an avatar; empty for one that was painted."""
    from jghand_engine.avatar.correctives import PoseNetwork

    learned = avatar.learned
    if learned is None:
        return {}
    shape = learned.correctives.shape if isinstance(learned.correctives, PoseNetwork) else None
    return {
        "light": _light(learned),
        "correctives": "none" if shape is None else f"network of width {shape.hidden}",
        "offsets_up_to_mm": 0.0 if shape is None else 1e3 * shape.reach_m,
        "shadow": "none" if learned.shadow is None else f"gain {learned.shadow.gain:.3g}",
        "cast_shadow": "none" if learned.cast is None else f"{len(learned.cast.lamp_rgb)} lamps",
        "psnr_db": _accuracy(learned.distilled),
        "tiers": {} if learned.distilled is None else {
            **{one.name: f"{one.frame_ms:.3g} ms, {one.lost_db:.2f} dB lost" for one in learned.distilled.prices},
            "measured on": learned.distilled.measured_on,
        },
    }  # fmt: skip


def _light(learned: Learned) -> str:
    if learned.response is None:
        return f"that of its capture, {len(learned.light.lobe_sharpness)} lobes of gloss"
    if learned.response.film_light is not None:
        return "estimated with the skin: that of its film, or of any scene"
    counts = ", ".join(f"{name} {count}" for name, count in learned.response.trained_on.items())
    return f"known: that of any scene{f'; learned from {counts}' if counts else ''}"


def _accuracy(distilled: Distilled | None) -> str:
    """What was measured of the exact tier, and on which pictures."""
    from jghand_engine.avatar.tiers import Tier

    prices = [] if distilled is None else [one.psnr_db for one in distilled.prices if one.name == Tier.EXACT]
    return f"{prices[0]:.2f} on {distilled.measured_on}" if distilled is not None and prices else "not measured"


def motion_facts(path: Path, options: FormatOptions) -> dict[str, Any]:
    """What a motion is: length, hand, gaps, and how much its bones wobble."""
    import numpy as np

    from jghand_engine.cli.inputs import read_file
    from jghand_engine.hand.orders import hand_length

    read = read_file(path, options)
    sequence = read.sequence
    lengths_m = sequence.bone_lengths_m
    return {
        "kind": "motion",
        "format": read.kind,
        "hand": str(sequence.handedness),
        "frames": len(sequence),
        "fps": sequence.fps,
        "seconds": sequence.duration_s,
        "frames_with_missing_joints": len(sequence.gaps.frames),
        "filled_frames": int(sequence.filled.sum()),
        "hand_length_mm": 1e3 * hand_length(sequence.joints_m),
        "bone_length_wobble_mm": 1e3 * float(np.nanmax(np.nanstd(lengths_m, axis=0))),
        "notes": list(read.notes),
    }


def usd_facts(path: Path) -> dict[str, Any]:
    """What a USD stage holds: times, units, variants, how many prims of each type, and what is wrong with it."""
    from jghand_engine.export.usd.check import stage_facts

    facts = stage_facts(path)
    findings = facts.pop("findings")
    return {"kind": "usd", **facts, FINDINGS: findings}
