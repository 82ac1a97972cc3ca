"""Hair on the back of the hand and of the first phalanges: strands that lie on the skin, as curves or as painted lines.

Lengths are millimeters, in the canonical frame of canvas.py. Places depend on the identity, the seed and how much hair
there is, not on the number of texels; less of it is a part of the same strands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from jghand_engine.captures.making.rig import Identity
from jghand_engine.captures.skin.canvas import MM, NARROWEST_TEXELS, TEXEL_LEVELS, Canvas
from jghand_engine.captures.skin.noise import gauss, smoothstep
from jghand_engine.captures.skin.person import MELANIN_ABSORBS, Person
from jghand_engine.hand.rotations import unit
from jghand_engine.template.closest import Surface
from jghand_engine.template.subdivision import Subdivision
from jghand_engine.template.surface import face_normals

# roots on a square millimeter where hair is densest, of a hand of usual size: with it 300 to 450 strands before the
# wrist, on any identity
PER_MM2 = 0.075
# edge of the map of where hair grows: texels of 0.7 mm
WHERE_PX = 512
# points of a strand: turns of a few degrees from one to the next
POINTS = 8
# lengths, and radii at each point: strands taper to their tips
LENGTH_MM, RADIUS_MM = (4.0, 9.0), 0.040 - 0.030 * np.linspace(0, 1, POINTS) ** 2
# how steeply strands leave the skin, degrees, and what is left of that at the tip
STEEP_DEG, STEEP_LEFT = (20.0, 30.0), 0.1
# heading: this much of ulnar on one of distal; spread of the heading and of how much it turns to the tip, degrees
ULNAR, HEADING_DEG, TURN_DEG = 0.8, 14.0, 25.0
# side below which skin is of the back enough to bear hair, and bears all
BACK = (-0.40, -0.90)
# the radial side bears this part of what the ulnar one does; where it begins to, mm from the middle
RADIAL, RADIAL_FROM_TO_MM = 0.30, (-14.0, 22.0)
# parts of each phalanx's hair, from the first, of a finger and of the thumb, whose first bone is a metacarpal
PHALANGES, THUMB_PHALANGES = (0.8, 0.12, 0.0), (1.0, 0.4, 0.0)
# wrinkles of joints have none: half the width of the bare band along the finger, and of a knuckle, mm
BARE_JOINT_MM, BARE_KNUCKLE_MM = 6.0, 5.0
# melanin of hair, the person's own beside it, and what carotene's warmth stands for in pale persons, who are fair; they
# are pale below these tones
HAIR_MELANIN, FAIR, FAIR_TONES = 1.2, 0.7, (0.45, 0.05)
# what the surface of the darkest hair sends back
CUTICLE = 0.006
# apart, along painted strands, of the points that texels are compared with, mm: less than half a texel
PAINTED_STEP_MM = 0.05
# texels farther from a strand than this many half widths of it show none of it
PAINTED_REACH = 3.0


@dataclass(frozen=True)
class Hair:
    """S strands, POINTS points each, from root to tip.

    place_mm: (S, POINTS, 3) on the smooth skin of the identity
    rise_mm:  (S, POINTS) of the strand above its place
    rgb:      (3,) linear reflectance
    """

    place_mm: np.ndarray
    rise_mm: np.ndarray
    rgb: np.ndarray

    @classmethod
    def of(cls, identity: Identity, person: Person) -> Hair:
        """The same to the bit for the same person on the same identity."""
        canvas = Canvas.of(identity, WHERE_PX, person)
        fine = Subdivision.of(identity.faces, identity.face_uv, TEXEL_LEVELS)
        skin = fine.faces[: identity.skin_face_count * 4**TEXEL_LEVELS]
        vertices_m, rng = fine.matrix @ identity.vertices_m, canvas.random("hair")
        ground, normals = Surface(vertices_m, skin), face_normals(vertices_m, skin)
        a, b, c = ground.corners_m.transpose(1, 0, 2) / MM
        areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        count = int(PER_MM2 * areas.sum() / canvas.size**2)
        face = rng.choice(len(skin), count, p=areas / areas.sum())
        across, along, chance, long, steep = rng.random((5, count))
        to, turn = np.radians(rng.normal(size=(2, count)) * [[HEADING_DEG], [TURN_DEG]])
        across = np.sqrt(across)
        shares = np.stack([1 - across, across * (1 - along), across * along], 1)
        root = np.einsum("nk,nkc->nc", shares, ground.corners_m[face]) / MM
        texel = np.asarray(KDTree(canvas.texels.point).query(root)[1])
        grows = chance < person.hair * _density(canvas)[texel]
        step = (LENGTH_MM[0] + long[grows] * np.ptp(LENGTH_MM)) / (POINTS - 1)
        heading = _turned(_along(canvas)[texel[grows]], normals[face[grows]], to[grows])
        place = [root[grows]]
        for _ in range(POINTS - 1):
            near = ground.closest(MM * (place[-1] + step[:, None] * heading))
            place.append(near.point_m / MM)
            heading = _turned(heading, normals[near.face], turn[grows] / (POINTS - 1))
        steep = np.radians(STEEP_DEG[0] + steep[grows] * np.ptp(STEEP_DEG))
        rise = np.cumsum(step[:, None] * np.tan(steep[:, None] * np.linspace(1, STEEP_LEFT, POINTS - 1)), 1)
        return cls(np.stack(place, 1), np.column_stack([np.zeros(len(rise)), rise]), hair_rgb(person))

    def attached(self, vertices_m: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """The smooth skin as a mesh -> (S, POINTS, 5) float32: face, shares of its second and third corner, height
        above it and radius, meters."""
        near = Surface(vertices_m, faces).closest(MM * self.place_mm.reshape(-1, 3))
        radius = np.tile(RADIUS_MM, len(self.place_mm))
        columns = [near.face, *near.barycentric.T[1:], MM * self.rise_mm.reshape(-1), MM * radius]
        return np.column_stack(columns).reshape(-1, POINTS, 5).astype(np.float32)

    def painted(self, canvas: Canvas, rgb: np.ndarray) -> np.ndarray:
        """The colors (N, 3) of a canvas's texels with the strands as flat lines."""
        steps = np.linspace(0, POINTS - 1, int(max(LENGTH_MM) / PAINTED_STEP_MM))
        low = np.minimum(steps.astype(int), POINTS - 2)
        part = (steps - low)[:, None]
        lines = (self.place_mm[:, low] * (1 - part) + self.place_mm[:, low + 1] * part).reshape(-1, 3)
        if not len(lines):
            return rgb
        radius = np.tile(np.interp(steps, np.arange(POINTS), RADIUS_MM), len(self.place_mm))
        reach_mm = PAINTED_REACH * max(RADIUS_MM.max(), NARROWEST_TEXELS * canvas.texels.texel_mm)
        near = KDTree(lines).query(canvas.texels.point, distance_upper_bound=reach_mm)
        distance, number = map(np.asarray, near)
        on = np.isfinite(distance)
        amount = np.zeros((len(rgb), 1), np.float32)
        amount[on, 0] = canvas.furrow(distance[on], radius[number[on]])
        return rgb + amount * (self.rgb.astype(np.float32) - rgb)


def hair_rgb(person: Person) -> np.ndarray:
    """(3,) linear reflectance: black and dark brown, and fair where the skin is pale and warm."""
    fair = FAIR * person.warmth * smoothstep(*FAIR_TONES, person.melanin)
    return CUTICLE + np.exp(-(HAIR_MELANIN + person.melanin - fair) * MELANIN_ABSORBS)


def _density(canvas: Canvas) -> np.ndarray:
    """(N,) of each texel, the part of PER_MM2 that grows there."""
    size, x_mm = canvas.size, canvas.texels.point[:, 0] / canvas.size
    of_bones = np.array([THUMB_PHALANGES, *[PHALANGES] * 4])
    shares = canvas.texels.shares
    density = 1 - shares.sum((1, 2)) + np.einsum("nfb,fb->n", shares, of_bones)
    ulnar = 1 - (1 - RADIAL) * smoothstep(*RADIAL_FROM_TO_MM, x_mm)
    density *= smoothstep(*BACK, canvas.side) * ulnar
    for finger in range(5):
        near = canvas.fingers[:, finger]
        for joint in (6 + finger, 11 + finger):
            along, _, _ = canvas.hinge(joint).of(canvas.texels.point)
            density *= 1 - near * gauss(along, BARE_JOINT_MM * size)
        if finger:
            along, across, _ = canvas.knuckle(finger).of(canvas.texels.point)
            density *= 1 - canvas.back * gauss(np.hypot(along, across), BARE_KNUCKLE_MM * size)
    return density


def _along(canvas: Canvas) -> np.ndarray:
    """(N, 3) to where hair points at each texel: distal along its bones, and ulnar."""
    shares = canvas.texels.shares
    axis = np.einsum("nfb,fbc->nc", shares, canvas.axis[6:].reshape(3, 5, 3).transpose(1, 0, 2))
    distal = axis + (1 - shares.sum((1, 2)))[:, None] * canvas.axis[3]
    return unit(distal) - [ULNAR, 0, 0]


def _turned(heading: np.ndarray, normal: np.ndarray, by_rad: np.ndarray) -> np.ndarray:
    """(S, 3) unit, along the skin, turned about its normal."""
    flat = unit(heading - (heading * normal).sum(1, keepdims=True) * normal)
    return np.cos(by_rad)[:, None] * flat + np.sin(by_rad)[:, None] * np.cross(normal, flat)
