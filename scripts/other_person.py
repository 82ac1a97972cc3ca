"""A trained hand as another person's: its shape and its skin changed by what the maps of two persons differ in.

Nothing of the other person was ever seen in pictures. What was learned stays: how skin answers light, how it moves with
the pose. It needs a hand that learned from a capture of procedural skin in known light, so that its colors are albedo.

    shape    Gaussians move by how far one identity lies from the other where both are driven by the same joints, with
             the relief of both that moves the mesh
    color    each Gaussian's albedo is multiplied by the ratio of both persons' maps over its footprint
    detail   the other's, which the trained person's own hand has, too: colors and relief of its maps. What a training
             found of them, from sides that do not agree to a pixel, has a twenty-fifth of their power
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.detail import LOG_RATIO_MAX, RATIO_STEPS, Detail, ratio_bytes
from jghand_engine.avatar.learned import Learned, SkinResponse
from jghand_engine.avatar.relief import HEIGHT_STEP_M, Relief
from jghand_engine.avatar.relighting import thrown_back
from jghand_engine.captures.making.person_skin import scatter_m
from jghand_engine.captures.making.rig import Identity, load_identity
from jghand_engine.captures.skin.canvas import MM
from jghand_engine.captures.skin.color import RGB_LIMITS, ROUGHNESS_LIMITS
from jghand_engine.captures.skin.maps import SkinMaps, nearest_covered
from jghand_engine.captures.skin.person import Person
from jghand_engine.captures.skin.surface import SkinSurface
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.rotations import unit
from jghand_engine.template.builtin import template_called
from jghand_engine.template.reshape import pulled_back, reshaped
from jghand_engine.template.subdivision import Subdivision
from jghand_engine.template.texture import rasterize_uv, sample_bilinear

# the template's faces are split twice for the change of shape: 1.3 mm, as fine as Gaussians lie
LEVELS = 2
# spread of a Gaussian's footprint, mm: the median radius in a hand of 40,000; of its color less, or the edges of nails
# would be blurred twice
FOOTPRINT_MM, COLOR_FOOTPRINT_MM = 0.6, 0.25
# detail is what is finer than this, mm, in the maps and not in the Gaussians, which show little of less
DETAIL_MM = 1.5
# what makes gloss is a mean over this spread, mm, of so many Gaussians at most whose normals have this cosine at least:
# a finger next to another is not asked
GLOSS_MM, GLOSS_MEAN, GLOSS_ALIKE = 2.0, 40, 0.3
# Gaussians that are looked at for a texel: those beyond change nothing that is seen; texels at once, for 200 MB
SHOWN, TEXELS_AT_ONCE = 16, 100_000
# where none of them reaches, which no picture shows, it is the mean of all
LEAST_ALPHA = 1e-9
# of the relief what light does not show: it goes below the skin and comes out beside, where reliefs of a texel are
# smoother, and a little less deep. Chosen by eye beside pictures of Cycles, at the truth's power of detail
RELIEF_BLUR_MM, RELIEF_GAIN = 0.17, 0.9
# blur of the colors, mm: half of the bytes, and nothing that is seen
COLOR_BLUR_MM = 0.1
# log ratio: 3.4 % of the light, six steps of a byte, and twice that of how hues differ. Nobody sees finer ones, and a
# file keeps its 8 MB
TEXTURE_STEP = 6 * LOG_RATIO_MAX / RATIO_STEPS


@dataclass(frozen=True)
class Somebody:
    """An identity, what is painted on it, and for whom."""

    identity: Identity
    person: Person
    maps: SkinMaps

    @property
    def texel_mm(self) -> float:
        """Edge of a texel on the skin, the mean over the skin."""
        hand = self.identity
        corners = hand.vertices_m[hand.faces[: hand.skin_face_count]]
        on_skin = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        uv = hand.face_uv[: hand.skin_face_count]
        in_uv = np.abs(np.linalg.det(uv[:, 1:] - uv[:, :1]))
        return 1e3 * float(np.sqrt(on_skin.sum() / in_uv.sum())) / len(self.maps.rgb)

    @cached_property
    def covered(self) -> np.ndarray:
        """(S, S, 1) 1 where a texel shows skin, else 0."""
        uv = self.identity.face_uv[: self.identity.skin_face_count]
        return rasterize_uv(uv, np.zeros((len(uv), 3, 1)), len(self.maps.rgb))[1][..., None].astype(np.float32)

    def blurred(self, values: np.ndarray, spread_mm: float = FOOTPRINT_MM) -> np.ndarray:
        """(S, S, C) a map blurred on the skin; left out, as Gaussians can show it."""
        sigma = spread_mm / self.texel_mm
        return np.stack([gaussian_filter(each, sigma) for each in np.moveaxis(values, -1, 0)], -1)


def as_person(avatar: HandAvatar, own: Somebody, other: Somebody) -> HandAvatar:
    """The avatar of `own` as `other`, but for its detail (`person_detail`). Its joints at rest are the
    other's.

    InputError for an avatar that did not learn in known light.
    """
    learned = avatar.learned
    if learned is None or learned.response is None:
        raise InputError(f"avatar {avatar.info.name}", wanted="one that learned in known light", came="another")
    uv = avatar.uvd[:, :2].astype(np.float64)
    before, after = (sample_bilinear(one.blurred(one.maps.rgb, COLOR_FOOTPRINT_MM), uv) for one in (own, other))
    rgb = (avatar.rgb * (after / before)).clip(*RGB_LIMITS).astype(np.float32)
    rgb = np.where(after == before, avatar.rgb, rgb)
    even = _with_even_skin(avatar, learned, _response(learned.response, own, other, uv))
    shaped = other_shape(replace(avatar, rgb=rgb, learned=even), own, other)
    assert shaped.learned is not None
    assert shaped.learned.response is not None
    response = replace(shaped.learned.response, bounce=thrown_back(shaped, rgb))
    return replace(shaped, learned=replace(shaped.learned, response=response), own_joints_m=other.identity.joints_m)


def other_shape(avatar: HandAvatar, own: Somebody, other: Somebody) -> HandAvatar:
    """The avatar with its skin where the other's is, driven by the same joints."""
    template = template_called(avatar.info.template)
    fine = Subdivision.of(template.faces, template.face_uv, LEVELS)
    skeleton = avatar.for_hand(Handedness.RIGHT).skeleton()
    own_m, other_m = (
        pulled_back(
            skeleton,
            _skin_m(one),
            fine.matrix @ one.identity.bone_weights,
            skeleton.bones(one.identity.joints_m, np.float64),
        )
        for one in (own, other)
    )
    before_m = fine.matrix @ template.vertices_m
    return reshaped(avatar, fine.faces, before_m, before_m + (other_m - own_m))


def _skin_m(one: Somebody) -> np.ndarray:
    """(V, 3) the fine surface of an open hand."""
    surface = SkinSurface(one.identity, LEVELS, one.maps)
    return surface.posed(one.identity.vertices_m, surface.bent(one.identity.joints_m[None])[0])


def _with_even_skin(avatar: HandAvatar, learned: Learned, response: SkinResponse) -> Learned:
    """With this response, its roughness and reflectance, and the normals, as means of those around each Gaussian: what
    they differ in from one to the next is chance, which the gloss of dark skin shows as gray blotches."""
    normal = learned.normal
    apart_m, near = map(np.asarray, KDTree(avatar.position_m).query(avatar.position_m, GLOSS_MEAN))
    weight = np.exp(-0.5 * (apart_m / GLOSS_MM / MM) ** 2) * avatar.opacity[near]
    weight *= np.einsum("gc,gkc->gk", normal, normal[near]) > GLOSS_ALIKE
    weight /= weight.sum(1, keepdims=True)
    normal, roughness, reflectance = (
        np.einsum("gk,gk...->g...", weight, each[near]).astype(np.float32)
        for each in (normal, response.roughness, response.reflectance)
    )
    response = replace(response, roughness=roughness, reflectance=reflectance)
    return replace(learned, normal=unit(normal), response=response)


def _response(response: SkinResponse, own: Somebody, other: Somebody, uv: np.ndarray) -> SkinResponse:
    """Gloss by the maps; light goes as much farther below paler skin."""
    before, after = (sample_bilinear(one.blurred(one.maps.roughness[..., None]), uv)[:, 0] for one in (own, other))
    roughness = (response.roughness + (after - before)).clip(*ROUGHNESS_LIMITS)
    return replace(
        response,
        roughness=np.where(after == before, response.roughness, roughness).astype(np.float32),
        softness=(response.softness * (scatter_m(other.person) / scatter_m(own.person))).astype(np.float32),
    )


# ---- detail ----------------------------------------------------------------------------------------------------------


def person_detail(avatar: HandAvatar, one: Somebody) -> Detail:
    """The avatar's detail with the colors and the relief of the maps of the person on whose skin it lies.

    InputError for an avatar without detail.
    """
    detail = avatar.detail
    if detail is None:
        raise InputError(f"avatar {avatar.info.name}", wanted="one with detail", came="one without")
    size = detail.size
    skin = _resized(one.covered, size) > 0.5
    fine_of_maps, fine_of_gaussians = (
        np.log(rgb / one.blurred(rgb, DETAIL_MM)) for rgb in (one.maps.rgb, shown_albedo(avatar, detail, one))
    )
    # what the file cannot hold would leave jags at the edges of nails, were it blurred before
    color = (fine_of_maps - fine_of_gaussians).clip(-LOG_RATIO_MAX, LOG_RATIO_MAX)
    color = _resized(one.blurred(color, COLOR_BLUR_MM), size)
    green = color[..., 1:2]
    color = TEXTURE_STEP * (np.rint(green / TEXTURE_STEP) + 2 * np.rint((color - green) / (2 * TEXTURE_STEP)))
    fine = one.maps.fine
    # as blender_addon/capture/scene.py mixes the maps by how bent the joints are
    straight, bent = fine["static"] + fine["straight"] + fine["fold"], fine["static"] + 1.5 * fine["fold"]
    height_m = RELIEF_GAIN * MM * one.blurred(np.stack([straight, bent], -1), RELIEF_BLUR_MM)
    height = np.rint(_resized(height_m, size) / HEIGHT_STEP_M).clip(-127, 127)
    return replace(detail, texture=ratio_bytes(color * skin), relief=Relief((height * skin).astype(np.int8)))


def shown_albedo(avatar: HandAvatar, detail: Detail, one: Somebody) -> np.ndarray:
    """(S, S, 3) what the Gaussians show at each texel of the maps, seen along the skin's normal: the nearest ones,
    blended from the outermost inwards. Around the island the nearest texel goes on."""
    corners = np.concatenate([detail.position_m[detail.faces], detail.normals[detail.faces]], -1)
    laid, covered = rasterize_uv(detail.face_uv, corners, len(one.maps.rgb))
    points_m, outwards = laid[covered][:, :3], unit(laid[covered][:, 3:])
    tree, shown = KDTree(avatar.position_m), np.empty_like(points_m)
    for start in range(0, len(points_m), TEXELS_AT_ONCE):
        rows = slice(start, start + TEXELS_AT_ONCE)
        apart_m, nearest = map(np.asarray, tree.query(points_m[rows], SHOWN))
        rise_m = np.einsum("tgk,tk->tg", avatar.position_m[nearest] - points_m[rows, None], outwards[rows])
        order = np.argsort(-rise_m, 1)
        apart_m, nearest, rise_m = (np.take_along_axis(each, order, 1) for each in (apart_m, nearest, rise_m))
        across = (apart_m**2 - rise_m**2) / avatar.sigma_m[nearest] ** 2
        alpha = np.maximum(avatar.opacity[nearest] * np.exp(-across / 2), LEAST_ALPHA)
        left = np.cumprod(1 - alpha, 1)
        weight = alpha * np.concatenate([np.ones_like(left[:, :1]), left[:, :-1]], 1)
        shown[rows] = np.einsum("tg,tgc->tc", weight, avatar.rgb[nearest]) / weight.sum(1, keepdims=True)
    square = np.zeros((*covered.shape, 3), np.float32)
    square[covered] = shown
    row, column = nearest_covered(covered)
    return square[row, column]


def _resized(values: np.ndarray, size: int) -> np.ndarray:
    """(size, size, C) float32 of (S, S, C): a texture and maps need not have the same number of texels."""
    if len(values) == size:
        return values.astype(np.float32)
    step = (np.arange(size) + 0.5) / size
    uv = np.stack(np.broadcast_arrays(step[None, :], 1 - step[:, None]), -1)
    return sample_bilinear(values, uv).astype(np.float32)


def somebody(avatar: HandAvatar, name: str, person: Person, maps: SkinMaps) -> Somebody:
    """Of an identity's name; with a forearm where the avatar has one."""
    return Somebody(load_identity(name, forearm=avatar.has_forearm), person, maps)
