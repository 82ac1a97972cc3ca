"""A made-up hand in a file of exactly MANO's structure: a Python 2 pickle with chumpy and scipy objects in it.

The pickle is written operation by operation, since neither Python 2 nor chumpy is here, and what Python 2 writes
differs from what Python 3 writes. (Files written by the real chumpy 0.70 were read exactly, too.) The surface is a
mitten of 778 vertices and 1538 faces around all bones, open along 16 edges like MANO's, pulled out at the vertices that
serve as finger tips; its joints are those of the built-in hand.
"""

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.template.builtin import load_template
from jghand_engine.template.surface import boundary_loop

SEGMENTS, RINGS, INNER = 16, 48, 10
TIPS_MANOPTH = (745, 317, 444, 556, 673)
# the file's frame is not ours
FILE_FROM_CANONICAL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
FILE_ROOT = np.array([0.095, 0.006, 0.007])
FLEXION_RAD = 0.3


@dataclass(frozen=True)
class Thing:
    """An object of a class that is only named."""

    module: str
    name: str
    state: dict


def canonical_joints() -> np.ndarray:
    """(21, 3) the built-in hand's joints in MANO's order."""
    return from_level(load_template().joints_m, JointOrder.MANO16_TIPS)


def sock() -> tuple[np.ndarray, np.ndarray]:
    """(778, 3) vertices in the canonical frame and (1538, 3) outward faces."""
    angle = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    rings = [
        np.stack([0.075 * np.cos(angle), np.full(SEGMENTS, y), 0.012 * np.sin(angle)], axis=1)
        for y in np.linspace(0, 0.19, RINGS)
    ]
    rng = np.random.default_rng(0)
    top = np.array([0, 0.195, 0]) + rng.uniform(-0.004, 0.004, (INNER, 3))
    vertices = np.concatenate([*rings, top])
    faces = []
    for ring in range(RINGS - 1):
        for k in range(SEGMENTS):
            a, b = ring * SEGMENTS + k, ring * SEGMENTS + (k + 1) % SEGMENTS
            faces += [(a, a + SEGMENTS, b), (b, a + SEGMENTS, b + SEGMENTS)]
    last, center = (RINGS - 1) * SEGMENTS, RINGS * SEGMENTS
    fan = [(last + k, center, last + (k + 1) % SEGMENTS) for k in range(SEGMENTS)]
    for inner in range(center + 1, center + INNER):
        a, b, c = fan.pop(0)
        fan += [(a, b, inner), (b, c, inner), (c, a, inner)]
    return vertices, np.array(faces + fan)


def mano_fields(*, left: bool = False) -> dict[str, Any]:
    """The arrays of a MANO file by name, all as plain arrays; a left hand is the right one mirrored."""
    rng = np.random.default_rng(1)
    vertices, faces = sock()
    joints = canonical_joints()
    vertices[list(TIPS_MANOPTH)] = joints[16:]
    vertices[445] = vertices[444]  # the left hand's middle tip in the same package
    distance = np.linalg.norm(vertices[:, None] - joints[None, :16], axis=2)
    weights = np.exp(-((distance / 0.01) ** 2) + (distance.min(axis=1, keepdims=True) / 0.01) ** 2)
    weights /= weights.sum(axis=1, keepdims=True)
    for tip, joint in zip((*TIPS_MANOPTH, 445), (15, 3, 6, 12, 9, 6), strict=True):
        weights[tip] = np.eye(16)[joint]
    weights[boundary_loop(faces)] = np.eye(16)[0]
    regressor = np.zeros((16, len(vertices)))
    for joint in range(16):
        some = rng.choice(len(vertices), 40, replace=False)
        system = np.vstack([vertices[some].T, np.ones(40)])
        regressor[joint, some] = np.linalg.lstsq(system, np.append(joints[joint], 1), rcond=None)[0]
    mean = np.zeros((15, 3))
    mean[:12, 0] = FLEXION_RAD  # about +x: towards the palm
    mirror = np.array([-1.0, 1.0, 1.0]) if left else np.ones(3)
    return {
        "v_template": (vertices @ FILE_FROM_CANONICAL.T + FILE_ROOT) * mirror,
        "f": (faces[:, ::-1] if left else faces).astype(np.uint32),
        "weights": weights,
        "J_regressor": regressor,
        "kintree_table": np.array([[2**32 - 1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14], range(16)], np.int64),
        "shapedirs": rng.normal(size=(len(vertices), 3, 10)) * 1e-3,
        "posedirs": np.zeros((len(vertices), 3, 135)),
        "hands_mean": (mean @ FILE_FROM_CANONICAL.T * (mirror * np.prod(mirror))).ravel(),
        "hands_components": np.eye(45),
    }


def mano_objects(fields: dict[str, Any]) -> dict[str, Any]:
    """The dictionary as MANO has it: a sparse regressor, shapes as a chumpy selection, and entries nobody reads."""
    shapes = fields["shapedirs"]
    selection = {
        "a": Thing("chumpy.ch", "Ch", {"x": shapes, "_dirty_vars": [], "_itr": None}),
        "idxs": np.arange(shapes.size, dtype=np.int64),
        "preferred_shape": shapes.shape,
        "_dirty_vars": [],
    }
    return {
        **fields,
        "J_regressor": csc(fields["J_regressor"]),
        "shapedirs": Thing("chumpy.reordering", "Select", selection),
        "bs_style": "lbs",
        "bs_type": "lrotmin",
        "J": np.zeros((16, 3)),
        "hands_coeffs": np.zeros((3, 45)),
    }


def csc(dense: np.ndarray) -> Thing:
    column, row = np.nonzero(dense.T)
    start = np.concatenate([[0], np.cumsum((dense != 0).sum(axis=0))])
    state = {
        "_shape": dense.shape,
        "data": dense[row, column],
        "indices": row.astype(np.int32),
        "indptr": start.astype(np.int32),
        "maxprint": 50,
    }
    return Thing("scipy.sparse.csc", "csc_matrix", state)


def python2_pickle(value: Any, protocol: int = 2) -> bytes:
    """`value` as Python 2 would have pickled it with protocol 0 or 2."""
    return (b"\x80\x02" if protocol else b"") + _Writer(protocol).bytes_of(value) + b"."


class _Writer:
    def __init__(self, protocol: int) -> None:
        self.binary, self.memo = protocol > 0, {}

    def bytes_of(self, value: Any) -> bytes:
        if value is None:
            return b"N"
        if isinstance(value, bool):
            return (b"\x88" if value else b"\x89") if self.binary else b"I%02d\n" % value
        if isinstance(value, int):
            return b"J" + struct.pack("<i", value) if self.binary else b"I%d\n" % value
        if isinstance(value, str):
            return self.text(value.encode("latin-1"))
        if isinstance(value, bytes):
            return self.text(value)
        if isinstance(value, tuple):
            return b"(" + b"".join(map(self.bytes_of, value)) + b"t"
        if isinstance(value, list):
            return (b"]" if self.binary else b"(l") + b"".join(self.bytes_of(item) + b"a" for item in value)
        if isinstance(value, dict):
            items = b"".join(self.bytes_of(key) + self.bytes_of(item) + b"s" for key, item in value.items())
            return (b"}" if self.binary else b"(d") + items
        if isinstance(value, np.ndarray):
            return self.array(value)
        if isinstance(value, Thing):
            return self.thing(value)
        raise TypeError(type(value))

    def text(self, raw: bytes) -> bytes:
        if not self.binary:
            return b"S" + repr(raw)[1:].encode("ascii") + b"\n"
        return (b"U" + bytes([len(raw)]) if len(raw) < 256 else b"T" + struct.pack("<i", len(raw))) + raw

    def array(self, array: np.ndarray) -> bytes:
        start = (
            b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n"
            + self.bytes_of((0,))
            + self.bytes_of("b")
            + b"tR"
        )
        shape = self.bytes_of(tuple(array.shape))
        state = b"(" + self.bytes_of(1) + shape + self.dtype(array.dtype) + b"I00\n" + self.text(array.tobytes()) + b"t"
        return start + state + b"b"

    def dtype(self, dtype: np.dtype) -> bytes:
        """A type of numbers is written once and mentioned after that, like everything in a real pickle."""
        kind = dtype.str[1:]
        if kind in self.memo:
            return (b"h%c" if self.binary else b"g%d\n") % self.memo[kind]
        number = self.memo.setdefault(kind, len(self.memo))
        made = b"cnumpy\ndtype\n" + self.bytes_of((kind, 0, 1)) + b"R"
        state = self.bytes_of((3, "<", None, None, None, -1, -1, 0)) + b"b"
        return made + (b"q%c" if self.binary else b"p%d\n") % number + state

    def thing(self, thing: Thing) -> bytes:
        name = f"c{thing.module}\n{thing.name}\n".encode()
        old_style = b"ccopy_reg\n_reconstructor\n(" + name + b"c__builtin__\nobject\nNtR"
        return (name + b")\x81" if self.binary else old_style) + self.bytes_of(thing.state) + b"b"
