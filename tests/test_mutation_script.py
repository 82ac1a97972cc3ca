"""What scripts/mutation.py changes, what it calls survived, and what its table counts."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

pytest.importorskip("resource", reason="the script needs a system with fork")
sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
import mutation

SOURCE = '''
"""One + text."""
LIMIT = 3


def outer(a: int, b: int = 4) -> int:
    if a < b:
        raise ValueError(1 + 1)

    def inner(c):
        return c * -2

    return inner(a + b)
'''


def test_only_what_functions_compute_is_changed():
    """Not constants of the module, defaults, annotations, nor the words of errors."""
    found = [(mutant.line, mutant.column, mutant.change) for mutant in mutation.mutants_of("some", SOURCE)]
    assert sorted(found) == [
        (7, 3, "Lt -> GtE"),
        (7, 3, "Lt -> LtE"),
        (11, 7, "Mult -> Div"),
        (11, 11, "USub left out"),
        (11, 12, "2 -> 3"),
        (13, 13, "Add -> Sub"),
    ]


def test_every_change_is_one_and_stands_in_the_outermost_function():
    before = ast.dump(ast.parse(SOURCE))
    for mutant in mutation.mutants_of("some", SOURCE):
        assert mutant.function == "outer"
        assert mutant.code == SOURCE.splitlines()[mutant.line - 1].strip()
        codes = mutation.mutated_codes(mutant, SOURCE, Path("some.py"))
        assert set(codes) == {"outer", "outer.<locals>.inner"}
    assert ast.dump(ast.parse(SOURCE)) == before


def test_the_table_counts_marked_survivors_apart():
    survivor = {"module": "some", "function": "outer", "change": "2 -> 3", "code": "return c * -2", "column": 12}
    count = {"tried": 10, "possible": 50, "killed": 8, "out_of_time": 1}
    room = {"modules": {"some": count}, "survivors": [survivor, {**survivor, "column": 7}]}
    marked = {**room, "equivalent": [{**survivor, "reason": "nobody asks for it"}]}
    assert "| some | 10 | 50 | 8 | 1 | 0 | 80% | 80% |" in mutation.summary({"room": room})
    assert "| some | 10 | 50 | 8 | 1 | 1 | 80% | 89% |" in mutation.summary({"room": marked})
    # when the line is another, the mark says nothing any more
    lapsed = {**room, "equivalent": [{**survivor, "code": "return c * -4", "reason": "nobody asks for it"}]}
    assert mutation.summary({"room": lapsed}) == mutation.summary({"room": room})


def test_what_is_kept_adds_up_and_every_mark_has_a_reason():
    results = mutation.read_results()
    assert results
    assert set(results) <= set(mutation.ROOMS)
    for room, result in results.items():
        assert set(result["modules"]) <= set(mutation.ROOMS[room].modules)
        survived = sum(count["tried"] - count["killed"] for count in result["modules"].values())
        assert survived == len(result["survivors"])
        for mark in result["equivalent"]:
            assert len(mark["reason"]) > 20
