"""Links to the stand-in engine, for tests. It runs in any Python that has numpy."""

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from blender_addon.core.view import HandInSpace, Moment, Pinhole, SceneLight, picture_request
from blender_addon.renderer.link import EngineLink

ROOT = Path(__file__).resolve().parents[2]
STAND_IN = ROOT / "tests" / "service" / "stand_in_engine.py"
# the machine may be busy with other tests
PATIENCE_S = 30.0


def picture(x_m: float = 0.0, light: SceneLight | None = None):
    joints = np.zeros((21, 3))
    joints[:, 0], joints[:, 2] = x_m, 0.3
    hand = HandInSpace("right", joints, np.eye(4))
    view = Pinhole(64, 48, 80, 80, 32, 24, np.eye(4))
    return picture_request([Moment(view, [hand])], preset="draft", outputs=["rgba_u8"], light=light)


def command(*faults: str) -> list[str]:
    return [sys.executable, "-I", str(STAND_IN), *faults]


@contextlib.contextmanager
def linked(*faults: str, **options) -> Iterator[EngineLink]:
    link = EngineLink(lambda: command(*faults), **options)
    try:
        yield link
    finally:
        link.close()
        assert link._engine is None
        assert link._thread is None
