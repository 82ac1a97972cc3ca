"""What the Blender extension repeats, because it may not import the engine, is the same here and there."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from blender_addon.core import joints as extension
from blender_addon.core import posing
from blender_addon.core.messages import ADVICE
from jghand_engine.errors import InputError, MemoryLimitError, RetryError
from jghand_engine.hand.joints import LEVEL_NAMES, PARENTS, STANDARD_NAMES, Handedness
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.service.commands import error_header
from jghand_engine.splat.settings import PRESETS
from jghand_engine.template.builtin import load_template


def test_joints_have_the_same_names_in_the_same_order():
    assert extension.NAMES == STANDARD_NAMES
    assert set(extension.HANDEDNESSES) == set(Handedness)


def test_joints_have_the_same_parents():
    for place, name in enumerate(extension.NAMES):
        parent = PARENTS[LEVEL_NAMES.index(name)]
        assert extension.PARENTS[place] == (-1 if parent < 0 else STANDARD_NAMES.index(LEVEL_NAMES[parent]))


def test_the_rest_hand_is_the_built_in_hand():
    # the extension's numbers are rounded to a micrometre
    wanted = from_level(np.asarray(load_template().joints_m), JointOrder.STANDARD)
    np.testing.assert_allclose(posing.rest_joints_m("right"), wanted, atol=6e-7)


def test_every_kind_of_error_of_the_engine_has_a_sentence_and_the_engines_own_exit_code():
    for error in (InputError("x"), RetryError("x"), MemoryLimitError("x")):
        assert ADVICE[error_header(error)["kind"]].exit_code == error.exit_code
    assert error_header(ZeroDivisionError())["kind"] in ADVICE


def test_the_preset_of_a_batch_run_exists():
    assert "final" in PRESETS
