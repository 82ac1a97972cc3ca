"""Tries the extension in a real Blender window, step by step, and keeps pictures of the screen.

    python scripts/test_in_blender.py                         every story of tests/in_blender
    python scripts/test_in_blender.py installed               one story
    python scripts/test_in_blender.py installed the_side_bar_has_its_tab     some of its steps, in this order
    python scripts/test_in_blender.py /tmp/look.py            a story that lies elsewhere

A story is a file of small functions (tests/in_blender/__init__.py says how they look); each story gets a Blender of its
own, with an empty profile into which the freshly built zip is installed: the renderer is the one in the zip, run by
Blender's own Python. In a folder of its own Blender sees nothing else of this machine than `tests`, so that no engine
of the checkout can help, but for a Python with PyTorch that a story names. Pictures, logs and results lie in
build/in_blender/STORY. Needs Blender, Xvfb, xdotool and ImageMagick; where they are not installed, a folder with all of
them is made from Debian's packages (root, mmdebstrap, two minutes, 1.3 GB; scripts/blender_folder.py). The exit code is
0 when every step passed, 1 when one failed, 77 when it cannot be tried here, which the last line then explains.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import build_extension
import bundled_engine
from blender_folder import NotPossibleError, Place, find_place

ROOT = Path(__file__).resolve().parents[1]
STORIES = ROOT / "tests" / "in_blender"
HELPERS = {"__init__", "driver", "window", "pictures"}
FOLDER_VARIABLE = "JGHAND_BLENDER_FOLDER"
LEARNING_VARIABLE = "JGHAND_LEARNING_PYTHON"
CANNOT = 77
SCREEN = "1280x800"
# starts the screen on a free number, then the rest of its arguments; ends the screen with them
WITH_SCREEN = """
number=$(mktemp)
Xvfb -displayfd 3 -screen 0 "$1x24" +extension GLX 3>"$number" 2>/dev/null & screen=$!
shift
for _ in $(seq 100); do [ -s "$number" ] && break; sleep 0.1; done
DISPLAY=":$(cat "$number")"; export DISPLAY
rm -f "$number"
"$@"; status=$?
kill "$screen"
exit $status
"""


def story_file(name: str) -> Path:
    path = STORIES / f"{name}.py" if "/" not in name else Path(name).resolve()
    if not path.is_file():
        known = ", ".join(stories())
        raise NotPossibleError(f"there is no story {name}; there are {known}")
    return path


def stories() -> list[str]:
    return sorted(path.stem for path in STORIES.glob("*.py") if path.stem not in HELPERS)


def the_platform() -> str:
    """This machine in Blender's words: the renderer for it goes into the zip."""
    found = bundled_engine.host_platform()
    if found is None:
        raise NotPossibleError("the kernels are not built for this machine")
    return found


def learning_python(story: Path, python: Path) -> tuple[dict[str, str], list[Path]]:
    """What tells a story which Python has PyTorch and the engine, and the folders that these are in. Nothing where the
    story does not name it, or the Python lacks one of them: the story then skips its steps."""
    if LEARNING_VARIABLE not in story.read_text(encoding="utf-8") or not python.is_file():
        return {}, []
    ask = "import sys, torch, jghand_engine; print(sys.prefix, sys.base_prefix, *jghand_engine.__path__, sep='\\n')"
    told = subprocess.run([str(python), "-I", "-c", ask], capture_output=True, text=True, check=False)
    if told.returncode:
        return {}, []
    return {LEARNING_VARIABLE: str(python)}, [Path(line) for line in told.stdout.splitlines()]


def run_story(place: Place, archive: Path, story: Path, steps: list[str], options: argparse.Namespace) -> bool:
    """Runs one story and says how its steps went; returns whether all passed."""
    out = options.out / story.stem
    if out.exists():
        shutil.rmtree(out)
    out.mkdir(parents=True)
    variables = {
        "HOME": str(out), "TMPDIR": "/tmp", "BLENDER_USER_RESOURCES": str(out / "profile"),
        "LIBGL_ALWAYS_SOFTWARE": "1", "GALLIUM_DRIVER": "llvmpipe",
        "JGHAND_CACHE_DIR": str(out.parent / "cache"), "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "2"),
    }  # fmt: skip
    named, folders = learning_python(story, options.learning_python)
    width, height = options.screen.split("x")
    blender = [
        "blender", "--no-window-focus", "--gpu-backend", "opengl", "--window-geometry", "0", "0", width, height,
        "--python-exit-code", "1", "--python", str(STORIES / "driver.py"),
        "--", str(archive), str(out), str(story), *steps,
    ]  # fmt: skip
    seen = [ROOT / "tests", out.parent, archive.parent, story.parent, *folders]
    command = place.command(["bash", "-c", WITH_SCREEN, "screen", options.screen, *blender], seen, variables | named)
    started = time.perf_counter()
    log = out / "blender.log"
    with log.open("wb") as stream:
        process = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT, start_new_session=True)
        try:
            code = process.wait(timeout=options.timeout)
        except (subprocess.TimeoutExpired, KeyboardInterrupt) as error:
            os.killpg(process.pid, 9)
            process.wait()
            if isinstance(error, KeyboardInterrupt):
                raise
            code = None
    return _say(story, out, code, time.perf_counter() - started)


def engine_that_is_left(out: Path) -> str:
    """The process of an engine that outlives its Blender; empty if there is none."""
    file = out / "engine.pid"
    pid = file.read_text(encoding="utf-8").strip() if file.exists() else ""
    for _ in range(50):
        if not pid or not Path(f"/proc/{pid}").exists():
            return ""
        time.sleep(0.1)
    return pid


def _say(story: Path, out: Path, code: int | None, seconds: float) -> bool:
    results_file = out / "results.json"
    results = json.loads(results_file.read_text(encoding="utf-8")) if results_file.exists() else []
    print(f"\n{story.stem}: {seconds:.0f} s, {out}")
    for result in results:
        word = "FAILED" if not result["ok"] else "skip" if "skipped" in result else "ok"
        print(f"  {word:<6} {result.get('seconds', 0):6.1f} s  {result['name']}")
        if "skipped" in result:
            print("         " + result["skipped"])
        if not result["ok"]:
            print("         " + result.get("problem", "").replace("\n", "\n         "))
    left = engine_that_is_left(out)
    passed = bool(results) and all(result["ok"] for result in results) and code == 0 and not left
    if not passed:
        end = "it ran out of time" if code is None else f"Blender ended with {code}"
        end += f"; the engine, process {left}, did not end with it" if left else ""
        last = (out / "blender.log").read_text(encoding="utf-8", errors="replace").splitlines()[-15:]
        print(f"  {end}; the end of its log:", *last, sep="\n    ")
    return passed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("story", nargs="?", help="a story of tests/in_blender, or a file; default: all of them")
    parser.add_argument("steps", nargs="*", help="names of its steps, without `step_`; default: all")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "in_blender", help="folder for the results")
    parser.add_argument(
        "--folder", type=Path, default=os.environ.get(FOLDER_VARIABLE) or ROOT / ".envs" / "blender_window",
        help=f"folder with Debian and Blender, made once (default {FOLDER_VARIABLE}, else .envs/blender_window)",
    )  # fmt: skip
    parser.add_argument(
        "--learning-python", type=Path, default=ROOT / ".envs" / "engine" / "bin" / "python", metavar="PYTHON",
        help="has the engine with PyTorch, for stories whose jobs learn (default .envs/engine)",
    )  # fmt: skip
    parser.add_argument("--screen", default=SCREEN, metavar="WxH", help=f"size of the screen (default {SCREEN})")
    parser.add_argument("--timeout", type=float, default=600, help="seconds that one story may take (default 600)")
    options = parser.parse_args()
    options.out = options.out.resolve()
    # a shell starts what runs in its background with Ctrl-C ignored, and so would be the jobs that Blender starts
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        files = [story_file(name) for name in ([options.story] if options.story else stories())]
        place = find_place(Path(options.folder))
        archive = build_extension.build(options.out / "zip", platforms=[the_platform()])
        passed = [run_story(place, archive, file, options.steps, options) for file in files]
    except NotPossibleError as error:
        print(f"not tried: {error}")
        return CANNOT
    return 0 if all(passed) else 1


if __name__ == "__main__":
    sys.exit(main())
