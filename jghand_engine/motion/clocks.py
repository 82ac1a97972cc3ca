"""When the frames of a motion are: rates, and clocks whose unit nobody says."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jghand_engine.hand.sequence import MOTION_FRAMES_MAX

# frames per second of a motion that does not say them
DEFAULT_FPS = 30.0
# those of video that are not whole
NTSC_RATES = (24000 / 1001, 30000 / 1001, 48000 / 1001, 60000 / 1001, 120000 / 1001)
# rates that a few frames of a clock in whole milliseconds may mean
USUAL_FPS = (30.0, 24.0, 25.0, 60.0, 50.0, 48.0, 90.0, 72.0, 120.0, 100.0, 144.0, 240.0)
# frames per second of a clock whose unit is not said; they tell seconds from milliseconds and microseconds
CLOCK_FPS_MIN, CLOCK_FPS_MAX = 1.5, 1000.0
# part of a step by which frames may miss even times, either way, and still come evenly
STEP_JITTER_MAX = 0.1
# ... or this, where it is more: clocks in whole milliseconds round. And the part of it by which a time may miss a whole
# one: round-off of seconds since 1970 in double precision
CLOCK_TICK_S, CLOCK_TICK_EPS = 1e-3, 1e-3
# steps of a clock that differ from their median by less than this part of it count for the rate: not one of two frames
STEP_USUAL = 1 / 3
# steps of an uneven clock up to so many medians make its rate: pages show a camera's frames after two or three of their
# pictures, which is 1.5; a frame that was dropped makes it 2
STEP_UNEVEN_MAX = 1.75
# part of the frames that must have a time that rises for a clock to be used
CLOCK_KNOWN_MIN = 0.5
# part by which a measured rate may miss a whole one: half of what 30000 / 1001 is from 30
WHOLE_RATE_EPS = 5e-4
# frames of a motion for each time of a clock, and seconds beyond that: two an hour apart are a mistake
FRAMES_PER_TIME_MAX, PAUSE_MAX_S = 64, 600.0

UNITS = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}

# names of a frame's time among those of its members, or of a column's, as `plain` has them: time_s, timestamp_ms, …
TIME_NAMES = ("timestamp", "timestampms", "time", "times", "timems")


def plain(name: str) -> str:
    """A key without case and separators: `multiHandWorldLandmarks` and `multi_hand_world_landmarks` are the same."""
    return "".join(letter for letter in name.casefold() if letter.isalnum())


def whole_rate(fps: float) -> float:
    """The whole rate, or the one of video (30000 / 1001), that a measured one is but for round-off; else itself."""
    best = min((float(round(fps)), *NTSC_RATES), key=lambda rate: abs(rate - fps))
    return best if abs(best - fps) < WHOLE_RATE_EPS * best else fps


def clock_s(times: Sequence[float | None]) -> tuple[np.ndarray | None, str]:
    """Times of frames, whose step tells their unit -> seconds from the first, and a sentence.

    A frame without a time, or with one that does not rise, lies evenly between its neighbors. None where no frame has
    a time, or where they are not used, which the sentence says.
    """
    values = np.array([math.nan if time is None else time for time in times], dtype=np.float64)
    values[~np.isfinite(values)] = np.nan
    if np.isfinite(values).sum() < 2:
        return None, ""
    highest = np.fmax.accumulate(values)
    known = np.isfinite(values) & (values > np.concatenate([[-np.inf], np.nan_to_num(highest[:-1], nan=-np.inf)]))
    steps = np.diff(values[known]) / np.diff(np.flatnonzero(known))
    if known.sum() < max(2, CLOCK_KNOWN_MIN * len(values)):
        return None, "Too many of its frames have no time, or one that does not rise: the times are not used."
    step = float(np.median(steps))
    for unit, seconds in UNITS.items():
        if 1 / CLOCK_FPS_MAX <= step * seconds <= 1 / CLOCK_FPS_MIN:
            seen = _between(np.flatnonzero(known), values[known], len(values), step)
            return (seen - seen[0]) * seconds, f"Its clock counts {unit}, by the step between its frames."
    return None, "The times of its frames are no clock that JGHand knows, so they are not used."


def _between(places: np.ndarray, values: np.ndarray, count: int, step: float) -> np.ndarray:
    """(count,) values by places, evenly between the known ones and by `step` beyond both ends."""
    every = np.arange(count)
    result = np.interp(every, places, values)
    outside = np.minimum(every - places[0], 0) + np.maximum(every - places[-1], 0)
    return result + step * outside


def even_frames(times_s: np.ndarray) -> tuple[float, np.ndarray | None]:
    """Frames per second of rising times (F,), F > 1, and the number of the frame that each is; None where they come
    unevenly. Frames that are left out leave their numbers out.

    The rate is that of the steps near the median, so that neither a hole nor a clock in whole milliseconds bends it.
    """
    steps = np.diff(times_s)
    # one of the steps: between two kinds of them the mean of both is near none
    median = float(np.quantile(steps, 0.5, method="lower"))
    step = float(steps[np.abs(steps - median) <= STEP_USUAL * median].mean())
    numbers = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps / step), 1.0))])
    centered = numbers - numbers.mean()
    line = 1 / float((centered * times_s).sum() / (centered * centered).sum())
    # steps of two and three pictures of a page lie near a grid too, but near one of other steps
    is_step = abs(1 / line - step) <= STEP_JITTER_MAX * step
    if is_step and numbers[-1] < MOTION_FRAMES_MAX:
        room_s = max(STEP_JITTER_MAX * step, min(CLOCK_TICK_S, 0.5 * step))
        for fps, range_s in (*_rounded_rates(times_s, line), (whole_rate(line), 2 * room_s), (line, 2 * room_s)):
            if np.ptp(times_s - numbers / fps) <= range_s:
                return fps, numbers.astype(np.int64)
    return whole_rate(1 / float(steps[steps <= STEP_UNEVEN_MAX * median].mean())), None


def _rounded_rates(times_s: np.ndarray, line: float) -> list[tuple[float, float]]:
    """Rates that a clock in whole milliseconds may have meant by the measured one, each with the range in seconds over
    which rounding spreads its frames; none for a clock that does not round."""
    ticks = times_s / CLOCK_TICK_S
    if (np.abs(ticks - np.rint(ticks)) > CLOCK_TICK_EPS).any():
        return []
    range_s = (1 + CLOCK_TICK_EPS) * CLOCK_TICK_S
    usual = min(USUAL_FPS, key=lambda fps: abs(fps - line))
    return [(usual, range_s), (max(round(line), 1), range_s)]


def is_one_motion(count: int, seconds: float, fps: float) -> bool:
    """Whether `count` times over so long can be those of one motion: a few hours apart would make a long one."""
    most = min(MOTION_FRAMES_MAX, FRAMES_PER_TIME_MAX * count + PAUSE_MAX_S * fps)
    return 0 <= seconds * fps <= most
