"""Skin in the light of a scene, differentiable: the specification of native/scene_light.cpp (docs/LIGHT.md).

Per Gaussian, with albedo rho, normal n, the world's irradiance E(n), lamps i with direction l, irradiance e and seen
part V, what the anchors say of the world (its part that is seen, what hidden skin throws back), and the pose's shade:

    matt  = rho / pi * exp(shade) * (E(n) * part + bounced + sum_i e_i f(n.l_i) V_i)
    color = phi(n.v) * (matt + sum_i GGX_i e_i (n.l_i) V_i + world's lobes * (F0 A + B) * open sky)

Light that was baked stands for all that is in the parentheses.

f is a cosine whose corner is rounded: light that goes through skin reaches a little beyond the terminator, and never
the far side. phi takes skin that faces away, which is seen through gaps between Gaussians only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.cast_task import FLESH_SOFTNESS as DISTANT_FLESH_SOFTNESS
from jghand_engine.avatar.cast_task import LAMP_HALF_WIDTH, PATCH, anchor_blocks, anchors_beside
from jghand_engine.avatar.lamp_rows import LIMITS, compared_at, lamp_rows, light_shares, world_shade
from jghand_engine.avatar.learned import LIGHT_EXPONENT_MAX, Anchors, SkinResponse
from jghand_engine.avatar.scene_light import WORLD_FLOOR, SceneLight
from jghand_engine.avatar.scene_light_step import BLACK, FLESH_SOFTNESS, WIDE_SOFTNESS, mirrored
from jghand_engine.learn.cast_shadow import CastTensors, Flesh, Skin, past_flesh
from jghand_engine.learn.light import harmonics, seen_from_outside, smooth, unit
from jghand_engine.learn.planes import weighted_rows
from jghand_engine.native.scene_light_task import NUMBER, LampKind

# see native/scene_light.cpp
CORNER_MIN, CORNER_MAX = 0.02, 0.95
DISTANCE2_MIN = 1e-12
FACING_MIN = 1e-3
GRAZING_FROM = 50.0
EDGE_GAIN = 100.0
FACING_SUM_MIN = 1e-9
CAUGHT_MIN = 0.01
FACED_MIN, FACED_PART_MIN = 1e-6, 0.25
OPEN_MIN = 1e-12


@dataclass(frozen=True)
class ResponseTensors(SkinResponse[Tensor]):
    @classmethod
    def of(cls, response: SkinResponse, dtype: torch.dtype = torch.float64) -> ResponseTensors:
        """A copy, without gradients."""
        names = ("spread", "roughness", "reflectance", "softness", "bounce")
        arrays = {name: torch.tensor(getattr(response, name), dtype=dtype) for name in names}
        return cls(**arrays, shade_gain=response.shade_gain, trained_on=response.trained_on)


@dataclass(frozen=True)
class Reached:
    """What the anchors say of the light, at the Gaussians.

    part:    (N, 3) of the world's light that is seen
    bounced: (N, 3) W/m2 from skin onto skin
    sky:     (N,) part of the directions that are open
    seen:    (slots, N) part of each lamp
    """

    part: Tensor
    bounced: Tensor
    sky: Tensor
    seen: Tensor


@dataclass(frozen=True)
class LampRows:
    """Lamps as the kernel takes them, see avatar/lamp_rows.py.

    shares:  (lamps + 1,) of all light, see `light_shares`
    rows:    (n, LAMP_NUMBERS)
    casting: (slots, LAMP_NUMBERS) those whose shadows are found
    """

    shares: np.ndarray
    rows: np.ndarray
    casting: np.ndarray

    @classmethod
    def of(cls, light: SceneLight, root_m: np.ndarray, linear_offset: np.ndarray, joints_m: np.ndarray) -> LampRows:
        """Those that matter to a pose. joints_m: (21, 3) canonical, root-relative"""
        points_m = compared_at(linear_offset, joints_m)
        shares = light_shares(light, root_m, points_m)
        return cls(shares, *lamp_rows(light, shares, root_m, points_m, LIMITS)[:2])


def lamp_at(row: np.ndarray, position_m: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Direction to a lamp (N, 3), irradiance of what faces it over its rgb (N,), sine of its half angle (N,)."""
    numbers = {name: float(row[place]) for name, place in NUMBER.items()}
    place = position_m.new_tensor(row[:3])
    ones = torch.ones_like(position_m[:, 0])
    if numbers["kind"] == LampKind.SUN:
        return place.expand_as(position_m), ones, ones * numbers["sun_sine"]
    way = place - position_m
    distance2 = (way * way).sum(-1).clamp_min(DISTANCE2_MIN)
    direction = way * distance2.rsqrt()[:, None]
    strength = 1 / (distance2 + numbers["softening"])
    sine = (numbers["radius2"] / (distance2 + numbers["radius2"])).sqrt()
    cosine = -direction @ position_m.new_tensor(row[3:6])
    if numbers["kind"] == LampKind.SPOT:
        strength = strength * smooth((cosine - numbers["cone"]) * numbers["cone_scale"])
    if numbers["kind"] == LampKind.AREA:
        strength = strength * cosine.clamp_min(0)
        if numbers["spread_gain"] > 0:
            tangent = (1 - cosine * cosine).clamp_min(0).sqrt() / cosine.clamp_min(1e-4)
            strength = strength * (numbers["spread"] - tangent).clamp_min(0) * numbers["spread_gain"]
    return direction, strength, sine


def by_column(rows: Tensor) -> Tensor:
    """The same (N, C) with columns that are contiguous, as results made of it will be: sums over the three channels,
    and products of rows with numbers, are several times as fast on the CPU."""
    return rows.T.contiguous().T


def soft_cosine(cosine: Tensor, width: Tensor) -> Tensor:
    """max(cosine, 0) with its corner rounded over |cosine| < width; 0 below."""
    within = torch.minimum(torch.maximum(cosine, -width), width)
    return (within + width).square() / (4 * width) + (cosine - width).clamp_min(0)


def world_irradiance(light: SceneLight, response: ResponseTensors, normal: Tensor) -> Tensor:
    """(N, 3) W/m2."""
    if light.world is None:
        return torch.zeros_like(normal)
    terms = light.world.terms
    # the corner of the world is that of the whole hand: no gradient goes there
    coefficients = normal.new_tensor(terms.irradiance(response.softness.detach().double().cpu().numpy()))
    least = WORLD_FLOOR * normal.new_tensor(terms.mean_irradiance)
    return torch.maximum(harmonics(normal) @ coefficients, least)


@dataclass(frozen=True)
class Patches:
    """Neighboring anchors that throw light onto others as one.

    of_anchor: (A,) in which of so many each is
    beside:    (A, EVENED) anchors whose mean is taken of the skin that they see, see `anchors_beside`
    """

    of_anchor: np.ndarray
    count: int
    beside: np.ndarray

    @classmethod
    def of(cls, anchors: Anchors[Tensor]) -> Patches:
        places = [values.detach().cpu().numpy() for values in (anchors.position_m, anchors.normal)]
        order = anchor_blocks(*places).order
        of_anchor = np.empty(len(order), np.int64)
        of_anchor[order] = np.arange(len(order)) // PATCH
        return cls(of_anchor, -(-len(order) // PATCH), anchors_beside(*places))

    def mean(self, values: Tensor) -> Tensor:
        """(count, C) of values (A, C) at the anchors."""
        sums, rows = values.new_zeros(self.count, values.shape[1] + 1), torch.from_numpy(self.of_anchor)
        sums = sums.index_add(0, rows.to(values.device), torch.cat([values, torch.ones_like(values[:, :1])], 1))
        return sums[:, :-1] / sums[:, -1:]

    def evened(self, bounced: Tensor, hidden: Tensor) -> Tensor:
        """(A, C) light bounced onto anchors, from skin whose brightness is the mean of what those around see.

        bounced: (A, C) · hidden: (A, 1) as of `faced`
        """
        rows = torch.from_numpy(self.beside.T.astype(np.int64)).to(bounced.device)
        sums = weighted_rows(torch.cat([bounced, hidden], 1), rows, bounced.new_ones(rows.shape))
        return hidden * sums[:, :-1] / sums[:, -1:].clamp_min(FACED_MIN)

    def faced(self, anchors: Skin, hidden: Tensor) -> Tensor:
        """(A, count) part of all that an anchor faces, by cosines, that each patch is: what flesh stands before, as
        much of it as skin of this hand is there. Below a quarter of it, another hand's is missing.

        anchors: posed · hidden: (A, 1) part of all directions, by cosines, that flesh stands before
        """
        place_m, normal = self.mean(anchors.position_m), self.mean(anchors.normal)
        within2 = self.mean((anchors.position_m - place_m[self.of_anchor]).square().sum(1, keepdim=True))[:, 0]
        # by columns: a third of the time of rows of three
        x_m, y_m, z_m = (place_m[:, k] - anchors.position_m[:, k, None] for k in range(3))
        own, other = anchors.normal.T[..., None], normal.T
        facing = x_m * own[0] + y_m * own[1] + z_m * own[2]
        cosines = facing.clamp_min(0) * -(x_m * other[0] + y_m * other[1] + z_m * other[2]).clamp_max(0)
        # a disc of twice the mean squared distance; nearer than it is large, it is no point
        way2 = x_m * x_m + y_m * y_m + z_m * z_m
        faces = cosines * 2 * within2 / (way2 + within2 + DISTANCE2_MIN).square()
        whole = torch.maximum(faces.sum(1, keepdim=True), FACED_PART_MIN * hidden).clamp_min(FACED_MIN)
        return hidden * faces / whole


@dataclass(frozen=True)
class Shadows:
    """What is seen past the flesh of one pose: nothing of it is learned.

    patches:    of the anchors, which throw light onto others
    visible:    (A, CELLS) part of the world's cells at the anchors
    at_anchors: (slots, A) part of each lamp
    at_skin:    (slots, N) the same at the Gaussians
    """

    patches: Patches
    visible: Tensor
    at_anchors: Tensor
    at_skin: Tensor

    def nbytes(self) -> int:
        """Memory of its own, bytes: all poses of a hand share their patches."""
        return self.visible.nbytes + self.at_anchors.nbytes + self.at_skin.nbytes

    def prefix(self, count: int) -> Shadows:
        """The same for the first `count` Gaussians."""
        return replace(self, at_skin=self.at_skin[:, :count])


def shadows(
    cast: CastTensors, patches: Patches, anchors: Skin, skin: Skin, flesh: Flesh, light: SceneLight, lamps: LampRows
) -> Shadows:
    """patches: of the hand's anchors · anchors, skin: posed, root-relative"""
    seen = wide = anchors.position_m.new_zeros(0, len(anchors.position_m))
    for row in lamps.casting:
        direction, _, sine = lamp_at(row, anchors.position_m)
        towards, half_width = direction[:, None], sine[:, None]
        seen = torch.cat([seen, past_flesh(anchors, flesh, towards, FLESH_SOFTNESS, half_width).T])
        wide = torch.cat([wide, past_flesh(anchors, flesh, towards, WIDE_SOFTNESS, half_width).T])
    spread = cast.anchors.spread
    of_lamps = spread(seen.T).T if len(seen) else seen.new_zeros(0, len(cast.anchors.nearest))
    near = replace(flesh, hides=spread(flesh.hides))
    for slot, row in enumerate(lamps.casting):
        direction, _, sine = lamp_at(row, skin.position_m)
        own = past_flesh(skin, near, direction[:, None], FLESH_SOFTNESS, sine[:, None])[:, 0]
        near_edge = spread(wide[slot][:, None])[:, 0]
        edge = (EDGE_GAIN * near_edge * (1 - near_edge)).clamp(0, 1)
        of_lamps = torch.cat([of_lamps[:slot], torch.lerp(of_lamps[slot], own, edge)[None], of_lamps[slot + 1 :]])
    directions = seen.new_tensor((BLACK if light.world is None else light.world).terms.direction)
    visible = past_flesh(anchors, flesh, directions, DISTANT_FLESH_SOFTNESS, LAMP_HALF_WIDTH)
    return Shadows(patches, visible, seen, of_lamps)


def reached(
    cast: CastTensors, anchors: Skin, fallen: Shadows, light: SceneLight, lamps: LampRows, response: ResponseTensors
) -> Reached:
    """What reaches the skin of one pose. anchors: posed, root-relative"""
    given, visible = torch.zeros_like(anchors.normal), fallen.visible
    for row in lamps.rows:
        direction, strength, _ = lamp_at(row, anchors.position_m)
        part = _drawn(fallen.at_anchors, row)
        got = (anchors.normal * direction).sum(-1).clamp_min(0) * strength * part * float(row[NUMBER["on_matt"]])
        given = given + got[:, None] * given.new_tensor(row[6:9])
    terms = (BLACK if light.world is None else light.world).terms
    cells, directions = given.new_tensor(terms.light), given.new_tensor(terms.direction)
    cosine = (anchors.normal @ directions.T).clamp_min(0)
    part = ((cosine * visible) @ cells + OPEN_MIN) / (cosine @ cells + OPEN_MIN)
    all_around, open_sky = cosine.sum(1, keepdim=True), (cosine * visible).sum(1, keepdim=True)
    hidden = 1 - (open_sky + FACING_SUM_MIN) / (all_around + FACING_SUM_MIN)
    # what it sees of skin is as bright as itself, and sees as much of it in turn
    again = (1 - response.bounce * hidden).clamp_min(CAUGHT_MIN)
    thrown = response.bounce * (world_irradiance(light, response, anchors.normal) * part + given) / again
    patches = fallen.patches
    bounced = patches.evened(patches.faced(anchors, hidden) @ patches.mean(thrown), hidden)
    at_skin = by_column(cast.anchors.spread(torch.cat([part, bounced, 1 - hidden], 1)))
    shade, _ = world_shade(lamps.shares, response.bounce.detach().double().cpu().numpy(), LIMITS)
    part, sky = 1 - shade * (1 - at_skin[:, :3]), 1 - shade * (1 - at_skin[:, 6])
    return Reached(part, shade * at_skin[:, 3:6], sky, fallen.at_skin)


def matt(
    albedo: Tensor,
    skin: Skin,
    got: Reached,
    light: SceneLight,
    lamps: LampRows,
    response: ResponseTensors,
    shade: Tensor | None,
) -> Tensor:
    """(N, 3) radiance that is the same from everywhere."""
    if light.baked is None:
        irradiance = by_column(world_irradiance(light, response, skin.normal)) * got.part + got.bounced
    else:
        field = albedo.new_tensor(light.baked.field[0][: len(albedo)])
        irradiance = (field[:, 0] + torch.einsum("na,nac->nc", skin.normal, field[:, 1:])).clamp_min(0)
    corner2 = by_column((response.spread[:, None] * response.softness).square())
    for row in lamps.rows if light.baked is None else ():
        direction, strength, sine = lamp_at(row, skin.position_m)
        corner = (corner2 + sine.square()[:, None]).sqrt().clamp(CORNER_MIN, CORNER_MAX)
        cosine = (skin.normal * direction).sum(-1, keepdim=True)
        strength = strength * _drawn(got.seen, row) * float(row[NUMBER["on_matt"]])
        irradiance = irradiance + soft_cosine(cosine, corner) * strength[:, None] * albedo.new_tensor(row[6:9])
    result = albedo / np.pi * irradiance
    if shade is not None:
        result = result * (shade * response.shade_gain).clamp(-LIGHT_EXPONENT_MAX, LIGHT_EXPONENT_MAX).exp()
    return result


def towards_eye(
    matt_rgb: Tensor,
    skin: Skin,
    eye_m: Tensor,
    got: Reached,
    light: SceneLight,
    lamps: LampRows,
    response: ResponseTensors,
) -> Tensor:
    """(N, 3) what the eye (3,), root-relative, gets of it."""
    eye = unit(eye_m - skin.position_m.detach())
    facing = (skin.normal * eye).sum(-1)
    cosine_eye, alpha = facing.clamp_min(FACING_MIN), response.roughness.square()
    k, rgb = alpha / 2, matt_rgb
    rise = (GRAZING_FROM * response.reflectance).clamp_max(1)
    for row in lamps.rows:
        direction, strength, sine = lamp_at(row, skin.position_m)
        half = unit(direction + eye)
        cosine, middle = ((skin.normal * each).sum(-1).clamp(0, 1) for each in (direction, half))
        wide2 = (alpha + sine / 2).clamp_max(1).square()
        bell = middle.square() * (wide2 - 1) + 1
        grazing = (1 - (direction * half).sum(-1).clamp(0, 1)) ** 5
        fresnel = response.reflectance + (1 - response.reflectance) * rise * grazing
        masked = (cosine * (1 - k) + k) * (cosine_eye * (1 - k) + k)
        shine = wide2 / (np.pi * bell.square()) * fresnel / 4 * cosine / masked * strength * _drawn(got.seen, row)
        rgb = rgb + shine[:, None] * float(row[NUMBER["on_gloss"]]) * rgb.new_tensor(row[6:9])
    if light.world is not None:
        lobes = rgb.new_tensor(mirrored(light.world, response.roughness.detach().double().cpu().numpy()))
        rough = response.roughness
        # between the normal and the mirrored direction
        part = (1 - rough) * ((1 - rough).sqrt() + rough)
        to_mirror = torch.lerp(skin.normal, 2 * facing[:, None] * skin.normal - eye, part[:, None])
        sharp = lobes[:, 3:4]
        sky = (lobes[:, 4:].T @ torch.exp(sharp * lobes[:, :3] @ unit(to_mirror).T - sharp)).T
        r0, r1 = 1 - rough, 0.0425 - 0.0275 * rough
        r2, r3 = 1.04 - 0.572 * rough, 0.022 * rough - 0.04
        base = torch.minimum(r0 * r0, torch.exp2(-9.28 * cosine_eye)) * r0 + r1
        gain = response.reflectance * (r2 - 1.04 * base) + rise * (r3 + 1.04 * base)
        rgb = rgb + sky * (gain * got.sky)[:, None]
    return rgb * seen_from_outside(facing)[:, None]


def _drawn(seen: Tensor, row: np.ndarray) -> Tensor | float:
    """(N,) part of a lamp that reaches points, by what they see of each slot: its shadow may have faded."""
    slot = int(row[NUMBER["slot"]])
    return 1 - float(row[NUMBER["shade"]]) * (1 - seen[slot]) if slot >= 0 else 1.0
