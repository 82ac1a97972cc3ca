# SPDX-License-Identifier: GPL-3.0-or-later
"""The process: `python blender_addon/capture PLAN_FOLDER --threads 2`, jobs as lines of JSON on standard input.

A job is {"pose": 0, "camera": 3, "file": "…/image0.png", "stamp": "…", "light": "…"}, the light where that of the plan
varies; the answer is a line on standard output: {"ready": "5.0.1"} once, then {"file": …, "seconds": …,
"cpu_seconds": …} for every picture, or {"error": …, "file": …} and the end. What Blender itself prints goes to standard
error. The end of the input is the end of the work.
"""

import argparse
import importlib
import json
import os
import secrets
import sys
import tempfile
import time
from pathlib import Path


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plan", type=Path)
    parser.add_argument("--threads", type=int, required=True)
    options = parser.parse_args()
    answers = _own_output()
    try:
        import bpy
    except ImportError as error:
        _say(answers, {"error": f"this Python cannot import bpy: {error}", "missing": "bpy"})
        return 3
    # this folder as a package of its own: that of the extension wants Blender's interface
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    plan = json.loads((options.plan / "plan.json").read_text(encoding="utf-8"))
    varies = "lights" in plan["render"]["light"]
    kind = importlib.import_module("capture.lit").LitScene if varies else importlib.import_module("capture.scene").Scene
    scene = kind(plan["render"], options.plan, options.threads)
    _say(answers, {"ready": bpy.app.version_string})
    for line in sys.stdin:
        job = json.loads(line)
        started, cpu_started = time.perf_counter(), time.process_time()
        target = Path(job["file"])
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory() as scratch:
                files = scene.picture(job, plan["cameras"][job["camera"]], Path(scratch))
            for suffix, data in files.items():
                _write(target.with_suffix(suffix), data)
        except (OSError, ValueError, RuntimeError) as error:
            _say(answers, {"error": f"{type(error).__name__}: {error}", "file": job["file"]})
            return 1
        took = {"seconds": time.perf_counter() - started, "cpu_seconds": time.process_time() - cpu_started}
        _say(answers, {"file": job["file"], **{name: round(value, 3) for name, value in took.items()}})
    return 0


def _write(target: Path, data: bytes) -> None:
    """Written beside the target and renamed: no moment shows half a file."""
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(4)}{target.suffix}")
    try:
        with open(temporary, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def _own_output():
    """A stream to the real standard output; everything else that prints there goes to standard error."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    return answers


def _say(answers, message: dict) -> None:
    answers.write(json.dumps(message) + "\n")
    answers.flush()


if __name__ == "__main__":
    sys.exit(main())
