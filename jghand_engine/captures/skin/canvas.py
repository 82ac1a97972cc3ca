"""What a person's skin is painted on: the texels of a hand as points in space, the directions of its bones, and the
layers that marks are added to.

Lengths are millimeters, in the canonical frame: wrist at the origin, +y to the middle MCP, +x to the index side, +z out
of the palm. Joints are in level order; bone i ends at joint i. A finger f of thumb..pinky has the bones 6 + f, 11 + f
and 16 + f (of the thumb the first is its metacarpal).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from PIL import Image
from scipy import sparse

from jghand_engine.captures.making.rig import FIRST_JOINTS, Identity
from jghand_engine.captures.skin.noise import cells, fractal_noise, noise, smoothstep
from jghand_engine.captures.skin.person import Person
from jghand_engine.hand.joints import PARENTS
from jghand_engine.hand.rotations import unit
from jghand_engine.template.builtin import ASSETS
from jghand_engine.template.subdivision import Subdivision
from jghand_engine.template.surface import directed_edges, vertex_normals
from jghand_engine.template.texture import rasterize_uv, sample_bilinear

MM = 1e-3
# how often the template is subdivided for the places of texels: on coarser faces their edges show in every mask
TEXEL_LEVELS = 2
# means over neighbors a millimeter away that spread a normal by 3 mm
AROUND_ROUNDS = 10
# the mean middle phalanx for which the lengths of marks are given, mm, and how far sizes of hands go from it
USUAL_PHALANX_MM, SIZES = 24.5, (0.70, 1.25)
PINKY_SIZE = 0.88
OUT_OF_PALM = np.array([0.0, 0.0, 1.0])
# share of the direction away from a finger's own nail in where its bones flex, from the first bone to the last; the
# rest is that of the palm
NAIL_SHARES, THUMB_NAIL_SHARES = (0.3, 0.6, 1.0), (0.9, 1.0, 1.0)
# skin of the forearm, over these millimeters behind the wrist: no palm, but skin of the back all around, on its palm
# side less so
FOREARM_FROM_TO, FOREARM_SIDE, FOREARM_SIDES = (-7.0, -22.0), -0.55, 0.4
# sharpness of furrows: between the cusp of exp(-x) and a Gauss curve
FURROW_EXPONENT = 1.35
# ages of a child, of the usual person and of an old one
AGES = (0.0, Person.age, 1.0)
# age from which skin has nothing of a child's any more, and that from which it has something of an old person's
GROWN, AGING = 0.2, 0.5
# the part of a grown person's lines that a child has, and over which part of them they become fainter
OF_A_CHILD, FAINTER = 0.35, 0.5
# narrower marks are widened to this part of a texel and made as much weaker: thinner ones would break up into dots
NARROWEST_TEXELS = 0.6


@dataclass(frozen=True)
class Frame:
    """The axis of a finger at a place, the direction to which it flexes, and axis x palmar; a point of it, mm."""

    place: np.ndarray
    axis: np.ndarray
    palmar: np.ndarray

    @property
    def lateral(self) -> np.ndarray:
        return np.cross(self.axis, self.palmar)

    def of(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (N, 3) -> (N,) along the axis, (N,) across, (N,) to the palm."""
        relative = points - self.place.astype(np.float32)
        along, across, palmar = (d.astype(np.float32) for d in (self.axis, self.lateral, self.palmar))
        return relative @ along, relative @ across, relative @ palmar


@dataclass(frozen=True)
class Texels:
    """The texels of the island that show skin.

    covered: (S, S) bool, row = 1 - v; of its N true ones, row by row:
    point:   (N, 3) mm
    normal:  (N, 3) unit
    around:  (N, 3) mean normal of some 3 mm around, shorter than 1 where the skin is round
    shares:  (N, 5, 3) skin weights of the fingers' bones
    nail:    (N,) 0..1 of the template's nail mask
    texel_mm: edge of a texel on the skin
    """

    covered: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    around: np.ndarray
    shares: np.ndarray
    nail: np.ndarray
    texel_mm: float

    @classmethod
    def of(cls, identity: Identity, size: int) -> Texels:
        fine = Subdivision.of(identity.faces, identity.face_uv, TEXEL_LEVELS)
        vertices = fine.matrix @ (identity.vertices_m / MM)
        weights = fine.matrix @ identity.weights25
        # a tip carries no bone: its weight is that of the one that ends there
        shares = np.stack([weights[:, first : first + 3] for first in FIRST_JOINTS], 1)
        shares[:, :, 2] += weights[:, [first + 3 for first in FIRST_JOINTS]]
        skin = identity.skin_face_count
        corners = np.broadcast_to(np.eye(3), (skin, 3, 3))
        numbers = np.broadcast_to(np.arange(skin)[:, None, None], (skin, 3, 1))
        laid, covered = rasterize_uv(identity.face_uv[:skin], np.concatenate([corners, numbers], -1), size)
        inside = laid[covered]
        face, share = fine.places(np.rint(inside[:, 3]).astype(np.int64), inside[:, :3])
        at, share = fine.faces[face], share.astype(np.float32)

        def looked_up(values: np.ndarray) -> np.ndarray:
            values = values.astype(np.float32)
            return np.einsum("nk,nkc->nc", share, values[at])

        row, column = np.nonzero(covered)
        uv = np.stack([(column + 0.5) / size, 1 - (row + 0.5) / size], axis=1)
        with (ASSETS / "nails.png").open("rb") as stream, Image.open(stream) as image:
            nails = np.asarray(image.convert("L"), dtype=np.float32)[..., None] / 255
        a, b, c = (vertices[fine.faces[:, k]] for k in range(3))
        on_skin = np.cross(b - a, c - a)[: skin * 4**TEXEL_LEVELS]
        in_uv = np.linalg.det(identity.face_uv[:skin, 1:] - identity.face_uv[:skin, :1])
        texel_mm = float(np.sqrt(np.linalg.norm(on_skin, axis=1).sum() / np.abs(in_uv).sum()) / size)
        normals = around = vertex_normals(vertices, fine.faces)
        beside = sparse.coo_array((np.ones(3 * len(fine.faces)), directed_edges(fine.faces).T)).tocsr()
        beside /= beside.sum(1)[:, None]
        for _ in range(AROUND_ROUNDS):
            around = beside @ around
        return cls(
            covered, looked_up(vertices), unit(looked_up(normals)), looked_up(around),
            looked_up(shares.reshape(-1, 15)).reshape(-1, 5, 3), sample_bilinear(nails, uv)[:, 0].astype(np.float32),
            texel_mm,
        )  # fmt: skip


@dataclass
class Canvas:
    """One person's skin while it is painted.

    joints:  (21, 3) mm
    axis, palmar, length: (21, 3), (21, 3), (21,) of each bone
    size:    of the hand, for which lengths of marks are scaled
    hand_side: (N,) -1 back to 1 palm, as if the forearm went on like the hand
    side_around: (N,) the same of the mean normal around
    wobble:  (N,) mm by which lines depart from their way
    heights: (N,) mm of each layer: `static` is always there, `straight` while the joint nearby is straight, `bent`
             while it is bent, `fold` always, and half as much again when bent
    amounts: (N,) 0..1 of each mark that has a color
    nail_xy: (N, 2) the coordinates of nails, see nails.py; 0 elsewhere
    """

    texels: Texels
    person: Person
    joints: np.ndarray
    axis: np.ndarray
    palmar: np.ndarray
    length: np.ndarray
    size: float
    hand_side: np.ndarray
    side_around: np.ndarray
    wobble: np.ndarray = field(init=False)
    heights: dict[str, np.ndarray] = field(init=False)
    amounts: dict[str, np.ndarray] = field(init=False)
    nail_xy: np.ndarray = field(init=False)

    HEIGHTS = ("static", "straight", "bent", "fold")
    AMOUNTS = (
        *("crease", "wrinkle", "vein", "knuckle", "pulp", "network", "pore", "crack", "ridge"),
        *("plate", "free_edge", "moon", "nail_fold"),
    )

    def __post_init__(self) -> None:
        count = len(self.texels.point)
        self.heights = {name: np.zeros(count, np.float32) for name in self.HEIGHTS}
        self.amounts = {name: np.zeros(count, np.float32) for name in self.AMOUNTS}
        self.nail_xy = np.zeros((count, 2), np.float32)
        self.wobble = 0.35 * self.fractal_noise("wobble", 6.0, octaves=2)

    @classmethod
    def of(cls, identity: Identity, size: int, person: Person) -> Canvas:
        texels = Texels.of(identity, size)
        joints = identity.joints_m / MM
        bones = np.array([joints[3], *(joints[i] - joints[PARENTS[i]] for i in range(1, 21))])
        axis, length = unit(bones), np.linalg.norm(bones, axis=1)
        palmar = np.tile(OUT_OF_PALM, (21, 1))
        for finger in range(5):
            on = (texels.nail > 0.6) & (texels.shares[:, finger, 2] > 0.3)
            away = -texels.normal[on].mean(0)
            for bone, share in enumerate(NAIL_SHARES if finger else THUMB_NAIL_SHARES):
                palmar[6 + 5 * bone + finger] = unit(share * away + (1 - share) * OUT_OF_PALM)
        palmar = unit(palmar - (palmar * axis).sum(1, keepdims=True) * axis)
        shares = texels.shares
        towards = (1 - shares.sum((1, 2)))[:, None] * OUT_OF_PALM
        towards = towards + np.einsum("nfb,bfc->nc", shares, palmar[6:].reshape(3, 5, 3))
        sides = ((each * unit(towards)).sum(1).astype(np.float32) for each in (texels.normal, texels.around))
        scale = float(np.clip(length[[12, 13, 14]].mean() / USUAL_PHALANX_MM, *SIZES))
        return cls(texels, person, joints, axis, palmar, length, scale, *sides)

    # ---- where ---------------------------------------------------------------------------------------------------

    @property
    def deep(self) -> float:
        """How deep lines are at this age."""
        return self.by_age(0.65, 0.925, 1.69)

    def by_age(self, child: float, usual: float, old: float) -> float:
        """What has these values at AGES."""
        return float(np.interp(self.person.age, AGES, (child, usual, old)))

    @property
    def aged(self) -> float:
        """0..1 how far skin is thin and loose, and flesh has gone."""
        return float(np.interp(self.person.age, (AGING, 1.0), (0.0, 1.0)))

    def present(self, rank: float) -> float:
        """0..1 how deep a line is at this age, beside a grown person's; rank: 0 the first of its kind that a child
        has, 1 the last that comes with the years."""
        have = np.interp(self.person.age, (0.0, GROWN), (OF_A_CHILD, 1 + FAINTER))
        return float(np.clip((have - rank) / FAINTER, 0, 1))

    @cached_property
    def side(self) -> np.ndarray:
        """(N,) -1 back to 1 palm."""
        return self.side_until(*FOREARM_FROM_TO)

    def side_until(self, begin_mm: float, end_mm: float, moved_mm: np.ndarray | float = 0.0) -> np.ndarray:
        """(N,) -1 back to 1 palm, the forearm's own beyond these places along the arm, the wrist at 0; moved_mm: how
        far each point is taken to be from where it is."""
        place_mm = self.texels.point[:, 1] / self.size + moved_mm
        share = smoothstep(begin_mm, end_mm, place_mm)
        return self.hand_side + share * (FOREARM_SIDE + FOREARM_SIDES * self.hand_side - self.hand_side)

    @cached_property
    def back(self) -> np.ndarray:
        return smoothstep(0.05, 0.55, -self.side)

    @cached_property
    def palm(self) -> np.ndarray:
        return smoothstep(-0.15, 0.35, self.side)

    @property
    def skin(self) -> np.ndarray:
        """What is no nail."""
        return 1 - self.amounts["plate"]

    @cached_property
    def fingers(self) -> np.ndarray:
        """(N, 5) shares of the fingers."""
        return self.texels.shares.sum(2)

    def finger_size(self, finger: int) -> float:
        return self.size * (PINKY_SIZE if finger == 4 else 1.0)

    def bone(self, bone: int, part: float = 1.0) -> Frame:
        """A bone at a part of its length."""
        place = self.joints[bone] - (1 - part) * self.length[bone] * self.axis[bone]
        return Frame(place, self.axis[bone], self.palmar[bone])

    def hinge(self, joint: int) -> Frame:
        """A joint 1..15, between its two bones."""
        axis, palmar = (unit(d[joint] + d[joint + 5]) for d in (self.axis, self.palmar))
        return Frame(self.joints[joint], axis, unit(palmar - (palmar @ axis) * axis))

    def knuckle(self, finger: int) -> Frame:
        """The MCP joint of a finger but the thumb, in the directions of its first bone."""
        return Frame(self.joints[1 + finger], self.axis[6 + finger], self.palmar[6 + finger])

    def distance_on_palm(self, center: np.ndarray) -> np.ndarray:
        """mm from a point, in the plane of the palm."""
        x, y = (self.texels.point[:, k] - np.float32(center[k]) for k in (0, 1))
        return np.hypot(x, y)

    # ---- chance --------------------------------------------------------------------------------------------------

    def seed(self, name: str) -> tuple[int, int]:
        """Of each field of chance its own, by its name: a new one changes no other."""
        return self.person.seed, zlib.crc32(name.encode())

    def random(self, name: str) -> np.random.Generator:
        return np.random.default_rng(self.seed(name))

    def noise(self, name: str, cell_mm: float, on: slice | np.ndarray = slice(None)) -> np.ndarray:
        return noise(self.texels.point[on], cell_mm, self.seed(name))

    def fractal_noise(self, name: str, cell_mm: float, octaves: int = 3) -> np.ndarray:
        return fractal_noise(self.texels.point, cell_mm, self.seed(name), octaves)

    def shifted(self, name: str, cell_mm: float, by_mm: float) -> np.ndarray:
        """(N, 3) the points, each moved by noise."""
        moves = [self.noise(f"{name}{axis}", cell_mm) for axis in "xyz"]
        return self.texels.point + by_mm * np.stack(moves, 1)

    def cells(self, name: str, cell_mm: float, points: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
        """See noise.cells; mm."""
        return cells(self.texels.point if points is None else points, cell_mm, self.seed(name))

    # ---- marks ---------------------------------------------------------------------------------------------------

    def furrow(self, x: np.ndarray, half_width: float | np.ndarray) -> np.ndarray:
        """The profile of a line, 0..1, at the distance `x` from its middle; mm."""
        wide = np.maximum(half_width, NARROWEST_TEXELS * self.texels.texel_mm)
        return half_width / wide * np.exp(-((np.abs(x) / wide) ** FURROW_EXPONENT))

    def raise_by(self, layer: str, height: np.ndarray, on: slice | np.ndarray = slice(None)) -> None:
        self.heights[layer][on] += height

    def mark(self, name: str, amount: np.ndarray, on: slice | np.ndarray = slice(None)) -> None:
        self.amounts[name][on] = np.maximum(self.amounts[name][on], amount)

    def each_finger(self, share: float) -> Iterator[tuple[int, np.ndarray]]:
        """Each finger with its texels."""
        fingers = self.fingers
        for finger in range(5):
            yield finger, np.nonzero(fingers[:, finger] > share)[0]
