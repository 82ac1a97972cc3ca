"""Relief: skin whose slope turns away from a lamp is darker, and follows the joints as they bend."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from detail_reference import bilinear, posed_surface
from detail_samples import detail_of, flat

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import padded_rows
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.posing import LightAround, Poser
from jghand_engine.avatar.relief import HEIGHT_STEP_M, Bend, Relief, finger_shares
from jghand_engine.avatar.relighting import in_studio
from jghand_engine.avatar.scene_light import WORLD_FLOOR, Baked, Lamp, SceneLight, World, soft_cosine
from jghand_engine.avatar.scene_light_step import BLACK
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.learn import scene_light as torch_light
from jghand_engine.learn.light import harmonics, unit
from jghand_engine.native import library as native_library
from jghand_engine.native.scene_light_task import NUMBER, LampKind
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import DetailedHand, SurfaceHits
from jghand_engine.render.effect_plan import Choice
from jghand_engine.render.renderer import Frame, HandRenderer, SceneRenderer
from jghand_engine.render.settings import RenderSettings, ShadowMode

DRAWN = RenderSettings(shadow=ShadowMode.OFF, antialias=False, threads=2, effects=Choice.parse("all"))
TEXELS = 64
# native/detail.cpp, scene_light.cpp
LEAST, MOST, GRAZED, LIT_MIN = 0.4, 2.5, 0.1, 1e-9


def heights(kind: str) -> np.ndarray:
    """(S, S, 2) of bumps of chance, a fifth as high where joints are bent; or one height everywhere."""
    if kind == "even":
        return np.full((TEXELS, TEXELS, 2), 100, np.int8)
    straight = np.random.default_rng(0).integers(-100, 101, (TEXELS, TEXELS))
    return np.stack([straight, straight // 5], -1).astype(np.int8)


@cache
def hand(kind: str = "", handedness: Handedness = Handedness.RIGHT, log_ratio: float = 0.0) -> HandAvatar:
    """The built-in hand with other detail: a relief, or one ratio everywhere. Its skin throws no light onto skin: the
    specification below knows lamps alone."""
    avatar = load_builtin(handedness=handedness)
    detail = replace(detail_of(flat(TEXELS, log_ratio)), depth_m=avatar.detail.depth_m)
    response = replace(avatar.learned.response, bounce=np.zeros(3, np.float32))
    relief = Relief(heights(kind)) if kind else None
    learned = replace(avatar.learned, response=response)
    return replace(avatar, learned=learned, detail=replace(detail, relief=relief))


def pose(name: str, handedness: Handedness = Handedness.RIGHT) -> np.ndarray:
    return named_pose(name, hand().rest_joints_m, handedness=handedness)


def camera(*, orthographic: bool = False) -> Camera:
    """Of the palm, a texel of which is larger than a pixel."""
    seen = Camera.looking_at((0.05, 0.09, 0.5), (0.0, 0.09, 0.0), (0, 1, 0), width=120, height=140, focal_px=300.0)
    return replace(seen, fx=600.0, fy=620.0, orthographic=True) if orthographic else seen


def sun(*towards: float, on_gloss: bool = False) -> SceneLight:
    return SceneLight(lamps=(Lamp(LampKind.SUN, (3.0, 3.0, 3.0), towards, has_shadow=False, on_gloss=on_gloss),))


def drawn(avatar: HandAvatar, light: SceneLight | None, name: str = "open", seen: Camera | None = None) -> Frame:
    return HandRenderer(avatar, DRAWN, light).render(pose(name, avatar.handedness), seen or camera())


def ratio(kind: str, light: SceneLight | None, name: str = "open", handedness=Handedness.RIGHT, seen=None):
    """(H, W) what the relief makes of the green, 1 where there is little of it, and whether there is enough."""
    with_relief, without = (drawn(hand(one, handedness), light, name, seen).rgba for one in (kind, ""))
    bright = (without[..., 3] > 0.9) & (without[..., 1] > 0.05)
    return np.where(bright, with_relief[..., 1] / np.where(bright, without[..., 1], 1), 1), bright


# ---- the specification -----------------------------------------------------------------------------------------------


def wanted(handedness: Handedness, name: str, seen: Camera, towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) by how much light changes, in float64, and where there is a surface."""
    avatar, joints_m = hand("bumps", handedness), pose(name, handedness)
    detail, bones = avatar.detail, avatar.skeleton().bones(joints_m)
    face, _ = SurfaceHits(native_library.load(), DetailedHand.of(avatar, 1.0))(bones, seen)
    points_m, scale = posed_surface(avatar, joints_m)
    points_m = points_m @ seen.camera_from_world[:3, :3].T + seen.camera_from_world[:3, 3]
    weights = avatar.map_weights(detail.position_m, detail.bone_weights).astype(np.float64)
    maps = np.einsum("vb,bij->vij", weights, bones.linear_offset)[..., :3]
    normal = np.einsum("vij,vj->vi", maps, detail.normals)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    corner = max(float(avatar.learned.response.softness[1]), 0.02)
    cosine = normal @ (towards / np.linalg.norm(towards))
    falls = ((cosine + corner) / (2 * corner)).clip(0, 1) / np.maximum(soft_cosine(cosine, np.array(corner)), GRAZED)
    slope = falls[:, None] * (towards / np.linalg.norm(towards))
    along = (slope * normal).sum(1)
    slope = slope @ seen.camera_from_world[:3, :3].T
    bend = Bend(detail.position_m, finger_shares(detail.bone_weights), avatar.canonical_joints_m)
    bent = bend.near @ bend.of_joints(joints_m[None])[0]

    pixels = (points_m[:, :2] / (1 if seen.orthographic else points_m[:, 2:])) * (seen.fx, seen.fy) + (seen.cx, seen.cy)
    near = -points_m[:, 2] if seen.orthographic else 1 / points_m[:, 2]
    row, column = np.nonzero(face >= 0)
    corners = detail.faces[face[row, column]]
    first, *others = (pixels[corners[:, k]] for k in range(3))
    sides = np.stack([other - first for other in others], -1)
    shares = np.linalg.solve(sides, (np.stack([column, row], -1) + 0.5 - first)[..., None])[..., 0]
    affine = np.concatenate([1 - shares.sum(1, keepdims=True), shares], 1)
    weight = affine if seen.orthographic else affine * near[corners]
    weight /= weight.sum(1, keepdims=True)
    xy = np.stack([detail.face_uv[..., 0], 1 - detail.face_uv[..., 1]], -1).astype(np.float64)[face[row, column]]
    place = np.einsum("pk,pki->pi", weight, xy)

    # how much column and row of the texture grow per meter along the skin
    edges, steps = (np.stack([at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]], 1) for at in (points_m[corners], xy))
    grown = np.linalg.inv(edges @ edges.swapaxes(1, 2)) @ steps
    gradients = np.einsum("pke,pki->pei", grown, edges)
    slopes = detail.slopes
    levels = slopes.texels[: TEXELS**2].view(np.int8).reshape(TEXELS // 4, TEXELS // 4, 4, 4, 4)
    rises = bilinear(levels.swapaxes(1, 2).reshape(TEXELS, TEXELS, 4) * slopes.step_m * scale, place[None])[0]
    amount = (affine * bent[corners]).sum(1)[:, None]
    rise = (1 - amount) * rises[:, :2] + amount * rises[:, 2:]
    tilt = np.einsum("pe,pei->pi", rise, gradients)
    slope_there, along_there = np.einsum("pk,pki->pi", affine, slope[corners]), (affine * along[corners]).sum(1)
    steep = np.sqrt(1 + (tilt**2).sum(1))
    light = np.ones(face.shape)
    light[row, column] = 1 - along_there + (along_there - (slope_there * tilt).sum(1)) / steep
    return light.clip(LEAST, MOST), face >= 0


@pytest.mark.parametrize("handedness", list(Handedness))
@pytest.mark.parametrize(("name", "orthographic"), [("open", False), ("fist", True)])
def test_the_kernel_makes_of_light_what_the_specification_says(handedness, name, orthographic):
    seen, towards = camera(orthographic=orthographic), np.array([-0.5, 0.3, 0.8])
    came, bright = ratio("bumps", sun(*towards), name, handedness, seen)
    light, hit = wanted(handedness, name, seen, towards)
    # how strongly detail shows at each pixel, from one ratio everywhere
    doubled, plain = (drawn(hand("", handedness, of), sun(*towards), name, seen).rgba[..., 1] for of in (0.5, 0.0))
    strength = np.log(doubled / np.where(bright, plain, 1), where=bright, out=np.zeros(hit.shape))
    strength /= strength.max()
    looked_at = bright & hit & (strength > 0.2)
    assert looked_at.sum() > 1000
    error = np.abs(came - 1 - strength * (light - 1))[looked_at]
    # observed: 2e-5; 99 of 100 below 5e-3, the others on faces that are seen along their surface
    assert np.median(error) < 4e-5
    assert np.percentile(error, 99) < 0.01
    assert light[looked_at].std() > 0.02


def test_what_is_mirrored_changes_with_the_slope_and_is_white():
    (matt, rough), (plain, glossy) = (
        [drawn(hand(kind), sun(0.1, 0.25, 0.9, on_gloss=on_gloss)).rgba for kind in ("", "bumps")]
        for on_gloss in (False, True)
    )
    mirrored, looked_at = plain - matt, (plain[..., 3] > 0.99) & (plain[..., 1] > 0.05)
    change = (glossy - rough - mirrored * (rough / np.where(looked_at[..., None], matt, 1)))[looked_at][:, :3]
    assert looked_at.sum() > 1000
    # what the relief makes of matt skin has the skin's color, what is added to it has none
    assert np.abs(change - change.mean(1, keepdims=True)).max() < 0.1 * np.abs(change).max()
    # by a third of what smooth skin mirrors, and more, both ways
    share = change[:, 1] / mirrored[looked_at][:, 1].mean()
    assert np.percentile(share, 5) < -0.3
    assert np.percentile(share, 95) > 0.3


def test_dark_lines_in_the_gloss_of_dark_skin_are_black_at_most():
    avatar = hand("bumps", log_ratio=-math.log(2))
    response = avatar.learned.response
    glossy = replace(response, roughness=np.full_like(response.roughness, 0.3))
    dark = replace(avatar, rgb=0.1 * avatar.rgb, learned=replace(avatar.learned, response=glossy))
    assert drawn(dark, sun(0.1, 0.25, 0.9, on_gloss=True)).rgba.min() > -1e-6


@pytest.mark.parametrize("variant", native_library.runnable_variants())
def test_every_kernel_and_any_number_of_threads_draws_the_same_relief(variant):
    light = sun(0.5, 0.3, 0.8)
    one, two = (
        HandRenderer(hand("bumps"), replace(DRAWN, backend=variant, threads=threads), light)
        .render(pose("open"), camera())
        .rgba
        for threads in (1, 2)
    )
    assert np.array_equal(one, two)
    assert np.abs(one - drawn(hand("bumps"), light).rgba).max() < 1e-3


# ---- how light turns with skin ---------------------------------------------------------------------------------------

# lamps of all kinds, which show skin of all slopes
LAMPS = (
    Lamp(LampKind.SUN, (3, 2, 1), (0.2, 0.5, 1), angle_rad=0.1, has_shadow=False),
    Lamp(LampKind.POINT, (0.05, 0.2, 0.1), (0.1, 0.15, 0.1), radius_m=0.03, has_shadow=False),
    Lamp(LampKind.SPOT, (0.3, 0.2, 0.4), (0, 0.1, -0.3), (0, 0, 1), cone_rad=0.9, blend=0.4, has_shadow=False),
    Lamp(LampKind.AREA, (2, 3, 4), (0.2, 0.5, -0.2), (-0.2, -1, 0.4), size_m=(0.3, 0.2), has_shadow=False),
    Lamp(LampKind.SUN, (1, 1, 1), (0, 0, -1), has_shadow=False, on_matt=False),
)
COLORS = World(np.random.default_rng(0).random((16, 32, 3)) ** 4 * [3, 2, 1])
LIGHTS = {
    "its own": None,
    "a world": SceneLight(COLORS),
    "lamps": SceneLight(None, LAMPS),
    "lamps behind each other and a world": SceneLight(COLORS, tuple(replace(lamp, has_shadow=True) for lamp in LAMPS)),
}


def luminance(rgb: np.ndarray | torch.Tensor) -> torch.Tensor:
    """(...) of colors (..., 3)."""
    return torch.as_tensor(rgb).double() @ torch.tensor([0.2126, 0.7152, 0.0722]).double()


def slope_of_world(of_world: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
    """(V, 3) along the skin: what comes from all around has no more of it along the normal."""
    (slope,) = torch.autograd.grad(of_world.sum(), normal)
    return slope - (slope * normal).sum(1, keepdim=True) * normal


def slope_in_scene(light: SceneLight, poser: Poser, around: LightAround, place_m: torch.Tensor, normal: torch.Tensor):
    """(V, 3) of the light at vertices (V, 3), root-relative, over the light itself; of shadows the kernel's anchors."""
    step = poser._light._scene
    columns = padded_rows(7 + 2 * step.task.slots)
    said = step.arrays["reached"].ravel()[: columns * len(step.arrays["reached"])].reshape(-1, columns)
    reached = torch.from_numpy(np.einsum("vk,vkc->vc", around.share.astype(np.float64), said[around.nearest]))
    terms, softness = (light.world or BLACK).terms, step._response.softness
    part = luminance(reached[:, :3])
    of_world = part * (harmonics(normal) @ luminance(terms.irradiance(softness)))
    slope, faced = slope_of_world(of_world, normal), torch.zeros(len(normal))
    whole = torch.maximum(of_world, part * luminance(WORLD_FLOOR * terms.mean_irradiance)) + luminance(reached[:, 3:6])
    for row in step.arrays["lamp"][: step.task.lamps].astype(np.float64):
        direction, strength, sine = torch_light.lamp_at(row, place_m)
        slot = int(row[NUMBER["slot"]])
        hidden = 0 if slot < 0 else row[NUMBER["shade"]] * (1 - reached[:, 7 + 2 * slot])
        strength = strength * (1 - hidden) * row[NUMBER["on_matt"]] * luminance(row[6:9])
        corner = (float(softness[1]) ** 2 + sine.square()).sqrt().clamp(torch_light.CORNER_MIN, torch_light.CORNER_MAX)
        falls = strength * torch_light.soft_cosine((normal * direction).sum(1), corner)
        slope, whole, faced = slope + torch.autograd.grad(falls.sum(), normal)[0], whole + falls, faced + strength
    return slope / torch.maximum(whole, GRAZED * faced).clamp_min(LIT_MIN)[:, None]


@pytest.mark.parametrize("light", LIGHTS.values(), ids=LIGHTS)
def test_the_slope_of_light_is_what_skin_that_turns_gets_more_of_it(light):
    """By derivatives of what training computes, at each vertex of the surface."""
    avatar, seen, joints_m = hand("bumps"), camera(), pose("fist")
    renderer = SceneRenderer([avatar], DRAWN, light)
    renderer.render([joints_m], seen)
    backend, bones = renderer._backend, avatar.skeleton().bones(joints_m)
    assert backend._detail is not None
    drawn = backend._detail._hands[0]
    maps = np.einsum("vb,bij->vij", DetailedHand.of(avatar, 1.0).weights, bones.linear_offset)[..., :3]
    normal = unit(torch.from_numpy(np.einsum("vij,vj->vi", maps, avatar.detail.normals))).requires_grad_(True)
    if light is None:
        irradiance = in_studio(avatar).learned.light.irradiance.mean(1)
        slope = slope_of_world(harmonics(normal) @ torch.from_numpy(irradiance).double(), normal)
    else:
        place_m = torch.from_numpy(posed_surface(avatar, joints_m)[0] - bones.root_m)
        slope = slope_in_scene(light, backend._hands[0], drawn._light, place_m, normal)
    turned = (slope @ torch.from_numpy(seen.camera_from_world[:3, :3].T)).detach().numpy()
    along = (slope * normal).sum(1).detach().numpy()
    found = drawn._arrays["slope"][:, drawn.row_of_vertex]
    # observed: 3.2e-6 of the largest
    assert np.abs(found - np.append(turned.T, along[None], 0)).max() < 5e-6 * np.abs(turned).max()


# lamps before the hand
MIRRORED = (
    Lamp(LampKind.SUN, (3, 3, 3), (0.1, 0.25, 0.9), has_shadow=False),
    Lamp(LampKind.SUN, (1, 2, 3), (-0.4, 0.1, 0.9), angle_rad=0.1, has_shadow=False),
    Lamp(LampKind.POINT, (0.3, 0.3, 0.1), (0.2, 0.2, 0.4), radius_m=0.03, has_shadow=False),
)


def lobes_of_gloss(light: SceneLight, seen: Camera):
    """Of a hand that is equally rough everywhere, what the kernel says of vertices, and what training computes there.

    -> way (V, 3) in the world's axes, width2 (V,), part (V,); (V,) luminance towards the camera by normals (V, 3); the
    surface's own
    """
    avatar = hand("bumps")
    even = {
        name: np.full(len(avatar), value, np.float32) for name, value in (("roughness", 0.45), ("reflectance", 0.03))
    }
    response = replace(avatar.learned.response, **even)
    avatar, joints_m = replace(avatar, learned=replace(avatar.learned, response=response)), pose("open")
    renderer = SceneRenderer([avatar], DRAWN, light)
    renderer.render([joints_m], seen)
    assert renderer._backend._detail is not None
    step, found = renderer._backend._hands[0]._light._scene, renderer._backend._detail._hands[0]
    gloss = found._arrays["gloss"][:, found.row_of_vertex].astype(np.float64)
    bones = avatar.skeleton().bones(joints_m)
    maps = np.einsum("vb,bij->vij", DetailedHand.of(avatar, 1.0).weights, bones.linear_offset)[..., :3]
    normal = unit(torch.from_numpy(np.einsum("vij,vj->vi", maps, avatar.detail.normals)))
    place_m = torch.from_numpy(posed_surface(avatar, joints_m)[0] - bones.root_m)
    rows = step.arrays["lamp"][: step.task.lamps].astype(np.float64)
    lamps = torch_light.LampRows(np.zeros(len(rows) + 1), rows, rows[:0])
    count, nothing = len(place_m), torch.zeros(len(place_m), 3)
    here = replace(response, **{name: array[:1].repeat(count) for name, array in even.items()})
    got = torch_light.Reached(nothing, nothing, nothing[:, 0], torch.ones(0, count))

    def mirrored(leaning: torch.Tensor) -> np.ndarray:
        skin = torch_light.Skin(place_m, leaning)
        eye_m = torch.from_numpy(seen.eye_m - bones.root_m)
        of_eye = torch_light.towards_eye(
            nothing.double(), skin, eye_m, got, replace(light, world=None), lamps, torch_light.ResponseTensors.of(here)
        )
        return luminance(of_eye).numpy()

    return gloss[:3].T @ seen.camera_from_world[:3, :3], gloss[3], gloss[4], mirrored, normal


@pytest.mark.parametrize(
    ("lamps", "lean"),
    [(MIRRORED[:1], 0.15), (MIRRORED, 0.02)],
    ids=["of one lamp far", "of three lamps near"],
)
def test_the_lobe_of_gloss_is_what_leaning_skin_mirrors(lamps, lean):
    """Of one lamp wherever a normal points; of many as they change together at the skin's."""
    way, width2, part, mirrored, normal = lobes_of_gloss(SceneLight(None, lamps), camera())
    before = mirrored(normal)
    glossy = (part > 0.05) & (before > 0)
    assert glossy.sum() > 300
    for axis in np.eye(3):
        turned = lean * unit(torch.linalg.cross(normal, torch.from_numpy(axis).expand_as(normal)))
        wanted = mirrored(unit(normal + turned))[glossy] / before[glossy]
        to_way = (way**2).sum(1), ((way - turned.numpy()) ** 2).sum(1)
        came = (((width2 + to_way[0]) / (width2 + to_way[1])) ** 2)[glossy]
        # observed: 0.989 to 0.9998; 1.05 to 1.12, as skin that leans to a lamp leans from the eye, which masks it
        assert np.corrcoef(came, wanted)[0, 1] > 0.985
        assert 1.03 < np.polyfit(wanted - 1, came - 1, 1)[0] < 1.14


# ---- what it does ----------------------------------------------------------------------------------------------------


def test_an_even_height_changes_nothing():
    came, _ = ratio("even", sun(0.5, 0.3, 0.8))
    assert np.abs(came - 1).max() < 1e-6


def test_light_from_the_other_side_shows_the_other_slopes():
    left, is_left = ratio("bumps", sun(-0.7, 0, 0.7))
    right, is_right = ratio("bumps", sun(0.7, 0, 0.7))
    both = is_left & is_right & (np.abs(left - 1) > 0.03)
    assert both.sum() > 500
    # observed: -0.42; flanks answer the lamp on their side alone
    assert np.corrcoef(left[both], right[both])[0, 1] < -0.3


def test_even_light_shows_no_relief_and_a_studio_some():
    even, _ = ratio("bumps", SceneLight(World(np.ones((16, 32, 3)))))
    studio, _ = ratio("bumps", None)
    assert np.abs(even - 1).mean() < 0.1 * np.abs(studio - 1).mean()


def test_wrinkles_of_straight_fingers_go_as_they_bend():
    bend = Bend(hand().detail.position_m, finger_shares(hand().detail.bone_weights), hand().canonical_joints_m)
    straight, fist = (bend.near @ bend.of_joints(pose(name)[None])[0] for name in ("flat", "fist"))
    joint = np.linalg.norm(hand().detail.position_m - hand().canonical_joints_m[8], axis=1) < 0.011
    assert straight[joint].max() < 0.1
    assert fist[joint].min() > 0.8
    wrist = np.linalg.norm(hand().detail.position_m - hand().canonical_joints_m[0], axis=1) < 0.02
    assert fist[wrist].max() < 0.05


def test_slopes_are_those_of_the_heights_whatever_their_level():
    ramp = np.zeros((TEXELS, TEXELS, 2), np.int8)
    ramp[..., 0] = np.arange(TEXELS) - 32
    slopes = Relief(ramp).slopes(np.ones((TEXELS, TEXELS), bool))
    steps = slopes.texels.view(np.int8).reshape(-1, 4)
    inner = steps[: TEXELS**2].reshape(16, 16, 4, 4, 4)[2:-2, 2:-2].reshape(-1, 4)
    np.testing.assert_allclose(inner[:, 0] * slopes.step_m, TEXELS * HEIGHT_STEP_M, rtol=0, atol=slopes.step_m / 2)
    assert not inner[:, 1:].any()
    # the second level follows the first
    coarser = steps[TEXELS**2 : TEXELS**2 * 5 // 4].reshape(8, 8, 4, 4, 4)[1:-1, 1:-1].reshape(-1, 4)
    np.testing.assert_allclose(coarser[:, 0] * slopes.step_m, TEXELS * HEIGHT_STEP_M, rtol=0.02)


@pytest.mark.parametrize(("texels", "share"), [(4, 0.84), (8, 0.98)])
def test_short_waves_are_about_as_steep_as_they_are(texels, share):
    """Differences of neighbors alone would leave 0.64 and 0.90."""
    wave = np.zeros((TEXELS, TEXELS, 2), np.int8)
    wave[..., 0] = np.rint(100 * np.sin(2 * np.pi * np.arange(TEXELS) / texels))[:, None]
    along, down = Relief(wave).rises_m(np.ones((TEXELS, TEXELS), bool))[8:-8, 8:-8].reshape(-1, 2).T
    steepest = 100 * HEIGHT_STEP_M * TEXELS * 2 * np.pi / texels
    assert share < down.max() / steepest < 1
    assert not along.any()


def test_light_that_was_baked_shows_relief_as_the_lamp_does():
    """The field of a sun: nothing from all around, and its irradiance along its direction."""
    towards = np.array([-0.5, 0.3, 0.8]) / np.linalg.norm([-0.5, 0.3, 0.8])
    lamp = sun(*towards)
    field = np.zeros((len(hand()), 4, 3), np.float32)
    field[:, 1:] = 3.0 * towards[:, None]
    by_lamp, bright = ratio("bumps", lamp)
    baked, is_lit = ratio("bumps", replace(lamp, baked=Baked((field,))))
    both = bright & is_lit & (np.abs(by_lamp - 1) > 0.03)
    assert both.sum() > 500
    assert np.median(np.abs(baked - by_lamp)[both]) < 0.01


def test_relief_stays_where_shadows_are_left_out():
    plain = replace(DRAWN, effects=Choice.parse("detail,correctives,gloss"))
    one, other = (HandRenderer(hand(kind), plain).render(pose("open"), camera()).rgba for kind in ("bumps", ""))
    assert np.abs(one - other).max() > 0.01


def test_a_hand_without_light_of_its_own_shows_no_relief():
    painted = replace(load_painted(handedness=Handedness.RIGHT), detail=hand("bumps").detail)
    joints_m = named_pose("open", painted.rest_joints_m, handedness=Handedness.RIGHT)
    plain = replace(painted, detail=hand().detail)
    one, other = (HandRenderer(each, DRAWN).render(joints_m, camera()).rgba for each in (painted, plain))
    assert np.array_equal(one, other)
