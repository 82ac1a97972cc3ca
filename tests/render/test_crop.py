"""What a plan knows of a posed hand before a camera is what NumPy finds of the same boxes and joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.native import contract
from jghand_engine.render.camera import Camera
from jghand_engine.render.crop import View, views_box
from jghand_engine.render.gate import extent_px
from jghand_engine.render.hand_facts import HandFacts

HANDS = {
    "painted": load_painted(handedness=Handedness.RIGHT),
    "built-in, with a forearm": load_builtin(handedness=Handedness.LEFT),
}
CAMERA = Camera.looking_at([0.1, 0.4, 0.5], [0.3, 0.1, 0.0], [0.0, 1.0, 0.1], width=300, height=200, focal_px=400.0)
CAMERAS = {
    "pinhole": replace(CAMERA, fy=350.0, cx=140.0),
    "parallel rays": replace(CAMERA, fx=900.0, fy=800.0, orthographic=True),
}
FOREARM = np.array([0.2, -0.1, 0.05, 0.9]) / np.linalg.norm([0.2, -0.1, 0.05, 0.9])


def posed(avatar: HandAvatar) -> np.ndarray:
    """A fist that is away from the origin and larger than its canonical hand, one finger longer than the others."""
    joints = 1.2 * named_pose("fist", avatar.canonical_joints_m, handedness=avatar.handedness) + [0.3, 0.05, 0.0]
    joints[17] += 0.5 * (joints[17] - joints[12])
    return joints


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("avatar", HANDS.values(), ids=HANDS)
def test_a_view_is_of_the_corners_of_all_boxes_and_of_the_joints(avatar: HandAvatar, camera: Camera):
    joints, facts, skeleton = posed(avatar), HandFacts(avatar), avatar.skeleton()
    bones = skeleton.bones(joints, forearm=FOREARM)
    view = View(joints, bones, facts, camera, contract.ALPHA_MIN)

    relative = bones.maps[facts._moving].astype(np.float64) @ facts._corners_m
    at = np.moveaxis(relative, 1, 2).reshape(-1, 3) + joints[0]
    pixels, _ = camera.project(at)
    slopes = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    in_camera = at @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    for got, of in (
        (view.lows_m, in_camera.min(0)),
        (view.highs_m, in_camera.max(0)),
        (view.lows, slopes.min(0)),
        (view.highs, slopes.max(0)),
    ):
        np.testing.assert_allclose(got, of, rtol=0, atol=1e-12)

    along = bones.linear_offset[:21, :, :3].astype(np.float64) @ skeleton.canonical.frames
    stretch = float(np.linalg.norm(along, axis=1).max())
    assert stretch > 1.3 * bones.scale  # of the longer finger
    assert view.offset_by_m == pytest.approx(facts.reach_m(bones.scale, stretch, contract.ALPHA_MIN)[1], rel=1e-12)

    pixels, depth_m = camera.project(joints)
    assert view.nearest_m == pytest.approx(depth_m.min(), rel=1e-12)
    wanted = extent_px(float(np.ptp(pixels, 0).max()), float(depth_m.min()), camera)
    assert view.extent_px == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_bone_that_is_nowhere_may_be_anywhere(value: float):
    avatar = HANDS["painted"]
    joints, facts = posed(avatar), HandFacts(avatar)
    bones = avatar.skeleton().bones(joints)
    lost = replace(bones, linear_offset=bones.linear_offset.copy())
    lost.linear_offset[7, 1, 2] = value
    box = views_box([View(joints, lost, facts, CAMERA, contract.ALPHA_MIN)], contract.ALPHA_MIN)
    assert box == (0, 0, CAMERA.width, CAMERA.height)
    assert views_box([View(joints, bones, facts, CAMERA, contract.ALPHA_MIN)], contract.ALPHA_MIN) != box
