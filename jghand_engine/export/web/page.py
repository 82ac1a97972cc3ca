"""A motion as a web page: one folder that opens in a browser by a double click, from a disk as from a server.

    index.html     the page
    hand.js        this hand: its Gaussians, what poses them, and the joints of every frame     web_hand, web_pack
    pose.js        the engine's kernels as WebAssembly, and the little around them
    viewer.js      what draws, with three.js
    LICENSES.txt   of the scripts

All but hand.js are made by scripts/build_web_viewer.py and are the same for every hand. The page loads nothing from
anywhere: scripts that a page may load from a disk, where it may read no other files, carry the data as text.

The skin is posed in the browser by the same code as here, so that sliders can pose it too, and drawn as this project's
rasterizer draws it. Left out is the self-shadow in the picture (METHOD 5); the page of a hand whose shadow
would be seen says so.
"""

from __future__ import annotations

import html
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine import __version__
from jghand_engine.avatar.avatar import HandAvatar, check_follows_joints
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.errors import InputError, RetryError
from jghand_engine.export.web.hand import pack_hand, with_cheap_correctives
from jghand_engine.export.web.pack import Pack
from jghand_engine.files import make_folder, write_file
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import ABDUCTION_SIDE, RANGES_DEG, ArticulatedHand
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.sequence import PoseSequence, bone_directions, rebuilt
from jghand_engine.hand.shapes import angles_on, named_angles, pose_names
from jghand_engine.native import contract
from jghand_engine.render.framing import FILL, FOCAL, framing_camera, skin_radii_m

ASSETS = Path(__file__).resolve().parents[2] / "assets" / "web"
PAGE, HAND = "index.html", "hand.js"
SCRIPTS = ("pose.js", "viewer.js", "LICENSES.txt")
# ten minutes at 60 frames a second take 12 MB of the page
FRAMES_MAX = 36_000
# letters of the page's title: one line
TITLE_MAX = 120
# the marks stand in the first 200 bytes
MARK_BYTES = 1000
# by these in its first MARK_BYTES a file is known as ours, and may be replaced: each by its own, so that an export
# that was stopped half-way can be tried again
_MARKS = {
    PAGE: '<meta name="generator" content="JGHand">',
    HAND: "globalThis.JGHAND_HAND={",
    "pose.js": "/*! JGHand, MIT: see LICENSES.txt.",
    "viewer.js": "/*! three.js and JGHand's viewer, MIT: see LICENSES.txt */",
    "LICENSES.txt": "What the scripts of this folder are made of.",
}


@dataclass(frozen=True)
class WebView:
    """From where the page shows the hand at first. to_eye, up: (3,) directions in the world of the motion · focal:
    focal length over the longer edge · reach_m: (21,) how far around each joint the skin must be in sight"""

    to_eye: tuple[float, float, float]
    up: tuple[float, float, float]
    focal: float
    reach_m: tuple[float, ...]

    @classmethod
    def of_motion(cls, joints_m: np.ndarray, handedness: Handedness, view: str) -> WebView:
        """So that (F, 21, 3) level-order joints are seen from a named side, whatever the page's size. view: a key of
        VIEWS, else InputError."""
        camera = framing_camera(joints_m, handedness, view, width=1024, height=1024)
        _, down, forward = camera.camera_from_world[:3, :3].tolist()
        to_eye, up = (-x for x in forward), (-x for x in down)
        return cls((*to_eye,), (*up,), FOCAL, tuple(skin_radii_m(joints_m).tolist()))


@dataclass(frozen=True)
class WebOptions:
    """title: of the page; empty: the avatar's name · gaussians: how many of the avatar's are shown, 0 for all"""

    title: str = ""
    gaussians: int = 0

    def __post_init__(self) -> None:
        if len(self.title) > TITLE_MAX or not self.title.isprintable():
            wanted = f"at most {TITLE_MAX} letters on one line"
            raise InputError("title of the page", wanted=wanted, came=repr(self.title[:200]))
        if self.gaussians < 0:
            raise InputError("number of Gaussians", wanted="0 (all) or a positive count", came=str(self.gaussians))


@dataclass(frozen=True)
class WebReport:
    """What an export did. page: what to open · bytes: by file name · correctives: linear, network or none"""

    page: Path
    frames: int
    gaussians: int
    correctives: str
    bytes: dict[str, int]


def export_web(
    folder: Path | str, avatar: HandAvatar, sequence: PoseSequence, view: WebView, options: WebOptions | None = None
) -> WebReport:
    """Writes the page into `folder`; an earlier page of JGHand is replaced, other files stay.

    Each file is whole or as it was; index.html comes last. Raises InputError for a motion with gaps or too long, an
    avatar that the page cannot pose, and a folder with files of somebody else under one of these names.
    """
    options = options or WebOptions()
    check_follows_joints(avatar)
    sequence.without_gaps()
    if len(sequence) > FRAMES_MAX:
        raise InputError(
            "motion for a web page", wanted=f"at most {FRAMES_MAX} frames", came=f"{len(sequence)}",
            remedy="Show a part of it with --frames.",
        )  # fmt: skip
    hand = avatar.with_stiff_wrist().for_hand(sequence.handedness)
    shown, correctives = with_cheap_correctives(hand.prefix(options.gaussians))
    title = options.title or avatar.info.name
    contents = {
        HAND: hand_script(shown, sequence, view),
        **{name: asset(name) for name in SCRIPTS},
        PAGE: asset(PAGE).replace("@TITLE@", html.escape(title)),
    }
    target = make_folder(folder)
    _refuse_others(target)
    sizes = {}
    for name, text in contents.items():
        content = text.encode()
        write_file(target / name, content)
        sizes[name] = len(content)
    return WebReport(target / PAGE, len(sequence), len(shown), correctives, sizes)


def hand_script(avatar: HandAvatar, sequence: PoseSequence, view: WebView) -> str:
    """The content of hand.js. avatar: of the hand that the sequence names, with the correctives to be computed."""
    pack = Pack()
    about = pack_hand(avatar, pack)
    # a hand far from the origin would lose its precision on the graphics card
    origin_m = sequence.joints_m[:, 0].mean(0)
    pack.exact("motion", sequence.joints_m - origin_m, "f4")
    info, scale = avatar.info, float(avatar.skeleton().bones(sequence.joints_m[0]).scale)
    description = about | {
        "name": info.name, "license": info.license, "handedness": str(avatar.handedness), "gaussians": len(avatar),
        "learned_from": None if info.learned_from is None else _learned_from(avatar),
        "notes": _notes(avatar, sequence), "made_by": f"Made by JGHand {__version__}",
        "fps": sequence.fps, "origin_m": origin_m.tolist(), "articulated": _articulated(avatar, sequence),
        "view": {"to_eye": view.to_eye, "up": view.up, "focal": view.focal, "fill": FILL},
        "reach_m": view.reach_m, "contract": _contract(avatar.pixel_m * scale), "arrays": pack.about,
    }  # fmt: skip
    # a script may not end inside a text, wherever the page puts it
    text = json.dumps(description, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
    return f'globalThis.JGHAND_HAND={{description:{text},arrays:"{pack.packed()}"}};\n'


def asset(name: str) -> str:
    """A file that is the same for every hand. RetryError when this installation lacks it."""
    try:
        return (ASSETS / name).read_text(encoding="utf-8")
    except OSError as error:
        raise RetryError(
            f"cannot read {ASSETS / name}: {error.strerror}", remedy="Install JGHand anew."
        ) from error  # fmt: skip


def _contract(pixel_m: float) -> dict[str, float]:
    """How the rasterizer draws (RENDERING 3): its low pass, at least and where the hand is, and its limits."""
    blur = {"blur_px2": contract.BLUR_PX2, "low_pass_m2": contract.BLUR_PX2 * pixel_m**2}
    limits = ("alpha_min", "alpha_max", "front_min", "cover_from", "cover_whole", "z_near_m")
    return blur | {name: getattr(contract, name.upper()) for name in limits}


def _learned_from(avatar: HandAvatar) -> str:
    learned_from = avatar.info.learned_from
    return "" if learned_from is None else f"{learned_from.pictures} pictures of {learned_from.capture}"


def _notes(avatar: HandAvatar, sequence: PoseSequence) -> list[str]:
    turns = avatar.has_forearm and sequence.forearm is not None
    notes = ["Not shown here: how the forearm turns, which goes with the palm."] if turns else []
    shadow = ShadowLook() if avatar.learned is None else avatar.learned.shadow
    if shadow is None or not shadow.is_seen:
        return notes
    return [*notes, "Not shown here: the faint shadow of close fingers that JGHand's own renderer adds."]


def _articulated(avatar: HandAvatar, sequence: PoseSequence) -> dict[str, Any]:
    """The canonical hand with straight fingers, as pose.js poses hands by angles; fingers that touch in a pose do so at
    the bone lengths of the motion's first frame."""
    canonical = avatar.canonical_joints_m
    lengths_m = bone_lengths(sequence.joints_m[:1])[0]
    scale = lengths_m.sum() / bone_lengths(canonical[None])[0].sum()
    resized = rebuilt(canonical[None, 0], bone_directions(canonical[None]), lengths_m / scale)[0]
    hand = ArticulatedHand(resized)
    bones_m = hand.straight_joints_m[6:] - hand.straight_joints_m[1:16]
    straight = (bones_m / np.linalg.norm(bones_m, axis=1, keepdims=True)).reshape(3, 5, 3)
    return {
        "straight": straight.tolist(),
        "flexion": hand.flexion_axes.tolist(), "abduction": hand.abduction_axes.tolist(),
        "side": ABDUCTION_SIDE.tolist(),
        "ranges_deg": RANGES_DEG.tolist(), "curled_deg": named_angles("fist").tolist(),
        "poses_deg": {name: np.round(angles_on(hand, name), 3).tolist() for name in pose_names()},
    }  # fmt: skip


def _refuse_others(folder: Path) -> None:
    """InputError when the folder holds files of a page's names that no export of ours wrote."""
    others = [name for name, mark in _MARKS.items() if os.path.lexists(folder / name) and not _has(folder / name, mark)]
    if others:
        raise InputError(
            f"folder {folder}", wanted="an empty folder, or one with a page that JGHand wrote",
            came=f"one with {', '.join(others)} of somebody else", remedy="Choose another folder.",
        )  # fmt: skip


def _has(file: Path, mark: str) -> bool:
    try:
        with file.open("rb") as stream:
            return mark.encode() in stream.read(MARK_BYTES)
    except OSError:
        return False
