"""Where a hand ends: faded at the wrist or along the forearm, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.detail import Detail
from jghand_engine.avatar.forearm import FOREARM_FADE_M, FOREARM_WAY, WRIST_CUT_M, WRIST_WAY, ended, has_forearm
from jghand_engine.hand.joints import Handedness
from jghand_engine.template.builtin import WITH_FOREARM, load_template, load_template_with_forearm
from jghand_engine.template.surface import boundary_loop


def on_template(forearm: bool) -> HandAvatar:
    """The painted hand's arrays, its first Gaussians at the vertices of a template."""
    template = load_template_with_forearm() if forearm else load_template()
    painted = load_painted(handedness=Handedness.RIGHT).prefix(len(template.vertices_m))
    info = replace(painted.info, template=template.identifier)
    whole = np.ones(len(painted), np.float32)
    return replace(painted, info=info, position_m=template.vertices_m.astype(np.float32), opacity=whole)


def test_the_fade_lies_where_the_template_ends():
    hand, arm = load_template(), load_template_with_forearm()
    loop = hand.vertices_m[boundary_loop(hand.faces[: hand.skin_face_count])]
    assert np.linalg.norm([WRIST_WAY, FOREARM_WAY], axis=1) == pytest.approx([1, 1], abs=1e-3)
    # observed 0.8 mm: the cut is nearly flat
    np.testing.assert_allclose(loop @ WRIST_WAY, WRIST_CUT_M, atol=1e-3)
    # before the last ring, where the skin of a smooth mesh rounds off
    assert FOREARM_FADE_M[0] < (arm.vertices_m[-21:-1] @ FOREARM_WAY).min()


@pytest.mark.parametrize("load", [load_builtin, load_painted])
def test_a_hand_without_a_forearm_fades_over_the_last_15_mm_and_nowhere_else(load):
    hand = load(handedness=Handedness.LEFT)
    shown = ended(hand)
    from_cut_m = hand.position_m @ WRIST_WAY - WRIST_CUT_M
    assert not has_forearm(hand)
    assert (shown.opacity[from_cut_m < 0.003] == 0).all()
    assert np.array_equal(shown.opacity[from_cut_m > 0.015], hand.opacity[from_cut_m > 0.015])
    within = (from_cut_m > 0.004) & (from_cut_m < 0.014)
    assert (shown.opacity[within] < hand.opacity[within]).all()
    assert (shown.opacity[within] > 0).all()
    # only that
    assert shown.info == hand.info
    assert shown.position_m is hand.position_m
    assert np.array_equal(ended(hand, forearm=False).opacity, shown.opacity)


def test_a_forearm_is_shown_up_to_its_last_centimeters_or_hidden():
    arm = on_template(forearm=True)
    along_m = arm.position_m @ FOREARM_WAY
    assert has_forearm(arm)
    assert arm.info.template == WITH_FOREARM
    shown, hidden = ended(arm), ended(arm, forearm=False)
    assert (shown.opacity[along_m < 0.105] == 1).all()
    assert (shown.opacity[along_m > 0.125] == 0).all()
    # hidden it is the hand that ends at the wrist, whose mesh goes with it
    assert (hidden.opacity[along_m > 0.02] == 0).all()
    assert hidden.info.template == load_template().identifier
    alone = ended(on_template(forearm=False))
    assert np.array_equal(hidden.opacity[:1609], alone.opacity[:1609])


def test_a_hidden_forearm_has_no_detail_that_would_hide_what_is_behind_it():
    arm, template = on_template(forearm=True), load_template_with_forearm()
    skin = template.faces[: template.skin_face_count].astype(np.int32)
    uv = template.face_uv[: template.skin_face_count].astype(np.float32)
    weights = template.bone_weights.astype(np.float32)
    detail = Detail(template.vertices_m.astype(np.float32), weights, skin, uv, np.zeros((4, 4, 3), np.uint8), 0.001)
    shown, hidden = (ended(replace(arm, detail=detail), forearm=forearm).detail for forearm in (True, False))
    assert shown is not None
    assert hidden is not None
    assert len(hidden.face_uv) == len(hidden.faces) < len(shown.faces) <= len(skin)
    for ends_m, left in ((0.125, shown), (0.02, hidden)):
        assert ((detail.position_m @ FOREARM_WAY)[left.faces].min(1) < ends_m).all()


def test_manos_hands_fade_where_theirs_end_and_unknown_ones_stay():
    hand = on_template(forearm=False)
    mano = replace(hand, info=replace(hand.info, template="mano-right-mean-manopth-projected"))
    behind_m = mano.position_m[:, 1] - mano.position_m[:, 1].min()
    opacity = ended(mano).opacity
    assert (opacity[behind_m < 0.003] == 0).all()
    assert (opacity[behind_m > 0.0151] == 1).all()
    other = replace(hand, info=replace(hand.info, template="mine"))
    assert ended(other) is other
