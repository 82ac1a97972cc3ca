"""Preview Movie: a movie of hands and all else from a copy of the scene, of which nothing stays. Solid shading needs a
window; here Cycles draws what is no hand."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import bpy
import hands
import numpy as np
import pytest
from test_combine import fails_from, is_magenta

from blender_addon import versions
from blender_addon.render import composite, preview

pytestmark = pytest.mark.usefixtures("linked_extension")


@pytest.fixture
def scene(context, tmp_path, monkeypatch) -> bpy.types.Scene:
    """A hand, half behind a white wall, in a scene of EEVEE with motion blur, a preview range and a compositor."""
    monkeypatch.setattr(preview, "REST_ENGINE", "CYCLES")
    hands.keyed_hand(context, "right", hands.moving_hand_m("right", frames=4))
    scene = context.scene
    scene.cycles.samples = 1
    scene.camera = hands.camera_on(context, (0, 0.09, 0), 0.5)
    scene.render.engine = next(name for name in ("BLENDER_EEVEE_NEXT", "BLENDER_EEVEE") if _is_engine(scene, name))
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 192, 128, 50
    scene.render.use_motion_blur = scene.use_preview_range = True
    scene.render.dither_intensity = 0.0
    scene.frame_end, scene.frame_preview_start, scene.frame_preview_end = 99, 2, 3
    scene.render.filepath = str(tmp_path / "movie" / "f_####")
    versions.write_png(scene.render.image_settings)
    scene.render.image_settings.color_mode = "RGBA"
    versions.ensure_compositor_tree(scene)
    bpy.ops.mesh.primitive_plane_add(size=0.2, location=(0.13, 0.09, 0.05))
    context.view_layer.objects.active = bpy.data.objects["right"]
    scene.frame_set(4)
    return scene


def _is_engine(scene: bpy.types.Scene, name: str) -> bool:
    try:
        scene.render.engine = name
    except TypeError:
        return False
    return True


def state(scene: bpy.types.Scene) -> dict:
    """Every plain setting of the scene and what it consists of, and how many data-blocks there are."""
    owners = (scene, scene.render, scene.display.shading, scene.view_settings, scene.jghand, scene.view_layers[0])
    found = {
        (type(owner).__name__, each.identifier): str(getattr(owner, each.identifier))
        for owner in owners
        for each in owner.bl_rna.properties
        if each.type in ("BOOLEAN", "INT", "FLOAT", "STRING", "ENUM")
    }
    found |= {name: len(getattr(bpy.data, name)) for name in ("scenes", "objects", "cameras", "node_groups", "worlds")}
    return found | {"properties": dict(scene.items()).keys(), "camera": scene.camera}


def written(folder: Path) -> dict[str, np.ndarray]:
    return {path.name: hands.pixels(path)[..., :3] for path in sorted((folder / "movie").iterdir())}


def test_a_preview_has_hands_and_all_else_over_the_preview_range_and_leaves_nothing(scene, tmp_path, capfd):
    before = state(scene)
    assert bpy.ops.jghand.preview_movie() == {"FINISHED"}
    assert f"Wrote 2 images in {tmp_path / 'movie'}." in capfd.readouterr().out
    assert state(scene) == before
    pictures = written(tmp_path)
    assert list(pictures) == ["f_0002.png", "f_0003.png"]
    scene.render.engine, scene.render.use_motion_blur = "CYCLES", False
    scene.render.use_compositing = False
    scene.render.filepath = str(tmp_path / "alone.png")
    for frame in (2, 3):
        scene.frame_set(frame)
        bpy.ops.render.render(write_still=True)
        alone, picture = hands.pixels(scene.render.filepath)[..., :3], pictures[f"f_{frame:04d}.png"]
        hand = np.abs(picture - alone).max(-1) > 0.3
        assert hand.sum() > 10
        assert not is_magenta(picture)
        assert np.abs(picture - alone)[~hand].mean() < 0.02, "all else is as it is without hands"
    assert (np.abs(pictures["f_0002.png"] - pictures["f_0003.png"]).max(-1) > 0.3).any(), "it moves"


def test_one_image_or_a_movie_is_named_by_its_file(scene, capfd):
    scene.frame_preview_end = scene.frame_preview_start
    bpy.ops.jghand.preview_movie()
    assert re.search(r"Wrote .*movie.f_0002\.png\.", capfd.readouterr().out)


@pytest.mark.parametrize("size", [(191, 127), (1920, 1081), (9, 5)])
def test_a_preview_has_an_even_size_of_the_scenes_shape(scene, context, size):
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = *size, 100
    got = preview._size(scene, context)
    assert [side % 2 for side in got] == [0, 0]
    assert all(abs(one - other) <= 1 for one, other in zip(got, size, strict=True))


def test_a_combined_scene_has_a_preview_too_and_stays_combined(scene, tmp_path):
    bpy.ops.jghand.combine_with_scene()
    before, tree = state(scene), versions.compositor_tree(scene)
    nodes = len(tree.nodes)
    bpy.ops.jghand.preview_movie()
    assert state(scene) == before
    assert len(tree.nodes) == nodes
    assert composite.hands_scene_of(scene) is not None
    assert len(written(tmp_path)) == 2


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("Error: No camera found in scene"), ValueError()])
def test_a_preview_that_is_broken_off_is_over_and_says_why(scene, context, monkeypatch, error):
    def broken(*_):
        raise error

    monkeypatch.setattr(preview, "_render_aside", broken)
    before = state(scene)
    with pytest.raises(type(error)) as caught:
        preview.PreviewMovie.run(SimpleNamespace(_is_aside=True), context)
    assert caught.value is error
    assert state(scene) == before
    assert bpy.ops.jghand.preview_movie.poll(), "another one may begin"


def test_a_hand_that_fails_is_magenta_in_the_preview_which_says_so(scene, tmp_path, capfd):
    fails_from(bpy.data.objects["right"], 3)
    bpy.ops.jghand.preview_movie()
    assert [is_magenta(picture) for picture in written(tmp_path).values()] == [False, True]
    reason = "The hands of frame 3 failed and are magenta: A scale of zero is not supported"
    assert re.search(f"Warning: Wrote 2 images in .*movie. {reason}", capfd.readouterr().out)


def view_of(context) -> bpy.types.Area:
    return next(area for area in context.screen.areas if area.type == "VIEW_3D")


@contextmanager
def begun_in(area: bpy.types.Area) -> Iterator[bpy.types.Scene]:
    """The copy that a preview renders which is begun in a view."""
    with bpy.context.temp_override(area=area):
        assert bpy.ops.jghand.preview_movie.poll()
        movie = preview._begin(bpy.context)
    copy = preview._scene(movie.scene_uid)
    assert copy is not None
    yield copy
    preview._remove(movie)


def test_a_preview_of_a_view_looks_as_the_view_and_is_no_larger(scene, context):
    area = view_of(context)
    shading, region = area.spaces.active.shading, next(each for each in area.regions if each.type == "WINDOW")
    shading.type, shading.light = "SOLID", "FLAT"
    scene.jghand.viewport_preset, scene.jghand.render_preset = "draft", "reference"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 16000, 9000, 100
    with begun_in(area) as copy:
        assert copy.jghand.render_preset == "draft"
        assert copy.view_settings.view_transform == "Standard"
        assert copy.display.shading.light == "FLAT"
        assert 1 < copy.render.resolution_x <= region.width
        assert 1 < copy.render.resolution_y <= region.height


def test_a_view_becomes_a_camera_of_the_copy_alone(scene, context):
    """As Blender projects it in the view: perspective and orthographic, with markers that would choose a camera."""
    scene.timeline_markers.new("cut", frame=1).camera = scene.camera
    space = view_of(context).spaces.active
    space.lens, space.clip_start, space.clip_end = 50, 0.02, 80
    for perspective in ("PERSP", "ORTHO"):
        space.region_3d.view_perspective = perspective
        space.region_3d.view_location, space.region_3d.view_distance = (0.1, 0.2, 0.3), 2.5
        copy = scene.copy()
        made = preview._add_camera(copy, space)
        copy.view_layers[0].update()
        depsgraph = copy.view_layers[0].depsgraph
        got = made.calc_matrix_camera(depsgraph, x=160, y=90)
        # Blender: the view's frustum is 72 mm wide in front of its lens, or as wide at its distance
        wanted = 2 * space.lens / 72 if perspective == "PERSP" else 2 / (2.5 * 72 / space.lens)
        assert got[0][0] == pytest.approx(wanted)
        assert copy.camera == made
        assert not copy.timeline_markers
        bpy.data.scenes.remove(copy)
        bpy.data.cameras.remove(made.data)
    assert len(scene.timeline_markers) == 1
