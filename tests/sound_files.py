"""A sound file of every kind that is read, for tests that damage it."""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import motion_samples as samples
import numpy as np
from hand import sampled_hands as hands
from mano_samples import mano_fields, mano_objects, python2_pickle
from small_avatars import ellipsoid_avatar, known_avatar, trained_avatar

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_painted
from jghand_engine.avatar.correctives import LinearCorrectives
from jghand_engine.avatar.file import load_avatar, save_avatar
from jghand_engine.avatar.storage import Storage
from jghand_engine.avatar.tiers import Distilled, Price, Tier
from jghand_engine.errors import InputError
from jghand_engine.export.camera_file import read_camera
from jghand_engine.export.usd.check import check_usd
from jghand_engine.export.usd.package import UsdOptions, export_usd
from jghand_engine.export.usd.stage import Variant
from jghand_engine.export.video import write_video
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.motion.content import MotionFormat
from jghand_engine.motion.files import write_motion
from jghand_engine.motion.read import read_motion_file
from jghand_engine.template.builtin import ASSETS, load_fields
from jghand_engine.template.mano import read_mano
from jghand_engine.track.video import open_video, read_frames

sys.path.insert(0, str(Path(__file__).parent / "export"))
from usd_samples import lively_motion, small_avatar

TOLD = MotionFormat(JointOrder.STANDARD, "m", Handedness.RIGHT, 30.0)
CAMERA = {
    "width": 64, "height": 48, "fx": 90.0, "fy": 90.0, "cx": 32.0, "cy": 24.0,
    "camera_from_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]],
}  # fmt: skip


def distilled_avatar() -> HandAvatar:
    """A trained avatar with a linear tier."""
    avatar, g = trained_avatar(50), np.random.default_rng(3)
    assert avatar.learned is not None
    net: Any = avatar.learned.correctives
    channels = net.shape.angle_channels
    linear = LinearCorrectives(
        net.angles,
        np.zeros(channels, np.float32),
        g.standard_normal((channels, channels), np.float32),
        np.zeros((50, 6), np.float32),
        g.integers(-127, 128, (50, channels, 6), np.int8),
        np.full((50, 2), 1e-5, np.float32),
    )
    prices = (Price(Tier.EXACT, 0, 9.0, 0.1, 30.0, 0.0), Price(Tier.LINEAR, channels, 1.0, 0.1, 29.9, 0.1))
    return replace(avatar, learned=replace(avatar.learned, distilled=Distilled(linear, prices, "pictures")))


def painted() -> HandAvatar:
    return load_painted(handedness=Handedness.RIGHT).prefix(50)


def avatar_bytes(path: Path, avatar: HandAvatar, storage: Storage = Storage.EXACT) -> bytes:
    save_avatar(path, avatar, storage=storage)
    return path.read_bytes()


def motion_bytes(path: Path) -> bytes:
    motion = pose_sequence_of_names(("open",), hands.canonical_np(), handedness=Handedness.RIGHT)
    if path.suffix == ".npy":
        np.save(path, from_level(motion.joints_m, JointOrder.STANDARD))
    else:
        write_motion(path, motion)
    return path.read_bytes()


def bvh_bytes(path: Path) -> bytes:
    samples.write_bvh(path, samples.rig(samples.motion(frames=6)))
    return path.read_bytes()


def foreign_json(kind: str) -> bytes:
    motion = samples.motion(frames=6)
    joints = samples.standard(motion)
    return json.dumps({
        "mediapipe": lambda: samples.mediapipe_tasks(joints),
        "openpose": lambda: samples.openpose_frame(joints[0]),
        "iwer": lambda: samples.iwer_recording(motion),
        "webxr": lambda: {"frames": [{"right": frame} for frame in samples.webxr_joints(motion).tolist()]},
        "interhand": lambda: samples.interhand_document(motion),
    }[kind]()).encode()  # fmt: skip


def usd_bytes(path: Path) -> bytes:
    """A skinned hand in one file: what is lied about in it shows when values are read, not when it is opened."""
    package = "usdz" if path.suffix == ".usdz" else "usdc"
    options = UsdOptions(package=package, default_variant=Variant.MESH)
    report = export_usd(path.parent, small_avatar(), lively_motion(Handedness.RIGHT, 2), options=options)
    return report.stage.read_bytes()


def film_bytes(path: Path) -> bytes:
    random = np.random.default_rng(0)
    write_video(path, (random.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(6)), 30)
    return path.read_bytes()


@dataclass(frozen=True)
class Kind:
    """name: of the file · sound: its bytes, made at this path · read: fails the test unless it reads or refuses ·
    cuts: parts of it that are refused; a text that is cut later has lost nothing that anybody could miss · flips: how
    often bytes are flipped; not in USD's own files, of whose lies its library may crash"""

    name: str
    sound: Callable[[Path], bytes]
    read: Callable[[Path], object]
    cuts: tuple[float, ...] = (0, 0.01, 0.1, 0.5, 0.9, 0.999)
    flips: int = 60


def own(path: Path) -> object:
    return read_motion_file(path, TOLD)


def foreign(path: Path) -> object:
    return read_motion_file(path, MotionFormat(handedness=Handedness.RIGHT, check_hand=False))


def checked(path: Path) -> object:
    """What is found wrong in a stage counts as refused: USD opens archives whose layers are damaged."""
    for finding in check_usd(path):
        if finding.is_error:
            raise InputError(str(path), wanted="a sound stage", came=str(finding).replace("\n", " ")[:300])
    return path


def pictures(path: Path) -> object:
    assert list(read_frames(open_video(path)))


KINDS = {
    "avatar": Kind("a.jghand", lambda path: avatar_bytes(path, painted(), Storage.COMPACT), load_avatar),
    "trained avatar": Kind("a.jghand", lambda path: avatar_bytes(path, ellipsoid_avatar(50)), load_avatar),
    "avatar in known light": Kind("a.jghand", lambda path: avatar_bytes(path, known_avatar(50)), load_avatar),
    "distilled avatar": Kind("a.jghand", lambda path: avatar_bytes(path, distilled_avatar()), load_avatar),
    **{f"motion {suffix}": Kind(f"motion{suffix}", motion_bytes, own) for suffix in (".npz", ".npy", ".json")},
    # text without a closing mark cannot tell that lines are lost after the last one
    "motion .csv": Kind("motion.csv", motion_bytes, own, cuts=(0, 0.001)),
    "bvh": Kind("motion.bvh", bvh_bytes, foreign, cuts=(0, 0.01, 0.1, 0.5, 0.9)),
    **{
        kind: Kind("motion.json", lambda path, kind=kind: foreign_json(kind), foreign)
        for kind in ("mediapipe", "openpose", "iwer", "webxr", "interhand")
    },
    "camera": Kind("camera.json", lambda path: json.dumps(CAMERA).encode(), read_camera),
    "template": Kind("hand.npz", lambda path: (ASSETS / "hand_right.npz").read_bytes(), load_fields, flips=20),
    "mano": Kind("MANO_RIGHT.pkl", lambda path: python2_pickle(mano_objects(mano_fields())), read_mano, flips=30),
    "usd": Kind("hand.usdc", usd_bytes, checked, flips=0),
    "usd archive": Kind("hand.usdz", usd_bytes, checked, flips=0),
    # what a film lost at its end is missed by nobody who sees its other pictures
    "film": Kind("film.mp4", film_bytes, pictures, cuts=(0, 0.02, 0.1), flips=6),
}  # fmt: skip
