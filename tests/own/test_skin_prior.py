"""Skin that is seen hardly or not at all."""

from __future__ import annotations

import numpy as np
from drawn_film import plain_hand

from jghand_engine.own.skin_prior import whole_skin


def test_what_few_of_many_pictures_show_is_not_believed_and_of_few_photographs_it_is():
    hand = plain_hand()
    palm = hand.position_m[:, 2] > np.median(hand.position_m[:, 2])
    # another finger's shadow, or the wall
    albedo = np.where(palm[:, None], hand.rgb, 0.01)
    of_many, of_few = (whole_skin(hand, albedo, np.where(palm, most, 0.5))[~palm] for most in (20.0, 2.0))
    assert np.median(of_many) > 0.5 * np.median(hand.rgb[~palm])
    assert np.median(of_few) < 0.1 * np.median(hand.rgb[~palm])
