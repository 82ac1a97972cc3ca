"""Sets everything up, then passes the project's checks and tests.

    python scripts/test.py                     everything
    python scripts/test.py --only engine       one part; --help names them
    python scripts/test.py -k fist -x          what this script does not know goes to pytest
    python scripts/test.py tests/hand          a path runs only the tests below it

Needs nothing but Python 3.11 or newer. The parts blender45 and blender52, the extension in the oldest and the newest
Blender, want a Python 3.11 and a Python 3.13 on the machine, and window wants what scripts/test_in_blender.py wants;
each is left out without. With two processors or more two parts run at a time; what ran beside the first is shown after
it. The exit code is 0 when everything passed, else 1.
"""

import sys

if sys.version_info < (3, 11):  # noqa: UP036  (the very message this line is for)
    sys.exit("Python 3.11 or newer is needed, this is " + sys.version.split()[0])

import argparse
import os
import queue
import re
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import environments
from environments import BLENDER, BLENDER45, BLENDER52, DEVELOPER, ROOT, Environment, SetupError

# the parts, the longest first so that what runs beside it fills its time, and the seconds that each should take on one
# of two processors: shown beside its time, never asserted
BUDGET_S = {
    "engine": 720,
    "learning": 420,
    "blender52": 360,
    "blender": 300,
    "window": 240,
    "checks": 90,
    "blender45": 60,
}
# the same for everything, the environments made from nothing included
ALL_S = 1200
# how many parts run at a time
LANES = 2
OTHER_BLENDERS = {"blender45": BLENDER45, "blender52": BLENDER52}
# what concerns a selection of tests; the others are of one piece
SELECTABLE = ("checks", "engine", "blender", "blender52")
# what learns, captures and measures: a part of its own, the rest of the engine's tests is about what draws
LEARNING_PATHS = ("tests/learn", "tests/captures", "tests/track", "tests/study", "tests/template")
# what is tried in Blender's Python
BLENDER_PATHS = ("tests/blender",)
# the extension in its oldest Blender: it registers, adds a hand, renders, reads old files, installs from its zip
BLENDER45_PATHS = tuple(
    f"tests/blender/test_{name}.py"
    for name in ("extension", "armature", "render_engine", "saved_files", "built_extension")
)
# what our own processes do more than Blender: where its newest version is tried, in that alone
NEWEST_ALONE = tuple(
    f"tests/blender/test_{name}.py"
    for name in [
        "capture_hair",
        "capture_lit",
        "capture_render",
        "demo",
        "engine_operators",
        "hand_from_film",
        "track_video",
        "training_operators",
    ]
)
# the stories in a window that take part, and the exit code of their script where it cannot try them here
STORIES = ("newcomer",)
CANNOT = 77
# how many of the slowest tests each part lists
SLOWEST = 25
# pytest's exit code when a selection matches no test: fine for a selection, which may well concern one part only
NO_TESTS = 5


@dataclass(frozen=True)
class Result:
    """One line of the summary. passed None: it was not run, `note` says why."""

    name: str
    passed: bool | None
    seconds: float = 0.0
    note: str = ""


@dataclass(frozen=True)
class Selection:
    """The options for pytest, and the paths of each part; a part with None is not run. of_all: all parts are run"""

    options: tuple[str, ...]
    engine: tuple[str, ...] | None
    blender: tuple[str, ...] | None
    of_all: bool = False

    @classmethod
    def of(cls, arguments: list[str]) -> "Selection":
        paths = [a for a in arguments if not a.startswith("-") and (ROOT / a.split("::")[0]).exists()]
        options = tuple(a for a in arguments if a not in paths)
        if not paths:
            return cls(options, ("tests",), BLENDER_PATHS)
        blender = tuple(path for path in paths if (ROOT / path).is_relative_to(ROOT / "tests" / "blender"))
        engine = tuple(path for path in paths if path not in blender)
        return cls(options, engine or None, blender or None)

    @property
    def selective(self) -> bool:
        return bool(self.options) or self.engine != ("tests",)


@dataclass(frozen=True)
class Lane:
    """Where what is run shows its lines, what its processes find in their environment besides, and the processors that
    they may use; none: all."""

    show: Callable[[str], object]
    variables: dict[str, str]
    processors: frozenset[int] = frozenset()


def show_now(text: str) -> None:
    """For the only lane, or the one that is watched."""
    print(text, end="", flush=True)


def run(name: str, command: list[str], lane: Lane) -> tuple[Result, str]:
    """Runs a command, shows its output as it comes, and returns it too."""
    lane.show(f"\n== {name}\n")
    started = time.perf_counter()
    process = subprocess.Popen(
        command, cwd=ROOT, env=environments.clean_variables() | lane.variables, text=True, encoding="utf-8",
        errors="replace", stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    if lane.processors:
        os.sched_setaffinity(process.pid, lane.processors)
    lines = []
    assert process.stdout is not None
    for line in process.stdout:
        lane.show(line)
        lines.append(line)
    code = process.wait()
    return Result(name, code == 0, time.perf_counter() - started, f"exit code {code}" if code else ""), "".join(lines)


def run_checks(python: Path, lane: Lane) -> list[Result]:
    tools = {
        "ruff format": ["-m", "ruff", "format", "--check"],
        "ruff check": ["-m", "ruff", "check"],
        "pyright": ["-m", "pyright"],
    }
    return [run(name, [str(python), *arguments], lane)[0] for name, arguments in tools.items()]


def run_pytest(name: str, python: Path, arguments: tuple[str, ...], selective: bool, lane: Lane) -> tuple[Result, str]:
    """Runs pytest; returns its result and its own last line."""
    color = ("--color=yes",) if sys.stdout.isatty() else ()
    result, output = run(name, [str(python), "-m", "pytest", *color, *arguments], lane)
    lines = [line for line in output.splitlines() if line.strip()]
    summary = next((line for line in reversed(lines) if re.search(r"\d+ \w+.* in [\d.]+s|no tests ran", line)), "")
    if selective and result.note == f"exit code {NO_TESTS}":
        return Result(name, None, result.seconds, "the selection holds none of these"), summary
    return result, summary


def run_part(part: str, selection: Selection, require_blender: bool, lane: Lane) -> tuple[list[Result], list[str]]:
    """Sets up what the part needs and runs it; returns the lines of the summary and pytest's own."""
    if part == "checks":
        return run_checks(environments.ensure(DEVELOPER), lane), []
    if part == "window":
        return run_stories(lane), []
    paths = selection.engine if part in ("engine", "learning") else selection.blender
    name = f"pytest, {part}"
    if paths is None:
        return [], []
    arguments = (*paths, *selection.options)
    if not selection.selective:
        arguments = (*arguments, f"--durations={SLOWEST}")
    if part in ("engine", "learning"):
        if part == "learning":
            arguments = (*LEARNING_PATHS, *arguments[1:])
        elif not selection.selective:
            arguments = (*arguments, *(f"--ignore={path}" for path in LEARNING_PATHS))
        arguments = (*arguments, "--ignore=tests/blender")
        result, summary = run_pytest(name, environments.ensure(DEVELOPER), arguments, selection.selective, lane)
        return [result], [summary]
    environments.ensure(DEVELOPER)  # Blender's side talks to the real engine
    if part != "blender" and (reason := why_no_other_blender(OTHER_BLENDERS[part])):
        return [Result(name, None, note=reason)], []
    try:
        python = environments.ensure(OTHER_BLENDERS.get(part, BLENDER))
    except SetupError as error:
        print(f"\n{error}", file=sys.stderr, flush=True)
        return [Result(name, False if require_blender else None, note="there is no Blender environment, see above")], []
    if part == "blender45":
        arguments = (*BLENDER45_PATHS, *arguments[len(paths) :])
    if part == "blender" and selection.of_all and not why_no_other_blender(BLENDER52):
        arguments = (*arguments, *(f"--ignore={path}" for path in NEWEST_ALONE))
    result, summary = run_pytest(name, python, arguments, selection.selective, lane)
    return [result], [summary]


def run_stories(lane: Lane) -> list[Result]:
    """The stories in a real Blender window; not run where there can be none."""
    results = []
    for story in STORIES:
        command = [sys.executable, str(ROOT / "scripts" / "test_in_blender.py"), story]
        result, output = run(f"window, {story}", command, lane)
        if result.note == f"exit code {CANNOT}":
            result = Result(result.name, None, result.seconds, output.strip().splitlines()[-1])
        results.append(result)
    return results


def run_lane(
    parts: Iterable[str], selection: Selection, require_blender: bool, lane: Lane
) -> tuple[list[Result], list[str]]:
    """The same for several parts, one after the other."""
    results: list[Result] = []
    summaries: list[str] = []
    for part in parts:
        started = time.perf_counter()
        new_results, new_summaries = run_part(part, selection, require_blender, lane)
        seconds = time.perf_counter() - started
        lane.show(f"\n{part}: {seconds:.0f} s with its set-up, of {BUDGET_S[part]} s\n")
        results += new_results
        summaries += new_summaries
    return results, summaries


def run_lanes(selection: Selection, require_blender: bool) -> tuple[list[Result], list[str]]:
    """All parts, side by side where there are processors for it: what the first lane runs is shown as it runs, what the
    second does after it."""
    processors = os.cpu_count() or 1
    if processors < LANES:
        return run_lane(BUDGET_S, selection, require_blender, Lane(show_now, {}))
    environments.ensure(DEVELOPER)  # both lanes want it
    # threads that wait for each other while another lane has their processor cost more than they bring: each lane has
    # processors of its own, where the system can say so, and the engine takes as many threads
    variables = {"OMP_NUM_THREADS": str(processors // LANES)}
    own = [frozenset[int]()] * LANES
    if hasattr(os, "sched_setaffinity") and len(allowed := sorted(os.sched_getaffinity(0))) >= LANES:
        half = len(allowed) // 2
        own = [frozenset(allowed[:half]), frozenset(allowed[half:])]
    left: queue.SimpleQueue[str] = queue.SimpleQueue()
    for part in BUDGET_S:
        left.put(part)
    kept: list[str] = []
    with ThreadPoolExecutor(LANES) as pool:
        shown, hidden = (
            pool.submit(run_lane, _taken(left), selection, require_blender, Lane(show, variables, cpus))
            for show, cpus in zip((show_now, kept.append), own, strict=True)
        )
        results, summaries = shown.result()
        more_results, more_summaries = hidden.result()
    show_now("".join(kept))
    return [*results, *more_results], [*summaries, *more_summaries]


def _taken(left: "queue.SimpleQueue[str]") -> Iterator[str]:
    """Parts that nobody has begun, until there are none."""
    while not left.empty():
        try:
            yield left.get_nowait()
        except queue.Empty:
            return


def why_no_other_blender(environment: Environment) -> str:
    """Why another Blender is not tried beside the first; empty if it is."""
    try:
        python = environments.find_python(environment.pythons)
        first = environments.find_python(BLENDER.pythons)
    except SetupError:
        return "there is no Python on this machine that it is built for"
    same = environment is BLENDER52 and python == first
    return "the part blender has that version here" if same else ""


def print_summary(results: list[Result], summaries: list[str]) -> None:
    words = {True: "ok", False: "FAILED", None: "not run"}
    print("\n== Summary")
    for result in results:
        print(f"{result.name:<18} {words[result.passed]:<8} {result.seconds:6.1f} s  {result.note}".rstrip())
    for line in summaries:
        print(line)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
                                     allow_abbrev=False)  # fmt: skip
    parser.add_argument("--only", choices=BUDGET_S, help="run one part")
    parser.add_argument("--require-blender", action="store_true", help="fail where Blender's part cannot run")
    options, rest = parser.parse_known_args()
    selection = Selection.of(rest)
    started = time.perf_counter()
    if options.only or selection.selective:
        parts = (options.only,) if options.only else SELECTABLE
        results, summaries = run_lane(parts, selection, options.require_blender, Lane(show_now, {}))
    else:
        results, summaries = run_lanes(replace(selection, of_all=True), options.require_blender)
    print_summary(results, summaries)
    print(f"{time.perf_counter() - started:.0f} s in all, of {ALL_S} s")
    return 1 if any(result.passed is False for result in results) else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except SetupError as problem:
        sys.exit(f"\n{problem}")
    except KeyboardInterrupt:
        sys.exit(130)
