# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs a story inside Blender: `blender --python driver.py -- ZIP OUT STORY.py [STEP ...]`.

Installs the zip into the (empty) profile, unless the story says INSTALLS and does so itself, then walks through the
steps from a timer, so that Blender draws and reacts as it does for an artist. OUT/results.json says how every step
went; Blender ends afterwards the ordinary way.
"""

import importlib.util
import json
import sys
import time
import traceback
from collections.abc import Callable, Generator
from pathlib import Path
from types import ModuleType
from unittest import SkipTest

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from in_blender.window import Window

# seconds a step may wait for a condition: a cold engine imports torch within it, with other work on the machine
PATIENCE_S = 90.0
POLL_S = 0.05
Steps = Generator[float | Callable[[], object] | None, None, None]


class Walk:
    """Goes through steps, a piece at every call of `tick`; one that raises SkipTest is not tried, and does not fail.
    results: one entry per step, in OUT/results.json too."""

    def __init__(self, steps: list[Callable], window: Window) -> None:
        self._left, self._window = list(steps), window
        self._step: Steps | None = None
        self._condition: Callable[[], object] | None = None
        self._since = 0.0
        self.results: list[dict] = []

    def tick(self) -> float | None:
        """For Blender's timer: seconds until the next call, None when everything is done."""
        try:
            return self._go_on()
        except SkipTest as reason:
            self.results[-1]["skipped"] = str(reason)
            self._end()
            return POLL_S
        except BaseException as error:
            self._end(f"{type(error).__name__}: {error}", traceback.format_exc())
            self._left.clear()  # a story goes no further than it holds
            return self._quit()

    def _go_on(self) -> float | None:
        if self._step is None:
            if not self._left:
                return self._quit()
            self._begin(self._left.pop(0))
            return POLL_S
        if self._condition is not None:
            if not self._condition():
                if time.monotonic() - self._since > PATIENCE_S:
                    condition, self._condition = self._condition, None
                    self._step.throw(TimeoutError(f"not within {PATIENCE_S:g} s: {_name(condition)}"))
                return POLL_S
            self._condition = None
        try:
            wish = next(self._step)
        except StopIteration:
            self._end()
            return POLL_S
        if callable(wish):
            self._condition, self._since = wish, time.monotonic()
            return POLL_S
        return max(POLL_S, wish or 0.0)

    def _begin(self, step: Callable) -> None:
        print(f"JGHAND step {step.__name__}", flush=True)
        self.results.append({"name": step.__name__, "ok": False, "started": time.monotonic()})
        outcome = step(self._window)
        self._step = outcome if isinstance(outcome, Generator) else _nothing()

    def _end(self, problem: str = "", trace: str = "") -> None:
        if self.results:
            last = self.results[-1]
            last["seconds"] = round(time.monotonic() - last.pop("started"), 2)
            last.update({"ok": not problem, "problem": problem, "trace": trace})
        if problem:
            print(f"JGHAND FAILED {problem}\n{trace}", flush=True)
            self._window.picture("failed")
        self._step = None
        self.write()

    def write(self) -> None:
        """The results so far: also what a Blender leaves that dies."""
        (self._window.out / "results.json").write_text(json.dumps(self.results, indent=1), encoding="utf-8")

    def _quit(self) -> None:
        if self._window.addon is not None:
            engine = self._window.runtime().link().status.handshake.get("pid", "")
            (self._window.out / "engine.pid").write_text(str(engine))  # it must end with this Blender
        bpy.ops.wm.quit_blender()


def _nothing() -> Steps:
    yield from ()


def _name(condition: Callable) -> str:
    code = getattr(condition, "__code__", None)
    return f"{condition.__qualname__} (line {code.co_firstlineno})" if code else repr(condition)


def install(archive: str) -> ModuleType:
    """Installs and enables the zip as a drop into the window does; returns the extension's package."""
    bpy.ops.extensions.package_install_files(
        filepath=archive, repo="user_default", enable_on_install=True, overwrite=True
    )
    return sys.modules["bl_ext.user_default.jghand"]


def load(story: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location("story", story)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main(archive: str, out: str, story: str, *names: str) -> None:
    bpy.context.preferences.view.show_splash = False
    module = load(story)
    steps = [thing for name, thing in vars(module).items() if name.startswith("step_")]  # in their order
    if names:
        named = {step.__name__.removeprefix("step_"): step for step in steps}
        steps = [named[name] for name in names]
    window = Window(Path(out), Path(archive))
    walk = Walk(steps, window)

    def start() -> None:
        try:
            if not getattr(module, "INSTALLS", False):
                window.addon = install(archive)
        except Exception as error:
            walk.results.append({"name": "install", "ok": False, "problem": f"{type(error).__name__}: {error}"})
            walk.write()
            print(traceback.format_exc(), flush=True)
            bpy.ops.wm.quit_blender()
            return
        bpy.app.timers.register(walk.tick, first_interval=0.5, persistent=True)

    bpy.app.timers.register(start, first_interval=1.0, persistent=True)


main(*sys.argv[sys.argv.index("--") + 1 :])
