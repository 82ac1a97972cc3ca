"""The benchmark of the link runs, and prints every figure that it promises. What they are is not looked at here."""

from __future__ import annotations

import sys

import benchmark_link


def test_every_part_runs_and_prints_its_figures(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["benchmark_link.py", "--quick"])
    few = benchmark_link.Plan(benchmark_link.stand_in("blank"), 2, 4, 1, 4)
    monkeypatch.setattr(benchmark_link, "Plan", lambda *_: few)
    assert benchmark_link.main() in (0, 1)
    said = capsys.readouterr().out
    for figure in ("there and back", "engine killed", "control", "trials with a block", "processes left"):
        assert figure in said
