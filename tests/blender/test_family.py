"""Add Hand offers other persons' hands by picture: their avatar, and bones as long as theirs."""

import dataclasses
import zipfile
from pathlib import Path

import bpy
import numpy as np
import pytest
from recording_layout import draw
from test_avatar_cards import write_avatar

from blender_addon import folders
from blender_addon.core import kinematics, poses, posing
from blender_addon.hand import armature, avatar_files, panel, properties, seen_hands

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def installed(extension, tmp_path):
    """A child's hand whose bones are three quarters as long, installed from a zip that has a broken one, too."""
    own = (0.75 * posing.rest_joints_m("right")).tolist()
    avatar = write_avatar(tmp_path / "child.jghand", name="child", gaussians=7, own_joints_m=own)
    picture = ROOT / "jghand_engine" / "assets" / "hands" / "builtin.png"
    with zipfile.ZipFile(tmp_path / "pack.zip", "w") as archive:
        archive.write(avatar, "child.jghand")
        archive.write(picture, "child.png")
        archive.writestr("elder.jghand", b"broken")
    bpy.ops.jghand.install_hands(filepath=str(tmp_path / "pack.zip"))
    yield avatar
    for file in folders.user_folder(seen_hands.HANDS).iterdir():
        file.unlink()


def test_a_broken_hand_of_a_pack_is_told_and_the_rest_is_offered(installed, capfd):
    names = [name for name, *_ in properties.hand_items()]
    assert names[0] == "builtin"
    assert "child" in names
    assert "elder" not in names


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_childs_hand_has_its_avatar_and_its_bones(installed, side):
    bpy.ops.jghand.add_hand(handedness=side, avatar="child")
    hand = bpy.context.object
    assert hand.jghand.avatar == "child"
    assert seen_hands.avatar_of(hand) == str(folders.user_folder(seen_hands.HANDS) / "child.jghand")
    joints_m = armature.read_hand(hand, bpy.context.evaluated_depsgraph_get()).joints_m
    np.testing.assert_allclose(joints_m, 0.75 * posing.rest_joints_m(side), atol=1e-6)


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_fist_is_that_of_the_hands_own_skin(installed, side, monkeypatch):
    monkeypatch.setattr(avatar_files, "LOOK_S", 0.0)
    fist = kinematics.Fist((-5.0, 2.0, 1.0), (0.01, -0.005, 0.0), 0.005)
    write_avatar(
        folders.user_folder(seen_hands.HANDS) / "child.jghand", name="child", gaussians=7, fist=dataclasses.asdict(fist)
    )
    bpy.ops.jghand.add_hand(handedness=side, avatar="child")
    bpy.ops.jghand.apply_pose(pose="fist")
    joints_m = armature.read_hand(bpy.context.object, bpy.context.evaluated_depsgraph_get()).joints_m
    wanted_m, by_bones_m = (poses.joints_on("fist", posing.rest_joints_m(side), side, *one) for one in ([fist], []))
    np.testing.assert_allclose(joints_m, wanted_m, atol=1e-6)
    assert np.abs(wanted_m - by_bones_m).max() > 2e-3


def test_the_built_in_hand_is_added_unless_another_is_chosen(installed):
    bpy.ops.jghand.add_hand(handedness="right")
    assert bpy.context.object.jghand.avatar == ""
    assert seen_hands.avatar_of(bpy.context.object) == "builtin"
    assert bpy.context.window_manager.jghand.hand == "builtin"
    bpy.context.window_manager.jghand.hand = "child"


def test_add_hand_stands_below_pictures_where_there_is_more_than_one_hand(installed, monkeypatch):
    for count in (3, 1):
        seen = draw(panel.HandPanel, bpy.context)
        assert ("template_icon_view" in [one.function for one in seen.drawn]) == (count > 1)
        (added,) = [one for one in seen.drawn if one.arguments.get("operator") == "jghand.add_hand"]
        assert added.settings == {"avatar": bpy.context.window_manager.jghand.hand}
        only = properties.hand_items()[:1]
        monkeypatch.setattr(properties, "hand_items", lambda only=only: only)


def test_a_hand_whose_pack_is_not_installed_says_which_file_is_missing(extension):
    bpy.ops.jghand.add_hand(handedness="right")
    bpy.context.object.jghand.avatar = "somebody"
    wanted = folders.user_folder(seen_hands.HANDS, make=False) / "somebody.jghand"
    assert seen_hands.avatar_of(bpy.context.object) == str(wanted)
