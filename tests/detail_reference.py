"""What detail does to a picture, in plain float64: the specification of native/detail.cpp.

For each pixel: the nearest face that looks at the camera; its place on the texture, by perspective; a level of the
texture by how many texels the pixel spans; the ratio there, weakened at the outline and where the Gaussians lie
elsewhere than the surface. Which face is the nearest is said to be certain where float32 finds the same one.
"""

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.detail import LOG_RATIO_MAX, RATIO_STEPS, Detail
from jghand_engine.avatar.detail_correctives import angle_numbers
from jghand_engine.avatar.detail_mips import STEPS_PER_BYTE
from jghand_engine.avatar.skin_task import BLEND_DET_MIN
from jghand_engine.hand.joints import Handedness
from jghand_engine.native import contract
from jghand_engine.native.detail_task import TEXEL_BITS, TEXEL_ZERO
from jghand_engine.render.camera import Camera
from jghand_engine.render.detail import ALPHA_FROM, ALPHA_TO, FADE_FROM_M, FADE_TO_M, GRAZE_MAX

# faces reach so much farther than their edges, as in native/detail.cpp: no gaps between neighbors
EDGE_PX = 1 / 512
# what float32 may be off by: at an edge, where coordinates of 100 px have steps of 8e-6; in depth, a part of it, where
# steps are 6e-8
ROUNDING_PX, ROUNDING_DEPTH = 1e-4, 1e-6


def levels_of(detail: Detail) -> list[np.ndarray]:
    """The log ratios of each level, (S, S, 3), (S / 2, S / 2, 3), … (4, 4, 3)"""
    texels, size, found = detail.mips.texels.astype(np.int64), detail.size, []
    while size >= 4:
        some, texels = texels[: size * size], texels[size * size :]
        some = some.reshape(size // 4, size // 4, 4, 4).swapaxes(1, 2).reshape(size, size)
        channels = [(some >> (TEXEL_BITS * k) & (1 << TEXEL_BITS) - 1) - TEXEL_ZERO for k in range(3)]
        found.append(np.stack(channels, -1) * (LOG_RATIO_MAX / RATIO_STEPS / STEPS_PER_BYTE))
        size //= 2
    return found


def posed_surface(avatar: HandAvatar, joints_m: np.ndarray) -> tuple[np.ndarray, float]:
    """(V, 3) world, meters, and the hand's scale."""
    detail, skeleton = avatar.detail, avatar.skeleton()
    bones = skeleton.bones(joints_m, np.float64)
    weights = avatar.map_weights(detail.position_m, detail.bone_weights).astype(np.float64)
    maps = np.einsum("vb,bij->vij", weights, bones.linear_offset)
    relative = detail.position_m - avatar.canonical_joints_m[0]
    posed_m = np.einsum("vij,vj->vi", maps[..., :3], relative) + maps[..., 3] + bones.root_m
    if detail.correctives is not None:
        rest = avatar.for_hand(Handedness.RIGHT).skeleton().bones(avatar.canonical_joints_m, np.float64)
        changes = angle_numbers(bones.angles_rad) - angle_numbers(rest.angles_rad)
        numbers = detail.bone_weights.astype(np.float64) @ changes
        offset_m = np.einsum("vk,vkc->vc", numbers, detail.correctives.direction * np.float64(1))
        offset_m *= detail.correctives.scale_m[:, None]
        volume = np.abs(np.linalg.det(maps[..., :3] / bones.scale))
        turn = maps[..., :3] / np.cbrt(np.maximum(volume, BLEND_DET_MIN))[:, None, None]
        posed_m += np.einsum("vij,vj->vi", turn, offset_m)
    return posed_m, bones.scale


def ratios(avatar: HandAvatar, joints_m: np.ndarray, camera: Camera, alpha: np.ndarray, depth_m: np.ndarray):
    """-> (H, W, 3) what colors are multiplied by, (H, W) depth of the surface, infinite where there is none, and (H, W)
    bool: whether rounding has no say in which face is the nearest one.

    alpha, depth_m: (H, W) of the Gaussians
    """
    detail = avatar.detail
    points_m, scale = posed_surface(avatar, joints_m)
    pixels, depth = camera.project(points_m)
    near = -depth if camera.orthographic else 1 / depth
    facing = -1 if avatar.handedness is Handedness.RIGHT else 1
    height, width = alpha.shape
    nearest, sure = np.full((height, width), -np.inf), np.zeros((height, width), bool)
    # of the faces that rounding may find there: the nearest and the next
    first, second = np.full((2, height, width), -np.inf)
    uv, slopes, spans = np.zeros((height, width, 2)), np.zeros((height, width, 2)), np.zeros((height, width))
    texture_xy = np.stack([detail.face_uv[..., 0], 1 - detail.face_uv[..., 1]], -1).astype(np.float64)
    for corners, places in zip(detail.faces, texture_xy, strict=True):
        (x, y), n = pixels[corners].T, near[corners]
        area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
        if not (depth[corners] > contract.Z_NEAR_M).all() or area * facing <= 0:
            continue
        (x0, x1), (y0, y1) = centers(x, width), centers(y, height)
        if x0 > x1 or y0 > y1:
            continue
        column, row = np.meshgrid(np.arange(x0, x1 + 1), np.arange(y0, y1 + 1))

        def shares_at(dx, dy, x=x, y=y, area=area, column=column, row=row):
            px, py = column + 0.5 + dx - x[0], row + 0.5 + dy - y[0]
            first = (px * (y[2] - y[0]) - py * (x[2] - x[0])) / area
            second = (py * (x[1] - x[0]) - px * (y[1] - y[0])) / area
            return np.stack([1 - first - second, first, second], -1)

        def places_at(shares, n=n, places=places):
            weight = shares if camera.orthographic else shares * n / (shares * n).sum(-1, keepdims=True)
            return weight @ places

        shares = shares_at(0, 0)
        opposite_px = np.hypot(np.roll(x, -1) - np.roll(x, 1), np.roll(y, -1) - np.roll(y, 1))
        inside_px, found = (shares * abs(area) / opposite_px).min(-1) + EDGE_PX, shares @ n
        here = (inside_px >= 0) & (found > nearest[row, column])
        place, step = places_at(shares), 1e-4
        along = [(places_at(shares_at(*d)) - place) / step for d in ((step, 0), (0, step))]
        nearest[row[here], column[here]], sure[row[here], column[here]] = found[here], inside_px[here] >= ROUNDING_PX
        perhaps = np.where(inside_px >= -ROUNDING_PX, found, -np.inf)
        second[row, column] = np.maximum(second[row, column], np.minimum(first[row, column], perhaps))
        first[row, column] = np.maximum(first[row, column], perhaps)
        uv[row[here], column[here]] = place[here]
        # near is linear on the image
        slopes[row[here], column[here]] = np.linalg.solve(np.stack([np.diff(x), np.diff(y)], 1), np.diff(n))
        spans[row[here], column[here]] = np.sqrt(sum((a**2).sum(-1) for a in along) / 2)[here] * detail.size
    hit = np.isfinite(nearest)
    certain = np.where(hit, sure & (second < nearest - ROUNDING_DEPTH * np.abs(nearest)), np.isinf(first))
    surface_m = np.where(hit, -nearest if camera.orthographic else 1 / np.where(hit, nearest, 1.0), np.inf)
    log = looked_up(levels_of(detail), uv, spans)
    over = 1.0 if camera.orthographic else np.where(hit, surface_m, 0)[..., None]
    slope = slopes * (camera.fx, camera.fy) * over
    graze = np.minimum(np.sqrt(1 + (slope**2).sum(-1)), GRAZE_MAX)
    apart = np.abs(depth_m - surface_m - scale * detail.depth_m) / graze
    weight = smooth(alpha, ALPHA_FROM, ALPHA_TO) * (1 - smooth(apart, scale * FADE_FROM_M, scale * FADE_TO_M)) * hit
    return np.exp(weight[..., None] * log), surface_m, certain


def centers(corners_px: np.ndarray, size: int) -> tuple[int, int]:
    """The first and the last row or column whose center a face may reach."""
    reach = EDGE_PX + ROUNDING_PX - 0.5
    return max(int(np.ceil(corners_px.min() - 1 - reach)), 0), min(int(np.floor(corners_px.max() + reach)), size - 1)


def looked_up(levels: list[np.ndarray], uv: np.ndarray, spans: np.ndarray) -> np.ndarray:
    """(H, W, 3) of places (H, W, 2), 0..1, and texels per pixel (H, W): bilinear, and between two levels."""
    level = np.clip(np.log2(np.maximum(spans, 1e-9)), 0, len(levels) - 1)
    fine = np.floor(level).astype(int)
    each = [bilinear(texels, uv) for texels in levels]
    stack = np.stack([*each, each[-1]])
    pick = np.indices(fine.shape)
    first, second = stack[fine, *pick], stack[fine + 1, *pick]
    # mixed on the middle half of the way between two levels: one look-up serves the rest
    return first + np.clip(2 * (level - fine) - 0.5, 0, 1)[..., None] * (second - first)


def bilinear(texels: np.ndarray, uv: np.ndarray) -> np.ndarray:
    size = len(texels)
    at = uv * size - 0.5
    corner = np.floor(at).astype(int)
    part = at - corner
    (x0, y0), (x1, y1) = (np.moveaxis((corner + k).clip(0, size - 1), -1, 0) for k in (0, 1))
    fx, fy = part[..., :1], part[..., 1:]
    top, bottom = ((1 - fx) * texels[y, x0] + fx * texels[y, x1] for y in (y0, y1))
    return (1 - fy) * top + fy * bottom


def smooth(x: np.ndarray, none: float, full: float) -> np.ndarray:
    s = np.clip((x - none) / (full - none), 0, 1)
    return s * s * (3 - 2 * s)
