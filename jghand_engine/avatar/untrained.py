"""An avatar without training: the template's skin, sampled and painted. The built-in hand is made this way.

Its Gaussians are opaque, because nothing will sharpen them later: most lie in a thin outer layer that carries the
picture, some in a layer below it that closes what opens between them when the skin stretches.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from scipy.spatial import cKDTree

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.avatar.procedural_skin import SkinLook, skin_rgb
from jghand_engine.avatar.skin_points import SkinPoints
from jghand_engine.avatar.studio_light import Studio
from jghand_engine.hand.joints import BONE_COUNT, Handedness
from jghand_engine.limits import SIGMA_MAX_M, SIGMA_MIN_M, UVD_RANGE_M
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.sampling import bone_distances, sample_shell
from jghand_engine.template.surface import vertex_normals
from jghand_engine.template.texture import sample_bilinear
from jghand_engine.template.weight_field import WeightField


@dataclass(frozen=True)
class Layers:
    """How the Gaussians of an untrained avatar are placed. Lengths in metres.

    count:           Gaussians in all
    drawn_per_bone:  points drawn per bone, of which the first in farthest-point order are used: more give evener gaps
    area_power:      bones share the count as area ** power: 0 equally (METHOD 3.2), 1 evenly over the skin. Between:
                     the palm is not starved, finger tips and nails stay sharp
    outer_depth_m:   depth of the outer layer's centres below the skin, from and to: the rims then meet the skin
    backing_every:   each so-many-th Gaussian belongs to the backing layer
    backing_depth_m: depth of the backing layer
    sigma_factor:    radius as a part of the mean distance to the three nearest neighbours of the same layer
                     (METHOD 4.2 starts training at 0.5)
    opacity:         of both layers
    curving:         0 keeps the flat triangles, 1 curves them fully (Phong tessellation): smooth outlines
    """

    count: int = 60_000
    drawn_per_bone: int = 9_000
    area_power: float = 0.65
    outer_depth_m: tuple[float, float] = (0.00025, 0.00055)
    backing_every: int = 6
    backing_depth_m: float = 0.0024
    sigma_factor: float = 0.50
    backing_sigma_max_m: float = 0.0010
    opacity: float = 0.96
    curving: float = 0.75


@dataclass(frozen=True)
class Recipe:
    """Everything that decides what an untrained avatar looks like."""

    name: str
    licence: str
    layers: Layers = field(default_factory=Layers)
    look: SkinLook = field(default_factory=SkinLook)
    studio: Studio = field(default_factory=Studio)
    seed: int = 0


def make_untrained(template: HandTemplate, nails: np.ndarray, recipe: Recipe) -> HandAvatar:
    """A painted right hand of `recipe.layers.count` Gaussians, ordered so that every prefix covers the hand.

    nails: (H, W) mask 0..1 of the nails in the template's texture space. The same arguments give the same avatar.
    """
    layers = recipe.layers
    sample = sample_shell(template, per_bone=layers.drawn_per_bone, depth_m=layers.outer_depth_m[1], seed=recipe.seed)
    chosen = spread_over_bones(sample.bone, bone_areas(template), layers)
    face, barycentric = sample.face[chosen], sample.barycentric[chosen]
    uv = sample.uvd[chosen, :2]
    skin_m, normal = curved_surface(template, face, barycentric, layers.curving)
    backing = np.arange(layers.count) % layers.backing_every == layers.backing_every - 1
    depth_m = np.random.default_rng(recipe.seed).uniform(*layers.outer_depth_m, layers.count)
    depth_m[backing] = layers.backing_depth_m
    position_m = skin_m - depth_m[:, None] * normal
    bone_weights = WeightField.build(template).query(position_m)
    points = SkinPoints(skin_m, normal, bone_weights.double().numpy(), sample_bilinear(nails[..., None], uv)[:, 0])
    sigma_m = np.empty(layers.count)
    for layer in (backing, ~backing):
        sigma_m[layer] = layers.sigma_factor * neighbour_distance(skin_m[layer])
    sigma_m[backing] = np.minimum(1.2 * sigma_m[backing], layers.backing_sigma_max_m)
    uvd = np.column_stack([uv, 0.5 - depth_m / (2 * UVD_RANGE_M)])
    return HandAvatar(
        info=AvatarInfo(name=recipe.name, template=template.identifier, licence=recipe.licence),
        handedness=Handedness.RIGHT,
        canonical_joints_m=torch.from_numpy(template.joints_m.copy()),
        position_m=_float(position_m),
        sigma_m=_float(np.clip(sigma_m, SIGMA_MIN_M, SIGMA_MAX_M)),
        opacity=torch.full((layers.count,), layers.opacity),
        rgb=_float(skin_rgb(template, points, recipe.look, recipe.studio)),
        bone_weights=bone_weights.float(),
        uvd=_float(uvd),
    )


def bone_areas(template: HandTemplate) -> np.ndarray:
    """(20,) area of the closed surface that is nearest to each of the bones 1..20, square metres."""
    corners = template.vertices_m[template.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    nearest = bone_distances(corners.mean(1), template.joints_m).argmin(1)
    return np.bincount(nearest, area, minlength=BONE_COUNT)


def spread_over_bones(bone: np.ndarray, area: np.ndarray, layers: Layers) -> np.ndarray:
    """Indices (count,) into a sample whose points `bone` (M,) are in farthest-point order within each bone.

    Bone b gets a share of area ** power, at most what was drawn; its points come at even steps of the whole list, so
    that every prefix has the same shares.
    """
    share = area**layers.area_power
    counts = np.floor(share / share.sum() * layers.count).astype(int)
    counts[np.argsort(-share)[: layers.count - counts.sum()]] += 1
    if counts.max() > layers.drawn_per_bone:
        raise ValueError(f"drawn_per_bone {layers.drawn_per_bone} is less than the {counts.max()} points of a bone")
    picked, turn = [], []
    for number, count in enumerate(counts, start=1):
        picked.append(np.flatnonzero(bone == number)[:count])
        turn.append((np.arange(count) + 0.5) / count)
    return np.concatenate(picked)[np.argsort(np.concatenate(turn), kind="stable")]


def curved_surface(
    template: HandTemplate, face: np.ndarray, barycentric: np.ndarray, curving: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) on the triangles bent towards their vertices' tangent planes, and their normals (N, 3).

    Phong tessellation (Boubekeur and Alexa 2008); it rounds the flat facets off without moving the vertices.
    """
    corners_m = template.vertices_m[template.faces[face]]
    normals = vertex_normals(template.vertices_m, template.faces)[template.faces[face]]
    flat_m = np.einsum("nk,nkc->nc", barycentric, corners_m)
    off_plane = np.sum((flat_m[:, None] - corners_m) * normals, axis=2, keepdims=True)
    bent_m = np.einsum("nk,nkc->nc", barycentric, flat_m[:, None] - off_plane * normals)
    normal = np.einsum("nk,nkc->nc", barycentric, normals)
    return (1 - curving) * flat_m + curving * bent_m, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def neighbour_distance(points_m: np.ndarray) -> np.ndarray:
    """(N,) mean distance to the three nearest neighbours, metres."""
    distance, _ = cKDTree(points_m).query(points_m, k=4)
    return distance[:, 1:].mean(1)


def _float(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
