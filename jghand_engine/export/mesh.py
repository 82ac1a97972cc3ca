"""A motion as triangle meshes, a file per frame: the surface that the avatar was made on, posed by its bones.

GLB and OBJ have UV and a texture, PLY a color for each vertex: those of the nearest Gaussians, in the light and shade
of the pose; the texture times the hand's detail, where it has one, beside a normal map of its relief. What training
adds to the shape of a pose is in the Gaussians alone. trimesh (extra learn) writes the files; meters, y up. The skinned
mesh of a stage has such textures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.nearest import nearest_centers
from jghand_engine.color import linear_to_srgb, to_bytes
from jghand_engine.errors import InputError, package
from jghand_engine.export.motion import HandMotion
from jghand_engine.export.png import encode_png
from jghand_engine.export.skin import COLOR_NEIGHBORS, SkinTexture, normal_map
from jghand_engine.export.splats.cloud import RUB_FROM_UP
from jghand_engine.export.splats.files import FrameFiles
from jghand_engine.files import make_folder, write_file
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.template.builtin import template_called
from jghand_engine.template.mesh import HandTemplate, mirrored, skinned
from jghand_engine.template.surface import one_uv_each, vertex_normals

# format of `jghand export` -> suffix of its files
MESH_FORMATS = {"mesh": "glb", "mesh-obj": "obj", "mesh-ply": "ply"}
# suffixes of what an OBJ needs beside it: its material and its texture
COMPANIONS = (".mtl", ".png")
# keys of a material that name its relief, and the suffix of the picture, which all frames share. norm is the key of
# normal maps. Blender knows none; it takes what should be heights for one, with a strength alone, and decodes its sRGB
RELIEF = {"norm": ".normal.png", "map_Bump -bm 1": ".bump.png"}


@dataclass(frozen=True)
class MeshReport:
    """What an export did. files: one per frame written · bytes: of all of them, textures of OBJ included"""

    files: tuple[Path, ...]
    vertices: int
    faces: int
    bytes: int
    kept: int


def export_meshes(
    folder: Path | str,
    avatar: HandAvatar,
    sequence: PoseSequence,
    names: FrameFiles,
    *,
    up: str = "y",
    template: HandTemplate | None = None,
    frames: range | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> MeshReport:
    """Writes NAME.0000.glb and so on into `folder`, as `export_splats` writes splats; an OBJ beside its .mtl and .png.

    names:    of the files, whose suffix is one of MESH_FORMATS
    up:       the axis of the motion's world that points up
    template: surface of the avatar; None takes the built-in one
    frames:   which of the motion's are written; None: all
    InputError as `export_splats`, for a template that is not the avatar's, and without trimesh.
    """
    motion = HandMotion(avatar, sequence, up=up)
    surface = _Surface(motion, template_of(motion.avatar, template, motion.handedness), names.suffix)
    target, size = make_folder(folder), 0
    frames = range(len(sequence)) if frames is None else frames
    files = tuple(names.path(target, index) for index in frames)
    shared = surface.relief_files(names.name) if names.suffix == "obj" else {}
    companions = [path.with_suffix(suffix) for path in files for suffix in COMPANIONS] if names.suffix == "obj" else []
    # another part of the motion has the same pictures
    others = [target / name for name, content in shared.items() if not _has(target / name, content)]
    kept = names.refuse_others(target, files, len(sequence), [*companions, *others])
    for name, content in shared.items():
        write_file(target / name, content)
        size += len(content)
    for done, (index, path) in enumerate(zip(frames, files, strict=True), 1):
        for name, content in _encoded(surface.mesh(index, RUB_FROM_UP[up]), path, shared).items():
            write_file(target / name, content)
            size += len(content)
        if progress:
            progress(done, len(files))
    return MeshReport(files, len(surface.vertex), len(surface.faces), size, kept)


def _has(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content


def template_of(avatar: HandAvatar, template: HandTemplate | None, handedness: Handedness) -> HandTemplate:
    """The surface of the avatar's hand, mirrored for a left one. InputError when it is not the one the avatar was
    made on: the skin would follow other joints."""
    template = template or template_called(avatar.info.template)
    if template.identifier != avatar.info.template or not np.allclose(
        template.joints_m, np.asarray(avatar.canonical_joints_m), rtol=0, atol=1e-7
    ):
        raise InputError(
            "template",
            wanted=f"{avatar.info.template!r}, on which the avatar was made",
            came=repr(template.identifier),
            remedy="Give the avatar's own template.",
        )
    return mirrored(template) if handedness is Handedness.LEFT else template


class _Surface:
    """The skin of a motion. suffix: of the files, which decides between texture and colors of vertices."""

    def __init__(self, motion: HandMotion, template: HandTemplate, suffix: str) -> None:
        self._motion, self._template, self._trimesh = motion, template, package("trimesh", "meshes", "learn")
        self._skeleton = motion.avatar.skeleton()
        self._right = mirrored(template) if motion.handedness is Handedness.LEFT else template
        self._weights = motion.map_weights(template)
        rest_m = motion.rest_arrays()[0].astype(np.float64)
        self._textured = suffix != "ply"
        if self._textured:
            self.vertex, self._uv, self.faces = one_uv_each(template.faces, template.face_uv)
            self._texture = SkinTexture(motion.avatar, template, rest_m)
            detail = motion.avatar.detail
            self._relief = None if detail is None else normal_map(detail)
        else:
            self.vertex, self.faces = np.arange(len(template.vertices_m)), template.faces
            self._nearest = nearest_centers(template.vertices_m, rest_m, COLOR_NEIGHBORS)

    def mesh(self, index: int, axes: np.ndarray) -> Any:
        """The skin in one frame, a trimesh.Trimesh. axes: (3, 3) a turn of everything."""
        trimesh, motion = self._trimesh, self._motion
        rgb = motion.frame(index).rgb
        rgb = np.asarray(motion.avatar.rgb if rgb is None else rgb, np.float64).clip(0, 1)
        pose, rest_m = motion.sequence.pose(index), self._right.vertices_m
        vertices_m = skinned(rest_m, self._weights, self._skeleton, pose.joints_m, pose.forearm) @ axes.T
        if self._textured:
            from PIL import Image

            image = Image.fromarray(self._texture.of_colors(rgb))
            relief = None if self._relief is None else Image.fromarray(self._relief)
            material = trimesh.visual.material.PBRMaterial(
                name="skin", baseColorTexture=image, normalTexture=relief, metallicFactor=0.0, roughnessFactor=0.6
            )
            visual = trimesh.visual.TextureVisuals(uv=self._uv, material=material)
        else:
            visual = trimesh.visual.ColorVisuals(vertex_colors=to_bytes(rgb[self._nearest].mean(axis=1)))
        normals = vertex_normals(vertices_m, self._template.faces)[self.vertex]
        return trimesh.Trimesh(
            vertices_m[self.vertex], self.faces, vertex_normals=normals, visual=visual, process=False
        )

    def relief_files(self, name: str) -> dict[str, bytes]:
        """The pictures of RELIEF, in its order; none of a hand without one."""
        if self._relief is None:
            return {}
        coded = np.rint(255 * linear_to_srgb(self._relief / 255)).astype(np.uint8)
        pictures = (self._relief, coded)
        return {f"{name}{suffix}": encode_png(one) for suffix, one in zip(RELIEF.values(), pictures, strict=True)}


def _encoded(mesh: Any, path: Path, relief: Iterable[str]) -> dict[str, bytes]:
    """The files of a trimesh.Trimesh by name, that of `path` last. relief: pictures that an OBJ shares, of RELIEF"""
    if path.suffix == ".obj":
        material = mesh.visual.material.to_simple()
        material.name = path.stem
        mesh.visual.material = material
        text, others = package("trimesh", "meshes", "learn").exchange.obj.export_obj(
            mesh, include_normals=True, return_texture=True, mtl_name=f"{path.stem}.mtl", header=None
        )
        lines = [f"{key} {name}" for key, name in zip(RELIEF, relief, strict=False)]
        others[f"{path.stem}.mtl"] += "".join(f"\n{line}" for line in lines).encode()
        return {**others, path.name: text.encode()}
    if path.suffix == ".ply":
        return {path.name: mesh.export(file_type="ply", vertex_normal=True)}
    return {path.name: mesh.export(file_type="glb", include_normals=True)}
