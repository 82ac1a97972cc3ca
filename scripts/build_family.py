"""Makes the family of built-in hands: other persons' hands from one that was trained, a picture of each, and the pack.

    python scripts/build_family.py --out family

The built-in hand learned from `jghand capture` of adult_woman and the usual person, in known light (train_builtin.py).
Nobody else's pictures were learned: each hand is the trained one in another identity's shape, with the colors, the
gloss and the detail of another person's maps (`scripts/other_person.py`) on that person's skin (`registration.py`). In
OUT come NAME.jghand and NAME.png of each, family.png with all of them, and jghand-hands.zip, which Blender's "Install
Hands" takes. A hand that is there, of the same trained one, the same person and the same code, is kept; the maps of a
person take minutes of one core, and are kept too.
"""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import json
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import other_person
import registration
import tyro
from other_person import Somebody, as_person, somebody
from PIL import Image
from registration import with_maps
from show_light import sky

from jghand_engine.avatar import BUILTIN
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import avatar_sha256, load_avatar_called
from jghand_engine.avatar.file import load_avatar, save_avatar
from jghand_engine.avatar.forearm import ended
from jghand_engine.avatar.light_records import light_of
from jghand_engine.avatar.scene_light import Lamp
from jghand_engine.avatar.storage import Storage
from jghand_engine.avatar.validation import as_text
from jghand_engine.captures.making.person_skin import MAP_PX
from jghand_engine.captures.making.rig import load_identity
from jghand_engine.captures.skin import maps as paint
from jghand_engine.captures.skin.hair import Hair
from jghand_engine.captures.skin.maps import FINE_LAYERS, SkinMaps, paint_skin
from jghand_engine.captures.skin.noise import smoothstep
from jghand_engine.captures.skin.person import Person
from jghand_engine.export.pictures import flatten
from jghand_engine.files import writing
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.native.scene_light_task import LampKind
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import Frame, HandRenderer
from jghand_engine.render.settings import preset
from jghand_engine.template import reshape

# whom the trained hand learned: identity, and the person on it
TRAINED = ("adult_woman", Person())
# the same by name, of the others; beside the trained hand itself, which is a grown woman of the Monk scale's
# third tone. From pale to dark: the tones 1, 2, 4, 5, 6, 8 and 10
FAMILY = {
    "elder": ("old_person", Person(0.05, 0.40, 0.28, age=0.95, freckles=0.45, dryness=0.65, nail_mm=0.8, seed=12)),
    "child": ("child", Person(0.08, 0.50, 0.25, age=0.0, freckles=0.30, dryness=0.20, nail_mm=0.5, seed=11)),
    "man": ("adult_man", Person(0.18, 0.48, 0.3, age=0.45, freckles=0.2, dryness=0.5, nail_mm=0.6, hair=0.9, seed=13)),
    "slender": ("slim_woman", Person(0.28, 0.40, 0.38, age=0.20, freckles=0.10, dryness=0.30, nail_mm=2.2, seed=14)),
    "long": ("long_fingers", Person(0.45, 0.42, 0.35, age=0.30, freckles=0.10, dryness=0.40, nail_mm=1.0, seed=15)),
    "strong": ("big_man", Person(0.90, 0.45, 0.35, age=0.50, freckles=0.05, dryness=0.55, nail_mm=0.6, seed=17)),
    "dark": ("adult_woman", Person(1.80, 0.42, 0.35, age=0.25, freckles=0.0, dryness=0.45, nail_mm=1.8, seed=18)),
}
HANDS = Path(__file__).resolve().parents[1] / "jghand_engine" / "assets" / "hands"
LAYERS = ("static", "straight", "bent", "fold")
FILE_MAX_BYTES = 8_000_000
PACK = "jghand-hands.zip"
# pictures: of a hand to choose it by, and of all side by side at one scale; what their height shows, meters
THUMB_PX, THUMB_FIELD_M = 256, 0.26
CELL_PX, CELL_FIELD_M = (270, 370), 0.28
DISTANCE_M, BACKGROUND = 0.8, (0.80, 0.79, 0.78)
# of a cell's height, from its lower edge, the part over which an arm fades: none is cut off
ARM_FADES = 0.17
# the light of pictures, the same on both sides: a wide lamp on the camera's left and above it, whose light falls across
# the relief, and a dim sky, which leave the palest hand below white and the darkest above black. W/(m2 sr), meters, and
# from the middle of the hand to the lamp where a camera sees the palm
KEY_RGB, KEY_SIZE_M, KEY_AWAY_M = (19.0, 18.1, 16.6), (0.22, 0.22), (-0.31, 0.26, 0.29)
SKY = 0.75


@dataclass(frozen=True)
class Options:
    """trained: the hand, a .jghand file or builtin · maps: folder in which maps are kept; OUT/maps
    texels: along an edge of the maps · only: these of the family, without family.png and the pack
    carried: hands of this run that are put into the assets instead of the pack, with the picture of the trained one,
    which comes with JGHand as the built-in hand"""

    trained: str = BUILTIN
    out: Path = Path("family")
    maps: Path | None = None
    texels: int = MAP_PX
    only: tuple[str, ...] = ()
    carried: tuple[str, ...] = ()


def main(options: Options) -> None:
    absent = set(options.carried) - set(options.only or FAMILY)
    if absent:
        raise SystemExit(f"--carried wants hands that are made in this run, not {', '.join(sorted(absent))}")
    trained = load_avatar_called(options.trained)
    maps = options.maps or options.out / "maps"
    maps.mkdir(parents=True, exist_ok=True)
    load = partial(_somebody, trained, maps, options.texels)
    own = load(*TRAINED)
    digest = avatar_sha256(options.trained)
    files = [_kept(options.out / "builtin.jghand", digest, lambda: trained)]
    for name in options.only or FAMILY:

        def made(name: str = name) -> HandAvatar:
            other = load(*FAMILY[name])
            return _told(with_maps(as_person(trained, own, other), other), f"JGHand {name}")

        identity, person = FAMILY[name]
        stamp = json.dumps([digest, code_sha256(), options.texels, identity, dataclasses.asdict(person)])
        files.append(_kept(options.out / f"{name}.jghand", stamp, made))
    if not options.only:
        picture(files).save(options.out / "family.png")
        pack([file for file in files[1:] if file.stem not in options.carried], options.out / PACK)
    for name in options.carried:
        shutil.copyfile(options.out / f"{name}.jghand", HANDS / f"{name}.jghand")
    for name in ("builtin", *options.carried) if options.carried else ():
        shutil.copyfile(options.out / f"{name}.png", HANDS / f"{name}.png")


def code_sha256() -> str:
    """Of the sources that make one person's hand into another's, and those that paint persons."""
    sources = (inspect.getsource(module) for module in (other_person, registration, reshape))
    return hashlib.sha256("".join(sources).encode() + skin_sources()).hexdigest()


def skin_sources() -> bytes:
    """Of what paints the maps of a person."""
    return b"".join(path.read_bytes() for path in sorted(Path(paint.__file__).parent.glob("*.py")))


def _told(avatar: HandAvatar, name: str) -> HandAvatar:
    """The avatar with a name, which says what its figures are of: it was compared with no picture itself."""
    learned = avatar.learned
    if learned is not None and learned.distilled is not None:
        measured_on = as_text(f"the hand that it was made from: {learned.distilled.measured_on}")
        avatar = replace(
            avatar, learned=replace(learned, distilled=replace(learned.distilled, measured_on=measured_on))
        )
    return replace(avatar, info=replace(avatar.info, name=as_text(f"{name}, made from {avatar.info.name}")))


def _kept(file: Path, stamp: str, make: Callable[[], HandAvatar]) -> Path:
    """The file of a hand and its picture, made when they are not there, or of something else."""
    note = file.with_suffix(".stamp")
    if not (file.is_file() and note.is_file() and note.read_text() == stamp):
        avatar = make()
        save_avatar(file, avatar, storage=Storage.COMPACT)
        thumbnail(avatar).save(file.with_suffix(".png"))
        note.write_text(stamp)
    size = file.stat().st_size
    print(f"{file}: {size / 1e6:.1f} MB")
    if size > FILE_MAX_BYTES:
        raise SystemExit(f"{file} is larger than {FILE_MAX_BYTES / 1e6:g} MB")
    return file


def _somebody(trained: HandAvatar, folder: Path, texels: int, identity: str, person: Person) -> Somebody:
    return somebody(trained, identity, person, kept_maps(folder, identity, person, texels))


def kept_maps(folder: Path, identity: str, person: Person, texels: int) -> SkinMaps:
    """Painted once by the same code, in half precision: 2 um of the largest height."""
    text = json.dumps([identity, dataclasses.asdict(person), texels], sort_keys=True)
    file = folder / f"{hashlib.sha256(text.encode() + skin_sources()).hexdigest()[:16]}.npz"
    if not file.is_file():
        hand = load_identity(identity, forearm=True)
        maps = paint_skin(hand, texels, person, Hair.of(hand, person))
        arrays = {"rgb": maps.rgb, "roughness": maps.roughness, "plate": maps.plate}
        arrays |= {f"coarse_{name}": height for name, height in maps.coarse.items()}
        arrays |= {f"fine_{name}": height for name, height in maps.fine.items()}
        with writing(file) as temporary, temporary.open("wb") as stream:
            np.savez(stream, allow_pickle=False, **{name: each.astype(np.float16) for name, each in arrays.items()})
    with np.load(file) as kept:
        arrays = {name: kept[name].astype(np.float32) for name in kept.files}
    coarse, fine = ({one: arrays[f"{part}_{one}"] for one in layers} for part, layers in (
        ("coarse", LAYERS), ("fine", FINE_LAYERS),
    ))  # fmt: skip
    return SkinMaps(arrays["rgb"], arrays["roughness"], arrays["plate"], coarse, fine)


# ---- pictures --------------------------------------------------------------------------------------------------------


def thumbnail(avatar: HandAvatar) -> Image.Image:
    """The back of the hand, as large as it is, on nothing."""
    rgba = _frame(avatar, -1, (THUMB_PX, THUMB_PX), THUMB_FIELD_M).displayed()
    rgba[..., :3] /= rgba[..., 3:].clip(1e-3)
    return Image.fromarray(np.rint(255 * rgba.clip(0, 1)).astype(np.uint8), "RGBA")


def picture(files: list[Path]) -> Image.Image:
    """Backs above palms, all at one scale."""
    shown = smoothstep(0, ARM_FADES, np.linspace(1, 0, CELL_PX[1]))[:, None, None]
    rows = []
    for side in (-1, 1):
        frames = [_frame(load_avatar(file), side, CELL_PX, CELL_FIELD_M) for file in files]
        rows.append(np.concatenate([flatten(shown * frame.displayed(), BACKGROUND) for frame in frames], 1))
    return Image.fromarray(np.concatenate(rows))


def _frame(avatar: HandAvatar, side: int, size: tuple[int, int], field_m: float) -> Frame:
    """side: 1 shows the palm, -1 the back"""
    shown = ended(avatar.for_hand(Handedness.RIGHT))
    joints_m = named_pose("open", shown.rest_joints_m, handedness=Handedness.RIGHT)
    # wrist and the tip of the middle finger, level order
    middle = joints_m[[0, 18]].mean(0) - [0, 0.01, 0]
    seen_from = np.array([side, 1, side])
    eye = middle + DISTANCE_M * seen_from * [0.14, 0.10, 0.98]
    focal_px = size[1] * DISTANCE_M / field_m
    camera = Camera.looking_at(eye, middle, (0, 1, 0), width=size[0], height=size[1], focal_px=focal_px)
    away_m = seen_from * KEY_AWAY_M
    key = Lamp(LampKind.AREA, KEY_RGB, tuple(middle + away_m), tuple(-away_m), size_m=KEY_SIZE_M)
    return HandRenderer(shown, preset("final"), light_of((key,), sky(SKY))).render(joints_m, camera)


def pack(files: list[Path], path: Path) -> None:
    """The zip, the same for the same hands."""
    with writing(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for file in (each for name in files for each in (name, name.with_suffix(".png"))):
            archive.writestr(zipfile.ZipInfo(file.name), file.read_bytes())
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
