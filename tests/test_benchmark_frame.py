"""The frame benchmark: hands of the stated size, and every kind of case runs and fits the table."""

from __future__ import annotations

from dataclasses import replace

import benchmark_frame as benchmark
import numpy as np
import pytest
from small_avatars import trained_avatar
from synthetic_hands import synthetic_hand

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.tiers import Distilled, Price, Tier
from jghand_engine.native.library import load
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.timing import COLUMNS, measure, table_rows


@pytest.mark.parametrize("name", ["A", "B"])
def test_volumes_cover_as_much_of_the_picture_as_stated(name: str):
    hand = synthetic_hand(name)
    frame = HandRenderer(hand.avatar).render(hand.avatar.canonical_joints_m, hand.camera())
    covered = float((frame.rgba[..., 3] > 0.5).mean())
    assert 0.40 <= covered <= 0.445  # RENDERING: 40 to 44 % (observed 0.41 and 0.44)


@pytest.mark.parametrize("subject", benchmark.subjects(64, 42), ids=lambda subject: subject.name)
def test_poses_move_in_every_frame(subject):
    step = np.abs(np.diff(subject.poses, axis=0)).max(axis=(1, 2))
    assert len(subject.poses) >= 100
    assert float(step.min()) > 5e-5  # else the frame would be reused


def priced_avatar() -> HandAvatar:
    avatar = trained_avatar(300)
    prices = tuple(Price(tier, 0, 1.0, 0.0, 33.0, 0.0) for tier in (Tier.EXACT, Tier.LINEAR))
    return replace(avatar, learned=replace(avatar.learned, distilled=Distilled(None, prices, "nothing")))


def test_every_kind_of_case_runs_and_fits_the_table(monkeypatch):
    painted = benchmark.painted_subject(64, 42)
    small = replace(painted, avatar=painted.avatar.prefix(500))
    monkeypatch.setattr(benchmark, "SIZES", ((64, 42),))
    monkeypatch.setattr(benchmark, "subjects", lambda width, height: [small])
    settings = benchmark.every_frame_shadowed(1)
    cases = [
        *benchmark.whole_frame_cases(settings),
        *benchmark.raster_and_shadow_cases(load("auto"), 1),
        *benchmark.part_cases(load("auto"), 1),
        *benchmark.reference_cases(1),
        *benchmark.trained_cases(settings, priced_avatar()),
    ]
    measured = measure(cases, rounds=2, warm_up=1)
    table = table_rows(measured)
    assert all(len(row) == len(COLUMNS) for row in table)
    sections = [row[0] for row in table if not row[1]]
    assert len(sections) == len(set(sections)) >= 7
    assert all(np.isfinite(one.median_ms) and one.median_ms <= one.p95_ms for one in measured)
