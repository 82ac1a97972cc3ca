"""The render engine: F12 and animations with their passes, what a scene may ask for, and failing so that Blender writes
nothing. A stand-in engine draws discs; at the end the real one draws a hand."""

import contextlib
import itertools
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import bpy
import hands
import numpy as np
import pytest

from blender_addon import ui
from blender_addon.core import posing, view
from blender_addon.core.view import Moment, picture_request
from blender_addon.hand import armature, sources
from blender_addon.render import camera, command, samples
from blender_addon.render import engine as render_engine
from blender_addon.renderer import runtime
from blender_addon.renderer.link import EngineLink

SIZE = (96, 64)


pytestmark = pytest.mark.usefixtures("linked_extension")


@pytest.fixture
def scene(context, tmp_path) -> bpy.types.Scene:
    """A hand that moves over frames 1 to 4, and a camera; colors and film as the engine has them."""
    hands.keyed_hand(context, "right", hands.moving_hand_m("right", frames=4))
    scene = context.scene
    scene.camera = hands.camera_on(context, (0, 0.09, 0), 0.5)
    camera.set_picture_size(scene.render, *SIZE)
    scene.render.engine = "JGHAND"
    scene.render.film_transparent, scene.render.dither_intensity = True, 0.0
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"
    scene.render.filepath = str(tmp_path / "picture.png")
    scene.frame_start, scene.frame_end = 1, 4
    return scene


def f12() -> np.ndarray:
    """Renders the current frame; (H, W, 4) of the file, straight alpha, top row first."""
    path = Path(bpy.context.scene.render.filepath)
    path.unlink(missing_ok=True)
    assert bpy.ops.render.render(write_still=True) == {"FINISHED"}
    return hands.pixels(path)


def layers(scene: bpy.types.Scene, folder: Path, *, names: bool = False) -> dict[str, np.ndarray]:
    """Renders the current frame; (H, W) of every channel of every pass, top row first, by "Pass.channel", and with the
    view layer's name before it where names are wanted."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    scene.render.filepath = str(folder / "layers.exr")
    bpy.ops.render.render(write_still=True)
    bpy.utils.expose_bundled_modules()
    import OpenImageIO

    file, found, part = OpenImageIO.ImageInput.open(str(folder / "layers.exr")), {}, 0
    while file.seek_subimage(part, 0):
        values = file.read_image(part, 0, 0, file.spec().nchannels, OpenImageIO.FLOAT)
        found |= {name: values[..., place] for place, name in enumerate(file.spec().channelnames)}
        part += 1
    return {name if names else name.partition(".")[2]: values for name, values in found.items()}


def asked(scene: bpy.types.Scene, *outputs: str) -> tuple[np.ndarray, ...]:
    """What the engine itself answers about this scene."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    seen = [armature.read_hand(hand, depsgraph) for hand in armature.hands_at_any_frame(bpy.context.view_layer)]
    view = camera.pinhole(scene.camera, depsgraph)
    reply = runtime.link().request(*picture_request([Moment(view, seen)], preset="final", outputs=outputs))
    return tuple(np.asarray(reply.arrays[name].view()) for name in outputs)


# ---- pictures and passes --------------------------------------------------------------------------------------------


def test_f12_writes_the_engines_picture(scene):
    (wanted,) = asked(scene, "rgba_f32")
    assert wanted[..., 3].sum() > 10
    np.testing.assert_array_equal(f12(), wanted)  # discs are opaque or nothing, white or nothing


def test_an_animation_writes_every_frame_as_it_is_posed(scene, tmp_path):
    scene.render.filepath = str(tmp_path / "frame_")
    bpy.ops.render.render(animation=True)
    pictures = [hands.pixels(tmp_path / f"frame_{frame:04d}.png") for frame in (1, 2, 3, 4)]
    for frame, picture in enumerate(pictures, 1):
        scene.frame_set(frame)
        np.testing.assert_array_equal(picture, asked(scene, "rgba_f32")[0])
    assert all(np.abs(one - other).max() == 1 for one, other in itertools.pairwise(pictures))


def test_depth_and_bones_are_passes_on_demand(scene, tmp_path):
    depth_m, ids = asked(scene, "depth", "ids")
    assert set(layers(scene, tmp_path)) == {f"Combined.{channel}" for channel in "RGBA"}
    scene.view_layers[0].use_pass_z = scene.jghand.use_pass_ids = True
    passes = layers(scene, tmp_path)
    np.testing.assert_array_equal(passes["JGHandId.X"], ids)
    seen = depth_m > 0
    np.testing.assert_allclose(passes["Depth.Z"][seen], depth_m[seen])
    assert (passes["Depth.Z"][~seen] == np.float32(1e10)).all()


def test_depth_is_in_blender_units(scene, tmp_path):
    """The same scene in Blender units, of half a meter each, has the same numbers."""
    scene.view_layers[0].use_pass_z = True
    of_meters = layers(scene, tmp_path)["Depth.Z"]
    scene.unit_settings.scale_length = 0.5
    of_half_meters = layers(scene, tmp_path)["Depth.Z"]
    seen = (of_meters < 1e9) & (of_half_meters < 1e9)
    assert seen.sum() > 20
    # the stand-in's discs have a size in meters, so that another one may be in front
    assert (np.abs(of_half_meters[seen] - of_meters[seen]) < 1e-6).mean() > 0.9


def test_what_is_behind_the_hand_is_the_world(scene):
    world = bpy.data.worlds.new("World")
    scene.world, scene.render.film_transparent = world, False
    tree = armature.versions.world_tree(world)
    node = next((node for node in tree.nodes if node.type == "BACKGROUND"), None) if tree is not None else None
    if node is not None:
        node.inputs["Color"].default_value, node.inputs["Strength"].default_value = (0.2, 0.05, 0.4, 1.0), 0.5
        wanted = (0.1, 0.025, 0.2)
    else:
        world.color = wanted = (0.1, 0.025, 0.2)
    empty = asked(scene, "rgba_f32")[0][..., 3] == 0
    picture = f12()
    assert (picture[..., 3] == 1).all()
    encoded = [12.92 * c if c <= 0.0031308 else 1.055 * c ** (1 / 2.4) - 0.055 for c in wanted]
    np.testing.assert_allclose(picture[empty][:, :3], np.tile(encoded, (empty.sum(), 1)), atol=0.6 / 255)
    assert (picture[~empty] == 1).all()


def test_a_keyed_world_is_that_of_each_frame(scene, tmp_path):
    scene.world, scene.render.film_transparent = bpy.data.worlds.new("World"), False
    tree = armature.versions.world_tree(scene.world)
    node = next((node for node in tree.nodes if node.type == "BACKGROUND"), None) if tree is not None else None
    owner, name = (scene.world, "color") if node is None else (node.inputs["Color"], "default_value")
    for frame, gray in ((1, 0.0), (2, 0.2), (3, 0.5), (4, 1.0)):
        setattr(owner, name, (gray, gray, gray, 1.0)[: len(getattr(owner, name))])
        owner.keyframe_insert(name, frame=frame)
    scene.render.filepath = str(tmp_path / "animation_")
    bpy.ops.render.render(animation=True)
    for frame, gray in ((1, 0.0), (2, 0.2), (3, 0.5), (4, 1.0)):
        encoded = 12.92 * gray if gray <= 0.0031308 else 1.055 * gray ** (1 / 2.4) - 0.055
        behind = np.median(hands.pixels(tmp_path / f"animation_{frame:04d}.png")[..., :3])
        assert behind == pytest.approx(encoded, abs=0.6 / 255)


def test_what_is_deleted_while_it_is_rendered_is_in_that_picture(scene, monkeypatch):
    """A render has a thread of its own: of the file it reads nothing, only what Blender evaluated for it."""
    wanted, read = f12(), render_engine.samples.read_moments

    def deleted_meanwhile(*args):
        bpy.data.objects.remove(bpy.data.objects["right"])
        return read(*args)

    monkeypatch.setattr(render_engine.samples, "read_moments", deleted_meanwhile)
    np.testing.assert_array_equal(f12(), wanted)


def test_only_what_was_evaluated_for_a_render_is_read_while_it_runs(sliding, monkeypatch):
    seen = []
    for owner, name in (
        (armature, "is_any_hand"),
        (armature, "read_hand"),
        (samples.seen_hands, "avatar_of"),
        (camera, "pinhole"),
    ):
        function = getattr(owner, name)

        def noticed(thing, *rest, function=function):
            seen.append(thing.is_evaluated)
            return function(thing, *rest)

        monkeypatch.setattr(owner, name, noticed)
    f12()
    assert len(seen) > 10
    assert all(seen)


def test_two_hands_are_one_picture_the_nearer_in_front(scene):
    armature.build_armature(bpy.context, "left", posing.rest_joints_m("left"), "left")
    (wanted,) = asked(scene, "rgba_f32")
    picture = f12()
    np.testing.assert_array_equal(picture, wanted)
    colors = {tuple(color) for color in picture[picture[..., 3] > 0]}
    assert colors == {(1, 1, 1, 1), (0, 0, 1, 1)}  # the stand-in draws a left hand blue


def test_every_view_layer_shows_its_own_hands(scene, tmp_path):
    hand = bpy.data.objects["right"]
    collection = bpy.data.collections.new("hands")
    scene.collection.children.link(collection)
    collection.objects.link(hand)
    scene.collection.objects.unlink(hand)
    without = scene.view_layers.new("without")
    without.layer_collection.children["hands"].exclude = True
    first = scene.view_layers[0].name
    passes = layers(scene, tmp_path, names=True)
    assert passes[f"{first}.Combined.A"].any()
    assert not passes["without.Combined.A"].any()


# ---- what a scene may ask for ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("region", [(0.25, 0.8, 0.1, 0.55), (0.0, 0.333, 0.501, 1.0), (0.41, 0.421, 0.0, 1.0)])
def test_a_region_is_the_same_part_of_the_whole_picture(scene, region):
    whole = f12()
    render = scene.render
    render.use_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = region
    render.use_crop_to_border = True
    part = camera.region(render)
    wanted = whole[part.top : part.bottom, part.left : part.right]
    np.testing.assert_array_equal(f12(), wanted)
    render.use_crop_to_border = False
    framed = f12()
    assert framed.shape == whole.shape
    np.testing.assert_array_equal(framed[part.top : part.bottom, part.left : part.right], wanted)
    framed[part.top : part.bottom, part.left : part.right] = 0
    assert not framed[..., 3].any()


def test_a_hand_that_is_hidden_in_renders_at_a_frame_is_not_in_its_picture(scene):
    hand = bpy.data.objects["right"]
    for frame, hidden in ((1, False), (2, True)):
        hand.hide_render = hidden
        hand.keyframe_insert("hide_render", frame=frame)
    scene.frame_set(1)
    assert f12().any()
    scene.frame_set(2)
    assert not f12().any()


def test_a_rig_that_is_switched_off_in_viewports_is_rendered(scene):
    wanted = f12()
    bpy.data.objects["right"].hide_viewport = True
    np.testing.assert_array_equal(f12(), wanted)


@pytest.fixture
def asked_for() -> Iterator[list[dict]]:
    """The headers of all requests for pictures."""
    headers: list[dict] = []
    link = runtime.link()
    request = link.request

    def spy(header, *rest, **more):
        headers.append(header)
        return request(header, *rest, **more)

    link.request = spy
    yield headers
    del link.request


def test_persistent_data_do_not_hide_what_was_changed(scene, tmp_path, asked_for):
    scene.render.use_persistent_data = True
    for name in ("one", "two"):
        bpy.data.objects["right"].jghand.avatar = str(tmp_path / name)
        f12()
    assert [header["hands"][0]["avatar"] for header in asked_for] == [str(tmp_path / name) for name in ("one", "two")]
    rig, _ = hands.mixamo_rig(bpy.context)
    f12()
    bpy.ops.jghand.use_armature()
    f12()
    sources.forget_map(rig, "left")
    f12()
    sources.forget(rig)
    f12()
    assert [len(header["hands"]) for header in asked_for[2:]] == [1, 3, 2, 1]


# ---- motion blur ----------------------------------------------------------------------------------------------------


@pytest.fixture
def sliding(scene) -> bpy.types.Scene:
    """The hand moves along x by 40 mm a frame, as a whole."""
    hand = bpy.data.objects["right"]
    hand.animation_data_clear()
    for frame, x in ((0, -0.04), (4, 0.12)):
        hand.location.x = x
        hand.keyframe_insert("location", frame=frame)
    for curve in armature.versions.fcurves(hand):
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.5
    scene.jghand.motion_samples = 4
    scene.frame_set(2)
    return scene


@pytest.mark.parametrize(("position", "first"), [("START", 0.0), ("CENTER", -0.25), ("END", -0.5)])
def test_motion_blur_is_the_mean_of_subframes(sliding, position, first):
    sliding.render.motion_blur_position = position
    blurred = f12()
    assert (sliding.frame_current, sliding.frame_subframe) == (2, 0.0)
    alone = []
    for place in (0.5, 1.5, 2.5, 3.5):
        frame = 2 + first + 0.5 * place / 4
        sliding.frame_set(int(frame // 1), subframe=frame % 1)
        alone.append(asked(sliding, "rgba_f32")[0][..., 3])
    np.testing.assert_allclose(blurred[..., 3], np.mean(alone, 0), atol=0.51 / 255)
    assert 0.2 < np.median(blurred[..., 3][(blurred[..., 3] > 0)]) < 0.8


def test_the_shutters_curve_weighs_the_subframes(sliding):
    curve = sliding.render.motion_blur_shutter_curve
    points = curve.curves[0].points
    while len(points) > 2:
        points.remove(points[1])
    points[0].location, points[-1].location = (0.0, 0.0), (1.0, 1.0)
    for point in points:
        point.handle_type = "VECTOR"
    curve.update()
    times = samples.shutter_times(sliding)
    weights = np.array([weight for _, weight in times])
    np.testing.assert_allclose(weights / weights[-1], np.array([1, 3, 5, 7]) / 7, atol=0.02)
    assert [time for time, _ in times] == pytest.approx([-0.1875, -0.0625, 0.0625, 0.1875])
    blurred, alone = f12(), []
    for time, _ in times:
        sliding.frame_set(int((2 + time) // 1), subframe=(2 + time) % 1)
        alone.append(asked(sliding, "rgba_f32")[0][..., 3])
    weighed = np.average(alone, axis=0, weights=weights)
    np.testing.assert_allclose(blurred[..., 3], weighed, atol=0.51 / 255)
    assert np.abs(weighed - np.mean(alone, 0)).max() > 0.1


def test_a_camera_that_moves_blurs_a_hand_that_does_not(sliding):
    hand = bpy.data.objects["right"]
    hand.animation_data_clear()
    eye = sliding.camera
    for frame, x in ((1, 0.0), (3, 0.1)):
        eye.location.x += x
        eye.keyframe_insert("location", frame=frame)
    sliding.frame_set(2)
    blurred = f12()[..., 3]
    assert ((blurred > 0.1) & (blurred < 0.9)).sum() > 20


def test_what_does_not_move_is_drawn_once(sliding):
    bpy.data.objects["right"].animation_data_clear()
    assert set(np.unique(f12()[..., 3])) == {0.0, 1.0}


def test_every_frame_of_an_animation_is_blurred_around_itself(sliding, tmp_path):
    sliding.render.filepath = str(tmp_path / "frame_")
    sliding.frame_start, sliding.frame_end = 1, 2
    bpy.ops.render.render(animation=True)
    for frame in (1, 2):
        came = hands.pixels(tmp_path / f"frame_{frame:04d}.png")
        sliding.frame_set(frame)
        sliding.render.filepath = str(tmp_path / "alone.png")
        np.testing.assert_array_equal(f12(), came)


# ---- failing --------------------------------------------------------------------------------------------------------


def refused(scene: bpy.types.Scene, words: str) -> None:
    """A still and an animation both end with these words, and nothing is written."""
    folder = Path(scene.render.filepath).parent
    for options in ({"write_still": True}, {"animation": True}):
        with pytest.raises(RuntimeError, match=words):
            bpy.ops.render.render(**options)
        assert not list(folder.glob("*.png"))


def test_no_camera_is_said(scene):
    scene.camera = None
    with pytest.raises(RuntimeError, match="camera"):
        bpy.ops.render.render(write_still=True)


def test_a_failed_render_says_why_above_its_image_too_and_in_lines_that_fit_a_pop_up():
    said, engine = [], render_engine.JGHandRenderEngine
    fake = SimpleNamespace(
        error_set=lambda text: said.append(("image", text)),
        update_stats=lambda *_: said.append(("shown", "")),
        report=lambda kind, text: said.append((kind, text)),
    )
    text = "Orthographic cameras have no depth of field here. Switch it off, or choose another (Hand Camera)"
    engine._say(fake, text)
    assert said == [("image", text), ("shown", ""), ({"ERROR"}, text)]  # a log has its sentence in one line
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ui, "bpy", SimpleNamespace(app=SimpleNamespace(background=False)))
        engine._say(fake, text)
    lines = said[-1][1].split(" \n")
    assert " ".join(lines) == text
    assert max(map(len, lines)) <= 48


REFUSED = {
    "no hand in this scene": lambda scene, hand: bpy.data.objects.remove(hand),
    "Panoramic cameras are not supported": lambda scene, hand: setattr(scene.camera.data, "type", "PANO"),
    "multiple views are not supported": lambda scene, hand: setattr(scene.render, "use_multiview", True),
    "A scale of zero is not supported": lambda scene, hand: setattr(hand.scale, "x", 0),
    "they are blocked": lambda scene, hand: setattr(hand.driver_add("location", 0).driver, "expression", "nonsense(3)"),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_rendered_is_said(scene, words):
    REFUSED[words](scene, bpy.data.objects["right"])
    refused(scene, words)


def test_a_mistake_of_our_own_fails_the_render_instead_of_writing_an_empty_picture(scene, monkeypatch, capsys):
    def mistake(*_):
        raise ZeroDivisionError("ours")

    monkeypatch.setattr(render_engine.view, "scene_linear", mistake)
    refused(scene, "ZeroDivisionError: ours")
    assert "Traceback" in capsys.readouterr().err


@contextlib.contextmanager
def linked_to(link: EngineLink) -> Iterator[None]:
    before, runtime._link = runtime._link, link
    try:
        yield
    finally:
        runtime._link = before


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("die", "stopped unexpectedly"),
        ("memory", "Out of memory"),
        ("bug", "Internal error"),
        ("slow", "does not answer in time"),
    ],
)
def test_an_engine_that_fails_or_takes_too_long_fails_the_render(scene, stand_in_command, monkeypatch, fault, words):
    if fault == "slow":
        monkeypatch.setattr(render_engine, "REQUEST_S", 0.2)
    with contextlib.closing(EngineLink(lambda: [*stand_in_command, fault])) as faulty, linked_to(faulty):
        with pytest.raises(RuntimeError, match=words):
            bpy.ops.render.render(animation=True)
        assert not list(Path(scene.render.filepath).parent.glob("*.png"))
    assert f12().any()


# ---- Blender's other ways to render ---------------------------------------------------------------------------------


def test_an_animation_and_a_batch_run_write_the_same_bytes(scene, tmp_path, monkeypatch, stand_in_command):
    """As far as the file's metadata leave out the clock; that is all in which they may differ."""
    scene.render.use_motion_blur, scene.jghand.motion_samples, scene.jghand.render_preset = True, 3, "viewport"
    scene.render.film_transparent, scene.render.dither_intensity = False, 1.0
    scene.view_settings.view_transform = "AgX"
    scene.world = bpy.data.worlds.new("World")
    scene.render.use_stamp_date = scene.render.use_stamp_render_time = False
    scene.render.filepath = str(tmp_path / "animation_")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hand.blend"))
    bpy.ops.render.render(animation=True)
    monkeypatch.setattr(runtime, "engine_command", lambda *_, **__: stand_in_command)
    for run in ("one", "two"):
        assert command.main([str(tmp_path / "hand.blend"), "--out", str(tmp_path / run)]) == 0
    runtime.use_link(EngineLink(lambda: stand_in_command))  # a run ends the link it used
    for frame in (1, 2, 3, 4):
        contents = {
            path.read_bytes()
            for path in (
                tmp_path / f"animation_{frame:04d}.png",
                *(tmp_path / run / "Camera" / f"{frame:04d}.png" for run in ("one", "two")),
            )
        }
        assert len(contents) == 1


# ---- the real engine ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dither", "steps"), [(0.0, 1.0), (1.0, 1.5)])
def test_under_standard_the_picture_is_the_engines_own(scene, real_engine, dither, steps):
    """Premultiplied and within one 8-bit step, at edges and inside. Blender's writer dithers by half a step more,
    unless that is off."""
    scene.render.dither_intensity = dither
    with linked_to(real_engine):
        (wanted,) = asked(scene, "rgba_f32")
        came = f12()
    assert 0.05 < (wanted[..., 3] > 0.5).mean() < 0.8
    assert (wanted[..., 3] > 0.02).sum() > (wanted[..., 3] > 0.98).sum() + 50  # there are soft edges
    premultiplied = np.concatenate([came[..., :3] * came[..., 3:], came[..., 3:]], -1)
    # a picture has nothing brighter than white, however little of it is covered
    wanted[..., :3] = np.clip(wanted[..., :3], 0, wanted[..., 3:])
    assert np.abs(premultiplied - wanted).max() < 1.01 * steps / 255


def test_depth_of_field_and_bones_come_from_the_real_engine(scene, real_engine, tmp_path):
    scene.view_layers[0].use_pass_z = scene.jghand.use_pass_ids = True
    scene.jghand.render_preset = "draft"
    with linked_to(real_engine):
        sharp = layers(scene, tmp_path)
        depth_of_field = scene.camera.data.dof
        depth_of_field.use_dof, depth_of_field.aperture_fstop, depth_of_field.focus_distance = True, 0.8, 0.9
        blurred = layers(scene, tmp_path)
    edge = [np.abs(np.diff(passes["Combined.A"], axis=1)).max() for passes in (sharp, blurred)]
    assert edge[1] < 0.6 * edge[0]
    np.testing.assert_allclose(blurred["Depth.Z"], sharp["Depth.Z"], rtol=1e-5)
    np.testing.assert_array_equal(blurred["JGHandId.X"], sharp["JGHandId.X"])
    numbers = np.unique(sharp["JGHandId.X"])
    assert set(numbers) <= set(range(21))
    assert len(numbers) > 8
    assert view.NOTHING_DEPTH in sharp["Depth.Z"]
