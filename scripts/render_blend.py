# SPDX-License-Identifier: GPL-3.0-or-later
# This script imports blender_addon (GPL-3.0-or-later) and bpy (GPL), so it is under the GPL too: blender_addon/LICENSE.
"""Renders the hands of a .blend file without a window: joints from Blender, pictures from the engine.

    .envs/blender/bin/python scripts/render_blend.py FILE.blend --camera CamPalm,CamSide --frames 1-60 --out FOLDER

Runs in a Python that has bpy; `--help` says what it can be told. The work is done by `blender_addon.render.command`.
--engine-python PATH: a Python that has jghand installed, in place of .envs/engine.
"""

import argparse
import importlib.util
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def main() -> int:
    if importlib.util.find_spec("bpy") is None:
        print("This needs a Python with bpy: run it with .envs/blender/bin/python.", file=sys.stderr)
        return 2
    sys.path.insert(0, str(ROOT))
    from blender_addon import registration
    from blender_addon.render import command
    from blender_addon.renderer.process import VARIABLE

    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--engine-python", default=os.environ.get(VARIABLE, ""))
    options, words = parser.parse_known_args()
    os.environ[VARIABLE] = options.engine_python
    registration.register()
    return command.main(words, program="render_blend.py")


if __name__ == "__main__":
    sys.exit(main())
