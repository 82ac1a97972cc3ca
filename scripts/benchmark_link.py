# SPDX-License-Identifier: GPL-3.0-or-later
# This script imports blender_addon (GPL-3.0-or-later), so it is under the GPL too: blender_addon/LICENSE.
"""What the way between Blender and the engine costs, and what it does to Blender when the engine fails.

    python scripts/benchmark_link.py [--quick] [--only round-trip,blocks,memory] [--engine-python PATH]

    round-trip  a picture of 512 x 334 there and back, less what the engine itself took; wanted: <= 1 ms
    blocks      the longest time the main thread is kept while it plays, with engines that are late, that hang, that are
                frozen by the system and that are killed, 200 trials; wanted: none over 50 ms
    memory      10,000 pictures: growth of this process and of the engine; wanted: < 10 MB

Runs with any Python that has numpy. Without --engine-python the engine is the stand-in of the tests, which draws
nothing; with it, round-trip and memory use the real one. Figures of a busy machine mean nothing: the load is
printed too. Exit code 1 when a figure misses what is wanted.
"""

from __future__ import annotations

import argparse
import os
import platform
import random
import signal
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from blender_addon.core import pacing
from blender_addon.core.posing import rest_joints_m
from blender_addon.core.view import HandInSpace, Moment, Pinhole, SceneLight, picture_request
from blender_addon.errors import JGHandFailure
from blender_addon.renderer.link import EngineLink

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("round-trip", "blocks", "memory")
SIZE = (512, 334)
# the largest picture of a world that is sent
SKY = np.full((256, 512, 3), 0.5, np.float32)
FRAME_S = 1 / 24
PATIENCE_S = 120.0
ROUND_TRIP_MS, BLOCK_MS, GROWTH_MB = 1.0, 50.0, 10.0


@dataclass
class Figures:
    """What is printed, and whether all of it is as wanted."""

    missed: list[str] = field(default_factory=list)

    def say(self, name: str, text: str, good: bool | None = None) -> None:
        verdict = "" if good is None else "  ok" if good else "  MISSED"
        print(f"{name:44}{text}{verdict}", flush=True)
        if good is False:
            self.missed.append(name)


@dataclass(frozen=True)
class Plan:
    """How much of everything."""

    command: tuple[str, ...]
    pictures: int
    trials: int
    frames: int


def stand_in(*faults: str) -> tuple[str, ...]:
    return (sys.executable, "-I", str(ROOT / "tests/service/stand_in_engine.py"), *faults)


@contextmanager
def linked(command: tuple[str, ...]) -> Iterator[EngineLink]:
    link = EngineLink(lambda: command)
    try:
        yield link
    finally:
        link.close()


def picture(turn: int, outputs: tuple[str, ...] = ("rgba_u8",), light: SceneLight | None = None):
    """The rest hand, moved a little with every turn, as it fills the viewport."""
    width, height = SIZE
    joints = rest_joints_m("right") + np.array([1e-4 * (turn % 50), -0.09, 0.0])
    view = np.eye(4)
    view[2, 3] = 0.45
    hand = HandInSpace("right", joints, np.eye(4))
    pinhole = Pinhole(width, height, 900, 900, width / 2, height / 2, view)
    return picture_request([Moment(pinhole, [hand])], preset="viewport", outputs=outputs, light=light)


class Player:
    """A view that plays, by the rules of the viewport (core/pacing.py), without Blender around it."""

    def __init__(self, link: EngineLink) -> None:
        self._link, self._pace, self._taken = link, pacing.Pace(), None

    def show(self, frame: int) -> float:
        """One frame; returns how long it waited for its picture, seconds."""
        now_s, answering = time.monotonic(), self._link.status.state == "ready"
        moment = pacing.DrawMoment(now_s, pacing.Activity.PLAYING, FRAME_S, now_s, answering)
        self._take(moment)
        want = pacing.Want(f"frame {frame}", "camera", SIZE[0] * SIZE[1])
        self._pace, decision = pacing.step(self._pace, want, moment, pacing.ViewSettings())
        if decision.ask is not None:
            self._link.ask("viewport", *picture(frame), tag=decision.ask.tag)
        begun = time.perf_counter()
        if decision.wait_for is not None:
            self._link.wait("viewport", decision.wait_for, decision.wait_s)
        waited_s = time.perf_counter() - begun
        self._take(moment)
        if self._pace.shown is None or self._pace.shown.want != want:
            self._pace = pacing.missed(self._pace, moment)
        return waited_s

    def _take(self, moment: pacing.DrawMoment) -> None:
        answer = self._link.answer("viewport")
        if answer is not None and answer is not self._taken:
            self._taken = answer
            kind = answer.failure.kind if answer.failure is not None else None
            self._pace, _ = pacing.answered(self._pace, str(answer.tag), kind, answer.round_trip_ms / 1e3, moment)


# ---- the parts -------------------------------------------------------------------------------------------------------


def round_trip(plan: Plan, figures: Figures) -> None:
    with linked(plan.command) as link:
        asked: list[tuple[str, tuple[str, ...], SceneLight | None]] = [
            ("", ("rgba_u8",), None),
            ("", ("rgba_u8", "depth"), None),
            ("", ("rgba_f32", "depth"), None),
            (", in a sky", ("rgba_f32", "depth"), SceneLight((), {"key": "sky"}, SKY)),
        ]
        for lit, outputs, light in asked:
            there_and_back, whole = [], []
            for turn in range(plan.pictures + 10):
                link.ask("viewport", *picture(turn, outputs, light), tag=(outputs, lit, turn))
                answer = link.wait("viewport", (outputs, lit, turn), PATIENCE_S)
                if answer is None or answer.message is None:
                    raise SystemExit(f"no picture came: {answer and answer.failure}")
                if turn >= 10:
                    whole.append(answer.round_trip_ms)
                    there_and_back.append(answer.round_trip_ms - answer.message.header["took_ms"])
            median, p95 = statistics.median(there_and_back), np.percentile(there_and_back, 95)
            text = f"{median:6.2f} ms median, {p95:6.2f} p95; with the engine's own {statistics.median(whole):6.2f}"
            name = f"there and back, {SIZE[0]} x {SIZE[1]}, {' + '.join(outputs)}{lit}"
            figures.say(name, text, median <= ROUND_TRIP_MS if outputs == ("rgba_u8",) else None)


def blocks(plan: Plan, figures: Figures) -> None:
    """Plays as the viewport does: every frame asks, waits a little, shows what there is. The engine's trouble begins at
    a random moment."""
    troubles = {
        "late (200 ms a picture)": ("late", None),
        "hung in a picture": ("hang:5", None),
        "frozen by the system": ("blank", getattr(signal, "SIGSTOP", None)),
        "killed": ("blank", getattr(signal, "SIGKILL", None)),
    }
    dice = random.Random(0)
    longest: dict[str, list[float]] = {name: [] for name in troubles}
    others: list[float] = []
    for trial in range(plan.trials):
        name = list(troubles)[trial % len(troubles)]
        fault, sent = troubles[name]
        with linked(stand_in(fault)) as link:
            link.start()
            link.wait_until_ready()
            pid, at = link.status.handshake["pid"], time.monotonic() + dice.uniform(0.0, 0.5)
            worst_s, player = 0.0, Player(link)
            for frame in range(24):
                if sent is not None and time.monotonic() > at:
                    os.kill(pid, sent)
                    sent = None
                begun = time.perf_counter()
                waited_s = player.show(frame)
                took_s = time.perf_counter() - begun
                worst_s = max(worst_s, took_s)
                others.append(took_s - waited_s)
                time.sleep(max(0.0, FRAME_S - took_s))
            longest[name].append(1e3 * worst_s)
            if sent is None and troubles[name][1] == getattr(signal, "SIGSTOP", None):
                os.kill(pid, signal.SIGKILL)  # or closing would wait for it to listen
    slept = []
    for _ in range(10 * plan.trials):
        begun = time.perf_counter()
        time.sleep(pacing.PLAY_WAIT_S)
        slept.append(1e3 * (time.perf_counter() - begun))
    text = f"{max(slept):6.1f} ms longest, {np.percentile(slept, 99):6.1f} p99 of {len(slept)}"
    figures.say(f"control: a sleep of {1e3 * pacing.PLAY_WAIT_S:.0f} ms on this machine", text)
    over = sum(value > BLOCK_MS for values in longest.values() for value in values)
    for name, values in longest.items():
        text = f"{max(values):6.1f} ms longest, {statistics.median(values):6.1f} median of {len(values)} trials"
        figures.say(f"main thread kept, engine {name}", text)
    figures.say("the same without the wait for a picture", f"{1e3 * max(others):6.1f} ms longest")
    figures.say(f"trials with a block over {BLOCK_MS:.0f} ms", f"{over} of {plan.trials}", over == 0)


def memory(plan: Plan, figures: Figures) -> None:
    with linked(plan.command) as link:
        before: tuple[float, float] = (0.0, 0.0)
        warm_up = min(500, plan.frames // 4)
        for turn in range(plan.frames + warm_up):
            link.ask("viewport", *picture(turn, ("rgba_u8", "depth")), tag=turn)
            answer = link.wait("viewport", turn, PATIENCE_S)
            if answer is None or answer.message is None:
                raise SystemExit(f"no picture came: {answer and answer.failure}")
            if turn == warm_up:
                before = (resident_mb(os.getpid()), resident_mb(link.status.handshake["pid"]))
        after = (resident_mb(os.getpid()), resident_mb(link.status.handshake["pid"]))
    for name, one, other in zip(("this process", "the engine"), before, after, strict=True):
        growth = other - one
        text = f"{growth:6.1f} MB more after {plan.frames} pictures ({other:.0f} MB)"
        figures.say(f"memory of {name}", text, growth < GROWTH_MB)


# ---- what the system says ------------------------------------------------------------------------------------------


def resident_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status")
    if not status.exists():
        return 0.0
    return int(next(line for line in status.read_text().splitlines() if line.startswith("VmRSS")).split()[1]) / 1024


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a few of everything, to see that it runs")
    parser.add_argument("--only", default=",".join(PARTS), help=f"some of {','.join(PARTS)}")
    parser.add_argument("--engine-python", metavar="PATH", help="a Python that has jghand installed")
    options = parser.parse_args()
    parts = options.only.split(",")
    if unknown := [part for part in parts if part not in PARTS]:
        parser.error(f"--only: wanted some of {','.join(PARTS)}, got {','.join(unknown)}")
    command = stand_in("blank")
    if options.engine_python:
        command = (options.engine_python, "-I", "-m", "jghand_engine", "serve")
    plan = Plan(command, 20, 8, 200) if options.quick else Plan(command, 300, 200, 10_000)
    figures = Figures()
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores{load}, {platform.platform()}")
    print(f"the engine is {'the real one' if options.engine_python else 'a stand-in that draws nothing'}")
    todo: dict[str, Callable[[Plan, Figures], None]] = {
        **{"round-trip": round_trip, "blocks": blocks, "memory": memory}
    }
    try:
        for part in parts:
            todo[part](plan, figures)
    except JGHandFailure as failure:
        print(f"the engine failed: {failure}", file=sys.stderr)
        return 2
    if figures.missed:
        print("not as wanted: " + ", ".join(figures.missed))
    return 1 if figures.missed else 0


if __name__ == "__main__":
    sys.exit(main())
