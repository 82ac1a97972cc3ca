"""An avatar without training: the template's skin, sampled and painted. The built-in hand is made this way.

Its Gaussians are opaque, because nothing will sharpen them later: most lie in a thin outer layer that carries the
picture, some in a layer below it that closes what opens between them when the skin stretches.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np
import torch
from painted_skin import SkinLook
from scipy.spatial import KDTree
from studio_light import Studio, skin_rgb

from jghand_engine.avatar.avatar import SIGMA_MAX_M, SIGMA_MIN_M, UVD_RANGE_M, AvatarInfo, HandAvatar
from jghand_engine.captures.making.skin import SkinPoints
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.learn.canonical_points import bone_areas, shared_out, take_turns
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.skinning import apply, blend, posed_radius_scale
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.sampling import sample_shell
from jghand_engine.template.surface import vertex_normals
from jghand_engine.template.texture import sample_bilinear
from jghand_engine.template.weight_field import WeightField

# poses in which an untrained avatar's skin is kept closed, and the largest growth of a radius for it: more would blur
CLOSED_IN = ("fist", "claw", "table", "spread")
STRETCH_MAX = 1.35


@dataclass(frozen=True)
class Layers:
    """How the Gaussians of an untrained avatar are placed. Lengths in meters.

    count:            Gaussians in all
    backing_count:    how many of them form the backing layer
    oversampling:     points drawn per point used of the fullest bone; the first in farthest-point order are used, so
                      that more give evener gaps
    area_power:       bones share the outer layer as area ** power: 0 equally (METHOD 3.2), 1 evenly over the skin.
                      Between, the palm is not starved and finger tips and nails stay sharp
    outer_depth_m:    depth of the outer layer's centers below the skin, from and to: their rims then meet the skin
    outer_sigma:      radius of the outer layer as a part of the mean distance to the neighbors (METHOD 4.2 starts
                      training at 0.5 of the three nearest); larger closes more and blurs more
    backing_sigma:    the same of the backing layer, whose bones share by area
    backing_sigma_m:  limits of the backing layer's radius
    backing_depth:    depth of the backing layer, in its own radii: less shows around the outline, more shows in bends
    opacity:          of both layers
    curving:          0 keeps the flat triangles, 1 curves them fully (Phong tessellation): rounder outlines, but where
                      the built-in template's triangles are large the skin lies up to 3.5 mm off them, 1.8 mm at 0.5
    """

    count: int = 60_000
    backing_count: int = 8_000
    oversampling: float = 1.8
    area_power: float = 0.78
    outer_depth_m: tuple[float, float] = (0.00025, 0.00050)
    outer_sigma: float = 0.56
    backing_sigma: float = 0.60
    backing_sigma_m: tuple[float, float] = (0.0006, 0.0014)
    backing_depth: float = 2.0
    opacity: float = 0.97
    curving: float = 0.5


@dataclass(frozen=True)
class Recipe:
    """Everything that decides what an untrained avatar looks like."""

    name: str
    license: str
    layers: Layers = field(default_factory=Layers)
    look: SkinLook = field(default_factory=SkinLook)
    studio: Studio = field(default_factory=Studio)
    seed: int = 0


def make_untrained(template: HandTemplate, nails: np.ndarray, recipe: Recipe) -> HandAvatar:
    """A painted right hand of `recipe.layers.count` Gaussians, ordered so that every prefix covers the hand.

    nails: (H, W) mask 0..1 of the nails in the template's texture space. The same arguments give the same avatar.
    """
    layers = recipe.layers
    placed = place(template, layers, recipe.seed)
    nail = sample_bilinear(nails[..., None], placed.uv)[:, 0]
    bone_weights = WeightField.build(template).query(placed.position_m)
    points = SkinPoints(placed.skin_m, placed.normal, bone_weights.double().numpy(), nail)
    outer = placed.depth_m <= layers.outer_depth_m[1]
    sigma_m = placed.sigma_m.copy()
    outer_weights = bone_weights[torch.from_numpy(outer)].double()
    sigma_m[outer] *= bending_stretch(placed.skin_m[outer], outer_weights, template.joints_m)
    return HandAvatar(
        info=AvatarInfo(name=recipe.name, template=template.identifier, license=recipe.license),
        handedness=Handedness.RIGHT,
        canonical_joints_m=template.joints_m.copy(),
        position_m=_float(placed.position_m),
        sigma_m=_float(np.clip(sigma_m, SIGMA_MIN_M, SIGMA_MAX_M)),
        opacity=np.full(layers.count, layers.opacity, np.float32),
        rgb=_float(skin_rgb(template, points, recipe.look, recipe.studio)),
        bone_weights=bone_weights.float().numpy(),
        uvd=_float(np.column_stack([placed.uv, 0.5 - placed.depth_m / (2 * UVD_RANGE_M)])),
    )


@dataclass(frozen=True)
class Placed:
    """Gaussians without color: skin_m (N, 3) and normal (N, 3) of the curved skin above them, depth_m (N,) below it,
    uv (N, 2), sigma_m (N,); turn (N,) 0..1 sorts them so that every prefix covers the hand."""

    skin_m: np.ndarray
    normal: np.ndarray
    depth_m: np.ndarray
    uv: np.ndarray
    sigma_m: np.ndarray
    turn: np.ndarray

    @property
    def position_m(self) -> np.ndarray:
        return self.skin_m - self.depth_m[:, None] * self.normal


def place(template: HandTemplate, layers: Layers, seed: int) -> Placed:
    """Both layers, in one order."""
    outer = _layer(template, layers, layers.count - layers.backing_count, layers.area_power, seed)
    depth_m = np.random.default_rng(seed).uniform(*layers.outer_depth_m, len(outer.turn))
    outer = replace(outer, depth_m=depth_m, sigma_m=layers.outer_sigma * neighbor_distance(outer.skin_m))
    if not layers.backing_count:
        return outer
    backing = _layer(template, layers, layers.backing_count, 1.0, seed + 1)
    sigma_m = np.clip(layers.backing_sigma * neighbor_distance(backing.skin_m), *layers.backing_sigma_m)
    backing = replace(backing, depth_m=layers.backing_depth * sigma_m, sigma_m=sigma_m)
    order = np.argsort(np.concatenate([outer.turn, backing.turn]), kind="stable")
    return Placed(
        **{f.name: np.concatenate([getattr(outer, f.name), getattr(backing, f.name)])[order] for f in fields(Placed)}
    )


def _layer(template: HandTemplate, layers: Layers, count: int, area_power: float, seed: int) -> Placed:
    """`count` points of the skin, evenly spread, without depth and radius yet."""
    counts = shared_out(bone_areas(template) ** area_power, count)
    drawn = int(np.ceil(layers.oversampling * counts.max()))
    sample = sample_shell(template, per_bone=drawn, depth_m=layers.outer_depth_m[1], seed=seed)
    chosen, turn = take_turns(sample.bone, counts)
    skin_m, normal = curved_surface(template, sample.face[chosen], sample.barycentric[chosen], layers.curving)
    nothing = np.zeros(count)
    return Placed(skin_m, normal, nothing, sample.uvd[chosen, :2], nothing, turn)


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


def neighbor_distance(points_m: np.ndarray) -> np.ndarray:
    """(N,) mean distance to the six nearest neighbors, meters: of an even layer those around the point."""
    distance, _ = KDTree(points_m).query(points_m, k=7)
    return np.asarray(distance)[:, 1:].mean(1)


def bending_stretch(points_m: np.ndarray, bone_weights: torch.Tensor, joints_m: np.ndarray) -> np.ndarray:
    """(N,) factor of at least 1 by which radii must be larger for the skin to stay closed in the CLOSED_IN poses.

    How much the neighbors of each skin point (N, 3) move away in those poses, beyond what the posed radius follows.
    bone_weights: (N, 21) float64; joints_m: (21, 3) canonical.
    """
    around = np.asarray(KDTree(points_m).query(points_m, k=7)[1])[:, 1:]
    skin_m = torch.from_numpy(points_m)

    def gap(at: torch.Tensor) -> torch.Tensor:
        return torch.linalg.vector_norm(at[around] - at[:, None], dim=-1).mean(1)

    worst = torch.ones(len(points_m), dtype=torch.float64)
    for name in CLOSED_IN:
        bones = JointTransform(joints_m, handedness=Handedness.RIGHT).bones(
            torch.from_numpy(named_pose(name, joints_m, handedness=Handedness.RIGHT))
        )
        linear, offset_m = blend(bone_weights, bones)
        posed_m = apply(linear, skin_m - bones.canonical_root_m) + offset_m
        worst = torch.maximum(worst, gap(posed_m) / gap(skin_m) / posed_radius_scale(linear, bones.scale))
    # a neighbor's stretch counts too: a gap lies between two Gaussians
    return worst.clamp(max=STRETCH_MAX)[around].mean(1).numpy()


def _float(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float32)
