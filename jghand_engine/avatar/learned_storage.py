"""How what training adds to an avatar lies in a file: arrays, and the JSON that says their shapes.

| array            | exact        | compact                  | price of compact, at most                              |
| ---------------- | ------------ | ------------------------ | ------------------------------------------------------ |
| normal           | float32 x 3  | octahedral, uint16 x 2   | 0.004 degrees                                          |
| shine            | float32      | float16                  | 0.05 %                                                 |
| light.*          | float32      | float32                  | nothing                                                |
| pose_net.*       | float32      | float16                  | 0.05 % of every weight                                 |
| ellipsoid.*      | float32      | float16                  | 0.05 %                                                 |
| cast.*_rgb       | float32      | float32                  | nothing                                                |
| cast.position_m  | float32 x 3  | float32 x 3              | nothing                                                |
| cast.normal      | float32 x 3  | octahedral, uint16 x 2   | 0.004 degrees                                          |
| cast.bone_weights| float32 x 21 | float16 x 21             | 0.05 % of every weight                                 |
| cast.nearest     | uint16 x 3   | uint16 x 3               | nothing                                                |
| cast.share       | uint8 x 3    | uint8 x 3                | nothing: they are learned with in eight bits            |
| linear.*         | as it is used: int8 directions with a scale, constants as float16; nothing lost by writing    |

The network reads where a Gaussian sits, and its bones; both stand in the file already. What the cheaper tiers cost
stands under `baked`, the name of files of 0.1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from jghand_engine import limits
from jghand_engine.avatar.correctives import LinearCorrectives, PoseNetShape, PoseNetwork, largest_basis
from jghand_engine.avatar.learned import (
    ANCHOR_NEIGHBORS,
    SH_COUNT,
    SHARE_UNITS,
    Anchors,
    CastShadow,
    Ellipsoid,
    Learned,
    Light,
    ShadowLook,
    own_flesh,
)
from jghand_engine.avatar.storage import UINT16_MAX, Storage
from jghand_engine.avatar.texts import is_text
from jghand_engine.avatar.tiers import Distilled, Price, Tier
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT

NORMAL, PACKED_NORMAL, SHINE = "normal", "normal_octahedral", "shine"
LIGHT, NET, ELLIPSOID, CAST, LINEAR = "light.", "pose_net.", "ellipsoid.", "cast.", "linear."

# no figure of a tier is larger
PRICE_MAX = 1e9
# prices in a file: of the exact tier, the linear one, and `cached` in files of 0.1
PRICES_MAX = 3
# name, what was wanted, what came -> the error that names the file
Wrong = Callable[[str, str, object], InputError]


@dataclass(frozen=True)
class DistilledAbout:
    """What the JSON says of tiers: size of the linear one's basis, 0 for none · the rest as in Distilled."""

    basis: int
    prices: tuple[Price, ...]
    measured_on: str

    @classmethod
    def of(cls, distilled: Distilled) -> DistilledAbout:
        return cls(0 if distilled.linear is None else distilled.linear.basis, distilled.prices, distilled.measured_on)

    @classmethod
    def parsed(cls, value: object, net: PoseNetShape | None, wrong: Wrong) -> DistilledAbout:
        """Every field looked at. A linear tier has a price, and a price of it is of the tier that there is."""
        if not isinstance(value, dict) or net is None:
            raise wrong("learned baked", "an object, beside a network", value)
        basis, prices, measured_on = value.get("basis"), value.get("prices"), value.get("measured_on")
        if not isinstance(basis, int) or not _is_count(basis, min(limits.BASIS_MAX, largest_basis(net))):
            raise wrong("learned baked basis", f"a count of 0 to {limits.BASIS_MAX}, as the features give", basis)
        if not (isinstance(measured_on, str) and is_text(measured_on)):
            raise wrong("learned baked measured_on", "a text of one line", measured_on)
        if not isinstance(prices, list) or len(prices) > PRICES_MAX:
            raise wrong("learned baked prices", "a list of tiers", prices)
        # files of 0.1 have the price of a tier `cached`, which the compiled skin's exact tier is
        kept = [price for price in prices if not (isinstance(price, dict) and price.get("tier") == "cached")]
        parsed = tuple(_parsed_price(price, basis, wrong) for price in kept)
        if len({price.tier for price in parsed}) != len(parsed):
            raise wrong("learned baked prices", "one of each tier", prices)
        return cls(basis, parsed, measured_on)


def _parsed_price(value: object, basis: int, wrong: Wrong) -> Price:
    names = [f.name for f in fields(Price)]
    if not isinstance(value, dict) or set(value) != set(names):
        raise wrong("learned baked price", f"an object of {', '.join(names)}", value)
    if value["tier"] not in (Tier.EXACT, Tier.LINEAR):
        raise wrong("learned baked price tier", "exact or linear", value["tier"])
    tier = Tier(value["tier"])
    wanted = basis if tier is Tier.LINEAR else 0
    unusable = tier is Tier.LINEAR and basis == 0
    if unusable or value["basis"] != wanted or not _is_count(value["basis"], wanted):
        raise wrong("learned baked price basis", f"that of the tier in the file, {basis}", value["basis"])
    # an accuracy may be below 0 dB, and a tier nearer to the pictures than the network; time and size are never below 0
    for name, least in (("frame_ms", 0.0), ("megabytes", 0.0), ("psnr_db", -PRICE_MAX), ("lost_db", -PRICE_MAX)):
        if not _is_number(value[name], least, PRICE_MAX):
            raise wrong(f"learned baked price {name}", f"a number of {least:g} to {PRICE_MAX:g}", value[name])
    return Price(**{**value, "tier": tier})


@dataclass(frozen=True)
class CastAbout:
    """What the JSON says of the cast shadow: its lamps and its anchors, at least one of each."""

    lamps: int
    anchors: int

    @classmethod
    def parsed(cls, value: object, wrong: Wrong) -> CastAbout:
        """Every field looked at."""
        lamps, anchors = (value.get("lamps"), value.get("anchors")) if isinstance(value, dict) else (None, None)
        if not (isinstance(lamps, int) and _is_count(lamps, limits.CAST_LAMPS_MAX) and lamps > 0 and lamps % 2 == 0):
            raise wrong("learned cast lamps", f"an even count of 2 to {limits.CAST_LAMPS_MAX}", lamps)
        if not (isinstance(anchors, int) and _is_count(anchors, UINT16_MAX) and anchors > 0):
            raise wrong("learned cast anchors", f"a count of 1 to {UINT16_MAX}", anchors)
        if lamps * anchors > limits.CAST_PAIRS_MAX:
            raise wrong("learned cast", f"lamps times anchors of at most {limits.CAST_PAIRS_MAX:,}", value)
        return cls(lamps, anchors)


@dataclass(frozen=True)
class LearnedAbout:
    """What the JSON says: lobes of the light's gloss · shape of the network, None for none · whether the Gaussians are
    ellipsoids · the cast shadow, None where there is none · what it says of cheaper tiers, None where nothing was
    measured · the rest as in Learned."""

    lobes: int
    net: PoseNetShape | None
    shadow: ShadowLook | None
    world_offsets: bool
    ellipsoids: bool
    cast: CastAbout | None
    baked: DistilledAbout | None

    @classmethod
    def of(cls, learned: Learned) -> LearnedAbout:
        """InputError for correctives that are no network: only their exact form is written."""
        net = learned.correctives
        if net is not None and not isinstance(net, PoseNetwork):
            raise InputError("correctives of an avatar", wanted="the exact network", came=type(net).__name__)
        lobes = learned.light.lobe_direction.shape[0]
        shape = None if net is None else net.shape
        distilled = learned.distilled
        baked = None if distilled is None or net is None else DistilledAbout.of(distilled)
        cast = None if learned.cast is None else CastAbout(len(learned.cast.lamp_rgb), len(learned.cast.anchors))
        return cls(lobes, shape, learned.shadow, learned.world_offsets, learned.ellipsoid is not None, cast, baked)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    @classmethod
    def parsed(cls, value: object, gaussians: int, wrong: Wrong) -> LearnedAbout:
        """The inverse of `as_dict`, every field looked at. gaussians: how many the file has."""
        if not isinstance(value, dict):
            raise wrong("learnt", "an object", value)
        lobes = value.get("lobes")
        if not isinstance(lobes, int) or not _is_count(lobes, limits.LIGHT_LOBES_MAX):
            raise wrong("learned lobes", f"a count of 0 to {limits.LIGHT_LOBES_MAX}", lobes)
        world_offsets, ellipsoids = value.get("world_offsets"), value.get("ellipsoids", False)
        for name, told in (("world_offsets", world_offsets), ("ellipsoids", ellipsoids)):
            if not isinstance(told, bool):
                raise wrong(f"learned {name}", "true or false", told)
        net, shadow = _parsed_net(value.get("net"), wrong), _parsed_shadow(value.get("shadow"), wrong)
        if net is not None and gaussians * net.hidden > limits.POSE_NET_UNITS_MAX:
            most = limits.POSE_NET_UNITS_MAX // gaussians
            raise wrong("learned net hidden", f"at most {most} units for each of {gaussians} Gaussians", net.hidden)
        baked = None if value.get("baked") is None else DistilledAbout.parsed(value["baked"], net, wrong)
        cast = None if value.get("cast") is None else CastAbout.parsed(value["cast"], wrong)
        return cls(lobes, net, shadow, bool(world_offsets), ellipsoids, cast, baked)


def _parsed_shadow(value: object, wrong: Wrong) -> ShadowLook | None:
    if value is None:
        return None
    if not isinstance(value, dict):
        raise wrong("learned shadow", "an object", value)
    gain, tint, seen = (value.get(name) for name in ("gain", "tint", "seen"))
    if not _is_number(gain, 0, limits.SHADOW_GAIN_MAX):
        raise wrong("learned shadow gain", f"a number of 0 to {limits.SHADOW_GAIN_MAX:g}", gain)
    if not (isinstance(tint, list) and len(tint) == 3 and all(_is_number(part, 0, 1) for part in tint)):
        raise wrong("learned shadow tint", "three numbers of 0 to 1", tint)
    if not (seen is None or _is_number(seen, 0, 1)):
        raise wrong("learned shadow seen", "a number of 0 to 1, or null", seen)
    red, green, blue = map(float, tint)
    return ShadowLook(float(gain), (red, green, blue), None if seen is None else float(seen))  # type: ignore[arg-type]


def _parsed_net(value: object, wrong: Wrong) -> PoseNetShape | None:
    if value is None:
        return None
    if not isinstance(value, dict):
        raise wrong("learned net", "an object", value)
    octaves = value.get("octaves")
    most = limits.POSE_NET_OCTAVES_MAX
    counts = octaves if isinstance(octaves, list) and len(octaves) == 3 else ()
    if not (counts and all(_is_count(count, most) for count in counts) and any(counts)):
        raise wrong("learned net octaves", f"three counts of 0 to {most}, not all 0", octaves)
    sizes = {}
    for name, least, most in (
        ("angle_channels", 1, limits.POSE_NET_WIDTH_MAX),
        ("angle_texels", 2, limits.POSE_NET_TEXELS_MAX),
        ("hidden", 1, limits.POSE_NET_WIDTH_MAX),
    ):
        sizes[name] = value.get(name)
        if not (_is_count(sizes[name], most) and sizes[name] >= least):
            raise wrong(f"learned net {name}", f"a count of {least} to {most}", sizes[name])
    for name in ("level1", "shaded"):
        if not isinstance(value.get(name), bool):
            raise wrong(f"learned net {name}", "true or false", value.get(name))
    reach_m = value.get("reach_m")
    if not _is_number(reach_m, 0, limits.AVATAR_REACH_M):
        raise wrong("learned net reach_m", f"a length of 0 to {limits.AVATAR_REACH_M} m", reach_m)
    return PoseNetShape(
        octaves=(counts[0], counts[1], counts[2]),
        level1=value["level1"],
        shaded=value["shaded"],
        reach_m=float(reach_m),  # type: ignore[arg-type]
        **sizes,
    )


def _is_count(value: object, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most


def _is_number(value: object, low: float, high: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high


# ---- arrays ----------------------------------------------------------------------------------------------------------


def expected_learned_arrays(about: LearnedAbout, gaussians: int, storage: Storage) -> dict[str, tuple[str, tuple]]:
    """Name -> (safetensors dtype, shape) of every array that training adds."""
    exact = storage is Storage.EXACT
    arrays: dict[str, tuple[str, tuple]] = {SHINE: ("F32" if exact else "F16", (gaussians,))}
    arrays |= {NORMAL: ("F32", (gaussians, 3))} if exact else {PACKED_NORMAL: ("U16", (gaussians, 2))}
    for name, shape in _light_shapes(about.lobes).items():
        arrays[LIGHT + name] = ("F32", shape)
    if about.net is not None:
        for name, shape in about.net.arrays().items():
            arrays[NET + name] = ("F32" if exact else "F16", shape)
    if about.net is not None and about.baked is not None and about.baked.basis:
        for name, kind in _linear_arrays(about.net, about.baked.basis, gaussians).items():
            arrays[LINEAR + name] = kind
    if about.cast is not None:
        for name, kind in _cast_arrays(about.cast, gaussians, storage).items():
            arrays[CAST + name] = kind
    if about.ellipsoids:
        for name, width in (("log_stretch", 3), ("quaternion", 4)):
            arrays[ELLIPSOID + name] = ("F32" if exact else "F16", (gaussians, width))
    return arrays


def _light_shapes(lobes: int) -> dict[str, tuple[int, ...]]:
    return {
        "irradiance": (SH_COUNT, 3), "lobe_direction": (lobes, 3), "lobe_sharpness": (lobes,), "lobe_rgb": (lobes, 3),
        "rim": (1,),
    }  # fmt: skip


def _linear_arrays(net: PoseNetShape, basis: int, gaussians: int) -> dict[str, tuple[str, tuple]]:
    return {
        "mean": ("F32", (net.angle_channels,)),
        "projection": ("F32", (net.angle_channels, min(basis, net.angle_channels))),
        "constant": ("F16", (gaussians, 6)),
        "direction": ("I8", (gaussians, basis, 6)),
        "scale": ("F32", (gaussians, 2)),
    }


def _cast_arrays(about: CastAbout, gaussians: int, storage: Storage) -> dict[str, tuple[str, tuple]]:
    exact = storage is Storage.EXACT
    normal = (NORMAL, ("F32", (about.anchors, 3))) if exact else (PACKED_NORMAL, ("U16", (about.anchors, 2)))
    return {
        "lamp_rgb": ("F32", (about.lamps, 3)),
        "bounced_rgb": ("F32", (3,)),
        "position_m": ("F32", (about.anchors, 3)),
        "bone_weights": ("F32" if exact else "F16", (about.anchors, JOINT_COUNT)),
        "nearest": ("U16", (gaussians, ANCHOR_NEIGHBORS)),
        "share": ("U8", (gaussians, ANCHOR_NEIGHBORS)),
        normal[0]: normal[1],
    }


def _pack_cast(cast: CastShadow, storage: Storage) -> dict[str, np.ndarray]:
    anchors, normal = cast.anchors, _single(cast.anchors.normal)
    packed = {
        "lamp_rgb": _single(cast.lamp_rgb),
        "bounced_rgb": _single(cast.bounced_rgb),
        "position_m": _single(anchors.position_m),
        "nearest": anchors.nearest.astype(np.uint16),
        "share": np.rint(SHARE_UNITS * anchors.share).astype(np.uint8),
        "bone_weights": _single(anchors.bone_weights).astype(np.float32 if storage is Storage.EXACT else np.float16),
    }
    packed |= {NORMAL: normal} if storage is Storage.EXACT else {PACKED_NORMAL: octahedral(normal)}
    return {CAST + name: array for name, array in packed.items()}


def _unpack_cast(packed: dict[str, np.ndarray], canonical_joints_m: np.ndarray) -> CastShadow:
    own = {name.removeprefix(CAST): array for name, array in packed.items() if name.startswith(CAST)}
    anchors = Anchors(
        position_m=_single(own["position_m"]),
        normal=_single(own[NORMAL] if NORMAL in own else octahedral_normal(own[PACKED_NORMAL])),
        bone_weights=_single(own["bone_weights"]),
        nearest=own["nearest"].astype(np.int64),
        share=_single(own["share"]) / SHARE_UNITS,
    )
    flesh = own_flesh(anchors.position_m, canonical_joints_m)
    return CastShadow(_single(own["lamp_rgb"]), _single(own["bounced_rgb"]), anchors, flesh)


def _pack_linear(linear: LinearCorrectives) -> dict[str, np.ndarray]:
    packed = {LINEAR + name: _single(getattr(linear, name)) for name in ("mean", "projection", "scale")}
    packed[LINEAR + "constant"] = _single(linear.constant).astype(np.float16)
    packed[LINEAR + "direction"] = linear.direction
    return packed


def _unpack_linear(packed: dict[str, np.ndarray], net: PoseNetwork) -> LinearCorrectives:
    names = ("mean", "projection", "constant", "scale")
    direction = np.ascontiguousarray(packed[LINEAR + "direction"])
    return LinearCorrectives(
        angles=net.angles, direction=direction, **{name: _single(packed[LINEAR + name]) for name in names}
    )


def pack_learned(learned: Learned, storage: Storage) -> dict[str, np.ndarray]:
    """Arrays as they stand in a file."""
    exact = storage is Storage.EXACT
    real = np.float32 if exact else np.float16
    normal = _single(learned.normal)
    packed = {SHINE: _single(learned.shine)}
    packed |= {NORMAL: normal} if exact else {PACKED_NORMAL: octahedral(normal)}
    for f in fields(Light):
        packed[LIGHT + f.name] = np.atleast_1d(_single(getattr(learned.light, f.name)))
    with np.errstate(over="ignore"):  # what becomes infinite is refused when the file is read once before it is named
        packed[SHINE] = packed[SHINE].astype(real)
        if isinstance(learned.correctives, PoseNetwork):
            for name, array in learned.correctives.weights.items():
                packed[NET + name] = _single(array).astype(real)
        if learned.distilled is not None and learned.distilled.linear is not None:
            packed |= _pack_linear(learned.distilled.linear)
        if learned.cast is not None:
            packed |= _pack_cast(learned.cast, storage)
        if learned.ellipsoid is not None:
            for f in fields(Ellipsoid):
                packed[ELLIPSOID + f.name] = _single(getattr(learned.ellipsoid, f.name)).astype(real)
    return {name: np.ascontiguousarray(array) for name, array in packed.items()}


def unpack_learned(packed: dict[str, np.ndarray], about: LearnedAbout, canonical_joints_m: np.ndarray) -> Learned:
    """The inverse of `pack_learned`. canonical_joints_m: (21, 3) of the avatar."""
    normal = packed[NORMAL] if NORMAL in packed else octahedral_normal(packed[PACKED_NORMAL])
    light = {f.name: _single(packed[LIGHT + f.name]) for f in fields(Light)}
    light["rim"] = light["rim"].reshape(())
    net = None
    if about.net is not None:
        net = PoseNetwork(about.net, {name: _single(packed[NET + name]) for name in about.net.arrays()})
    distilled = None
    if about.baked is not None and net is not None:
        linear = _unpack_linear(packed, net) if about.baked.basis else None
        distilled = Distilled(linear, about.baked.prices, about.baked.measured_on)
    ellipsoid = None
    if about.ellipsoids:
        ellipsoid = Ellipsoid(**{f.name: _single(packed[ELLIPSOID + f.name]) for f in fields(Ellipsoid)})
    return Learned(
        normal=_single(normal),
        shine=_single(packed[SHINE]),
        light=Light(**light),
        correctives=net,
        shadow=about.shadow,
        world_offsets=about.world_offsets,
        ellipsoid=ellipsoid,
        cast=None if about.cast is None else _unpack_cast(packed, canonical_joints_m),
        distilled=distilled,
    )


def octahedral(normal: np.ndarray) -> np.ndarray:
    """(N, 2) uint16 of unit vectors (N, 3): the octahedron |x| + |y| + |z| = 1 unfolded into a square."""
    vector = normal.astype(np.float64)
    vector = vector / np.maximum(np.abs(vector).sum(-1, keepdims=True), np.finfo(np.float64).tiny)
    square = np.where(vector[:, 2:] < 0, _folded(vector[:, :2]), vector[:, :2])
    return np.rint((square + 1) / 2 * UINT16_MAX).astype(np.uint16)


def octahedral_normal(packed: np.ndarray) -> np.ndarray:
    """(N, 3) float32 unit vectors: the inverse of `octahedral`."""
    square = packed.astype(np.float64) / UINT16_MAX * 2 - 1
    height = 1 - np.abs(square).sum(-1, keepdims=True)
    vector = np.concatenate([np.where(height < 0, _folded(square), square), height], -1)
    return (vector / np.linalg.norm(vector, axis=-1, keepdims=True)).astype(np.float32)


def _folded(square: np.ndarray) -> np.ndarray:
    """The corners of the square turned inwards, which is the lower half of the octahedron; its own inverse."""
    return (1 - np.abs(square[:, ::-1])) * np.where(square < 0, -1.0, 1.0)


def _single(array: np.ndarray) -> np.ndarray:
    """As contiguous float32; () stays ()."""
    return np.asarray(array, np.float32, order="C")
