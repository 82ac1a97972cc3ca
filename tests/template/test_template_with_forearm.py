"""The forearm: it goes on where the hand's skin ends, and the hand does not notice."""

import numpy as np
import pytest
import trimesh

from jghand_engine.captures.making.rig import identity_names, load_identity
from jghand_engine.cli.learning import hand_template
from jghand_engine.hand.joints import BONE_COUNT
from jghand_engine.learn.canonical_points import FOREARM_DENSITY, bone_areas, bone_shares
from jghand_engine.template.builtin import (
    load_fields,
    load_template,
    load_template_with_forearm,
    template_called,
    with_forearm,
)
from jghand_engine.template.closest import Surface
from jghand_engine.template.sampling import FOREARM, sample_shell
from jghand_engine.template.surface import boundary_loop, enclosed_volume, face_normals, is_closed
from jghand_engine.template.texture import rasterize_uv


@pytest.fixture(scope="module")
def arm():
    return load_template_with_forearm()


def test_the_hand_is_the_same_to_the_bit(arm):
    hand = load_template()
    skin, faces = len(load_fields()["base_index"]), hand.skin_face_count
    assert arm.skin_face_count - arm.forearm_face_count == faces
    for name, count in (("vertices_m", skin), ("bone_weights", skin), ("faces", faces), ("face_uv", faces)):
        assert np.array_equal(getattr(arm, name)[:count], getattr(hand, name)[:count]), name
    assert np.array_equal(arm.joints_m, hand.joints_m)
    assert arm.identifier != hand.identifier


def test_a_hand_is_learned_on_it_where_the_pictures_show_it(arm):
    assert hand_template(None, forearm=True) is arm
    assert hand_template(None) is load_template()
    # and its mesh is found again by the name that avatars carry
    assert template_called(arm.identifier) is arm


def test_it_follows_the_wrist_alone_and_ends_in_the_middle_of_the_forearm(arm):
    skin = len(load_fields()["base_index"])
    assert (arm.bone_weights[skin:, 0] == 1).all()
    assert -0.145 < arm.vertices_m[:, 1].min() < -0.12


@pytest.mark.parametrize("name", [None, *identity_names()])
def test_its_surface_is_closed_and_smooth_where_the_hand_ended(name):
    hand = load_template_with_forearm() if name is None else load_identity(name, forearm=True)
    assert is_closed(hand.faces)
    assert enclosed_volume(hand.vertices_m, hand.faces) > 0
    normals = face_normals(hand.vertices_m, hand.faces)
    faces_at = {
        tuple(edge): face
        for face, corners in enumerate(hand.faces)
        for edge in zip(corners, np.roll(corners, -1), strict=True)
    }
    loop = boundary_loop(load_template().faces[: load_template().skin_face_count])
    cut = [(faces_at[a, b], faces_at[b, a]) for a, b in zip(loop, np.roll(loop, -1), strict=True)]
    turns_deg = np.degrees(np.arccos([normals[one] @ normals[other] for one, other in cut]))
    # worst observed 14 degrees, between the faces of a coarse mesh; a fold or a flipped face has 90 and more
    assert turns_deg.max() < 25
    # nothing of the forearm looks inwards
    arm = hand.faces[load_template().skin_face_count : hand.skin_face_count]
    points, axis = hand.vertices_m[arm].mean(1), hand.vertices_m[-1] - hand.vertices_m[loop].mean(0)
    away = points - hand.vertices_m[-1]
    away -= np.outer(away @ axis / (axis @ axis), axis)
    assert (np.sum(face_normals(hand.vertices_m, arm) * away, axis=1) > 0).all()


def test_its_skin_has_a_place_of_its_own_in_the_uv(arm):
    hand = arm.skin_face_count - arm.forearm_face_count
    parts = [slice(0, hand), slice(hand, arm.skin_face_count), slice(arm.skin_face_count, None)]
    laid = [rasterize_uv(arm.face_uv[part], np.zeros((*arm.face_uv[part].shape[:2], 1)), 512)[1] for part in parts]
    # along the wrist both cover the texels that the line between them crosses
    assert (laid[0] & laid[1]).sum() < 400
    assert not (laid[2] & (laid[0] | laid[1])).any()
    edges = np.cross(*np.moveaxis(np.pad(np.diff(arm.face_uv[parts[1]], axis=1), ((0, 0), (0, 0), (0, 1))), 1, 0))
    assert (edges[:, 2] > 0).all()
    # no seam at the wrist: a vertex of the cut has the same UVs on both sides
    loop = boundary_loop(load_template().faces[:hand])
    for vertex in loop:
        sides = [{tuple(uv) for uv in arm.face_uv[part][arm.faces[part] == vertex]} for part in parts[:2]]
        assert sides[1] <= sides[0]


def test_the_fingers_keep_their_gaussians_and_the_forearm_has_a_part_of_their_density(arm):
    # in proportion to the area
    share, area = bone_shares(arm, 1.0), bone_areas(arm)
    density = share / area
    np.testing.assert_allclose(density[:BONE_COUNT], density[0])
    assert density[BONE_COUNT] == pytest.approx(FOREARM_DENSITY * density[0])
    # as trainings share them: the fingers lose one in twenty, because the wrist's cap has none any more
    before, after = (bone_shares(one, 0.78) for one in (load_template(), arm))
    fingers = slice(5, BONE_COUNT)
    assert after[fingers].sum() / after.sum() > 0.95 * before[fingers].sum() / before.sum()


def test_points_of_the_forearm_lie_under_its_skin_and_those_of_bones_do_not(arm):
    sample = sample_shell(arm, per_bone=40, seed=1)
    near = Surface(arm.vertices_m, arm.faces).closest(sample.position_m)
    assert np.array_equal(arm.is_forearm[near.face], sample.bone == FOREARM)
    # none where it is cut
    assert near.face.max() < arm.skin_face_count
    assert np.array_equal(np.bincount(sample.bone), [0, *[40] * 21])
    # everywhere under it: worst observed 5 mm
    corners = arm.vertices_m[arm.faces[arm.is_forearm]]
    middle_m = np.average(corners.mean(axis=1), axis=0, weights=trimesh.triangles.area(corners))
    np.testing.assert_allclose(sample.position_m[sample.bone == FOREARM].mean(axis=0), middle_m, atol=0.008)


def test_a_file_without_its_last_ring_is_no_hand():
    fields = load_fields()
    broken = with_forearm({**fields, "forearm_faces": fields["forearm_faces"][:-20]})
    assert not is_closed(broken["faces"])
