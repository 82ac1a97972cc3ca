"""What is said of an avatar from a film, on a film that the engine drew."""

import json
from dataclasses import replace

import numpy as np
import pytest
from drawn_film import film_of, marked_hand, plain_hand, window_world

from jghand_engine.hand.joints import Handedness
from jghand_engine.own.gather import observe
from jghand_engine.own.light_and_skin import Origin, OwnHand, skin_from
from jghand_engine.own.report import held_out, scores, seen_map, write_report


@pytest.fixture(scope="module")
def made():
    """The avatar of a film without the pictures that were held out, the film, and which these are."""
    hand = plain_hand()
    film, held = film_of(marked_hand(hand), window_world(), count=12), held_out(12, is_film=True)
    known = film.part(~held)
    observed = observe(hand, known.joints_m, known.camera, known.pictures, known.masks)
    return skin_from(observed, hand, Origin("film.mp4", "ab", Handedness.RIGHT)), film, held


def test_every_eighth_picture_of_a_film_is_held_out_and_no_photograph():
    assert np.flatnonzero(held_out(20, is_film=True)).tolist() == [4, 12]
    assert not held_out(5, is_film=True).any()
    assert not held_out(10, is_film=False).any()


def test_pictures_that_were_held_out_look_like_the_film(made):
    own, film, held = made
    (found,) = scores(own, film.part(held))
    (other,) = scores(replace(own, avatar=replace(own.avatar, rgb=own.avatar.rgb[:, ::-1])), film.part(held))
    assert found["psnr_mask"] > 26
    assert found["iou"] > 0.95
    assert other["psnr_mask"] < found["psnr_mask"] - 5


def test_the_map_is_red_where_nothing_was_seen_and_green_elsewhere(made):
    own, *_ = made
    green = seen_map(own, 64)
    red = seen_map(OwnHand(own.avatar, np.zeros_like(own.seen), own.world), 64)
    for name in green:
        more_red = [(picture[..., 0] > picture[..., 1] + 40.0).mean() for picture in (green[name], red[name])]
        # seen: 0.47, as what is bent in half of the pictures counts less
        assert more_red[0] < 0.5 * more_red[1]


def test_the_report_is_a_sheet_and_figures(made, tmp_path):
    own, film, held = made
    report = write_report(tmp_path, own, film, held, np.arange(1, 13))
    assert json.loads((tmp_path / "report.json").read_text()) == report
    # the first of the pictures that were kept was left out
    assert report["held_out"] == [5]
    assert 0.5 < float(str(report["seen_part"])) < 1
    assert (tmp_path / "sheet.png").stat().st_size > 10_000


def test_skin_that_too_few_of_many_pictures_show_is_invented_and_not_counted_as_seen(made, tmp_path):
    own, film, held = made
    palm = own.avatar.position_m[:, 2] > np.median(own.avatar.position_m[:, 2])
    some = film.part(np.arange(len(held)) == np.flatnonzero(held)[0])
    few = replace(own, seen=np.where(palm, 20.0, 1.5))
    none = replace(own, seen=np.where(palm, 20.0, 0.0))
    told = [write_report(tmp_path, one, some, np.array([True]), np.zeros(1, int))["seen_part"] for one in (few, none)]
    assert told[0] == told[1]
    assert all((seen_map(few, 64)[name] == seen_map(none, 64)[name]).all() for name in seen_map(none, 64))


def test_new_poses_are_those_of_the_own_bones(made):
    own, *_ = made
    longer = own.avatar.canonical_joints_m * (1.0, 1.3, 1.0)
    shown = [seen_map(replace(own, avatar=replace(own.avatar, own_joints_m=bones)), 64) for bones in (None, longer)]
    assert all((shown[0][name] != shown[1][name]).any() for name in shown[0])
