"""Prints the size of the house beside its aims: lines, files, parameters, options, import circles.

.envs/engine/bin/python scripts/size.py             as a table
.envs/engine/bin/python scripts/size.py --json      as one JSON object
"""

from __future__ import annotations

import argparse
import ast
import json
import sys
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
# the first is the engine, whose packages are listed one by one
TREES = ("jghand_engine", "blender_addon", "tests", "scripts")
SHORT_LINES, MANY_PARAMETERS = 40, 8


@dataclass(frozen=True)
class Figure:
    name: str
    value: int
    # at most so many; None where there is no aim
    aim: int | None = None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    as_json: bool = parser.parse_args().json
    sizes = {tree: lines_of(sources(tree)) for tree in TREES}
    engine = sources("jghand_engine")
    circles = list(import_circles(engine))
    short = [path for tree in TREES[:2] for path, lines in lines_of(sources(tree)).items() if 0 < lines <= SHORT_LINES]
    wide = list(wide_functions([*engine, *sources("blender_addon")]))
    options = options_of_verbs()
    figures = [
        Figure("lines of Python, engine", sum(sizes["jghand_engine"].values()), 33_000),
        Figure("lines of C++, engine", sum(lines_of(sources("jghand_engine", "*.cpp", "*.h")).values())),
        Figure("lines of Python, extension", sum(sizes["blender_addon"].values()), 12_000),
        Figure("files of the extension", len(sizes["blender_addon"]), 75),
        Figure("lines of Python, tests", sum(sizes["tests"].values()), 47_000),
        Figure("lines of Python, scripts", sum(sizes["scripts"].values())),
        Figure(f"files of at most {SHORT_LINES} lines", len(short)),
        Figure(f"public functions with more than {MANY_PARAMETERS} parameters", len(wide), 0),
        Figure("options of the command line", sum(options.values()), 200),
        Figure("import circles among files", len(circles), 0),
    ]
    details = {"short files": [name_of(path) for path in short], "wide functions": wide, "import circles": circles}
    if as_json:
        print(json.dumps({"figures": {one.name: one.value for one in figures}, "options": options, **details}))
        return
    for one in figures:
        met = "" if one.aim is None else f"{one.aim:>8,}  {'met' if one.value <= one.aim else 'not met'}"
        print(f"{one.name:<50}{one.value:>8,}{met}")
    print("\nPackages of the engine: lines, files")
    for package, lines in by_package(sizes["jghand_engine"]).items():
        print(f"  {package:<16}{sum(lines):>8,}{len(lines):>6}")
    print("\nOptions of each verb")
    print("  " + ", ".join(f"{verb} {count}" for verb, count in options.items()))
    for name, found in details.items():
        print(f"\n{name.capitalize()}: {len(found)}")
        for one in found:
            print(f"  {one if isinstance(one, str) else ', '.join(one)}")


def sources(tree: str, *patterns: str) -> list[Path]:
    return sorted(path for pattern in patterns or ("*.py",) for path in (ROOT / tree).rglob(pattern))


def lines_of(paths: Iterable[Path]) -> dict[Path, int]:
    return {path: len(path.read_text(encoding="utf-8").splitlines()) for path in paths}


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def by_package(lines: dict[Path, int]) -> dict[str, list[int]]:
    """Line counts of the files of each package of the engine; files beside the packages together."""
    found: dict[str, list[int]] = {}
    for path, count in lines.items():
        parts = path.relative_to(ROOT / "jghand_engine").parts
        found.setdefault(parts[0] if len(parts) > 1 else "(top)", []).append(count)
    return found


def wide_functions(paths: Iterable[Path]) -> Iterator[str]:
    """Public functions with too many parameters, each as file:line name count."""
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) or node.name.startswith("_"):
                continue
            named = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            count = len(named) - (bool(named) and named[0].arg in ("self", "cls"))
            if count > MANY_PARAMETERS:
                yield f"{name_of(path)}:{node.lineno} {node.name} {count}"


def import_circles(paths: Iterable[Path]) -> Iterator[list[str]]:
    """Groups of files that import one another, inside functions too; imports for type checkers alone do not count."""
    modules = {module_name(path): path for path in paths}
    graph = {name: set(imported(path, modules)) - {name} for name, path in modules.items()}
    reached = {name: _reachable(name, graph) for name in graph}
    told: set[str] = set()
    for name in sorted(graph):
        circle = sorted({name} | {other for other in reached[name] if name in reached[other]})
        if name in reached[name] and name not in told:
            told.update(circle)
            yield circle


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(path: Path, modules: dict[str, Path]) -> Iterator[str]:
    """The modules among `modules` that a file imports when it runs."""
    waiting: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            waiting += node.orelse
            continue
        waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom) and node.module:
            above = module_name(path).split(".")[: -node.level] if node.level else []
            module = ".".join([*above, node.module])
            inner = [f"{module}.{alias.name}" for alias in node.names]
            if any(name not in modules for name in inner) and module in modules:
                yield module
            yield from (name for name in inner if name in modules)


def _reachable(start: str, graph: dict[str, set[str]]) -> set[str]:
    """Every module that `start` imports, directly or not; `start` itself only where it is in a circle."""
    found: set[str] = set()
    waiting = list(graph[start])
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += graph[name]
    return found


def options_of_verbs() -> dict[str, int]:
    """Options of each verb of `jghand`, --help apart."""
    import tyro

    sys.path.insert(0, str(ROOT))
    from jghand_engine import cli

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # get_parser has no successor yet
        parsers = {
            name: tyro.extras.get_parser(verb, config=cli.STYLE)
            for name, verb in ((name, cli.verb_called(name)[0]) for name in cli.VERBS)
        }
    return {name: _options(parser) for name, parser in parsers.items()}


def _options(parser: Any) -> int:
    own = sum(bool(action.option_strings) and "--help" not in action.option_strings for action in parser._actions)
    nested = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return own + sum(_options(inner) for action in nested for inner in action.choices.values())


if __name__ == "__main__":
    main()
