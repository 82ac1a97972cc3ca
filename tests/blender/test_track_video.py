"""Track Video: the hands in a video become keys. The engine is a stand-in but for one test."""

import json
import subprocess
import sys
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from hands import blenders_pixels, moving_hand_m

from blender_addon import folders, versions
from blender_addon import ops as common
from blender_addon.core.controls import HAND_CONTROL
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, controls, ops_motion
from blender_addon.hand.motion_files import MotionFile, words, write_motion
from blender_addon.ops import InTurns
from blender_addon.renderer import jobs as renderer_jobs
from blender_addon.renderer import runtime
from blender_addon.renderer.jobs import Job, Phase

FRAMES, FILLED = 9, 4
# says what `jghand track` says: progress, motions and figures, or an error
_ENGINE = """
import json, pathlib, shutil, sys, time
arguments = sys.argv[1:]
here = pathlib.Path(__file__).parent
(here / "asked.json").write_text(json.dumps(arguments))
print(json.dumps({"jghand": "progress", "text": "Looking for hands", "done": 1, "total": 2}), file=sys.stderr)
for _ in range(2000):
    if not (here / "wait").exists():
        break
    time.sleep(0.01)
if (here / "error.json").exists():
    print((here / "error.json").read_text(), file=sys.stderr)
    sys.exit(2)
out = pathlib.Path(arguments[arguments.index("--out") + 1])
sides = sorted(path.stem for path in here.glob("*.npz"))
hands = []
for side in sides:
    file = out if len(sides) == 1 else out.with_name(f"motion_{side}.npz")
    shutil.copy(here / f"{side}.npz", file)
    hands.append({"hand": side, "file": str(file), "frames_seen": 8, "frames_filled": 1 if side == "left" else 0})
pathlib.Path(arguments[arguments.index("--json") + 1]).write_text(
    json.dumps({"notes": [], "hands": hands, "size_px": [540, 960]})
)
"""


@pytest.fixture
def engine(extension, tmp_path, monkeypatch):
    """A folder in which the stand-in finds what it shall say."""
    folder = tmp_path / "engine"
    folder.mkdir()
    (folder / "engine.py").write_text(_ENGINE)
    monkeypatch.setattr(runtime, "program", lambda **_: (sys.executable, str(folder / "engine.py")))
    monkeypatch.setattr(folders, "job_folder", lambda: _made(tmp_path / "job"))
    monkeypatch.setattr(ops_motion, "_last_film", None)
    return folder


def _made(folder):
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture
def video(tmp_path):
    """A name is enough for the stand-in."""
    path = tmp_path / "waving.mp4"
    path.write_bytes(b"film")
    return path


def leave(engine, side, seed=0):
    """Lets the stand-in find a hand; its joints."""
    joints = moving_hand_m(side, FRAMES, seed)
    # as the stand-in tells it
    filled = np.arange(FRAMES) == FILLED if side == "left" else None
    write_motion(engine / f"{side}.npz", MotionFile(joints, 24.0, side, (), filled))
    return joints


def check_keys(scene, hand, joints):
    """joints: (F, 21, 3) where they are in the world, meters."""
    for frame in range(FRAMES):
        seen = armature.read_hand(hand, armature.at_frame(scene, 1 + frame))
        # Blender's single precision; worst seen 3e-7 m
        np.testing.assert_allclose(seen.joints_world_m, joints[frame], atol=3e-6)


def hands_of(scene):
    found = [thing for thing in scene.objects if armature.is_hand(thing)]
    return {armature.handedness_of(thing): thing for thing in found}


def test_both_hands_of_a_video_are_keyed(extension, engine, video, tmp_path, capfd):
    joints = {side: leave(engine, side, seed) for seed, side in enumerate(("left", "right"))}
    assert bpy.ops.jghand.track_video(filepath=str(video), hand_length=190.0, exact=True) == {"FINISHED"}
    hands = hands_of(extension.scene)
    assert {hand.name for hand in hands.values()} == {"waving left", "waving right"}
    first = {side: joints[side][0, 0] for side in joints}
    for side, hand in hands.items():
        # the middle of both wrists is the origin, and each stays where it was first
        start = first[side] - (first["left"] + first["right"]) / 2
        check_keys(extension.scene, hand, joints[side] - joints[side][:, :1] + start)
        kinds = ["JITTER" if side == "left" and frame == FILLED else "KEYFRAME" for frame in range(FRAMES)]
        assert all([key.type for key in curve.keyframe_points] == kinds for curve in versions.fcurves(hand))
    assert (extension.scene.frame_start, extension.scene.frame_end) == (1, FRAMES)
    said = capfd.readouterr().out
    assert "The left hand was not seen in 1 of 9 frames" in said
    assert "of the kind Jitter" in said
    asked = json.loads((engine / "asked.json").read_text())
    assert asked[:2] == ["track", str(video)]
    for option, value in (("--up", "z"), ("--hand-length", "190"), ("--hand", "auto")):
        assert asked[asked.index(option) + 1] == value
    assert "--progress-json" in asked
    assert "--exact" in asked
    assert not (tmp_path / "job").exists(), "what the job needed is taken away"


@pytest.mark.parametrize("placement", ["IN_PLACE", "FROM_HAND"])
def test_the_hand_that_add_hand_made_takes_the_motion_where_it_stands(
    extension, engine, video, capfd, tmp_path, placement
):
    """With its controls and its avatar; another hand of the film is beside it as it was in the film."""
    extension.scene.cursor.location = (1, 2, 3)
    bpy.ops.jghand.add_hand(handedness="right")
    hand = extension.object
    assert controls.has_controls(hand)
    hand.jghand.avatar = str(tmp_path / "mine.jghand")
    hand.pose.bones[HAND_CONTROL].rotation_euler = (0.3, 0.0, 0.0)
    joints = {side: leave(engine, side, seed) for seed, side in enumerate(("left", "right"))}
    chosen = {"camera_angle": np.radians(70.0), "placement": placement}
    assert bpy.ops.jghand.track_video(filepath=str(video), **chosen) == {"FINISHED"}
    hands = hands_of(extension.scene)
    assert hands["right"] is hand
    assert controls.has_controls(hand)
    assert not controls.controls_are_muted(hand)
    for side, each in hands.items():
        wrist = joints[side][:, :1]
        moved = wrist - wrist[:1] if placement == "IN_PLACE" else 0.0
        check_keys(extension.scene, each, joints[side] - moved - joints["right"][0, 0] + (1, 2, 3))
    assert "Finger controls are neutral" in capfd.readouterr().out
    asked = json.loads((engine / "asked.json").read_text())
    assert asked[asked.index("--avatar") + 1] == str(tmp_path / "mine.jghand")
    assert asked[asked.index("--camera-angle") + 1] == "70"
    extension.view_layer.objects.active = hand
    bpy.ops.jghand.track_video(filepath=str(video), hand="left")
    assert "--avatar" not in json.loads((engine / "asked.json").read_text()), "that hand is not the one looked for"


@pytest.mark.parametrize("unit_m", [1.0, 0.01])
def test_the_films_camera_sees_the_hand_where_the_film_shows_it(extension, engine, video, capfd, unit_m):
    """540 x 960 pixels, 66 degrees across the longer edge, looking along y; the film plays frame for frame."""
    scene = extension.scene
    scene.render.fps, scene.unit_settings.scale_length = 24, unit_m
    scene.cursor.location = (1, 2, 3)
    bpy.ops.jghand.add_hand(handedness="right")
    hand = extension.object
    joints = moving_hand_m("right", FRAMES) + np.array([0.05, 0.65, -0.1])
    write_motion(engine / "right.npz", MotionFile(joints, 30 / 1.001, "right"))
    chosen = {"placement": "FILM", "first_frame": 11}
    assert bpy.ops.jghand.track_video(filepath=str(video), **chosen) == {"FINISHED"}
    assert (scene.render.fps, scene.render.fps_base) == (30, pytest.approx(1.001))
    assert (scene.frame_start, scene.frame_end) == (11, 10 + FRAMES)
    assert (scene.render.resolution_x, scene.render.resolution_y) == (540, 960)
    behind = scene.camera.data.background_images[0]
    assert scene.camera.data.show_background_images
    assert bpy.path.abspath(behind.clip.filepath) == str(video)
    assert behind.clip.frame_start == 11
    assert "cannot play the film" in capfd.readouterr().out, "it is none"
    focal = 960 / 2 / np.tan(np.radians(33))
    for frame in range(FRAMES):
        seen = armature.read_hand(hand, armature.at_frame(scene, 11 + frame)).joints_world_m
        x, y, z = joints[frame].T
        wanted = np.stack([270 + focal * x / y, 480 - focal * z / y], -1)
        # a lens, a sensor and the constraints of finger controls in single precision, which is 2e-7 m so far from the
        # world's origin; worst seen 2.5e-3 px, at the origin 4e-4 px
        np.testing.assert_allclose(blenders_pixels(scene, scene.camera, seen / unit_m, (540, 960)), wanted, atol=5e-3)


def test_a_film_that_blender_plays_is_as_large_as_the_scenes_images(extension, engine, engine_python, tmp_path, capfd):
    """The tracker looks at a smaller one."""
    film = tmp_path / "film.mp4"
    make = (
        "import subprocess, sys, imageio_ffmpeg as f; subprocess.run([f.get_ffmpeg_exe(), *sys.argv[1:]], check=True)"
    )
    source = ["-v", "error", "-f", "lavfi", "-i", "testsrc=size=1080x1920:rate=30", "-frames:v", "3"]
    subprocess.run([engine_python, "-c", make, *source, str(film)], check=True)
    leave(engine, "right")
    assert bpy.ops.jghand.track_video(filepath=str(film), placement="FILM") == {"FINISHED"}
    assert "cannot play" not in capfd.readouterr().out
    render = extension.scene.render
    assert (render.resolution_x, render.resolution_y) == (1080, 1920)


def test_another_placement_is_no_reason_to_look_for_hands_again(extension, engine, video):
    leave(engine, "right")
    assert bpy.ops.jghand.track_video(filepath=str(video)) == {"FINISHED"}
    (engine / "engine.py").write_text("")
    extension.view_layer.objects.active = None  # as after the undo of Blender's redo panel
    assert bpy.ops.jghand.track_video(filepath=str(video), placement="FROM_HAND") == {"FINISHED"}
    video.write_bytes(b"another film")
    extension.view_layer.objects.active = None
    with pytest.raises(RuntimeError, match="figures"):
        bpy.ops.jghand.track_video(filepath=str(video))


def test_an_avatar_that_was_trained_anew_is_a_reason_to_look_again(extension, engine, video, tmp_path):
    bpy.ops.jghand.add_hand(handedness="right")
    avatar = tmp_path / "mine.jghand"
    extension.object.jghand.avatar = str(avatar)
    leave(engine, "right")
    for content in (b"one", b"another"):
        avatar.write_bytes(content)
        (engine / "asked.json").unlink(missing_ok=True)
        assert bpy.ops.jghand.track_video(filepath=str(video)) == {"FINISHED"}
        assert (engine / "asked.json").exists()


@pytest.mark.parametrize("online", [False, True])
def test_networks_are_downloaded_only_where_blender_may_go_online(extension, engine, video, monkeypatch, online):
    app = SimpleNamespace(online_access=online)
    monkeypatch.setattr(ops_motion, "bpy", SimpleNamespace(app=app, path=bpy.path))
    text = "hand model: wanted networks, got none. Fetch it once (35 MB) with --fetch-model."
    error = {"jghand": "error", "kind": "bad_input", "text": text, "exit_code": 2}
    (engine / "error.json").write_text(json.dumps(error))
    remedy = "correct it" if online else "Allow Online Access"
    with pytest.raises(RuntimeError, match=f"(?i){remedy}"):
        bpy.ops.jghand.track_video(filepath=str(video))
    assert ("--fetch-model" in json.loads((engine / "asked.json").read_text())) is online


def test_blender_is_free_while_the_engine_looks(extension, engine, video, tmp_path, monkeypatch):
    """The job is looked at once a turn, whatever else happens."""
    leave(engine, "right")
    (engine / "wait").touch()
    app = SimpleNamespace(background=False)
    monkeypatch.setattr(common, "bpy", SimpleNamespace(app=app, ops=bpy.ops, types=bpy.types))
    timers, said, looks = [], [], []
    look = Job.tick
    monkeypatch.setattr(Job, "tick", lambda job: looks.append(job) or look(job))
    manager = SimpleNamespace(
        event_timer_add=lambda seconds, window: timers.append(seconds) or seconds,
        event_timer_remove=lambda _: None,
        modal_handler_add=lambda _: None,
    )
    screen, dragged = SimpleNamespace(is_animation_playing=True), []
    context = SimpleNamespace(
        window_manager=manager,
        window=SimpleNamespace(
            modal_operators=dragged, cursor_modal_set=lambda _: None, cursor_modal_restore=lambda: None
        ),
        screen=screen,
        workspace=SimpleNamespace(status_text_set=said.append),
        **{
            name: getattr(extension, name)
            for name in ("scene", "view_layer", "mode", "object", "evaluated_depsgraph_get")
        },
    )
    operator = working(video)
    assert InTurns.invoke(operator, context, None) == {"RUNNING_MODAL"}

    def sent(kind, value="PRESS"):
        return operator.modal(context, SimpleNamespace(type=kind, value=value))

    sent("TIMER")
    assert len(looks) <= 1, "nobody waits for the engine"
    free = {"PASS_THROUGH"}
    assert sent("MOUSEMOVE") == sent("TIMER") == sent("A") == free
    assert len(looks) <= 2
    assert timers[-1] == renderer_jobs.JOB_LOOK_S
    assert sent("ESC") == free, "it ends playback"
    assert runtime.jobs.get(runtime.IMPORT).state.phase is Phase.RUNNING
    with pytest.raises(JGHandFailure, match="running already"):
        next(working(video).steps(context))
    (engine / "wait").unlink()
    assert runtime.jobs.get(runtime.IMPORT).wait(20.0)
    dragged.append(SimpleNamespace(bl_idname="OBJECT_OT_duplicate_move", macros=[translate]))
    assert sent("TIMER") == free
    assert not hands_of(extension.scene), "nothing changes under what is dragged"
    dragged.clear()
    assert sent("TIMER") == {"FINISHED"}
    assert set(hands_of(extension.scene)) == {"right"}
    assert not (tmp_path / "job").exists()


translate = SimpleNamespace(bl_idname="TRANSFORM_OT_translate", macros=[])


def working(video):
    """The operator as it works after the file browser; Blender alone makes a true one."""

    class Tracking(ops_motion.KeysFile):
        steps, hand_for, _tracked = (
            ops_motion.TrackVideo.steps,
            ops_motion.TrackVideo.hand_for,
            ops_motion.TrackVideo._tracked,
        )
        working = "Tracking"

        def report(self, kind, text):
            pass

    operator = Tracking.__new__(Tracking)
    chosen = {
        "filepath": str(video),
        "hand": "auto",
        "hand_length": 0.0,
        "exact": False,
        "camera_angle": 1.0,
        "smoothing": 1.0,
    }
    placed = {"placement": "IN_PLACE", "first_frame": 1, "use_scene_range": False, "use_scene_rate": False}
    for name, value in {**chosen, **placed}.items():
        setattr(operator, name, value)
    return operator


def test_esc_while_the_engine_looks_ends_it(extension, engine, video, tmp_path):
    (engine / "wait").touch()
    steps = working(video).steps(extension)
    next(steps)
    assert (tmp_path / "job").exists()
    steps.close()
    assert runtime.jobs.get(runtime.IMPORT).state.phase is Phase.CANCELLED
    assert not (tmp_path / "job").exists()


def test_a_hand_of_the_other_side_is_left_alone(extension, engine, video):
    leave(engine, "right")
    bpy.ops.jghand.track_video(filepath=str(video))
    first = extension.object
    (engine / "right.npz").unlink()
    leave(engine, "left")
    bpy.ops.jghand.track_video(filepath=str(video))
    assert set(hands_of(extension.scene)) == {"left", "right"}
    assert armature.handedness_of(first) == "right"


def test_what_the_engine_says_is_told_and_nothing_is_changed(extension, engine, video, tmp_path):
    text = "video waving.mp4: wanted a hand, got none in any picture."
    error = {"jghand": "error", "kind": "bad_input", "text": text, "exit_code": 2}
    (engine / "error.json").write_text(json.dumps(error))
    with pytest.raises(RuntimeError, match="none in any picture"):
        bpy.ops.jghand.track_video(filepath=str(video))
    assert not hands_of(extension.scene)
    assert not (tmp_path / "job").exists()


def test_figures_that_are_none_are_refused(extension, engine, video):
    (engine / "engine.py").write_text("")
    with pytest.raises(RuntimeError, match="figures"):
        bpy.ops.jghand.track_video(filepath=str(video))


def test_the_real_engine_takes_these_words(engine_python, tmp_path):
    """It gets as far as the video, which is none."""
    (tmp_path / "odd.mp4").write_bytes(b"no film")
    options = {"--hand": "right", "--hand-length": "190", "--avatar": "painted", "--smoothing": "1", "--exact": True}
    asked = words("track", tmp_path / "odd.mp4", tmp_path, {**options, "--camera-angle": "60"})
    done = subprocess.run(
        [engine_python, "-I", "-m", "jghand_engine", *asked], check=False, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "odd.mp4" in done.stderr
