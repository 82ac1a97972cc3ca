"""How times are taken: in turns, after a warm-up, with disturbed samples told apart. Never how long anything takes."""

import pytest

from jghand_engine.render.report import FrameReport
from jghand_engine.render.timing import Case, FreeCores, measure


def test_cases_take_turns_after_the_warm_up():
    calls: list[str] = []
    cases = [Case("s", name, lambda name=name: calls.append(name), threads=1) for name in ("a", "b")]
    measured = measure(cases, rounds=3, warm_up=2)
    assert calls == ["a", "b"] * 5
    assert [one.samples + one.dropped for one in measured] == [3, 3]


def test_slow_cases_run_few_times():
    calls: list[str] = []
    cases = [
        Case("s", name, lambda name=name: calls.append(name), rounds=n, threads=1) for name, n in (("a", 0), ("b", 2))
    ]
    measure(cases, rounds=5, warm_up=3)
    assert calls.count("a") == 8
    assert calls.count("b") == 3  # one to warm up


def test_stages_of_a_frame_follow_it():
    def frame() -> FrameReport:
        report = FrameReport()
        report.ran("raster", 2.0)
        report.ran("shadow", 0.0)
        return report

    names = [(one.name, one.median_ms) for one in measure([Case("s", "frame", frame, threads=1)], rounds=4, warm_up=1)]
    assert names[0][0] == "frame"
    assert names[1:] == [("  raster", 2.0), ("  shadow", 0.0)]


def test_a_stage_of_some_frames_only_took_nothing_in_the_others(monkeypatch):
    frames = iter(range(9))

    def frame() -> FrameReport:
        report = FrameReport()
        report.ran("raster", 2.0)
        if next(frames) % 4 == 3:
            report.ran("shadow gate", 1.0)
        return report

    # the control before and the one after each of 1 + 8 samples; the last sample is disturbed
    seen = iter([1.0] * 16 + [0.4, 1.0])
    monkeypatch.setattr(FreeCores, "__call__", lambda self: next(seen))
    measured = measure([Case("s", "frame", frame, threads=1)], rounds=8, warm_up=1, enough=5)
    gate = next(one for one in measured if one.name == "  shadow gate")
    assert (gate.samples, gate.dropped) == (7, 1)
    assert gate.median_ms == 0.0
    assert gate.p95_ms > 0.0


@pytest.mark.parametrize(("cores", "dropped", "disturbed"), [((1.0,) * 40, 0, False), ((0.5,) * 40, 0, True)])
def test_samples_of_a_busy_machine_are_dropped_or_marked(monkeypatch, cores, dropped, disturbed):
    seen = iter(cores)
    monkeypatch.setattr(FreeCores, "__call__", lambda self: next(seen))
    (one,) = measure([Case("s", "a", lambda: None, threads=1)], rounds=12, warm_up=1)
    assert (one.dropped, one.disturbed) == (dropped, disturbed)


def test_single_disturbed_samples_are_dropped(monkeypatch):
    # one control before and one after each of 1 + 12 samples; the one before the last sample is bad
    seen = iter([1.0] * 24 + [0.4, 1.0])
    monkeypatch.setattr(FreeCores, "__call__", lambda self: next(seen))
    (one,) = measure([Case("s", "a", lambda: None, threads=1)], rounds=12, warm_up=1)
    assert (one.samples, one.dropped, one.disturbed) == (11, 1, False)
