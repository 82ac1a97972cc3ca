"""The frame benchmark: every kind of case runs and fits the table."""

from dataclasses import replace

import benchmark_frame as benchmark
import numpy as np
from small_avatars import trained_avatar

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.tiers import Distilled, Price, Tier
from jghand_engine.native.library import load
from jghand_engine.render.timing import COLUMNS, measure, table_rows


def priced_avatar() -> HandAvatar:
    avatar = trained_avatar(300)
    prices = tuple(Price(tier, 0, 1.0, 0.0, 33.0, 0.0) for tier in (Tier.EXACT, Tier.LINEAR))
    return replace(avatar, learned=replace(avatar.learned, distilled=Distilled(None, prices, "nothing")))


def test_every_kind_of_case_runs_and_fits_the_table(monkeypatch):
    painted = benchmark.painted_subject(64, 42)
    small = replace(painted, avatar=painted.avatar.prefix(500))
    monkeypatch.setattr(benchmark, "SIZES", ((64, 42),))
    monkeypatch.setattr(benchmark, "painted_subject", lambda width, height: small)
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
