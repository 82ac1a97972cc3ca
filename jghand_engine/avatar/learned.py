"""What a trained avatar knows beyond its canonical Gaussians: normals, light, correctives, shadows. Plain arrays.

How a pose makes use of it is said by the differentiable form in torch, which training goes through, and done by the
native kernels, which draw; tests hold the two together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np

from jghand_engine.avatar.correctives import Correctives, PerGaussian, PoseNetwork
from jghand_engine.avatar.nearest import nearest_centers
from jghand_engine.avatar.tiers import Distilled, Price, Tier, choose
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import PARENTS
from jghand_engine.native.contract import SHADOW_GAIN, SHADOW_TINT

# capsule radii of the flesh of bones 1..20, millimeters at scale 1 (METHOD 5.4)
CAPSULE_RADII_MM = (
    *(16.0,) * 5, 10.0, 9.0, 9.0, 8.5, 7.5, 9.0, 8.0, 8.0, 7.8, 7.0, 8.0, 7.2, 7.2, 7.0, 6.2,
)  # fmt: skip
# capsules are fitted to so many anchors, evenly taken, in so many steps of half the way: whole ones give and take the
# same points for ever. After them they move by some tenths of a millimeter a step
FIT_POINTS, FIT_ROUNDS, FIT_STEP = 1024, 40, 0.5
# what holds each axis to its bone, per point of skin: shadows are as good with half or twice of it
FIT_STAY = 0.02
# no skin is farther from the capsules along its bones, meters
FIT_REACH_M = 0.03
MIDDLE_METACARPAL = 2
# least radius, meters; floors against division by zero: distance from an axis, m, and its squared length, m^2
CAPSULE_RADIUS_MIN_M, AXIS_DISTANCE_MIN_M, CAPSULE_LENGTH2_MIN = 1e-4, 1e-9, 1e-12
# canonical Gaussians further than this from the wrist along an axis, meters, belong to no hand
AVATAR_REACH_M = 0.5
# flesh is a point's own up to this many radii from its bone, and wholly foreign from this many on: skin behind a
# knuckle lies 1.5 radii from the bone before it, which in a fist would stand in its light
OWN_FLESH_RADII = (1.4, 2.0)
# a shadow that never changes a pixel by more, as it was measured, is not drawn: two 8-bit steps, on the darkest pixel
SHADOW_UNSEEN = 2 / 255
# logarithm of the strongest light and shade: exp(3) is 20 times, farther than any display reaches
LIGHT_EXPONENT_MAX = 3.0
# logarithm of the longest and shortest axis of a Gaussian over its radius: 20 times, a needle
LOG_STRETCH_MAX = 3.0

# coefficients of the light's irradiance: real spherical harmonics of degrees 0 to 3
SH_COUNT = 16
# anchors of the cast shadow that a Gaussian is interpolated from, and the whole numbers that their shares are of
ANCHOR_NEIGHBORS = 3
# anchors are nearer than the next one by this at least, meters, so that some count where all are equally far
ANCHOR_NEARER_MIN_M = 1e-6
SHARE_UNITS = 255

# NumPy's arrays; tensors while a hand is learned
Array = TypeVar("Array", bound=Any)


@dataclass(frozen=True)
class Light(Generic[Array]):
    """The light of the capture, in the world's frame, that of the joints.

    irradiance:     (16, 3) coefficients of the logarithm of the color that matt skin gets
    lobe_direction: (K, 3) towards the lights, of any length
    lobe_sharpness: (K,) lambda of exp(lambda (cos - 1))
    lobe_rgb:       (K, 3) display-referred, 0 and up
    rim:            () how much more is reflected at grazing angles, 0 and up
    """

    irradiance: Array
    lobe_direction: Array
    lobe_sharpness: Array
    lobe_rgb: Array
    rim: Array


def no_light() -> Light:
    """Of a hand that shines with its own colors alone, or is lit by a scene."""
    nothing = np.zeros((0, 3), np.float32)
    return Light(np.zeros((SH_COUNT, 3), np.float32), nothing, nothing[:, 0], nothing, np.zeros((), np.float32))


@dataclass(frozen=True)
class ShadowLook:
    """How dark the self-shadow is: gain and strength per color channel of METHOD 5.2, both learned.

    seen:    0..1, the most that it changes a channel of any pixel, as `jghand distill` measured it; None: not measured
    printed: learned with the paper's own form, which `learn.shadow` alone draws; the renderer draws its own instead
    """

    gain: float = SHADOW_GAIN
    tint: tuple[float, float, float] = SHADOW_TINT
    seen: float | None = None
    printed: bool = False

    @property
    def is_seen(self) -> bool:
        """Whether anybody would miss it."""
        return self.seen is None or self.seen > SHADOW_UNSEEN


@dataclass(frozen=True)
class Ellipsoid(PerGaussian, Generic[Array]):
    """How canonical Gaussians differ from spheres of their sigma.

    log_stretch: (N, 3) logarithm of each axis over sigma
    quaternion:  (N, 4) wxyz of any length, turns the axes
    """

    ROWS = ("log_stretch", "quaternion")

    log_stretch: Array
    quaternion: Array


@dataclass(frozen=True)
class Anchors(PerGaussian, Generic[Array]):
    """Where the cast shadow is computed, and how it is spread to N Gaussians.

    position_m:   (A, 3) float32 canonical, meters
    normal:       (A, 3) float32 unit
    bone_weights: (A, 21) float32
    nearest:      (N, 3) int64 anchors around each Gaussian
    share:        (N, 3) float32 of each, sums to 1
    """

    ROWS = ("nearest", "share")

    position_m: Array
    normal: Array
    bone_weights: Array
    nearest: Array
    share: Array

    def __len__(self) -> int:
        return len(self.position_m)


def anchors_around(anchors: Anchors, position_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) those around canonical places (V, 3), and their shares, as of Gaussians."""
    nearest = nearest_centers(position_m, anchors.position_m, ANCHOR_NEIGHBORS + 1)
    distance_m = np.linalg.norm(position_m[:, None] - anchors.position_m[nearest], axis=-1)
    order = distance_m.argsort(1)
    nearest, share = mixed_of(np.take_along_axis(nearest, order, 1), np.take_along_axis(distance_m, order, 1))
    return nearest, share.astype(np.float32)


def mixed_of(nearest: np.ndarray, distance_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) anchors that places mix, and their shares, of the four nearest (V, 4) and how far they are, in this order:
    as much as each is nearer than the fourth, so that none comes or goes with a step. Hands of fewer anchors have fewer
    columns, the last one counts for nothing then, and shares of 0 make up three."""
    nearer = np.maximum(distance_m[:, -1:] - distance_m, ANCHOR_NEARER_MIN_M)[:, :ANCHOR_NEIGHBORS]
    spare = ((0, 0), (0, ANCHOR_NEIGHBORS - nearer.shape[1]))
    return np.pad(nearest[:, :ANCHOR_NEIGHBORS], spare), np.pad(nearer / nearer.sum(1, keepdims=True), spare)


@dataclass(frozen=True)
class CastShadow(PerGaussian, Generic[Array]):
    """Shadows that the fingers cast on the hand, see `native/learned_cast.cpp`.

    lamp_rgb:    (K, 3) what each lamp around the hand sends, 0 and up
    bounced_rgb: (3,) what reaches skin that sees no lamp, 0 and up; only their ratios count
    anchors:     where it is computed
    flesh:       (20, 7) start, end and radius, meters, of a capsule for each bone in the canonical pose, which moves
                 with it, see `flesh_of`
    own:         (A, 20) 0..1 how much the flesh of each bone is the anchor's own, which casts nothing on it
    """

    PARTS = ("anchors",)

    lamp_rgb: Array
    bounced_rgb: Array
    anchors: Anchors[Array]
    flesh: Array
    own: Array


@dataclass(frozen=True)
class SkinResponse(PerGaussian, Generic[Array]):
    """How the skin of N Gaussians answers light. The avatar's colors are its albedo then, linear.

    spread:      (N,) of the softness at each Gaussian, 1 on average
    roughness:   (N,) of GGX, whose alpha is its square
    reflectance: (N,) at right angles
    softness:    (3,) half width of the rounded corner of a cosine, per channel
    bounce:      (3,) albedo with which skin throws light onto skin
    shade_gain:  of the pose's shade
    trained_on:  how many worlds, and lamps of each kind, it was learned from, by name; empty for a guess
    film_light:  (64, 3) radiance times solid angle of the cells of the world that a film was taken in, found with the
                 skin, for the axes of its camera, y up; None of a hand that has no light of its own
    """

    ROWS = ("spread", "roughness", "reflectance")

    spread: Array
    roughness: Array
    reflectance: Array
    softness: Array
    bounce: Array
    shade_gain: float
    trained_on: Mapping[str, int] = field(default_factory=dict)
    film_light: Array | None = None

    @cached_property
    def mirrors(self) -> bool:
        """Whether anything has gloss."""
        return bool((self.reflectance > 0).any())


@dataclass(frozen=True)
class Learned(PerGaussian):
    """What training adds to N Gaussians.

    normal:        (N, 3) float32 unit, canonical frame, outward
    shine:         (N,) float32, 0 and up, how much is reflected
    light:         of the capture
    correctives:   what the pose changes; None when nothing but the bones moves the skin
    shadow:        look of the self-shadow; None when it was trained without
    world_offsets: offsets of the correctives are in world axes, as the paper prints it, instead of turning
                   with the hand
    ellipsoid:     of Gaussians that are no spheres, else None
    cast:          shadows that its parts cast on each other; None when it was trained without
    distilled:     cheaper tiers of the correctives, and what they cost; None where nothing was measured
    response:      how the skin answers the light of a scene; then light and shine are none, and the cast shadow has a
                   lamp for each cell of a world. None where it was learned in one unknown light
    in_studio:     whether it learned in known light and carries that of a studio, see `relighting.in_studio`
    """

    ROWS, PARTS = ("normal", "shine"), ("correctives", "ellipsoid", "cast", "distilled", "response")

    normal: np.ndarray
    shine: np.ndarray
    light: Light
    correctives: Correctives | None
    shadow: ShadowLook | None
    world_offsets: bool = False
    ellipsoid: Ellipsoid | None = None
    cast: CastShadow | None = None
    distilled: Distilled | None = None
    response: SkinResponse | None = None
    in_studio: bool = False

    @property
    def reflects(self) -> bool:
        """Whether colors depend on where the camera stands."""
        return self.response is not None or (bool(self.shine.any()) and bool(self.light.lobe_rgb.any()))

    @property
    def fades(self) -> bool:
        """Whether what faces away from the camera fades out: a hand of known light learned with that."""
        return self.response is not None or self.in_studio

    def with_anchors(self, anchors: Anchors, canonical_joints_m: np.ndarray) -> Learned:
        """The same with the shadows that it casts found at others; as it is without any."""
        if self.cast is None:
            return self
        flesh, own = flesh_of(anchors.position_m, canonical_joints_m, fitted=is_learned(self.response))
        return replace(self, cast=replace(self.cast, anchors=anchors, flesh=flesh, own=own))

    def with_tier(self, wanted: Tier) -> tuple[Learned, Price | None]:
        """The same with the correctives of a tier, and its price where it has one. InputError for a tier without."""
        if not isinstance(self.correctives, PoseNetwork):
            return self, None
        price = choose(self.distilled, wanted)
        if price is None or price.tier is Tier.EXACT or self.distilled is None:
            return self, price
        return replace(self, correctives=self.distilled.linear), price


def capsules(joints_m: np.ndarray, hand_scale: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start (20, 3), end (20, 3) and radius (20,) of the bones' flesh. joints_m: (21, 3), level order."""
    radius_m = 1e-3 * np.array(CAPSULE_RADII_MM)
    return joints_m[list(PARENTS[1:])], joints_m[1:], radius_m * hand_scale


def is_learned(response: SkinResponse | None) -> bool:
    """Whether there is one, from pictures in known light or with the light of a film: not guessed."""
    return response is not None and (bool(response.trained_on) or response.film_light is not None)


def flesh_of(position_m: np.ndarray, canonical_joints_m: np.ndarray, *, fitted: bool) -> tuple[np.ndarray, np.ndarray]:
    """`CastShadow.flesh` and `own` of anchors at canonical places (A, 3): capsules that fit the skin of a hand
    whose response to light was learned; along the bones where a light, and what fingers take of it, was. A hand that is
    put into a studio, and one whose response is guessed, keeps what it has."""
    flesh = fitted_flesh(position_m, canonical_joints_m) if fitted else bone_flesh(canonical_joints_m)
    return flesh, own_flesh(position_m, flesh)


def bone_flesh(canonical_joints_m: np.ndarray) -> np.ndarray:
    """(20, 7) float32 start, end and radius, meters, of capsules along the bones of a canonical hand (21, 3)."""
    return np.column_stack(capsules(canonical_joints_m, 1.0)).astype(np.float32)


def fitted_flesh(position_m: np.ndarray, canonical_joints_m: np.ndarray) -> np.ndarray:
    """The same of capsules that fit points of its skin (A, 3), each by those that are nearest to it: flesh lies at the
    palm's side of bones, and people's fingers differ. Least squares of distances, by damped Gauss-Newton steps."""
    flesh = bone_flesh(canonical_joints_m).astype(np.float64)
    rest, wrist_m, points = flesh.copy(), canonical_joints_m[0], position_m.astype(np.float64)
    # skin behind the wrist is no finger's, and what is far from all bones is no skin
    points = points[:: -(-len(points) // FIT_POINTS)]
    points = points[np.abs(points - wrist_m).max(1) < AVATAR_REACH_M]
    points = points[(points - wrist_m) @ (flesh[MIDDLE_METACARPAL, 3:6] - wrist_m) > 0]
    points = points[(_from_axes(points, flesh)[2] - flesh[:, 6]).min(1) < FIT_REACH_M]
    for _ in range(FIT_ROUNDS):
        part, away, distance_m = _from_axes(points, flesh)
        nearest = (distance_m - flesh[:, 6]).argmin(1)
        for bone in range(len(flesh)):
            rows = nearest == bone
            s, out, error = part[rows, bone, None], away[rows, bone], distance_m[rows, bone] - flesh[bone, 6]
            slope = np.concatenate([(s - 1) * out, -s * out, -np.ones_like(s)], 1)
            stay = np.append(np.full(6, FIT_STAY * len(s)), 0) + FIT_STAY
            step = np.linalg.solve(slope.T @ slope + np.diag(stay), slope.T @ error + stay * (flesh[bone] - rest[bone]))
            flesh[bone] -= FIT_STEP * step
    flesh[:, 6] = np.maximum(flesh[:, 6], CAPSULE_RADIUS_MIN_M)
    return flesh.astype(np.float32)


def own_flesh(position_m: np.ndarray, flesh: np.ndarray) -> np.ndarray:
    """(A, 20) float32 how much each bone's flesh (20, 7) is an anchor's own: 1 on it, 0 well away from it, in the
    canonical pose. position_m: (A, 3) canonical."""
    distance_m, (near, far) = _from_axes(position_m.astype(np.float64), flesh)[2], OWN_FLESH_RADII
    t = np.clip((distance_m / flesh[:, 6] - near) / (far - near), 0, 1)
    return 1 - (t * t * (3 - 2 * t)).astype(np.float32)


def _from_axes(points_m: np.ndarray, flesh: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of points (A, 3) and the axes of capsules (20, 7): where on each the nearest place is, 0..1 (A, 20), the unit
    direction from there (A, 20, 3), 0 on the axis, and how far, meters (A, 20)."""
    start, along = flesh[:, :3].astype(np.float64), flesh[:, 3:6].astype(np.float64) - flesh[:, :3]
    to_point = points_m[:, None] - start
    part = np.clip((to_point * along).sum(-1) / np.maximum((along * along).sum(-1), CAPSULE_LENGTH2_MIN), 0, 1)
    away = to_point - part[..., None] * along
    distance_m = np.linalg.norm(away, axis=-1)
    return part, away / np.maximum(distance_m, AXIS_DISTANCE_MIN_M)[..., None], distance_m


def lamp_directions(count: int) -> np.ndarray:
    """(count, 3) float64 unit vectors towards the lamps of a cast shadow, count even: a Fibonacci lattice on the half
    sphere x > 0, then its mirror image, so that left hands are learned as well as right ones. InputError for an odd
    count."""
    if count % 2 or count < 2:
        raise InputError("lamps", wanted="an even number", came=str(count))
    index = np.arange(count // 2) + 0.5
    height = 1 - 2 * index / count
    radius, turn = np.sqrt(1 - height * height), np.pi * (1 + np.sqrt(5)) * index
    half = np.stack([height, radius * np.cos(turn), radius * np.sin(turn)], -1)
    return np.concatenate([half, half * [-1.0, 1.0, 1.0]])
