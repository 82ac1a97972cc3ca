"""The web page of a motion: what is written, that it asks nobody for anything, and that its scripts pose the hand as
the engine does. In a browser it is tried by scripts/check_web_page.py."""

import base64
import gzip
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import build_web_viewer
import check_web_page
import numpy as np
import pytest
import torch
from detail_reference import posed_surface
from scipy.spatial.transform import Rotation
from small_avatars import coarse_builtin, ellipsoid_avatar, known_avatar, small_avatar, trained_avatar

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import Blocks
from jghand_engine.avatar.detail import Detail
from jghand_engine.avatar.detail_mips import skin_texels
from jghand_engine.avatar.posing import Poser
from jghand_engine.avatar.relighting import in_studio, relightable
from jghand_engine.avatar.tiers import Distilled
from jghand_engine.color import linear_to_srgb
from jghand_engine.errors import InputError
from jghand_engine.export.web import page as web
from jghand_engine.export.web.hand import turned_light, with_cheap_correctives
from jghand_engine.export.web.page import WebOptions, WebView, export_web
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import ArticulatedHand
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.hand.shapes import angles_on
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.distill import distill
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.native import library as native_library
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import DetailedHand, NativeDetail
from jghand_engine.template.surface import one_uv_each

VIEW = WebView((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 2.2, (0.012,) * 21)
FILES = {"index.html", "hand.js", "pose.js", "viewer.js", "LICENSES.txt"}
NODE = shutil.which("node")
EYE_M = np.array([0.1, 0.2, 0.45])
POSE_SCRIPT = Path(__file__).with_name("web_pose.mjs")


def motion(avatar: HandAvatar, hand: Handedness = Handedness.RIGHT) -> PoseSequence:
    return pose_sequence_of_names(["open", "fist", "ok"], avatar.canonical_joints_m, handedness=hand)


def exported(folder: Path, avatar: HandAvatar | None = None, **options) -> web.WebReport:
    avatar = avatar or small_avatar()
    return export_web(folder, avatar, motion(avatar), VIEW, WebOptions(**options))


def with_linear(avatar: HandAvatar) -> HandAvatar:
    """The same with a linear tier, as `jghand distill` adds one."""
    assert avatar.learned is not None
    g = torch.Generator().manual_seed(3)
    linear = distill(avatar, 0.5 * torch.randn(24, 37, generator=g), [5])[5]
    return replace(avatar, learned=replace(avatar.learned, distilled=Distilled(linear, (), "test")))


def description_of(folder: Path) -> dict:
    found = re.fullmatch(
        r'globalThis\.JGHAND_HAND=\{description:(.*),arrays:"([^"]*)"\};\n', (folder / "hand.js").read_text()
    )
    assert found
    return json.loads(found[1]) | {"content": gzip.decompress(base64.b64decode(found[2]))}


# ---- what is written -------------------------------------------------------------------------------------------------


def test_a_page_is_five_files_and_says_how_large_they_are(tmp_path):
    report = exported(tmp_path / "page")
    assert {path.name for path in (tmp_path / "page").iterdir()} == FILES
    assert report.page == tmp_path / "page" / "index.html"
    assert report.bytes == {path.name: path.stat().st_size for path in (tmp_path / "page").iterdir()}
    assert (report.gaussians, report.correctives) == (200, "none")


def test_what_every_page_has_in_common_stays_below_two_megabytes():
    assert sum(path.stat().st_size for path in web.ASSETS.iterdir()) < 2e6


def test_the_page_names_hand_license_and_pictures(tmp_path):
    avatar = coarse_builtin()
    exported(tmp_path, avatar, gaussians=500)
    found = description_of(tmp_path)
    assert (found["name"], found["license"]) == (avatar.info.name, avatar.info.license)
    assert found["learned_from"].startswith("348 pictures of")
    assert found["gaussians"] == 500


def test_the_page_says_what_it_leaves_out_where_that_would_be_seen(tmp_path):
    exported(tmp_path / "painted")
    exported(tmp_path / "builtin", coarse_builtin(), gaussians=500)
    assert "shadow" in description_of(tmp_path / "painted")["notes"][0]
    assert description_of(tmp_path / "builtin")["notes"] == []


def test_a_name_cannot_end_the_script(tmp_path):
    avatar = small_avatar()
    avatar = replace(avatar, info=replace(avatar.info, name='</script>"\u2028\\'))
    exported(tmp_path, avatar)
    assert "</script" not in (tmp_path / "hand.js").read_text()
    assert description_of(tmp_path)["name"] == '</script>"\u2028\\'


def test_the_page_asks_nobody_for_anything(tmp_path):
    exported(tmp_path)
    page = (tmp_path / "index.html").read_text()
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert sorted(sources) == ["data:,", "hand.js", "pose.js", "viewer.js"]
    assert "default-src 'none'" in page
    assert "http:" not in page
    assert "https:" not in page


def test_a_page_of_ours_is_replaced_and_other_files_stay(tmp_path):
    exported(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    exported(tmp_path, title="Second")
    assert "Second" in (tmp_path / "index.html").read_text()
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert {path.name for path in tmp_path.iterdir()} == FILES | {"notes.txt"}


@pytest.mark.parametrize("name", ["index.html", "viewer.js", "LICENSES.txt"])
def test_a_page_of_somebody_else_stays_as_it_is(tmp_path, name):
    (tmp_path / name).write_text("<html>mine</html>")
    with pytest.raises(InputError, match=f"{name} of somebody else"):
        exported(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "<html>mine</html>"


def test_a_motion_with_gaps_or_too_long_is_refused(tmp_path):
    avatar = small_avatar()
    joints_m = motion(avatar).joints_m.copy()
    joints_m[3, 5] = np.nan
    with pytest.raises(InputError, match="frame"):
        export_web(tmp_path, avatar, PoseSequence(joints_m, 30.0, Handedness.RIGHT), VIEW)
    long = PoseSequence(np.repeat(motion(avatar).joints_m[:1], web.FRAMES_MAX + 1, 0), 30.0, Handedness.RIGHT)
    with pytest.raises(InputError, match="--frames"):
        export_web(tmp_path, avatar, long, VIEW)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("what", "options"), [("title", {"title": "a\nb"}), ("Gaussians", {"gaussians": -1})])
def test_an_impossible_option_is_named(what, options):
    with pytest.raises(InputError, match=what):
        WebOptions(**options)


def test_the_scripts_were_built_from_these_sources():
    assert build_web_viewer.stamp() == build_web_viewer.source_hash(), "run scripts/build_web_viewer.py"


def test_every_license_is_with_the_scripts():
    text = (web.ASSETS / "LICENSES.txt").read_text()
    lock = json.loads((build_web_viewer.SOURCES / "package-lock.json").read_text())["packages"]
    for name in ("three",):
        assert f"{name} {lock[f'node_modules/{name}']['version']}" in text
    assert text.count("Permission is hereby granted") >= 4
    assert all("integrity" in about for name, about in lock.items() if name)


def test_a_page_that_fails_is_reported_as_one_that_shows_nothing():
    shot = {"name": "slider", "watch": True, "steps": [["pose", "fist"], ["slide", "#curl1", 0.8]]}
    assert check_web_page.idle(shot, {"ready_s": 0.1, "message": "The hand cannot be shown."}) == []


# ---- how arrays are packed -------------------------------------------------------------------------------------------


# ---- how the page poses ----------------------------------------------------------------------------------------------


def asked(folder: Path, **plan) -> list[dict]:
    """What web_pose.mjs prints; the arrays of `plan` are its own."""
    if NODE is None:
        pytest.skip("there is no node")
    plan = {name: array if name == "suns" else np.asarray(array).tolist() for name, array in plan.items()}
    plan = {"joints": [], "angles": [], "from": [], "eye": EYE_M.tolist()} | plan
    (folder / "plan.json").write_text(json.dumps(plan))
    done = subprocess.run(
        [NODE, str(POSE_SCRIPT), str(folder), str(folder / "plan.json"), str(folder / "out")],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def posed_by_the_page(folder: Path, joints_m: np.ndarray) -> dict[str, np.ndarray]:
    """Positions (F, rows, 3), sigma (F, rows), rgb (F, rows, 3) and covariance (F, rows, 6) of joints (F, 21, 3), all
    from the page's origin."""
    asked(folder, joints=joints_m.reshape(len(joints_m), 63))
    return left_by_the_page(folder, len(joints_m))


def left_by_the_page(folder: Path, frames: int) -> dict[str, np.ndarray]:
    """What is in the file that web_pose.mjs wrote."""
    about = description_of(folder)
    rows, arrays = about["rows"], about["arrays"]
    widths = {"position_m": 3, "sigma_m": 1, "rgb": 3}
    widths |= {"front": 1} if "front" in arrays else {}
    widths |= {"covariance_m2": 6} if "skin.covariance" in arrays else {}
    ends = np.cumsum([width * rows for width in widths.values()])
    *parts, surface = np.split(np.fromfile(folder / "out", "<f4").reshape(frames, -1), ends, 1)
    found = {name: part.reshape(frames, rows, -1) for name, part in zip(widths, parts, strict=True)}
    if "detail.vertex" in arrays:
        count = arrays["detail.vertex"]["shape"][1]
        surface = surface.reshape(frames, -1, count)
        found |= {
            "surface_m": surface[:, :3].swapaxes(1, 2) * (1, 1, -1),
            "slope": surface[:, 3:7],
            "bend": surface[:, 7:],
        }
    return found


def far_apart(folder: Path, avatar: HandAvatar, hand: Handedness = Handedness.RIGHT) -> dict[str, float]:
    """Exports a motion and compares what the page makes of some frames with the functions that the avatar was trained
    with, in float64: the largest differences of positions, mm, colors, 0..1, radii and covariances, as a part."""
    avatar = avatar.for_hand(hand)
    sequence = motion(avatar, hand)
    export_web(folder, avatar, sequence, VIEW)
    shown, _ = with_cheap_correctives(in_studio(avatar))
    origin_m = np.array(description_of(folder)["origin_m"])
    joints_m = sequence.joints_m[[0, 20, 38, 55, -1]] - origin_m
    found = posed_by_the_page(folder, joints_m)
    order, transform, worst = Blocks.of(shown.position_m).order, transform_of(shown), dict[str, float]()
    for frame, joints in enumerate(joints_m):
        bones = transform.bones(torch.from_numpy(joints))
        with torch.no_grad():
            wanted = pose_gaussians(shown, bones, frames=bones.frames, eye_m=torch.from_numpy(EYE_M))
        count = len(order)
        assert (found["sigma_m"][frame, count:] == 0).all()
        scale = {"position_m": 1e-3, "sigma_m": wanted.sigma_m.numpy()[order][:, None], "rgb": 1.0}
        if wanted.covariance_m2 is not None:
            scale["covariance_m2"] = np.linalg.norm(wanted.covariance_m2.numpy()[order], axis=1, keepdims=True)
        if wanted.front is not None:
            scale["front"] = 1.0
        for name, unit in scale.items():
            exact = getattr(wanted, name).numpy()[order].reshape(count, -1)
            if name == "front":
                # the page draws skin that others hide, too
                exact = exact.clip(0)
            off = float((np.abs(found[name][frame, :count] - exact) / unit).max())
            worst[name] = max(worst.get(name, 0.0), off)
    return worst


AVATARS = {
    "painted": small_avatar,
    "network": trained_avatar,
    "linear": lambda: with_linear(trained_avatar()),
    "ellipsoids": ellipsoid_avatar,
    "builtin": lambda: coarse_builtin(6000),
}


@pytest.mark.parametrize("hand", Handedness)
@pytest.mark.parametrize("kind", AVATARS)
def test_the_page_poses_as_the_engine_does(tmp_path, kind, hand):
    worst = far_apart(tmp_path, AVATARS[kind](), hand)
    # sixteen bits of what is read: observed 0.0053 mm (built-in hand 0.0016), 1.11e-4, 3.1e-4, 2.7e-4
    assert worst["position_m"] < 0.006
    assert worst["sigma_m"] < 1.2e-4
    assert worst["rgb"] < 4e-4
    assert worst.get("covariance_m2", 0.0) < 3.5e-4
    assert worst.get("front", 0.0) < 4e-4
    assert ("front" in worst) is (kind == "builtin")


def in_rows_of_the_page(detail: Detail) -> np.ndarray:
    """Which vertex of the surface stands in each of the page's."""
    vertex = one_uv_each(detail.faces, detail.face_uv)[0]
    return vertex[Blocks.of(detail.position_m[vertex]).order]


@pytest.mark.parametrize("hand", Handedness)
def test_the_surface_of_the_detail_moves_with_the_skin_and_has_its_texture(tmp_path, hand):
    avatar = coarse_builtin(500).for_hand(hand)
    detail, sequence = avatar.detail, motion(avatar, hand)
    assert detail is not None
    export_web(tmp_path, avatar, sequence, VIEW)
    joints_m = sequence.joints_m[[0, 20]] - np.array(description_of(tmp_path)["origin_m"])
    found, vertex = posed_by_the_page(tmp_path, joints_m)["surface_m"], in_rows_of_the_page(detail)
    for frame, joints in enumerate(joints_m):
        wanted_m, _ = posed_surface(avatar.with_stiff_wrist(), joints)
        # numbers of 16 bits
        assert np.abs(found[frame, : len(vertex)] - wanted_m[vertex]).max() < 2e-5
    texture = np.fromfile(tmp_path / "out.texture", np.uint8).reshape(detail.size, detail.size, 4)
    skin = skin_texels(detail.face_uv, detail.size)
    assert np.array_equal(texture[skin][:, :3], detail.texture[skin])


@pytest.mark.parametrize("hand", Handedness)
@pytest.mark.parametrize("towards", [None, (0.6, 0.0, 0.8)])
def test_the_light_on_the_relief_turns_with_the_skin_as_the_engine_has_it(tmp_path, hand, towards):
    """At each vertex of the surface, in the light that the hand carries and in one that is turned; and the skin is as
    bent there."""
    avatar = coarse_builtin(500).for_hand(hand)
    detail, sequence = avatar.detail, motion(avatar, hand)
    assert detail is not None
    export_web(tmp_path, avatar, sequence, VIEW)
    joints_m = sequence.joints_m[[0, 20]] - np.array(description_of(tmp_path)["origin_m"])
    asked(tmp_path, joints=joints_m.reshape(2, 63), suns=[towards] * 2)
    page, vertex = left_by_the_page(tmp_path, 2), in_rows_of_the_page(detail)
    shown, _ = with_cheap_correctives(avatar.with_stiff_wrist())
    slope, bend = slopes_of_the_engine(shown, joints_m, towards)
    for frame in range(2):
        # sixteen bits of what is read, of which places say what skin throws onto skin that is near: observed 3.3e-3, of
        # slopes up to 2.2, and 8e-6 in its own light; 2e-5
        off = np.abs(page["slope"][frame, :, : len(vertex)] - slope[frame][:, vertex]).max()
        assert off < (1e-5 if towards is None else 5e-3)
        assert np.abs(page["bend"][frame, 0, : len(vertex)] - bend[frame][vertex]).max() < 3e-5
    assert bend[1].max() > 0.9 > 0.1 > bend[0].mean()


def slopes_of_the_engine(
    avatar: HandAvatar, joints_m: np.ndarray, towards: tuple[float, float, float] | None
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Of each pose (4, V) how light turns with the normal, and along it, and (V,) how bent joints are."""
    avatar = in_studio(avatar) if towards is None else relightable(avatar)
    library, detail = native_library.load(), avatar.detail
    assert detail is not None
    poser = Poser(library, avatar)
    drawn = NativeDetail(library, [DetailedHand.of(avatar, 1.0, poser)])
    (hand,), row = drawn._hands, np.argsort(Blocks.of(detail.position_m).order)
    camera, slopes, bends = Camera(8, 8, 10.0, 10.0, 4.0, 4.0, np.eye(4), orthographic=True), [], []
    for joints in joints_m:
        bones = avatar.skeleton().bones(joints)
        poser.prepare(bones, np.zeros(3), light=None if towards is None else turned_light(towards))
        poser.run()
        drawn.pose([bones], [np.zeros(3)])
        drawn.prepare(np.zeros((5, 8, 8), np.float32), camera, [1.0])
        drawn.find_surface()
        slopes.append(hand._arrays["slope"][:, row].copy())
        bends.append(hand._arrays["bend"][row].copy())
    return slopes, bends


def test_the_relief_of_the_page_rises_as_that_of_the_engine(tmp_path):
    avatar = coarse_builtin(500)
    export_web(tmp_path, avatar, motion(avatar), VIEW)
    asked(tmp_path)
    detail = avatar.detail
    assert detail is not None
    assert detail.slopes is not None
    size = detail.size
    page = np.fromfile(tmp_path / "out.rises", np.uint8).reshape(size, size, 4).astype(int) - 128
    squares = detail.slopes.texels[: size**2].view(np.int8).reshape(size // 4, size // 4, 4, 4, 4)
    engine = squares.swapaxes(1, 2).reshape(size, size, 4)
    skin = skin_texels(detail.face_uv, size)
    # halves may be rounded to the other side; at the edge heights go on in whole steps
    apart = np.abs(page - engine)[skin]
    assert (apart > 1).any(axis=1).mean() < 0.01
    assert np.abs(engine[skin]).max() == 127


def lit_by_the_engine(avatar: HandAvatar, joints_m: np.ndarray, towards: tuple[float, float, float]) -> np.ndarray:
    """(N, 3) scene-linear colors toward EYE_M, in the rows of the kernel."""
    avatar = relightable(avatar)
    poser = Poser(native_library.load(), avatar)
    bones = avatar.skeleton().bones(joints_m)
    poser.prepare(bones, np.zeros(3), light=turned_light(towards))
    poser.run()
    # positions are relative to the root
    assert poser.prepare_gloss(EYE_M - bones.root_m)
    poser.run_gloss()
    return poser.into.rgb


@pytest.mark.parametrize("hand", Handedness)
@pytest.mark.parametrize("kind", ["known", "linear", "builtin"])
def test_the_page_lights_a_hand_as_the_engine_does_and_gives_it_its_own_light_back(tmp_path, kind, hand):
    avatar = {**AVATARS, "known": known_avatar}[kind]().for_hand(hand)
    sequence = motion(avatar, hand)
    export_web(tmp_path, avatar, sequence, VIEW)
    joints_m = sequence.joints_m[[0, 20, 20, -1]] - np.array(description_of(tmp_path)["origin_m"])
    suns = [None, (0.6, 0.0, 0.8), (0.0, -0.6, -0.8), None]
    asked(tmp_path, joints=joints_m.reshape(4, 63), suns=suns)
    lit = left_by_the_page(tmp_path, 4)["rgb"]
    for frame, towards in ((1, suns[1]), (2, suns[2])):
        shown, _ = with_cheap_correctives(avatar)
        # sixteen bits of what is read
        wanted = linear_to_srgb(lit_by_the_engine(shown, joints_m[frame], towards))
        assert np.abs(linear_to_srgb(lit[frame]) - wanted).max() < 5e-3
    asked(tmp_path, joints=joints_m.reshape(4, 63))
    own = left_by_the_page(tmp_path, 4)["rgb"]
    assert np.array_equal(own[[0, 3]], lit[[0, 3]])
    assert np.abs(own[1] - lit[1]).max() > 0.1


def test_a_painted_hand_has_no_light_that_is_turned(tmp_path):
    exported(tmp_path)
    assert description_of(tmp_path)["light"] is None


TURN = Rotation.from_euler("xyz", [40, -70, 120], degrees=True).as_matrix()


def estimated_hands(avatar: HandAvatar, hand: Handedness, count: int = 4) -> np.ndarray:
    """(count, 21, 3) hands as an estimate gives them: with other proportions, crooked, and turned somehow."""
    named = motion(avatar, hand).joints_m
    joints_m = named[np.linspace(0, len(named) - 1, count).astype(int)]
    return (1.2 * joints_m + np.random.default_rng(8).normal(0, 4e-3, joints_m.shape)) @ TURN.T


def test_sliders_pose_as_the_engine_does(tmp_path):
    avatar = small_avatar()
    exported(tmp_path, avatar)
    canonical_m = avatar.canonical_joints_m
    hand = ArticulatedHand(canonical_m)
    angles_deg = np.stack([angles_on(hand, name) for name in ("open", "fist", "ok", "spread")])
    wanted_m = hand.joints(angles_deg) - canonical_m[0]
    for found in asked(tmp_path, angles=np.radians(angles_deg), **{"from": wanted_m.reshape(4, 63)}):
        # observed 6e-17
        assert np.abs(np.array(found["posed"]).reshape(wanted_m.shape) - wanted_m).max() < 1e-12
        assert np.abs(np.degrees(found["back"]) - angles_deg).max() < 1e-9


@pytest.mark.parametrize("hand", Handedness)
def test_a_slider_moves_its_finger_and_no_other_joint_of_any_hand(tmp_path, hand):
    avatar = small_avatar().for_hand(hand)
    export_web(tmp_path, avatar, motion(avatar, hand), VIEW)
    hands_m = estimated_hands(avatar, hand)
    for shown_m, found in zip(hands_m, asked(tmp_path, **{"from": hands_m.reshape(-1, 63)}), strict=True):
        # observed 6e-17
        assert np.abs(np.reshape(found["untouched"], (21, 3)) - shown_m).max() < 1e-12
        for finger, moved in enumerate(found["moved"]):
            off_m = np.linalg.norm(np.reshape(moved, (21, 3)) - shown_m, axis=1)
            its_own = [6 + finger, 11 + finger, 16 + finger]
            assert (off_m[its_own] > 1e-3).all()
            assert np.delete(off_m, its_own).max() < 1e-12


@pytest.mark.parametrize("hand", Handedness)
def test_a_pose_keeps_wrist_knuckles_and_bone_lengths_of_the_hand_that_is_shown(tmp_path, hand):
    avatar = small_avatar().for_hand(hand)
    export_web(tmp_path, avatar, motion(avatar, hand), VIEW)
    hands_m = estimated_hands(avatar, hand)
    angles_deg = angles_on(ArticulatedHand(avatar.canonical_joints_m), "point")[None]
    found = asked(tmp_path, angles=np.radians(angles_deg), **{"from": hands_m.reshape(-1, 63)})
    posed_m = np.reshape([one["posed"] for one in found], (-1, 21, 3))
    # observed 6e-17, 4e-16
    assert np.abs(posed_m[:, :6] - hands_m[:, :6]).max() < 1e-12
    assert np.abs(bone_lengths(posed_m) / bone_lengths(hands_m) - 1).max() < 1e-12
    # a slider that is touched while the hand turns into the pose does not stop it half-way
    assert np.array_equal(np.reshape([one["hurried"] for one in found], (-1, 21, 3)), posed_m)
    # bones are straight, whatever the hand was: observed 3e-14 degrees
    assert max(np.abs(np.degrees(one["back"][0]) - angles_deg[0]).max() for one in found) < 1e-9
