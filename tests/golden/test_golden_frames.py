"""Pictures stay what they were, to one step of 8 bits in color and coverage and a hundredth of a millimeter in depth.

A depth is a mean of what covers a pixel, 0 where too little does. Compared are pixels that rounding cannot change much:
those on a threshold were left out when the golden pictures were made (make_golden.py).
"""

import numpy as np
import pytest
from cases import PICTURES, Picture, drawn
from golden_store import of_case, to_bytes, unpacked

STEPS, DEPTH_M = 1, 1e-5
# part of a hand's pixels that is not compared
LEFT_OUT = 0.05


@pytest.mark.parametrize(
    ("group", "picture"),
    [pytest.param(group, one, id=f"{group}: {one.name}") for group, pictures in PICTURES.items() for one in pictures],
)
def test_a_picture_is_as_it_was(group: str, picture: Picture):
    rgba, depth_m, compared = unpacked(of_case(group, picture.name))
    frame = drawn(picture)
    assert frame.rgba.shape == rgba.shape
    steps = np.abs(to_bytes(frame.rgba).astype(int) - rgba)[compared]
    assert steps.max() <= STEPS, f"{steps.max()} steps off, {(steps > STEPS).any(-1).sum()} pixels by more than {STEPS}"
    away_m = np.abs(frame.depth_m - depth_m)[compared]
    assert away_m.max() <= DEPTH_M, f"{away_m.max():.2g} m off, {(away_m > DEPTH_M).sum()} pixels by too much"


@pytest.mark.parametrize("group", PICTURES)
def test_nearly_every_pixel_of_a_hand_is_compared(group: str):
    for picture in PICTURES[group]:
        _, depth_m, compared = unpacked(of_case(group, picture.name))
        assert (~compared).sum() <= LEFT_OUT * (compared & (depth_m > 0)).sum()
