"""What users of such add-ons complain about most, each with a test that would catch it.

1. It works in the viewport and F12 is empty.   2. Colors differ from other viewers (`test_render_engine`, and here).
3. Hidden preconditions.   4. An external process that hangs on "Starting…" for ever.   5. Each Blender release
breaks it.

The first two are asked of the real engine.
"""

import ast
import itertools
import time
import webbrowser
from collections.abc import Iterator
from pathlib import Path

import bpy
import hands
import numpy as np
import pytest

from blender_addon import folders, registration
from blender_addon.core.view import Moment, picture_request
from blender_addon.errors import ADVICE
from blender_addon.hand import sources
from blender_addon.render import camera, rendering
from blender_addon.renderer import runtime
from blender_addon.renderer import state as renderer_state
from blender_addon.renderer.link import EngineLink

ROOT = Path(__file__).resolve().parents[2]
SIZE = (160, 120)


@pytest.fixture(scope="module", autouse=True)
def extension() -> Iterator[None]:
    registration.register()
    yield
    registration.unregister()


@pytest.fixture
def stand_in(stand_in_command) -> Iterator[EngineLink]:
    """A link to an engine that draws discs."""
    yield from _use(EngineLink(lambda: stand_in_command))


@pytest.fixture
def engine(engine_python) -> Iterator[EngineLink]:
    """A link to the real engine."""
    yield from _use(EngineLink(lambda: [engine_python, "-I", "-m", "jghand_engine", "serve"]))


def _use(link: EngineLink) -> Iterator[EngineLink]:
    runtime.use_link(link)
    yield link
    runtime.use_link(None)


@pytest.fixture
def scene(context, tmp_path) -> bpy.types.Scene:
    """What an artist has after Add Hand in an empty scene, keyed over three frames; the hand in its own light."""
    assert bpy.ops.jghand.add_hand(handedness="right") == bpy.ops.jghand.add_camera() == {"FINISHED"}
    scene, thing = context.scene, context.object
    scene.jghand.light = "CAPTURE"
    scene.frame_start, scene.frame_end = 1, 3
    for frame in (1, 2, 3):
        for finger in ("index", "middle", "ring"):
            for place in (1, 2, 3):
                bone = thing.pose.bones[f"{finger}{place}"]
                bone.rotation_quaternion = (1.0, 0.35 * (frame - 1), 0.0, 0.0)
                bone.keyframe_insert("rotation_quaternion", frame=frame)
    scene.frame_set(1)
    camera.set_picture_size(scene.render, *SIZE)
    scene.render.filepath = str(tmp_path / "picture_")
    return scene


def rendered_frames(scene: bpy.types.Scene) -> list[np.ndarray]:
    """Renders the animation; (H, W, 4) of each file."""
    bpy.ops.render.render(animation=True)
    folder = Path(scene.render.filepath).parent
    return [hands.pixels(path) for path in sorted(folder.glob("picture_*.png"))]


def viewports_picture(link: EngineLink, scene: bpy.types.Scene) -> np.ndarray:
    """(H, W, 4) premultiplied, display colors: what a view that looks through the scene's camera shows when it is
    still. No color is brighter than white, as its shader has it: a highlight on a soft edge may be."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    read = sources.read_hands(scene.objects["Right Hand"], depsgraph)
    header, arrays = picture_request(
        [Moment(camera.pinhole(scene.camera, depsgraph), read)], preset=scene.jghand.render_preset, outputs=["rgba_u8"]
    )
    reply = link.request(header, arrays, timeout_s=renderer_state.LOAD_S)
    picture = np.asarray(reply.arrays["rgba_u8"].view()).astype(np.float32) / 255
    return np.minimum(picture, picture[..., 3:])


# ---- 1. it works in the viewport and F12 is empty --------------------------------------------------------------------


def test_works_in_the_viewport_and_f12_is_empty(engine, scene):
    """Every frame of an animation is the picture of the viewport at that frame: not empty, not the one before."""
    assert bpy.ops.jghand.use_engine() == {"FINISHED"}
    scene.view_settings.view_transform, scene.render.film_transparent = "Standard", True
    scene.render.image_settings.color_mode, scene.render.dither_intensity = "RGBA", 0.0
    files = rendered_frames(scene)
    assert len(files) == 3
    for frame, file in enumerate(files, 1):
        scene.frame_set(frame)
        seen = viewports_picture(engine, scene)
        assert (file[..., 3] > 0.5).mean() > 0.05
        premultiplied = np.concatenate([file[..., :3] * file[..., 3:], file[..., 3:]], -1)
        # two roundings to 8 bits, at edges of a product of two: 1.53 of 255 was the most
        assert np.abs(premultiplied - seen).max() <= 1.6 / 255
    for one, other in itertools.pairwise(files):
        assert np.abs(one - other).max() > 0.5


def test_f12_with_an_engine_that_draws_no_hands_says_so_once(stand_in, scene, capfd):
    scene.render.engine = "BLENDER_WORKBENCH"
    bpy.ops.render.render()
    bpy.ops.render.render()
    told = [line for line in capfd.readouterr().err.splitlines() if line.startswith("JGHand:")]
    assert told == [
        "JGHand: This image has no hands: Workbench does not draw them. "
        'Press "Use JGHand Engine" or "Set Up Compositing".'
    ]


@pytest.mark.parametrize("way", ["our engine", "combined", "hidden hands", "no hand"])
def test_nothing_is_said_where_hands_are_drawn_or_not_wanted(stand_in, scene, way):
    assert rendering.hands_left_out(scene) == ["Right Hand"]
    if way == "our engine":
        bpy.ops.jghand.use_engine()
    elif way == "combined":
        bpy.ops.jghand.combine_with_scene()
    elif way == "hidden hands":
        scene.objects["Right Hand"].hide_render = True
    else:
        bpy.data.objects.remove(scene.objects["Right Hand"])
    assert rendering.hands_left_out(scene) == []


# ---- 3. hidden preconditions -----------------------------------------------------------------------------------------


def our_operators() -> list[str]:
    return sorted(f"jghand.{name}" for name in dir(bpy.ops.jghand) if not name.startswith("_"))


@pytest.mark.parametrize("content", ["nothing", "a cube", "a hand"])
def test_hidden_preconditions(stand_in, context, content):
    """Every operator either may run or says what it is missing, never Blender's 'context is incorrect'."""
    if content == "a cube":
        bpy.ops.mesh.primitive_cube_add()
    elif content == "a hand":
        bpy.ops.jghand.add_hand()
    silent = []
    for name in our_operators():
        operator = getattr(bpy.ops.jghand, name.partition(".")[2])
        if operator.poll():
            continue
        with pytest.raises(RuntimeError) as caught:
            operator()
        if "context is incorrect" in str(caught.value):
            silent.append(name)
    assert silent == []
    assert len(our_operators()) > 20


# what a test must not press, and why
NOT_PRESSED = {"jghand.install_tools": "downloads much (test_engine_operators)"}


@pytest.mark.parametrize("content", ["a hand", "two hands, one in pose mode", "somebody's rig", "a combined scene"])
@pytest.mark.filterwarnings("error")
def test_whatever_may_run_runs_or_says_in_a_sentence_why_not(stand_in, context, monkeypatch, tmp_path, content):
    """Every operator whose poll agrees, as its button calls it, each in a scene that none has touched."""
    monkeypatch.setattr(webbrowser, "open", lambda *_: True)
    monkeypatch.setattr(folders, "user_folder", lambda name, **_: tmp_path / name)
    sentences = tuple(advice.sentence for advice in ADVICE.values())
    ran, is_fresh = 0, False
    for name in our_operators():
        if not is_fresh:
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            prepare(content)
            # a movie of two small frames
            bpy.context.scene.frame_end, bpy.context.scene.render.resolution_percentage = 2, 5
            bpy.context.scene.render.filepath = f"{tmp_path}/"
            is_fresh = True
        operator = getattr(bpy.ops.jghand, name.partition(".")[2])
        if name in NOT_PRESSED or not operator.poll():
            continue
        if name == "jghand.make_pose_assets" and content != "a hand":
            continue  # takes seconds, and looks at nothing of the scene
        ran, is_fresh = ran + 1, False
        said = ""
        try:
            operator()
        except RuntimeError as error:
            said = str(error)
        assert "Traceback" not in said, name
        assert not said or any(sentence in said for sentence in sentences), (name, said)
    assert ran > 10


def prepare(content: str) -> None:
    if content == "somebody's rig":
        hands.mixamo_rig(bpy.context)
        bpy.ops.jghand.use_armature()
        return
    bpy.ops.jghand.add_hand()
    bpy.ops.jghand.add_camera()
    if content.startswith("two hands"):
        bpy.ops.jghand.add_hand(handedness="left")
        bpy.ops.object.mode_set(mode="POSE")
    elif content == "a combined scene":
        bpy.context.scene.render.engine = "CYCLES"
        bpy.ops.jghand.combine_with_scene()


def test_one_button_in_an_empty_scene_is_all_that_a_render_needs(stand_in, context, tmp_path):
    """No proxy, no camera, no setting beforehand: Add Hand, Use JGHand Engine, F12."""
    assert not bpy.data.objects
    bpy.ops.jghand.add_hand()
    bpy.ops.jghand.use_engine()
    context.scene.render.filepath = str(tmp_path / "first.png")
    camera.set_picture_size(context.scene.render, *SIZE)
    context.scene.render.film_transparent = True
    context.scene.render.image_settings.color_mode = "RGBA"
    assert bpy.ops.render.render(write_still=True) == {"FINISHED"}
    assert (hands.pixels(tmp_path / "first.png")[..., 3] > 0.5).mean() > 0.005  # 21 discs


# ---- 4. an external process that hangs on "Starting…" for ever -------------------------------------------------------


@pytest.mark.parametrize("fault", ["silent", "die_at_start", "garbage", "wrong_version", "wrong_port"])
def test_an_external_process_that_hangs_on_starting_for_ever(stand_in_command, scene, monkeypatch, fault):
    """An engine that never gets ready ends as a sentence with a remedy, and F12 ends with it, within bounds."""
    monkeypatch.setattr(renderer_state, "HANDSHAKE_S", 1.0)
    monkeypatch.setattr(renderer_state, "TERMINATE_S", 0.5)
    bpy.ops.jghand.use_engine()
    link = EngineLink(lambda: [*stand_in_command, fault])
    runtime.use_link(link)
    began = time.monotonic()
    link.start()
    assert time.monotonic() - began < 0.5, "starting blocks Blender"
    # the stand-in itself needs a moment until it says something wrong, the rest is for a busy machine
    while link.status.state == "starting" and time.monotonic() - began < 20:
        time.sleep(0.02)
    assert link.status.state == "failed"
    assert link.status.failure is not None
    assert link.status.failure.advice.sentence
    assert link.status.failure.advice.remedy
    with pytest.raises(RuntimeError, match=r"\w+\. \w+"):
        bpy.ops.render.render(write_still=True)
    assert not list(Path(scene.render.filepath).parent.glob("*.png")), "a picture without hands was written"
    runtime.use_link(None)


# ---- 5. each Blender release breaks it -------------------------------------------------------------------------------


def blender_files() -> list[Path]:
    return sorted(path for path in (ROOT / "blender_addon").rglob("*.py") if "__pycache__" not in path.parts)


def test_each_blender_release_breaks_it():
    """No line asks for Blender's version: features are looked for, and in one module."""
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in blender_files()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and ast.unparse(node) in ("bpy.app.version", "app.version")
    ]
    assert found == []
