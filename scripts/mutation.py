"""Breaks a line at a time and asks whether a test notices: the part of such mutants that are killed, by area.

    python -m venv mutants && mutants/bin/pip install cosmic-ray
    .envs/engine/bin/python scripts/mutation.py --library mutants/lib/python3.*/site-packages [AREA …] [--sample 20]

Python lines are broken by cosmic-ray's operators, C++ lines by the few below, after which the kernels are built anew.
A mutant is tried in a copy of the checkout, with the test files that name its module, which must pass without it.
Survivors are printed: those that change what users get want a test, others (a size of a buffer, a faster way to the
same picture) are equivalent. It takes about ten seconds a mutant, in C++ a minute, and is run by hand, not in CI.
"""

from __future__ import annotations

import argparse
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# area -> files, and the folders whose tests count for them
AREAS = {
    "hand": (("jghand_engine/hand/*.py",), ("tests/hand", "tests/learn")),
    "template": (("jghand_engine/template/*.py",), ("tests/template",)),
    "render": (("jghand_engine/render/*.py",), ("tests/render", "tests/service")),
    "effects": (("jghand_engine/render/effect*.py", "jghand_engine/render/[bcg]*.py"), ("tests/render",)),
    "training": (("jghand_engine/learn/*.py",), ("tests/learn",)),
    "exporters": (("jghand_engine/export/**/*.py",), ("tests/export",)),
    "studies": (("jghand_engine/study/*.py", "scripts/compare_transforms.py"), ("tests/study", "tests/test_*.py")),
    "kernels": (("jghand_engine/native/*.cpp",), ("tests/native", "tests/render/test_rasterize*.py",
                                                  "tests/render/test_shadow.py", "tests/avatar")),
}  # fmt: skip
# of the lines of C++ that can be broken, one of so many is, unless --sample says how many
CPP_ONE_IN = 10
CPP_OPERATORS = (
    (r" \+ ", " - "), (r" - ", " + "), (r" \* ", " / "), (r" < ", " >= "), (r" > ", " <= "), (r"\bmin\(", "max("),
    (r"\bmax\(", "min("), (r"0\.5f", "1.0f"), (r" && ", " || "), (r"\+= ", "-= "),
)  # fmt: skip
# unions of types are no arithmetic, `is` compares as == does, and a dataclass without its decorator is no program
IGNORED = re.compile(r"BitOr|BitXor|_Is|RemoveDecorator|Variable|Shift|Pow|Mod|FloorDiv|BitAnd")
TIMEOUT_S = 900
BUILD = """
import sys
from jghand_engine.native import build, library
build.build_all(build.host_targets(), build.LIBRARY_FOLDER)
sys.exit(library.load("auto").variant != sys.argv[1])
"""


@dataclass(frozen=True)
class Mutant:
    """path: below the root · line: from 1 · operator: of cosmic-ray by name, of CPP_OPERATORS by number · place: which
    occurrence of it, in C++ the column"""

    path: str
    line: int
    operator: str
    place: int

    @property
    def original(self) -> str:
        return (ROOT / self.path).read_text(encoding="utf-8")

    def text(self) -> str:
        """The whole file with the line broken."""
        if self.path.endswith(".py"):
            from cosmic_ray import mutating, plugins  # pyright: ignore[reportMissingImports]

            broken = mutating.mutate_code(self.original, plugins.get_operator(self.operator)(), self.place)
            return broken or self.original
        lines = self.original.split("\n")
        line = lines[self.line - 1]
        pattern, other = CPP_OPERATORS[int(self.operator)]
        lines[self.line - 1] = line[: self.place] + re.sub(pattern, other, line[self.place :], count=1)
        return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("areas", nargs="*", metavar="AREA", help=f"of {', '.join(AREAS)}; left out: all")
    parser.add_argument("--library", type=Path, required=True, help="the folder that cosmic-ray was installed into")
    parser.add_argument(
        "--sample", type=int, default=0, help="mutants of each area; 0: 100, and of C++ one line in ten"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    sys.path.append(str(options.library))
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        files = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in files.rstrip("\0").split("\0"):
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, copy / name)
        shutil.copytree(ROOT / "jghand_engine/native/lib", copy / "jghand_engine/native/lib")
        for area in options.areas or AREAS:
            killed = tried = 0
            for mutant in sampled(area, options.sample, random.Random(options.seed)):
                tests = tests_of(mutant.path, AREAS[area][1])
                if not passes(copy, tests):
                    print(f"  {mutant.path}:{mutant.line}: its tests fail without it", flush=True)
                    continue
                if mutant.text() == mutant.original:
                    continue
                survived = outlives(mutant, copy, tests)
                tried, killed = tried + 1, killed + (not survived)
                if survived:
                    own, broken = ((each.splitlines())[mutant.line - 1] for each in (mutant.original, mutant.text()))
                    print(f"  {mutant.path}:{mutant.line}\n    - {own.strip()}\n    + {broken.strip()}", flush=True)
            if area == "kernels" and not run(copy, "-c", BUILD, variant()):
                # or the areas behind it would be tried with the last broken kernel
                raise SystemExit(f"{area}: the unbroken kernels do not build")
            print(f"{area}: {killed} of {tried} killed, {100 * killed / max(tried, 1):.0f} %", flush=True)
    return 0


def sampled(area: str, count: int, random_: random.Random) -> list[Mutant]:
    """Mutants of an area, no two of one line."""
    # plots are looked at
    files = sorted({path for pattern in AREAS[area][0] for path in ROOT.glob(pattern) if "plot" not in path.stem})
    found = [mutant for file in files for mutant in (in_cpp(file) if file.suffix == ".cpp" else in_python(file))]
    random_.shuffle(found)
    chosen = [*{(mutant.path, mutant.line): mutant for mutant in found}.values()]
    return chosen[: count or (len(chosen) // CPP_ONE_IN if area == "kernels" else 100)]


def in_python(file: Path) -> Iterator[Mutant]:
    from cosmic_ray import plugins  # pyright: ignore[reportMissingImports]
    from cosmic_ray.ast import ast_nodes, get_ast  # pyright: ignore[reportMissingImports]

    nodes = [*ast_nodes(get_ast(file.read_text(encoding="utf-8")))]
    for name in plugins.operator_names():
        if IGNORED.search(name):
            continue
        operator = plugins.get_operator(name)()
        places = [start for node in nodes for start, _end in operator.mutation_positions(node)]
        for place, (line, _column) in enumerate(places):
            yield Mutant(str(file.relative_to(ROOT)), line, name, place)


def in_cpp(file: Path) -> Iterator[Mutant]:
    for number, line in enumerate(file.read_text(encoding="utf-8").split("\n"), 1):
        if line.lstrip().startswith(("//", "#", "*", "static_assert", "template")):
            continue
        for operator, (pattern, _other) in enumerate(CPP_OPERATORS):
            for found in re.finditer(pattern, line.split("//")[0]):
                yield Mutant(str(file.relative_to(ROOT)), number, str(operator), found.start())


@cache
def tests_of(path: str, folders: tuple[str, ...]) -> tuple[str, ...]:
    """The test files that name the module; of a kernel, and where none does, all that are given."""
    files = [file for folder in folders for file in ROOT.glob(folder if "*" in folder else f"{folder}/test_*.py")]
    name = re.compile(rf"\b{Path(path).stem}\b")
    named = [file for file in files if path.endswith(".py") and name.search(file.read_text(encoding="utf-8"))]
    return tuple(sorted(str(file.relative_to(ROOT)) for file in named or files))


@cache
def passes(copy: Path, tests: tuple[str, ...]) -> bool:
    """Whether they pass without a mutant."""
    return run(copy, "-m", "pytest", "-xq", "-p", "no:cacheprovider", *tests)


def outlives(mutant: Mutant, copy: Path, tests: tuple[str, ...]) -> bool:
    """Whether all tests pass with it. A kernel that does not build, or fails its self-test, is killed."""
    try:
        (copy / mutant.path).write_text(mutant.text(), encoding="utf-8")
        builds = not mutant.path.endswith(".cpp") or run(copy, "-c", BUILD, variant())
        return builds and run(copy, "-m", "pytest", "-xq", "-p", "no:cacheprovider", *tests)
    finally:
        (copy / mutant.path).write_text(mutant.original, encoding="utf-8")


@cache
def variant() -> str:
    """Of the kernels that this machine takes."""
    sys.path.insert(0, str(ROOT))
    from jghand_engine.native.library import load

    return load("auto").variant


def run(copy: Path, *words: str) -> bool:
    """Whether Python ends well in the copy; one that never ends does not."""
    environment = {"PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        command = ["env", *(f"{name}={value}" for name, value in environment.items()), sys.executable, *words]
        return subprocess.run(command, cwd=copy, capture_output=True, timeout=TIMEOUT_S).returncode == 0
    except subprocess.TimeoutExpired:
        return False


if __name__ == "__main__":
    sys.exit(main())
