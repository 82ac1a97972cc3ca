"""The hand that JGHand ships: what is promised of its surface, its weights and its texture layout."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import LEVEL_NAMES, PARENTS, STANDARD_NAMES
from jghand_engine.hand.orders import bone_lengths, check_order, implausibilities
from jghand_engine.template import builtin
from jghand_engine.template.builtin import load_fields, load_template
from jghand_engine.template.mesh import mirrored
from jghand_engine.template.surface import enclosed_volume, is_closed
from jghand_engine.template.texture import rasterize_uv, sample_bilinear

# DATA 2; thumb, index, middle, ring, pinky from the wrist on
BONE_LENGTHS_MM = [
    *(37.5, 94.5, 88.5, 84.4, 79.6),
    *(42.0, 29.6, 38.1, 36.2, 26.9),
    *(24.5, 19.7, 26.8, 27.0, 15.0),
    *(29.6, 28.0, 24.2, 19.4, 18.9),
]


@pytest.fixture(scope="module")
def template():
    return load_template()


def signed_uv_areas(face_uv):
    edge1, edge2 = face_uv[:, 1] - face_uv[:, 0], face_uv[:, 2] - face_uv[:, 0]
    return (edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0]) / 2


def test_the_surface_is_closed_and_looks_outwards(template):
    assert is_closed(template.faces)
    edges = len(template.faces) * 3 // 2
    assert len(template.vertices_m) - edges + len(template.faces) == 2
    assert enclosed_volume(template.vertices_m, template.faces) == pytest.approx(274.4e-6, abs=0.05e-6)
    area_m2 = trimesh.triangles.area(template.vertices_m[template.faces]).sum()
    assert area_m2 == pytest.approx(374e-4, abs=0.5e-4)


def test_the_frame_is_canonical(template):
    wrist, index, middle, pinky = template.joints_m[[0, 2, 3, 5]]
    assert (wrist == 0).all()
    np.testing.assert_allclose(middle / np.linalg.norm(middle), [0, 1, 0], atol=1e-15)
    assert index[0] > 0 > pinky[0]
    assert index[2] == pytest.approx(pinky[2], abs=1e-8)
    # the fingers bend towards the palm
    assert (template.joints_m[17:, 2] > template.joints_m[2:6, 2]).all()


def test_bone_lengths_are_those_of_the_recipe(template):
    np.testing.assert_allclose(bone_lengths(template.joints_m) * 1e3, BONE_LENGTHS_MM, atol=0.1)


def test_its_joints_are_a_plausible_hand(template):
    assert implausibilities(template.joints_m) == []
    check_order(template.joints_m)


def test_rows_of_weights_sum_to_one_and_no_skin_follows_a_tip(template):
    np.testing.assert_allclose(template.bone_weights.sum(axis=1), 1, atol=1e-15)
    assert (template.bone_weights >= 0).all()
    stored = load_fields()["weights"]
    assert (stored[:, [STANDARD_NAMES.index(f"{finger}4") for finger in ("thumb", "index", "pinky")]] == 0).all()
    assert (stored > 1e-4).sum(axis=1).max() == 6


def test_skin_between_two_joints_follows_the_bone_between_them(template):
    """Off by one joint leaves every joint exact and ruins the skin."""
    for bone in range(6, 21):
        middle = (template.joints_m[bone] + template.joints_m[PARENTS[bone]]) / 2
        nearest = np.linalg.norm(template.vertices_m - middle, axis=1).argsort()[:5]
        assert template.bone_weights[nearest, bone].mean() > 0.5, LEVEL_NAMES[bone]


def test_the_texture_layout_has_no_flips_and_no_overlaps(template):
    area = signed_uv_areas(template.face_uv)
    # the island and the cap each have one orientation
    skin = template.skin_face_count
    assert (np.sign(area[:skin]) == np.sign(area[0])).all()
    assert (area[skin:] != 0).all()
    _, covered = rasterize_uv(template.face_uv, np.zeros((len(area), 3, 1)), 1024)
    # faces that overlap would cover less than the sum of their areas; observed 0.5 % more, from texels at the rim
    assert 1 <= covered.mean() / np.abs(area).sum() <= 1.01


def test_the_cap_lies_beside_the_skin_in_the_texture(template):
    skin = template.skin_face_count
    halves = [
        rasterize_uv(template.face_uv[part], np.zeros((len(template.face_uv[part]), 3, 1)), 512)[1]
        for part in (slice(0, skin), slice(skin, None))
    ]
    assert not (halves[0] & halves[1]).any()
    assert halves[1].any()


def test_the_left_hand_is_the_right_one_mirrored_exactly(template):
    left = mirrored(template)
    assert np.array_equal(left.vertices_m[:, 0], -template.vertices_m[:, 0])
    assert np.array_equal(left.vertices_m[:, 1:], template.vertices_m[:, 1:])
    assert np.array_equal(left.joints_m, template.joints_m * [-1, 1, 1])
    assert left.bone_weights is template.bone_weights
    assert enclosed_volume(left.vertices_m, left.faces) == pytest.approx(
        enclosed_volume(template.vertices_m, template.faces), rel=1e-12
    )
    # each vertex keeps its texture coordinates
    rows = np.arange(len(left.faces))[:, None]
    order_left, order = left.faces.argsort(axis=1), template.faces.argsort(axis=1)
    assert np.array_equal(left.face_uv[rows, order_left], template.face_uv[rows, order])
    twice = mirrored(left)
    for name in ("vertices_m", "joints_m", "faces", "face_uv"):
        assert np.array_equal(getattr(twice, name), getattr(template, name)), name


def test_the_shared_template_cannot_be_changed(template):
    with pytest.raises(ValueError, match="read-only"):
        template.vertices_m[0] = 0
    assert load_template() is template


def test_a_damaged_installation_is_to_be_made_again(monkeypatch, tmp_path):
    monkeypatch.setattr(builtin, "load_fields", lambda: load_fields(tmp_path / "none.npz"))
    with pytest.raises(InputError, match=r"built-in hand: got .*none\.npz.* Install JGHand again"):
        load_template.__wrapped__()


def test_every_finger_has_its_nail_on_the_back_of_its_tip(template):
    with (builtin.ASSETS / "nails.png").open("rb") as stream:
        nails = np.asarray(Image.open(stream))
    assert nails.shape == (512, 512)
    assert nails.dtype == np.uint8
    skin = template.skin_face_count
    centers = template.vertices_m[template.faces[:skin]].mean(axis=1)
    is_nail = sample_bilinear(nails[..., None].astype(float), template.face_uv[:skin].mean(axis=1))[:, 0] > 128
    nearest_tip = np.linalg.norm(centers[is_nail, None] - template.joints_m[16:], axis=2)
    assert set(nearest_tip.argmin(axis=1)) == set(range(5))
    # worst observed 13.8 mm
    assert nearest_tip.min(axis=1).max() < 0.015
    corners = template.vertices_m[template.faces[:skin][is_nail]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    fingers = nearest_tip.argmin(axis=1) > 0
    assert (normals[fingers, 2] < 0).all()


def test_the_other_fields_of_the_file_are_there():
    fields = load_fields()
    assert fields["joints25"].shape == (25, 3)
    np.testing.assert_allclose(fields["weights25"].sum(axis=1), 1, atol=1e-6)
    # the metacarpals are what 25 joints have and 21 have not
    extra = set(map(tuple, fields["joints25"].round(5))) - set(map(tuple, fields["joints"].round(5)))
    assert len(extra) == 4
    assert (fields["face_uv_makehuman"].min(), fields["face_uv_makehuman"].max()) > (0, 0)
    assert len(fields["base_index"]) == len(fields["vertices"]) - 1


def test_it_equals_the_reference_build(shared_data):
    with np.load(shared_data / "hand_right.npz", allow_pickle=False) as reference:
        fields = load_fields()
        for name in ("vertices", "joints", "weights", "joints25", "weights25", "face_uv", "face_uv_makehuman"):
            np.testing.assert_allclose(fields[name], reference[name], atol=1e-6, err_msg=name)
        ours, theirs = ((f["vertices"].astype(float), f["faces"].astype(int)) for f in (fields, reference))
    assert abs(enclosed_volume(*ours) - enclosed_volume(*theirs)) < 1e-6 * enclosed_volume(*theirs)
    areas_m2 = [trimesh.triangles.area(vertices[faces]).sum() for vertices, faces in (ours, theirs)]
    assert areas_m2[0] == pytest.approx(areas_m2[1], rel=1e-6)
