"""Pictures whose light is known: what each light of it gives, apart, so that a trainer mixes them anew at every step.

    picture = load_groups(sample)
    view = mix(picture, random_weights(picture.light, rng))        view.rgb, view.alpha, view.light, view.exposure

Beside `imageN.png`, which is for people's eyes and masks, lies `imageN.npz`, all of it of the hand's box alone:

    groups  (G, h, w, 3) float16, scene-linear, Rec.709, premultiplied: the world's, then each lamp's
    alpha   (h, w) uint8
    box_px  (4,) left, top, right, bottom of the box in the picture
    stamp   of the plan

Whose light they are says plan/lights.json (captures/making/lights.py). Half-floats of NumPy, and not OpenEXR: a
training reads them without another package, and Blender's own files of parts carry the day and the machine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jghand_engine.avatar.light_records import lamps_of, light_of, turn_of
from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.errors import InputError
from jghand_engine.json_files import JsonObject
from jghand_engine.npz_files import read_arrays

if TYPE_CHECKING:
    from jghand_engine.captures.sample import Sample

LIGHTS_FILE = Path("plan") / "lights.json"
LIGHTS_FORMAT = 1
# how often the world, and a lamp, is on in a mix; how far the logarithms of weights and of colors vary
WORLD_ON, LAMP_ON = 0.75, 0.6
WEIGHT_SPREAD, COLOR_SPREAD = 0.6, 0.25
# a mix is exposed so that this part of the hand is at most so bright, within bounds: no noise is made a picture
EXPOSED_PART, EXPOSED_TO = 0.95, 0.7
EXPOSURE = (0.2, 12.0)
# alpha from which a pixel shows nothing but the hand
WHOLE_ALPHA = 0.9
_REMEDY = "Start the command that made the capture again: it makes broken files anew."


@dataclass(frozen=True, eq=False)
class KnownLight:
    """The light of one picture, reduced as for drawing: its groups are the world's, if it has one, and each lamp's.

    suns:        of the world, taken out of it: its group holds their light
    file:        of the groups
    is_held_out: whether it has worlds and kinds of lamps that no picture has that is learned from
    judged_in:   (G,) of its groups, the mix by which a hand is judged; None: one by chance, the same every time
    """

    world: World | None
    suns: tuple[Lamp, ...]
    lamps: tuple[Lamp, ...]
    file: Path = Path()
    is_held_out: bool = False
    judged_in: tuple[float, ...] | None = None

    @property
    def groups(self) -> int:
        return (self.world is not None) + len(self.lamps)

    def weighted(self, weight: np.ndarray) -> SceneLight:
        """All of it, its groups multiplied by `weight` (G, 3). What is multiplied by 0 is left out."""
        of_lamps = weight if self.world is None else weight[1:]
        lamps = [(lamp, by) for lamp, by in zip(self.lamps, of_lamps, strict=True) if by.any()]
        world = None
        if self.world is not None and weight[0].any():
            world = World(self.world.radiance * weight[0].astype(np.float32), self.world.env_from_world)
            lamps += [(sun, weight[0]) for sun in self.suns]
        return SceneLight(world, tuple(replace(lamp, rgb=tuple((lamp.rgb * by).tolist())) for lamp, by in lamps))


@dataclass(frozen=True, eq=False)
class LitPicture:
    """groups: (G, h, w, 3) float16, linear, premultiplied · alpha: (h, w) uint8 · corner_px: left, top of both in the
    picture · size_px: its width, height · light: whose groups they are"""

    groups: np.ndarray
    alpha: np.ndarray
    corner_px: tuple[int, int]
    size_px: tuple[int, int]
    light: KnownLight


@dataclass(frozen=True, eq=False)
class MixedPicture:
    """rgb: (H, W, 3) float32, linear, premultiplied, not exposed · alpha: (H, W) float32 · weight: (G, 3) float32 by
    which each group of `of` is multiplied · exposure: factor that makes `rgb` a picture of usual brightness"""

    rgb: np.ndarray
    alpha: np.ndarray
    weight: np.ndarray
    exposure: float
    of: KnownLight

    @cached_property
    def light(self) -> SceneLight:
        """The light that `rgb` shows."""
        return self.of.weighted(self.weight)


def read_lights(folder: Path) -> dict[tuple[int, str], KnownLight]:
    """(frame, camera) -> light of every picture of a capture; empty for one that says nothing of it.

    InputError names what is wrong in lights.json, or the picture of a world that is missing or damaged.
    """
    file = folder / LIGHTS_FILE
    if not file.exists():
        return {}
    content = JsonObject.of_file(file, _REMEDY)
    content.value("format", lambda value: value == LIGHTS_FORMAT, str(LIGHTS_FORMAT))
    pictures = content.needed("pictures")
    worlds: dict[str, SceneLight] = {}
    lights = {}
    for key in pictures.fields:
        frame, _, camera = key.partition("/")
        if not (frame.isdecimal() and camera):
            raise pictures.wrong(key, "pictures named frame/camera")
        picture = pictures.needed(key)
        world, suns = None, ()
        if (entry := picture.object("world")) is not None:
            whole, env_from_world = _world(entry, file.parent, worlds), turn_of(entry)
            world = None if whole.world is None else World(whole.world.radiance, env_from_world)
            suns = tuple(replace(sun, place_m=tuple(sun.place_m @ env_from_world)) for sun in whole.lamps)
        held_out = picture.flag("is_held_out", False)
        lights[int(frame), camera] = KnownLight(world, suns, lamps_of(picture), is_held_out=held_out)
    return lights


def groups_file(image: Path) -> Path:
    """Where the groups of a picture lie."""
    return image.with_suffix(".npz")


def load_groups(sample: Sample) -> LitPicture:
    """Reads what each light of a picture gives. InputError names the file when it is missing, broken or of another
    size, and for a picture whose light is not known."""
    if sample.light is None:
        raise InputError(f"picture {sample.image}", wanted="one whose light is known", came="another")
    size_px = sample.camera.width, sample.camera.height
    arrays = read_groups(sample.light.file, size_px, sample.light.groups)
    left, top = arrays["box_px"][:2].tolist()
    return LitPicture(arrays["groups"], arrays["alpha"], (left, top), size_px, sample.light)


def read_groups(file: Path, size_px: tuple[int, int], groups: int | None = None) -> dict[str, np.ndarray]:
    """The arrays of a file of groups for a picture of (width, height) pixels. InputError as `load_groups`."""
    named = f"light groups {file}"
    try:
        arrays = read_arrays(file, ("groups", "alpha", "box_px", "stamp"), named)
    except InputError as error:
        raise InputError(error.thing, wanted=error.wanted, came=error.came, remedy=_REMEDY) from error
    light, alpha, box = arrays["groups"], arrays["alpha"], arrays["box_px"]
    whole = (0, 0, *size_px)
    fits = box.shape == (4,) and box.dtype.kind in "iu" and light.ndim == 4 and alpha.dtype == np.uint8
    if fits:
        left, top, right, bottom = box.tolist()
        fits = whole[0] <= left < right <= whole[2] and whole[1] <= top < bottom <= whole[3]
        shape = (light.shape[0] if groups is None else groups, bottom - top, right - left, 3)
        fits = fits and light.shape == shape and alpha.shape == shape[1:3]
    if not fits or light.dtype != np.float16 or not np.isfinite(light).all():
        wanted = f"{groups or 'some'} groups of light in a box of {size_px[0]} x {size_px[1]} pixels"
        came = f"{light.dtype} of shape {light.shape} in the box {box.tolist()}"
        raise InputError(named, wanted=wanted, came=came, remedy=_REMEDY)
    return arrays


# ---- mixing ----------------------------------------------------------------------------------------------------------


def mix(picture: LitPicture, weight: np.ndarray) -> MixedPicture:
    """The picture with its lights multiplied by `weight` (G, 3), and the exposure that fits it."""
    weight = weight.astype(np.float32)
    inside = np.einsum("ghwc,gc->hwc", picture.groups.astype(np.float32), weight)
    alpha = picture.alpha.astype(np.float32) / 255
    width, height = picture.size_px
    (left, top), (rows, columns) = picture.corner_px, alpha.shape
    rgb, whole = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.float32)
    rgb[top : top + rows, left : left + columns] = inside
    whole[top : top + rows, left : left + columns] = alpha
    return MixedPicture(rgb, whole, weight, fit_exposure(inside, alpha), picture.light)


def random_weights(light: KnownLight, rng: np.random.Generator) -> np.ndarray:
    """(G, 3) random amounts of the world and the lamps, at least one of them on."""
    often = np.array(([] if light.world is None else [WORLD_ON]) + [LAMP_ON] * len(light.lamps))
    on = np.zeros(len(often), bool)
    while not on.any():
        on = rng.random(len(often)) < often
    amount = on * np.exp(WEIGHT_SPREAD * rng.standard_normal(len(often)))
    return amount[:, None] * np.exp(COLOR_SPREAD * rng.standard_normal((len(often), 3)))


def fit_exposure(rgb: np.ndarray, alpha: np.ndarray) -> float:
    """The factor of linear premultiplied light (h, w, 3) at which the hand has the brightness of a usual picture."""
    luminance = rgb.mean(-1)[alpha > WHOLE_ALPHA]
    if not luminance.size:
        return 1.0
    return float(np.clip(EXPOSED_TO / max(float(np.quantile(luminance, EXPOSED_PART)), 1e-9), *EXPOSURE))


def _world(entry: JsonObject, folder: Path, known: dict[str, SceneLight]) -> SceneLight:
    """The world of an entry, not yet turned, and its suns. known: those that were read before, by name."""
    name = entry.value("picture", _is_inside, "the name of a file in the plan's folder")
    if name not in known:
        try:
            known[name] = light_of((), World(np.load(folder / name, allow_pickle=False)))
        except (OSError, ValueError, EOFError) as error:
            thing = f"picture of a world {folder / name}"
            raise InputError(thing, wanted="a whole .npy file", came=str(error)[:200], remedy=_REMEDY) from error
    return known[name]


def _is_inside(name: object) -> bool:
    return isinstance(name, str) and not Path(name).is_absolute() and ".." not in Path(name).parts
