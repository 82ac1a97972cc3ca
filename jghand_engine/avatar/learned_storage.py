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
| response.*       | float32      | uint8 over their range   | 1/510 of the range; constants are float32: nothing     |
| linear.*         | as it is used: int8 directions with a scale, constants as float16; nothing lost by writing    |

A hand that was learned in known light has a response, and neither shine nor light; one whose light was estimated with
its skin has that of its film, response.film_light, float32. The network reads where a Gaussian
sits, and its bones; both stand in the file already. What the cheaper tiers cost stands under `baked`, the name of files
of 0.1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import NamedTuple

import numpy as np

from jghand_engine.avatar.correctives import BASIS_MAX, LinearCorrectives, PoseNetShape, PoseNetwork, largest_basis
from jghand_engine.avatar.learned import (
    ANCHOR_NEIGHBORS,
    AVATAR_REACH_M,
    SH_COUNT,
    SHARE_UNITS,
    Anchors,
    CastShadow,
    Ellipsoid,
    Learned,
    Light,
    ShadowLook,
    SkinResponse,
    flesh_of,
    is_learned,
    no_light,
)
from jghand_engine.avatar.scene_light import CELLS
from jghand_engine.avatar.storage import UINT8_MAX, UINT16_MAX, Storage
from jghand_engine.avatar.tiers import Distilled, Price, Tier
from jghand_engine.avatar.validation import LIGHT_LOBES_MAX, SHADOW_GAIN_MAX, is_text
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.json_files import JsonObject
from jghand_engine.native.learned_tasks import HIDDEN_MAX

NORMAL, SHINE = "normal", "shine"
LIGHT, NET, ELLIPSOID, CAST, LINEAR = "light.", "pose_net.", "ellipsoid.", "cast.", "linear."
RESPONSE, RANGE, FILM_LIGHT = "response.", "response.range", "response.film_light"
# in older files light that no shadow takes, beside a bounce that was learned with it; zeros since
AMBIENT = "response.ambient"
# of a response: values per Gaussian, then per channel
MATERIAL, PER_CHANNEL = ("spread", "roughness", "reflectance"), ("softness", "bounce")

# no figure of a tier is larger
PRICE_MAX = 1e9
# sizes beyond these come from no training; all but the network's width are those of arrays that the file has
COUNT_MAX = UINT16_MAX


@dataclass(frozen=True)
class DistilledAbout:
    """What the JSON says of tiers.

    basis:               size of the linear one's, 0 for none
    prices, measured_on: as in Distilled
    """

    basis: int
    prices: tuple[Price, ...]
    measured_on: str

    @classmethod
    def of(cls, distilled: Distilled) -> DistilledAbout:
        return cls(0 if distilled.linear is None else distilled.linear.basis, distilled.prices, distilled.measured_on)

    @classmethod
    def parsed(cls, of: JsonObject, net: PoseNetShape) -> DistilledAbout:
        """A linear tier has a price, and a price of it is of the tier that there is."""
        basis = of.count("basis", 0, min(BASIS_MAX, largest_basis(net)))
        prices = of.value("prices", lambda value: isinstance(value, list), "a list of tiers")
        # files of 0.1 have the price of a tier `cached`, which the compiled skin's exact tier is
        kept = [price for price in prices if not (isinstance(price, dict) and price.get("tier") == "cached")]
        parsed = tuple(_parsed_price(of.inner(price, "price"), basis) for price in kept)
        if len({price.tier for price in parsed}) != len(parsed):
            raise of.wrong("prices", "one of each tier")
        return cls(basis, parsed, of.value("measured_on", is_text, "a text of one line"))


def _parsed_price(of: JsonObject, basis: int) -> Price:
    tier = Tier(of.one_of("tier", (Tier.EXACT, Tier.LINEAR)))
    wanted = basis if tier is Tier.LINEAR else 0
    if of.count("basis", 0, BASIS_MAX) != wanted or (tier is Tier.LINEAR and basis == 0):
        raise of.wrong("basis", f"that of the tier in the file, {basis}")
    figures = ("frame_ms", "megabytes", "psnr_db", "lost_db")
    return Price(tier=tier, basis=wanted, **{name: of.number(name, -PRICE_MAX, PRICE_MAX) for name in figures})


@dataclass(frozen=True)
class CastAbout:
    """What the JSON says of the cast shadow: its lamps and its anchors, at least one of each."""

    lamps: int
    anchors: int

    @classmethod
    def parsed(cls, of: JsonObject) -> CastAbout:
        lamps = of.count("lamps", 2, COUNT_MAX)
        if lamps % 2:
            raise of.wrong("lamps", "an even count")
        return cls(lamps, of.count("anchors", 1, COUNT_MAX))


@dataclass(frozen=True)
class LightAbout:
    """What the JSON says of the light that the hand was learned in: one that it carries along, known ones, or one that
    was estimated with its skin; it answers any, but in the first case. trained_on: as in SkinResponse"""

    kind: str = "learnt"
    trained_on: Mapping[str, int] = field(default_factory=dict)

    @property
    def is_known(self) -> bool:
        """Whether the hand answers any light."""
        return self.kind != "learnt"

    @property
    def is_estimated(self) -> bool:
        return self.kind == "estimated"

    @classmethod
    def of(cls, response: SkinResponse | None) -> LightAbout:
        if response is None:
            return cls()
        return cls("known" if response.film_light is None else "estimated", dict(response.trained_on))

    @classmethod
    def parsed(cls, of: JsonObject) -> LightAbout:
        kind, counts = (
            of.one_of("kind", ("learnt", "known", "estimated")),
            of.inner(of.fields.get("trained_on"), "trained_on"),
        )
        for name in counts.fields:
            if not is_text(name):
                raise of.wrong("trained_on", "names of one line")
        return cls(kind, {name: counts.count(name, 0, 2**53) for name in counts.fields})


@dataclass(frozen=True)
class LearnedAbout:
    """What the JSON says.

    lobes:                 of the light's gloss
    net:                   shape of the network, None for none
    shadow, world_offsets: as in Learned
    ellipsoids:            whether the Gaussians are ellipsoids
    cast:                  the cast shadow, None where there is none
    baked:                 cheaper tiers, None where nothing was measured
    light:                 that it was learned in
    """

    lobes: int
    net: PoseNetShape | None
    shadow: ShadowLook | None
    world_offsets: bool
    ellipsoids: bool
    cast: CastAbout | None
    baked: DistilledAbout | None
    light: LightAbout

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
        ellipsoids, light = learned.ellipsoid is not None, LightAbout.of(learned.response)
        return cls(lobes, shape, learned.shadow, learned.world_offsets, ellipsoids, cast, baked, light)

    @classmethod
    def parsed(cls, of: JsonObject) -> LearnedAbout:
        """From JSON, every field looked at."""
        net = None if (shape := of.object("net")) is None else _parsed_net(shape)
        distilled, cast, shadow = of.object("baked"), of.object("cast"), of.object("shadow")
        if distilled is not None and net is None:
            raise of.wrong("baked", "an object, beside a network")
        about = None if cast is None else CastAbout.parsed(cast)
        light = LightAbout() if (told := of.object("light")) is None else LightAbout.parsed(told)
        if light.is_known and (about is None or about.lamps != CELLS):
            raise of.wrong("cast", f"one of {CELLS} lamps, beside a known light")
        return cls(
            of.count("lobes", 0, LIGHT_LOBES_MAX),
            net,
            None if shadow is None else _parsed_shadow(shadow),
            of.flag("world_offsets"),
            of.flag("ellipsoids", left_out=False),
            about,
            None if distilled is None or net is None else DistilledAbout.parsed(distilled, net),
            light,
        )


def _parsed_shadow(of: JsonObject) -> ShadowLook:
    red, green, blue = of.numbers("tint", 3, 0, 1)
    seen = None if of.fields.get("seen") is None else of.number("seen", 0, 1)
    printed = of.flag("printed", left_out=False)
    return ShadowLook(of.number("gain", 0, SHADOW_GAIN_MAX), (red, green, blue), seen, printed)


def _parsed_net(of: JsonObject) -> PoseNetShape:
    octaves = of.numbers("octaves", 3, 0, COUNT_MAX)
    if not any(octaves) or not all(isinstance(count, int) for count in of.fields["octaves"]):
        raise of.wrong("octaves", "three counts, not all 0")
    return PoseNetShape(
        octaves=(int(octaves[0]), int(octaves[1]), int(octaves[2])),
        level1=of.flag("level1"),
        shaded=of.flag("shaded"),
        reach_m=of.number("reach_m", 0, AVATAR_REACH_M),
        angle_channels=of.count("angle_channels", 1, COUNT_MAX),
        angle_texels=of.count("angle_texels", 2, COUNT_MAX),
        # the widest that the kernel draws
        hidden=of.count("hidden", 1, HIDDEN_MAX),
    )


# ---- arrays ----------------------------------------------------------------------------------------------------------


class _Stored(NamedTuple):
    """Shape of an array, and as what exact and compact files have it: a dtype of safetensors, or one of the below."""

    shape: tuple[int, ...]
    exact: str = "F32"
    compact: str = "F32"


# unit vectors as two numbers, under another name; values of a response over their range, see RANGE
_UNIT, _RANGED = "octahedral", "ranged"
_DTYPES = {"F32": np.float32, "F16": np.float16, "U16": np.uint16, "U8": np.uint8, "I8": np.int8}


def _layout(about: LearnedAbout, gaussians: int) -> dict[str, _Stored]:
    """Every array that training adds, by name."""
    each, net = (gaussians,), about.net
    arrays = {NORMAL: _Stored((*each, 3), compact=_UNIT)}
    if about.light.is_known:
        arrays |= {RESPONSE + name: _Stored(each, compact=_RANGED) for name in MATERIAL}
        arrays |= {RESPONSE + name: _Stored((3,)) for name in PER_CHANNEL} | {RESPONSE + "shade_gain": _Stored((1,))}
        arrays |= {AMBIENT: _Stored((3,))}
        arrays |= {FILM_LIGHT: _Stored((CELLS, 3))} if about.light.is_estimated else {}
    else:
        arrays |= {SHINE: _Stored(each, compact="F16"), LIGHT + "irradiance": _Stored((SH_COUNT, 3))}
        arrays |= {LIGHT + name: _Stored((about.lobes, 3)) for name in ("lobe_direction", "lobe_rgb")}
        arrays |= {LIGHT + "lobe_sharpness": _Stored((about.lobes,)), LIGHT + "rim": _Stored((1,))}
    if net is not None:
        arrays |= {NET + name: _Stored(shape, compact="F16") for name, shape in net.arrays().items()}
    if net is not None and about.baked is not None and about.baked.basis:
        basis, channels = about.baked.basis, net.angle_channels
        arrays |= {
            LINEAR + "mean": _Stored((channels,)),
            LINEAR + "projection": _Stored((channels, min(basis, channels))),
            LINEAR + "constant": _Stored((*each, 6), "F16", "F16"),
            LINEAR + "direction": _Stored((*each, basis, 6), "I8", "I8"),
            LINEAR + "scale": _Stored((*each, 2)),
        }
    if about.cast is not None:
        anchors = (about.cast.anchors,)
        arrays |= {
            CAST + "lamp_rgb": _Stored((about.cast.lamps, 3)),
            CAST + "bounced_rgb": _Stored((3,)),
            CAST + "position_m": _Stored((*anchors, 3)),
            CAST + NORMAL: _Stored((*anchors, 3), compact=_UNIT),
            CAST + "bone_weights": _Stored((*anchors, JOINT_COUNT), compact="F16"),
            CAST + "nearest": _Stored((*each, ANCHOR_NEIGHBORS), "U16", "U16"),
            CAST + "share": _Stored((*each, ANCHOR_NEIGHBORS), "U8", "U8"),
        }
    if about.ellipsoids:
        widths = {"log_stretch": 3, "quaternion": 4}
        arrays |= {ELLIPSOID + name: _Stored((*each, width), compact="F16") for name, width in widths.items()}
    return arrays


def _values(learned: Learned) -> dict[str, np.ndarray]:
    """The same arrays as they are in memory, and others."""
    parts = {LIGHT: learned.light, ELLIPSOID: learned.ellipsoid, CAST: learned.cast, RESPONSE: learned.response}
    if isinstance(learned.correctives, PoseNetwork) and learned.distilled is not None:
        parts[LINEAR] = learned.distilled.linear
    values = {NORMAL: learned.normal, SHINE: learned.shine, AMBIENT: np.zeros(3)}
    for prefix, part in parts.items():
        values |= {} if part is None else {prefix + name: value for name, value in vars(part).items()}
    if isinstance(learned.correctives, PoseNetwork):
        values |= {NET + name: value for name, value in learned.correctives.weights.items()}
    if learned.cast is not None:
        values |= {CAST + name: value for name, value in vars(learned.cast.anchors).items()}
        values[CAST + "share"] = np.rint(SHARE_UNITS * learned.cast.anchors.share)
    return values


def expected_learned_arrays(about: LearnedAbout, gaussians: int, storage: Storage) -> dict[str, tuple[str, tuple]]:
    """Name -> (safetensors dtype, shape) of every array that training adds."""
    arrays: dict[str, tuple[str, tuple]] = {}
    for name, stored in _layout(about, gaussians).items():
        kind = stored.exact if storage is Storage.EXACT else stored.compact
        if kind == _UNIT:
            arrays[f"{name}_{_UNIT}"] = ("U16", (*stored.shape[:-1], 2))
        elif kind == _RANGED:
            arrays |= {name: ("U8", stored.shape), RANGE: ("F32", (len(MATERIAL), 2))}
        else:
            arrays[name] = (kind, stored.shape)
    return arrays


def pack_learned(learned: Learned, storage: Storage) -> dict[str, np.ndarray]:
    """Arrays as they stand in a file."""
    values, packed = _values(learned), {}
    for name, stored in _layout(LearnedAbout.of(learned), len(learned.normal)).items():
        kind, array = stored.exact if storage is Storage.EXACT else stored.compact, np.atleast_1d(_single(values[name]))
        if kind == _UNIT:
            packed[f"{name}_{_UNIT}"] = octahedral(array)
        elif kind == _RANGED:
            low, high = array.min().astype(np.float64), array.max().astype(np.float64)
            packed[name] = np.rint((array - low) / ((high - low) / UINT8_MAX or 1.0)).astype(np.uint8)
            packed[RANGE] = np.vstack([*packed.get(RANGE, ()), np.array([low, high], np.float32)])
        else:
            with np.errstate(over="ignore"):  # infinite ones are refused when the file is read once before it is named
                packed[name] = array.astype(_DTYPES[kind])
    return {name: np.ascontiguousarray(array) for name, array in packed.items()}


def unpack_learned(
    packed: dict[str, np.ndarray], about: LearnedAbout, canonical_joints_m: np.ndarray, bounce: np.ndarray
) -> Learned:
    """The inverse of `pack_learned`. canonical_joints_m: (21, 3) of the avatar · bounce: (3,) by the albedo of its
    skin, in place of what older files have, which was learned beside an ambient light"""

    def unit(prefix: str = "") -> np.ndarray:
        exact = packed.get(prefix + NORMAL)
        return octahedral_normal(packed[f"{prefix}{NORMAL}_{_UNIT}"]) if exact is None else _single(exact)

    def part(prefix: str, names: Iterable[str]) -> dict[str, np.ndarray]:
        return {name: _single(packed[prefix + name]) for name in names}

    normal = unit()
    response, light, shine = None, no_light(), np.zeros(len(normal), np.float32)
    if about.light.is_known:
        response = _unpacked_response(packed, about.light, bounce)
    else:
        arrays, shine = part(LIGHT, [f.name for f in fields(Light)]), _single(packed[SHINE])
        light = Light(**arrays | {"rim": arrays["rim"].reshape(())})
    net = None if about.net is None else PoseNetwork(about.net, part(NET, about.net.arrays()))
    distilled = None
    if about.baked is not None and net is not None:
        linear = None
        if about.baked.basis:
            direction = np.ascontiguousarray(packed[LINEAR + "direction"])
            numbers = part(LINEAR, ("mean", "projection", "constant", "scale"))
            linear = LinearCorrectives(angles=net.angles, direction=direction, **numbers)
        distilled = Distilled(linear, about.baked.prices, about.baked.measured_on)
    cast = None
    if about.cast is not None:
        around = part(CAST, ("position_m", "bone_weights", "share"))
        around["share"] /= np.float32(SHARE_UNITS)
        anchors = Anchors(normal=unit(CAST), nearest=packed[CAST + "nearest"].astype(np.int64), **around)
        flesh, own = flesh_of(anchors.position_m, canonical_joints_m, fitted=is_learned(response))
        cast = CastShadow(**part(CAST, ("lamp_rgb", "bounced_rgb")), anchors=anchors, flesh=flesh, own=own)
    return Learned(
        normal=normal,
        shine=shine,
        light=light,
        correctives=net,
        shadow=about.shadow,
        world_offsets=about.world_offsets,
        ellipsoid=Ellipsoid(**part(ELLIPSOID, [f.name for f in fields(Ellipsoid)])) if about.ellipsoids else None,
        cast=cast,
        distilled=distilled,
        response=response,
    )


def _unpacked_response(packed: dict[str, np.ndarray], about: LightAbout, bounce: np.ndarray) -> SkinResponse:
    values = {name: packed[RESPONSE + name] for name in (*MATERIAL, *PER_CHANNEL)}
    if RANGE in packed:
        for name, (low, high) in zip(MATERIAL, packed[RANGE].astype(np.float64), strict=True):
            with np.errstate(invalid="ignore"):  # a range that is not finite gives values that are refused
                values[name] = low + values[name] * ((high - low) / UINT8_MAX)
    if packed[AMBIENT].any():
        values["bounce"] = bounce
    return SkinResponse(
        **{name: _single(array) for name, array in values.items()},
        shade_gain=float(packed[RESPONSE + "shade_gain"][0]),
        trained_on=about.trained_on,
        film_light=_single(packed[FILM_LIGHT]) if about.is_estimated else None,
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
