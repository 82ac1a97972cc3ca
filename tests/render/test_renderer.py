"""From 21 joints to the finished picture: the native frame against the torch chain, and what the receipt says."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import torch

from jghand_engine.avatar import forearm
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.posing import Posing
from jghand_engine.avatar.scene_light import Lamp, LampKind, SceneLight
from jghand_engine.avatar.tiers import Tier
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.learn.reference import rasterize_reference
from jghand_engine.learn.shadow import darken
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.native import contract
from jghand_engine.native import library as native_library
from jghand_engine.render.camera import Camera
from jghand_engine.render.effect_plan import Decision, Effect
from jghand_engine.render.effects import REUSE_SKIN_M, reusable
from jghand_engine.render.framing import framing_camera
from jghand_engine.render.hand_facts import HandFacts
from jghand_engine.render.renderer import Frame, HandRenderer, SceneRenderer
from jghand_engine.render.settings import RenderSettings, ShadowMode, preset
from jghand_engine.render.shadow import ShadowStyle

COUNT = 4000
# of a float32 sum of weights times depths of half a meter, whose steps are 3e-8 m; observed 5.0e-7
DEPTH_ROUNDING_M = 6e-7
# from the nearest to the farthest skin of the hands that are drawn here: observed 0.083 to 0.094
HAND_DEPTH_M = 0.1
RIGHT = load_painted(handedness=Handedness.RIGHT)
CANONICAL_M = RIGHT.canonical_joints_m
NATIVE = native_library.runnable_variants()
ALWAYS = RenderSettings(gaussians=COUNT, shadow=ShadowMode.ALWAYS, shadow_samples=32)


@pytest.fixture(params=NATIVE or ["none"])
def backend(request) -> str:
    if request.param == "none":
        pytest.skip("no native variant runs on this processor")
    return request.param


@pytest.fixture
def renderer(backend: str) -> HandRenderer:
    return HandRenderer(RIGHT, replace(ALWAYS, backend=backend))


def camera(width: int = 150, height: int = 120, *, away_m: float = 0.5, focal_px: float = 300.0) -> Camera:
    eye, target = (0.15, 0.18, away_m), (0, 0.08, 0)
    return Camera.looking_at(eye, target, (0, 1, 0), width=width, height=height, focal_px=focal_px)


def pose(name: str, handedness: Handedness = Handedness.RIGHT) -> np.ndarray:
    return named_pose(name, CANONICAL_M, handedness=handedness)


def exact_planes(pose_m: np.ndarray, view: Camera, settings: RenderSettings, handedness=Handedness.RIGHT):
    """(5, H, W) float64 by the torch chain: darkened R G B, alpha, sum of weight times depth."""
    avatar = load_painted(handedness=handedness).prefix(settings.gaussians)
    bones = JointTransform(avatar.canonical_joints_m, handedness=handedness).bones(torch.from_numpy(pose_m))
    picture = rasterize_reference(pose_gaussians(avatar, bones), view, alpha_min=settings.alpha_min)
    planes = torch.cat([picture.rgb.permute(2, 0, 1), picture.alpha[None], picture.depth_sum[None]])
    return torch.cat([darken(planes, view, ShadowStyle(samples=settings.shadow_samples)), planes[3:]])


def check_against(frame: Frame, planes: torch.Tensor, *, flips: float) -> None:
    exact, depth_sum = planes[:4].permute(1, 2, 0).numpy(), planes[4].numpy()
    alpha = exact[..., 3]
    error = np.abs(frame.rgba - exact).max(-1)
    assert float(error.max()) < 0.04
    valid = alpha > contract.DEPTH_ALPHA_MIN + 1e-3
    depth_error = np.where(valid, np.abs(frame.depth_m * alpha - depth_sum), 0)
    # what an early stop leaves out lies within the hand, and moves the mean depth by its part of alpha
    allowed = DEPTH_ROUNDING_M + HAND_DEPTH_M * np.abs(frame.rgba[..., 3] - alpha)
    # RENDERING 3: 1.1e-4 but for flips of a threshold, up to 1/255, or of a normal of the shadow (observed 0.014)
    flipped = (error > 1.1e-4) | (depth_error > allowed)
    assert float(flipped.mean()) <= flips
    assert (depth_error <= allowed + HAND_DEPTH_M * contract.ALPHA_MIN).all()
    assert (frame.depth_m[alpha < contract.DEPTH_ALPHA_MIN - 1e-3] == 0).all()


# ---- the picture ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["open", "fist"])
@pytest.mark.parametrize("handedness", list(Handedness))
def test_native_frame_agrees_with_the_float64_chain(backend: str, name: str, handedness: Handedness):
    joints = 1.1 * pose(name, handedness)
    view = camera()
    settings = replace(ALWAYS, backend=backend)
    frame = HandRenderer(load_painted(handedness=handedness), settings).render(joints, view)
    # observed: eleven pixels of 18,000, in the left fist, whose fingers touch the palm: there two skins are equally far
    check_against(frame, exact_planes(joints, view, settings, handedness), flips=7e-4)
    assert float(frame.rgba[..., 3].mean()) > 0.05


def test_frame_has_the_same_bits_from_one_two_and_three_threads(backend: str):
    joints, view = pose("pinch"), camera(237, 161)
    settings = replace(ALWAYS, gaussians=20_000, backend=backend)
    frames = [HandRenderer(RIGHT, replace(settings, threads=n)).render(joints, view) for n in (1, 2, 3)]
    for other in frames[1:]:
        assert np.array_equal(frames[0].rgba, other.rgba)
        assert np.array_equal(frames[0].depth_m, other.depth_m)


def test_left_hand_is_the_mirrored_picture_of_the_right(backend: str):
    settings = replace(ALWAYS, backend=backend)
    joints = pose("relaxed")
    mirror = np.diag([-1.0, 1.0, 1.0])
    view = camera(160, 120)
    seen = view.camera_from_world.copy()
    # the mirrored world from the mirrored camera: x flips on both sides
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirrored = replace(view, camera_from_world=flip @ seen @ flip, cx=view.width - view.cx)
    right = HandRenderer(RIGHT, settings).render(joints, view)
    left = HandRenderer(load_painted(handedness=Handedness.LEFT), settings).render(joints @ mirror, mirrored)
    error = np.abs(right.rgba - left.rgba[:, ::-1]).max(-1)
    # sample disc and tie order are not mirrored, so the shadow differs a little: compare it apart
    assert float(np.abs(right.rgba - left.rgba[:, ::-1])[..., 3].max()) < 1e-4 + 1 / 255
    assert float(np.median(error[right.rgba[..., 3] > 0.5])) < 0.01
    plain = replace(settings, shadow=ShadowMode.OFF)
    right = HandRenderer(RIGHT, plain).render(joints, view)
    left = HandRenderer(load_painted(handedness=Handedness.LEFT), plain).render(joints @ mirror, mirrored)
    error = np.abs(right.rgba - left.rgba[:, ::-1]).max(-1)
    assert float((error > 1.1e-4).mean()) < 1e-3


def test_hand_a_kilometer_away_loses_nothing(renderer: HandRenderer):
    joints, view = pose("fist"), camera()
    away = np.array([1000.0, -700.0, 300.0])
    moved = view.camera_from_world.copy()
    moved[:3, 3] -= moved[:3, :3] @ away
    here = renderer.render(joints, view)
    there = renderer.render(joints + away, replace(view, camera_from_world=moved))
    error = np.abs(here.rgba - there.rgba).max(-1)
    assert float((error > 1.1e-4).mean()) < 1e-3  # observed 3e-4
    assert float(error.max()) < 0.04


def test_camera_inside_the_hand_gives_a_finite_picture(renderer: HandRenderer):
    for depth in (0.05, 0.02, 0.001, -0.01):
        frame = renderer.render(CANONICAL_M, camera(away_m=depth))
        assert np.isfinite(frame.rgba).all()
        assert float(frame.rgba[..., 3].max()) <= 1


def test_frames_belong_to_the_caller(renderer: HandRenderer):
    first = renderer.render(CANONICAL_M, camera())
    kept = first.rgba.copy()
    first.depth_m[:] = 7
    renderer.render(pose("fist"), camera())
    assert np.array_equal(first.rgba, kept)
    first.rgba[:] = 7
    again = renderer.render(CANONICAL_M, camera())
    assert np.array_equal(again.rgba, kept)


# ---- the receipt ----------------------------------------------------------------------------------------------------


def decision(frame: Frame, effect: Effect) -> Decision:
    assert frame.report.plan is not None
    return frame.report.plan[effect]


def bound(frame: Frame) -> str:
    return decision(frame, Effect.SKIN).bound


def test_skin_that_faces_away_is_neither_drawn_nor_missed(monkeypatch):
    hand = load_builtin(handedness=Handedness.RIGHT)
    joints_m = named_pose("fist", hand.rest_joints_m, handedness=Handedness.RIGHT)
    view = framing_camera(joints_m[None], Handedness.RIGHT, "front", width=334, height=512)
    drawn = HandRenderer(hand, preset("viewport")).render(joints_m, view)
    monkeypatch.setattr(forearm, "HIDDEN_FROM", -2)
    whole = HandRenderer(hand, preset("viewport")).render(joints_m, view)
    assert drawn.report.visible_gaussians < 0.7 * whole.report.visible_gaussians
    difference = np.abs(drawn.rgba - whole.rgba).max(-1)
    # observed 1.7e-5, and 22 pixels of 171,008, at outlines
    assert difference.mean() < 2e-5
    assert (difference > 0.02).sum() < 30


@pytest.mark.parametrize("in_scene", [False, True])
def test_no_memory_of_the_size_of_an_image_is_taken_beside_the_frames(in_scene: bool):
    """In the light of a scene with pictures from its lamps, and light of them that is drawn apart."""
    view = camera(512, 384, focal_px=1000.0)
    if in_scene:
        sun = Lamp(LampKind.SUN, (3.0, 3.0, 3.0), (0.3, 1.0, 0.5), angle_rad=0.01)
        builtin, settings = load_builtin(handedness=Handedness.RIGHT), replace(preset("final"), reuse=False)
        renderer = HandRenderer(builtin, settings, SceneLight(None, (sun,)))
    else:
        renderer = HandRenderer(RIGHT, replace(ALWAYS, reuse=False))
    poses = [pose(name) for name in ("fist", "open")]
    for joints in (*poses, *poses):
        renderer.render(joints, view)
    tracemalloc.start()
    frames = [renderer.render(joints, view) for joints in (*poses, *poses)]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert all(decision(frame, Effect.WHOLE).runs for frame in frames)
    beside = peak - sum(frame.rgba.nbytes + frame.depth_m.nbytes for frame in frames)
    # observed 0.04 of one plane of the image
    assert abs(beside) < 0.5 * frames[0].depth_m.nbytes


def test_a_part_of_a_frame_is_kept_as_it_is():
    renderer, view = HandRenderer(RIGHT, replace(ALWAYS, reuse=False)), camera()
    poses = [pose(name) for name in ("fist", "open", "point", "pinch")]
    parts = [renderer.render(joints, view).rgba[::2, :, 3] for joints in poses]
    for joints, part in zip(poses, parts, strict=True):
        assert np.array_equal(part, HandRenderer(RIGHT, ALWAYS).render(joints, view).rgba[::2, :, 3])


def test_small_movements_reuse_the_pose_within_the_bound(renderer: HandRenderer):
    first = renderer.render(CANONICAL_M, camera())
    assert {"transform", "skin", "raster", "shadow + compose"} <= set(first.report.stages)
    nudged = CANONICAL_M + 2e-5
    second = renderer.render(nudged, camera(away_m=0.6))
    assert not {"transform", "skin"} & set(second.report.stages)
    assert "raster" in second.report.stages
    assert bound(second) == "0.035 mm of skin"  # as far as the hand: 0.02 mm along each axis
    # steps below the limit do not add up beyond it: the distance is to the joints that were last posed
    third = renderer.render(CANONICAL_M + 4e-5, camera(away_m=0.6))
    assert "transform" in third.report.stages


def odd_bones(avatar: HandAvatar, name: str, palm: float, fingers: float) -> np.ndarray:
    joints = named_pose(name, avatar.canonical_joints_m, handedness=Handedness.RIGHT)
    out = joints.copy()
    for joint in range(1, 21):
        parent = 0 if joint < 6 else joint - 5
        out[joint] = out[parent] + (palm if joint < 6 else fingers) * (joints[joint] - joints[parent])
    return out


@pytest.mark.parametrize("tier", [Tier.EXACT, Tier.LINEAR])
@pytest.mark.parametrize("bones", [(1.0, 1.0), (0.6, 1.4), (1.4, 0.6)], ids=["usual", "short palm", "long palm"])
@pytest.mark.parametrize("name", ["relaxed", "fist"])
def test_skin_that_is_kept_is_off_by_no_more_than_the_receipt_says(name: str, bones: tuple[float, float], tier: Tier):
    """With all joints moved against each other in the way that moves some point of the skin most, as far as the bound
    allows; also of hands of odd bones."""
    avatar = load_builtin(handedness=Handedness.RIGHT).prefix(1500)
    assert avatar.learned is not None
    avatar = replace(avatar, learned=avatar.learned.with_tier(tier)[0])
    facts, skeleton, posing = HandFacts(avatar), avatar.skeleton(), Posing(avatar, threads=1)
    joints = odd_bones(avatar, name, *bones)
    before, rest = posing(joints).position_m.astype(np.float64), skeleton.bones(joints)
    tiny_m = 2e-5  # float32 positions are good to 1e-8
    jacobian = (
        np.stack(
            [posing(joints + tiny_m * one.reshape(21, 3)).position_m.astype(np.float64) - before for one in np.eye(63)]
        )
        / tiny_m
    )
    length = np.abs(jacobian).sum(0)  # (N, 3) when every coordinate moves its worst way
    worst, axis = np.unravel_index(length.argmax(), length.shape)
    way = np.sign(jacobian[:, worst, axis]).reshape(21, 3)
    settings, seen = RenderSettings(), 0.0
    for step_m in 10.0 ** np.arange(-4.0, -9.0, -0.25):
        moved = joints + step_m * way
        bones_now = skeleton.bones(moved)
        stated_m = reusable([bones_now], [rest], [rest.angles_rad], [facts], settings)
        if stated_m is None:
            continue
        off_m = float(np.linalg.norm(posing(moved).position_m - before, axis=1).max())
        assert off_m <= stated_m + 1e-7
        seen = max(seen, stated_m)
    assert seen > 0.1 * REUSE_SKIN_M  # some of these steps are reused


def test_a_flagged_hand_is_reused_only_when_it_stands_still(renderer: HandRenderer):
    joints = CANONICAL_M.copy()
    joints[20] = joints[15]  # a bone without length: its direction may turn with any movement
    renderer.render(joints, camera())
    assert bound(renderer.render(joints, camera())) == "0"
    moved = joints.copy()
    moved[20, 0] += 1e-6
    assert "transform" in renderer.render(moved, camera()).report.stages


def test_unchanged_pose_and_camera_reuse_the_picture_exactly(renderer: HandRenderer):
    first = renderer.render(CANONICAL_M, camera())
    second = renderer.render(CANONICAL_M, camera())
    assert set(second.report.stages) == {"plan", "shadow + compose"}
    assert np.array_equal(first.rgba, second.rgba)
    assert first.report.visible_gaussians == second.report.visible_gaussians
    resized = renderer.render(CANONICAL_M, camera(151))
    assert "raster" in resized.report.stages


def test_joints_changed_in_place_are_seen(renderer: HandRenderer):
    joints = CANONICAL_M.copy()
    renderer.render(joints, camera())
    joints += 0.01
    frame = renderer.render(joints, camera())
    assert "transform" in frame.report.stages


def test_reuse_can_be_switched_off(backend: str):
    renderer = HandRenderer(RIGHT, replace(ALWAYS, backend=backend, reuse=False))
    for _ in range(2):
        frame = renderer.render(CANONICAL_M, camera())
        assert set(frame.report.stages) == {"transform", "plan", "skin", "raster", "shadow + compose"}


def test_gate_fades_the_shadow_and_says_the_score(backend: str):
    renderer = HandRenderer(RIGHT, replace(ALWAYS, backend=backend, shadow=ShadowMode.GATED))
    still = renderer.render(CANONICAL_M, camera())
    assert decision(still, Effect.SHADOW).reason == "gate 0.00"
    assert "shadow + compose" not in still.report.stages
    fist = renderer.render(pose("fist"), camera())
    assert "shadow + compose" in fist.report.stages


def test_a_picture_that_is_given_up_between_its_parts_harms_no_later_one(backend: str):
    settings, view = replace(ALWAYS, backend=backend), camera()
    poses = [pose(name) for name in ("open", "fist")]
    renderer = HandRenderer(RIGHT, settings)._scene
    wanted = HandRenderer(RIGHT, settings).render(poses[1], view).rgba
    parts = []
    renderer.render([poses[0]], view, check_canceled=lambda: parts.append(None))
    assert len(parts) > 1
    for last in range(1, len(parts) + 1):
        calls = []

        def give_up(last: int = last, calls: list[None] = calls) -> None:
            calls.append(None)
            if len(calls) == last:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            renderer.render([poses[1]], view, check_canceled=give_up)
        np.testing.assert_array_equal(renderer.render([poses[1]], view).rgba, wanted)
        renderer.render([poses[0]], view)


def test_receipt_is_plain_data_and_reads_as_sentences(backend: str):
    report = HandRenderer(RIGHT, replace(ALWAYS, backend=backend)).render(CANONICAL_M, camera()).report
    data = report.as_dict()
    assert data["gaussians"] == COUNT
    assert data["visible_gaussians"] > 0
    assert data["invalid_gaussians"] == 0
    assert data["total_ms"] >= max(stage["milliseconds"] for stage in data["stages"])
    assert any(line.startswith("raster ran, ") for line in report.lines())


def test_odd_hands_are_noted(backend: str):
    joints = CANONICAL_M.copy()
    joints[20] = joints[15]
    frame = HandRenderer(RIGHT, replace(ALWAYS, backend=backend)).render(joints, camera())
    assert "a bone has no length" in frame.report.notes
    assert np.isfinite(frame.rgba).all()
    both = SceneRenderer([RIGHT, RIGHT], replace(ALWAYS, backend=backend)).render([CANONICAL_M, joints], camera())
    assert both.report.notes == ["hand 2: a bone has no length"]


# ---- bad input ------------------------------------------------------------------------------------------------------


def test_joint_that_is_not_finite_is_named(backend: str):
    joints = CANONICAL_M.copy()
    joints[7, 1] = np.nan
    with pytest.raises(InputError, match="index2 not finite"):
        HandRenderer(RIGHT, replace(ALWAYS, backend=backend)).render(joints, camera())


@pytest.mark.parametrize("shape", [(20, 3), (42, 3), (21, 2), (2, 21, 3), (63,)])
def test_wrong_number_of_joints_is_refused(shape: tuple[int, ...]):
    renderer = HandRenderer(RIGHT, ALWAYS)
    with pytest.raises(InputError, match="joints"):
        renderer.render(np.zeros(shape), camera())


def test_renderer_works_on_after_a_refused_camera(backend: str):
    settings = replace(ALWAYS, gaussians=500, backend=backend)
    renderer = HandRenderer(RIGHT, settings)
    view, too_large = camera(60, 50), camera(contract.IMAGE_MAX_PX + 1, 1)
    first = renderer.render(CANONICAL_M, view)
    fist = pose("fist")
    with pytest.raises(InputError, match="image size"):
        renderer.render(fist, too_large)
    # the refused picture's pose is posed now, not taken for the one that was drawn ...
    assert np.array_equal(renderer.render(fist, view).rgba, HandRenderer(RIGHT, settings).render(fist, view).rgba)
    with pytest.raises(InputError, match="image size"):
        renderer.render(fist, too_large)
    # ... and neither is the one before
    assert np.array_equal(renderer.render(CANONICAL_M, view).rgba, first.rgba)


# ---- several hands --------------------------------------------------------------------------------------------------


def test_two_hands_share_one_picture(backend: str):
    settings = replace(ALWAYS, backend=backend, shadow=ShadowMode.OFF)
    left = load_painted(handedness=Handedness.LEFT)
    joints = [
        pose("open") + np.array([0.09, 0, 0]),
        pose("fist", Handedness.LEFT) - np.array([0.09, 0, 0]),
    ]
    view = camera(240, 120)
    both = SceneRenderer([RIGHT, left], settings).render(joints, view)
    alone = [
        HandRenderer(avatar, settings).render(hand, view) for avatar, hand in zip((RIGHT, left), joints, strict=True)
    ]
    alpha = [frame.rgba[..., 3] for frame in alone]
    apart = np.minimum(*alpha) < 1e-6
    error = np.abs(both.rgba - alone[0].rgba - alone[1].rgba).max(-1)[apart]
    assert float((error > 1.1e-4).mean()) < 1e-3
    assert both.report.gaussians == 2 * COUNT


def test_hands_that_come_near_shade_each_other(backend: str):
    settings = replace(ALWAYS, backend=backend, shadow=ShadowMode.GATED)
    scene = SceneRenderer([RIGHT, RIGHT], settings)
    far = scene.render([CANONICAL_M, CANONICAL_M + np.array([0.4, 0.0, 0.0])], camera())
    near = scene.render([CANONICAL_M, CANONICAL_M + np.array([0.0, 0.0, 0.04])], camera())
    assert "shadow + compose" not in far.report.stages
    assert "shadow + compose" in near.report.stages


def test_scene_wants_joints_for_every_hand():
    with pytest.raises(InputError, match="hands of an image"):
        SceneRenderer([RIGHT, RIGHT], ALWAYS).render([CANONICAL_M], camera())
    with pytest.raises(InputError, match="hands of an image"):
        SceneRenderer([], ALWAYS)
