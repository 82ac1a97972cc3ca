"""Armatures, places and cameras for the tests inside Blender."""

from pathlib import Path

import bpy
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Matrix, Vector

from blender_addon.core import posing
from blender_addon.core.joints import HANDEDNESSES, NAMES, PARENTS
from blender_addon.hand import armature, motion, stand_ins

# object transforms that a hand must survive: location, rotation, scale
PLACES = {
    "where it was made": ((0, 0, 0), (0, 0, 0), (1, 1, 1)),
    "moved and turned": ((0.3, -1.2, 0.7), (0.4, 1.1, -2.0), (1, 1, 1)),
    "scaled": ((0.1, 0.2, -0.3), (1.0, 0.2, 0.5), (1.5, 1.5, 1.5)),
    "stretched": ((-0.2, 0.1, 0.4), (0.3, -0.8, 0.6), (0.7, 1.2, 1.6)),
    "turned inside out": ((0.2, 0.0, 0.1), (0.3, -0.8, 0.6), (-1.1, -1.1, 1.1)),
}


def moving_hand_m(handedness: str, frames: int = 5, seed: int = 0) -> np.ndarray:
    """(F, 21, 3) joints, meters: a hand with changing pose, bone lengths and palm."""
    rng = np.random.default_rng(seed)
    rest = posing.rest_joints_m(handedness)
    joints = np.tile(rest, (frames, 1, 1))
    joints[:, 0] = rng.uniform(-0.05, 0.05, (frames, 3))
    for place in range(1, 21):
        bone = rest[place] - rest[PARENTS[place]]
        noise = rng.standard_normal((frames, 3)) * np.linalg.norm(bone) * (0.05 if PARENTS[place] == 0 else 0.4)
        joints[:, place] = joints[:, PARENTS[place]] + (bone + noise) * rng.uniform(0.9, 1.1, (frames, 1))
    return joints


def keyed_hand(context: bpy.types.Context, handedness: str, joints_m: np.ndarray) -> bpy.types.Object:
    hand = armature.build_armature(context, handedness, posing.rest_joints_m(handedness, joints_m), handedness)
    motion.key_motion(hand, joints_m, context.scene, range(1, 1 + len(joints_m)))
    return hand


def joints_of(hand: bpy.types.Object) -> np.ndarray:
    """(21, 3) joints of a hand as it is now, meters, in its own space."""
    bpy.context.view_layer.update()
    return armature.read_hand(hand, bpy.context.evaluated_depsgraph_get()).joints_m


def stand_ins_of(hand: bpy.types.Object) -> list[bpy.types.Object]:
    """Of a rig with two hands, two."""
    return [thing for thing in bpy.data.objects if stand_ins.MARK in thing and thing.parent == hand]


def mixamo_rig(context: bpy.types.Context) -> tuple[bpy.types.Object, dict[str, np.ndarray]]:
    """An armature with two hands, as Mixamo names them, without tip bones, under an arm that can move."""
    data = bpy.data.armatures.new("Body")
    rig = bpy.data.objects.new("Body", data)
    context.scene.collection.objects.link(rig)
    context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    joints = {}
    for side in HANDEDNESSES:
        at = posing.rest_joints_m(side) + np.array([0.6 if side == "left" else -0.6, 0.0, 1.2])
        joints[side] = at
        names = [f"mixamorig:{side.title()}Hand"]
        names += [f"{names[0]}{name[:-1].title()}{name[-1]}" for name in NAMES[1:]]
        arm = data.edit_bones.new(f"mixamorig:{side.title()}ForeArm")
        arm.head, arm.tail = Vector(at[0]) + Vector((0, -0.25, 0)), at[0]
        for place, name in enumerate(names):
            if place and place % 4 == 0:
                continue
            bone = data.edit_bones.new(name)
            bone.head, bone.tail = at[place], at[9 if place == 0 else place + 1]
            bone.parent = data.edit_bones[names[PARENTS[place]]] if place else arm
    bpy.ops.object.mode_set(mode="OBJECT")
    return rig, joints


def named_bones(context: bpy.types.Context, names: list[str]) -> bpy.types.Object:
    """An armature with bones of these names and no meaning, active."""
    data = bpy.data.armatures.new("Rig")
    rig = bpy.data.objects.new("Rig", data)
    context.scene.collection.objects.link(rig)
    context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for place, name in enumerate(names):
        bone = data.edit_bones.new(name)
        bone.head, bone.tail = (0.01 * place, 0.0, 0.0), (0.01 * place, 0.02 + 0.001 * place, 0.0)
    bpy.ops.object.mode_set(mode="OBJECT")
    return rig


def joint_empties(context: bpy.types.Context, handedness: str) -> list[bpy.types.Object]:
    """21 selected empties where the joints of a resting hand are, named after them, standard order."""
    things = []
    for name, place in zip(NAMES, posing.rest_joints_m(handedness), strict=True):
        thing = bpy.data.objects.new(f"{handedness}_{name}", None)
        thing.location = place
        context.scene.collection.objects.link(thing)
        thing.select_set(True)
        things.append(thing)
    context.view_layer.update()
    return things


def select_bones(thing: bpy.types.Object, *names: str) -> None:
    """Selects these bones alone."""
    for bone in thing.pose.bones:
        (bone if hasattr(bone, "select") else bone.bone).select = bone.name in names


def put(thing: bpy.types.Object, place: tuple) -> None:
    location, rotation, scale = place
    thing.matrix_world = Matrix.LocRotScale(Vector(location), Euler(rotation), Vector(scale))


def camera_on(context: bpy.types.Context, target: np.ndarray, distance: float, **lens) -> bpy.types.Object:
    """A camera that looks at `target` (Blender units) from `distance`, a little aslant and tilted."""
    data = bpy.data.cameras.new("Camera")
    for name, value in lens.items():
        setattr(data, name, value)
    camera = bpy.data.objects.new("Camera", data)
    context.scene.collection.objects.link(camera)
    back = Vector((0.4, -0.5, 0.77)).normalized()
    turn = back.to_track_quat("Z", "Y").to_matrix().to_4x4() @ Matrix.Rotation(0.2, 4, "Z")
    camera.matrix_world = Matrix.Translation(Vector(target) + back * distance) @ turn
    return camera


def blenders_pixels(scene: bpy.types.Scene, camera: bpy.types.Object, points: np.ndarray, size: tuple) -> np.ndarray:
    """(N, 2) pixels, v down, where Blender itself projects world points (Blender units)."""
    seen = [world_to_camera_view(scene, camera, Vector(point)) for point in points]
    return np.array([(p.x * size[0], (1 - p.y) * size[1]) for p in seen])


def pixels(path: Path | str, *, as_it_is: bool = False) -> np.ndarray:
    """(H, W, 4) of a picture file, straight alpha, top row first. as_it_is: its bytes, and not their colors"""
    image = bpy.data.images.load(str(path))
    if as_it_is:
        image.colorspace_settings.name, image.alpha_mode = "Non-Color", "CHANNEL_PACKED"
    values = np.array(image.pixels[:], np.float32).reshape(image.size[1], image.size[0], 4)[::-1]
    bpy.data.images.remove(image)
    return values


def alpha_of(path: Path) -> np.ndarray:
    """(H, W) alpha of a picture file, top row first."""
    return pixels(path)[..., 3]


def centroid(weight: np.ndarray) -> np.ndarray:
    """(2,) pixels, (0, 0) the top-left corner, of an (H, W) picture of weights."""
    assert weight.sum() > 0, "nothing was drawn"
    rows, columns = np.indices(weight.shape) + 0.5
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
