"""How much of the mathematics the tests would notice: one small change at a time, and does a test fail?

    python scripts/mutation.py hand                          150 mutants of hand/, chosen by seed 0
    python scripts/mutation.py render --mutants 60 --seed 1   others
    python scripts/mutation.py hand --only rotations poses   some modules of a room
    python scripts/mutation.py hand --more --minutes 9       goes on where the last run stopped
    python scripts/mutation.py hand --again                  the survivors once more, after tests were added
    python scripts/mutation.py --summary                     what is known, written into tests/README.md

A score is the share of mutants that a test kills: it fails, or takes more processor time than allowed (counted apart).
Each room's mutants meet only that room's tests. Results are kept in tests/mutation.json with every survivor's line.
A change that nobody can notice may be marked there, by hand, one by one: an entry of the room's list "equivalent" with
the survivor's module, function, change, code and column, and the reason. The mark lapses when the line is changed.

Why not one of the tools: mutmut and cosmic-ray write mutants to files, of the working tree or of a copy that kernels
and assets must follow into, start Python (and torch: seconds) for each, or cannot choose a sample by a seed. Here
nothing is written: pytest collects once, then every mutant gets a forked process in which the changed function's code
is put in place, and which runs the tests that touch it, quick ones first. So only what stands in a function can be
changed, not constants and defaults of a module. Needs a system with fork (Linux, macOS).
"""

from __future__ import annotations

import argparse
import ast
import gc
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "tests" / "mutation.json"
README = ROOT / "tests" / "README.md"
BEGIN, END = "<!-- scripts/mutation.py: begin -->", "<!-- scripts/mutation.py: end -->"
MEMORY_BYTES = 6 << 30


@dataclass(frozen=True)
class Room:
    """modules: those that compute (files and formats are none) · tests: what may kill a mutant"""

    modules: tuple[str, ...]
    tests: tuple[str, ...]


ROOMS = {
    "hand": Room(
        ("rotations", "skeleton", "kinematics", "poses"),
        ("tests/hand", "tests/hard_cases/test_hard_hands.py"),
    ),
    "template": Room(
        ("closest", "sampling", "surface", "weight_field", "weights", "checks", "texture"),
        ("tests/template", "tests/hostile_files/test_template_files.py"),
    ),
    "render": Room(
        ("camera", "gate", "blur", "shadow", "image"),
        ("tests/render", "tests/hard_cases/test_hard_splats.py"),
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
    """One change. place: the node's number in ast.walk, and which of its variants · function: qualified name of the
    outermost one around it · code, column: the line without its indent, and where in it the node begins"""

    module: str
    line: int
    function: str
    change: str
    code: str
    column: int
    place: tuple[int, int]


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
        more = node.value + 1
        yield f"{node.value} -> {more}", lambda: setattr(node, "value", more)
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
    tree, lines = ast.parse(source), source.splitlines()
    left_alone: set[ast.AST] = set()
    function = dict(_functions(tree, ""))
    for node in ast.walk(tree):
        parts: list[ast.AST | None] = []
        if isinstance(node, ast.Raise | ast.Assert | ast.Import | ast.ImportFrom):
            parts = [node]
        elif isinstance(node, ast.arg | ast.AnnAssign):
            parts = [node.annotation]
        elif isinstance(node, ast.FunctionDef):
            parts = [node.returns, *node.decorator_list, *node.args.defaults, *node.args.kw_defaults]
        elif isinstance(node, ast.ClassDef):
            parts = [*node.decorator_list, *node.bases]
        left_alone |= {below for part in parts if part is not None for below in ast.walk(part)}
    found = []
    for number, node in enumerate(ast.walk(tree)):
        changes = [] if node in left_alone or node not in function else list(variants(node))
        for which, (change, _) in enumerate(changes):
            line = getattr(node, "lineno", 1)
            code = lines[line - 1].strip()
            column = getattr(node, "col_offset", 0) - lines[line - 1].index(code)
            found.append(Mutant(module, line, function[node], change, code, column, (number, which)))
    return found


def _functions(node: ast.AST, path: str) -> Iterator[tuple[ast.AST, str]]:
    """Every node inside a function, with the qualified name of the outermost one."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef):
            yield from ((below, path + child.name) for below in ast.walk(child))
        else:
            yield from _functions(child, f"{path}{child.name}." if isinstance(child, ast.ClassDef) else path)


def mutated_codes(mutant: Mutant, source: str, path: Path) -> dict[str, CodeType]:
    """The codes of the module's functions with the change, by qualified name."""
    tree = ast.parse(source)
    number, which = mutant.place
    node = next(node for place, node in enumerate(ast.walk(tree)) if place == number)
    list(variants(node))[which][1]()
    found: dict[str, CodeType] = {}
    to_see = [compile(ast.fix_missing_locations(tree), str(path), "exec", dont_inherit=True)]
    while to_see:
        for constant in to_see.pop().co_consts:
            if isinstance(constant, CodeType):
                found[constant.co_qualname] = constant
                to_see.append(constant)
    return found


def put_in_place(mutant: Mutant, source: str, path: Path) -> bool:
    """Gives the living function the changed code; whether there was one."""
    code = mutated_codes(mutant, source, path)[mutant.function]
    living = [
        thing
        for thing in gc.get_objects()
        if isinstance(thing, FunctionType)
        and thing.__code__.co_filename == str(path)
        and thing.__code__.co_qualname == mutant.function
    ]
    for function in living:
        function.__code__ = code
    return bool(living)


# ---- tests ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Known:
    """Of a run without a change. seconds: of each test · touched: tests by the function (file:name) they call"""

    seconds: dict[str, float]
    touched: dict[str, list[str]]

    def items_for(self, function: str, items: list[Any], longest_s: float) -> list[Any]:
        """The tests that touch a function, quick ones first; none that takes longer than that."""
        names = {name for name in self.touched.get(function, ()) if self.seconds[name] <= longest_s}
        return sorted((item for item in items if item.nodeid in names), key=lambda item: self.seconds[item.nodeid])


class Reports:
    """A pytest plugin that ends the process at the first failure, and leaves the failed test's name in a file."""

    def __init__(self, killer: Path) -> None:
        self._killer = killer

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            self._killer.write_text(report.nodeid, encoding="utf-8")
            os._exit(1)


def run(items: list[Any], around: Callable[[Any, Callable[[], None]], None] = lambda item, work: work()) -> None:
    """Runs collected tests in their order."""
    for place, item in enumerate(items):
        following = items[place + 1] if place + 1 < len(items) else None
        around(item, lambda i=item, f=following: i.config.hook.pytest_runtest_protocol(item=i, nextitem=f))


def in_child(work: Callable[[], None], cpu_seconds: int) -> int:
    """The exit code of `work` in a forked, silent process: 0 when it came to its end; below 0 when it took more
    processor time than allowed."""
    child = os.fork()
    if child == 0:
        code = 70
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds))
            # a loop without an end takes memory too
            resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
            silence = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silence, 1)
            os.dup2(silence, 2)
            work()
            code = 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def learn(items: list[Any], watched: set[str], kept: Path) -> Known:
    """Runs the tests once without a change, and notes which functions each of them calls; not those that `kept`, a
    line of JSON for each, already knows."""
    notes = [json.loads(line) for line in kept.read_text(encoding="utf-8").splitlines()] if kept.exists() else []
    noted = {test for test, _, _ in notes}

    def work() -> None:
        now: set[str] = set()

        def profile(frame: Any, event: str, _argument: Any) -> None:
            if event == "call" and frame.f_code.co_filename in watched:
                name = frame.f_code.co_qualname.split(".<locals>")[0]
                now.add(f"{frame.f_code.co_filename}:{name}")

        def around(item: Any, test: Callable[[], None]) -> None:
            now.clear()
            began = time.process_time()
            sys.setprofile(profile)
            try:
                test()
            finally:
                sys.setprofile(None)
            with kept.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps([item.nodeid, time.process_time() - began, sorted(now)]) + "\n")

        run([item for item in items if item.nodeid not in noted], around)

    if (code := in_child(work, 3600)) != 0:
        sys.exit(f"the tests do not pass without a change (exit code {code})")
    seconds: dict[str, float] = {}
    touched: dict[str, list[str]] = {}
    for test, took, functions in map(json.loads, kept.read_text(encoding="utf-8").splitlines()):
        seconds[test] = took
        for function in functions:
            touched.setdefault(function, []).append(test)
    return Known(seconds, touched)


# ---- results --------------------------------------------------------------------------------------------------------


def read_results() -> dict[str, Any]:
    return json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}


def is_equivalent(survivor: dict[str, Any], marks: list[dict[str, Any]]) -> bool:
    """Whether a mark names this survivor."""
    names = ("module", "function", "change", "code", "column")
    return any(all(mark[name] == survivor[name] for name in names) for mark in marks)


def summary(results: dict[str, Any]) -> str:
    """Markdown: a line per module and per room."""
    lines = [
        "| room | module | mutants tried | of | killed | of these out of time | equivalent | score | of the others |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for room, result in results.items():
        equivalent = Counter(
            survivor["module"]
            for survivor in result["survivors"]
            if is_equivalent(survivor, result.get("equivalent", []))
        )
        total: Counter[str] = Counter()
        for module, count in result["modules"].items():
            total.update(count)
            lines.append(_line(room, module, count, equivalent[module]))
        lines.append(_line(f"**{room}**", "all", total, equivalent.total()))
    return "\n".join(lines)


def _line(room: str, module: str, count: dict[str, int], equivalent: int) -> str:
    tried, killed = count["tried"], count["killed"]
    scores = [f"{killed / of:.0%}" if of else "-" for of in (tried, tried - equivalent)]
    numbers = (tried, count["possible"], killed, count["out_of_time"], equivalent, *scores)
    return f"| {room} | {module} | " + " | ".join(map(str, numbers)) + " |"


def _is(survivor: dict[str, Any], mutant: Mutant) -> bool:
    return (survivor["module"], tuple(survivor["place"])) == (mutant.module, mutant.place)


class Measurement:
    """A pytest plugin: instead of running the collected tests it tries mutants on them."""

    def __init__(self, room: str, options: argparse.Namespace, killer: Path) -> None:
        self._room, self._options, self._killer = room, options, killer
        self._folder = ROOT / "jghand_engine" / room
        self._modules = [m for m in ROOMS[room].modules if not options.only or m in options.only]
        self._sources = {m: (self._folder / f"{m}.py").read_text(encoding="utf-8") for m in self._modules}

    def pytest_runtestloop(self, session: Any) -> bool:
        every = [mutant for module, source in self._sources.items() for mutant in mutants_of(module, source)]
        result, chosen = self._begin(every)
        print(f"\n{self._room}: {len(chosen)} of {len(every)} mutants; the tests without a change first", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            kept = self._options.known or Path(folder) / "known.jsonl"
            known = learn(session.items, {str(self._path(module)) for module in self._modules}, kept)
        print(f"{len(session.items)} tests, {sum(known.seconds.values()):.0f} s; now the mutants", flush=True)
        spent: Counter[str] = Counter()
        end = time.monotonic() + 60 * self._options.minutes
        for mutant in chosen:
            began = time.monotonic()
            if began > end:
                print("the time is over: --more goes on from here", flush=True)
                break
            if self._options.again:
                # what was killed stays killed
                result["survivors"] = [m for m in result["survivors"] if not _is(m, mutant)]
                result["modules"][mutant.module]["tried"] -= 1
            else:
                result["sample"] += 1
            if spent[mutant.module] <= self._options.module_minutes * 60:
                self._try(mutant, known, session.items, result)
            spent[mutant.module] += round(time.monotonic() - began)
            if not self._options.dry:
                RESULTS.write_text(
                    json.dumps({**read_results(), self._room: result}, indent=1) + "\n", encoding="utf-8"
                )
        print(summary({self._room: result}), flush=True)
        return True

    def _begin(self, every: list[Mutant]) -> tuple[dict[str, Any], list[Mutant]]:
        """What is known before, and the mutants to try."""
        options, before = self._options, read_results().get(self._room, {})
        possible = Counter(mutant.module for mutant in every)
        tests = list(options.tests or ROOMS[self._room].tests)
        about = {"seed": options.seed, "tests": tests, "longest_test_s": options.test_seconds}
        order = random.Random(options.seed).sample(every, len(every))
        if not (options.again or options.more):
            empty = {m: {"tried": 0, "possible": possible[m], "killed": 0, "out_of_time": 0} for m in self._modules}
            marks = before.get("equivalent", [])
            result = {**about, "sample": 0, "modules": empty, "survivors": [], "equivalent": marks}
            return result, order[: options.mutants]
        if {module: count["possible"] for module, count in before["modules"].items()} != dict(possible):
            sys.exit("the modules are not those of the results: begin anew, without --again and --more")
        if options.again:
            return before, [mutant for mutant in every if any(_is(m, mutant) for m in before["survivors"])]
        if before["seed"] != options.seed:
            sys.exit(f"the results are of seed {before['seed']}: begin anew, or give that seed")
        return {**before, **about}, order[before["sample"] : options.mutants]

    def _try(self, mutant: Mutant, known: Known, items: list[Any], result: dict[str, Any]) -> None:
        function = f"{self._path(mutant.module)}:{mutant.function}"
        touching = known.items_for(function, items, self._options.test_seconds)
        # three times what the tests take without a change, and ten seconds: who needs more goes round in circles
        allowed_s = 10 + 3 * sum(known.seconds[item.nodeid] for item in touching)
        code = self._fate(mutant, touching, round(min(allowed_s, self._options.mutant_seconds)))
        count = result["modules"][mutant.module]
        count["tried"] += 1
        count["killed"] += code != 0
        count["out_of_time"] += code in (-signal.SIGXCPU, -signal.SIGKILL)
        if code == 0:
            result["survivors"].append({**asdict(mutant), "place": list(mutant.place), "tests": len(touching)})
        marked = is_equivalent(asdict(mutant), result["equivalent"])
        if marked or code == 0 or self._options.verbose:
            killer = self._killer.read_text(encoding="utf-8") if code > 0 else f"signal {-code}"
            fate = f"survived {len(touching)} tests" if code == 0 else f"killed by {killer}"
            where = f"{mutant.module}.py:{mutant.line}:{mutant.column} {mutant.change} ({mutant.function})"
            print(f"  {where}{', marked as equivalent' * marked}: {fate}", flush=True)

    def _path(self, module: str) -> Path:
        return self._folder / f"{module}.py"

    def _fate(self, mutant: Mutant, items: list[Any], cpu_seconds: int) -> int:
        """0: no test noticed."""
        self._killer.unlink(missing_ok=True)
        if not items:
            return 0

        def work() -> None:
            if put_in_place(mutant, self._sources[mutant.module], self._path(mutant.module)):
                run(items)

        code = in_child(work, cpu_seconds)
        if code > 0 and not self._killer.exists():
            sys.exit(f"{mutant}: its process ended by {code} without a failed test")
        return code


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("room", nargs="?", choices=ROOMS)
    parser.add_argument("--only", nargs="+", metavar="MODULE", help="modules of the room")
    parser.add_argument("--tests", nargs="+", metavar="PATH", help="only these of the room's tests: a lower bound")
    parser.add_argument("--mutants", type=int, default=150, help="how many, chosen at random")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--mutant-seconds", type=int, default=300, help="processor time at most, after which it counts as killed"
    )
    parser.add_argument("--module-minutes", type=float, default=60.0, help="then no more mutants of that module")
    parser.add_argument("--test-seconds", type=float, default=60.0, help="no test that takes longer: a lower bound")
    parser.add_argument("--minutes", type=float, default=600.0, help="then no more mutants")
    parser.add_argument("--more", action="store_true", help="go on with the sample, up to --mutants")
    parser.add_argument("--known", type=Path, metavar="FILE", help="keeps which tests touch what, for the next run")
    parser.add_argument("--again", action="store_true", help="try the survivors again, after tests were added")
    parser.add_argument("--verbose", action="store_true", help="say of every mutant which test killed it")
    parser.add_argument("--dry", action="store_true", help="keep no results")
    parser.add_argument("--summary", action="store_true")
    options = parser.parse_args()
    if options.summary:
        text = README.read_text(encoding="utf-8")
        inner = f"{BEGIN}\n{summary(read_results())}\n"
        README.write_text(text[: text.index(BEGIN)] + inner + text[text.index(END) :], encoding="utf-8")
        print(summary(read_results()))
        return
    if options.room is None:
        parser.error("which room? " + " | ".join(ROOMS))
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.nice(19)
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    import pytest

    quiet = ["-q", "-p", "no:cacheprovider", "--no-header", "--tb=no", "--hypothesis-seed=0", "-s"]
    paths = options.tests or ROOMS[options.room].tests
    with tempfile.TemporaryDirectory() as folder:
        killer = Path(folder) / "killer"
        pytest.main([*quiet, *paths], plugins=[Reports(killer), Measurement(options.room, options, killer)])


if __name__ == "__main__":
    main()
