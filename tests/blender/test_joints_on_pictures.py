"""On the engine's pictures every joint lies where Blender itself projects it, and as far away as it is.

The avatars are three small Gaussians each, exactly at three joints, in red, green and blue.
"""

import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import bpy
import hands
import numpy as np
import pytest

from blender_addon.core.joints import HANDEDNESSES
from blender_addon.core.view import HandInSpace, Moment, Pinhole, picture_request
from blender_addon.hand import armature
from blender_addon.render import camera
from blender_addon.renderer.link import EngineLink
from blender_addon.renderer.process import engine_command

# worst observed 0.020 px (a Gaussian's middle is not quite its centroid in perspective); the promise is 0.5
AGREES_PX = 0.03
# worst observed 6e-7 m: float32 depth
DEPTH_M = 1e-6

VIEWS = {
    "perspective": ((512, 334), 100, {}),
    "shifted": ((512, 334), 100, {"shift_x": 0.1, "shift_y": -0.08, "lens": 40}),
    "portrait": ((334, 512), 100, {}),
    "half size": ((512, 334), 50, {}),
}


@pytest.fixture(scope="module")
def avatars(engine_python, tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("avatars")
    writer = Path(__file__).with_name("write_joint_avatars.py")
    subprocess.run([engine_python, "-I", str(writer), str(folder)], check=True)
    return [str(folder / f"{file}.jghand") for file in range(7)]


@pytest.fixture(scope="module")
def engine(engine_python) -> Iterator[EngineLink]:
    link = EngineLink(lambda: engine_command(engine_python))
    yield link
    link.close()


def picture(engine: EngineLink, view: Pinhole, *seen: HandInSpace) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 4) premultiplied and (H, W) depth in meters."""
    reply = engine.request(*picture_request([Moment(view, seen)], preset="draft", outputs=["rgba_f32", "depth"]))
    return tuple(np.asarray(reply.arrays[name].view()) for name in ("rgba_f32", "depth"))


def check_joints(context: bpy.types.Context, engine: EngineLink, avatars: list[str], eye: bpy.types.Object) -> None:
    """Compares every joint of the only hand in the scene, at the current frame, with Blender's own projection."""
    depsgraph = context.evaluated_depsgraph_get()
    (hand,) = armature.hands_at_any_frame(context.view_layer)
    seen = armature.read_hand(hand, depsgraph)
    view = camera.pinhole(eye, depsgraph)
    unit_m = context.scene.unit_settings.scale_length
    wanted = hands.blenders_pixels(context.scene, eye, seen.joints_world_m / unit_m, (view.width, view.height))
    distance_m = view.project(seen.joints_world_m)[:, 2]
    assert (wanted > 10).all()
    assert (wanted < np.array([view.width, view.height]) - 10).all()
    for file, avatar in enumerate(avatars):
        rgba, depth_m = picture(engine, view, replace(seen, avatar=avatar))
        for channel in range(3):
            joint = 3 * file + channel
            alone = rgba[..., channel] > 0.99 * rgba[..., 3]
            came = hands.centroid(rgba[..., channel])
            assert np.linalg.norm(came - wanted[joint]) < AGREES_PX
            column, row = wanted[joint].astype(int)
            if alone[row, column]:  # no other joint of the three in front
                assert abs(depth_m[row, column] - distance_m[joint]) < DEPTH_M


@pytest.mark.parametrize(("size", "percentage", "lens"), VIEWS.values(), ids=VIEWS.keys())
@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_joints_are_drawn_where_blender_projects_them(context, engine, avatars, handedness, size, percentage, lens):
    hands.keyed_hand(context, handedness, hands.moving_hand_m(handedness))
    camera.set_picture_size(context.scene.render, *size)
    context.scene.render.resolution_percentage = percentage
    eye = hands.camera_on(context, (0, 0.09, 0), 0.75, **lens)
    armature.at_frame(context.scene, 2)
    check_joints(context, engine, avatars, eye)
