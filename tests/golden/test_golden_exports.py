"""Stages and pages hold the numbers that they held: positions to a hundredth of a millimeter, colors to one step of 8
bits (golden_decode.TOLERANCES). Splat files have the engine's numbers by tests/export."""

from pathlib import Path

import numpy as np
import pytest
from cases import EXPORTS
from golden_decode import decoded, tolerance
from golden_store import of_case


@pytest.mark.parametrize(("group", "case"), [(group, case) for group, cases in EXPORTS.items() for case in cases])
def test_an_export_holds_the_numbers_that_it_held(group: str, case: str, tmp_path: Path):
    golden = of_case(group, case)
    EXPORTS[group][case](tmp_path)
    arrays = decoded(case, tmp_path)
    assert sorted(arrays) == sorted(golden)
    wrong = [line for name in golden if (line := difference(name, arrays[name], golden[name]))]
    assert not wrong, "\n" + "\n".join(wrong)


def difference(name: str, array: np.ndarray, golden: np.ndarray) -> str:
    """A sentence about an array that is not as it was; empty for the same."""
    if array.shape != golden.shape or array.dtype.kind != golden.dtype.kind:
        return f"{name}: {array.dtype} {array.shape} in place of {golden.dtype} {golden.shape}"
    if golden.dtype.kind != "f":
        return "" if np.array_equal(array, golden) else f"{name}: {array} in place of {golden}"
    away = np.abs(array.astype(float) - golden.astype(float))
    beyond = ~(away <= tolerance(name, golden))
    return f"{name}: {beyond.sum()} of {away.size} numbers off, by up to {away.max():.3g}" if beyond.any() else ""
