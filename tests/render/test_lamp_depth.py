"""Shadows with the edges of the skin's surface, by pictures that are taken from lamps."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from small_avatars import coarse_builtin, trained_avatar
from test_effects import plan_of

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.forearm import ended
from jghand_engine.avatar.lamp_rows import fade
from jghand_engine.avatar.scene_light import Lamp, SceneLight, Shades, World
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.native import library
from jghand_engine.native.scene_light_task import LAYERS_MAX, LampKind
from jghand_engine.render import light_effects
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import DetailedHand, NativeDetail
from jghand_engine.render.effect_plan import Choice, Effect
from jghand_engine.render.framing import framing_camera
from jghand_engine.render.hand_facts import HandFacts
from jghand_engine.render.lamp_depth import skin_above
from jghand_engine.render.light_effects import APART_LEAST, APART_WHOLE
from jghand_engine.render.renderer import Frame, SceneRenderer
from jghand_engine.render.settings import RenderSettings, preset
from jghand_engine.template.closest import Surface

AVATAR = coarse_builtin()
FINAL = preset("final")
FIST = named_pose("fist", AVATAR.rest_joints_m, handedness=Handedness.RIGHT)
DIM = World(np.full((2, 4, 3), 0.02, np.float32))
WHITE = (3.0, 3.0, 3.0)
TO_SUN = np.array([0.8, 0.7, 0.6]) / np.linalg.norm([0.8, 0.7, 0.6])
SUN = Lamp(LampKind.SUN, WHITE, tuple(TO_SUN), angle_rad=0.002)
MIDDLE_M = FIST.mean(0)
# sees two hands that are half a meter apart
FROM_AFAR = Camera.looking_at((0, 0, 3.0), MIDDLE_M, (0, 1, 0), width=300, height=300, focal_px=300)


def point(away_m: float, radius_m: float = 0.0005) -> Lamp:
    """As bright as the sun at the middle of the fist, in its direction."""
    place_m = MIDDLE_M + away_m * TO_SUN
    return Lamp(LampKind.POINT, tuple(away_m**2 * np.array(WHITE)), tuple(place_m), radius_m=radius_m, is_soft=False)


def view(joints_m: np.ndarray = FIST) -> Camera:
    return framing_camera(joints_m[None], Handedness.RIGHT, "front", width=240, height=300)


@cache
def _made(settings: RenderSettings, pixel_light: float) -> SceneRenderer:
    return SceneRenderer([AVATAR], settings, SceneLight(DIM))


def lit_by(light: SceneLight, settings: RenderSettings = FINAL) -> SceneRenderer:
    """Of the hand; it takes longer to be made than to draw."""
    renderer = _made(settings, light_effects.PIXEL_LIGHT)
    renderer.light = light
    return renderer


def drawn(*lamps: Lamp, joints_m: np.ndarray = FIST, settings: RenderSettings = FINAL) -> Frame:
    return lit_by(SceneLight(DIM, lamps), settings).render([joints_m], view(joints_m))


def skin_seen(renderer: SceneRenderer, hand: int = 0) -> np.ndarray:
    """(N,) what of the first lamp reaches the Gaussians of a hand."""
    poser = renderer._backend._hands[hand]
    assert poser._light is not None
    assert poser._light._scene is not None
    return poser._light._scene.arrays["skin_seen"][0][np.argsort(poser.blocks.order)]


def seen_in(lamp: Lamp, avatar: HandAvatar = AVATAR) -> np.ndarray:
    """(N,) what of a lamp reaches the Gaussians of the fist."""
    light = SceneLight(DIM, (lamp,))
    renderer = lit_by(light) if avatar is AVATAR else SceneRenderer([avatar], FINAL, light)
    renderer.render([FIST], view())
    return skin_seen(renderer).copy()


def hidden_by_faces(corners_m: np.ndarray, places_m: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(N,) whether any of the triangles (F, 3, 3) stands before places (N, 3), by rays: Möller and Trumbore, 1997."""
    sides_m = corners_m[:, 1:] - corners_m[:, :1]
    across = np.cross(direction, sides_m[:, 1])
    area = (sides_m[:, 0] * across).sum(1)
    found = []
    for place_m in places_m:
        from_first = place_m - corners_m[:, 0]
        turned = np.cross(from_first, sides_m[:, 0])
        u, v = (from_first * across).sum(1) / area, (turned @ direction) / area
        way_m = (sides_m[:, 1] * turned).sum(1) / area
        found.append(((u >= 0) & (v >= 0) & (u + v <= 1) & (way_m > 0.002)).any())
    return np.array(found)


@pytest.fixture(scope="module")
def posed():
    """Corners of the faces of the fist (F, 3, 3), places above the Gaussians (N, 3), and normals there (N, 3)."""
    detail = AVATAR.detail
    assert detail is not None
    bones = AVATAR.skeleton().bones(FIST)
    vertices_m = DetailedHand.of(AVATAR, 1.0).posed_m(bones)
    vertex, share = skin_above(detail, AVATAR.position_m)
    corners_m = vertices_m[detail.faces]
    around_m = vertices_m[vertex]
    normal = np.cross(around_m[:, 1] - around_m[:, 0], around_m[:, 2] - around_m[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return corners_m, np.einsum("nk,nkc->nc", share, around_m), normal


def test_skin_above_a_place_is_the_nearest_that_there_is():
    detail = AVATAR.detail
    assert detail is not None
    vertex, share = skin_above(detail, AVATAR.position_m)
    assert np.allclose(share.sum(1), 1, atol=1e-5)
    assert share.min() >= 0
    found_m = np.einsum("nk,nkc->nc", share, detail.position_m[vertex])
    exact = Surface(detail.position_m.astype(np.float64), detail.faces).closest(AVATAR.position_m.astype(np.float64))
    apart_m = np.linalg.norm(found_m - AVATAR.position_m, axis=1)
    # a face that the nearest vertex is not of can be nearer, by a part of its size
    assert np.percentile(apart_m - np.abs(exact.signed_m), 95) < 1e-4
    assert (apart_m - np.abs(exact.signed_m)).max() < 3e-3


@pytest.mark.parametrize("lamp", [SUN, point(20.0), point(0.4)], ids=["sun", "far point", "near point"])
def test_light_reaches_skin_where_no_face_stands_before_it(posed, lamp):
    """By rays past every face, for Gaussians that the light falls on and that no edge of a shadow is near."""
    corners_m, places_m, normal = posed
    renderer = lit_by(SceneLight(DIM, (lamp,)))
    assert plan_of(renderer.render([FIST], view())).runs(Effect.SHARP_SHADOW)
    seen = skin_seen(renderer)
    chosen = np.random.default_rng(1).permutation(len(places_m))[:1500]
    to_lamp = TO_SUN if lamp.kind is LampKind.SUN else np.array(lamp.place_m) - places_m[chosen]
    to_lamp = np.broadcast_to(to_lamp, (len(chosen), 3)) / np.linalg.norm(to_lamp, axis=-1, keepdims=True)
    lit = (normal[chosen] * to_lamp).sum(1) > 0.4
    chosen, to_lamp = chosen[lit], to_lamp[lit]
    clear = (seen[chosen] < 0.05) | (seen[chosen] > 0.95)
    chosen, to_lamp = chosen[clear], to_lamp[clear]
    hidden = np.concatenate(
        [hidden_by_faces(corners_m, places_m[[row]], way) for row, way in zip(chosen, to_lamp, strict=True)]
    )
    assert len(chosen) > 300
    assert 0.1 < hidden.mean() < 0.9
    assert (hidden == (seen[chosen] < 0.5)).mean() > 0.97


def facing(posed) -> np.ndarray:
    """(N,) whether the sun falls on a Gaussian well."""
    return posed[2] @ TO_SUN > 0.4


def test_edges_are_as_wide_as_the_lamp_makes_them(posed):
    """Skin that is in part in the shadow grows with the lamp."""
    parts = []
    for radius_m in (0.0, 0.035, 0.068):
        seen = seen_in(point(0.5, radius_m))[facing(posed)]
        parts.append(float(((seen > 0.1) & (seen < 0.9)).mean()))
    assert parts[0] < 0.8 * parts[1] < 0.8 * 0.8 * parts[2], parts


def test_skin_that_sees_all_of_a_wide_lamp_is_not_darkened_by_its_own_slope(posed):
    """And none of it reaches skin that sees nothing of it: by rays to its middle and its rim."""
    corners_m, places_m, _ = posed
    lamp = point(0.5, 0.068)
    seen = seen_in(lamp)
    chosen = np.flatnonzero(facing(posed))[::4]
    across = np.cross(TO_SUN, [[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
    on_lamp_m = lamp.place_m + np.vstack([[0.0, 0, 0], 0.068 * across / np.linalg.norm(across, axis=1, keepdims=True)])
    hidden = np.array(
        [[hidden_by_faces(corners_m, places_m[[row]], to - places_m[row])[0] for to in on_lamp_m] for row in chosen]
    )
    whole, none = seen[chosen][~hidden.any(1)], seen[chosen][hidden.all(1)]
    assert min(len(whole), len(none)) > 30
    assert np.percentile(whole, 5) > 0.9
    assert none.mean() < 0.1


def test_a_far_point_is_a_sun():
    pictures = [drawn(lamp).rgba for lamp in (SUN, point(30.0))]
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.002 * pictures[0].mean()


def test_a_hand_of_another_size_in_a_scene_of_that_size_looks_the_same():
    def at_size(times: float) -> np.ndarray:
        lamp = point(0.5)
        rgb = tuple((times**2 * np.array(lamp.rgb)).tolist())
        place_m = tuple((times * np.array(lamp.place_m)).tolist())
        return drawn(replace(lamp, rgb=rgb, place_m=place_m, radius_m=times * 0.01), joints_m=times * FIST).rgba

    usual, large = at_size(1.0), at_size(6.0)
    assert np.abs(usual - large).mean() < 0.004 * usual.mean()


def test_a_hand_before_the_lamp_hides_it_from_the_other(posed):
    """Where capsules of a hand farther than 30 cm are not asked."""
    renderer = SceneRenderer([AVATAR, AVATAR], FINAL, SceneLight(DIM, (SUN,)))
    renderer.render([FIST, FIST + 0.6 * TO_SUN], FROM_AFAR)
    behind, before, alone = (
        one[facing(posed)].mean() for one in (skin_seen(renderer, 0), skin_seen(renderer, 1), seen_in(SUN))
    )
    assert behind < 0.1 * alone
    assert np.isclose(before, alone, rtol=0.05)


def test_a_lamp_takes_no_picture_for_a_hand_that_it_does_not_light():
    for lamp, wanted in ((SUN, [1, 1]), (replace(SUN, hands=(1,)), [0, 1])):
        renderer = SceneRenderer([AVATAR, AVATAR], FINAL, SceneLight(DIM, (lamp,)))
        frame = renderer.render([FIST, FIST + 0.6 * TO_SUN], FROM_AFAR)
        assert [weights_of(frame, hand) for hand in (0, 1)] == [(weight,) for weight in wanted]


def test_a_lamp_that_lights_only_a_hand_out_of_the_picture_is_not_called_for():
    for lamp, runs in ((SUN, True), (replace(SUN, hands=(1,)), False)):
        renderer = SceneRenderer([AVATAR, AVATAR], FINAL, SceneLight(DIM, (lamp,)))
        assert plan_of(renderer.render([FIST, FIST + np.array([9.0, 0, 0])], view())).runs(Effect.LAMPS) == runs


def weights_of(frame: Frame, hand: int = 0) -> tuple[float, ...]:
    """Per lamp how much of a picture counts."""
    return plan_of(frame).sharp[hand].weights if plan_of(frame).sharp else ()


def test_a_lamp_that_comes_near_fades_to_capsules():
    """No step changes much where its picture begins to see too little, and inside the hand's ball there is none."""
    ball = HandFacts(AVATAR).ball(AVATAR.skeleton().bones(FIST))
    assert ball is not None
    frames = []
    for radii in np.linspace(APART_LEAST - 0.1, APART_WHOLE + 0.1, 14):
        place_m = ball.middle_m + radii * ball.radius_m * TO_SUN
        frames.append(drawn(replace(point(0.3), place_m=tuple(place_m), radius_m=0.0005)))
    weights = [weights_of(frame)[0] if weights_of(frame) else 0.0 for frame in frames]
    assert weights[:2] == [0.0, 0.0]
    assert weights[-2:] == [1.0, 1.0]
    assert np.diff(weights).min() >= 0
    pictures = [frame.rgba for frame in frames]
    steps = [np.abs(b - a).mean() / a.mean() for a, b in pairwise(pictures)]
    assert max(steps) < 2 * np.median(steps)


def test_large_faint_and_shadowless_lamps_have_edges_of_capsules():
    far = point(1.0)
    large, faint = replace(far, radius_m=0.5), replace(far, rgb=(0.01, 0.01, 0.01))
    assert weights_of(drawn(SUN, faint, large)) == (1.0, 0.0, 0.0)
    reason = plan_of(drawn(SUN, faint, large))[Effect.SHARP_SHADOW].reason
    assert reason.endswith(", 1 lamp too large, too near or too faint")
    assert plan_of(drawn(large))[Effect.SHARP_SHADOW].reason == "lamps are too large, too near or too faint"
    assert plan_of(drawn(replace(SUN, has_shadow=False)))[Effect.SHARP_SHADOW].reason == "no lamp casts a shadow"


def test_who_asks_for_less_gets_capsules_and_is_told_why():
    cases = {
        "presets final and reference ask for it": (preset("viewport"), AVATAR),
        "not among the chosen effects": (replace(FINAL, effects=Choice.parse("lamp-shadow,detail")), AVATAR),
        "a hand has no surface": (FINAL, trained_avatar(500)),
    }
    for why, (settings, avatar) in cases.items():
        frame = SceneRenderer([avatar], settings, SceneLight(DIM, (SUN,))).render([FIST], view())
        assert plan_of(frame)[Effect.SHARP_SHADOW].reason == why
        assert "lamp pictures" not in frame.report.stages


def test_a_hand_that_comes_into_the_image_leaves_the_edges_on_the_other_as_they_are():
    """And one that leaves it: bits of an animation do not depend on what was drawn before."""
    joints_m = [FIST, FIST + np.array([0.8, 0.0, 0.1])]
    light, settings = SceneLight(DIM, (SUN, point(0.35))), replace(FINAL, repeatable=True)
    both, one = (
        Camera.looking_at((x_m, 0, 1.2), (x_m, MIDDLE_M[1], 0), (0, 1, 0), width=260, height=260, focal_px=focal_px)
        for x_m, focal_px in ((0.4, 180), (0.0, 500))
    )
    renderer = SceneRenderer([AVATAR, AVATAR], settings, light)
    frames = [renderer.render(joints_m, camera) for camera in (one, both, one)]
    assert [plan_of(frame).seen for frame in frames] == [(True, False), (True, True), (True, False)]
    assert len({weights_of(frame) for frame in frames}) == 1
    assert np.array_equal(frames[0].rgba, frames[2].rgba)
    fresh = SceneRenderer([AVATAR, AVATAR], settings, light).render(joints_m, both)
    assert np.array_equal(frames[1].rgba, fresh.rgba)


def test_light_does_not_come_in_at_the_wrist_of_a_hand_without_its_forearm():
    """The surface is open there: it is drawn from within, too. Light comes up the arm, and the arm hides some."""
    lamp, parts = Lamp(LampKind.SUN, WHITE, tuple(FIST[0] - FIST[9]), angle_rad=0.002), []
    for avatar in (AVATAR, ended(AVATAR, forearm=False)):
        fingers = avatar.bone_weights[:, 5:].sum(1) > 0.9
        parts.append(float(seen_in(lamp, avatar)[fingers].mean()))
    assert parts[1] < parts[0] + 0.08


@pytest.mark.parametrize("handedness", Handedness)
def test_a_hand_of_either_side_has_the_shadows_of_its_mirror_image(handedness):
    avatar = AVATAR.for_hand(handedness)
    mirror = np.array([1.0 if handedness is Handedness.RIGHT else -1.0, 1, 1])
    lamp = replace(SUN, place_m=tuple(TO_SUN * mirror))
    renderer = SceneRenderer([avatar], FINAL, SceneLight(DIM, (lamp,)))
    camera = framing_camera((FIST * mirror)[None], handedness, "front", width=240, height=300)
    renderer.render([FIST * mirror], camera)
    assert np.abs(skin_seen(renderer) - seen_in(SUN)).mean() < 0.01


def test_hands_without_size_or_outside_the_image_are_no_hard_cases():
    everything = replace(FINAL, effects=Choice.parse("all"))
    assert np.isfinite(drawn(SUN, point(0.5), joints_m=np.full((21, 3), 0.1) + 1e-12 * FIST).rgba).all()
    for lamp in (SUN, point(0.5), point(0.0)):
        renderer = lit_by(SceneLight(DIM, (lamp,)), everything)
        assert np.isfinite(renderer.render([np.zeros((21, 3))], view()).rgba).all()
        assert not renderer.render([FIST + np.array([3.0, 0, 0])], view()).rgba.any()


def test_light_begins_softly_at_an_edge_that_is_wider_than_pictures_are_searched():
    """That of a hand far before another: skin that sees most of the sun is about as common as skin that sees little."""
    seen = []
    renderer = SceneRenderer([AVATAR, AVATAR], FINAL, SceneLight(DIM, (replace(SUN, angle_rad=0.2),)))
    for aside_m in np.linspace(-0.05, 0.05, 5):
        renderer.render([FIST, FIST + 0.6 * TO_SUN + np.array([aside_m, -aside_m, 0])], FROM_AFAR)
        seen.append(skin_seen(renderer, 0))
    seen = np.concatenate(seen)
    most, little = ((seen > 0.75) & (seen < 0.995)).sum(), ((seen > 0.005) & (seen < 0.25)).sum()
    assert little > 500
    assert most > 0.45 * little


def test_a_large_picture_with_finer_faces_leaves_the_next_shadows_as_they_are():
    light, pose = SceneLight(DIM, (SUN,)), [FIST]
    renderer = SceneRenderer([AVATAR], FINAL, light)
    renderer.render(pose, view().scaled(4))
    assert renderer._backend._detail is not None
    assert renderer._backend._detail._hands[0]._fine is not None
    other = [FIST @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])]
    renderer.render(other, view())
    assert np.array_equal(
        renderer.render(pose, view()).rgba, SceneRenderer([AVATAR], FINAL, light).render(pose, view()).rgba
    )


def test_a_lamp_that_is_dragged_takes_its_picture_anew_and_one_that_stays_does_not():
    renderer = SceneRenderer([AVATAR], FINAL, SceneLight(DIM, (SUN,)))
    renderer.render([FIST], view())
    moved = SceneLight(DIM, (replace(SUN, place_m=(0.5, 0.9, 0.6)),))
    renderer.light = moved
    dragged = renderer.render([FIST], view())
    assert {"lamp pictures", "light"} <= set(dragged.report.stages)
    fresh = SceneRenderer([AVATAR], FINAL, moved).render([FIST], view())
    assert np.array_equal(dragged.rgba, fresh.rgba)
    again = renderer.render([FIST], view())
    assert "lamp pictures" not in again.report.stages
    assert np.array_equal(again.rgba, fresh.rgba)


# ---- at pixels ------------------------------------------------------------------------------------------------------

LARGE = view().scaled(2.5)


def large(*lamps: Lamp, camera: Camera = LARGE, shades: Shades | None = None) -> np.ndarray:
    """(H, W, 4) the fist in the light of lamps alone, so large that shadows are found at pixels."""
    return lit_by(SceneLight(None, lamps, shades)).render([FIST], camera).rgba


@pytest.fixture
def at_gaussians(monkeypatch):
    """The same as `large`, with shadows that are found at Gaussians."""

    def draw(*lamps: Lamp, **how) -> np.ndarray:
        with monkeypatch.context() as patched:
            patched.setattr(light_effects, "PIXEL_LIGHT", np.inf)
            return large(*lamps, **how)

    return draw


PARALLEL = replace(LARGE, fx=2500.0, fy=2500.0, orthographic=True)


@pytest.mark.parametrize(
    ("lamp", "camera"),
    [(SUN, LARGE), (SUN, PARALLEL), (point(0.4), LARGE), (point(20.0), LARGE)],
    ids=["sun", "parallel rays", "near point", "far point"],
)
def test_shadows_at_pixels_are_where_faces_stand_before_a_lamp(posed, at_gaussians, lamp, camera):
    """By rays past every face, from the surface at each pixel, and much better than at Gaussians."""
    corners_m, _, _ = posed
    detail = NativeDetail(library.load(), [DetailedHand.of(AVATAR, 1.0)])
    detail.pose([AVATAR.skeleton().bones(FIST)], [np.zeros(3)])
    face, depth_m = detail.hits(camera.about(FIST[0]))
    normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    open_sky = large(replace(lamp, has_shadow=False), camera=camera)[..., :3].sum(-1)
    seen, before = (
        draw(lamp, camera=camera)[..., :3].sum(-1) / np.maximum(open_sky, 1e-6) for draw in (large, at_gaussians)
    )
    lit = (face >= 0) & (open_sky > 0.2) & (normal[face] @ TO_SUN > 0.4)
    rows, columns = np.nonzero(lit)
    chosen = np.random.default_rng(2).permutation(len(rows))[:750]
    rows, columns = rows[chosen], columns[chosen]
    over = depth_m[rows, columns]
    flat = over if not camera.orthographic else np.ones(len(over))
    across = ((columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy)
    in_camera_m = np.stack([flat * across[0], flat * across[1], over], 1)
    places_m = (in_camera_m - camera.camera_from_world[:3, 3]) @ camera.camera_from_world[:3, :3]
    ways = np.broadcast_to(TO_SUN, places_m.shape)
    if lamp.kind is LampKind.POINT:
        ways = np.array(lamp.place_m) - places_m
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    hidden = np.concatenate(
        [hidden_by_faces(corners_m, place_m[None], way) for place_m, way in zip(places_m, ways, strict=True)]
    )
    seen, before = seen[rows, columns], before[rows, columns]
    assert 0.05 < hidden.mean() < 0.9
    wrong, wrong_before = ((hidden != (of < 0.5)).mean() for of in (seen, before))
    assert wrong < 0.03
    assert wrong < 0.7 * wrong_before


@pytest.fixture
def shadows_alone(soft_fingers):
    """What differs at edges of fingers is none of a shadow's."""
    _made.cache_clear()  # renderers keep their last image
    yield
    _made.cache_clear()


@pytest.mark.usefixtures("shadows_alone")
def test_an_image_does_not_depend_on_where_tiles_begin():
    """Of the kernel that shadows pixels, and of vectors of sixteen of them."""
    picture = large(SUN)
    for right, down in ((1, 0), (8, 0), (0, 1), (16, 5)):
        camera = replace(LARGE, cx=LARGE.cx + right, cy=LARGE.cy + down)
        moved = large(SUN, camera=camera)[down:, right:]
        apart = np.abs(moved - picture[: moved.shape[0], : moved.shape[1]])
        assert (apart > 0.01).sum() <= 3
        assert apart.mean() < 1e-5


def test_skin_that_sees_all_of_a_lamp_has_the_colors_that_it_has_without_shadows():
    """In each channel."""
    colored = replace(SUN, rgb=(3.0, 1.5, 0.5))
    shaded, whole = large(colored)[..., :3], large(replace(colored, has_shadow=False))[..., :3]
    reached = shaded.sum(-1) > 0.97 * whole.sum(-1)
    reached &= whole.sum(-1) > 0.2
    assert reached.sum() > 10_000
    assert np.abs(shaded - whole)[reached].max() < 0.05 * whole.max()


@pytest.mark.usefixtures("shadows_alone")
def test_a_shadow_of_things_is_at_pixels_that_of_gaussians_where_the_hand_throws_none(at_gaussians):
    """With an edge across the fist, beyond which a twentieth of the sun is left."""
    assert AVATAR.learned is not None
    assert AVATAR.learned.cast is not None
    across_m = AVATAR.learned.cast.anchors.position_m[:, 0]
    shades = Shades((np.where(across_m > np.median(across_m), 1.0, 0.05)[None].astype(np.float32),))
    open_sky = large(replace(SUN, has_shadow=False))[..., :3].sum(-1)
    drawn = [(draw(SUN), draw(SUN, shades=shades)) for draw in (large, at_gaussians)]
    (whole, part), (whole_before, part_before) = [[each[..., :3].sum(-1) for each in pair] for pair in drawn]
    reached = (np.minimum(whole, whole_before) > 0.995 * open_sky) & (open_sky > 0.2)
    left = part[reached] / whole[reached]
    assert (left < 0.06).sum() > 2000
    assert (left > 0.99).sum() > 2000
    # worst observed 0.0009, of colors up to 1.5
    assert np.abs(part - part_before)[reached].max() < 0.001


@pytest.mark.usefixtures("shadows_alone")
def test_a_thing_that_takes_as_much_everywhere_leaves_edges_of_the_hands_own_shadow_as_they_are():
    assert AVATAR.learned is not None
    assert AVATAR.learned.cast is not None
    shades = Shades((np.full((1, len(AVATAR.learned.cast.anchors.position_m)), 0.2, np.float32),))
    # worst observed 3.4e-6
    np.testing.assert_allclose(large(SUN, shades=shades)[..., :3], 0.2 * large(SUN)[..., :3], atol=5e-6)


def test_light_on_a_hand_stays_where_one_without_a_picture_of_the_lamp_is_behind(monkeypatch):
    """Its Gaussians reach beyond its surface, onto that of the other."""
    frames, light = [], SceneLight(None, (SUN,))
    behind = FIST - np.array([0.06, 0.0, 0.1])
    for of_behind in (1.0, 1e-6, 0.0):
        left = iter((1.0, of_behind))
        monkeypatch.setattr(light_effects, "_suits_picture", lambda *_, left=left: np.array([next(left)]))
        frames.append(SceneRenderer([AVATAR, AVATAR], FINAL, light).render([FIST, behind], LARGE).rgba)
    assert np.abs(frames[0] - frames[1]).max() > 0.05
    # capsules shade the one behind: near the first, nothing of it differs
    assert np.abs(frames[1] - frames[2]).max() < 0.01


def test_no_more_lamps_have_layers_than_there_are_and_none_is_switched():
    shares = np.linspace(0.5, 0.2, 12)
    for swapped in np.linspace(-0.05, 0.05, 11):
        # the ninth overtakes the eighth
        shares[8] = shares[7] + swapped
        limit = light_effects._pixel_light([shares, np.zeros(12)])
        parts = fade(shares, limit)
        assert np.count_nonzero(parts) <= LAYERS_MAX
        assert parts[7:9].max() <= abs(swapped) / 0.2
    assert light_effects._pixel_light([shares[:8]]) == light_effects.PIXEL_LIGHT


def test_light_apart_and_the_rest_are_the_colors_that_gaussians_have(monkeypatch):
    """As far as it reaches them."""
    colors = []
    for limit in (np.inf, light_effects.PIXEL_LIGHT):
        monkeypatch.setattr(light_effects, "PIXEL_LIGHT", limit)
        renderer = SceneRenderer([AVATAR], FINAL, SceneLight(DIM, (SUN, point(0.5))))
        frame = renderer.render([FIST], LARGE)
        backend = renderer._backend
        layers = backend._layer_rows[: len(backend._layers)]
        assert len(layers) == 2 * (limit < np.inf), plan_of(frame).sharp
        assert not layers.size or layers[..., 3].max() > 0.5
        colors.append(backend._gaussians.rgb.sum(1) + layers[..., 3].sum(0))
    assert np.allclose(colors[0], colors[1], atol=1e-5)


def test_half_of_it_at_pixels_is_the_mean_of_all_and_none(at_gaussians, monkeypatch):
    """So what fades in between does not pop."""
    whole, none = large(SUN), at_gaussians(SUN)
    monkeypatch.setattr(light_effects, "PIXEL_LIGHT", 1 / 1.5)
    half = large(SUN)
    assert np.abs(whole - none).max() > 0.2
    assert np.abs(half - (whole + none) / 2).max() < 0.002


@pytest.mark.usefixtures("shadows_alone")
def test_edges_of_shadows_are_as_wide_as_pixels():
    """What finer pixels show in the mean: skin that light grazes has an edge within one."""
    grazing, finer = replace(SUN, place_m=(0.8, 0.5, 0.3)), 3
    fine, whole = large(grazing, camera=LARGE.scaled(finer)), large(grazing)
    mean = fine.reshape(LARGE.height, finer, LARGE.width, finer, 4).mean((1, 3))
    # outlines are wider than a pixel. Observed: 9
    within = (whole[..., 3] > 0.999) & (mean[..., 3] > 0.999)
    assert (np.abs(whole - mean)[within, :3].max(-1) > 0.05).sum() < 20


def test_lights_of_several_lamps_add_up_at_pixels():
    """Each has a picture of its own, and a layer."""
    other = replace(point(0.6), place_m=(-0.3, 0.4, 0.5))
    both = large(SUN, other)[..., :3]
    assert np.abs(both - large(SUN)[..., :3] - large(other)[..., :3]).mean() < 0.002 * both.mean()


def test_they_fade_in_as_a_hand_grows_and_with_its_light():
    parts = []
    for times in np.linspace(0.3, 2.5, 12):
        plan = plan_of(lit_by(SceneLight(DIM, (SUN,))).render([FIST], view().scaled(times)))
        parts.append(plan.sharp[0].at_pixels[0])
    assert parts[0] == 0
    assert parts[-1] == 1
    assert np.diff(parts).min() >= 0
    faint = replace(SUN, rgb=(0.2, 0.2, 0.2), place_m=(-0.5, 0.4, 0.8))
    sharp = plan_of(lit_by(SceneLight(DIM, (SUN, faint))).render([FIST], LARGE)).sharp[0]
    assert (sharp.weights, sharp.at_pixels) == ((1.0, 1.0), (1.0, 0.0))


def test_a_camera_that_comes_nearer_to_a_pose_lights_it_anew_where_it_has_to():
    light = SceneLight(DIM, (SUN,))
    renderer = SceneRenderer([AVATAR], FINAL, light)
    small = renderer.render([FIST], view().scaled(0.3)).rgba
    near = renderer.render([FIST], LARGE)
    assert np.array_equal(near.rgba, SceneRenderer([AVATAR], FINAL, light).render([FIST], LARGE).rgba)
    turned = replace(LARGE, fx=LARGE.fx * 1.1, fy=LARGE.fy * 1.1)
    assert plan_of(near).runs(Effect.LAMPS)
    assert plan_of(near).runs(Effect.SHARP_SHADOW)
    closer = renderer.render([FIST], turned)
    assert "light" not in closer.report.stages
    assert not plan_of(closer).runs(Effect.LAMPS)
    assert plan_of(closer).runs(Effect.SHARP_SHADOW)
    assert np.array_equal(closer.rgba, SceneRenderer([AVATAR], FINAL, light).render([FIST], turned).rgba)
    assert np.array_equal(renderer.render([FIST], view().scaled(0.3)).rgba, small)


@pytest.mark.parametrize(("aside_m", "width"), [(0.25, 900), (-1.4, 2600)], ids=["near", "far"])
def test_each_hand_asks_its_own_pictures_and_threads_agree(aside_m, width):
    """Two hands look as each alone, also where a lamp gives one of them hardly any light; bits are those of one
    thread."""
    small = replace(point(0.3), rgb=tuple(0.3 * np.array(point(0.3).rgb)))
    joints_m, light = [FIST, FIST + np.array([aside_m, 0.0, 0.05])], SceneLight(None, (SUN, small))
    middle_m = MIDDLE_M + np.array([aside_m / 2, 0, 0])
    eye_m = middle_m + np.array([0, 0, 0.6])
    camera = Camera.looking_at(eye_m, middle_m, (0, 1, 0), width=width, height=500, focal_px=900)
    frame, other = (
        SceneRenderer([AVATAR, AVATAR], replace(FINAL, threads=threads), light).render(joints_m, camera)
        for threads in (1, 2)
    )
    one, two = frame.rgba, other.rgba
    assert np.array_equal(one, two)
    assert (weights_of(frame, 1)[1] > 0) == (aside_m > 0)
    alone = np.sum([SceneRenderer([AVATAR], FINAL, light).render([hand], camera).rgba for hand in joints_m], 0)
    assert np.abs(one - alone).mean() < 0.01 * alone.mean()


def test_a_left_hand_has_the_picture_of_its_mirror_image():
    mirror = np.array([-1.0, 1, 1])
    camera = framing_camera((FIST * mirror)[None], Handedness.LEFT, "front", width=240, height=300).scaled(2.5)
    light = SceneLight(None, (replace(SUN, place_m=tuple(TO_SUN * mirror)),))
    left = SceneRenderer([AVATAR.for_hand(Handedness.LEFT)], FINAL, light).render([FIST * mirror], camera).rgba
    right = large(SUN)
    assert np.abs(left[:, ::-1] - right).mean() < 0.02 * right.mean()


def test_a_card_that_draws_no_layers_leaves_shadows_at_gaussians():
    renderer = SceneRenderer([AVATAR], FINAL, SceneLight(DIM, (SUN,)))
    renderer._backend.draws_layers = False
    plan = plan_of(renderer.render([FIST], LARGE))
    assert plan.sharp[0].at_pixels == (0.0,)
    assert plan[Effect.SHARP_SHADOW].reason == "of 1 lamp"
