"""The mask of a hand that nobody cut out: the template, posed and projected."""

import dataclasses

import numpy as np
import pytest
import torch
from picture_sets import FAR, LEFT, RIGHT, look, pose

from jghand_engine.captures.masks import lit_part, silhouette, template_mask
from jghand_engine.hand.skeleton import Skeleton
from jghand_engine.render.camera import Camera
from jghand_engine.template.builtin import load_template
from jghand_engine.template.mesh import posed_vertices


def camera(size=64):
    """At the origin, looking along +z: a point at 1 m depth is at its x and y times 100 plus the middle."""
    return Camera(size, size, 100.0, 100.0, size / 2, size / 2, torch.eye(4, dtype=torch.float64))


def posed(joints_m, handedness):
    template = load_template()
    return posed_vertices(template, Skeleton(template.joints_m, handedness=handedness), joints_m)


def test_a_rectangle_covers_the_pixels_that_it_should():
    corners = np.array([[-0.10, -0.05, 1], [0.105, -0.05, 1], [0.105, 0.15, 1], [-0.10, 0.15, 1]])
    mask = silhouette(camera(), corners, np.array([[0, 1, 2], [0, 2, 3]]))
    assert mask.shape == (64, 64)
    assert mask[27:47, 22:42].all()
    # its right edge runs through the middle of column 42
    assert mask[30:40, 42] == pytest.approx(0.5, abs=0.26)
    assert mask.sum() == pytest.approx(20.5 * 20, abs=0.25 * 41)


def test_what_is_behind_the_camera_or_far_outside_is_not_drawn():
    behind = np.array([[-0.1, -0.1, -1], [0.1, -0.1, -1], [0, 0.1, -1.0]])
    half_behind = np.array([[-0.1, -0.1, 1], [0.1, -0.1, 1], [0, 0.1, -1.0]])
    outside = np.array([[1e7, 0, 1], [1e7, 1e7, 1], [2e7, 0, 1.0]])
    for corners in (behind, half_behind, outside):
        assert not silhouette(camera(), corners, np.array([[0, 1, 2]])).any()


def test_the_template_posed_by_its_own_joints_is_itself():
    template = load_template()
    np.testing.assert_allclose(posed(template.joints_m, RIGHT), template.vertices_m, atol=1e-12)


@pytest.mark.parametrize("index", [0, 1, 2])
def test_a_left_hand_is_the_mirror_image_of_a_right_one(index):
    right = posed(pose(index, RIGHT) - FAR, RIGHT)
    np.testing.assert_allclose(posed(pose(index, LEFT) - FAR, LEFT), right * [-1, 1, 1], atol=1e-12)
    view = look(0.0, 128, 128)
    centered = dataclasses.replace(view, cx=64.0)
    masks = [template_mask(centered, pose(index, hand), hand) for hand in (RIGHT, LEFT)]
    # samples on the outline are drawn or not by the last bit of a corner: 0.004 of the sides' length seen
    assert np.abs(masks[0] - masks[1][:, ::-1]).sum() < 0.01 * np.abs(np.diff(masks[0], axis=1)).sum()


def test_the_silhouette_is_that_of_the_person_who_has_the_template_hand(shared_data):
    """Another identity and rig: the template's silhouette in its pose still covers most of it."""
    from jghand_engine.captures.capture_folder import open_capture
    from jghand_engine.captures.sample import load_image

    for sample in open_capture(shared_data / "capture_old").samples[5::60]:
        truth = load_image(sample).mask >= 0.5
        ours = template_mask(sample.camera, sample.joints_m, sample.handedness) >= 0.5
        # 0.962 is the lowest seen
        assert (truth & ours).sum() / (truth | ours).sum() > 0.95


def test_the_lit_part_is_the_largest_piece_that_is_neither_black_nor_glaring():
    mask = np.zeros((20, 40), np.float32)
    mask[2:18, 2:38] = 1
    picture = np.full((20, 40, 3), 120, np.uint8)
    picture[:, :10] = 9
    picture[:, 30] = 230
    lit = lit_part(mask, picture)
    assert lit[2:18, 10:30].all()
    assert lit.sum() == 16 * 20
    assert not lit_part(mask, np.zeros_like(picture)).any()
