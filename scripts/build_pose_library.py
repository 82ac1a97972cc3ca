# SPDX-License-Identifier: GPL-3.0-or-later
# This script imports blender_addon (GPL-3.0-or-later) and bpy (GPL), so it is under the GPL too: blender_addon/LICENSE.
"""Makes a folder that Blender can use as an asset library of hand poses, for a studio or to look at.

    .envs/blender/bin/python scripts/build_pose_library.py --out FOLDER

Runs in a Python that has bpy. The extension makes the same folder itself, on demand, by the Blender that runs it; the
poses come from blender_addon/assets/poses.json (`scripts/build_pose_table.py`). FOLDER gets one .blend file with pose
assets for both hands and Blender's catalog file beside it: add it under Preferences, File Paths, Asset Libraries.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="the folder of the library")
    options = parser.parse_args()
    from blender_addon.errors import JGHandFailure
    from blender_addon.hand import pose_library

    try:
        path = pose_library.build_library(options.out.resolve())
    except JGHandFailure as failure:
        print(f"build_pose_library: {failure}", file=sys.stderr)
        return failure.advice.exit_code
    print(f"wrote {path} ({path.stat().st_size / 1024:.0f} KiB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
