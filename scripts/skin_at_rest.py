"""How far skin moves from one frame of a motion to the next while the hand rests: by its bones alone, and as it is
shown, with what it has learned to add to each pose.

    .envs/engine/bin/python scripts/skin_at_rest.py MOTION AVATAR [AVATAR …]

A hand rests where its joints move least: in a quarter of the frames. What moves then is noise of the joints.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_avatar_called
from jghand_engine.motion.content import MotionFormat
from jghand_engine.motion.read import read_motion_file
from jghand_engine.study.stability_measures import as_shown

RESTING_PART = 0.25
# of the Gaussians of a frame that are told of: their middle, and those that move farthest
PERCENTILES = 50, 99
_MM = 1e3


def resting(joints_m: np.ndarray) -> np.ndarray:
    """Of joints (F, 21, 3): the frames f, in order, from which to f + 1 they move least, about the wrist."""
    about_wrist_m = joints_m - joints_m[:, :1]
    moved_m = np.linalg.norm(np.diff(about_wrist_m, axis=0), axis=-1).mean(1)
    return np.sort(moved_m.argsort()[: max(1, round(RESTING_PART * len(moved_m)))])  # NaN comes last


def moved_mm(avatar: HandAvatar, joints_m: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """(len(frames), N) how far each Gaussian goes from each of the frames to the next, about the wrist, millimeters."""
    skin, steps = as_shown(avatar), (torch.from_numpy(joints_m[frame : frame + 2]) for frame in frames)
    return _MM * np.array([np.linalg.norm(np.diff(skin(one, torch.float64).skin, axis=0)[0], axis=-1) for one in steps])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("motion", type=Path)
    parser.add_argument("avatars", nargs="+", help="files, or a name such as builtin")
    options = parser.parse_args()
    avatars = {name: load_avatar_called(name) for name in options.avatars}
    of_hand = MotionFormat(handedness=next(iter(avatars.values())).handedness)
    joints_m = read_motion_file(options.motion, of_hand).sequence.joints_m
    frames = resting(joints_m)
    print(f"{len(frames)} of {len(joints_m)} frames; mm, medians over them of the skin's {PERCENTILES} %")
    for name, avatar in avatars.items():
        learned = avatar.learned
        bare = None if learned is None else replace(learned, correctives=None, distilled=None)
        ways = [
            np.percentile(moved_mm(one, joints_m, frames), PERCENTILES, axis=1)
            for one in (replace(avatar, learned=bare), avatar)
        ]
        by_bones, shown = (np.median(way, axis=1).round(3).tolist() for way in ways)
        print(f"{name}: by bones {by_bones}, as shown {shown}")


if __name__ == "__main__":
    main()
