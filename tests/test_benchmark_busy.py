"""The busy benchmark: both sides take turns beside as many loops as asked for, and a row holds their medians."""

from __future__ import annotations

import contextlib

import benchmark_busy as benchmark


def test_a_row_compares_both_sides_beside_the_same_loops(monkeypatch):
    loops: list[int] = []

    class Stand(contextlib.nullcontext):
        def __init__(self, what: str, count: int) -> None:
            super().__init__(self)
            self.rate = 8.0 if count else 6.0

        def per_second(self) -> float:
            return self.rate / (1 + loops[-1])

    @contextlib.contextmanager
    def beside(count: int):
        loops.append(count)
        yield

    monkeypatch.setattr(benchmark, "Worker", Stand)
    monkeypatch.setattr(benchmark, "busy_loops", beside)
    rows = list(benchmark.measured("frames", [0, 1], 3, lambda: None))
    assert loops == [0, 1] * 4
    assert [(row.beside, row.automatic, row.one, row.ratio) for row in rows] == [
        (0, 6.0, 8.0, 0.75),
        (1, 3.0, 4.0, 0.75),
    ]
