"""What Gaussians cannot hold (`avatar.detail`), learned beside them in the last part of a training.

    surface   the template's mesh, moved along its normals until it lies equally far above the Gaussians' depth in all
              pictures; how far, the outlines say. It is found once, and follows the bones alone
    texture   log ratios, by gradient: the pictures are compared with the Gaussians' times the texture

That a texel slides on a person's skin does not matter, as long as it stays on the same skin in every picture.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from scipy import ndimage, sparse
from torch import Tensor, nn
from torch.nn import functional

from jghand_engine.avatar.avatar import HandAvatar, forearm_way, with_slices
from jghand_engine.avatar.detail import LOG_RATIO_MAX, MIX_FROM, MIX_TO, NO_RATIO, Detail, ratio_bytes
from jghand_engine.captures.sample import Sample
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import HandPose
from jghand_engine.hand.skeleton import Bones, Skeleton
from jghand_engine.learn.light import smooth
from jghand_engine.learn.pictures import LruCache, Pictures
from jghand_engine.native.library import load as load_native
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import (
    ALPHA_FROM,
    ALPHA_TO,
    FADE_FROM_M,
    FADE_TO_M,
    GRAZE_MAX,
    DetailedHand,
    SurfaceHits,
)
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.settings import RenderSettings
from jghand_engine.template.mesh import HandTemplate, skinned
from jghand_engine.template.subdivision import Subdivision
from jghand_engine.template.surface import directed_edges, vertex_normals

# the mesh's faces are split once: 3 mm on the palm, flatter than a Gaussian is thick
LEVELS = 1
# texels along a side: 0.16 mm on a grown hand, a little less than a pixel of a close-up
TEXELS = 2048
# pictures of coarser pixels, meters at the hand, hold no more than Gaussians do, which lie a millimeter apart
PIXEL_MAX_M = 4e-4

# ---- surface
# how far the Gaussians' blended depth lies below the skin at the start, meters: of 40,000
DEPTH_START_M = 1.2e-3
ROUNDS = 5
# pictures that it looks at, at most: spread over all
FIT_PICTURES = 120
# alpha of picture and Gaussians that shows nothing but skin, and the outline that is left out, pixels
WHOLLY, WHOLLY_DRAWN, OUTLINE_PX = 0.99, 0.97, 2
# cosine to the camera below which depth says little of the skin, and how far apart the two may be, meters
FIT_COSINE, FIT_REACH_M = 0.4, 5e-3
# how far from the surface a mask is still the hand's, meters: beyond may be an arm
NEAR_M = 4e-3
# how much neighbors are to move alike, and none at all, against a vertex that is seen as often as the mean of them
SMOOTH, STILL = 0.3, 1e-3

# ---- texture
# levels that pictures read: of the whole hand they have pixels of two to four texels, and more where skin is steep
MIP_LEVELS = 4
# twice the area of a face that is seen edge-on
AREA_MIN_PX2 = 1e-6
# steps of the coordinates that are kept of a picture, a thirtieth of a texel; bytes of all that is kept
UV_STEPS, PLACES_CACHE_BYTES = 65535, 1_000_000_000

# (H, W, 3) of a camera, of alpha (H, W) and the sum of depth (H, W) of the Gaussians that it sees
Ratio = Callable[[Camera, Tensor, Tensor], Tensor]


class Surface:
    """The template's mesh, `LEVELS` finer, and how far it stands out from the template. height_m: (v,) of the coarse
    mesh's vertices, along their normals."""

    def __init__(self, template: HandTemplate, skeleton: Skeleton) -> None:
        self.template, self.skeleton = template, skeleton
        fine = Subdivision.of(template.faces, template.face_uv, LEVELS)
        skin = template.skin_face_count * 4**LEVELS
        self.faces, self.face_uv, self.matrix = fine.faces[:skin], fine.face_uv[:skin], fine.matrix
        self._closed = fine.faces
        self.bone_weights = self.matrix @ template.bone_weights
        self._normal = vertex_normals(template.vertices_m, template.faces)
        self.height_m = np.zeros(len(template.vertices_m))
        edges, count = directed_edges(template.faces), len(template.vertices_m)
        beside = sparse.csr_array(sparse.coo_array((np.ones(len(edges)), tuple(edges.T)), (count, count)))
        self.laplacian = sparse.diags_array(np.asarray(beside.sum(1)).ravel()) - beside

    @property
    def position_m(self) -> np.ndarray:
        """(V, 3) canonical."""
        return self.matrix @ (self.template.vertices_m + self.height_m[:, None] * self._normal)

    @property
    def map_weights(self) -> np.ndarray:
        """(V, maps) of all maps of the skeleton, see `HandAvatar.map_weights`."""
        if forearm_way(self.template.identifier) is None:
            return self.bone_weights
        return with_slices(self.position_m, self.bone_weights, self.template.joints_m[0])

    def bones(self, hand: HandPose) -> Bones:
        return self.skeleton.bones(hand.joints_m, forearm=hand.forearm)

    def posed(self, hand: HandPose) -> np.ndarray:
        """(V, 3) in the world of the joints."""
        return skinned(self.position_m, self.map_weights, self.skeleton, hand.joints_m, hand.forearm)

    def normals(self, posed_m: np.ndarray) -> np.ndarray:
        """(V, 3) unit, outwards."""
        outwards = vertex_normals(posed_m, self._closed)
        # a left hand's faces are those of its mirror image
        return -outwards if self.skeleton.handedness is Handedness.LEFT else outwards

    def hits(self) -> SurfaceHits:
        """Of the surface as it is now, the wrist closed: faces from `len(faces)` on are not skin."""
        closed = Detail(
            position_m=self.position_m.astype(np.float32),
            bone_weights=self.bone_weights.astype(np.float32),
            faces=self._closed.astype(np.int32),
            face_uv=np.zeros((len(self._closed), 3, 2), np.float32),
            texture=np.full((4, 4, 3), NO_RATIO, np.uint8),
            depth_m=0.0,
        )
        hand = DetailedHand(closed, 1.0, self.template.joints_m, self.skeleton.handedness, self.map_weights)
        return SurfaceHits(load_native("auto"), hand)


# ---- where the skin is -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Beside:
    """A picture's mask beside the Gaussians. hand: (H, W) bool · trusted: (H, W) bool, both show nothing but skin
    depth_m: (H, W) float32 of the Gaussians · pixel_m: at the hand"""

    pose: HandPose
    camera: Camera
    hand: np.ndarray
    trusted: np.ndarray
    depth_m: np.ndarray
    pixel_m: float


def beside(avatar: HandAvatar, samples: Sequence[Sample], pictures: Pictures) -> list[Beside]:
    """FIT_PICTURES of the samples, of one hand, spread over them."""
    chosen = np.unique(np.linspace(0, len(samples) - 1, min(FIT_PICTURES, len(samples))).astype(int))
    renderer = SceneRenderer([avatar.for_hand(samples[0].handedness)], RenderSettings(antialias=False))
    found = []
    for sample in (samples[one] for one in chosen):
        view = pictures.view(sample)
        frame, mask = renderer.render([sample.hand], view.camera), view.mask.numpy()
        trusted = ndimage.binary_erosion(
            (mask > WHOLLY) & (frame.rgba[..., 3] > WHOLLY_DRAWN), iterations=OUTLINE_PX, border_value=1
        )
        pixel_m = float(np.linalg.norm(view.camera.eye_m - sample.joints_m.mean(0))) / view.camera.fx
        found.append(Beside(sample.hand, view.camera, mask > 0.5, trusted, frame.depth_m, pixel_m))
    return found


def fit_surface(surface: Surface, pictures: Sequence[Beside]) -> float:
    """Moves the surface in place; how far the Gaussians' depth lies below it, meters.

    Each round, every vertex by the mean of what the depth of the Gaussians says of it along its normal, the vertices
    smooth among themselves: least squares with the graph's Laplacian. The Gaussians' depth is deeper than the skin by
    a length that is the same all over the hand; the area of the outlines tells it.
    """
    depth_m = DEPTH_START_M
    for turn in range(ROUNDS):
        hits, wide_m = surface.hits(), []
        total, weight = np.zeros(len(surface.bone_weights)), np.zeros(len(surface.bone_weights))
        for one in pictures:
            face, _ = hits(surface.bones(one.pose), one.camera)
            _add_heights(surface, one, face, depth_m, total, weight)
            wide_m.append(one.pixel_m * _wider_px(face >= 0, one.hand, NEAR_M / one.pixel_m))
        if turn:
            # at first the outlines were the template's
            depth_m -= float(np.mean(wide_m))
        wanted, seen = surface.matrix.T @ (total + depth_m * weight), surface.matrix.T @ weight
        matrix = sparse.diags_array(seen / seen.mean() + STILL) + SMOOTH * surface.laplacian
        surface.height_m += sparse.linalg.spsolve(matrix.tocsc(), wanted / seen.mean())
    return max(depth_m, 0.0)


def _wider_px(ours: np.ndarray, hand: np.ndarray, near_px: float) -> float:
    """How far the outline of ours (H, W) lies outside the hand's, on average; of the mask what is near ours."""
    outline = ours & ~np.asarray(ndimage.binary_erosion(ours, border_value=1), bool)
    near = np.asarray(ndimage.distance_transform_edt(~ours)) <= near_px
    return (float(ours.sum()) - float((hand & near).sum())) / max(float(outline.sum()), 1.0)


def _add_heights(
    surface: Surface, one: Beside, face: np.ndarray, depth_m: float, total: np.ndarray, weight: np.ndarray
) -> None:
    """Adds to (V,) sums, in place: how much farther out the Gaussians' depth is than each vertex, meters, and how much
    that counts. depth_m: how far below the surface it is to be, to tell what is of another finger"""
    y, x = np.nonzero(one.trusted & (face >= 0) & (face < len(surface.faces)))
    posed_m = surface.posed(one.pose)
    corners, shares = surface.faces[face[y, x]], _shares(posed_m[surface.faces[face[y, x]]], one.camera, y, x)
    seen_m = np.einsum("nk,nki->ni", shares, posed_m[corners]) - one.camera.eye_m
    outwards = np.einsum("nk,nki->ni", shares, surface.normals(posed_m)[corners])
    along = seen_m @ one.camera.camera_from_world[2, :3]
    into = -np.einsum("ni,ni->n", outwards, seen_m) / np.linalg.norm(outwards, axis=1)
    out_m = into * (1 - one.depth_m[y, x] / along)
    cosine = into / np.linalg.norm(seen_m, axis=1)
    kept = (cosine > FIT_COSINE) & (np.abs(out_m + depth_m) < FIT_REACH_M)
    weights = (shares * cosine[:, None] ** 2)[kept]
    total += np.bincount(corners[kept].ravel(), (weights * out_m[kept, None]).ravel(), minlength=len(total))
    weight += np.bincount(corners[kept].ravel(), weights.ravel(), minlength=len(weight))


def _mixed_level(level: np.ndarray) -> np.ndarray:
    """The level of the mips that is drawn for one whose texels are as large as a pixel: whole where one serves."""
    return np.floor(level) + np.clip((level % 1 - MIX_FROM) / (MIX_TO - MIX_FROM), 0.0, 1.0)


def _shares(corners_m: np.ndarray, camera: Camera, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(N, 3) shares of the corners (N, 3, 3) of the faces that pixels show, where their middles meet them: the volumes
    that the ray cuts off the tetrahedron of the eye and the face."""
    slopes = np.stack([(x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy, np.ones(len(x))], 1)
    way = slopes @ camera.camera_from_world[:3, :3]
    a, b, c = np.moveaxis(corners_m - camera.eye_m, 1, 0)
    volumes = np.stack([np.einsum("ni,ni->n", way, np.cross(*pair)) for pair in ((b, c), (c, a), (a, b))], 1)
    return volumes / volumes.sum(1, keepdims=True)


# ---- what it looks like ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Places:
    """Where the pixels of a picture are in the texture. pixel: (N,) int32, row by row · uv: (N, 2) uint16 · level:
    (N,) float32 of the mips · depth_m: (N,) float32 of the surface · graze: (N,) float32, by how much longer what lies
    below it is along the ray"""

    pixel: Tensor
    uv: Tensor
    level: Tensor
    depth_m: Tensor
    graze: Tensor

    def nbytes(self) -> int:
        return sum(tensor.nbytes for tensor in vars(self).values())


class DetailLearner(nn.Module):
    """A detail that is being learned. Before `find` there is none.

    texture:  (3, TEXELS, TEXELS) log ratios
    height_m: as of Surface, depth_m: as of Detail; below 0 before `find`
    """

    def __init__(self, template: HandTemplate, skeleton: Skeleton) -> None:
        super().__init__()
        self._surface = Surface(template, skeleton)
        self.texture = nn.Parameter(torch.zeros(3, TEXELS, TEXELS))
        self.height_m: Tensor
        self.depth_m: Tensor
        self.register_buffer("height_m", torch.zeros(len(self._surface.height_m), dtype=torch.float64))
        self.register_buffer("depth_m", torch.tensor(-1.0, dtype=torch.float64))
        self._places: LruCache[_Places] = LruCache(PLACES_CACHE_BYTES, _Places.nbytes)
        self._hits: SurfaceHits | None = None

    @property
    def is_found(self) -> bool:
        return bool(self.depth_m >= 0)

    def find(self, avatar: HandAvatar, samples: Sequence[Sample], pictures: Pictures) -> None:
        """Puts the surface where the avatar's Gaussians are in the samples. From the template's on, as at the first
        time: a training that goes back before this step finds it again."""
        self._surface.height_m = np.zeros(len(self.height_m))
        depth_m = fit_surface(self._surface, beside(avatar, samples, pictures))
        self._places, self._hits = LruCache(PLACES_CACHE_BYTES, _Places.nbytes), None
        self.height_m.copy_(torch.from_numpy(self._surface.height_m))
        self.depth_m.fill_(depth_m)

    def mips(self) -> list[Tensor]:
        """The texture and its means, (1, 3, S, S), finest first."""
        levels = [self.texture[None]]
        for _ in range(MIP_LEVELS - 1):
            levels.append(functional.avg_pool2d(levels[-1], 2))
        return levels

    def ratios(self, hand: HandPose, cameras: Sequence[Camera]) -> Ratio:
        """What the renderer multiplies colors by in pictures of one pose; looked up in one go, since the gradient of a
        texture is as large as the texture."""
        each = [self._places.get(_key(hand, camera), partial(self._placed, hand, camera)) for camera in cameras]
        uv, level = (torch.cat([getattr(one, name) for one in each]) for name in ("uv", "level"))
        values = _looked_up(self.mips(), uv.float() / UV_STEPS, level).split([len(one.pixel) for one in each])
        of = dict(zip(map(id, cameras), zip(each, values, strict=True), strict=True))
        scale, depth_m = self._surface.bones(hand).scale, float(self.depth_m)

        def ratio(camera: Camera, alpha: Tensor, depth_sum: Tensor) -> Tensor:
            places, log_ratio = of[id(camera)]
            alpha, depth_sum = (plane.detach().reshape(-1)[places.pixel] for plane in (alpha, depth_sum))
            apart = depth_sum / alpha.clamp_min(ALPHA_FROM) - places.depth_m - scale * depth_m
            low, high = scale * FADE_FROM_M, scale * FADE_TO_M
            fade = smooth((apart.abs() / places.graze - low) / (high - low))
            weight = smooth((alpha - ALPHA_FROM) / (ALPHA_TO - ALPHA_FROM)) * (1 - fade)
            whole = torch.ones(camera.height * camera.width, 3)
            whole = whole.index_copy(0, places.pixel.long(), (weight[:, None] * log_ratio).exp())
            return whole.reshape(camera.height, camera.width, 3)

        return ratio

    def _placed(self, hand: HandPose, camera: Camera) -> _Places:
        surface = self._surface
        if self._hits is None:
            surface.height_m = self.height_m.numpy().copy()
            self._hits = surface.hits()
        face, depth_m = self._hits(surface.bones(hand), camera)
        y, x = np.nonzero((face >= 0) & (face < len(surface.faces)))
        face, depth_m = face[y, x], depth_m[y, x]
        corners_m = surface.posed(hand)[surface.faces[face]]
        uv = np.einsum("nk,nki->ni", _shares(corners_m, camera, y, x), surface.face_uv[face])
        # texels that a pixel spans, the mean square of its two sides, as the renderer takes them
        spans2 = TEXELS**2 * _squared_slopes(surface.face_uv[face], camera.project(corners_m)[0]) / 2
        level = _mixed_level(0.5 * np.log2(np.clip(spans2, 1, 4.0 ** (MIP_LEVELS - 1))))
        return _Places(
            torch.from_numpy((y * camera.width + x).astype(np.int32)),
            torch.from_numpy(np.rint(np.clip(uv, 0, 1) * UV_STEPS).astype(np.uint16)),
            torch.from_numpy(level.astype(np.float32)),
            torch.from_numpy(depth_m.astype(np.float32)),
            torch.from_numpy(_grazes(corners_m, camera, y, x).astype(np.float32)),
        )

    def keep_in_range(self) -> None:
        """Ratios that a texture can hold, after every change of it."""
        with torch.no_grad():
            self.texture.clamp_(-LOG_RATIO_MAX, LOG_RATIO_MAX)

    def detail(self) -> Detail | None:
        """What has been learned; None before the surface is found."""
        if not self.is_found:
            return None
        surface = self._surface
        surface.height_m = self.height_m.numpy().copy()
        return Detail(
            position_m=surface.position_m.astype(np.float32),
            bone_weights=surface.bone_weights.astype(np.float32),
            faces=surface.faces.astype(np.int32),
            face_uv=surface.face_uv.astype(np.float32),
            texture=ratio_bytes(self.texture.detach().permute(1, 2, 0).numpy()),
            depth_m=float(self.depth_m),
        )


def _key(hand: HandPose, camera: Camera) -> tuple:
    """What decides where a picture's pixels are in the texture."""
    inside = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    forearm = None if hand.forearm is None else hand.forearm.tobytes()
    return (hand.joints_m.tobytes(), forearm, camera.camera_from_world.tobytes(), *inside)


def _looked_up(mips: Sequence[Tensor], uv: Tensor, level: Tensor) -> Tensor:
    """(N, 3) of the texture at (N, 2), bilinear in two levels and linear between them."""
    grid = torch.stack([2 * uv[:, 0] - 1, 1 - 2 * uv[:, 1]], -1)
    total = torch.zeros(len(uv), 3)
    for number, mip in enumerate(mips):
        weight = (1 - (level - number).abs()).clamp_min(0)
        (there,) = torch.nonzero(weight, as_tuple=True)
        values = functional.grid_sample(mip, grid[there][None, None], padding_mode="border", align_corners=False)
        total = total.index_add(0, there, values[0, :, 0].T * weight[there, None])
    return total


def _grazes(corners_m: np.ndarray, camera: Camera, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(N,) of faces (N, 3, 3) where pixels see them, GRAZE_MAX at most."""
    sides = (corners_m[:, 1:] - corners_m[:, :1]) @ camera.camera_from_world[:3, :3].T
    normal = np.cross(sides[:, 0], sides[:, 1])
    facing = normal[:, 0] * (x + 0.5 - camera.cx) / camera.fx + normal[:, 1] * (y + 0.5 - camera.cy) / camera.fy
    facing += normal[:, 2]
    slope2 = (normal[:, 0] ** 2 + normal[:, 1] ** 2) / np.maximum(facing**2, np.finfo(float).tiny)
    return np.minimum(np.sqrt(1 + slope2), GRAZE_MAX)


def _squared_slopes(uv: np.ndarray, px: np.ndarray) -> np.ndarray:
    """(N,) summed squares of how the corners (N, 3, 2) of faces in the texture change along x and y of the image."""
    (du1, du2), (dx1, dx2) = (np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0) for corners in (uv, px))
    area = np.maximum(np.abs(dx1[:, 0] * dx2[:, 1] - dx1[:, 1] * dx2[:, 0]), AREA_MIN_PX2)[:, None]
    along_x = (du1 * dx2[:, 1:] - du2 * dx1[:, 1:]) / area
    along_y = (du2 * dx1[:, :1] - du1 * dx2[:, :1]) / area
    return (along_x**2 + along_y**2).sum(1)
