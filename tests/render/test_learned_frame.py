"""Trained avatars in the frame: normals, light, gloss and correctives, for any hand, camera and place."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_avatars import ellipsoid_avatar, small_avatar, trained_avatar

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.avatar.posing import Poser
from jghand_engine.avatar.relighting import in_studio
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.skeleton import Transform
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.reference import rasterize_reference
from jghand_engine.learn.shadow import darken
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.native import library as native_library
from jghand_engine.native.threads import shared_pool
from jghand_engine.render.camera import Camera
from jghand_engine.render.effect_plan import Choice, Effect
from jghand_engine.render.gate import ShadowGate, capsules_beside, fade
from jghand_engine.render.renderer import Frame, HandRenderer, SceneRenderer
from jghand_engine.render.settings import RenderSettings, ShadowMode
from jghand_engine.render.shadow import ShadowStyle

AVATAR = trained_avatar(3000)
BACKENDS = native_library.runnable_variants()
PLAIN = RenderSettings(shadow=ShadowMode.OFF, antialias=False)


@pytest.fixture(params=BACKENDS)
def settings(request) -> RenderSettings:
    return replace(PLAIN, backend=request.param)


def joints_of(pose: str, avatar: HandAvatar = AVATAR) -> np.ndarray:
    return named_pose(pose, avatar.canonical_joints_m, handedness=avatar.handedness)


def beside(joints_m: np.ndarray, shift_m: float) -> np.ndarray:
    return joints_m + np.array([shift_m, 0.0, 0.2 * shift_m])


def camera(side: float = 0.15, *, size: tuple[int, int] = (120, 100), focal_px: float = 240.0) -> Camera:
    eye, target = (side, 0.18, 0.5), (0, 0.08, 0)
    return Camera.looking_at(eye, target, (0, 1, 0), width=size[0], height=size[1], focal_px=focal_px)


def covariance_of(gaussians: Gaussians) -> torch.Tensor:
    """(N, 6) as in `Gaussians`, of spheres too."""
    if gaussians.covariance_m2 is not None:
        return gaussians.covariance_m2
    sphere = gaussians.sigma_m.new_tensor([1.0, 0.0, 0.0, 1.0, 0.0, 1.0])
    return gaussians.sigma_m[:, None] ** 2 * sphere


def exact(avatars: list[HandAvatar], joints: list[np.ndarray], view: Camera) -> np.ndarray:
    """(H, W, 4) by the functions that training uses, in float64 throughout, and the exact rasterizer."""
    parts, eye_m = [], torch.from_numpy(view.eye_m)
    beside_each = capsules_beside(
        joints, [avatar.skeleton().bones(each) for avatar, each in zip(avatars, joints, strict=True)]
    )
    for avatar, joints_m, others in zip(avatars, joints, beside_each, strict=True):
        transform = JointTransform(avatar.canonical_joints_m, handedness=avatar.handedness)
        bones = transform.bones(torch.from_numpy(joints_m))
        parts.append(pose_gaussians(avatar, bones, frames=bones.frames, eye_m=eye_m, others=others))
    fields = ("position_m", "sigma_m", "opacity", "rgb")
    both = replace(
        parts[0],
        covariance_m2=torch.cat([covariance_of(part) for part in parts]),
        **{name: torch.cat([getattr(part, name) for part in parts]) for name in fields},
    )
    picture = rasterize_reference(both, view, alpha_min=PLAIN.alpha_min)
    return torch.cat([picture.rgb, picture.alpha[..., None]], -1).numpy()


def check(frame: Frame, wanted: np.ndarray) -> None:
    error = np.abs(frame.rgba - wanted).max(-1)
    # 1.1e-4 but for flips of a threshold (RENDERING 3); the network in float32 costs nothing beside that
    assert float((error > 2e-4).mean()) <= 1e-3, float(np.quantile(error, 0.999))
    assert float(error.max()) < 0.02
    assert float(wanted[..., 3].mean()) > 0.05


@pytest.mark.parametrize("pose", ["open", "fist"])
@pytest.mark.parametrize("handedness", list(Handedness))
def test_the_frame_is_what_the_training_functions_make(settings, pose, handedness):
    avatar = AVATAR.for_hand(handedness)
    joints, view = 1.1 * joints_of(pose, avatar), camera()
    check(HandRenderer(avatar, settings).render(joints, view), exact([avatar], [joints], view))


def test_everything_that_was_learned_is_seen():
    """Each part of it changes the picture: the comparison above would otherwise prove little."""
    joints, view, learned = joints_of("fist"), camera(), AVATAR.learned
    whole = HandRenderer(AVATAR, PLAIN).render(joints, view).rgba
    dark = replace(learned.light, lobe_rgb=np.zeros_like(learned.light.lobe_rgb))
    flat = replace(learned.light, irradiance=np.zeros_like(learned.light.irradiance))
    for less in (
        replace(learned, correctives=None),
        replace(learned, shine=np.zeros_like(learned.shine)),
        replace(learned, light=dark),
        replace(learned, light=flat),
        replace(learned, normal=np.roll(learned.normal, 1, 0)),
        replace(learned, world_offsets=True),
    ):
        other = HandRenderer(replace(AVATAR, learned=less), PLAIN).render(joints, view).rgba
        assert float(np.abs(other - whole).max()) > 0.05


def test_trained_and_painted_hands_stand_in_one_picture(settings):
    painted, left = small_avatar(1000, 1), trained_avatar(1500, 2).for_hand(Handedness.LEFT)
    avatars = [painted, AVATAR, left]
    joints = [beside(joints_of("open", painted), 0.05), joints_of("fist"), beside(joints_of("point", left), -0.1)]
    scene, view = SceneRenderer(avatars, settings), camera()
    check(scene.render(joints, view), exact(avatars, joints, view))
    moved = [joints[0], joints_of("open"), joints[2]]
    check(scene.render(moved, view), exact(avatars, moved, view))


def test_ellipsoids_are_drawn_beside_spheres_and_painted_hands(settings):
    avatars = [ellipsoid_avatar(1501), small_avatar(700, 1), trained_avatar(600, 2)]
    joints = [joints_of("fist"), beside(joints_of("open"), 0.05), beside(joints_of("point"), -0.1)]
    scene, view = SceneRenderer(avatars, settings), camera()
    frame = scene.render(joints, view)
    check(frame, exact(avatars, joints, view))
    assert frame.report.invalid_gaussians == 0


def test_the_same_pose_from_elsewhere_reflects_what_is_seen_from_there(settings):
    renderer, joints = HandRenderer(AVATAR, settings), joints_of("relaxed")
    first = renderer.render(joints, camera())
    check(renderer.render(joints, camera(-0.4)), exact([AVATAR], [joints], camera(-0.4)))
    again = renderer.render(joints, camera())
    assert np.array_equal(again.rgba, first.rgba)
    assert "transform" not in again.report.stages
    # another picture of the same camera keeps the colors
    bigger = camera(size=(140, 100))
    assert np.array_equal(
        renderer.render(joints, bigger).rgba, HandRenderer(AVATAR, settings).render(joints, bigger).rgba
    )


# ---- the shadow ------------------------------------------------------------------------------------------------------


# near enough for a shadow
NEAR = camera(size=(160, 140), focal_px=450.0)


def shadowed(avatar: HandAvatar, mode: ShadowMode, pose: str = "fist") -> Frame:
    return HandRenderer(avatar, replace(PLAIN, shadow=mode)).render(joints_of(pose), NEAR)


def test_an_avatar_that_follows_the_joints_in_another_way_is_refused():
    """The renderer would draw it, and draw it wrong."""
    other = replace(AVATAR, info=replace(AVATAR.info, transform=Transform.HALO_LIKE))
    with pytest.raises(InputError, match=r"avatar small: transform.*wanted joints, got halo-like"):
        SceneRenderer([AVATAR, other], PLAIN)


def test_the_shadow_has_the_learned_look():
    drawn = shadowed(AVATAR, ShadowMode.GATED)
    assert "shadow + compose" in drawn.report.stages
    plain = exact([AVATAR], [joints_of("fist")], NEAR)
    alpha, depth = torch.from_numpy(plain[..., 3]), torch.from_numpy(drawn.depth_m).double()
    planes = torch.cat([torch.from_numpy(plain).permute(2, 0, 1), (alpha * depth)[None]])
    look = AVATAR.learned.shadow
    strength = fade(ShadowGate(AVATAR.canonical_joints_m).score(joints_of("fist")))
    style = ShadowStyle(16, strength, gain=look.gain, tint=look.tint)
    wanted = darken(planes, NEAR, style).permute(1, 2, 0).numpy()
    error = np.abs(drawn.rgba[..., :3] - wanted)
    assert float((error.max(-1) > 1e-3).mean()) < 5e-3
    assert float(np.abs(wanted - plain[..., :3]).max()) > 0.1


def test_a_hand_that_was_learned_without_shadow_gets_none():
    bare = replace(AVATAR, learned=replace(AVATAR.learned, shadow=None))
    frame = shadowed(bare, ShadowMode.ALWAYS)
    assert "shadow + compose" not in frame.report.stages
    assert "without" in frame.report.plan[Effect.SHADOW].reason
    assert np.array_equal(frame.rgba, shadowed(bare, ShadowMode.OFF).rgba)


def test_colors_that_were_learned_under_a_fading_shadow_keep_it_in_every_mode():
    for pose in ("open", "fist"):
        gated, always = (shadowed(AVATAR, mode, pose).rgba for mode in (ShadowMode.GATED, ShadowMode.ALWAYS))
        assert np.array_equal(gated, always)


def test_hands_of_different_looks_share_the_mean_of_them():
    dark = replace(AVATAR, learned=replace(AVATAR.learned, shadow=ShadowLook(gain=9.0, tint=(0.8, 0.8, 0.9))))
    mean = replace(AVATAR, learned=replace(AVATAR.learned, shadow=ShadowLook(gain=7.0, tint=(0.6, 0.7, 0.8))))
    joints = [joints_of("fist"), beside(joints_of("fist"), 0.09)]
    shown = [SceneRenderer(pair, RenderSettings()).render(joints, NEAR).rgba for pair in ([AVATAR, dark], [mean, mean])]
    assert np.allclose(*shown, atol=1e-6)


def with_seen(seen: float | None):
    return replace(AVATAR, learned=replace(AVATAR.learned, shadow=replace(AVATAR.learned.shadow, seen=seen)))


def test_a_shadow_that_nobody_sees_is_not_drawn():
    faint = with_seen(1.5 / 255)
    frame = shadowed(faint, ShadowMode.GATED)
    assert "shadow + compose" not in frame.report.stages
    assert "1.5 of 255 steps" in frame.report.plan[Effect.SHADOW].reason
    assert np.array_equal(frame.rgba, shadowed(AVATAR, ShadowMode.OFF).rgba)
    # said in the receipt: so far may the picture be off
    assert frame.report.plan[Effect.SHADOW].worst == pytest.approx(1.5 / 255)


@pytest.mark.parametrize(
    ("seen", "settings"),
    [
        (None, RenderSettings()),
        (3 / 255, RenderSettings()),
        (1 / 255, RenderSettings(shadow=ShadowMode.ALWAYS)),
        (1 / 255, RenderSettings(effects=Choice.parse("all"))),
    ],
    ids=["not measured", "seen", "asked for always", "asked for by name"],
)
def test_a_shadow_is_drawn_where_it_may_be_seen(seen, settings):
    frame = HandRenderer(with_seen(seen), settings).render(joints_of("fist"), NEAR)
    assert "shadow + compose" in frame.report.stages


@pytest.mark.parametrize(("casts", "runs"), [(True, False), (False, True)])
def test_hands_that_touch_take_the_screen_pass_only_where_no_shadow_is_cast(casts: bool, runs: bool):
    faint, joints = with_seen(0.0), joints_of("fist")
    if not casts:
        faint = replace(faint, learned=replace(faint.learned, cast=None))
    for away_m in (0.09, 0.5):
        frame = SceneRenderer([faint, faint], RenderSettings()).render([joints, beside(joints, away_m)], NEAR)
        assert ("shadow + compose" in frame.report.stages) is (runs and away_m < 0.1)


# ---- the shadow of one hand on the other -----------------------------------------------------------------------------


@pytest.mark.parametrize("handedness", Handedness)
def test_a_hand_over_another_one_casts_its_shadow_on_it(settings: RenderSettings, handedness: Handedness):
    """The less, the farther away it is; the mean color of all Gaussians of the hand below is compared."""
    avatar = in_studio(load_builtin(handedness=handedness).prefix(6000))
    # without gloss, which only a camera sees
    avatar = replace(avatar, learned=replace(avatar.learned, shine=np.zeros(len(avatar), np.float32)))
    joints = joints_of("flat", avatar)
    palm = np.cross(joints[2] - joints[0], joints[4] - joints[0])
    palm *= {Handedness.RIGHT: -1, Handedness.LEFT: 1}[handedness] / np.linalg.norm(palm)
    darkness = []
    for gap_m in (0.05, 0.10, 0.20, 0.45):
        other = joints + gap_m * palm
        lone, both = (
            capsules_beside(hands, [avatar.skeleton().bones(one) for one in hands])
            for hands in ([joints], [joints, other])
        )
        colors = []
        for others in (lone[0], both[0]):
            poser = Poser(native_library.load(settings.backend), avatar)
            poser.prepare(avatar.skeleton().bones(joints), np.zeros(3), others=others)
            shared_pool(1).run(lambda _thread, poser=poser: poser.run())
            colors.append(poser.into.rgb.astype(np.float64).mean())
        darkness.append(1 - colors[1] / colors[0])
    assert darkness[0] > 0.04
    assert darkness == sorted(darkness, reverse=True)
    # far apart nothing is computed, and nothing differs
    assert darkness[-1] == 0
    assert both[0] is None


def test_the_shadow_of_another_hand_fades_with_its_distance():
    joints = joints_of("fist")
    bones = AVATAR.skeleton().bones(joints)
    parts = []
    for away_m in np.linspace(0.1, 0.6, 101):
        found = capsules_beside([joints, joints + np.array([away_m, 0.0, 0.0])], [bones, bones])[0]
        parts.append(0.0 if found is None else float(found.part[0]))
    assert (parts[0], parts[-1]) == (1, 0)
    assert np.abs(np.diff(parts)).max() < 0.05


def test_every_hand_near_enough_casts_a_shadow_on_every_other():
    joints = [joints_of("fist") + np.array([0.12 * place, 0.0, 0.0]) for place in range(3)]
    found = capsules_beside(joints, [AVATAR.skeleton().bones(one) for one in joints])
    assert [None if one is None else len(one.part) for one in found] == [40, 40, 40]
    # as they stand around the middle one
    assert found[1] is not None
    np.testing.assert_allclose(found[1].start_m[0], joints[0][0] - joints[1][0])
