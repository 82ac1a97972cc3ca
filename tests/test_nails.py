"""Nails are painted on all five finger tips, and the shipped avatar is what the painter makes of the shipped mask."""

from __future__ import annotations

import numpy as np
import pytest
from painted_hand import Layers, curved_surface
from painted_skin import TIPS, Landmarks, MarkPainter, SkinLook, fit_nails
from PIL import Image
from studio_light import Studio, skin_rgb

from jghand_engine.avatar.avatar import UVD_RANGE_M
from jghand_engine.avatar.builtin import load_painted
from jghand_engine.captures.making.skin import SkinPoints
from jghand_engine.hand.joints import Handedness
from jghand_engine.template.builtin import ASSETS, load_template
from jghand_engine.template.closest import Surface
from jghand_engine.template.texture import sample_bilinear


@pytest.fixture(scope="module")
def shipped() -> tuple[SkinPoints, np.ndarray]:
    """The skin over some Gaussians of the shipped avatar, all those on nails among them, and their colors (N, 3)."""
    template, avatar = load_template(), load_painted(handedness=Handedness.RIGHT)
    with (ASSETS / "nails.png").open("rb") as stream:
        mask = np.asarray(Image.open(stream).convert("L"), dtype=float) / 255
    uvd = avatar.uvd.astype(np.float64)
    nail = sample_bilinear(mask[..., None], uvd[:, :2])[:, 0]
    some = np.flatnonzero((np.arange(len(avatar)) < 1500) | (nail > 0.5))
    position_m = avatar.position_m.astype(np.float64)[some]
    near = Surface(template.vertices_m, template.faces).closest(position_m)
    _, normal = curved_surface(template, near.face, near.barycentric, Layers().curving)
    depth_m = (0.5 - uvd[some, 2]) * 2 * UVD_RANGE_M
    weights = avatar.bone_weights.astype(np.float64)[some]
    points = SkinPoints(position_m + depth_m[:, None] * normal, normal, weights, nail[some])
    return points, avatar.rgb[some]


def test_every_finger_gets_a_nail_of_a_nail_s_size(shipped):
    shapes = fit_nails(shipped[0], Landmarks.of(load_template().joints_m))
    assert tuple(shape.tip for shape in shapes) == TIPS
    for shape in shapes:
        # measured: 7.6 to 13.3 mm long, 7.1 to 11.5 mm wide, the thumb's the widest
        assert 0.007 < 2 * shape.half_length_m < 0.014
        assert 0.0065 < 2 * shape.half_width_m < 0.012
    assert max(shapes, key=lambda shape: shape.half_width_m).tip == TIPS[0]


def test_nails_are_painted_where_the_mask_has_them_and_nowhere_else(shipped):
    points, _ = shipped
    painted = MarkPainter(points, Landmarks.of(load_template().joints_m)).paint(points.position_m).nail
    for tip in TIPS:
        finger = points.bone_weights[:, tip] > 0.3
        # worst seen 0.836 and 0.019: the painted outline is a smooth one
        assert painted[finger & (points.nail > 0.5)].mean() > 0.82
        assert painted[finger & (points.nail < 0.05)].mean() < 0.025
    assert not painted[(points.bone_weights[:, list(TIPS)] < 0.1).all(axis=1)].any()


def test_the_shipped_colors_are_what_the_painter_makes(shipped):
    """Position and normal are those that compact storage leaves, so single points at edges of marks differ."""
    points, rgb = shipped
    made = skin_rgb(load_template(), points, SkinLook(), Studio())
    error = 255 * np.abs(made - rgb)
    # in 8-bit steps; seen: 0.36, 2.0, and 0.50 on nails
    assert np.median(error) < 0.4
    assert np.percentile(error, 90) < 2.3
    assert np.median(error[points.nail > 0.5]) < 0.6
    bare = SkinPoints(points.position_m, points.normal, points.bone_weights, np.zeros_like(points.nail))
    without = 255 * np.abs(skin_rgb(load_template(), bare, SkinLook(), Studio()) - rgb)
    # seen: 20
    assert np.median(without[points.nail > 0.5]) > 15, "a hand without nails would pass too"
