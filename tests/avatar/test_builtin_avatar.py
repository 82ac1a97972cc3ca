"""The avatar that is shipped: right numbers, and a skin that is closed from every side in every level of detail."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageDraw
from scipy.ndimage import binary_erosion, distance_transform_edt, label

from jghand_engine.avatar import builtin
from jghand_engine.avatar.builtin import ASSETS, load_builtin, load_painted
from jghand_engine.avatar.file import save_avatar
from jghand_engine.avatar.tiers import LOST_MAX_DB, Tier
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.skinning import apply, blend, pose_gaussians
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings
from jghand_engine.template.builtin import load_template

# palm, back, thumb side, small finger side, finger tips, wrist
VIEWS = ((0, 0, 1), (0, 0, -1), (1, 0, 0.15), (-1, 0, 0.1), (0.1, 1, 0.35), (0.2, -1, 0.3))


@pytest.fixture(scope="module")
def avatar():
    return load_painted(handedness=Handedness.RIGHT)


def camera_at(direction, joints_m: torch.Tensor, width: int, height: int, focal_px: float) -> Camera:
    towards = torch.tensor(direction, dtype=torch.float64)
    center_m = (joints_m.min(0).values + joints_m.max(0).values) / 2
    eye_m = center_m + 0.6 * towards / towards.norm()
    up = torch.tensor([0.0, 0.0, 1.0] if abs(direction[1]) > 0.9 else [0.0, 1.0, 0.0], dtype=torch.float64)
    return Camera.looking_at(eye_m, center_m, up, width=width, height=height, focal_px=focal_px)


def posed_template_m(joints_m: torch.Tensor) -> torch.Tensor:
    template = load_template()
    bones = JointTransform(torch.from_numpy(template.joints_m.copy()), handedness=Handedness.RIGHT).bones(joints_m)
    linear, offset_m = blend(torch.from_numpy(template.bone_weights.copy()), bones)
    relative_m = torch.from_numpy(template.vertices_m.copy()) - bones.canonical_root_m
    return apply(linear, relative_m) + offset_m + bones.root_m


def template_mask(joints_m: torch.Tensor, camera: Camera) -> np.ndarray:
    """The pixels that the posed template covers."""
    pixels, _ = camera.project(posed_template_m(joints_m))
    picture = Image.new("1", (camera.width, camera.height))
    draw = ImageDraw.Draw(picture)
    for triangle in pixels[load_template().faces]:
        draw.polygon([tuple(corner - 0.5) for corner in triangle], fill=1)
    return np.array(picture)


def test_it_has_the_promised_size(avatar):
    assert len(avatar) == 60_000
    assert (ASSETS / "painted_right.jghand").stat().st_size < 2_500_000
    assert avatar.info.template == load_template().identifier
    np.testing.assert_array_equal(avatar.canonical_joints_m, load_template().joints_m)


def test_left_and_right_share_one_model(avatar):
    left = load_painted(handedness=Handedness.LEFT)
    assert left.handedness == Handedness.LEFT
    assert left.position_m is avatar.position_m


def test_palm_and_back_are_both_well_lit(avatar):
    z_m = avatar.position_m[:, 2]
    for name, part in (("palm", z_m > 0.01), ("back", z_m < -0.005)):
        mean = avatar.rgb[part].mean(0)
        # skin: bright, red over green over blue, neither gray nor orange
        assert 0.70 < float(mean[0]) < 0.92, name
        assert 0.65 < float(mean[1] / mean[0]) < 0.82, name
        assert 0.75 < float(mean[2] / mean[1]) < 0.95, name


# (Gaussians, width, height, focal length, eroded by, largest share of the background that may shine through).
# Worst seen over the poses and views: 0.001, 0.001, 0.003, 0.006
DETAIL = (
    (60_000, 512, 334, 1000.0, 2, 0.0015),
    (60_000, 1024, 1024, 2900.0, 4, 0.0015),
    (30_000, 512, 334, 1000.0, 2, 0.004),
    (15_000, 512, 334, 1000.0, 2, 0.008),
)


@pytest.mark.parametrize("pose", ["open", "fist", "claw"])
@pytest.mark.parametrize(("count", "width", "height", "focal_px", "eroded", "through"), DETAIL)
def test_no_background_shines_through_the_skin(avatar, pose, count, width, height, focal_px, eroded, through):
    joints_m = torch.from_numpy(named_pose(pose, load_template().joints_m, handedness=Handedness.RIGHT))
    bones = JointTransform(avatar.canonical_joints_m, handedness=Handedness.RIGHT).bones(joints_m.float())
    gaussians = pose_gaussians(avatar.prefix(count), bones)
    for view in VIEWS:
        camera = camera_at(view, joints_m, width, height, focal_px)
        alpha = rasterize(gaussians, camera, RenderSettings()).alpha.numpy()
        inside = binary_erosion(template_mask(joints_m, camera), iterations=eroded)
        assert 1 - alpha[inside].min() < through, f"seen from {view}"


def test_the_outline_is_that_of_the_template(avatar):
    joints_m = torch.from_numpy(named_pose("open", load_template().joints_m, handedness=Handedness.RIGHT))
    gaussians = pose_gaussians(
        avatar, JointTransform(avatar.canonical_joints_m, handedness=Handedness.RIGHT).bones(joints_m.float())
    )
    for view in VIEWS:
        camera = camera_at(view, joints_m, 1024, 1024, 2900.0)
        alpha = rasterize(gaussians, camera, RenderSettings()).alpha.numpy()
        pixels_away = distance_transform_edt(~template_mask(joints_m, camera))
        # 17 pixels are 3.5 mm: the curved skin lies up to 2 mm outside the template's flat triangles; worst seen 0.001
        assert alpha[pixels_away > 17].max() < 0.002, f"seen from {view}"


def test_the_trained_avatar_answers_any_light_and_has_its_angles_and_its_license_with_it():
    avatar = load_builtin(handedness=Handedness.RIGHT)
    assert avatar.learned is not None
    assert avatar.learned.response is not None
    assert avatar.learned.response.trained_on["worlds"] == 14
    assert avatar.learned.correctives is not None
    assert avatar.learned.cast is not None
    assert len(avatar.info.pose_statistics) == 30
    assert avatar.info.learned_from is not None
    assert avatar.info.learned_from.pictures == 348
    assert "CC0-1.0" in avatar.info.license


def test_every_hand_that_comes_with_jghand_takes_at_most_eight_megabytes():
    sizes = {path.name: path.stat().st_size for path in Path(str(ASSETS)).rglob("*.jghand")}
    assert {"builtin_right.jghand", "painted_right.jghand", "strong.jghand"} <= set(sizes)
    # observed 7.9e6, of the strong hand
    assert max(sizes.values()) <= 8e6, sizes


def test_the_trained_avatar_is_drawn_by_its_quick_tier_and_loses_nothing_that_counts():
    learned = load_builtin(handedness=Handedness.RIGHT).learned
    assert learned is not None
    _, price = learned.with_tier(Tier.AUTO)
    assert price is not None
    assert price.tier is Tier.LINEAR
    assert price.lost_db <= LOST_MAX_DB


@pytest.mark.parametrize("pose", ["open", "fist"])
def test_the_trained_avatar_is_closed_and_keeps_to_the_hand(pose):
    avatar = load_builtin(handedness=Handedness.RIGHT)
    joints_m = torch.from_numpy(named_pose(pose, avatar.canonical_joints_m, handedness=Handedness.RIGHT))
    camera = camera_at((0, 0, 1), joints_m, 200, 260, 600)
    frame = HandRenderer(avatar, RenderSettings()).render(joints_m, camera)
    solid = frame.rgba[..., 3] > 0.5
    # one piece without holes: no specks beside it, nothing shines through the palm
    _, count = label(solid)
    assert count == 1
    inside = binary_erosion(solid, iterations=4)
    assert frame.rgba[..., 3][inside].min() > 0.98


def test_a_hand_in_the_assets_is_called_by_its_name(tmp_path, monkeypatch):
    (tmp_path / "hands").mkdir()
    save_avatar(tmp_path / "hands" / "child.jghand", load_painted(handedness=Handedness.RIGHT).prefix(50))
    monkeypatch.setattr(builtin, "ASSETS", tmp_path)
    monkeypatch.setattr(builtin, "SHIPPED", ("builtin", "painted", "child"))
    assert len(builtin.load_avatar_called("child")) == 50
    assert builtin.avatar_sha256("child") == hashlib.sha256((tmp_path / "hands/child.jghand").read_bytes()).hexdigest()
