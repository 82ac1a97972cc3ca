"""The moving picture at the top of the README, from a real Blender window.

    python scripts/moving_picture.py [--out docs/viewport.webp]

Runs the story `moving` of tests/in_blender (scripts/test_in_blender.py says what that needs) and puts its pictures of
the screen together.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
RECORDED = ROOT / "build" / "in_blender" / "moving" / "recorded"
# a fifth of the README's width in bytes is saved by 960 pixels instead of 1280; text of the panel stays readable
WIDTH_PX = 960
FRAME_MS, PAUSE_MS = 80, 700
# of WebP: below 70 the skin shows blocks
QUALITY = 80


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "viewport.webp", help="file to write")
    out = parser.parse_args().out
    story = subprocess.run([sys.executable, str(ROOT / "scripts" / "test_in_blender.py"), "moving"], check=False)
    if story.returncode:
        return story.returncode
    frames = [Image.open(path).convert("RGB") for path in sorted(RECORDED.glob("*.png"))]
    height = round(WIDTH_PX * frames[0].height / frames[0].width)
    frames = [frame.resize((WIDTH_PX, height), Image.Resampling.LANCZOS) for frame in frames]
    there_and_back = [*frames, *frames[-2:0:-1]]
    durations = [PAUSE_MS if index in (0, len(frames) - 1) else FRAME_MS for index in range(len(there_and_back))]
    there_and_back[0].save(
        out, save_all=True, append_images=there_and_back[1:], duration=durations, loop=0, quality=QUALITY, method=6
    )
    print(f"{out}: {len(there_and_back)} frames, {out.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
