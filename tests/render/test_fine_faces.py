"""Hands that are large in a picture have faces of a quarter the size, on a smooth surface through their vertices."""

from dataclasses import replace

import numpy as np
import pytest

from jghand_engine.avatar.blocks import padded_rows
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.forearm import ended
from jghand_engine.avatar.scene_light import Lamp, SceneLight
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.native import library as native_library
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.native.threads import shared_pool
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import DetailedHand, NativeDetail
from jghand_engine.render.fine_faces import FineFaces, opposite_vertices, sides_behind
from jghand_engine.render.renderer import HandRenderer, SceneRenderer
from jghand_engine.render.settings import preset

# of the vertices around the middle of a side, in their order: Dyn, Levin and Gregory's, with their tension
SHARES = np.array([1 / 2, 1 / 2, 1 / 8, 1 / 8, *[-1 / 16] * 4])
OCTAHEDRON = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])


def grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Places (V, 2) and faces of a square of regular triangles, each small square cut the same way."""
    row, column = (each.ravel() for each in np.mgrid[: size - 1, : size - 1])
    low, number = row * size + column, np.arange(size)
    faces = np.concatenate(
        [np.stack([low, low + 1, low + size], 1), np.stack([low + 1, low + size + 1, low + size], 1)]
    )
    return np.stack(np.meshgrid(number, number), -1).reshape(-1, 2).astype(float), faces


def test_across_each_side_of_a_face_is_the_vertex_of_its_neighbor():
    faces = np.array([[0, 1, 2], [2, 1, 3]])
    assert sides_behind(faces).tolist() == [-1, 3, -1, 1, -1, -1]
    assert opposite_vertices(faces).tolist() == [[0, 3, 2], [0, 1, 3]]


def test_each_face_becomes_four_that_are_as_closed_as_the_surface_and_lie_in_its_texture():
    face_uv = np.random.default_rng(0).random((8, 3, 2))
    fine = FineFaces.of(OCTAHEDRON, face_uv, 6)
    assert fine.faces.shape == (32, 3)
    assert len(fine.around) == 12
    assert (sides_behind(fine.faces) >= 0).all()
    # its own vertices stay corners, and those in the middles stand between the ends of their sides
    place = np.random.default_rng(1).random((6, 3))
    places = np.concatenate([place, place[fine.around[:, :2]].mean(1)])
    areas = [
        np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        for corner in (places[fine.faces], place[OCTAHEDRON])
    ]
    np.testing.assert_allclose(areas[0].reshape(8, 4, 3), areas[1][:, None] / 4 * np.ones((1, 4, 1)))
    np.testing.assert_allclose(fine.face_uv.reshape(8, 12, 2).mean(1), face_uv.mean(1))
    np.testing.assert_array_equal(fine.face_uv[[0, 1, 2], [0, 0, 0]], face_uv[0])


def test_middles_lie_on_a_cubic_surface_through_the_vertices_and_on_its_border_where_it_ends():
    place, faces = grid(7)
    factors = np.random.default_rng(2).normal(size=(4, 4)) * (np.add.outer(range(4), range(4)) < 4)

    def height(at: np.ndarray) -> np.ndarray:
        return np.einsum("ni,ij,nj->n", np.vander(at[:, 0], 4, True), factors, np.vander(at[:, 1], 4, True))

    fine = FineFaces.of(faces, place[faces], len(place))
    middle, found = place[fine.around[:, :2]].mean(1), (height(place)[fine.around] * fine.share).sum(1)
    inside = ((middle > 1) & (middle < 5)).all(1)
    np.testing.assert_allclose(found[inside], height(middle)[inside])
    assert (fine.share[inside] == SHARES).all()
    # on the border as far as it goes straight on before and behind
    ends = ((middle == 0) | (middle == 6)).any(1)
    along = ends & ((middle == 0) | (middle == 6) | ((middle > 1) & (middle < 5))).all(1)
    assert (ends.sum(), along.sum()) == (24, 16)
    np.testing.assert_allclose(found[along], height(middle)[along])
    # and beside it no farther off than a plane is from a plane
    factors[2:], factors[:, 2:], factors[1, 1] = 0, 0, 0
    found = (height(place)[fine.around] * fine.share).sum(1)
    straight = ~ends | along
    np.testing.assert_allclose(found[straight], height(middle)[straight], atol=1e-12)


@pytest.mark.parametrize("orthographic", [False, True])
def test_the_kernel_puts_middles_where_the_shares_say(orthographic):
    avatar = load_builtin(handedness=Handedness.RIGHT)
    joints_m = named_pose("fist", avatar.canonical_joints_m, handedness=Handedness.RIGHT)
    seen = Camera.looking_at(
        joints_m[9] + (0.1, 0.05, 0.3), joints_m[9], (0, 1, 0), width=96, height=64, focal_px=900.0
    )
    seen = replace(seen, fx=3000.0, fy=3100.0, orthographic=True) if orthographic else seen
    hand, bones = DetailedHand.of(avatar, 1.0), avatar.skeleton().bones(joints_m)
    detail = NativeDetail(native_library.load(), [hand], outline_px=0.01)
    detail.pose([bones], [bones.root_m])
    detail.prepare(np.zeros((5, 64, 96), np.float32), seen, [1.0], ends_hands=True)
    shared_pool(0).run(lambda _thread: detail.find_surface())
    fine = FineFaces.of(hand.detail.faces, hand.detail.face_uv, len(hand.detail.position_m))
    own_m = hand.posed_m(bones)
    posed_m = np.concatenate([own_m, np.einsum("nk,nkc->nc", fine.share, own_m[fine.around])])
    wanted_px, _ = seen.project(posed_m[fine.faces].reshape(-1, 3))
    drawn = detail._hands[0]
    assert drawn._fine is not None
    corner, vertex = drawn._fine.arrays["corner"], drawn._arrays["vertex"]
    found_px = vertex[:2, corner.swapaxes(1, 2).reshape(-1, 3)[np.argsort(drawn._fine.of_row[: len(fine.faces)])]]
    apart_px = np.linalg.norm(found_px.reshape(2, -1).T - wanted_px, axis=1)
    assert apart_px.max() < 2e-3


def test_a_hand_has_finer_faces_where_its_corners_would_be_seen():
    avatar = load_builtin(handedness=Handedness.RIGHT)
    joints_m = named_pose("fist", avatar.canonical_joints_m, handedness=Handedness.RIGHT)
    apart = []
    for size in (120, 600):
        seen = Camera.looking_at(
            joints_m[9] + (0, 0, 0.5), joints_m[9], (0, 1, 0), width=size, height=size, focal_px=4 * size
        )
        settings = [replace(preset("final"), outline_px=outline_px, threads=2) for outline_px in (0.25, 100.0)]
        fine, coarse = (HandRenderer(avatar, each).render(joints_m, seen).rgba[..., 3] for each in settings)
        apart.append(np.abs(fine - coarse).max())
    assert apart[0] == 0
    assert apart[1] > 0.4


def test_middles_have_the_light_the_bend_and_the_end_of_the_mean_of_their_ends():
    avatar = ended(load_builtin(handedness=Handedness.RIGHT))
    joints_m = named_pose("fist", avatar.canonical_joints_m, handedness=Handedness.RIGHT)
    eye_m = joints_m[0] + np.array([0, 0, 0.5])
    seen = Camera.looking_at(eye_m, joints_m[0], (0, 1, 0), width=80, height=80, focal_px=200)
    light = SceneLight(lamps=(Lamp(LampKind.SUN, (3.0, 3.0, 3.0), (0.8, 0.2, 0.6)),))
    renderer = SceneRenderer([avatar], replace(preset("final"), outline_px=0.001), light)
    renderer.render([joints_m], seen)
    detail = renderer._backend._detail
    assert detail is not None
    arrays = detail._hands[0]._arrays
    ends, first = (
        arrays["around"][:, :2].swapaxes(1, 2).reshape(-1, 2),
        padded_rows(len(detail._hands[0].row_of_vertex)),
    )
    ends = ends[ends[:, 0] != ends[:, 1]]  # without what fills up the last block
    for name, varies in (("slope", 1.0), ("bend", 0.1), ("whole", 0.5)):
        values = arrays[name]
        assert np.ptp(values) > varies, name
        np.testing.assert_allclose(values[..., first : first + len(ends)], values[..., ends].mean(-1), atol=1e-6)
