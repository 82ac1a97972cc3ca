"""Sets everything up, then passes the project's checks and tests.

    python scripts/test.py                     everything
    python scripts/test.py --only engine       one part: checks, engine, blender or blender52
    python scripts/test.py -k fist -x          what this script does not know goes to pytest
    python scripts/test.py tests/hand          a path runs only the tests below it

Needs nothing but Python 3.11 or newer. The part blender52, the extension in Blender 5.2, wants a Python 3.13 on the
machine and is left out without one. With two processors or more the parts of Blender run beside the others, and are
shown after them. The exit code is 0 when everything passed, else 1.
"""

import sys

if sys.version_info < (3, 11):  # noqa: UP036  (the very message this line is for)
    sys.exit("Python 3.11 or newer is needed, this is " + sys.version.split()[0])

import argparse
import os
import re
import subprocess
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import environments
from environments import BLENDER, BLENDER52, DEVELOPER, ROOT, SetupError

PARTS = ("checks", "engine", "blender", "blender52")
# parts that run one after the other, and beside the other lane
LANES = (("checks", "engine"), ("blender", "blender52"))
# what is tried in Blender's Python
BLENDER_PATHS = ("tests/blender",)
# the part of the extension that needs no Blender: tried in the engine's Python, and in one of another version
ADDON_PATHS = ("tests/addon_core",)
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
    """The options for pytest, and the paths of each part; a part with None is not run."""

    options: tuple[str, ...]
    engine: tuple[str, ...] | None
    blender: tuple[str, ...] | None

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
    paths = selection.engine if part == "engine" else selection.blender
    name = f"pytest, {part}"
    if paths is None:
        return [], []
    arguments = (*paths, *selection.options)
    if part == "engine":
        arguments = (*arguments, "--ignore=tests/blender")
        result, summary = run_pytest(name, environments.ensure(DEVELOPER), arguments, selection.selective, lane)
        return [result], [summary]
    environments.ensure(DEVELOPER)  # Blender's side talks to the real engine
    if part == "blender52" and (reason := why_no_second_blender()):
        return [Result(name, None, note=reason)], []
    try:
        python = environments.ensure(BLENDER if part == "blender" else BLENDER52)
    except SetupError as error:
        print(f"\n{error}", file=sys.stderr, flush=True)
        return [Result(name, False if require_blender else None, note="there is no Blender environment, see above")], []
    if part == "blender52" and paths == BLENDER_PATHS:
        arguments = (*ADDON_PATHS, *arguments)
    result, summary = run_pytest(name, python, arguments, selection.selective, lane)
    return [result], [summary]


def run_lane(
    parts: Sequence[str], selection: Selection, require_blender: bool, lane: Lane
) -> tuple[list[Result], list[str]]:
    """The same for several parts, one after the other."""
    results: list[Result] = []
    summaries: list[str] = []
    for part in parts:
        new_results, new_summaries = run_part(part, selection, require_blender, lane)
        results += new_results
        summaries += new_summaries
    return results, summaries


def run_lanes(selection: Selection, require_blender: bool) -> tuple[list[Result], list[str]]:
    """All parts, side by side where there are processors for it: the first lane is shown as it runs, the second after
    it."""
    processors = os.cpu_count() or 1
    if processors < len(LANES):
        return run_lane(PARTS, selection, require_blender, Lane(show_now, {}))
    environments.ensure(DEVELOPER)  # both lanes want it
    # threads that wait for each other while another lane has their processor cost more than they bring: each lane has
    # processors of its own, where the system can say so, and the engine takes as many threads
    variables = {"OMP_NUM_THREADS": str(processors // len(LANES))}
    own = [frozenset[int]()] * len(LANES)
    if hasattr(os, "sched_setaffinity") and len(allowed := sorted(os.sched_getaffinity(0))) >= len(LANES):
        half = len(allowed) // 2
        own = [frozenset(allowed[:half]), frozenset(allowed[half:])]
    kept: list[str] = []
    with ThreadPoolExecutor(len(LANES)) as pool:
        shown, hidden = (
            pool.submit(run_lane, parts, selection, require_blender, Lane(show, variables, cpus))
            for parts, show, cpus in zip(LANES, (show_now, kept.append), own, strict=True)
        )
        results, summaries = shown.result()
        more_results, more_summaries = hidden.result()
    show_now("".join(kept))
    return [*results, *more_results], [*summaries, *more_summaries]


def why_no_second_blender() -> str:
    """Why the newer Blender is not tried beside the other; empty if it is."""
    try:
        environments.find_python(BLENDER52.pythons)
        first = environments.find_python(BLENDER.pythons)
    except SetupError:
        return "there is no Python 3.13 on this machine"
    same = environments.find_python(BLENDER52.pythons) == first
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
    parser.add_argument("--only", choices=PARTS, help="run one part")
    parser.add_argument("--require-blender", action="store_true", help="fail where Blender's part cannot run")
    options, rest = parser.parse_known_args()
    selection = Selection.of(rest)
    if options.only or selection.selective:
        parts = (options.only,) if options.only else PARTS
        results, summaries = run_lane(parts, selection, options.require_blender, Lane(show_now, {}))
    else:
        results, summaries = run_lanes(selection, options.require_blender)
    print_summary(results, summaries)
    return 1 if any(result.passed is False for result in results) else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except SetupError as problem:
        sys.exit(f"\n{problem}")
    except KeyboardInterrupt:
        sys.exit(130)
