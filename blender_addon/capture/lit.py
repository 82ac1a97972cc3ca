# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand in a light of its own in every picture, a Cycles light group for the world and for each lamp.

A picture becomes two files: .npz with the groups apart, each denoised, and a .png of their sum for people's eyes.
Layout of plan/lights.json: jghand_engine/captures/making/lights.py; of the .npz: jghand_engine/captures/known_light.py.
"""

import io
import json
import math
import os
import secrets
from pathlib import Path

import bpy
import mathutils
import numpy as np

from .scene import Scene, encoded, new_world, shipped_environment

# the group of all lights together
SUM = "sum"
# rows of the pictures of worlds; the columns are twice as many
WORLD_ROWS = 256
# around the hand, pixels: what the film's filter smears over the border
MARGIN_PX = 4
# where a border may fall, so that Blender rounds it to the pixel that is meant
BORDER_PX = 0.01
# the largest float16: beyond it is infinity
HALF_MAX = 65504.0
# what the brighter pixels of the hand are exposed to in the picture for people's eyes, and which they are
SHOWN, SHOWN_QUANTILE = 0.7, 0.95


class LitScene(Scene):
    """Built once from the plan (a dict) and the folder of its files; pictures as the lights of the plan say."""

    def __init__(self, plan: dict, folder: Path, threads: int) -> None:
        super().__init__(plan, folder, threads)
        lights = json.loads((folder / plan["light"]["lights"]).read_text(encoding="utf-8"))
        self._folder, self._lights, self._groups = folder, lights["pictures"], lights["groups"]
        for name in plan["light"]["shipped"]:
            _write_shipped(name, folder / "worlds" / f"{name}.npy")
        world, self._environment, self._turn = new_world(self._scene)
        world.lightgroup = self._groups[0]
        # as fine as the pictures: the automatic map takes longer to build than a small picture to trace
        world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 2 * WORLD_ROWS
        self._images: dict[str, bpy.types.Image] = {}
        for group in self._groups:
            self._scene.view_layers[0].lightgroups.add(name=group)
        self._lamps = [_lamp_object(self._scene, group) for group in self._groups[1:]]
        self._output = _compositor(self._scene, self._groups)
        cycles = self._scene.cycles
        # the noise threshold is one of the sum; clamping would cut off light, so that groups would not sum up
        cycles.use_denoising = cycles.use_adaptive_sampling = False
        cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0

    def picture(self, job: dict, camera: dict, scratch: Path) -> dict[str, bytes]:
        self._show(job["pose"], camera)
        box = self._frame(job["pose"], camera)
        planes = self.planes(job, camera, scratch)
        alpha = np.clip(planes[SUM][..., 3], 0, 1)
        if alpha.shape != (box[3] - box[1], box[2] - box[0]):
            raise RuntimeError(f"{alpha.shape} pixels came for the box {box}")
        # the denoiser leaves traces beside the hand
        groups = np.stack([planes[group][..., :3] * (alpha > 0)[..., None] for group in self._groups])
        groups = np.clip(groups, 0, HALF_MAX)
        return {
            ".npz": _npz(groups, alpha, box, job["stamp"]),
            ".png": encoded(_shown(groups.sum(0), alpha, box, (camera["height"], camera["width"])), job["stamp"]),
        }

    def planes(self, job: dict, camera: dict, scratch: Path) -> dict[str, np.ndarray]:
        """(h, w, 4) light of each group, denoised, and SUM, all of it as it was traced, with its alpha."""
        light = self._lights[job["light"]]
        self._environment.image = self._world_image(light["world"]["picture"])
        turn = mathutils.Matrix(light["world"]["env_from_world"])
        self._turn.inputs["Rotation"].default_value = turn.to_euler("XYZ")
        for lamp, record in zip(self._lamps, light["lamps"], strict=True):
            _set_lamp(lamp, record)
        # another for every picture, and the same again
        self._scene.cycles.seed = int(job["stamp"][:7], 16)
        self._show(job["pose"], camera)
        self._output.directory = str(scratch)
        bpy.ops.render.render()
        return {group: _pixels(next(scratch.glob(f"{group}*.exr"))) for group in (*self._groups, SUM)}

    def _frame(self, pose: int, camera: dict) -> tuple[int, int, int, int]:
        """Renders only where the hand and its hair are: left, top, right, bottom, pixels."""
        matrix = np.array(camera["camera_from_world"])
        shown_m = self._vertices(pose)
        if self._hair:
            shown_m = np.concatenate([shown_m, self._hair.places_m])
        seen = shown_m @ matrix[:3, :3].T + matrix[:3, 3]
        px = seen[:, :2] / seen[:, 2:] * [camera["fx"], camera["fy"]] + [camera["cx"], camera["cy"]]
        width, height = camera["width"], camera["height"]
        left, top = (max(math.floor(low) - MARGIN_PX, 0) for low in px.min(0))
        right, bottom = (
            min(math.ceil(high) + MARGIN_PX, most) for high, most in zip(px.max(0), (width, height), strict=True)
        )
        render = self._scene.render
        render.use_border = render.use_crop_to_border = True
        render.border_min_x, render.border_max_x = (left + BORDER_PX) / width, (right + BORDER_PX) / width
        render.border_min_y, render.border_max_y = (
            (height - edge + BORDER_PX) / height for edge in (bottom, top)
        )  # fmt: skip
        return left, top, right, bottom

    def _world_image(self, name: str) -> bpy.types.Image:
        if name not in self._images:
            radiance = np.load(self._folder / name, allow_pickle=False)
            image = bpy.data.images.new(name, radiance.shape[1], radiance.shape[0], float_buffer=True)
            image.colorspace_settings.name = "Linear Rec.709"
            # Blender's first row is the lowest
            rgba = np.concatenate([radiance[::-1], np.ones((*radiance.shape[:2], 1))], -1).astype(np.float32)
            image.pixels.foreach_set(rgba.ravel())
            image.update()
            self._images[name] = image
        return self._images[name]


def _lamp_object(scene, group: str):
    lamp = bpy.data.objects.new(group, bpy.data.lights.new(group, "POINT"))
    lamp.lightgroup = group
    # of a lamp behind the hand only its light is wanted
    lamp.visible_camera = False
    scene.collection.objects.link(lamp)
    return lamp


def _set_lamp(lamp, record: dict) -> None:
    """A radiometric record (jghand_engine.avatar.scene_light.Lamp) as Blender's light, whose power is in watts."""
    kind = record["kind"]
    lamp.data.type = kind.upper()
    # the type of a light is its class
    light = lamp.data = bpy.data.lights[lamp.data.name]
    strongest = max(record["rgb"])
    light.color = [value / strongest for value in record["rgb"]]
    light.energy = strongest * {"sun": 1.0, "area": math.pi}.get(kind, 4 * math.pi)
    away = mathutils.Vector(record["place_m"])
    if kind == "sun":
        light.angle = record["angle_rad"]
        lamp.matrix_world = away.to_track_quat("Z", "Y").to_matrix().to_4x4()
        return
    axis = mathutils.Vector(record.get("axis", (0.0, 0.0, -1.0)))
    rotation = axis.to_track_quat("-Z", "Y").to_matrix()
    if kind == "area":
        light.shape = "ELLIPSE" if record.get("is_ellipse") else "RECTANGLE"
        light.size, light.size_y = record["size_m"]
        light.spread = record.get("spread_rad", math.pi)
        light.energy *= light.size * light.size_y * (math.pi / 4 if record.get("is_ellipse") else 1.0)
        side, up = mathutils.Vector(record["side"]), -axis.normalized()
        rotation = mathutils.Matrix((side, up.cross(side), up)).transposed()
    else:
        light.shadow_soft_size = record["radius_m"]
        light.use_soft_falloff = record.get("is_soft", True)
    if kind == "spot":
        light.spot_size, light.spot_blend = record["cone_rad"], record["blend"]
    lamp.matrix_world = mathutils.Matrix.Translation(away) @ rotation.to_4x4()


def _compositor(scene, groups: list[str]):
    """The node that writes every group, denoised, and the sum: Cycles itself denoises the sum alone."""
    scene.view_layers[0].cycles.denoising_store_passes = True
    tree = bpy.data.node_groups.new("groups", "CompositorNodeTree")
    scene.compositing_node_group = tree
    scene.render.compositor_device = "CPU"
    tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    layers, output = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeOutputFile")
    tree.links.new(layers.outputs["Image"], tree.nodes.new("NodeGroupOutput").inputs[0])
    output.format.media_type = "IMAGE"
    output.format.file_format, output.format.color_mode = "OPEN_EXR", "RGBA"
    output.format.color_depth, output.format.exr_codec = "32", "NONE"
    output.file_name = ""
    for group in (*groups, SUM):
        output.file_output_items.new("RGBA", group)
    tree.links.new(layers.outputs["Image"], output.inputs[SUM])
    for group in groups:
        denoise = tree.nodes.new("CompositorNodeDenoise")
        # the fast one was 5 % off at the edge of a hand of 64 x 96 pixels, where this one was 0.1 %
        denoise.inputs["Prefilter"].default_value = "Accurate"
        for name, source in (
            ("Image", f"Combined_{group}"), ("Albedo", "Denoising Albedo"), ("Normal", "Denoising Normal"),
        ):  # fmt: skip
            tree.links.new(layers.outputs[source], denoise.inputs[name])
        tree.links.new(denoise.outputs[0], output.inputs[group])
    return output


def _pixels(file: Path) -> np.ndarray:
    """(h, w, 4) of an OpenEXR file, the highest row first."""
    image = bpy.data.images.load(str(file))
    width, height = image.size
    rgba = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(rgba)
    bpy.data.images.remove(image)
    return rgba.reshape(height, width, 4)[::-1]


def _npz(groups: np.ndarray, alpha: np.ndarray, box: tuple[int, int, int, int], stamp: str) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(
        stream, groups=groups.astype(np.float16), alpha=np.rint(255 * alpha).astype(np.uint8),
        box_px=np.array(box, np.int32), stamp=np.array(stamp),
    )  # fmt: skip
    return stream.getvalue()


def _shown(rgb: np.ndarray, alpha: np.ndarray, box: tuple[int, int, int, int], size: tuple[int, int]) -> np.ndarray:
    """(H, W, 4) uint8 sRGB, straight alpha, exposed, of linear premultiplied light in a box."""
    inside = rgb.mean(-1)[alpha > 0.9]
    exposure = SHOWN / max(float(np.quantile(inside, SHOWN_QUANTILE)), 1e-4) if inside.size else 1.0
    linear = np.clip(rgb * exposure / np.maximum(alpha, 1e-4)[..., None], 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    pixels = np.zeros((*size, 4), np.uint8)
    left, top, right, bottom = box
    pixels[top:bottom, left:right] = np.rint(255 * np.concatenate([srgb, alpha[..., None]], -1))
    return pixels


def _write_shipped(name: str, file: Path) -> None:
    """One of Blender's environments, averaged over pixels and over all directions 1, as the plan's own worlds are."""
    if file.exists():
        return
    # some have pixels just below 0
    rows = np.maximum(_pixels(shipped_environment(name))[..., :3].astype(np.float64), 0)
    height, width = rows.shape[:2]
    step = max(height // WORLD_ROWS, 1)
    radiance = rows.reshape(height // step, step, width // step, step, 3).mean((1, 3))
    edges = np.sin(np.pi * (0.5 - np.arange(len(radiance) + 1) / len(radiance)))
    mean = (radiance.mean((1, 2)) * (edges[:-1] - edges[1:])).sum() / 2
    file.parent.mkdir(exist_ok=True)
    temporary = file.with_name(f".{file.stem}.{secrets.token_hex(4)}.npy")
    np.save(temporary, (radiance / mean).astype(np.float32))
    os.replace(temporary, file)
