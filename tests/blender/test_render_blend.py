"""From a .blend file to pictures without a window: with a stand-in engine every turn of the run, with the real one the
way as a user goes it."""

import json
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import hands
import numpy as np
import pytest

from blender_addon import registration
from blender_addon.core import posing
from blender_addon.core.view import LIGHT_FROM_WORLD
from blender_addon.hand import armature, sources
from blender_addon.render import camera
from blender_addon.render import command as cli
from blender_addon.renderer import runtime

ROOT = Path(__file__).resolve().parents[2]
SIZE = (128, 84)


@pytest.fixture(autouse=True)
def registered(context) -> Iterator[None]:
    registration.register()
    yield
    registration.unregister()


@pytest.fixture
def engine(monkeypatch, stand_in_command):
    """Lets the command line find the stand-in; call it with a fault to get one that fails."""

    def use(*faults: str) -> None:
        monkeypatch.setattr(runtime, "engine_command", lambda *_, **__: [*stand_in_command, *faults])

    use()
    return use


@pytest.fixture
def blend(context, tmp_path) -> Path:
    """A saved scene: a hand that moves over frames 1 to 4, seen by two cameras."""
    joints = hands.moving_hand_m("right", frames=4)
    hand = hands.keyed_hand(context, "right", joints)
    hand.hide_viewport = True  # as riggers leave it
    camera.set_picture_size(context.scene.render, *SIZE)
    for name, distance in (("CamPalm", 0.5), ("CamSide", 0.7)):
        hands.camera_on(context, (0, 0.09, 0), distance).name = name
    context.scene.camera = bpy.data.objects["CamPalm"]
    context.scene.frame_start, context.scene.frame_end = 1, 4
    return saved(tmp_path)


def saved(folder: Path) -> Path:
    """The scene as a file, its film transparent and its colors as the engine has them."""
    path = folder / "hand.blend"
    scene = bpy.context.scene
    scene.render.film_transparent, scene.render.dither_intensity = True, 0.0
    scene.view_settings.view_transform = "Standard"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
    return path


def rendered(blend: Path, *options: object) -> tuple[int, list[str], dict]:
    """Exit code, written files and report of a run."""
    out, report = blend.parent / "out", blend.parent / "report.json"
    code = cli.main([str(blend), "--out", str(out), "--report", str(report), *map(str, options)])
    files = sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())
    return code, files, json.loads(report.read_text())


def drawn(report: dict) -> int:
    """How many pictures a run rendered."""
    return sum(not picture["skipped"] for picture in report["pictures"])


def test_every_frame_of_every_camera_becomes_a_picture(engine, blend, capsys):
    code, files, report = rendered(blend, "--camera", "CamPalm,CamSide", "--frames", "1-4,3")
    assert code == 0
    assert files == ["CamPalm/0001.png", "CamPalm/0004.png", "CamSide/0001.png", "CamSide/0004.png"]
    assert hands.pixels(blend.parent / "out" / "CamPalm" / "0001.png").shape == (*SIZE[::-1], 4)
    assert (report["wanted"], drawn(report), report["failure"]) == (4, 4, None)
    for picture in report["pictures"]:
        assert picture["reports"][0]["total_ms"] > 0
        assert min(picture[name] for name in ("evaluate_ms", "request_ms", "write_ms")) > 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("frame ")]
    assert len(lines) == 4
    assert "4 of 4" in lines[-1]


def test_the_command_of_an_installed_extension_is_the_same_run(engine, blend, capsys):
    for words in ([], ["train"], ["render"], ["render", "x.blend"], ["render", "x.blend", "--frames", "4-1"]):
        assert cli.command(words) == 2
    assert cli.command(["--help"]) == 0
    assert cli.command(["render", "--help"]) == 0
    assert "--command jghand render" in capsys.readouterr().out
    options = [str(blend), "--frames", "1-2", "--out"]
    assert cli.command(["render", *options, str(blend.parent / "command")]) == 0
    assert cli.main([*options, str(blend.parent / "script")]) == 0
    for frame in ("0001.png", "0002.png"):
        one, other = ((blend.parent / folder / "CamPalm" / frame).read_bytes() for folder in ("command", "script"))
        assert one == other


def test_without_options_the_scenes_own_camera_and_range_are_rendered(engine, blend):
    code, files, _ = rendered(blend)
    assert code == 0
    assert files == [f"CamPalm/{frame:04d}.png" for frame in (1, 2, 3, 4)]


def test_a_run_goes_on_where_the_last_one_stopped(engine, blend):
    rendered(blend)
    out = blend.parent / "out" / "CamPalm"
    (out / "0003.png").unlink()
    (out / "0001.png").write_bytes(b"mine")
    code, _, report = rendered(blend)
    assert code == 0
    assert (drawn(report), len(report["pictures"])) == (1, 4)
    assert (out / "0001.png").read_bytes() == b"mine"
    _, _, report = rendered(blend, "--overwrite")
    assert drawn(report) == 4
    assert (out / "0001.png").read_bytes() != b"mine"


def test_the_pictures_of_two_cameras_never_lie_in_one_folder(engine, blend):
    bpy.data.objects["CamSide"].name = "campalm"
    code, files, report = rendered(saved(blend.parent), "--camera", "CamPalm,campalm")
    assert code == 2
    assert report["failure"]["kind"] == "same_folder"
    assert files == []


def test_cameras_may_be_named_one_by_one_and_have_a_comma_in_their_name(engine, blend):
    bpy.data.objects["CamSide"].name = "side, left"
    options = ("--frames", "1", "--camera", "CamPalm", "--camera", "side, left")
    code, files, _ = rendered(saved(blend.parent), *options)
    assert code == 0
    assert files == ["CamPalm/0001.png", "side_ left/0001.png"]


@pytest.mark.parametrize("name", ["a {frame} b", "take #2", "{", "Ünicode ##"])
def test_the_folder_of_the_pictures_may_have_any_name(engine, blend, name):
    out = blend.parent / name
    for rendered_now in (2, 0):
        report = blend.parent / "report.json"
        assert cli.main([str(blend), "--out", str(out), "--frames", "1-2", "--report", str(report)]) == 0
        assert drawn(json.loads(report.read_text())) == rendered_now
        assert sorted(path.name for path in (out / "CamPalm").iterdir()) == ["0001.png", "0002.png"]


def test_a_combined_scene_keeps_its_engine_and_hands_that_fail_are_in_the_exit_code(engine, blend):
    current = bpy.context.scene
    current.render.engine, current.cycles.samples = "CYCLES", 1
    bpy.ops.jghand.combine_with_scene()
    bpy.data.objects["right"].scale.x = 0
    code, files, report = rendered(saved(blend.parent), "--frames", "1-2")
    assert (code, report["failure"]["kind"]) == (2, "zero_scale")
    assert files == ["CamPalm/0001.png", "CamPalm/0002.png"]
    assert (hands.pixels(blend.parent / "out" / files[0])[..., :3] == (1, 0, 1)).all()


def test_the_file_itself_stays_as_it_was(engine, blend):
    before = blend.read_bytes()
    rendered(blend, "--frames", "2")
    assert blend.read_bytes() == before


def test_the_hands_of_a_foreign_rig_and_of_21_objects_are_drawn_too(engine, context, tmp_path):
    rig, joints = hands.mixamo_rig(context)
    for handedness in joints:
        sources.store_map(rig, sources.recognize(rig, handedness).bone_map)
    things = []
    for place in posing.rest_joints_m("left") + joints["left"][0] - (0.6, 0, 0):
        things.append(bpy.data.objects.new("joint", None))
        things[-1].location = place
        things[-1].hide_viewport = True  # as riggers leave them
        context.scene.collection.objects.link(things[-1])
    holder = bpy.data.objects.new("Hand", None)
    context.scene.collection.objects.link(holder)
    sources.store_objects(holder, things, "left")
    eye = hands.camera_on(context, (0, 0, 0), 1)
    eye.matrix_world = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 3.2, 1.0]])
    camera.set_picture_size(context.scene.render, 600, 100)  # wide enough for the stand-in's discs
    context.scene.camera = eye
    code, _, report = rendered(saved(tmp_path), "--frames", "1")
    assert (code, drawn(report)) == (0, 1)
    context = bpy.context
    view = camera.pinhole(context.scene.camera, context.evaluated_depsgraph_get())
    picture = hands.pixels(tmp_path / "out/Camera/0001.png")
    shown = {"right": joints["right"][0], "left": joints["left"][0], "objects": joints["left"][0] - (0.6, 0, 0)}
    for name, wrist in shown.items():  # the stand-in draws a right hand white, a left one blue
        column, row, _ = view.project(wrist).astype(int)
        near = picture[row - 4 : row + 5, column - 4 : column + 5].reshape(-1, 4)
        assert {tuple(color) for color in near if color[3]} == {(1, 1, 1, 1) if name == "right" else (0, 0, 1, 1)}


def hidden() -> None:
    bpy.data.objects["right"].hide_render = True


def without_a_hand() -> None:
    bpy.data.objects.remove(bpy.data.objects["right"])


def without_a_camera() -> None:
    bpy.context.scene.camera = None


@pytest.mark.parametrize(
    ("change", "kind"), [(hidden, "no_hand"), (without_a_hand, "no_hand"), (without_a_camera, "no_camera")]
)
def test_a_scene_that_shows_no_hand_is_bad_input_and_no_run_of_empty_pictures(engine, blend, change, kind):
    change()
    code, files, report = rendered(saved(blend.parent))
    assert (code, report["failure"]["kind"]) == (2, kind)
    assert files == []


@pytest.mark.parametrize(
    ("fault", "code", "kind"),
    [
        ("die", 3, "crashed"),
        ("killed", 4, "killed"),
        ("memory", 4, "out_of_memory"),
        ("bug", 1, "internal"),
        ("die_at_start", 3, "crashed"),
        ("wrong_version", 2, "protocol"),
    ],
)
def test_a_failing_engine_ends_the_run_with_its_code_and_nothing_half_written(engine, blend, fault, code, kind, capsys):
    engine(fault)
    came, files, report = rendered(blend, "--frames", "1-2")
    assert came == code
    assert files == []
    assert report["failure"]["kind"] == kind
    assert report["failure"]["sentence"] in capsys.readouterr().err


@pytest.mark.skipif(os.name == "nt", reason="Windows cannot send Ctrl-C to one process")
def test_a_run_that_is_interrupted_says_so_in_its_exit_code_and_its_report(blend, stand_in_command):
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from blender_addon.render import command\n"
        "from blender_addon import registration; registration.register()\n"
        "from blender_addon.renderer import runtime; runtime.engine_command = lambda *_, **__: sys.argv[3:]\n"
        "print('starts', flush=True); sys.exit(command.main(sys.argv[2].split('|')))"
    )
    report = blend.parent / "report.json"
    options = [str(blend), "--out", str(blend.parent / "out"), "--report", str(report)]
    command = [sys.executable, "-c", code, str(ROOT), "|".join(options), *stand_in_command, "slow"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    with process.stdout:
        while not process.stdout.readline().startswith("frame 1 "):
            pass
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130
    content = json.loads(report.read_text())
    assert content["failure"]["kind"] == "interrupted"
    assert (content["wanted"], drawn(content)) == (4, 1)


def test_a_file_that_is_not_there_or_no_blend_file_is_bad_input(engine, tmp_path):
    for content in (None, b"no blend file"):
        path = tmp_path / "hand.blend"
        if content is not None:
            path.write_bytes(content)
        code, _, report = rendered(path)
        assert code == 2
        assert report["failure"]["kind"] == "bad_file"


def test_a_camera_that_is_not_there_is_bad_input_and_the_others_are_named(engine, blend, capsys):
    code, _, report = rendered(blend, "--camera", "CamPalm,CamTop")
    assert code == 2
    assert report["failure"]["kind"] == "not_a_camera"
    assert "CamSide" in capsys.readouterr().err


def test_region_film_and_depth_of_the_file_are_honored(engine, blend):
    render = bpy.context.scene.render
    render.use_border, render.use_crop_to_border = True, True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.75, 0.0, 0.5
    render.image_settings.color_mode, render.image_settings.color_depth = "RGB", "16"
    assert rendered(saved(blend.parent), "--frames", "1")[0] == 0
    content = (blend.parent / "out/CamPalm/0001.png").read_bytes()
    assert struct.unpack(">IIBB", content[16:26]) == (SIZE[0] // 2, SIZE[1] // 2, 16, 2)


def driven(thing: bpy.types.ID, path: str, expression: str) -> None:
    driver = thing.driver_add(path, 0).driver
    driver.expression = expression


def test_a_python_driver_that_is_blocked_ends_the_run_and_works_when_it_is_allowed(engine, blend):
    driven(bpy.data.objects["right"], "location", "[0.1 for _ in (1,)][0]")
    code, files, report = rendered(saved(blend.parent), "--frames", "1")
    assert code == 2
    assert report["failure"]["kind"] == "scripts_blocked"
    assert files == []
    code, _, _ = rendered(saved(blend.parent), "--frames", "1", "--allow-scripts")
    assert code == 0


def test_a_folder_that_cannot_be_written_is_bad_input(engine, blend):
    (blend.parent / "out").touch()
    code = cli.main([str(blend), "--out", str(blend.parent / "out"), "--frames", "1"])
    assert code == 2


def script(name: str, *arguments: object) -> subprocess.CompletedProcess:
    """Runs one of the project's scripts in this Python, as a user does."""
    command = [sys.executable, str(ROOT / "scripts" / name), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def motion_file(folder: Path, handedness: str = "right", changes: dict | None = None) -> Path:
    joints = hands.moving_hand_m(handedness, frames=3)
    content = {"joints_m": joints, "order": "standard", "unit": "m", "fps": 24.0, "handedness": handedness}
    np.savez_compressed(folder / "motion.npz", **{**content, **(changes or {})})
    return folder / "motion.npz"


def test_the_demo_scene_is_built_from_a_motion_file(context, tmp_path):
    words = ("--motion", motion_file(tmp_path, "left"), "--out", tmp_path / "hand.blend", "--avatar", "painted")
    done = script("build_demo_scene.py", *words)
    assert done.returncode == 0, done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "hand.blend"))
    built = bpy.context.scene
    assert {thing.name for thing in built.objects if thing.type == "CAMERA"} == {"CamPalm", "CamSide"}
    assert (built.frame_start, built.frame_end, built.render.fps) == (1, 3, 24)
    assert camera.picture_size(built.render) == (512, 334)
    (hand,) = armature.hands_at_any_frame(bpy.context.view_layer)
    assert hand.jghand.avatar == "painted"
    seen = armature.read_hand(hand, armature.at_frame(built, 3))
    x, y, z = hands.moving_hand_m("left", frames=3)[2].T  # in motions +y is up
    np.testing.assert_allclose(seen.joints_world_m, np.stack([x, -z, y], -1), atol=2e-7)


def test_the_demo_scene_takes_cameras_from_a_file(context, tmp_path):
    view = {"width": 200, "height": 100, "fx": 300, "fy": 300, "cx": 90, "cy": 55}
    matrix = np.diag([1.0, -1, -1, 1])
    matrix[2, 3] = 0.5
    (tmp_path / "cameras.json").write_text(json.dumps({"front": {**view, "camera_from_world": matrix.tolist()}}))
    files = ["--motion", motion_file(tmp_path), "--cameras", tmp_path / "cameras.json", "--out", tmp_path / "a.blend"]
    done = script("build_demo_scene.py", *files)
    assert done.returncode == 0, done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    seen = camera.pinhole(bpy.data.objects["front"], bpy.context.evaluated_depsgraph_get())
    assert (seen.width, seen.height) == (200, 100)
    assert (seen.fx, seen.cx, seen.cy) == pytest.approx((300, 90, 55), abs=1e-3)
    # in cameras of motions +y is up
    np.testing.assert_allclose(seen.camera_from_world @ LIGHT_FROM_WORLD.T, matrix, atol=1e-6)
    assert bpy.context.scene.render.film_transparent


@pytest.mark.parametrize("changes", [{"order": "mano16_tips"}, {"fps": "fast"}], ids=["another order", "no number"])
def test_a_motion_that_cannot_be_used_is_bad_input_and_writes_nothing(tmp_path, changes):
    motion = motion_file(tmp_path, changes=changes)
    done = script("build_demo_scene.py", "--motion", motion, "--out", tmp_path / "hand.blend")
    assert done.returncode == 2
    assert "build_demo_scene:" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "hand.blend").exists()


def test_a_python_without_numpy_and_bpy_is_told_which_one_to_use():
    for name, arguments in (
        ("build_demo_scene.py", ["--motion", "x.npz", "--out", "x.blend"]),
        ("render_blend.py", ["x.blend", "--out", "x"]),
    ):
        command = [sys.executable, "-I", "-S", str(ROOT / "scripts" / name), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 2
        assert ".envs/blender/bin/python" in done.stderr
        assert "Traceback" not in done.stderr


def test_the_real_engine_renders_a_blend_file(engine_python, blend):
    out = blend.parent / "real"
    done = script("render_blend.py", blend, "--out", out, "--frames", "1", "--engine-python", engine_python)
    assert done.returncode == 0, done.stderr
    picture = hands.pixels(out / "CamPalm" / "0001.png")
    assert picture.shape == (*SIZE[::-1], 4)
    assert 0.02 < (picture[..., 3] > 0.5).mean() < 0.7
    skin = picture[picture[..., 3] > 0.9][:, :3].mean(0)
    assert skin[0] > skin[2] > 0.1  # skin is reddish, and neither black nor white
    assert skin[0] < 0.98


# ---- markers that choose the camera ----------------------------------------------------------------------------------


def mark(frame: int, eye: str) -> None:
    bpy.context.scene.timeline_markers.new(eye, frame=frame).camera = bpy.data.objects[eye]


def test_a_scene_without_a_camera_is_seen_by_those_of_its_markers(engine, blend):
    mark(3, "CamSide")
    mark(1, "CamPalm")
    mark(1, "CamSide")
    bpy.context.scene.camera = None
    code, files, _ = rendered(saved(blend.parent), "--frames", "2-3")
    assert (code, files) == (0, ["CamPalm/0002.png", "CamPalm/0003.png"])
