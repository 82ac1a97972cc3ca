"""A trained hand as another person's: its shape and its skin changed by what the maps of two persons differ in.

Nothing of the other person was ever seen in pictures. What was learned stays: how skin answers light, how it moves with
the pose. It needs a hand that learned from a capture of procedural skin in known light, so that its colors are albedo.

    shape    Gaussians move by how far one identity lies from the other where both are driven by the same joints, with
             the relief of both that moves the mesh
    color    each Gaussian's albedo is multiplied by the ratio of both persons' maps over its footprint
    detail   the other's: of its color what is finer than Gaussians, and what its relief does to light, as the learned
             texture says that its own person's does
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.detail import LOG_RATIO_MAX, RATIO_STEPS, Detail, log_ratios, ratio_bytes
from jghand_engine.avatar.learned import SkinResponse
from jghand_engine.captures.making.person_skin import scatter_m
from jghand_engine.captures.making.rig import Identity, load_identity
from jghand_engine.captures.skin.color import RGB_LIMITS, ROUGHNESS_LIMITS
from jghand_engine.captures.skin.maps import FINE_LAYERS, SkinMaps
from jghand_engine.captures.skin.person import Person
from jghand_engine.captures.skin.surface import SkinSurface
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.template.builtin import template_called
from jghand_engine.template.reshape import pulled_back, reshaped
from jghand_engine.template.subdivision import Subdivision
from jghand_engine.template.texture import rasterize_uv, sample_bilinear

# the template's faces are split twice for the change of shape: 1.3 mm, as fine as Gaussians lie
LEVELS = 2
# spread of a Gaussian's footprint, mm: the median radius in a hand of 40,000. Detail is what is finer
FOOTPRINT_MM = 0.6
# spreads between which the bands of the relief lie that explain a texture, texels
BANDS_TEXELS = (0.0, 0.7, 1.4, 2.8, 5.6)
# penalty of the least squares on coefficients of features of unit variance, as a part of the texels: bands are alike
RIDGE = 1e-3
# log ratio: 1.7 % of the light, three steps of a byte. Nobody sees finer ones, and a file keeps its 8 MB
TEXTURE_STEP = 3 * LOG_RATIO_MAX / RATIO_STEPS
# of the color's detail a texture has found nothing when it has less than this part of it
FOUND_MIN = 0.05
# texels that the least squares look at: every so many'th of a row and a column
EVERY = 2


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

    def blurred(self, values: np.ndarray) -> np.ndarray:
        """(S, S, C) a map as Gaussians can show it."""
        sigma = FOOTPRINT_MM / self.texel_mm
        return np.stack([gaussian_filter(one, sigma) for one in np.moveaxis(values, -1, 0)], -1)


@dataclass(frozen=True)
class Shading:
    """What the learned texture says of the relief of its person.

    bands: (K,) log of light by each of `relief_bands`, per mm; 0 where the texture says nothing
    found: how much of the color's own detail, which is known, the texture has: 1 is all of it
    r2:    part of the texture's variance that both explain
    """

    bands: np.ndarray
    found: float
    r2: float


def as_person(avatar: HandAvatar, own: Somebody, other: Somebody) -> HandAvatar:
    """The avatar of `own` as `other`, but for the texture of its detail (`other_detail`). Its joints at rest are the
    other's.

    InputError for an avatar that did not learn in known light.
    """
    learned = avatar.learned
    if learned is None or learned.response is None:
        raise InputError(f"avatar {avatar.info.name}", wanted="one that learned in known light", came="another")
    uv = avatar.uvd[:, :2].astype(np.float64)
    before, after = (sample_bilinear(one.blurred(one.maps.rgb), uv) for one in (own, other))
    rgb = (avatar.rgb * (after / before)).clip(*RGB_LIMITS).astype(np.float32)
    rgb = np.where(after == before, avatar.rgb, rgb)
    learned = replace(learned, response=_response(learned.response, own, other, uv))
    shaped = other_shape(replace(avatar, rgb=rgb, learned=learned), own, other)
    return replace(shaped, own_joints_m=other.identity.joints_m)


def other_shape(avatar: HandAvatar, own: Somebody, other: Somebody) -> HandAvatar:
    """The avatar with its skin where the other's is, driven by the same joints."""
    template = template_called(avatar.info.template)
    fine = Subdivision.of(template.faces, template.face_uv, LEVELS)
    skeleton = avatar.for_hand(Handedness.RIGHT).skeleton()
    own_m, other_m = (
        pulled_back(skeleton, _skin_m(one), fine.matrix @ one.identity.bone_weights, one.identity.joints_m)
        for one in (own, other)
    )
    before_m = fine.matrix @ template.vertices_m
    return reshaped(avatar, fine.faces, before_m, before_m + (other_m - own_m))


def _skin_m(one: Somebody) -> np.ndarray:
    """(V, 3) the fine surface of an open hand."""
    surface = SkinSurface(one.identity, LEVELS, one.maps)
    return surface.posed(one.identity.vertices_m, surface.bent(one.identity.joints_m[None])[0])


def _response(response: SkinResponse, own: Somebody, other: Somebody, uv: np.ndarray) -> SkinResponse:
    """Gloss by the maps; light goes as much farther below paler skin, and as much more of it is thrown back."""
    before, after = (sample_bilinear(one.blurred(one.maps.roughness[..., None]), uv)[:, 0] for one in (own, other))
    roughness = (response.roughness + (after - before)).clip(*ROUGHNESS_LIMITS)
    own_rgb, other_rgb = (sample_bilinear(one.maps.rgb, uv).mean(0) for one in (own, other))
    return replace(
        response,
        roughness=np.where(after == before, response.roughness, roughness).astype(np.float32),
        softness=(response.softness * (scatter_m(other.person) / scatter_m(own.person))).astype(np.float32),
        bounce=(response.bounce * (other_rgb / own_rgb)).clip(0, 1).astype(np.float32),
    )


# ---- detail ----------------------------------------------------------------------------------------------------------


def shading(detail: Detail, own: Somebody) -> Shading:
    """By least squares of the texture, its channels' mean, on the color's and the relief's detail.

    What is seen from many sides is learned blurred: of the color's detail, which is in the maps, less than all is
    found. As much is missing of the relief's, so that both are divided by what was found.
    """
    skin = _resized(own.covered, detail.size)[::EVERY, ::EVERY, 0] > 0.5
    color = color_detail(own, detail.size).mean(-1, keepdims=True)
    rows = np.concatenate([color, relief_bands(own, detail.size)], -1)[::EVERY, ::EVERY][skin].astype(np.float64)
    wanted = log_ratios(detail.texture)[::EVERY, ::EVERY][skin].mean(-1).astype(np.float64)
    rows, wanted = rows - rows.mean(0), wanted - wanted.mean()
    size = np.sqrt(np.square(rows).mean(0)).clip(1e-12)
    scaled = rows / size
    coefficients = np.linalg.solve(scaled.T @ scaled + RIDGE * len(rows) * np.eye(len(size)), scaled.T @ wanted) / size
    found = float(coefficients[0])
    bands = coefficients[1:] / found if found > FOUND_MIN else np.zeros(len(size) - 1)
    left = wanted - rows @ coefficients
    return Shading(bands, found, float(1 - left.var() / max(wanted.var(), 1e-12)))


def other_detail(detail: Detail, light: Shading, other: Somebody) -> Detail:
    """The detail with the texture of another's maps."""
    relief = relief_bands(other, detail.size) @ light.bands.astype(np.float32)
    texture = color_detail(other, detail.size) + relief[..., None]
    steps = np.rint(texture / TEXTURE_STEP) * TEXTURE_STEP
    return replace(detail, texture=ratio_bytes(steps * (_resized(other.covered, detail.size) > 0.5)))


def color_detail(one: Somebody, size: int) -> np.ndarray:
    """(size, size, 3) log of how much brighter each texel is than what Gaussians show there."""
    return _resized(np.log(one.maps.rgb / one.blurred(one.maps.rgb)), size)


def relief_bands(one: Somebody, size: int) -> np.ndarray:
    """(size, size, K) how far each texel stands out from its neighborhood, mm, by the width of that, and how far it
    lies below it, which light does not reach evenly. Of straight joints."""
    height = _resized(np.sum([one.maps.fine[layer] for layer in FINE_LAYERS], axis=0)[..., None], size)[..., 0]
    blurred = [height if spread == 0 else gaussian_filter(height, spread) for spread in BANDS_TEXELS]
    bands = np.stack([fine - coarse for fine, coarse in pairwise(blurred)], -1)
    return np.concatenate([bands, np.minimum(bands, 0)], -1)


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
