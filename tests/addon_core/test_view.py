"""What a picture request says of cameras and hands."""

from dataclasses import replace

import numpy as np

from blender_addon.core.posing import rest_joints_m
from blender_addon.core.view import HandInSpace, Moment, Pinhole, SceneLight, avatar_stamp, picture_request
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.render.camera import Lens
from jghand_engine.service.image_request import read_request
from jghand_engine.service.protocol import Message


def rigid(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn * np.linalg.det(turn), rng.uniform(-5, 5, 3)
    return matrix


VIEW = Pinhole(96, 64, 120.0, 130.0, 40.0, 33.0, rigid(1))
HANDS = [
    HandInSpace(side, rest_joints_m(side), rigid(seed), f"{side}.jghand") for seed, side in ((2, "right"), (3, "left"))
]


def understood(header, arrays):
    """What the engine makes of it."""
    return read_request(Message(header, arrays))


def standard(moment):
    """(hands, 21, 3) its joints in the standard order, world, meters."""
    return from_level(np.stack(moment.joints_m), JointOrder.STANDARD)


def test_the_engine_sees_every_joint_where_the_pinhole_does():
    request, outputs = understood(*picture_request([Moment(VIEW, HANDS)], outputs=["rgba_u8", "depth"], preset="draft"))
    assert (request.width, request.height, outputs) == (96, 64, ["rgba_u8", "depth"])
    assert [(hand.avatar, hand.handedness) for hand in request.hands] == [
        ("right.jghand", "right"),
        ("left.jghand", "left"),
    ]
    (moment,) = request.moments
    for hand, joints_m in zip(HANDS, standard(moment), strict=True):
        pixels, depth_m = moment.camera.project(joints_m)
        np.testing.assert_allclose(np.c_[pixels, depth_m], VIEW.project(hand.joints_world_m), atol=1e-9)


def test_up_in_blender_is_up_in_the_light_of_captures():
    """+z of Blender is +y of captures; who looks from the front (-y) stands where captures look at the palm from."""
    upright = np.array([[1.0, 0, 0, 2], [0, 0, -1, 3], [0, 1, 0, 4], [0, 0, 0, 1]])  # +y of the hand along +z
    hand = replace(HANDS[0], world_from_hand=upright)
    request, _ = understood(*picture_request([Moment(VIEW, [hand])], outputs=["rgba_u8"], preset="draft"))
    np.testing.assert_allclose(standard(request.moments[0])[0] - (2, 4, -3), hand.joints_m, atol=1e-12)


def test_a_light_arrives_with_its_lamps_and_its_world():
    sun = {"kind": "sun", "rgb": [3.0, 2.0, 1.0], "place_m": [0.0, 0.0, 1.0]}
    picture = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    light = SceneLight([sun], {"key": "sky", "env_from_world": np.eye(3).tolist()}, picture)
    request, _ = understood(*picture_request([Moment(VIEW, HANDS)], outputs=["rgba_f32"], preset="draft", light=light))
    assert request.light is not None
    assert request.light.record == light.record()
    np.testing.assert_array_equal(request.light.radiance, picture)
    dark, _ = understood(
        *picture_request([Moment(VIEW, HANDS)], outputs=["rgba_f32"], preset="draft", light=SceneLight())
    )
    assert dark.light is not None
    assert dark.light.radiance is None


def test_settings_lens_and_rays_arrive():
    view = replace(VIEW, aperture_m=0.01, focus_m=0.7)
    request, _ = understood(*picture_request([Moment(view, HANDS)], outputs=["ids"], preset="final", budget_ms=9.5))
    assert request.moments[0].camera.lens == Lens(0.01, 0.7)
    assert request.ids
    assert not request.depth
    assert (request.settings.preset, request.settings.budget_ms) == ("final", 9.5)
    request, _ = understood(
        *picture_request([Moment(replace(VIEW, orthographic=True), [])], outputs=["rgba_u8"], preset="draft")
    )
    assert request.moments[0].camera.orthographic
    assert request.hands == ()


def test_moments_arrive_in_their_order_with_their_weights():
    shown = [replace(hand, forearm=place != 1) for place, hand in enumerate(HANDS)]
    moments = [
        Moment(replace(VIEW, fx=100.0 + k), [replace(hand, world_from_hand=rigid(10 + k)) for hand in shown], 1.0 + k)
        for k in range(3)
    ]
    request, _ = understood(*picture_request(moments, outputs=["depth_covered"], preset="draft"))
    assert [hand.forearm for hand in request.hands] == [hand.forearm for hand in shown]
    assert [moment.camera.fx for moment in request.moments] == [100, 101, 102]
    assert request.weights == (1, 2, 3)
    assert request.depth
    for sent, came in zip(moments, request.moments, strict=True):
        for hand, joints_m in zip(sent.hands, standard(came), strict=True):
            pixels, depth_m = came.camera.project(joints_m)
            np.testing.assert_allclose(np.c_[pixels, depth_m], sent.view.project(hand.joints_world_m), atol=1e-9)


def test_the_stamp_of_an_avatar_changes_with_its_file(tmp_path):
    path = tmp_path / "hand.jghand"
    stamps = [avatar_stamp("builtin"), avatar_stamp(str(path))]
    for content in (b"one", b"other"):
        path.write_bytes(content)
        stamps.append(avatar_stamp(str(path)))
        assert stamps[-1] == avatar_stamp(str(path))
    assert len(set(stamps)) == 4


def test_how_a_forearm_is_turned_is_said_for_all_hands_or_for_none():
    (straight,) = understood(*picture_request([Moment(VIEW, HANDS)], outputs=["depth"], preset="draft"))[0].moments
    assert [hand.forearm for hand in straight.hands] == [None, None]
    turn = np.array([0.6, 0.0, 0.8, 0.0])
    bent = [HANDS[0], replace(HANDS[1], forearm_turn=turn)]
    (moment,) = understood(*picture_request([Moment(VIEW, bent)], outputs=["depth"], preset="draft"))[0].moments
    np.testing.assert_allclose([hand.forearm for hand in moment.hands], [(1, 0, 0, 0), turn])
    assert bent[1].pose_bytes != HANDS[1].pose_bytes
