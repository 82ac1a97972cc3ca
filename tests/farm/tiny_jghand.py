"""The command jghand with a model of 300 Gaussians, whose trainings take milliseconds a step.

The environment says what goes wrong: JGHAND_TINY_STEP_S, seconds that a step takes besides.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from small_hands import small_points
from small_trainings import SMALL

from jghand_engine.cli import main
from jghand_engine.farm import executors, job
from jghand_engine.training import options, step

_STEP = step.HandTraining.step


def _slow_step(self, number):
    time.sleep(float(os.environ.get("JGHAND_TINY_STEP_S", "0")))
    return _STEP(self, number)


if __name__ == "__main__":
    step.place_points = lambda template, count, **how: small_points(count)
    step.HandTraining.step = _slow_step
    options.PRESETS["default"] = SMALL
    job.PROGRAM = (sys.executable, __file__)
    executors.SLURM_POLL_S = 1.0
    sys.exit(main())
