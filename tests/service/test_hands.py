"""The engine's own pictures for the service."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jghand_engine import limits
from jghand_engine.avatar.builtin import load_painted
from jghand_engine.avatar.file import save_avatar
from jghand_engine.avatar.shipped import PAINTED
from jghand_engine.avatar.storage import Storage
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.service.commands import Hand, View
from jghand_engine.service.hands import EngineHands
from jghand_engine.splat.camera import Camera
from jghand_engine.splat.frame import HandRenderer
from jghand_engine.splat.settings import preset

VIEW = View(120, 90, 200.0, 200.0, 60.0, 45.0, "draft", depth=True)


@pytest.fixture(scope="module")
def source() -> EngineHands:
    return EngineHands()


@pytest.fixture(scope="module")
def right(source) -> Hand:
    """The painted hand at rest, half a metre before the camera, palm towards it."""
    camera_from_hand = np.diag([1.0, -1, -1, 1])
    camera_from_hand[:3, 3] = (0, 0.09, 0.5)
    return Hand(PAINTED, "right", source.load(PAINTED).canonical_joints_m, camera_from_hand)


def test_a_picture_is_that_of_the_renderer_in_its_own_process(source, right):
    import torch

    came = source.render([right], VIEW)
    camera = Camera(120, 90, 200.0, 200.0, 60.0, 45.0, torch.from_numpy(right.camera_from_hand))
    renderer = HandRenderer(load_painted(handedness=Handedness.RIGHT), preset("draft"))
    frame = renderer.render(to_level(right.joints_m, JointOrder.STANDARD), camera)
    np.testing.assert_array_equal(came.rgba, frame.rgba)
    np.testing.assert_array_equal(came.depth_m, frame.depth_m)
    assert came.report["visible_gaussians"] > 0


def test_where_the_hands_own_space_is_does_not_matter(source, right):
    """Only joints seen from the camera count: the same hand given in another space is the same picture."""
    turn = np.array([[0, -1.0, 0, 0.3], [1, 0, 0, -2.0], [0, 0, 1, 0.7], [0, 0, 0, 1]])
    elsewhere = replace(
        right,
        joints_m=right.joints_m @ turn[:3, :3].T + turn[:3, 3],
        camera_from_hand=right.camera_from_hand @ np.linalg.inv(turn),
    )
    # worst observed 0: positions are kept relative to the root
    np.testing.assert_allclose(source.render([elsewhere], VIEW).rgba, source.render([right], VIEW).rgba, atol=1e-6)


def test_a_left_hand_is_the_mirror_image_of_a_right_one(source, right):
    left = replace(right, handedness="left", joints_m=right.joints_m * (-1, 1, 1))
    mirrored = source.render([left], VIEW).rgba[:, ::-1]
    # worst observed 0.0075: roundings decide about a Gaussian at the cut-off, which is 1/64 in this preset
    np.testing.assert_allclose(mirrored, source.render([right], VIEW).rgba, atol=1 / 64)


def test_the_nearer_of_two_hands_covers_the_other_whatever_their_order(source, right):
    nearer = replace(right, handedness="left", camera_from_hand=right.camera_from_hand.copy())
    nearer.camera_from_hand[2, 3] = 0.4
    one, other = source.render([right, nearer], VIEW), source.render([nearer, right], VIEW)
    # worst observed 2.5e-6 of rounding, because positions are kept relative to the first hand; a Gaussian at the
    # contract's cut-off may fall on either side of it (observed: 16 of 43200 values, by 4.3e-4 at most)
    difference = np.abs(one.rgba - other.rgba)
    assert (difference > 5e-6).mean() < 5e-4
    assert difference.max() < limits.ALPHA_MIN
    alone = source.render([nearer], VIEW)
    solid = alone.rgba[..., 3] > 0.998
    assert solid.sum() > 300
    # worst observed 0.0031 and 0.15 mm: the two thousandths that shine through, and where a block of pixels stops
    # early, which may cost the preset's t_stop of 0.01
    np.testing.assert_allclose(one.rgba[solid], alone.rgba[solid], atol=4e-3)
    np.testing.assert_allclose(one.depth_m[solid], alone.depth_m[solid], atol=2e-4)


def test_depth_is_left_out_when_nobody_asks_for_it(source, right):
    assert source.render([right], VIEW).depth_m.any()
    assert not source.render([right], replace(VIEW, depth=False)).depth_m.any()


def test_a_renderer_is_kept_and_only_the_last_few_are(source, right):
    fresh = EngineHands()
    for _ in range(2):
        fresh.render([right], VIEW)
        fresh.render([right], replace(VIEW, preset="viewport"))
    assert len(fresh._renderers) == 2
    for count in range(3, 12):
        fresh.render([right] * count, replace(VIEW, width=8, height=6))
    assert len(fresh._renderers) == 8


def test_an_avatar_that_changed_on_disk_is_seen_after_loading_it_again(source, right, tmp_path):
    path = tmp_path / "hand.jghand"
    avatar = load_painted(handedness=Handedness.RIGHT).prefix(5000)
    hand = replace(right, avatar=str(path))
    pictures = []
    for colour in (avatar.rgb, 1 - avatar.rgb):
        save_avatar(path, replace(avatar, rgb=colour))
        assert source.load(str(path)).facts["gaussians"] == 5000
        pictures.append(source.render([hand], VIEW).rgba)
    assert np.abs(pictures[0] - pictures[1]).max() > 0.2


def test_a_trained_hand_reflects_towards_the_camera_of_each_picture(source, right, tmp_path):
    import torch
    from small_avatars import trained_avatar

    avatar, path = trained_avatar(2000), tmp_path / "trained.jghand"
    save_avatar(path, avatar, storage=Storage.EXACT)
    hand, view = replace(right, avatar=str(path)), replace(VIEW, preset="viewport")
    dark = replace(avatar, learnt=replace(avatar.learnt, shine=torch.zeros(2000)))
    turn = np.array([[0.96, 0, 0.28, 0], [0, 1, 0, 0], [-0.28, 0, 0.96, 0], [0, 0, 0, 1]])
    for camera_from_hand in (right.camera_from_hand, right.camera_from_hand @ turn):
        came = source.render([replace(hand, camera_from_hand=camera_from_hand)], view)
        camera = Camera(120, 90, 200.0, 200.0, 60.0, 45.0, torch.from_numpy(camera_from_hand))
        wanted, matt = (
            HandRenderer(one, preset("viewport")).render(to_level(right.joints_m, JointOrder.STANDARD), camera).rgba
            for one in (avatar, dark)
        )
        np.testing.assert_array_equal(came.rgba, wanted)
        assert np.abs(wanted - matt).max() > 0.05
        assert any(stage["name"] == "gloss" and stage["ran"] for stage in came.report["stages"])


def test_a_png_is_encoded(source, right):
    assert source.encode_png(source.render([right], VIEW).rgba).startswith(b"\x89PNG")


@pytest.mark.parametrize("changes", [{"handedness": "both"}, {"avatar": "/nowhere.jghand"}])
def test_what_is_not_there_is_bad_input(source, right, changes):
    with pytest.raises(InputError):
        source.render([replace(right, **changes)], VIEW)


def test_an_unknown_preset_is_bad_input(source, right):
    with pytest.raises(InputError, match="preset"):
        source.render([right], replace(VIEW, preset="best"))
