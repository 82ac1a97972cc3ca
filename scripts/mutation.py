"""Breaks a line at a time and asks whether a test notices: the part of such mutants that are killed, by area.

    python -m venv mutants && mutants/bin/pip install cosmic-ray
    .envs/engine/bin/python scripts/mutation.py --library mutants/lib/python3.*/site-packages [AREA …] [--sample 20]

Python lines are broken by cosmic-ray's operators, C++ lines by the few below, after which the kernels are built anew.
A mutant is tried in a copy of the checkout, with the test files that name its module or one beside it that imports it;
they must pass without it. Those that import it come first. One with which they take far longer is killed, too. Every
run of tests is a fork of this process (Linux, macOS), so that NumPy and PyTorch are loaded once; only modules that
changed are built anew.
Survivors are printed: those that change what users get want a test, others (a size of a buffer, a faster way to the
same picture) are equivalent. It takes some seconds a mutant and is run by hand, not in CI.
"""

from __future__ import annotations

import argparse
import importlib
import math
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NATIVE, GOLDEN = "jghand_engine/native", "tests/golden/test_golden_frames.py"
# area -> files, and the tests that count for them; of C++ those of each entry are asked after all before it have passed
AREAS = {
    "hand": (("jghand_engine/hand/*.py",), ("tests/hand", "tests/service", "tests/learn")),
    "template": (("jghand_engine/template/*.py",), ("tests/template", "tests/hostile_files")),
    "render": (("jghand_engine/render/*.py",), ("tests/render", "tests/service")),
    "effects": (("jghand_engine/render/effect*.py", "jghand_engine/render/[bcg]*.py"), ("tests/render",)),
    "training": (("jghand_engine/learn/*.py",),
                 ("tests/learn", "tests/hand", "tests/avatar", "tests/render", "tests/hard_cases", "tests/cli")),
    "exporters": (("jghand_engine/export/**/*.py",), ("tests/export",)),
    "studies": (("jghand_engine/study/*.py", "scripts/compare_transforms.py"), ("tests/study", "tests/test_*.py")),
    "raster": ((f"{NATIVE}/raster*.cpp", f"{NATIVE}/raster.h", f"{NATIVE}/projection.h", f"{NATIVE}/tile.h"),
               ("tests/native/test_rasterizer.py", "tests/render/test_rasterize*.py", "tests/render/test_ellipsoids.py",
                GOLDEN)),
    "shadow": ((f"{NATIVE}/shadow*.cpp", f"{NATIVE}/shadow.h"), ("tests/render/test_shadow.py", GOLDEN)),
    "detail": ((f"{NATIVE}/detail*.cpp", f"{NATIVE}/detail*.h", f"{NATIVE}/pixel_shadow.h"),
               (*(f"tests/render/test_{name}.py" for name in ("outline", "relief", "detail", "fine_faces")),
                "tests/render/test_lamp_depth.py", "tests/learn/test_learned_detail.py", "tests/export/test_web.py",
                GOLDEN)),
    "scene_light": ((f"{NATIVE}/scene_light.*", f"{NATIVE}/lamp_depth.h"),
                    ("tests/avatar/test_scene_light.py", "tests/render/test_lamp_depth.py",
                     "tests/render/test_relief.py", "tests/render/test_light_effects.py",
                     "tests/avatar/test_world_suns.py")),
    "others": (tuple(f"{NATIVE}/{name}.cpp" for name in ("skeleton", "view", "ssim", "mean")),
               ("tests/learn/test_losses.py", "tests/hand/test_bones.py", "tests/render/test_crop.py",
                "tests/render/test_effects.py", GOLDEN)),
    "skin": ((f"{NATIVE}/skin*", f"{NATIVE}/learned*.cpp", f"{NATIVE}/learned.h", f"{NATIVE}/capsule.h"),
             ("tests/avatar", "tests/learn/test_trained_skin.py", GOLDEN)),
}  # fmt: skip
# of the lines that can be broken in C++, one of so many is, unless --sample says how many
CPP_ONE_IN = 10
CPP_OPERATORS = (
    (r" \+ ", " - "), (r" - ", " + "), (r" \* ", " / "), (r" < ", " >= "), (r" > ", " <= "), (r"\bmin\(", "max("),
    (r"\bmax\(", "min("), (r"0\.5f", "1.0f"), (r" && ", " || "), (r"\+= ", "-= "),
)  # fmt: skip
# unions of types are no arithmetic, `is` compares as == does, and a dataclass without its decorator is no program
IGNORED = re.compile(r"BitOr|BitXor|_Is|RemoveDecorator|Variable|Shift|Pow|Mod|FloorDiv|BitAnd")
# that anything may take, on the clock; and how many times the seconds of a processor that tests take without a mutant
TIMEOUT_S = 900
PATIENCE = 4
# the hash of all sources is written into the built library: in the compiler's command it would keep files that are as
# they were from coming out of its cache
BUILD = """
import sys
from jghand_engine.native import build, library
hash_of, none = build.source_hash, "0" * 64
for target in build.host_targets():
    if not build.has_these_sources(target):
        build.source_hash = lambda target: none
        path = build.build(target)
        build.source_hash = hash_of
        path.write_bytes(path.read_bytes().replace(none.encode(), hash_of(target).encode()))
sys.exit(library.load("auto").variant != sys.argv[1])
"""
# what tests import of others: loaded once, for all their processes
LOADED = ("hypothesis", "numpy", "PIL.Image", "pytest", "safetensors.numpy", "scipy.spatial", "torch", "trimesh")


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
        if not is_cpp(self.path):
            from cosmic_ray import mutating, plugins  # pyright: ignore[reportMissingImports]

            broken = mutating.mutate_code(self.original, plugins.get_operator(self.operator)(), self.place)
            return broken or self.original
        lines = self.original.split("\n")
        line = lines[self.line - 1]
        pattern, other = CPP_OPERATORS[int(self.operator)]
        lines[self.line - 1] = line[: self.place] + re.sub(pattern, other, line[self.place :], count=1)
        return "\n".join(lines)

    @property
    def is_program(self) -> bool:
        """Whether it is another one than the original, and one that Python reads: cosmic-ray takes the bare star of a
        signature for a product."""
        try:
            return self.text() != self.original and (is_cpp(self.path) or bool(compile(self.text(), self.path, "exec")))
        except SyntaxError:
            return False


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
    # a broken line of the same length, within a second, would be taken for the unbroken one
    sys.dont_write_bytecode = True
    os.environ["OMP_NUM_THREADS"] = "1"  # before it is loaded
    for name in LOADED:
        importlib.import_module(name)
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
                if not mutant.is_program:
                    continue
                survived = outlives(mutant, copy, tests_of(mutant.path, AREAS[area][1]))
                if survived is None:
                    print(f"  {mutant.path}:{mutant.line}: its tests fail without it", flush=True)
                    continue
                tried, killed = tried + 1, killed + (not survived)
                print("." if not survived else "", end="", file=sys.stderr, flush=True)
                if survived:
                    own, broken = ((each.splitlines())[mutant.line - 1] for each in (mutant.original, mutant.text()))
                    print(f"  {mutant.path}:{mutant.line}\n    - {own.strip()}\n    + {broken.strip()}", flush=True)
            # or the areas behind it would be tried with the last broken kernel
            if AREAS[area][0][0].startswith(NATIVE) and not builds(copy):
                raise SystemExit(f"{area}: the unbroken kernels do not build")
            print(f"{area}: {killed} of {tried} killed, {100 * killed / max(tried, 1):.0f} %", flush=True)
    return 0


def sampled(area: str, count: int, random_: random.Random) -> list[Mutant]:
    """Mutants of an area, no two of one line."""
    # plots are looked at
    files = sorted({path for pattern in AREAS[area][0] for path in ROOT.glob(pattern) if "plot" not in path.stem})
    found = [mutant for file in files for mutant in (in_cpp if is_cpp(file.name) else in_python)(file)]
    random_.shuffle(found)
    chosen = [*{(mutant.path, mutant.line): mutant for mutant in found}.values()]
    return chosen[: count or (len(chosen) // CPP_ONE_IN if AREAS[area][0][0].startswith(NATIVE) else 100)]


def in_python(file: Path) -> Iterator[Mutant]:
    from cosmic_ray import plugins  # pyright: ignore[reportMissingImports]
    from cosmic_ray.ast import ast_nodes, get_ast  # pyright: ignore[reportMissingImports]

    lines = file.read_text(encoding="utf-8").splitlines()
    nodes = [*ast_nodes(get_ast(file.read_text(encoding="utf-8")))]
    for name in plugins.operator_names():
        if IGNORED.search(name):
            continue
        operator = plugins.get_operator(name)()
        places = [start for node in nodes for start, _end in operator.mutation_positions(node)]
        for place, (line, _column) in enumerate(places):
            if name.endswith("ReplaceTrueWithFalse") and "strict=True" in lines[line - 1]:
                continue  # says of two lists that they are as long as each other, which they are
            yield Mutant(str(file.relative_to(ROOT)), line, name, place)


def in_cpp(file: Path) -> Iterator[Mutant]:
    for number, line in enumerate(file.read_text(encoding="utf-8").split("\n"), 1):
        if line.lstrip().startswith(("//", "#", "*", "static_assert", "template")):
            continue
        for operator, (pattern, _other) in enumerate(CPP_OPERATORS):
            # what is fetched early is no part of the result
            for found in re.finditer(pattern, line.split("//")[0].split("prefetch")[0]):
                yield Mutant(str(file.relative_to(ROOT)), number, str(operator), found.start())


def is_cpp(path: str) -> bool:
    return path.endswith((".cpp", ".h"))


@cache
def tests_of(path: str, folders: tuple[str, ...]) -> list[str]:
    """In turn the test files of each entry that import the module, that name it, and that name a module beside it that
    imports it; of C++ all of them, and in Python where none does."""
    entries = [sorted(ROOT.glob(each if each.endswith(".py") else f"{each}/test_*.py")) for each in folders]
    texts = {file: file.read_text(encoding="utf-8") for files in entries for file in files}
    own, beside = Path(path).stem, (ROOT / path).parent.glob("*.py")
    imported = re.compile(rf"import.*\b{own}\b|from.*\b{own} import")
    users = [own, *(file.stem for file in beside if imported.search(file.read_text(encoding="utf-8")))]
    name, by_users = re.compile(rf"\b{own}\b"), re.compile(rf"\b({'|'.join(users)})\b")
    parts = []
    for files in entries:
        first = [file for file in files if imported.search(texts[file])]
        named = [file for file in files if name.search(texts[file]) and file not in first]
        far = [file for file in files if by_users.search(texts[file]) and file not in (*first, *named)]
        parts += [first, named, far]
    if is_cpp(path) or not any(parts):
        parts = entries
    return [str(file.relative_to(ROOT)) for part in parts for file in part]


@cache
def seconds(copy: Path, test: str) -> float:
    """Of a processor that a file of tests takes without a mutant; infinite where one fails."""
    return run_tests(copy, test, TIMEOUT_S)


def outlives(mutant: Mutant, copy: Path, tests: list[str]) -> bool | None:
    """Whether all tests pass with it; None where they do not without it. A kernel that does not build, or fails its
    self-test, is killed."""
    if is_cpp(mutant.path):
        for test in tests:  # once, while the built kernels are the unbroken ones
            seconds(copy, test)
        with broken(mutant, copy):
            if not builds(copy):
                return False
    for test in tests:
        limit_s = PATIENCE * seconds(copy, test)
        if not math.isfinite(limit_s):
            return None
        with broken(mutant, copy):
            if not math.isfinite(run_tests(copy, test, limit_s)):
                return False
    return True


@contextmanager
def broken(mutant: Mutant, copy: Path) -> Iterator[None]:
    """The copy with its line broken."""
    (copy / mutant.path).write_text(mutant.text(), encoding="utf-8")
    try:
        yield
    finally:
        (copy / mutant.path).write_text(mutant.original, encoding="utf-8")


@cache
def variant() -> str:
    """Of the kernels that this machine takes."""
    command = [sys.executable, "-c", "from jghand_engine.native.library import load; print(load('auto').variant)"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()


def run_tests(copy: Path, test: str, limit_s: float) -> float:
    """Seconds of a processor that a file of tests takes, in a process that has what it imports of others; infinite
    where one fails, or all take longer."""
    child = os.fork()
    if not child:
        os.chdir(copy)
        sys.path.insert(0, str(copy))
        os.environ |= {"PYTHONPATH": str(copy), "TMPDIR": str(copy.parent)}
        for output in (1, 2):
            os.dup2(os.open(os.devnull, os.O_WRONLY), output)
        signal.alarm(TIMEOUT_S)
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(limit_s), math.ceil(limit_s)))
        pytest = importlib.import_module("pytest")
        none_here = pytest.ExitCode.NO_TESTS_COLLECTED  # of a file that skips itself
        os._exit(pytest.main(["-xq", "-p", "no:cacheprovider", test]) not in (0, none_here))
    _, status, used = os.wait4(child, 0)
    return math.inf if status else used.ru_utime + used.ru_stime


def builds(copy: Path) -> bool:
    """Whether the kernels of the copy build, load and pass their self-test."""
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    command = [sys.executable, "-c", BUILD, variant()]
    return subprocess.run(command, cwd=copy, env=environment, capture_output=True, timeout=TIMEOUT_S).returncode == 0


if __name__ == "__main__":
    sys.exit(main())
