"""When a training ends, and when something is due that happens now and then."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from jghand_engine.learn.checkpoint import LoopState

# steps that a training with a time budget is taken to have until its speed is known
PLANNED_STEPS_AT_FIRST = 10_000


@dataclass(frozen=True)
class Budget:
    """How long to train: so many steps, so many seconds over all sessions, or whichever is reached first.

    until: step at which to stop before that, for others to go on from; plans are those of all the steps
    """

    steps: int | None = None
    seconds: float | None = None
    until: int | None = None

    def is_spent(self, state: LoopState) -> bool:
        last = self.steps if self.until is None else self.until
        return (last is not None and state.step >= last) or (self.seconds is not None and state.seconds >= self.seconds)

    def planned_steps(self, state: LoopState) -> int:
        """How many steps the whole training will have, if they stay as fast as they were on average.

        Then step / planned steps is the part of the time that is spent: schedules end when the time does.
        """
        by_time = PLANNED_STEPS_AT_FIRST
        if self.seconds is None:
            return self.steps or by_time
        if state.step and state.seconds > 0:
            by_time = max(state.step, round(state.step * self.seconds / state.seconds))
        return by_time if self.steps is None else min(by_time, self.steps)

    def seconds_left(self, state: LoopState, steps_per_s: float | None) -> float | None:
        by_steps = (self.steps - state.step) / steps_per_s if self.steps is not None and steps_per_s else None
        by_time = self.seconds - state.seconds if self.seconds is not None else None
        known = [max(left, 0.0) for left in (by_steps, by_time) if left is not None]
        return min(known, default=None)


@dataclass(frozen=True)
class Every:
    """Something that is due after so many steps or seconds, whichever comes first. first_s: seconds to the first
    time, where it differs."""

    steps: int | None = None
    seconds: float | None = None
    first_s: float | None = None


class Timer:
    """Tells when an `Every` is due; counts from its making and then from the last time it was due."""

    def __init__(self, every: Every, step: int, now_s: float) -> None:
        self._every, self._step, self._since_s = every, step, now_s
        self._wait_s = every.seconds if every.first_s is None else every.first_s

    def is_due(self, step: int, now_s: float) -> bool:
        """Whether it is due; if so, counting begins anew."""
        by_steps = self._every.steps is not None and step - self._step >= self._every.steps
        by_time = self._wait_s is not None and now_s - self._since_s >= self._wait_s
        if by_steps or by_time:
            self._step, self._since_s, self._wait_s = step, now_s, self._every.seconds
        return by_steps or by_time


@contextmanager
def stop_requests() -> Iterator[threading.Event]:
    """Ctrl-C and a polite kill set the event, which the loop answers between two steps, where the state is whole.

    A second one ends the process at once, as if nobody had listened. Outside the main thread nothing is caught, nor is
    a polite kill that whoever started the process has told it to ignore: it is meant for them.
    """
    request = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    if before[signal.SIGTERM] is signal.SIG_IGN:
        del before[signal.SIGTERM]

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def ask(*_: object) -> None:
        request.set()
        restore()

    for number in before:
        signal.signal(number, ask)
    try:
        yield request
    finally:
        restore()
