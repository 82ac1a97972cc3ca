"""What a web page needs of an avatar to pose it: the arrays that the native kernels read, and the few that are prepared
for every pose. The page has the same kernels, compiled to WebAssembly, and pose.js in the place of avatar/posing.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import Blocks
from jghand_engine.avatar.cast_task import CAPSULE_SINE2_MIN, CastStep, anchor_blocks
from jghand_engine.avatar.corrective_task import LinearStep, NetworkStep, corrective_step
from jghand_engine.avatar.correctives import LinearCorrectives, PoseFeatures, products
from jghand_engine.avatar.detail import LOG_RATIO_MAX, MIX_FROM, MIX_TO, Detail
from jghand_engine.avatar.detail_correctives import NUMBERS, SIMPLE, angle_numbers
from jghand_engine.avatar.detail_mips import filled, with_rings
from jghand_engine.avatar.detail_storage import differences, height_differences
from jghand_engine.avatar.lamp_rows import LIMITS
from jghand_engine.avatar.learned import CAPSULE_LENGTH2_MIN, Learned, anchors_around
from jghand_engine.avatar.relief import BEND_DEG, HEIGHT_STEP_M, Bend, Relief, finger_shares
from jghand_engine.avatar.relighting import ALBEDO_MAX, GAP_FILL, albedo_gain, detail_power, in_studio, relightable
from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.avatar.scene_light_step import SceneLightStep
from jghand_engine.avatar.skin_task import (
    ellipsoid_axes,
    learned_arrays,
    learned_task,
    skin_arrays,
    skin_task,
    surface_task,
)
from jghand_engine.avatar.tiers import Tier
from jghand_engine.export.web.pack import Pack, task_in_words
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.native.detail_task import DetailHand, DetailTask
from jghand_engine.native.learned_tasks import CorrectiveKind, LearnedTask
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.render.detail import ALPHA_FROM, ALPHA_TO, FADE_FROM_M, FADE_TO_M, GRAZE_MAX
from jghand_engine.template.surface import one_uv_each

# arrays that are read in 16 bits: of the order of a micrometer, and of 1/65535 of a color
_ROUNDED = {
    *("skin.rest", "skin.axes", "look", "constant", "share", "cast.rest", "cast.foreign", "places", "scene.material"),
    *(
        "detail.skin.rest",
        "detail.constant",
        "detail.uv",
        "detail.share",
        "detail.normal",
        "detail.near",
        "detail.whole",
    ),
}
# those that the kernels or the page write
_WRITTEN = {
    *("matt", "given", "numbers", "features", "cast.capsule", "cast.capsule_lamp", "cast.other"),
    *("cast.fallen", "scene.capsule_lamp", "scene.posed", "scene.visible", "scene.skin_seen", "scene.thrown"),
    "scene.bounced",
    *("scene.sky", "scene.reflecting", "scene.reached", "front", "detail.vertex", "detail.slope", "detail.bend"),
    "detail.numbers",
}
# of a signed byte, which makes an unsigned one in the same order of it
SIGN_BIT = np.uint8(128)
# of what relief makes of light, and alpha from which on a pixel is the hand's wholly (native/detail.cpp)
LIGHT_LEAST, LIGHT_MOST, FILLED_FROM = 0.4, 2.5, 1 / 64
# the light that is turned: an even world, W/(m2 sr), and a wide sun, W/m2 on what faces it: skin of middle tone that
# does is as bright as it can be without being cut
WORLD_RADIANCE, SUN_W_M2, SUN_RAD = 0.45, 3.5, 0.35


def with_cheap_correctives(avatar: HandAvatar) -> tuple[HandAvatar, str]:
    """The avatar with its linear tier where it has one, and "linear", "network" or "none"."""
    if avatar.learned is None or avatar.learned.correctives is None:
        return avatar, "none"
    distilled = avatar.learned.distilled
    if distilled is not None and distilled.linear is not None:
        return replace(avatar, learned=replace(avatar.learned, correctives=distilled.linear)), Tier.LINEAR.value
    kind = Tier.LINEAR.value if isinstance(avatar.learned.correctives, LinearCorrectives) else "network"
    return avatar, kind


def pack_hand(avatar: HandAvatar, pack: Pack) -> dict[str, Any]:
    """Adds an avatar's arrays to `pack`, and says in plain data what else there is to know of posing it.

    avatar: with the correctives that the page shall compute.
    """
    given, avatar = avatar, in_studio(avatar)
    blocks = Blocks.of(avatar.position_m)
    learned = avatar.learned
    skin = skin_task(blocks)
    task = LearnedTask() if learned is None else learned_task(learned, avatar.handedness)
    arrays = {f"skin.{name}": array for name, array in skin_arrays(avatar, blocks).items()}
    about: dict[str, Any] = {"correctives": None, "cast": None, "light": None, "detail": None, "fades": False}
    if learned is not None:
        arrays |= learned_arrays(avatar, learned, blocks)
        task.lobes = len(arrays["lobe"])
        about["correctives"] = _correctives(learned, avatar, blocks, task, arrays)
        about["cast"] = _cast(learned, avatar, blocks, task, arrays)
        if learned.reflects and learned.cast is not None:
            about["light"] = _light(given, blocks, arrays)
        about["fades"] = learned.fades
        if learned.fades or about["light"]:
            arrays["front"] = np.empty(blocks.rows)
        if avatar.detail is not None:
            about["detail"] = _detail(given, avatar.detail, learned, arrays)
    task.skin = skin
    for name, array in arrays.items():
        _add(pack, name, array)
    rows = blocks.rows
    pack.empty("skin.position", (rows, 3))
    pack.empty("skin.sigma", (rows,))
    if ellipsoid_axes(avatar) is not None:
        pack.empty("skin.covariance", (rows, 6))
    if learned is None:
        pack.exact("rgb", blocks.in_rows(avatar.rgb), "f4")
    else:
        pack.empty("rgb", (rows, 3))
    opacity = blocks.in_rows(avatar.opacity)
    pack.rounded("opacity", opacity[None, None])
    pack.exact("skeleton", avatar.skeleton().packed, "f8")
    return about | {"rows": rows, "task": task_in_words(task)}


def _add(pack: Pack, name: str, array: np.ndarray) -> None:
    if name in _WRITTEN:
        pack.empty(name, array.shape)
    elif name in ("direction", "detail.direction"):
        pack.exact(name, array, "i1")
    elif name in ("detail.shades", "detail.heights"):
        pack.exact(name, array, "b1")
    elif name in _ROUNDED:
        pack.rounded(name, array)
    elif name.endswith("weight") or name == "scene.hides":
        pack.rounded(name, array[:, None])
    elif name in ("nearest", "detail.nearest", "detail.faces") or name.endswith("bone"):
        pack.counts(name, array)
    else:
        pack.exact(name, array, "i4" if array.dtype.kind in "iu" else "f4")


def _correctives(
    learned: Learned, avatar: HandAvatar, blocks: Blocks, task: LearnedTask, arrays: dict[str, np.ndarray]
) -> dict[str, Any] | None:
    step = corrective_step(learned.correctives, avatar, blocks, task)
    if not isinstance(step, LinearStep | NetworkStep):
        return None
    arrays |= step.arrays
    arrays["texels"] = step.features.texels
    about: dict[str, Any] = {"features": _features(step.features)}
    if isinstance(step, NetworkStep):
        step.prepare(task, np.zeros(37))  # says to the task that there is a network
        arrays["angles_in"] = step.angles_in
        return about | {"kind": "network", "hidden": int(task.hidden)}
    return about | {
        "kind": "linear", "basis": int(task.basis), "mean": step.mean.tolist(), "projection": step.projection.tolist(),
        "first": step.first, "second": step.second,
    }  # fmt: skip


def _features(features: PoseFeatures) -> dict[str, Any]:
    names = ("source", "offset", "slope")
    plain = {name: getattr(features, name).tolist() for name in names}
    return plain | {"level1": features.level1, "shape": list(features.texels.shape)}


def _cast(
    learned: Learned, avatar: HandAvatar, blocks: Blocks, task: LearnedTask, arrays: dict[str, np.ndarray]
) -> dict[str, Any] | None:
    if learned.cast is None:
        return None
    cast = CastStep(learned.cast, avatar, blocks, task)
    arrays |= {f"cast.{name}": array for name, array in cast.arrays.items()} | cast.around
    return {
        "flesh_m": [ends_m.tolist() for ends_m in cast.flesh_ends_m], "radius_m": cast.flesh_radius_m.tolist(),
        "direction": cast.direction.tolist(),
        "length2_min": CAPSULE_LENGTH2_MIN, "sine2_min": CAPSULE_SINE2_MIN,
    }  # fmt: skip


def _detail(avatar: HandAvatar, detail: Detail, learned: Learned, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """What the first step of native/detail.cpp reads of the surface, and what the page's shaders draw on it."""
    vertex, uv, faces = one_uv_each(detail.faces, detail.face_uv)
    position_m, blocks = detail.position_m[vertex], Blocks.of(detail.position_m[vertex])
    relative_m = position_m.astype(np.float64) - avatar.canonical_joints_m[0]
    own = {
        "skin.rest": blocks.blocked(np.pad(relative_m, ((0, 0), (0, 1)))),
        **{f"skin.{name}": array for name, array in blocks.bones(detail.bone_weights[vertex]).items()},
        "uv": blocks.in_rows(np.column_stack([uv[:, 0], 1 - uv[:, 1]]))[..., None],
        "faces": np.argsort(blocks.order)[faces], "shades": differences(filled(detail.texture, detail.skin)),
        "vertex": np.empty((3, blocks.rows)),
    }  # fmt: skip
    # the positions themselves: seen in parallel, along the axes
    task = DetailTask(hand_count=1, orthographic=1, fx=1.0, fy=1.0, z_near=-float(np.finfo(np.float32).max))
    task.camera_from_position[:] = np.eye(3, 4).ravel().tolist()
    surface, hand, relief = surface_task(blocks), DetailHand(), None
    if detail.correctives is not None:
        surface.correctives, surface.basis = CorrectiveKind.LINEAR, NUMBERS
        own |= detail.correctives.of(vertex).arrays(blocks) | {"numbers": np.empty((JOINT_COUNT, NUMBERS))}
    if detail.relief is not None and detail.slopes is not None:
        hand.rise = step_m = detail.slopes.step_m
        bend = Bend(position_m, finger_shares(detail.bone_weights[vertex]), avatar.canonical_joints_m)
        own |= _relief_arrays(detail.relief, detail.skin, bend, blocks) | _light_around(learned, position_m, blocks)
        own["normal"] = blocks.blocked(detail.normals[vertex])
        relief = {
            "step_m": step_m, "height_m": HEIGHT_STEP_M, "limits": [LIGHT_LEAST, LIGHT_MOST],
            "joints_m": (avatar.canonical_joints_m - avatar.canonical_joints_m[0]).tolist(),
            "rest_deg": bend.rest_deg.tolist(), "bend_deg": BEND_DEG,
        }  # fmt: skip
    if detail.ends_hand:
        own["whole"] = blocks.in_rows(detail.shown[vertex, None])[..., None]
    arrays |= {f"detail.{name}": array for name, array in own.items()}
    powers = [detail_power(avatar, in_scene=in_scene) for in_scene in (False, True)]
    return {
        "tasks": {"surface": task_in_words(surface), "hands": task_in_words(hand), "task": task_in_words(task)},
        "products": products(SIMPLE, NUMBERS), "rest": angle_numbers(avatar.canonical_angles_rad).ravel().tolist(),
        "size": detail.size, "log_ratios_max": [power * LOG_RATIO_MAX for power in powers], "depth_m": detail.depth_m,
        "fades_m": [FADE_FROM_M, FADE_TO_M], "graze_max": GRAZE_MAX, "alphas": [ALPHA_FROM, ALPHA_TO],
        "mixes": [MIX_FROM, MIX_TO], "relief": relief, "filled_from": FILLED_FROM,
        "ends_hand": detail.ends_hand,
    }  # fmt: skip


def _relief_arrays(relief: Relief, skin: np.ndarray, bend: Bend, blocks: Blocks) -> dict[str, np.ndarray]:
    # heights go on beside the skin, of which the page does not know where it ends
    height = relief.height.astype(np.float32)
    near_skin = with_rings(height, skin)
    height = filled(np.rint(height - np.iinfo(np.int8).min).astype(np.uint8), near_skin) ^ SIGN_BIT
    return {
        "heights": height_differences(height.view(np.int8)), "near": blocks.in_rows(bend.near)[..., None],
        "bend": np.empty(blocks.rows), "slope": np.empty((4, blocks.rows)),
    }  # fmt: skip


def _light_around(learned: Learned, position_m: np.ndarray, blocks: Blocks) -> dict[str, np.ndarray]:
    """The anchors of the light around places (V, 3), which a hand without shadows does not need."""
    if learned.cast is None:
        return {}
    nearest, share = anchors_around(learned.cast.anchors, position_m)
    anchors = learned.cast.anchors
    rows = np.argsort(anchor_blocks(anchors.position_m, anchors.normal).order)
    return {"nearest": blocks.blocked(rows[nearest], np.int32), "share": blocks.blocked(share)}


def turned_light(towards: tuple[float, float, float]) -> SceneLight:
    """The light that people turn on the page, with its sun in a direction."""
    world = World(np.full((16, 32, 3), WORLD_RADIANCE))
    return SceneLight(world, (Lamp(LampKind.SUN, (SUN_W_M2, SUN_W_M2, SUN_W_M2), towards, angle_rad=SUN_RAD),))


def _light(avatar: HandAvatar, blocks: Blocks, arrays: dict[str, np.ndarray]) -> dict[str, Any] | None:
    """What the page needs beside to light the hand anew: it makes the albedo of the colors that it has."""
    lit, scratch = relightable(avatar), LearnedTask()
    if lit.learned is None or lit.learned.cast is None or lit.learned.response is None:
        return None
    cast = CastStep(lit.learned.cast, lit, blocks, scratch)
    step = SceneLightStep(lit.learned.response, blocks, cast, scratch, LIMITS)
    step.prepare(turned_light((0.0, 0.0, 1.0)), lit.skeleton().bones(lit.canonical_joints_m))
    used = {name: array for name, array in step.arrays.items() if name != "left"}
    used["lamp"], used["casting"] = used["lamp"][: step.task.lamps], used["casting"][: step.task.slots]
    used |= {"cell": cast.arrays["lamp"], "capsule_lamp": cast.arrays["capsule_lamp"]}
    arrays |= {f"scene.{name}": array for name, array in used.items()}
    is_guess = lit is not avatar
    return {
        "task": task_in_words(step.task), "direction": cast.direction.tolist(), "most": ALBEDO_MAX if is_guess else 1.0,
        "gain": albedo_gain(avatar).tolist() if is_guess else [1.0] * 3, "grown": GAP_FILL if is_guess else 1.0,
    }  # fmt: skip
