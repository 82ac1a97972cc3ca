"""Exports, bakes and Blender's own USD export: what is written is what the scene shows."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from hands import PLACES, keyed_hand, mixamo_rig, moving_hand_m, put
from recording_layout import draw

import blender_addon
from blender_addon import folders, ui
from blender_addon.errors import JGHandFailure
from blender_addon.export import bakes, ops_common, recording, usd_hook
from blender_addon.export import panel as output
from blender_addon.export.ops import Bake, Export
from blender_addon.export.ops_common import StartsJob
from blender_addon.hand import armature, sources
from blender_addon.hand.motion_files import read_motion
from blender_addon.renderer import runtime
from blender_addon.renderer.jobs import JobSpec, JobTable
from blender_addon.renderer.process import VARIABLE
from blender_addon.viewport import handlers

FRAMES = 4
PANELS = (output.BakePanel, output.ExportPanel)
STAND_IN = Path(__file__).resolve().parents[1] / "addon_core" / "stand_in_job.py"
# float32 of Blender's bones, half a meter from the origin
JOINT_ERROR_M = 1e-6


@pytest.fixture
def extension(context):
    """The extension in an empty scene; the painted avatar on hands keeps exports small and quick."""
    blender_addon.register()
    context.scene.frame_start, context.scene.frame_end = 3, 2 + FRAMES
    yield context
    for job in runtime.jobs.running:
        job.kill()
    blender_addon.unregister()


def a_hand(context, handedness="right", place="moved and turned"):
    hand = keyed_hand(context, handedness, moving_hand_m(handedness, FRAMES))
    for bag in hand.animation_data.action.layers[0].strips[0].channelbags:
        for curve in bag.fcurves:
            for key in curve.keyframe_points:
                key.co.x += 2
    put(hand, PLACES[place])
    hand.jghand.avatar = "painted"
    context.view_layer.objects.active = hand
    hand.select_set(True)
    context.view_layer.update()
    return hand


def seen_joints(context, hand) -> np.ndarray:
    """(F, 21, 3) in the world, frame by frame, by another way than the recording's."""
    joints = []
    for frame in range(context.scene.frame_start, context.scene.frame_end + 1):
        context.scene.frame_set(frame)
        (one,) = sources.read_hands(hand, context.evaluated_depsgraph_get())
        joints.append(one.joints_world_m)
    return np.array(joints)


def save_as(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)


# ---- recordings ------------------------------------------------------------------------------------------------------


def test_a_motion_file_holds_the_joints_of_the_world_and_the_scene_stays_where_it_was(extension, tmp_path):
    hand = a_hand(extension)
    wanted = seen_joints(extension, hand)
    extension.scene.frame_set(4)
    settings = extension.scene.jghand.output
    settings.format, settings.folder = "motion", str(tmp_path)
    assert bpy.ops.jghand.export() == {"FINISHED"}
    assert extension.scene.frame_current == 4
    motion = read_motion(tmp_path / f"{hand.name}.npz")
    assert (motion.handedness, motion.fps) == ("right", 24)
    assert np.abs(motion.joints_m - wanted).max() <= JOINT_ERROR_M


def test_a_rig_with_two_hands_is_two_recordings(extension):
    rig, joints = mixamo_rig(extension)
    for side in joints:
        sources.store_map(rig, sources.recognize(rig, side).bone_map)
    into = []
    parts = list(ops_common.record_steps(extension, [rig], range(1, 3), into))
    assert parts == [0.5, 1.0]
    assert [(one.name, one.handedness) for one in into] == [("Body_right", "right"), ("Body_left", "left")]


def test_a_hand_that_cannot_be_read_is_a_report_and_nothing_is_written(extension, tmp_path):
    hand = a_hand(extension)
    hand.scale.x = 0
    settings = extension.scene.jghand.output
    settings.format, settings.folder = "motion", str(tmp_path / "out")
    with pytest.raises(RuntimeError, match="A scale of zero"):
        bpy.ops.jghand.export()
    assert not (tmp_path / "out").exists()


def test_a_folder_beside_a_file_that_was_never_saved_is_refused(extension):
    a_hand(extension)
    extension.scene.jghand.output.format = "motion"
    with pytest.raises(RuntimeError, match="Save the file first"):
        bpy.ops.jghand.export()


# ---- overwriting -----------------------------------------------------------------------------------------------------


def overwritten(operator: type[StartsJob], context) -> str:
    """What a click on the operator's button would overwrite, in words."""
    pressed = SimpleNamespace(recorded_hands=lambda where: operator.recorded_hands(SimpleNamespace(), where))
    return operator.overwritten(pressed, context)


@pytest.mark.parametrize("kind", ["motion", "usd", "ply"])
def test_a_click_is_told_which_exports_it_would_overwrite(extension, tmp_path, kind):
    hand = a_hand(extension)
    settings = extension.scene.jghand.output
    settings.format, settings.folder = kind, str(tmp_path)
    for name in ("right_2.npz", "right_2.usda", "right_2.0001.ply"):
        (tmp_path / name).touch()
    assert overwritten(Export, extension) == ""
    hand.name = "right_2"
    assert overwritten(Export, extension) == f"{tmp_path} has exports of right_2"


def test_a_click_on_bake_is_told_of_the_bake_that_is_there(baked):
    context, hand, _ = baked
    assert overwritten(Bake, context) == f"There is a bake in {bakes.folder_of(hand)}"
    hand.name = "other"
    assert overwritten(Bake, context) == ""


# ---- jobs ------------------------------------------------------------------------------------------------------------


def test_ply_files_are_numbered_as_the_scenes_frames(extension, engine, tmp_path):
    hand = a_hand(extension)
    settings = extension.scene.jghand.output
    settings.format, settings.folder = "ply", str(tmp_path)
    assert bpy.ops.jghand.export() == {"FINISHED"}
    assert sorted(path.name for path in tmp_path.glob("*.*") if path.name[0] != ".") == [
        f"{hand.name}.{n:04d}.ply" for n in (3, 4, 5, 6)
    ]


@pytest.mark.parametrize(("surfels", "least", "most"), [(False, 30_000, 41_000), (True, 55_000, 60_000)])
def test_splats_of_a_scene_that_lights_its_hands_show_its_light(extension, engine, tmp_path, surfels, least, most):
    hand, scene = a_hand(extension), extension.scene
    hand.jghand.avatar = "builtin"
    scene.frame_end = scene.frame_start
    settings, lamp = scene.jghand.output, bpy.data.lights.new("Lamp", "SUN")
    settings.format, settings.folder, settings.axes, settings.surfel_count = "ply", str(tmp_path), "rub", 60_000
    settings.use_surfels = surfels
    scene.collection.objects.link(bpy.data.objects.new("Lamp", lamp))
    lamp.energy, scene.world, scene.jghand.light = 3, None, "SCENE"
    reds = {}
    # from above, and from below
    for way in (0, np.pi):
        bpy.data.objects["Lamp"].rotation_euler = (way, 0, 0)
        assert bpy.ops.jghand.export() == {"FINISHED"}
        (path,) = tmp_path.glob("*.ply")
        header, _, body = path.read_bytes().partition(b"end_header\n")
        assert b"light=scene" in header
        table = np.frombuffer(body, "<f4").reshape(-1, header.count(b"property float"))
        assert least < len(table) <= most
        reds[way] = table[:, 6]
        path.unlink()
    # what one lights is dark in the other
    assert np.corrcoef(reds[0], reds[np.pi])[0, 1] < 0


def test_what_the_engine_refuses_is_told_with_its_own_words(extension, engine, tmp_path):
    hand = a_hand(extension)
    hand.jghand.avatar = str(tmp_path / "none.jghand")
    extension.scene.jghand.output.folder = str(tmp_path)
    with pytest.raises(RuntimeError, match=r"none\.jghand"):
        bpy.ops.jghand.export()
    job = runtime.jobs.get(runtime.EXPORT)
    assert job is not None
    assert job.state.failure is not None
    assert bpy.ops.jghand.show_log(key=runtime.EXPORT) == {"FINISHED"}


def test_a_job_is_shown_in_the_panel_that_started_it_and_keeps_the_other_from_writing(extension, monkeypatch):
    a_hand(extension)
    monkeypatch.setattr(runtime, "jobs", JobTable())
    runtime.jobs.start(runtime.BAKE, JobSpec("Baking", (sys.executable, "-I", str(STAND_IN), "long")))
    bars = [[one.function for one in draw(each, extension).drawn].count("progress") for each in PANELS]
    assert bars == [1, 0]
    assert not bpy.ops.jghand.export.poll()


def test_a_blender_without_usd_says_so_in_a_sentence_and_looks_for_it_once(extension, monkeypatch):
    a_hand(extension)
    looks = []

    def program(*, usd: bool = False, **_: object) -> tuple[str, ...]:
        looks.append(usd)
        raise JGHandFailure("no_usd")

    monkeypatch.setattr(runtime, "program", program)
    for panel in PANELS:
        assert "This Blender cannot read or write USD" in " ".join(draw(panel, extension).texts)
        assert not bpy.ops.jghand.bake.poll()
        assert not bpy.ops.jghand.export.poll()
    extension.scene.jghand.output.format = "ply"
    assert "USD" not in " ".join(draw(output.ExportPanel, extension).texts)
    looks.clear()
    with monkeypatch.context() as in_a_window:
        timers = SimpleNamespace(is_registered=lambda _: True)
        window = SimpleNamespace(app=SimpleNamespace(background=False, timers=timers))
        in_a_window.setattr(ui, "bpy", window)
        for _ in range(3):
            ops_common.poll_usd(Bake, extension)
    assert not looks, "a redraw reads nothing: the timer does"
    assert (ops_common.lacks_usd, extension.scene.session_uid, ()) in ui._wanted
    ui._wanted.clear()


def a_copy(made: Path, make: Callable[[Path], None], tmp_path: Path) -> bpy.types.Object:
    """The hand of a file that was made once, with all that lies beside it: each test has a copy of its own."""
    if not (made / "whole").exists():
        shutil.rmtree(made, ignore_errors=True)
        save_as(made / "scene.blend")
        make(made)
        bpy.ops.wm.save_mainfile()
        (made / "whole").touch()
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    (tmp_path / "whole").unlink()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    return bpy.context.object


@pytest.fixture
def baked(extension, engine, tmp_path, tmp_path_factory):
    """A scene, saved, with a baked hand: (context, hand, joints)."""

    def make(folder: Path) -> None:
        hand = a_hand(extension)
        bpy.context.scene.jghand.output.bake_folder = "//bakes"
        assert bpy.ops.jghand.bake() == {"FINISHED"}
        np.save(folder / "joints.npy", seen_joints(bpy.context, hand))

    hand = a_copy(tmp_path_factory.getbasetemp() / "baked", make, tmp_path)
    return bpy.context, hand, np.load(tmp_path / "joints.npy")


def cloud_positions(context, cloud) -> np.ndarray:
    """(N, 3) in the world, Blender units."""
    now = cloud.evaluated_get(context.evaluated_depsgraph_get())
    values = np.zeros(len(now.data.attributes["position"].data) * 3, np.float32)
    now.data.attributes["position"].data.foreach_get("vector", values)
    world = np.array(now.matrix_world)
    return values.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]


def test_a_bake_plays_where_the_hand_is_without_engine_and_extension(baked, tmp_path, monkeypatch):
    context, hand, joints = baked
    monkeypatch.delenv(VARIABLE)
    if bpy.ops.jghand.play_bake() != {"FINISHED"}:
        pytest.fail("the bake does not play")
    (cloud,) = bakes.playing(context.scene, bakes.folder_of(hand))
    name = cloud.name
    blender_addon.unregister()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    # the farm has the file and the bake elsewhere, and nothing of JGHand
    moved = tmp_path / "farm"
    moved.mkdir()
    shutil.move(tmp_path / "scene.blend", moved / "scene.blend")
    shutil.move(tmp_path / "bakes", moved / "bakes")
    bpy.ops.wm.open_mainfile(filepath=str(moved / "scene.blend"))
    cloud = bpy.data.objects[name]
    seen = []
    for place, frame in enumerate(range(3, 3 + FRAMES)):
        bpy.context.scene.frame_set(frame)
        positions = cloud_positions(bpy.context, cloud)
        # the skin is around the joints: no joint is further from it than a palm is thick
        far = [np.linalg.norm(positions - joint, axis=1).min() for joint in joints[place]]
        assert max(far) < 0.03
        seen.append(positions)
    assert np.abs(np.diff(seen, axis=0)).max() > 0.005, "it moves"
    assert cloud.data.materials[0].name == bakes.MATERIAL
    blender_addon.register()


def test_a_bake_of_another_pose_or_avatar_says_so_where_it_is_played(baked, capfd):
    context, hand, _ = baked
    for change in ("moves in another way", "avatar is another one"):
        if "moves" in change:
            hand.location.x += 0.01
        else:
            hand.jghand.avatar = ""
        context.view_layer.update()
        assert bpy.ops.jghand.play_bake() == {"FINISHED"}
        assert change in capfd.readouterr().out
    assert bpy.ops.jghand.clear_bake() == {"FINISHED"}
    assert not [thing for thing in context.scene.objects if thing.type == "POINTCLOUD"]
    assert hand.jghand.show_in_viewport


def test_a_bake_knows_whether_it_has_the_forearm_that_the_hand_shows(baked, monkeypatch):
    context, hand, _ = baked

    def reasons() -> list[str]:
        folder = bakes.folder_of(hand)
        return bakes.stale_now(hand, context.evaluated_depsgraph_get(), bakes.read_bake(folder))

    hand.jghand.forearm = False
    assert not reasons(), "its avatar has none"
    monkeypatch.setattr(recording.avatar_files, "has_forearm", lambda avatar: True)
    assert reasons() == ["Forearm was switched"]
    assert bpy.ops.jghand.bake() == {"FINISHED"}
    assert not reasons()
    hand.jghand.forearm = True
    assert reasons() == ["Forearm was switched"]


def test_what_plays_a_bake_shows_the_new_one_when_it_is_baked_again(baked):
    """USD keeps an open file as it was read: without care the old frames would play on."""
    context, hand, _ = baked
    bpy.ops.jghand.play_bake()
    folder = bakes.folder_of(hand)
    context.scene.frame_set(3)
    (played,) = bakes.playing(context.scene, folder)
    before = cloud_positions(context, played)
    played.name, played.pass_index, played.parent = "Mine", 7, bpy.data.objects.new("parent", None)
    played.data.materials[0] = bpy.data.materials.new("My Skin")
    played.modifiers.new("Mine", "NODES")
    hand.location.x += 0.25
    context.view_layer.update()
    assert bpy.ops.jghand.bake() == {"FINISHED"}
    assert context.object == hand
    (cloud,) = bakes.playing(context.scene, bakes.folder_of(hand))
    after = cloud_positions(context, cloud)
    assert np.abs(after - before - [0.25, 0, 0]).max() < 1e-5
    assert len(bpy.data.cache_files) == len(bpy.data.pointclouds) == 1
    assert (cloud, cloud.name, cloud.pass_index, cloud.parent) == (played, "Mine", 7, bpy.data.objects["parent"])
    assert [material.name for material in cloud.data.materials] == ["My Skin"]
    assert [modifier.type for modifier in cloud.modifiers] == ["MESH_SEQUENCE_CACHE", "NODES"]


def test_the_panel_says_what_is_baked_and_that_what_plays_is_stale(baked):
    context, hand, _ = baked
    context.scene.frame_set(4)
    assert "Baked: frames 3 to 6" in " ".join(draw(output.BakePanel, context).texts)
    assert "not what" not in " ".join(draw(output.BakePanel, context).texts)
    hand.location.x += 0.01
    context.view_layer.update()
    assert "The bake is not what the scene has: the hand moves" in " ".join(draw(output.BakePanel, context).texts)
    bpy.ops.jghand.play_bake()
    assert "What plays here is not what the scene has" in " ".join(draw(output.BakePanel, context).texts)
    (bakes.folder_of(hand) / bakes.STAMP).unlink()
    assert "no finished bake" in " ".join(draw(output.BakePanel, context).texts)


def failing_engine(monkeypatch):
    monkeypatch.setattr(runtime, "program", lambda **_: (sys.executable, "-I", str(STAND_IN), "die"))


def test_a_bake_that_fails_loses_nothing_of_the_one_before(baked, tmp_path, monkeypatch):
    context, hand, _ = baked
    before = bakes.folder_of(hand)
    bpy.ops.jghand.play_bake()
    failing_engine(monkeypatch)
    with pytest.raises(RuntimeError, match="stopped unexpectedly"):
        bpy.ops.jghand.bake()
    assert bakes.folder_of(hand) == before
    assert bakes.read_bake(before)
    assert bakes.playing(context.scene, before)
    assert [path.name for path in before.parent.iterdir()] == ["right"]


def test_a_linked_hand_of_the_same_name_has_a_bake_of_its_own(extension, tmp_path, monkeypatch):
    a_hand(extension)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"), copy=True)
    bpy.ops.wm.link(directory=str(tmp_path / "library.blend" / "Object") + "/", filename="right")
    assert [hand.name for hand in armature.hands_at_any_frame(extension.view_layer)] == ["right", "right"]
    extension.scene.jghand.output.bake_folder = str(tmp_path / "bakes")
    extension.scene.jghand.output.hands = "all"
    failing_engine(monkeypatch)
    specs = []

    def start(_key, spec):
        specs.append(spec)
        raise JGHandFailure("retry")

    monkeypatch.setattr(runtime, "start_job", start)
    with pytest.raises(RuntimeError):
        bpy.ops.jghand.bake()
    names = [command[command.index("--name") + 1] for command in (specs[0].command, *specs[0].more)]
    assert names == ["right", "right_2"]


def test_files_of_one_folder_bake_and_export_into_folders_of_their_own(extension, tmp_path):
    settings = extension.scene.jghand.output
    for name in ("one", "two"):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / f"{name}.blend"))
        for folder in (settings.bake_folder, settings.folder):
            assert ops_common.place(bpy.context, folder).name == name


def test_what_jobs_are_given_is_in_a_folder_of_each_and_gone_when_they_are_over(extension, engine, tmp_path):
    one, other = folders.job_folder(), folders.job_folder()
    assert one != other
    for folder in (one, other):
        folder.rmdir()
    a_hand(extension)
    extension.scene.jghand.output.folder = str(tmp_path / "out")
    before = set(folders.user_folder("jobs").iterdir())
    bpy.ops.jghand.export()
    assert set(folders.user_folder("jobs").iterdir()) == before


# ---- Blender's own USD export ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("y_up", [False, True])
@pytest.mark.parametrize("with_root", [True, False])
def test_blenders_own_usd_export_has_the_splats_where_the_hand_is(baked, tmp_path, capfd, y_up, with_root):
    from pxr import Usd, UsdGeom

    *_, joints = baked
    name = f"whole_{y_up}_{with_root}.usdc"
    options = {} if with_root else {"root_prim_path": ""}
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.wm.usd_export(filepath=str(tmp_path / name), export_animation=True, convert_orientation=y_up, **options)
    assert "left out" not in capfd.readouterr().err
    stage = Usd.Stage.Open(str(tmp_path / name))
    (prim,) = [prim for prim in stage.Traverse() if prim.GetTypeName() == usd_hook.SPLAT_TYPE]
    assert stage.GetPrimAtPath("/root/Cube" if with_root else "/Cube")
    turn = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]) if y_up else np.eye(3)
    for place, frame in enumerate(range(3, 3 + FRAMES)):
        world = np.array(UsdGeom.XformCache(frame).GetLocalToWorldTransform(prim))
        positions = np.array(prim.GetAttribute("positions").Get(frame))
        positions = positions @ world[:3, :3] + world[3, :3]
        far = [np.linalg.norm(positions - turn @ joint, axis=1).min() for joint in joints[place]]
        assert max(far) < 0.03
    assert stage.GetMetadata("fallbackPrimTypes")
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (3, 2 + FRAMES)


def test_usd_core_finds_the_baked_splats_in_blenders_export(baked, engine, tmp_path):
    """Read by another USD, newer than Blender's; what it finds wrong is Blender's own skeleton, and nothing of ours."""
    _, hand, _ = baked
    code = """
import json, sys
import numpy as np
from pxr import Usd
from jghand_engine.export.usd.check import check_usd
whole, bake, report = sys.argv[1:]
def positions(path):
    stage = Usd.Stage.Open(path)
    stage.SetEditTarget(stage.GetSessionLayer())
    for prim in stage.Traverse():
        if prim.GetVariantSets().HasVariantSet("representation"):
            prim.GetVariantSet("representation").SetVariantSelection("splats")
    (prim,) = [one for one in stage.Traverse() if one.GetTypeName() == "ParticleField3DGaussianSplat"]
    return np.stack([np.array(prim.GetAttribute("positions").Get(frame)) for frame in (3, 4, 5, 6)])
same = bool((positions(whole) == positions(bake)).all())
json.dump({"same": same, "found": [str(one) for one in check_usd(whole)]}, open(report, "w"))
"""
    folder = bakes.folder_of(hand)
    for name in ("whole.usdc", "whole.usdz"):
        (tmp_path / "out").mkdir(exist_ok=True)
        path, report = tmp_path / "out" / name, tmp_path / "report.json"
        assert bpy.ops.wm.usd_export(export_animation=True, filepath=str(path)) == {"FINISHED"}
        command = [engine, "-I", "-c", code, str(path), str(folder / f"{hand.name}.usda"), str(report)]
        subprocess.run(command, check=True, timeout=120)
        said = json.loads(report.read_text())
        assert said["same"]
        assert [one for one in said["found"] if "InvalidSkelBindingAPIApply" not in one] == []


def test_a_scene_in_centimeters_is_baked_played_and_exported_in_its_own_unit(extension, engine, tmp_path):
    from pxr import Usd, UsdGeom

    extension.scene.unit_settings.scale_length = 0.01
    hand = keyed_hand(extension, "right", moving_hand_m("right", FRAMES))
    hand.jghand.avatar = "painted"
    extension.view_layer.objects.active = hand
    extension.scene.jghand.output.bake_folder = str(tmp_path / "bakes")
    assert bpy.ops.jghand.bake() == {"FINISHED"}
    bpy.ops.jghand.play_bake()
    (cloud,) = bakes.playing(extension.scene, bakes.folder_of(hand))
    extension.scene.frame_set(3)
    wrist = np.array(hand.matrix_world @ hand.pose.bones["wrist"].head)
    size = np.ptp(cloud_positions(extension, cloud), axis=0).max()
    assert 10 < size < 30, "a hand is some twenty centimeters long"
    assert np.linalg.norm(cloud_positions(extension, cloud) - wrist, axis=1).min() < 3
    assert bpy.ops.wm.usd_export(export_animation=True, filepath=str(tmp_path / "whole.usdc")) == {"FINISHED"}
    stage = Usd.Stage.Open(str(tmp_path / "whole.usdc"))
    (prim,) = [prim for prim in stage.Traverse() if prim.GetTypeName() == usd_hook.SPLAT_TYPE]
    frame = extension.scene.frame_current
    world = np.array(UsdGeom.XformCache(frame).GetLocalToWorldTransform(prim))
    positions = np.array(prim.GetAttribute("positions").Get(frame)) @ world[:3, :3] + world[3, :3]
    assert np.abs(positions - cloud_positions(extension, cloud)).max() < 1e-4, "as Blender wrote everything else"


def test_both_hands_of_a_foreign_rig_are_baked_played_and_exported(extension, engine, tmp_path):
    from pxr import Usd

    rig, joints = mixamo_rig(extension)
    for side in joints:
        sources.store_map(rig, sources.recognize(rig, side).bone_map)
    rig.jghand.avatar = "painted"
    extension.scene.frame_end = 4
    settings = extension.scene.jghand.output
    settings.bake_folder, settings.hands = str(tmp_path / "bakes"), "all"
    assert bpy.ops.jghand.bake() == {"FINISHED"}
    folder = Path(rig.jghand.bake)
    assert folder.name == "Body"
    assert [hand.handedness for hand in bakes.read_bake(folder)] == ["right", "left"]
    extension.view_layer.objects.active = rig
    assert bpy.ops.jghand.play_bake() == {"FINISHED"}
    for cloud, side in zip(bakes.playing(extension.scene, folder), ("right", "left"), strict=True):
        far = np.linalg.norm(cloud_positions(extension, cloud) - joints[side][9], axis=1).min()
        assert far < 0.03, f"{cloud.name} is not the {side} hand"
    assert bpy.ops.wm.usd_export(export_animation=True, filepath=str(tmp_path / "whole.usdc")) == {"FINISHED"}
    stage = Usd.Stage.Open(str(tmp_path / "whole.usdc"))
    found = [prim.GetPath() for prim in stage.Traverse() if prim.GetTypeName() == usd_hook.SPLAT_TYPE]
    assert sorted(map(str, found)) == ["/root/Body_left/Splats", "/root/Body_right/Splats"]


def test_a_hand_that_is_not_exported_brings_no_splats(baked, tmp_path):
    from pxr import Usd

    context, hand, _ = baked
    bpy.ops.mesh.primitive_cube_add()
    assert context.selected_objects == [bpy.data.objects["Cube"]]
    bpy.ops.wm.usd_export(filepath=str(tmp_path / "cube.usdc"), selected_objects_only=True)
    hand.select_set(True)
    bpy.ops.wm.usd_export(filepath=str(tmp_path / "both.usdc"), selected_objects_only=True)
    found = {}
    for name in ("cube", "both"):
        stage = Usd.Stage.Open(str(tmp_path / f"{name}.usdc"))
        found[name] = sum(prim.GetTypeName() == usd_hook.SPLAT_TYPE for prim in stage.Traverse())
    assert found == {"cube": 0, "both": 1}


def test_a_stale_or_missing_bake_is_left_out_and_told(baked, tmp_path, capfd):
    from pxr import Usd

    context, hand, _ = baked
    hand.location.x += 0.01
    context.view_layer.update()
    path = tmp_path / "whole.usdc"
    assert bpy.ops.wm.usd_export(export_animation=True, filepath=str(path)) == {"FINISHED"}
    stage = Usd.Stage.Open(str(path))
    assert not [prim for prim in stage.Traverse() if prim.GetTypeName() == usd_hook.SPLAT_TYPE]
    (told,) = [line for line in capfd.readouterr().err.splitlines() if "left out" in line]
    assert "another way" in told


def test_blenders_own_export_says_which_hands_it_leaves_out(extension, tmp_path, monkeypatch, capfd):
    """With a menu in a window, on stderr without one."""
    shown = []
    monkeypatch.setattr(usd_hook.ui, "show_message", lambda text, **_: shown.append(text))
    bpy.ops.jghand.add_hand(handedness="right")
    name = bpy.context.object.name
    window = SimpleNamespace(app=SimpleNamespace(background=False), context=bpy.context)
    bpy.ops.wm.usd_export(filepath=str(tmp_path / "whole.usdc"))
    assert f"{name}: left out." in capfd.readouterr().err
    with monkeypatch.context() as in_a_window:
        in_a_window.setattr(usd_hook.ui, "bpy", window)
        bpy.ops.wm.usd_export(filepath=str(tmp_path / "whole.usdc"))
    assert not shown  # Blender's export has a thread of its own: the timer shows it
    for _ in range(2):
        handlers.tick()
    (text,) = shown
    assert f"{name}: left out." in text


def test_the_layers_of_an_export_lie_in_a_folder_of_its_own(baked, tmp_path):
    _, hand, _ = baked
    out = tmp_path / "out"
    out.mkdir()
    (out / f"{hand.name}.usda").write_text("somebody else's")
    bpy.ops.wm.usd_export(export_animation=True, filepath=str(out / "whole.usdc"))
    assert (out / f"{hand.name}.usda").read_text() == "somebody else's"
    assert (out / "whole_jghand" / f"{hand.name}.usda").is_file()
