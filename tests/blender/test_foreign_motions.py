"""Motions of other programs: the engine reads what Blender's exporters write, and Import Motion puts that, and what
the tests write, onto a hand."""

import json
import shutil
import subprocess
from pathlib import Path

import bpy
import numpy as np
import pytest
from hands import mixamo_rig
from mathutils import Quaternion, Vector

from blender_addon.core.joints import NAMES, TIPS
from blender_addon.hand import armature
from blender_addon.hand.motion_files import read_motion

TESTS = Path(__file__).resolve().parents[1]
FRAMES = 12
OTHERS = [place for place in range(21) if place not in TIPS]
_SAMPLES = """
import sys, json
sys.path.insert(0, sys.argv[1])
from pathlib import Path
import numpy as np
import motion_samples as samples
folder = Path(sys.argv[2])
motion = samples.motion(frames=12)
samples.write_bvh(folder / "sample.bvh", samples.rig(motion, scale=100))
np.save(folder / "joints.npy", samples.standard(motion))
(folder / "sample.json").write_text(json.dumps(samples.mediapipe_tasks(samples.standard(motion))))
"""


@pytest.fixture(scope="module")
def written(engine_python, tmp_path_factory):
    folder = tmp_path_factory.mktemp("samples")
    subprocess.run([engine_python, "-c", _SAMPLES, str(TESTS), str(folder)], check=True)
    return folder


@pytest.fixture
def samples(written, engine, tmp_path):
    """A folder with sample.bvh (centimeters, y up), sample.json of MediaPipe, and their joints.npy."""
    return shutil.copytree(written, tmp_path, dirs_exist_ok=True)


def converted(engine, path, *words):
    """What the engine makes of a file, as the extension reads it."""
    out = path.with_suffix(".npz")
    command = [engine, "-I", "-m", "jghand_engine", "motion", str(path), "--out", str(out), *words]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return read_motion(out), done.stdout


def a_dance(context):
    """A Mixamo body whose right hand moves: the rig, and (F, 21, 3) where its bones are, tails for tips, world."""
    rig, _ = mixamo_rig(context)
    scene = context.scene
    scene.frame_start, scene.frame_end, scene.render.fps = 1, FRAMES, 24
    random = np.random.default_rng(4)
    hand = [bone for bone in rig.pose.bones if "RightHand" in bone.name or "RightForeArm" in bone.name]
    for bone in hand:
        bone.rotation_mode = "QUATERNION"
        for frame in (1, FRAMES // 2, FRAMES):
            axis = Vector(random.standard_normal(3))
            bone.rotation_quaternion = Quaternion(axis, 0.3 if "Hand" in bone.name else 0.8)
            bone.keyframe_insert("rotation_quaternion", frame=frame)
    names = ["RightHand", *(f"RightHand{name[:-1].title()}{name[-1]}" for name in NAMES[1:])]
    joints = np.empty((FRAMES, 21, 3))
    for frame in range(FRAMES):
        scene.frame_set(1 + frame)
        seen = rig.evaluated_get(context.evaluated_depsgraph_get())
        for place, name in enumerate(names):
            tip = place in TIPS
            bone = seen.pose.bones[f"mixamorig:{names[place - 1] if tip else name}"]
            joints[frame, place] = seen.matrix_world @ (bone.tail if tip else bone.head)
    return rig, joints


def enable(module):
    import addon_utils

    addon_utils.enable(module)


def test_bvh_of_blender_is_read_back(context, engine, tmp_path):
    rig, joints = a_dance(context)
    enable("io_anim_bvh")
    path = tmp_path / "dance.bvh"
    context.view_layer.objects.active = rig
    bpy.ops.export_anim.bvh(filepath=str(path), frame_start=1, frame_end=FRAMES, rotate_mode="ZXY", global_scale=100)
    motion, said = converted(engine, path, "--hand", "right")
    assert "centimeters" in said
    assert (motion.fps, motion.handedness) == (24.0, "right")
    # six digits of centimeters and degrees; worst seen 2e-7 m
    np.testing.assert_allclose(motion.joints_m, joints, atol=5e-7)


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_usd_of_blender_is_read_back(context, engine, tmp_path, suffix):
    _, joints = a_dance(context)
    path = tmp_path / f"dance.{suffix}"
    bpy.ops.wm.usd_export(filepath=str(path), export_animation=True, export_armatures=True)
    motion, _ = converted(engine, path, "--hand", "right", "--up", "z")
    assert motion.fps == 24.0
    _check_without_tips(motion, joints)


def _check_without_tips(motion, joints):
    """All joints of bones, and tips in the direction of the last bones, whose ends neither format knows."""
    # single precision, a meter from the origin; worst seen 5e-7 m
    np.testing.assert_allclose(motion.joints_m[:, OTHERS], joints[:, OTHERS], atol=1e-6)
    for tip in TIPS:
        made, true = (one[:, tip] - one[:, tip - 1] for one in (motion.joints_m, joints))
        cosine = (made * true).sum(-1) / np.linalg.norm(made, axis=-1) / np.linalg.norm(true, axis=-1)
        # half precision of rest poses; worst seen 0.1 degrees
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.3, NAMES[tip]


# ---- Import Motion ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["sample.bvh", "sample.json"])
def test_import_motion_takes_files_of_other_programs(extension, samples, capfd, name):
    extension.scene.render.fps = 30
    assert bpy.ops.jghand.import_motion(filepath=str(samples / name), placement="FILE") == {"FINISHED"}
    said = capfd.readouterr().out
    assert "12 frames from 1 to 12" in said
    x, y, z = np.moveaxis(np.load(samples / "joints.npy"), -1, 0)
    # MediaPipe's camera has y down, BVH has y up
    wanted = np.stack([x, z, -y] if name.endswith("json") else [x, -z, y], axis=-1)
    hand = extension.object
    assert armature.handedness_of(hand) == "right"
    for frame in range(FRAMES):
        seen = armature.read_hand(hand, armature.at_frame(extension.scene, 1 + frame))
        np.testing.assert_allclose(seen.joints_world_m, wanted[frame], atol=3e-6)


def test_rate_and_order_of_joints_alone_are_said_beside_them(extension, samples, capfd):
    joints = np.load(samples / "joints.npy")
    mano = [0, *range(5, 8), *range(9, 12), *range(17, 20), *range(13, 16), *range(1, 4), *TIPS]
    np.save(samples / "bare.npy", joints[:, mano])
    extension.scene.render.fps = 24
    said = {"hand": "right", "order": "mano16_tips", "fps": 48.0, "placement": "FILE"}
    assert bpy.ops.jghand.import_motion(filepath=str(samples / "bare.npy"), **said) == {"FINISHED"}
    assert "12 frames from 1 to 7" in capfd.readouterr().out
    for frame in (0, 4, 10):
        seen = armature.read_hand(extension.object, armature.at_frame(extension.scene, 1 + frame // 2))
        np.testing.assert_allclose(seen.joints_world_m, joints[frame], atol=3e-6)


def test_a_motion_with_gaps_is_filled_which_is_told(extension, samples, capfd):
    joints = np.load(samples / "joints.npy").tolist()
    joints[2][5] = None
    content = {"format": "jghand motion", "version": 1, "order": "standard", "unit": "m", "fps": 24}
    path = samples / "gap.json"
    path.write_text(json.dumps({**content, "handedness": "right", "joints": joints}))
    assert bpy.ops.jghand.import_motion(filepath=str(path)) == {"FINISHED"}
    assert "1 " in capfd.readouterr().out
    seen = armature.read_hand(extension.object, armature.at_frame(extension.scene, 1))
    np.testing.assert_allclose(seen.joints_world_m, joints[0], atol=3e-6)


def test_what_the_engine_cannot_read_is_told_in_its_words(extension, engine, tmp_path):
    path = tmp_path / "broken.bvh"
    path.write_text("HIERARCHY\n")
    with pytest.raises(RuntimeError, match="no MOTION"):
        bpy.ops.jghand.import_motion(filepath=str(path))
    assert not bpy.data.armatures


@pytest.mark.parametrize("content", [b"no zip", b"PK\x03\x04 torn", b""])
def test_a_bad_npz_is_told_without_words_of_the_command_line(extension, engine, tmp_path, content):
    path = tmp_path / "bad.npz"
    path.write_bytes(content)
    with pytest.raises(RuntimeError, match=r"bad\.npz") as refused:
        bpy.ops.jghand.import_motion(filepath=str(path))
    assert "`" not in str(refused.value)
    assert "jghand " not in str(refused.value)


def test_jghands_own_files_are_mirrored_and_kept_in_place_too(extension, samples, engine):
    motion, _ = converted(engine, samples / "joints.npy", "--hand", "right")
    chosen = {"mirror": True, "placement": "IN_PLACE"}
    assert bpy.ops.jghand.import_motion(filepath=str(samples / "joints.npz"), **chosen) == {"FINISHED"}
    hand = extension.object
    assert armature.handedness_of(hand) == "left"
    wanted = (motion.joints_m - motion.joints_m[:, :1] + motion.joints_m[0, 0]) * [-1, 1, 1]
    for frame in (0, 11):
        at = 1 + frame * extension.scene.render.fps / motion.fps
        seen = armature.read_hand(hand, armature.at_frame(extension.scene, at))
        np.testing.assert_allclose(seen.joints_world_m, wanted[frame], atol=3e-6)


@pytest.mark.parametrize("mirror", [False, True])
def test_of_a_file_with_both_hands_the_active_hand_takes_the_one_that_becomes_its_own(extension, samples, mirror):
    assert bpy.ops.jghand.import_motion(filepath=str(samples / "sample.bvh")) == {"FINISHED"}
    hand = extension.object
    frames = json.loads((samples / "sample.json").read_text())
    for frame in frames:
        right = frame["worldLandmarks"][0]
        frame["worldLandmarks"].append([{**point, "x": 0.1 - point["x"]} for point in right])
        frame["handedness"].append([{"categoryName": "Left", "score": 1.0}])
    (samples / "both.json").write_text(json.dumps(frames))
    chosen = {"mirror": mirror, "placement": "FILE"}
    assert bpy.ops.jghand.import_motion(filepath=str(samples / "both.json"), **chosen) == {"FINISHED"}
    assert extension.object is hand
    assert armature.handedness_of(hand) == "right"
    x, y, z = np.moveaxis(np.load(samples / "joints.npy"), -1, 0)
    # MediaPipe's camera has y down; the file's left hand mirrored is the right one, moved
    wanted = np.stack([x - 0.1 * mirror, z, -y], axis=-1)
    seen = armature.read_hand(hand, armature.at_frame(extension.scene, 1))
    np.testing.assert_allclose(seen.joints_world_m, wanted[0], atol=3e-6)


def test_bones_of_no_convention_and_the_axis_that_points_up_are_said_beside_the_file(extension, samples):
    path = samples / "sample.bvh"
    text = path.read_text().replace("Hips", "Root")
    names = ["RightHand", *(f"RightHand{name[:-1].title()}{name[-1]}" for name in NAMES[1:])]
    for place, name in sorted(enumerate(names), key=lambda one: -len(one[1])):
        text = text.replace(f"JOINT {name}\n", f"JOINT knochen{place}\n")
    path.write_text(text)
    with pytest.raises(RuntimeError, match="Bone Names"):
        bpy.ops.jghand.import_motion(filepath=str(path))
    bones = samples / "map.json"
    bones.write_text(json.dumps({name: f"knochen{place}" for place, name in enumerate(NAMES)}))
    extension.scene.render.fps = 30
    chosen = {"bones": str(bones), "hand": "right", "up": "z"}
    assert bpy.ops.jghand.import_motion(filepath=str(path), **chosen) == {"FINISHED"}
    seen = armature.read_hand(extension.object, armature.at_frame(extension.scene, 1))
    np.testing.assert_allclose(seen.joints_world_m, np.load(samples / "joints.npy")[0], atol=3e-6)


def test_the_first_refusal_is_told_not_that_of_another_try(extension, samples):
    """A file of which a part has to be chosen is not asked for again with the active hand's side."""
    assert bpy.ops.jghand.import_motion(filepath=str(samples / "sample.bvh")) == {"FINISHED"}
    with pytest.raises(RuntimeError, match="a part called 'nonsense'"):
        bpy.ops.jghand.import_motion(filepath=str(samples / "sample.bvh"), part="nonsense")
