"""Skin that is seen hardly or not at all."""

import numpy as np
from drawn_film import plain_hand

from jghand_engine.own.skin_prior import believed, whole_skin


def test_what_few_of_many_pictures_show_is_not_believed_and_of_few_photographs_it_is():
    hand = plain_hand()
    palm = hand.position_m[:, 2] > np.median(hand.position_m[:, 2])
    # another finger's shadow, or the wall
    albedo = np.where(palm[:, None], hand.rgb, 0.01)
    of_many, of_few = (whole_skin(hand, albedo, np.where(palm, most, 0.5))[~palm] for most in (20.0, 2.0))
    assert np.median(of_many) > 0.5 * np.median(hand.rgb[~palm])
    assert np.median(of_few) < 0.1 * np.median(hand.rgb[~palm])


def test_belief_has_no_step_and_so_the_skin_no_edge():
    hand = plain_hand()
    strange, seen = np.full_like(hand.rgb, 0.01), np.linspace(0, 20, len(hand))
    steps = np.diff(believed(np.linspace(0, 20, 4001)))
    # observed 0.0028: 18 of the best tenth are whole from 3.6 on
    assert steps.max() < 0.004
    assert believed(seen)[[0, -1]].tolist() == [0, 1]
    palm = hand.position_m[:, 2] > np.median(hand.position_m[:, 2])
    alone = np.arange(len(hand)) == np.flatnonzero(~palm)[0]
    for some in (~palm, alone):
        # on both sides of where pictures begin to be believed, and elsewhere
        for middle in (1.8, 2.0, 3.0, 4.0):
            below, above = (
                whole_skin(hand, np.where(some[:, None], strange, hand.rgb), np.where(some, at, 20.0 * palm))
                for at in (middle - 1e-4, middle + 1e-4)
            )
            # observed 0.0006; 4.5 where skin counts as seen from a threshold on
            assert np.abs(np.log(above / below)).max() < 0.005
