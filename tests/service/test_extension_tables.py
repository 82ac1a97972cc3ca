"""What the Blender extension repeats, because it may not import the engine, is the same here and there."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from blender_addon.core import bone_maps, lamps, posing, stand_in
from blender_addon.core import controls as control_numbers
from blender_addon.core import joints as extension
from blender_addon.errors import ADVICE
from blender_addon.hand import motion_files
from jghand_engine.avatar.avatar import FOREARM_WAY
from jghand_engine.avatar.lamp_rows import LAMPS_MAX
from jghand_engine.avatar.light_records import RECORDS_MAX
from jghand_engine.avatar.world_suns import SUNS_MAX
from jghand_engine.errors import InputError, MemoryLimitError, RetryError
from jghand_engine.hand.joints import LEVEL_NAMES, PARENTS, STANDARD_NAMES, Handedness
from jghand_engine.hand.kinematics import RANGES_DEG
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.hand.sequence import FPS_MAX, FPS_MIN, PoseSequence
from jghand_engine.hand.skeleton import PALM_PRIOR
from jghand_engine.hand.wrist import BEND_M
from jghand_engine.motion import bone_names, conventions
from jghand_engine.motion.files import write_motion
from jghand_engine.render.settings import PRESETS
from jghand_engine.service.commands import error_header
from jghand_engine.template.builtin import load_template
from jghand_engine.template.weights import PALM_SPLIT_SIGMA_M, WRIST_BLEND_M


def test_joints_have_the_same_names_in_the_same_order():
    assert extension.NAMES == STANDARD_NAMES
    assert set(extension.HANDEDNESSES) == set(Handedness)


def test_orders_that_can_be_chosen_are_those_of_the_engine():
    assert {name for name, _ in motion_files.ORDERS} == set(JointOrder)


def test_joints_have_the_same_parents():
    for place, name in enumerate(extension.NAMES):
        parent = PARENTS[LEVEL_NAMES.index(name)]
        assert extension.PARENTS[place] == (-1 if parent < 0 else STANDARD_NAMES.index(LEVEL_NAMES[parent]))


def test_the_rest_hand_is_the_built_in_hand():
    # the extension's numbers are rounded to a micrometer
    wanted = from_level(np.asarray(load_template().joints_m), JointOrder.STANDARD)
    np.testing.assert_allclose(posing.rest_joints_m("right"), wanted, atol=6e-7)


def test_the_wrist_bends_in_the_same_place():
    assert stand_in.BEND_M == BEND_M


def test_the_elbow_lies_where_the_forearm_goes():
    # both are rounded to a tenth of a millimeter, or of a thousandth
    elbow_m = np.array(extension.ELBOW_RIGHT_M)
    np.testing.assert_allclose(elbow_m / np.linalg.norm(elbow_m), FOREARM_WAY, atol=3e-4)


def test_the_palm_arches_alike():
    assert (stand_in._SPLIT_M, stand_in._WRIST_BLEND_M) == (PALM_SPLIT_SIGMA_M, WRIST_BLEND_M)
    assert stand_in._PALM_PART == PALM_PRIOR


def test_every_kind_of_error_of_the_engine_has_a_sentence_and_the_engines_own_exit_code():
    for error in (InputError("x"), RetryError("x"), MemoryLimitError("x")):
        assert ADVICE[error_header(error)["kind"]].exit_code == error.exit_code
    assert error_header(ZeroDivisionError())["kind"] in ADVICE


def test_the_preset_of_a_batch_run_exists():
    assert "final" in PRESETS


def test_as_many_lamps_light_a_hand_and_the_suns_of_a_world_find_room_beside_those_that_are_sent():
    assert lamps.LAMPS_LIT == LAMPS_MAX
    assert lamps.LAMPS_SENT + SUNS_MAX <= RECORDS_MAX


def test_joints_go_as_far():
    thumb, *fingers = RANGES_DEG
    assert [list(map(list, table)) for table in control_numbers.JOINT_RANGES_DEG] == [
        thumb.tolist(),
        fingers[0].tolist(),
    ]
    assert all((finger == fingers[0]).all() for finger in fingers)


def test_motions_may_be_as_slow_and_as_fast():
    assert (motion_files.FPS_MIN, motion_files.FPS_MAX) == (FPS_MIN, FPS_MAX)


def test_the_extension_reads_the_motions_that_the_engine_writes(tmp_path):
    joints = np.asarray(load_template().joints_m) + np.linspace(0, 0.1, 5)[:, None, None]
    write_motion(tmp_path / "motion.npz", PoseSequence(joints, 24.0, Handedness.LEFT))
    read = motion_files.read_motion(tmp_path / "motion.npz")
    np.testing.assert_array_equal(read.joints_m, from_level(joints, JointOrder.STANDARD))
    assert (read.fps, read.handedness) == (24.0, "left")


@pytest.mark.parametrize("convention", bone_names.CONVENTIONS, ids=lambda one: one.title)
@pytest.mark.parametrize("side", list(Handedness))
def test_the_extension_and_the_engine_find_the_same_bones(convention, side):
    chosen = [names[0] for names in convention.names(side)]
    prefix = "" if convention.says_side else f"{side}_"
    names = ["Root", *(prefix + name for name in reversed(chosen))]
    (hand,), _ = bone_names.hands_among(names)
    assert hand.handedness is side
    assert [names[bone] for bone in hand.bones if bone is not None] == [prefix + name for name in chosen]
    if convention.title in {one.title for one in conventions.CONVENTIONS}:
        found = bone_maps.recognize(names, side.value).bone_map
        assert found is not None
        assert [source.bone for source in found.sources if source is not None] == [prefix + name for name in chosen]
