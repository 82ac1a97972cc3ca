"""How far one machine goes: what one more picture, step and frame costs, for the table in docs/SCALE.md.

    python scripts/benchmark_scale.py [--page docs/SCALE.md] [--json FILE] [--repeats 3]

Runs the commands as anyone would, each as processes of its own. Seconds are what a command says itself (--json), once
it has started; core-seconds (user and system, of all its processes) and peak memory come from the operating system.
What one more picture, step or frame costs is the difference of a long and a short run, so that starting is told apart,
and the median of such differences (--repeats), of short and long runs in turn; how far they lie apart is said below the
table. In the motion, which begins again and again, 9 of 600 frames are like the one before. A repeat takes some five
minutes on two quiet cores; --quick takes a tenth of the work, to see that it runs.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from other_programs import put_into_page, table

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import MotionOptions, pose_sequence_of_names
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.motion.files import write_motion
from jghand_engine.native.machine import processor

ROOT = Path(__file__).resolve().parents[1]
JGHAND = (sys.executable, "-m", "jghand_engine")
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
# the motion that is rendered and exported
FRAMES, POSES = 600, ["open", "fist", "point", "ok", "spread", "relaxed", "open"]
PARTS = ("render", "capture", "train", "export")
BLENDER = ROOT / ".envs" / "blender" / "bin" / "python"


@dataclass(frozen=True)
class Run:
    """Processes that worked at the same time. wall_s: until the last ended · work_s: what the slowest says itself that
    it took, without starting · core_s: of all · peak_mb: of the largest · bytes: of the files that they left"""

    wall_s: float
    work_s: float
    core_s: float
    peak_mb: float
    bytes: int


@dataclass(frozen=True)
class Cost:
    """What one more of something costs. wall_s, core_s, start_s: medians of all repeats; start_s of as many processes
    at once, each of which does one · peak_mb: of the largest · mb: of the files of the first repeat, as all leave the
    same · apart: how far the core times of the repeats lie apart, as a part of core_s · command: without its folders"""

    what: str
    per: str
    wall_s: float
    core_s: float
    peak_mb: float
    start_s: float
    mb: float
    command: str
    repeats: int = 1
    apart: float = 0.0

    def row(self) -> tuple[str, ...]:
        return (
            self.what, self.per, seconds(self.wall_s), seconds(self.core_s), f"{self.start_s:.1f} s",
            f"{self.peak_mb:.0f} MB", f"{self.mb:.3f} MB" if self.mb else "-", f"`{self.command}`",
        )  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", type=Path, help="write the table into this page, between its marks")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--only", default=",".join(PARTS), help="what is measured")
    parser.add_argument("--repeats", type=int, default=3, help="of each difference (default 3)")
    parser.add_argument("--quick", action="store_true", help="a tenth of the work: to see that it runs")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()), help="where work files go")
    options = parser.parse_args()
    wanted = options.only.split(",")
    if not set(wanted) <= set(PARTS) or options.repeats < 1:
        raise SystemExit(f"--only: some of {', '.join(PARTS)}; --repeats: 1 or more.")
    if not {"capture", "train"}.isdisjoint(wanted) and not BLENDER.is_file():
        raise SystemExit(f"There is no {BLENDER}, which captures: --only render,export.")
    if options.json and not options.json.parent.is_dir():
        raise SystemExit(f"--json: there is no folder {options.json.parent}.")
    if options.page and set(wanted) != set(PARTS):
        raise SystemExit("--page wants all figures: leave out --only.")
    load = f"load {os.getloadavg()[0]:.1f} before it began"
    machine = f"{processor()}, {CORES} cores, {load}, {time.strftime('%Y-%m-%d')}"
    if options.quick:
        machine += ", a tenth of the work (--quick)"
    with tempfile.TemporaryDirectory(dir=options.folder, prefix="jghand_scale_") as folder:
        costs = measured(Path(folder), wanted, options.repeats, 10 if options.quick else 1)
    text = measured_table(costs, machine)
    print(text)
    if options.json:
        content = {"machine": machine, "costs": {name: asdict(cost) for name, cost in costs.items()}}
        options.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    if options.page:
        put_into_page(options.page, Path(__file__).name, f"\n{text}\n")
    return 0


# ---- measured --------------------------------------------------------------------------------------------------------


def measured(folder: Path, wanted: Iterable[str], repeats: int, divisor: int) -> dict[str, Cost]:
    costs: dict[str, Cost] = {}
    motion = folder / "wave.npz"
    write_motion(motion, moving_hand(FRAMES))
    if "render" in wanted:
        for size in ("512x334", "1024x1024"):
            costs |= rendering(rooms(folder / size, repeats), motion, size, max(20, FRAMES // divisor))
    if "export" in wanted:
        costs["export"] = exporting(rooms(folder / "export", repeats), motion, max(6, FRAMES // 10 // divisor))
    if "capture" in wanted or "train" in wanted:
        places = rooms(folder / "capture", repeats)
        costs["capture"] = capturing(places, 2 if divisor > 1 else 4)
        if "train" in wanted:
            steps = max(20, 300 // divisor)
            costs["train"] = training(rooms(folder / "train", repeats), places[0] / "many", steps)
    return costs


def rooms(folder: Path, repeats: int) -> list[Path]:
    """A folder for each repeat."""
    return [folder / str(number) for number in range(repeats)]


def moving_hand(frames: int) -> PoseSequence:
    """Poses without a rest between them, over and over."""
    joints_m = load_builtin(handedness=Handedness.RIGHT).canonical_joints_m
    options = MotionOptions(hold_s=0.0)
    once = pose_sequence_of_names(POSES, joints_m, handedness=Handedness.RIGHT, options=options).joints_m[:-1]
    times = -(-frames // len(once))
    return PoseSequence(np.tile(once, (times, 1, 1))[:frames], 30.0, Handedness.RIGHT)


def rendering(folders: Sequence[Path], motion: Path, size: str, frames: int) -> dict[str, Cost]:
    """One process that takes all cores, and one process per core."""
    words, last = ["render", "--motion", motion, "--size", size], f"0-{frames - 1}"
    alone, parted = [], []
    for folder in folders:
        one = run([[*words, "--frames", "0", "--out", folder / "one"]], folder / "one")
        alone.append((one, run([[*words, "--frames", last, "--out", folder / "alone"]], folder / "alone")))
        if CORES > 1:
            # so many pictures as there are shards: one each
            each = run(shards([*words, "--frames", f"0-{CORES - 1}", "--out", folder / "short"]), folder / "short")
            many = run(shards([*words, "--frames", last, "--out", folder / "shards"]), folder / "shards")
            parted.append((each, many))
    said = f"jghand render --motion FILE --size {size}"
    found = {f"render {size}": difference(f"picture, {size}", "one process", alone, frames - 1, said)}
    if parted:
        said += f" --threads 1 --shard N/{CORES}"
        by = f"{CORES} processes"
        found[f"render {size}, shards"] = difference(f"picture, {size}", by, parted, frames - CORES, said)
    return found


def shards(words: Sequence[object]) -> list[list[object]]:
    return [[*words, "--threads", "1", "--shard", f"{number}/{CORES}"] for number in range(1, CORES + 1)]


def exporting(folders: Sequence[Path], motion: Path, frames: int) -> Cost:
    words = ["export", "--motion", motion]
    pairs = [
        (
            run([[*words, "--frames", "0", "--out", folder / "one"]], folder / "one"),
            run([[*words, "--frames", f"0-{frames - 1}", "--out", folder / "many"]], folder / "many"),
        )
        for folder in folders
    ]
    return difference("frame of a USD stage", "one process", pairs, frames - 1, "jghand export --motion FILE")


def capturing(folders: Sequence[Path], poses: int) -> Cost:
    words = ["capture", "--identity", "3", "--cameras", "4", "--close-ups", "0", "--subdivisions", "2"]
    words += ["--size", "334x512", "--samples", "16"]
    pairs = [
        (
            run([[*words, "--poses", "1", "--out", folder / "one"]], folder / "one"),
            run([[*words, "--poses", str(1 + poses), "--out", folder / "many"]], folder / "many"),
        )
        for folder in folders
    ]
    return difference("picture of a capture, 334x512", "one process", pairs, 4 * poses, " ".join(["jghand", *words]))


def training(folders: Sequence[Path], capture: Path, steps: int) -> Cost:
    """Of so few steps as of many: the schedule, which is coarse first, is stretched over them."""

    def of(folder: Path, count: int) -> Run:
        place = folder / str(count)
        return run([["train", capture, "--steps", str(count), "--out", place / "hand.jghand"]], place)

    pairs = [(of(folder, 1), of(folder, steps)) for folder in folders]
    cost = difference("step of a training", "one process", pairs, steps - 1, "jghand train CAPTURE --steps …")
    # an avatar and its checkpoints are not larger for more steps
    return replace(cost, mb=pairs[0][1].bytes / 1e6)


def run(commands: Sequence[Sequence[object]], left: Path) -> Run:
    """Runs processes at the same time. SystemExit with what one said that failed."""
    started = time.perf_counter()
    with contextlib.ExitStack() as held:
        told = Path(held.enter_context(tempfile.TemporaryDirectory()))
        processes = []
        for number, words in enumerate(commands):
            log = held.enter_context(tempfile.TemporaryFile("w+"))
            command = [*JGHAND, *map(str, words), "--json", str(told / f"{number}.json")]
            processes.append((subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT), log))
        core_s = peak_mb = 0.0
        try:
            for process, log in processes:
                # not by Popen: it forgets what the process took
                _, status, used = os.wait4(process.pid, 0)
                process.returncode = os.waitstatus_to_exitcode(status)
                if process.returncode:
                    log.seek(0)
                    raise SystemExit(f"{process.args}\n{log.read()}")
                core_s += used.ru_utime + used.ru_stime
                peak_mb = max(peak_mb, used.ru_maxrss / 1e3)
        finally:
            for process, _ in processes:
                if process.returncode is None:
                    process.kill()
                    process.wait()
        wall_s = time.perf_counter() - started
        work_s = max(seconds_in(json.loads(file.read_text(encoding="utf-8"))) for file in told.glob("*.json"))
        return Run(wall_s, work_s, core_s, peak_mb, size_of(left))


def seconds_in(report: dict[str, Any]) -> float:
    """What a command says that its work took."""
    if report["command"] == "capture":
        return report["seconds_each"] * report["rendered"]
    told = report["seconds"]
    return sum(told.values()) if isinstance(told, dict) else told


def size_of(path: Path) -> int:
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def difference(what: str, per: str, pairs: Sequence[tuple[Run, Run]], more: int, command: str) -> Cost:
    """What one of `more` costs, by which the second run of each pair was longer."""
    core_s = [(long.core_s - short.core_s) / more for short, long in pairs]
    middle_s = statistics.median(core_s)
    short, long = pairs[0]
    return Cost(
        what, per, statistics.median((long.work_s - short.work_s) / more for short, long in pairs), middle_s,
        max(long.peak_mb for _, long in pairs), statistics.median(short.wall_s for short, _ in pairs),
        (long.bytes - short.bytes) / more / 1e6, command, len(pairs), (max(core_s) - min(core_s)) / abs(middle_s),
    )  # fmt: skip


# ---- told ------------------------------------------------------------------------------------------------------------


def measured_table(costs: dict[str, Cost], machine: str) -> str:
    head = ("one", "by", "takes", "core time", "start", "peak memory", "on disk", "command")
    rows = table(head, [cost.row() for cost in costs.values()])
    return f"Measured on {machine}:\n\n{rows}\n\n{repeated(list(costs.values()))}"


def repeated(costs: Sequence[Cost]) -> str:
    """How far one can trust the figures."""
    most = max(costs, key=lambda cost: cost.apart)
    if most.repeats == 1:
        return "Each figure is one difference of a long and a short run, not repeated."
    return (
        f"Medians of {most.repeats} differences of a long and a short run. The core times of one thing lie at most "
        f"{most.apart:.0%} apart ({most.what}, {most.per})."
    )


def seconds(value_s: float) -> str:
    return f"{1e3 * value_s:.1f} ms" if value_s < 1 else f"{value_s:.2f} s"


if __name__ == "__main__":
    sys.exit(main())
