"""Reports of many frames as one table."""

from jghand_engine.cli.timings import TOTAL, Timings
from jghand_engine.render.report import FrameReport


def report(blend_ms, shadow):
    frame = FrameReport(total_ms=blend_ms + 1)
    frame.ran("blend", blend_ms)
    if shadow:
        frame.ran("shadow", 1.0)
    return frame.as_dict()


def test_medians_leave_the_warm_up_out():
    timings = Timings()
    for index in range(12):
        timings.add(report(100.0 if index < Timings.WARM_UP else 4.0, shadow=index >= 10))
        timings.add_ms("writing", 2.0)
    figures = timings.figures()
    assert timings.frames == 12
    assert figures["blend"] == {"ran": 12, "median_ms": 4.0, "p95_ms": 4.0}
    assert figures["shadow"]["ran"] == 2
    assert figures[TOTAL]["median_ms"] == 5.0
    assert figures["writing"]["median_ms"] == 2.0
