"""Stands in for jghand_cycles where there is no Blender: same lines of JSON, a disc instead of a hand.

The environment says what goes wrong: JGHAND_STAND_IN_FAILS_AT, number of a picture at which the process ends, and how
long a picture takes: JGHAND_STAND_IN_TAKES_S.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

from PIL import Image, PngImagePlugin


def main() -> None:
    plan = json.loads((Path(sys.argv[1]) / "plan.json").read_text(encoding="utf-8"))
    print(json.dumps({"ready": "stand-in"}), flush=True)
    fails_at = int(os.environ.get("JGHAND_STAND_IN_FAILS_AT", "-1"))
    for number, line in enumerate(sys.stdin):
        if number == fails_at:
            sys.exit("the stand-in was told to fail")
        time.sleep(float(os.environ.get("JGHAND_STAND_IN_TAKES_S", "0")))
        job = json.loads(line)
        camera = plan["cameras"][job["camera"]]
        picture = Image.new("RGBA", (camera["width"], camera["height"]), (200, 150, 120, 0))
        picture.paste((200, 150, 120, 255), (2, 2, camera["width"] - 2, camera["height"] - 2))
        stamp = PngImagePlugin.PngInfo()
        stamp.add_text("jghand-stamp", job["stamp"])
        Path(job["file"]).parent.mkdir(parents=True, exist_ok=True)
        picture.save(job["file"], pnginfo=stamp)
        print(json.dumps({"file": job["file"], "seconds": 0.1}), flush=True)


if __name__ == "__main__":
    main()
