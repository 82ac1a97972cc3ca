"""Joints that are bent farther than an avatar was trained on are named, each once."""

import math
from dataclasses import replace

import numpy as np
import torch
from small_avatars import trained_avatar

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.pose_range import range_report, trained_range
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.skeleton import angle_ranges
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer


def trained_on(*poses: str, handedness: Handedness = Handedness.RIGHT) -> HandAvatar:
    avatar = trained_avatar(100).for_hand(handedness)
    joints = torch.from_numpy(np.stack([joints_of(avatar, pose) for pose in poses]))
    statistics = angle_ranges(transform_of(avatar), joints)
    return replace(avatar, info=replace(avatar.info, pose_statistics=statistics))


def joints_of(avatar: HandAvatar, pose: str) -> np.ndarray:
    return named_pose(pose, avatar.canonical_joints_m, handedness=avatar.handedness)


def report_of(avatar: HandAvatar, *poses: str):
    joints = torch.from_numpy(np.stack([joints_of(avatar, pose) for pose in poses]))
    return range_report(avatar, joints.numpy())


def test_poses_that_were_trained_are_inside():
    for handedness in Handedness:
        avatar = trained_on("open", "fist", "point", handedness=handedness)
        assert report_of(avatar, "open", "fist", "point") == []


def test_a_fist_is_outside_of_open_hands():
    avatar = trained_on("open", "flat", "spread")
    found = report_of(avatar, "open", "fist", "open")
    names = [one.name for one in found]
    assert len(set(names)) == len(names)
    assert {
        f"{finger}{joint} flexion" for finger in ("index", "middle", "ring", "pinky") for joint in (1, 2, 3)
    } <= set(names)
    assert {one.frame for one in found} == {1}
    assert [one.beyond_rad for one in found] == sorted((one.beyond_rad for one in found), reverse=True)
    worst = found[0]
    assert worst.beyond_rad == worst.angle_rad - worst.high_rad > math.radians(8)


def test_one_sentence_says_joint_angle_range_and_how_far():
    avatar = trained_on("open", "fist")
    low, high = avatar.info.pose_statistics["index2 flexion"]
    statistics = {**avatar.info.pose_statistics, "index2 flexion": (low, high - math.radians(20))}
    avatar = replace(avatar, info=replace(avatar.info, pose_statistics=statistics))
    (found,) = report_of(avatar, "fist")
    assert found.name == "index2 flexion"
    degrees = [round(math.degrees(value)) for value in (found.angle_rad, low, high - math.radians(20))]
    wanted = f"index2 flexion {degrees[0]}°: 20° outside the {degrees[1]}° to {degrees[2]}° that was trained"
    assert found.sentence() == wanted


def test_an_avatar_that_was_not_trained_has_no_range():
    avatar = trained_on("open")
    painted = replace(avatar, info=replace(avatar.info, pose_statistics={}))
    assert trained_range(painted.info) is None
    assert report_of(painted, "fist") == []


def test_an_angle_of_which_nothing_is_known_is_never_outside():
    avatar = trained_on("open")
    only = {"index1 flexion": avatar.info.pose_statistics["index1 flexion"]}
    found = report_of(replace(avatar, info=replace(avatar.info, pose_statistics=only)), "fist")
    assert [one.name for one in found] == ["index1 flexion"]


def test_the_frame_notes_what_it_never_saw_also_when_it_is_reused():
    avatar = trained_on("open", "flat")
    view = torch.eye(4, dtype=torch.float64)
    view[2, 3] = 0.5
    camera = Camera(40, 40, 60.0, 60.0, 20.0, 20.0, view)
    renderer = HandRenderer(avatar, None)
    for _ in range(2):
        report = renderer.render(joints_of(avatar, "fist"), camera).report
        assert any("index2 flexion" in note and "trained" in note for note in report.notes)
    assert "transform" not in report.stages
    assert renderer.render(joints_of(avatar, "open"), camera).report.notes == []
