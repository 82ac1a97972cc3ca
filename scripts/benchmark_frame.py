"""Where the milliseconds of a frame go, on this machine, beside the torch reference and a scalar loop.

    python scripts/benchmark_frame.py [--rounds 100] [--threads 0] [--only frame,trained] [--json FILE]

Cases take turns, after a warm-up; samples during which the machine was not free are dropped; medians and p95. Nothing
is a sum of stages. Files and sockets are not part of it.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch

from jghand_engine.cli.console import progress, say, say_table
from jghand_engine.files import writing
from jghand_engine.native.library import load
from jghand_engine.native.threads import thread_count
from jghand_engine.study import frame_time
from jghand_engine.study.timing import Case, measure

WARM_UP = 10
PARTS = ("frame", "trained", "raster", "parts", "reference", "numba")


def cases(parts: list[str], threads: int) -> Iterator[Case]:
    library = load("auto")
    count = thread_count(threads)
    if "frame" in parts:
        yield from frame_time.whole_frame_cases(frame_time.every_frame_shadowed(threads))
    if "trained" in parts:
        yield from frame_time.trained_cases(frame_time.every_frame_shadowed(threads))
    if "raster" in parts and library:
        yield from frame_time.raster_and_shadow_cases(library, count)
    if "parts" in parts and library:
        yield from frame_time.part_cases(library, count)
    if "reference" in parts:
        yield from frame_time.reference_cases(count)
    if "numba" in parts:
        yield from numba_cases()


def numba_cases() -> Iterator[Case]:
    """The scalar loop of scripts/numba_loop.py, raster only, on the same pictures; nothing without numba."""
    if importlib.util.find_spec("numba") is None:
        say("numba is not installed: the scalar loop is left out")
        return
    sys.path.insert(0, str(Path(__file__).parent))
    import numba_loop

    for subject in frame_time.subjects(*frame_time.SIZES[0]):
        gaussians, camera = frame_time.posed_gaussians(subject), subject.camera
        matrix = torch.from_numpy(camera.camera_from_world).float()
        position = gaussians.position_m @ matrix[:3, :3].T + matrix[:3, 3]
        view = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        arrays = (*(t.numpy() for t in (position, gaussians.sigma_m, gaussians.opacity, gaussians.rgb)), view)

        def run(arrays: tuple[Any, ...] = arrays) -> None:
            numba_loop.draw(*arrays)

        title = f"{subject.name}, {camera.width} x {camera.height}"
        yield Case("scalar loop in numba, raster only, one thread", title, run, rounds=frame_time.FEW, threads=1)


def parts_of(text: str) -> list[str]:
    """The parts named in a list with commas; a misspelt one must not be measured as nothing."""
    parts = [part.strip() for part in text.split(",")]
    if unknown := [part for part in parts if part not in PARTS]:
        raise argparse.ArgumentTypeError(f"wanted some of {','.join(PARTS)}, got {','.join(unknown)}")
    return parts


def commit() -> str:
    """What was measured: the commit, with a + when files differ from it; empty without git."""
    command = ["git", "describe", "--always", "--abbrev=12", "--exclude=*", "--dirty=+"]
    try:
        folder = Path(__file__).parent
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=100, help="samples of every case")
    parser.add_argument("--threads", type=int, default=0, help="0: as many as is sensible")
    parser.add_argument("--only", type=parts_of, default=list(PARTS), help=f"some of {','.join(PARTS)}")
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args()
    torch.set_num_threads(thread_count(options.threads))
    facts = frame_time.machine(options.threads) | ({"commit": name} if (name := commit()) else {})
    say(", ".join(f"{name} {value}" for name, value in facts.items()))
    chosen = list(cases(options.only, options.threads))
    with progress("Measuring", WARM_UP + options.rounds) as bar:
        measured = measure(chosen, rounds=options.rounds, warm_up=WARM_UP, tick=lambda: bar.advance(bar.task_ids[0]))
    say_table("Milliseconds", frame_time.COLUMNS, frame_time.rows(measured))
    if options.json:
        content = {"machine": facts, "warm_up": WARM_UP, "measurements": [one.as_dict() for one in measured]}
        with writing(options.json) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
