"""The skin of a person as Cycles is given it: a fine mesh in each pose, pictures of color, surface and relief, hair.

skin.png      reflectance, sRGB
surface.png   red: roughness, green: how far it is nail
relief_*.png  16 bit, one for each of `FINE_LAYERS`: meters are low_m + value * range_m
hair.npy      (S, K, 5) float32, where there is hair: strands from root to tip, see `Hair.attached`
mesh.npy      (P, V, 4) float32: the mesh, world, meters, and how bent the joint near each vertex is, 0..1; a pose of
              100,000 vertices takes 1.6 MB, so that it is written, and read, one by one
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from jghand_engine.captures.making.rig import Identity
from jghand_engine.captures.skin.canvas import MM
from jghand_engine.captures.skin.hair import Hair
from jghand_engine.captures.skin.maps import FINE_LAYERS, SkinMaps, paint_skin
from jghand_engine.captures.skin.person import Person
from jghand_engine.captures.skin.surface import SkinSurface
from jghand_engine.color import linear_to_srgb, to_bytes

# edge of the maps: 0.16 mm of skin per texel, as fine as a pixel of a hand that fills 1080 lines
MAP_PX = 2048
PERSON_FILES = ("skin.png", "surface.png", *(f"relief_{layer}.png" for layer in FINE_LAYERS))
MESH_FILE, HAIR_FILE = "mesh.npy", "hair.npy"
# how far light scatters in pale skin, meters; melanin takes it, up to this part of the way, from this amount on
SCATTER_M, SCATTER_TAKEN, SCATTER_DARK = 0.0026, 0.45, 0.83


@dataclass(frozen=True)
class PersonSkin:
    """faces (F, 3), face_uv (F, 3, 2) and files of the plan; material: what the worker is told."""

    surface: SkinSurface
    material: dict[str, Any]
    files: dict[str, bytes]

    @classmethod
    def of(cls, identity: Identity, person: Person, levels: int, map_px: int | None = None) -> PersonSkin:
        maps = paint_skin(identity, map_px or MAP_PX, person)
        low_m = MM * float(min(height.min() for height in maps.fine.values()))
        range_m = MM * float(max(height.max() for height in maps.fine.values())) - low_m
        material = {
            "person": dataclasses.asdict(person), "low_m": low_m, "range_m": range_m, "scatter_m": scatter_m(person)
        }  # fmt: skip
        # what moves the mesh, for the stamps of images: they do not hold the mesh itself
        coarse = b"".join(np.ascontiguousarray(maps.coarse[name]).tobytes() for name in sorted(maps.coarse))
        material["coarse"] = hashlib.sha256(coarse).hexdigest()
        files = dict(zip(PERSON_FILES, _pictures(maps, low_m, range_m), strict=True))
        surface = SkinSurface(identity, levels, maps)
        if person.hair:
            hair, stream = Hair.of(identity, person), io.BytesIO()
            np.save(stream, hair.attached(surface.smooth(identity.vertices_m), surface.faces))
            material["hair_rgb"], files[HAIR_FILE] = hair.rgb.tolist(), stream.getvalue()
        return cls(surface, material, files)

    def write_mesh(self, path: Path, vertices_m: np.ndarray, joints_m: np.ndarray) -> None:
        """Writes MESH_FILE of the rig's vertices (P, v, 3) and joints (P, 21, 3) level order, pose by pose."""
        shape = (len(vertices_m), int(self.surface.faces.max()) + 1, 4)
        with path.open("wb") as stream:
            header = {"descr": "<f4", "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(stream, header)
            for vertices, joints in zip(vertices_m, joints_m, strict=True):
                bent = self.surface.bent(joints[None])[0]
                posed = np.column_stack([self.surface.posed(vertices, bent), bent])
                stream.write(posed.astype("<f4").tobytes())


def png_bytes(pixels: np.ndarray) -> bytes:
    """(H, W) uint8 or uint16, or (H, W, 3) uint8, as a PNG file."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG")
    return stream.getvalue()


def scatter_m(person: Person) -> float:
    """How far light goes below the skin before it comes out again, red's."""
    return SCATTER_M * (1 - SCATTER_TAKEN * min(1.0, person.melanin / SCATTER_DARK))


def _pictures(maps: SkinMaps, low_m: float, range_m: float) -> Iterator[bytes]:
    yield png_bytes(to_bytes(linear_to_srgb(maps.rgb)))
    yield png_bytes(to_bytes(np.stack([maps.roughness, maps.plate, np.zeros_like(maps.plate)], -1)))
    for layer in FINE_LAYERS:
        yield png_bytes(np.rint((MM * maps.fine[layer] - low_m) / range_m * 65535).astype(np.uint16))
