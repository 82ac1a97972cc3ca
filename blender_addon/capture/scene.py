# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene of a capture: one hand whose vertices change from pose to pose, its skin and hair, the light and one
camera; and finished pictures with their stamp."""

import struct
import zlib
from pathlib import Path

import bpy
import mathutils
import numpy as np

SENSOR_MM = 36.0
# clipping of the camera, meters: nearer than any close-up, farther than any stage
CLIP_M = (0.01, 20.0)
# attribute of vertices: how bent the joint nearby is
BENT = "bent"
# of a person's skin, inputs of the Principled BSDF: on skin and on nails, and everywhere. Scattering radii are parts of
# the plan's scale; sheen is the down at the outline
SKIN_AND_NAIL = {
    "Specular IOR Level": (0.42, 0.57),
    "Subsurface Weight": (1.0, 0.45),
    "Coat Weight": (0.07, 0.57),
    "Coat Roughness": (0.32, 0.16),
}
SKIN_EVERYWHERE = {
    "IOR": 1.42, "Coat IOR": 1.45, "Sheen Weight": 0.06, "Sheen Roughness": 0.40,
    "Subsurface Radius": (1.0, 0.40, 0.22),
}  # fmt: skip


class Scene:
    """Built once from the plan (a dict, see jghand_engine/captures/making/plan.py) and the folder of its files."""

    def __init__(self, plan: dict, folder: Path, threads: int) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._scene, look = bpy.context.scene, plan["skin"]
        with np.load(folder / "hands.npz", allow_pickle=False) as arrays:
            rig = arrays["vertices_m"]
            # (P, V, 4): vertices, and how bent the skin is. They are gigabytes, read pose by pose
            self._poses = np.load(folder / "mesh.npy", mmap_mode="r", allow_pickle=False)
            self._mesh = _mesh(self._vertices(0), arrays, self._scene)
            self._hair = _Hair(look["hair_rgb"], folder, arrays["faces"], self._scene) if "hair_rgb" in look else None
        self._mesh.attributes.new(BENT, "FLOAT", "POINT")
        self._mesh.materials.append(_skin(look, folder))
        if "hdri" in plan["light"]:
            _light(plan["light"], folder, rig, self._scene)
        self._camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        self._scene.collection.objects.link(self._camera)
        self._scene.camera = self._camera
        self._samples = plan["sampling"]["samples"]
        _settings(self._scene, plan["sampling"], threads)
        self._pose = None

    def picture(self, job: dict, camera: dict, scratch: Path) -> dict[str, bytes]:
        """The files of a job, by suffix: here a PNG, straight alpha, sRGB. scratch: an empty folder."""
        self._show(job["pose"], camera)
        path = scratch / "picture.png"
        self._scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        return {".png": stamped(path.read_bytes(), job["stamp"])}

    def _show(self, pose: int, camera: dict) -> None:
        if pose != self._pose:
            self._mesh.vertices.foreach_set("co", self._vertices(pose).reshape(-1))
            self._mesh.attributes[BENT].data.foreach_set("value", np.array(self._poses[pose, :, 3]))
            self._mesh.update()
            if self._hair:
                self._hair.follow(self._mesh, self._vertices(pose))
            self._pose = pose
        self._aim(camera)

    def _vertices(self, pose: int) -> np.ndarray:
        """(V, 3) of the mesh in a pose, meters."""
        return np.array(self._poses[pose, :, :3], np.float32)

    def _aim(self, camera: dict) -> None:
        """An OpenCV pinhole, x_cam = R X + t; square pixels. samples: rays per pixel, where it has its own"""
        self._scene.cycles.samples = camera.get("samples", self._samples)
        width, height = camera["width"], camera["height"]
        self._scene.render.resolution_x, self._scene.render.resolution_y = width, height
        camera_from_world = np.array(camera["camera_from_world"])
        rotation = camera_from_world[:3, :3].T
        matrix = np.eye(4)
        # Blender's camera looks along -z, with y up
        matrix[:3, :3] = rotation @ np.diag([1.0, -1.0, -1.0])
        matrix[:3, 3] = -rotation @ camera_from_world[:3, 3]
        self._camera.matrix_world = mathutils.Matrix(matrix.tolist())
        data = self._camera.data
        data.sensor_fit, data.sensor_width = "HORIZONTAL", SENSOR_MM
        data.clip_start, data.clip_end = CLIP_M
        data.lens = camera["fx"] * SENSOR_MM / width
        # both shifts are in widths
        data.shift_x = -(camera["cx"] - width / 2) / width
        data.shift_y = (camera["cy"] - height / 2) / width


def _mesh(vertices: np.ndarray, arrays, scene):
    mesh = bpy.data.meshes.new("hand")
    mesh.from_pydata(vertices.tolist(), [], arrays["faces"].tolist())
    mesh.uv_layers.new(name="uv").data.foreach_set("uv", arrays["face_uv"].reshape(-1).astype(np.float32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), dtype=bool))
    hand = bpy.data.objects.new("hand", mesh)
    scene.collection.objects.link(hand)
    return mesh


class _Hair:
    """Strands as curves whose points stand on faces of the skin. places_m: (N, 3) of the points"""

    def __init__(self, rgb: list[float], folder: Path, faces: np.ndarray, scene) -> None:
        strands = np.load(folder / "hair.npy", allow_pickle=False)
        face, second, third, self._rise_m, radius_m = strands.reshape(-1, 5).T
        self._corners = faces[face.astype(np.int64)]
        self._shares = np.stack([1 - second - third, second, third], 1)[..., None]
        self._curves = bpy.data.hair_curves.new("hair")
        self._curves.add_curves([strands.shape[1]] * len(strands))
        self._curves.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", np.array(radius_m))
        self._curves.materials.append(_hair_material(rgb))
        scene.collection.objects.link(bpy.data.objects.new("hair", self._curves))

    def follow(self, mesh, vertices_m: np.ndarray) -> None:
        """Puts the strands on the mesh, whose vertices are these (V, 3)."""
        normals = np.empty_like(vertices_m)
        mesh.vertex_normals.foreach_get("vector", normals.reshape(-1))
        outwards = (self._shares * normals[self._corners]).sum(1)
        outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
        self.places_m = (self._shares * vertices_m[self._corners]).sum(1) + self._rise_m[:, None] * outwards
        self._curves.position_data.foreach_set("vector", self.places_m.reshape(-1))
        self._curves.update_tag()


def _hair_material(rgb: list[float]):
    material = bpy.data.materials.new("hair")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.remove(tree.nodes["Principled BSDF"])
    strand = tree.nodes.new("ShaderNodeBsdfHairPrincipled")
    strand.parametrization = "COLOR"
    strand.inputs["Color"].default_value = (*rgb, 1.0)
    tree.links.new(strand.outputs["BSDF"], tree.nodes["Material Output"].inputs["Surface"])
    return material


def _skin(look: dict, folder: Path):
    """Flesh that light goes into, a film of grease, relief of which some bends away; nails like
    varnish."""
    material = bpy.data.materials.new("skin")
    material.use_nodes = True
    tree = material.node_tree
    link = tree.links.new
    surface = tree.nodes["Principled BSDF"]

    def computed(operation: str, *values) -> bpy.types.NodeSocket:
        """A node of arithmetic; values are numbers or what other nodes give."""
        node = tree.nodes.new("ShaderNodeMath")
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            if isinstance(value, int | float):
                socket.default_value = value
            else:
                link(value, socket)
        return node.outputs[0]

    link(_picture(tree, folder / "skin.png", "sRGB").outputs["Color"], surface.inputs["Base Color"])
    parts = tree.nodes.new("ShaderNodeSeparateColor")
    link(_picture(tree, folder / "surface.png", "Non-Color").outputs["Color"], parts.inputs["Color"])
    link(parts.outputs["Red"], surface.inputs["Roughness"])
    plate = parts.outputs["Green"]
    for name, (skin, nail) in SKIN_AND_NAIL.items():
        link(computed("MULTIPLY_ADD", plate, nail - skin, skin), surface.inputs[name])
    for name, value in SKIN_EVERYWHERE.items():
        surface.inputs[name].default_value = value
    surface.inputs["Subsurface Scale"].default_value = look["scatter_m"]

    attribute = tree.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = BENT
    bent = attribute.outputs["Fac"]
    height = 0.0
    for layer, share in (
        ("static", 1.0),
        ("straight", computed("SUBTRACT", 1.0, bent)),
        ("fold", computed("MULTIPLY_ADD", bent, 0.5, 1.0)),
    ):
        picture = _picture(tree, folder / f"relief_{layer}.png", "Non-Color")
        # linear would show the texels' squares in gloss
        picture.interpolation = "Cubic"
        height_m = computed("MULTIPLY_ADD", picture.outputs["Color"], look["range_m"], look["low_m"])
        height = computed("MULTIPLY_ADD", height_m, share, height)
    bump = tree.nodes.new("ShaderNodeBump")
    bump.inputs["Strength"].default_value = bump.inputs["Distance"].default_value = 1.0
    link(height, bump.inputs["Height"])
    for name in ("Normal", "Coat Normal"):
        link(bump.outputs["Normal"], surface.inputs[name])
    return material


def _picture(tree, path: Path, color_space: str):
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.load(str(path))
    node.image.colorspace_settings.name = color_space
    return node


def new_world(scene):
    """A world that shows a picture: it, and its nodes of the picture and of its turn."""
    scene.world = world = bpy.data.worlds.new("world")
    world.use_nodes = True
    tree = world.node_tree
    environment, turn = tree.nodes.new("ShaderNodeTexEnvironment"), tree.nodes.new("ShaderNodeMapping")
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], turn.inputs["Vector"])
    tree.links.new(turn.outputs["Vector"], environment.inputs["Vector"])
    tree.links.new(environment.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    return world, environment, turn


def _light(light: dict, folder: Path, vertices: np.ndarray, scene) -> None:
    middle = (vertices.min((0, 1)) + vertices.max((0, 1))) / 2
    world, environment, turn = new_world(scene)
    name = light["hdri"]
    file = folder / name if Path(name).suffix else shipped_environment(name)
    environment.image = bpy.data.images.load(str(file))
    # the pictures stand on z, our hands on y
    turn.inputs["Rotation"].default_value = (np.pi / 2, 0.0, np.radians(light["hdri_turn_deg"]))
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = light["hdri_strength"]
    for number, lamp in enumerate(light["lamps"]):
        data = bpy.data.lights.new(f"lamp{number}", "AREA")
        data.size, data.energy, data.color = lamp["edge_m"], lamp["watts"], lamp["rgb"]
        place = mathutils.Vector(lamp["place_m"])
        lamp_object = bpy.data.objects.new(f"lamp{number}", data)
        lamp_object.location = place
        lamp_object.rotation_euler = (mathutils.Vector(middle.tolist()) - place).to_track_quat("-Z", "Y").to_euler()
        scene.collection.objects.link(lamp_object)


def shipped_environment(name: str) -> Path:
    """The file of an environment that comes with Blender."""
    return Path(bpy.utils.resource_path("LOCAL")) / "datafiles" / "studiolights" / "world" / f"{name}.exr"


def _settings(scene, sampling: dict, threads: int) -> None:
    scene.render.engine = "CYCLES"
    values = {
        "device": "CPU", "use_denoising": True, "denoiser": "OPENIMAGEDENOISE",
        "denoising_input_passes": "RGB_ALBEDO_NORMAL", "denoising_prefilter": "FAST",
        "max_bounces": sampling["bounces"], "transparent_max_bounces": 4, "use_adaptive_sampling": True,
        "adaptive_threshold": sampling["adaptive_threshold"], "seed": 0,
    }  # fmt: skip
    for name, value in values.items():
        setattr(scene.cycles, name, value)
    render = scene.render
    render.threads_mode, render.threads = "FIXED", threads
    render.use_persistent_data = True
    render.film_transparent = True
    render.resolution_percentage = 100
    render.dither_intensity = 0.0
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode = "RGBA"
    render.image_settings.color_depth = "8"
    render.image_settings.compression = 60
    # plain sRGB, no tone curve
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"


# ---- PNGs with nothing but their picture and a stamp, so that the same plan gives the same bytes ---------------------

SIGNATURE = b"\x89PNG\r\n\x1a\n"
# the word under which the stamp stands in the file; the engine looks for it
STAMP_KEY = "jghand-stamp"
# what decoders need; Blender adds date, host and render time as text
_KEPT = (b"IHDR", b"PLTE", b"tRNS", b"sRGB", b"IDAT", b"IEND")


def stamped(data: bytes, stamp: str) -> bytes:
    """The PNG `data` without its texts, with the Latin-1 text `stamp`. ValueError when it is not a whole PNG."""
    if not data.startswith(SIGNATURE):
        raise ValueError("not a PNG")
    result, place = [SIGNATURE], len(SIGNATURE)
    while place < len(data):
        (length,) = struct.unpack(">I", data[place : place + 4])
        kind = data[place + 4 : place + 8]
        end = place + 12 + length
        if end > len(data):
            raise ValueError("a PNG that breaks off")
        if kind in _KEPT:
            result.append(data[place:end])
        if kind == b"IHDR":
            result.append(_chunk(b"tEXt", _text(stamp)))
        place = end
        if kind == b"IEND":
            return b"".join(result)
    raise ValueError("a PNG without an end")


def encoded(pixels, stamp: str) -> bytes:
    """(H, W, 4) uint8 as such a PNG."""
    height, width = pixels.shape[:2]
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    kinds = (b"IHDR", b"tEXt", b"sRGB", b"IDAT", b"IEND")
    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return SIGNATURE + b"".join(map(_chunk, kinds, (head, _text(stamp), b"\0", zlib.compress(rows), b"")))


def _text(stamp: str) -> bytes:
    return STAMP_KEY.encode() + b"\0" + stamp.encode("latin-1")


def _chunk(kind: bytes, content: bytes) -> bytes:
    body = kind + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))
