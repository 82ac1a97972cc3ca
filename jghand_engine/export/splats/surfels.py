"""The skin of a hand as flat Gaussians on the surface of its detail: files hold no texture, and a few hundred thousand
of these hold what is seen of one close up.

Each is a part of one face, the same in every pose. It is as wide as that part and very thin, and has the
color that the avatar's Gaussians blend there, times the mean of the texture and what the relief makes of the light.
Nothing lies beneath it.
"""

from __future__ import annotations

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.cast_task import LIGHT_TO_DISPLAY, posed_joints_m
from jghand_engine.avatar.detail import log_ratios
from jghand_engine.avatar.detail_mips import filled
from jghand_engine.avatar.forearm import of_each_layer
from jghand_engine.avatar.nearest import nearest_centers
from jghand_engine.avatar.posing import PosedHand
from jghand_engine.avatar.relief import LIGHT_CHANGE_MAX, Bend, finger_shares
from jghand_engine.avatar.relighting import detail_power, material_of
from jghand_engine.avatar.scene_light import harmonics
from jghand_engine.color import srgb_to_linear
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.rotations import unit
from jghand_engine.hand.skeleton import Bones
from jghand_engine.render.detail import DetailedHand
from jghand_engine.render.fine_faces import FineFaces, parted_in_four
from jghand_engine.template.texture import sample_bilinear

# sigma over the standard deviation of places in a part: less leaves holes, more blurs. Long parts are rounder by this
WIDTH, ROUNDER = 2.0, 0.5
# sigma along the normal, meters
THICKNESS_M = 1e-5
# how far below the surface they lie, meters: viewers widen each by half a pixel, all around an outline
BELOW_M = 0.00025
# what blur will take is added before: as much as the texture differs from its mean over parts that are longer by this
WIDER = 2.5
# a part is parted in four this often, and the texture looked up in the middle of each, for a mean
LOOKS_LOG4 = 2
# surfels of a face that are looked at together, at most, and the Gaussians nearest to them, whose colors are blended:
# with 8 Gaussians for each surfel colors are the same, and take twice as long
TOGETHER, NEIGHBORS = 8, 16
# of the light on its way through these the part that the mean of all gets: where none of them covers the place
UNCOVERED = 1e-6
# about so many surfels lie over one another: each fades sooner at the end of a hand, so that all together fade evenly
LAYERS = 5
# harmonics of the light that a relief turns in: of degrees 0 to 2, as matt skin has hardly more of a light; they go
# below zero, so that normals get at least this part of the mean
LIGHT_TERMS, LIGHT_FLOOR = 9, 0.3
# albedos below count as this: what is black says nothing of light
DARK = 1e-3
# more are finer than the texture; and halvings of the largest face, at most, which so many are never
SURFELS_MAX, HALVINGS_MAX = 2_000_000, 24


class Surfels:
    """avatar: of the hand that moves · count: how many there may be; some fewer are made

    InputError for a hand whose surface is not its skin in all poses, and for fewer than that has faces, or too many.
    """

    def __init__(self, avatar: HandAvatar, count: int) -> None:
        detail = avatar.detail
        if detail is None or not detail.ends_hand:
            raise InputError(
                f"surfels of {avatar.info.name}", wanted="a hand with a texture whose surface is its skin",
                came="one without a texture" if detail is None else "one whose surface is only near its skin",
                remedy="Export its Gaussians, without surfels.",
            )  # fmt: skip
        # four for each, as close-ups have them: outlines show no corners
        self._fine = FineFaces.of(detail.faces, detail.face_uv, len(detail.position_m))
        faces = self._fine.faces
        if not len(faces) <= count <= SURFELS_MAX:
            wanted = f"{len(faces)}, one for each face of its surface, to {SURFELS_MAX}"
            raise InputError(f"surfels of {avatar.info.name}", wanted=wanted, came=str(count))
        self._hand = DetailedHand.of(avatar, detail_power(avatar, in_scene=False))
        self._opacity = avatar.opacity.astype(np.float32)
        self._albedo = material_of(avatar).albedo
        face, part = halved(self._fine.with_middles(detail.position_m)[faces], count)
        self._corner, self._part, coarse = faces[face], part.astype(np.float32), face // 4
        in_face = np.arange(len(face)) - np.searchsorted(coarse, coarse)
        self._group = np.cumsum(in_face % TOGETHER == 0) - 1
        uv = part @ self._fine.face_uv[face]
        texture = log_ratios(filled(detail.texture, detail.skin))
        self._ratio = np.exp(self._hand.power * _sharpened(texture, uv)).astype(np.float32)
        self._rise_m: np.ndarray | None = None
        # paint has no light that a relief could turn in
        if detail.relief is not None and avatar.learned is not None:
            along = (uv[:, 1:] - uv[:, :1]) * (1, -1)
            rises_m = [_sharpened(detail.relief.rises_m(detail.skin, bent=bent), uv) for bent in (False, True)]
            self._rise_m = np.stack([along @ rise[..., None] for rise in rises_m])[..., 0].astype(np.float32)
            self._bend = Bend(detail.position_m, finger_shares(detail.bone_weights), avatar.canonical_joints_m)
        # in double precision: next to 1 a root is steep
        whole = (part * self._fine.with_middles(detail.shown)[self._corner][:, None]).sum(-1).mean(1).clip(0, 1)
        self.opacity = of_each_layer(whole, LAYERS).astype(np.float32)

    def __len__(self) -> int:
        return len(self._part)

    def of_pose(self, bones: Bones, posed: PosedHand, rgb: np.ndarray) -> tuple[np.ndarray, ...]:
        """Places (S, 3) and sigmas (S, 3), meters; turns (S, 3, 3), whose columns are the ways of these sigmas; colors
        (S, 3), display-referred, some above 1. posed: the Gaussians in that pose · rgb: (N, 3) their colors"""
        corner_m = self._of_corners(self._hand.posed_m(bones) - bones.root_m)
        place_m = corner_m.mean(1)
        side_m, other_m = corner_m[:, 1] - corner_m[:, 0], corner_m[:, 2] - corner_m[:, 0]
        across_m2 = np.cross(side_m, other_m)
        normal = unit(across_m2) * (1 if self._hand.handedness is Handedness.RIGHT else -1)
        apart_m = corner_m - place_m[:, None]
        # of places in a triangle it is a twelfth of that sum; the smallest, along the normal, is none
        variance_m2, turn = np.linalg.eigh(np.einsum("skc,skd->scd", apart_m, apart_m) / 12)
        turn[..., 0] *= np.linalg.det(turn)[:, None]
        flat_m2 = variance_m2[:, 1:] + ROUNDER * (variance_m2[:, 1:].mean(1, keepdims=True) - variance_m2[:, 1:])
        # parts of no area have a size, too: files hold its logarithm
        flat_m = WIDTH * np.sqrt(np.maximum(flat_m2, THICKNESS_M**2))
        sigmas_m = np.concatenate([np.full((len(self), 1), THICKNESS_M), flat_m], 1)
        both = np.concatenate([rgb, self._albedo], 1).astype(np.float32)
        blended, albedo = np.split(self._blended(posed, bones.root_m, both, place_m, normal), 2, 1)
        colors = blended * self._ratio
        if self._rise_m is not None:
            joints_m = posed_joints_m(bones.linear_offset, self._hand.joints_m - self._hand.joints_m[0])
            bent = self._bend.near @ self._bend.of_joints(joints_m[None])[0]
            straight, changed = self._rise_m[0], self._rise_m[1] - self._rise_m[0]
            rise_m = straight + self._of_corners(bent[:, None]).mean(1) * changed
            # that has these rises along both sides
            slope = rise_m[:, :1] * np.cross(other_m, across_m2) - rise_m[:, 1:] * np.cross(side_m, across_m2)
            slope *= bones.scale / np.maximum(np.square(across_m2).sum(1, keepdims=True), np.finfo(np.float32).tiny)
            colors = colors * turned_light(blended, albedo, normal, unit(normal - slope))
        return place_m - bones.scale * BELOW_M * normal + bones.root_m, sigmas_m, turn, colors

    def _of_corners(self, values: np.ndarray) -> np.ndarray:
        """(S, 3, C) at the corners of the parts, of values (V, C) at the vertices."""
        return self._part @ self._fine.with_middles(values)[self._corner].astype(np.float32)

    def _blended(
        self, posed: PosedHand, root_m: np.ndarray, colors: np.ndarray, place_m: np.ndarray, normal: np.ndarray
    ) -> np.ndarray:
        """(S, C) of Gaussians' colors (N, C) as an eye above each place (S, 3), from the root, sees them."""
        position_m, sizes = (posed.position_m - root_m).astype(np.float32), np.bincount(self._group)
        middle_m = np.add.reduceat(place_m, np.cumsum(sizes) - sizes) / sizes[:, None].astype(np.float32)
        nearest = nearest_centers(middle_m, position_m, NEIGHBORS)[self._group]
        apart_m = position_m[nearest] - place_m[:, None]
        height_m = np.einsum("skc,sc->sk", apart_m, normal)
        aside_m2 = np.square(apart_m).sum(-1) - np.square(height_m)
        alpha = self._opacity[nearest] * np.exp(-aside_m2 / (2 * np.square(posed.sigma_m[nearest])))
        order = np.argsort(-height_m, axis=1)
        left = np.cumprod(1 - np.take_along_axis(alpha, order, 1), axis=1)
        seen = -np.diff(left, axis=1, prepend=1) + UNCOVERED
        seen /= seen.sum(1, keepdims=True)
        return np.einsum("sk,skc->sc", seen, colors[np.take_along_axis(nearest, order, 1)])


def halved(corner_m: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Parts of faces (F, 3, 3), as even as can be, at most `count`: the face (S,) of each, and its corners (S, 3, 3) in
    barycentric coordinates of that. The largest parts are halved, over their longest sides, as far as the count allows.
    """
    a, b, c = np.moveaxis(corner_m, 1, 0)
    area_m2 = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    # halving all parts of a face once more adds as many as it has
    times = 2.0 ** np.arange(HALVINGS_MAX)
    sizes_m2 = (area_m2[:, None] / times).ravel()
    order = np.argsort(-sizes_m2, kind="stable")
    added = np.cumsum(np.tile(times, len(area_m2))[order])
    largest_m2 = sizes_m2[order][np.searchsorted(added, count - len(area_m2), side="right")]
    face, part = np.arange(len(area_m2)), np.tile(np.eye(3), (len(area_m2), 1, 1))
    while (is_large := area_m2 > largest_m2).any():
        own, three = face[is_large], part[is_large]
        at_m = three @ corner_m[own]
        longest = np.linalg.norm(np.roll(at_m, -1, 1) - at_m, axis=-1).argmax(1)
        turned = (longest[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(three, turned[..., None], 1), 1, 0)
        middle = (a + b) / 2
        copies = np.where(is_large, 2, 1)
        rows = np.cumsum(copies)[is_large] - 1
        face, part, area_m2 = face.repeat(copies), part.repeat(copies, 0), area_m2.repeat(copies)
        part[rows - 1], part[rows] = np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)
        area_m2[rows - 1] = area_m2[rows] = area_m2[rows] / 2
    return face, part


def turned_light(colors: np.ndarray, albedo: np.ndarray, normal: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """(S, 3) what skin of other normals (S, 3) makes of its display-referred colors (S, 3). How light goes with the
    normal is read from these, whatever lights them: what of a linear albedo (S, 3) they show, as harmonics."""
    lit = srgb_to_linear(colors) / np.maximum(albedo, DARK)
    waves, others = (harmonics(way)[:, :LIGHT_TERMS] for way in (normal, turned))
    light, *_ = np.linalg.lstsq(waves, lit, rcond=None)
    # without any light nothing turns
    least = LIGHT_FLOOR * lit.mean(0) + np.finfo(float).tiny
    before, after = (np.maximum(wave @ light, least) for wave in (waves, others))
    return (after / before).clip(1 / (1 + LIGHT_CHANGE_MAX), 1 + LIGHT_CHANGE_MAX) ** LIGHT_TO_DISPLAY


def _sharpened(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(S, C) means of a texture (H, W, C) over triangles (S, 3, 2), and what blur will take of them."""
    looks = np.eye(3)[None]
    for _ in range(LOOKS_LOG4):
        looks = parted_in_four(looks, (looks + np.roll(looks, -1, 1)) / 2)
    fine, wide = (1 / 3 + scale * (looks.mean(1) - 1 / 3) for scale in (1.0, WIDER))
    fine, wide = (np.mean([sample_bilinear(texture, share @ uv) for share in shares], 0) for shares in (fine, wide))
    return 2 * fine - wide
