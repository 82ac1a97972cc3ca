"""Receipts: their lines, and those of many images summed up."""

from dataclasses import replace

import pytest

from jghand_engine.render.effect_plan import Decision, Effect, EffectPlan
from jghand_engine.render.image import Box
from jghand_engine.render.report import EffectSums, FrameReport, summed

SHADOW = Decision(Effect.SHADOW, True, "gate {0:.2f}", "darker", 1.0, 0.25, (0.7,))
CROP = Decision(Effect.WHOLE, False, "a small hand", "{0:.0f} step", 0.0, 0.5, (1.0,))
PLAN = EffectPlan((SHADOW, CROP), Box(0, 0, 4, 4), (True,))


def report(**changes) -> FrameReport:
    return replace(FrameReport(total_ms=1.5, visible_gaussians=3, gaussians=9, backend="v3", plan=PLAN), **changes)


def test_the_first_lines_say_the_time_and_what_was_drawn():
    assert FrameReport().lines()[1] == "0 of 0 Gaussians drawn, 0 invalid"
    lines = report(notes=["flat"], tier="exact network", stages={"raster": 0.4}).lines()
    assert lines[:3] == ["frame 1.50 ms, v3, 1 thread", "3 of 9 Gaussians drawn, 0 invalid", "exact network"]
    assert lines[-2:] == ["raster ran, 0.40 ms", "flat"]
    assert report(threads=2).lines()[0] == "frame 1.50 ms, v3, 2 threads"


def test_the_line_of_an_effect_says_why_what_it_is_worth_and_what_it_took_or_saved():
    assert report(stages={"shadow + compose": 2.0}).lines()[2:4] == [
        "self-shadow    ran      gate 0.70; without: darker; 2.00 ms",
        "whole-picture  skipped  a small hand; off by: 1 step; saved about 0.5 ms",
    ]
    assert report().lines()[2].endswith("; about 0.25 ms")
    assert CROP._replace(estimated_ms=0.0).line().endswith("; off by: 1 step")


def test_of_a_mean_times_are_added_and_notes_said_once():
    whole = summed([report(notes=["a"], stages={"skin": 1.0}), report(notes=["b", "a"], stages={"skin": 2.0})], None)
    assert (whole.stages, whole.notes, whole.plan) == ({"skin": 3.0}, ["a", "b"], None)


def test_effects_of_many_frames_are_counted_with_what_they_took_and_saved():
    sums = EffectSums()
    sums.add(FrameReport())  # without a plan
    sums.add(report())
    sums.add(report(stages={"shadow + compose": 2.0}))
    shadow, crop = (sums.figures()[str(one.effect)] for one in (SHADOW, CROP))
    assert (shadow["ran"], shadow["skipped"]) == (2, 0)
    assert shadow["ms"] == pytest.approx(2.25)  # once estimated, once measured
    assert (crop["ran"], crop["skipped"], crop["saved_ms"], crop["reason"]) == (0, 2, 1.0, "a small hand")
