"""Writes avatars whose Gaussians sit exactly at the joints: run by the engine's Python.

    python write_joint_avatars.py FOLDER

FOLDER/0.jghand … 6.jghand hold three joints each, in pure red, green and blue: joints 3 k, 3 k + 1, 3 k + 2 of the
standard order. A picture's color channels then say where each of them is, however near they are.
"""

import sys
from pathlib import Path

import numpy as np

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.avatar.file import save_avatar
from jghand_engine.hand.joints import LEVEL_NAMES, STANDARD_NAMES, Handedness
from jghand_engine.template.builtin import load_template

SIGMA_M = 0.0015


def main(folder: Path) -> None:
    joints = np.array(load_template().joints_m, np.float64)
    for file in range(7):
        level = [LEVEL_NAMES.index(STANDARD_NAMES[3 * file + channel]) for channel in range(3)]
        save_avatar(
            folder / f"{file}.jghand",
            HandAvatar(
                info=AvatarInfo(name="joints", template="built-in", license="CC0-1.0"),
                handedness=Handedness.RIGHT,
                canonical_joints_m=joints,
                position_m=joints[level].astype(np.float32),
                sigma_m=np.full(3, SIGMA_M, np.float32),
                opacity=np.full(3, 0.9, np.float32),
                rgb=np.eye(3, dtype=np.float32),
                bone_weights=np.eye(21, dtype=np.float32)[level],  # bone i ends at joint i
                uvd=np.full((3, 3), 0.5, np.float32),
            ),
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
