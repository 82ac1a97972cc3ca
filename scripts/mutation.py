"""How much of the mathematics the tests would notice: one small change at a time, and does a test fail?

    python scripts/mutation.py hand                          150 mutants of hand/, chosen by seed 0
    python scripts/mutation.py splat --mutants 60 --seed 1   others
    python scripts/mutation.py hand --only rotations frames  some modules of a room
    python scripts/mutation.py --summary                     what is known, as Markdown (for tests/README.md)

A score is the share of mutants that a test kills (fails, or does not end in time). Each room's mutants meet only that
room's tests. Results are kept in tests/mutation.json, survivors with their lines, so that somebody can look at them.

Why not one of the tools: mutmut and cosmic-ray write mutants to files, of the working tree or of a copy that the
compiled kernels and assets must follow into, start Python (and torch: seconds) anew or cannot choose a sample by a
seed. Here nothing is written: mutants live in the memory of a forked process that has torch loaded already, and see
the tests that touch the changed function, quick ones first. Needs a system with fork (Linux, macOS).
"""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.abc
import importlib.util
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "tests" / "mutation.json"
WANTED = 0.85


@dataclass(frozen=True)
class Room:
    """modules: those that compute (files and formats are none) · tests: what may kill a mutant"""

    modules: tuple[str, ...]
    tests: tuple[str, ...]


ROOMS = {
    "hand": Room(
        ("rotations", "frames", "transform", "kinematics", "baselines", "anatomy"),
        ("tests/hand", "tests/hard_cases/test_hard_hands.py"),
    ),
    "template": Room(
        ("closest", "sampling", "surface", "weight_field", "weights", "checks", "texture"),
        ("tests/template", "tests/hostile_files/test_template_files.py"),
    ),
    "splat": Room(
        ("camera", "gate", "reference", "rasterise", "shadow", "picture", "inputs"),
        ("tests/splat", "tests/hard_cases/test_hard_splats.py"),
    ),
}


# ---- mutants --------------------------------------------------------------------------------------------------------

_ARITHMETIC = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
               ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd}  # fmt: skip
_COMPARED: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,),
}  # fmt: skip
_NAMES = {"sin": "cos", "cos": "sin", "min": "max", "max": "min", "amin": "amax", "amax": "amin", "any": "all",
          "all": "any", "clamp_min": "clamp_max", "argmin": "argmax", "argmax": "argmin", "floor": "ceil",
          "zeros_like": "ones_like", "ones_like": "zeros_like", "zeros": "ones", "ones": "zeros"}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One change. place: the node's number in ast.walk, and which of its variants · function: innermost one, or None"""

    module: str
    line: int
    function: str | None
    change: str
    place: tuple[int, int]

    def as_dict(self) -> dict[str, Any]:
        return {"module": self.module, "line": self.line, "function": self.function, "change": self.change}


def variants(node: ast.AST) -> Iterator[tuple[str, Callable[[], None]]]:
    """What may be changed about a node: a sentence, and what does it to the node."""
    if isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in _ARITHMETIC:
        other = _ARITHMETIC[type(node.op)]
        yield f"{type(node.op).__name__} -> {other.__name__}", lambda: setattr(node, "op", other())
    elif isinstance(node, ast.Compare):
        for place, operator in enumerate(node.ops):
            for other_compare in _COMPARED.get(type(operator), ()):
                change = f"{type(operator).__name__} -> {other_compare.__name__}"
                yield change, lambda p=place, o=other_compare: node.ops.__setitem__(p, o())
    elif isinstance(node, ast.BoolOp):
        swapped = ast.Or if isinstance(node.op, ast.And) else ast.And
        yield f"{type(node.op).__name__} -> {swapped.__name__}", lambda: setattr(node, "op", swapped())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        # applied twice is left out, and also where leaving out would change a type
        twice = ast.UnaryOp(node.op, node.operand)
        yield f"{type(node.op).__name__} left out", lambda: setattr(node, "operand", twice)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield f"{node.value} -> {not node.value}", lambda: setattr(node, "value", not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield f"{node.value} -> {node.value + 1}", lambda: setattr(node, "value", node.value + 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        value = 2 * node.value if node.value else 1.0
        yield f"{node.value} -> {value}", lambda: setattr(node, "value", value)
    elif isinstance(node, ast.Attribute) and node.attr in _NAMES:
        other_name = _NAMES[node.attr]
        yield f"{node.attr} -> {other_name}", lambda: setattr(node, "attr", other_name)
    elif isinstance(node, ast.Call) and ast.unparse(node.func) == "torch.where" and len(node.args) == 3:
        yield "where: values swapped", lambda: node.args.__setitem__(slice(1, 3), node.args[:0:-1])


def mutants_of(module: str, source: str) -> list[Mutant]:
    """Every mutant of a module's text; texts, annotations and the words of errors are left alone."""
    tree = ast.parse(source)
    left_alone: set[ast.AST] = set()
    function: dict[ast.AST, str | None] = {}
    _note_functions(tree, (), None, function)
    for node in ast.walk(tree):
        parts: list[ast.AST | None] = []
        if isinstance(node, ast.Raise | ast.Assert | ast.Import | ast.ImportFrom):
            parts = [node]
        elif isinstance(node, ast.arg | ast.AnnAssign):
            parts = [node.annotation]
        elif isinstance(node, ast.FunctionDef):
            parts = [node.returns, *node.decorator_list]
        elif isinstance(node, ast.ClassDef):
            parts = [*node.decorator_list, *node.bases]
        left_alone |= {below for part in parts if part is not None for below in ast.walk(part)}
    return [
        Mutant(module, getattr(node, "lineno", 0), function[node], change, (number, which))
        for number, node in enumerate(ast.walk(tree))
        if node not in left_alone
        for which, (change, _) in enumerate(variants(node))
    ]


def _note_functions(node: ast.AST, path: tuple[str, ...], inside: str | None, found: dict) -> None:
    found[node] = inside
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef):
            below = (*path, child.name)
            _note_functions(child, (*below, "<locals>"), ".".join(below), found)
        elif isinstance(child, ast.ClassDef):
            _note_functions(child, (*path, child.name), inside, found)
        else:
            _note_functions(child, path, inside, found)


def mutated_code(mutant: Mutant, source: str, path: Path) -> CodeType:
    """The module with the change, compiled."""
    tree = ast.parse(source)
    number, which = mutant.place
    node = next(node for place, node in enumerate(ast.walk(tree)) if place == number)
    list(variants(node))[which][1]()
    return compile(ast.fix_missing_locations(tree), str(path), "exec")


class MutatedModule(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives one module another code when it is imported."""

    def __init__(self, name: str, path: Path, code: CodeType) -> None:
        self._name, self._path, self._code = name, path, code

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        if fullname != self._name:
            return None
        return importlib.util.spec_from_file_location(fullname, self._path, loader=self)

    def create_module(self, spec: Any) -> ModuleType | None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        exec(self._code, module.__dict__)


# ---- tests ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Known:
    """Of a run without a change. seconds: of each test · touched: functions (file, qualified name) of each test file"""

    seconds: dict[str, float]
    touched: dict[str, set[tuple[str, str]]]

    def tests_for(self, path: Path, function: str | None) -> list[str]:
        """The tests of all files that touch a function, quick ones first; all tests when that cannot be said."""
        files = set(self.touched)
        if function is not None:
            files = {file for file, functions in self.touched.items() if (str(path), function) in functions}
        return sorted((test for test in self.seconds if test.split("::")[0] in files), key=self.seconds.__getitem__)


class Recorder:
    """A pytest plugin that writes what Known holds."""

    def __init__(self, watched: set[str]) -> None:
        self._watched = watched
        self.seconds: dict[str, float] = {}
        self.touched: dict[str, set[tuple[str, str]]] = {}
        self._now: set[tuple[str, str]] = set()

    def profile(self, frame: Any, event: str, _argument: Any) -> None:
        if event == "call" and frame.f_code.co_filename in self._watched:
            self._now.add((frame.f_code.co_filename, frame.f_code.co_qualname))

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        self.touched.setdefault(report.nodeid.split("::")[0], set()).update(self._now)
        if report.when == "teardown":
            self._now.clear()


class Chosen:
    """A pytest plugin that runs certain tests only, in a certain order."""

    def __init__(self, tests: Sequence[str]) -> None:
        self._place = {test: place for place, test in enumerate(tests)}

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        items[:] = sorted((i for i in items if i.nodeid in self._place), key=lambda i: self._place[i.nodeid])


def run_pytest(paths: Sequence[str], plugin: object) -> int:
    import pytest

    options = ["-x", "-q", "-p", "no:cacheprovider", "--no-header", "--tb=no", "--hypothesis-seed=0"]
    return int(pytest.main([*options, *paths], plugins=[plugin]))


def in_child(work: Callable[[], int], seconds: float) -> int | None:
    """The exit code of `work` in a forked process without output; None when it did not end in time."""
    child = os.fork()
    if child == 0:
        code = 70
        try:
            os.setpgid(0, 0)
            silence = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silence, 1)
            os.dup2(silence, 2)
            code = work()
        finally:
            os._exit(code)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def learn(room: Room, paths: set[str]) -> Known:
    """Runs the room's tests once without a change."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "known.json"

        def work() -> int:
            recorder = Recorder(paths)
            sys.setprofile(recorder.profile)
            code = run_pytest(room.tests, recorder)
            sys.setprofile(None)
            touched = {test: sorted(functions) for test, functions in recorder.touched.items()}
            file.write_text(json.dumps([recorder.seconds, touched]))
            return code

        if (code := in_child(work, 3600)) != 0:
            sys.exit(f"the tests do not pass without a change (exit code {code}); try: pytest {' '.join(room.tests)}")
        seconds, touched = json.loads(file.read_text())
    return Known(seconds, {test: {(a, b) for a, b in functions} for test, functions in touched.items()})


def is_killed(mutant: Mutant, room: str, known: Known, seconds: float) -> bool | None:
    """Whether a test notices the mutant; None when no test touches it at all."""
    path = ROOT / "jghand_engine" / room / f"{mutant.module}.py"
    tests = known.tests_for(path, mutant.function)
    if not tests:
        return None
    code = mutated_code(mutant, path.read_text(encoding="utf-8"), path)

    def work() -> int:
        sys.meta_path.insert(0, MutatedModule(f"jghand_engine.{room}.{mutant.module}", path, code))
        return run_pytest(sorted({test.split("::")[0] for test in tests}), Chosen(tests))

    return in_child(work, seconds) != 0


# ---- results --------------------------------------------------------------------------------------------------------


def read_results() -> dict[str, Any]:
    return json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}


def summary(results: dict[str, Any]) -> str:
    """Markdown: a line per module and per room."""
    lines = ["| room | module | mutants tried | of | killed | score |", "| --- | --- | ---: | ---: | ---: | ---: |"]
    for room, result in results.items():
        total: Counter[str] = Counter()
        for module, count in result["modules"].items():
            total.update(count)
            lines.append(_line(room, module, count))
        lines.append(_line(f"**{room}**", "all", total))
    return "\n".join(lines)


def _line(room: str, module: str, count: dict[str, int]) -> str:
    score = f"{count['killed'] / count['tried']:.0%}" if count["tried"] else "-"
    return f"| {room} | {module} | {count['tried']} | {count['possible']} | {count['killed']} | {score} |"


def measure(room_name: str, options: argparse.Namespace) -> None:
    room = ROOMS[room_name]
    modules = [module for module in room.modules if not options.only or module in options.only]
    folder = ROOT / "jghand_engine" / room_name
    every = [m for module in modules for m in mutants_of(module, (folder / f"{module}.py").read_text(encoding="utf-8"))]
    chosen = random.Random(options.seed).sample(every, min(options.mutants, len(every)))
    print(f"{room_name}: {len(chosen)} of {len(every)} mutants; the tests without a change first", flush=True)
    known = learn(room, {str(folder / f"{module}.py") for module in modules})
    possible = Counter(mutant.module for mutant in every)
    counts = {module: {"tried": 0, "possible": possible[module], "killed": 0} for module in modules}
    survivors, spent = [], Counter[str]()
    for mutant in chosen:
        if spent[mutant.module] > options.module_minutes * 60:
            continue
        began = time.monotonic()
        killed = is_killed(mutant, room_name, known, options.mutant_seconds)
        spent[mutant.module] += int(time.monotonic() - began)
        counts[mutant.module]["tried"] += 1
        counts[mutant.module]["killed"] += bool(killed)
        if not killed:
            survivors.append(mutant.as_dict() | {"tested": killed is not None})
            print(f"  survived: {mutant.module}.py:{mutant.line} {mutant.change} ({mutant.function})", flush=True)
        results = read_results()
        results[room_name] = {"seed": options.seed, "modules": counts, "survivors": survivors}
        RESULTS.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    print(summary({room_name: results[room_name]}) if chosen else "nothing to change")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("room", nargs="?", choices=ROOMS)
    parser.add_argument("--only", nargs="+", metavar="MODULE", help="modules of the room")
    parser.add_argument("--mutants", type=int, default=150, help="how many, chosen at random")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--mutant-seconds", type=float, default=300.0, help="a mutant that takes longer counts as killed"
    )
    parser.add_argument("--module-minutes", type=float, default=60.0, help="then the next module's turn comes")
    parser.add_argument("--summary", action="store_true")
    options = parser.parse_args()
    if options.summary:
        print(summary(read_results()))
        return
    if options.room is None:
        parser.error("which room? " + " | ".join(ROOMS))
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.nice(19)
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    # loaded once, and shared by all forked processes; nothing of the engine
    for name in ("hypothesis", "numpy", "pytest", "scipy.spatial", "torch", "trimesh"):
        importlib.import_module(name)
    measure(options.room, options)


if __name__ == "__main__":
    main()
