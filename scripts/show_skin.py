"""Shows a person's skin, by the program that renders captures: views side by side.

    python scripts/show_skin.py --out hand.png --size 960x540 --samples 16 --person.melanin 0.9 --person.age 0.7
    python scripts/show_skin.py --out maps.png --views maps     # color and relief in the template's UV
    python scripts/show_skin.py --out docs/skin.jpg --views sheet --size 180x200 --samples 12 --levels 2 --texels 1024

Half a minute of one core for the maps, and one for each view of 480x270 at 12 rays. The sheet shows what each number of
a person does: nineteen persons, a minute each.
"""

from __future__ import annotations

import dataclasses
import io
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tyro
from PIL import Image

from jghand_engine.captures.making.cameras import PlannedCamera
from jghand_engine.captures.making.closing import Closing
from jghand_engine.captures.making.options import AreaLight, Light, Sampling
from jghand_engine.captures.making.person_skin import MAP_PX, PERSON_FILES, PersonSkin
from jghand_engine.captures.making.plan import CapturePlan, drafted_mesh, write_plan
from jghand_engine.captures.making.rig import RiggedHand, load_identity
from jghand_engine.captures.making.worker import find_blender_python, render
from jghand_engine.captures.skin.person import Person
from jghand_engine.color import to_bytes
from jghand_engine.export.pictures import Cell, SheetStyle, contact_sheet
from jghand_engine.native.threads import processors
from jghand_engine.render.camera import Camera

# name -> pose, where the camera stands (degrees around the hand from the palm, and above), the joints that it looks at,
# and what the picture's height shows, meters
VIEWS = {
    "palm": ("open", 8, 5, (0, 2, 3, 4, 5, 7, 8, 9, 10), 0.190),
    "back": ("open", 180, 12, (0, 2, 3, 4, 5, 7, 8, 9, 10), 0.190),
    "fist": ("fist", 20, 15, (2, 3, 4, 5, 7, 8, 9, 10), 0.120),
    "knuckles": ("fist", 195, 35, (2, 3, 4, 5, 7, 8, 9, 10), 0.120),
    "pinch": ("pinch", 240, 20, (11, 16, 17, 12, 7), 0.110),
    "knuckle": ("open", 180, 20, (8,), 0.040),
    "nail": ("open", 180, 15, (17,), 0.040),
    "lines": ("open", 8, 5, (0, 3, 4), 0.100),
    "arm": ("open", 8, 0, (0,), 0.340),
    "arm_back": ("open", 190, 0, (0,), 0.340),
    "arm_side": ("open", 85, 0, (0,), 0.340),
    "wrist": ("open", 8, 0, (0,), 0.110),
    "wrist_back": ("open", 185, 0, (0,), 0.110),
}
DISTANCE_M = 0.5
# what the sheet shows of each number: where it is seen, and two values beside the usual one
SHEET = {
    "melanin": ("back", 0.05, 1.3),
    "blood": ("palm", 0.1, 0.9),
    "warmth": ("palm", 0.0, 0.9),
    "age": ("back", 0.0, 1.0),
    "freckles": ("back", 0.0, 1.0),
    "dryness": ("knuckle", 0.0, 1.0),
    "nail_mm": ("nail", 0.0, 3.0),
    "hair": ("wrist_back", 0.5, 1.0),
    "seed": ("lines", 1, 2),
}
# one small key high on the left of the palm's side and one of the back's over a weak world: light that shows relief
LIGHT = Light(
    hdri="studio", hdri_strength=0.35,
    lamps=(
        AreaLight((-0.33, 0.45, 0.36), 0.20, 2.6, (1.0, 0.965, 0.92)),
        AreaLight((0.33, 0.45, -0.36), 0.20, 2.6, (1.0, 0.965, 0.92)),
    ),
)  # fmt: skip
BACKDROP = (0.23, 0.24, 0.26)


@dataclass(frozen=True)
class Options:
    """identity: of `jghand capture` · size: of each picture, pixels · samples: rays per pixel
    levels: of subdivision · texels: along an edge of the maps"""

    out: Path
    identity: str = "adult_woman"
    views: tuple[str, ...] = ("palm", "back", "fist", "pinch")
    size: str = "480x270"
    samples: int = 12
    levels: int = 3
    texels: int = MAP_PX
    person: Person = field(default_factory=Person)


def main(options: Options) -> None:
    width, height = map(int, options.size.split("x"))
    shown = sheet if options.views == ("sheet",) else row
    Image.fromarray(shown(options, (width, height))).save(options.out, quality=85)


def row(options: Options, size: tuple[int, int]) -> np.ndarray:
    return np.concatenate(pictures(options, options.person, size), 1)


def sheet(options: Options, size: tuple[int, int]) -> np.ndarray:
    """Each number of SHEET at three values from low to high, two numbers a row."""
    views = tuple(dict.fromkeys(view for view, _, _ in SHEET.values()))
    usual = dict(zip(views, pictures(replace(options, views=views), options.person, size), strict=True))
    cells = []
    for name, (view, low, high) in SHEET.items():
        for value in sorted((low, getattr(options.person, name), high)):
            person = replace(options.person, **{name: value})
            is_usual = person == options.person
            shown = usual[view] if is_usual else pictures(replace(options, views=(view,)), person, size)[0]
            cells.append(Cell(f"{name} {value:g}", shown))
    return contact_sheet(cells, SheetStyle(6, size[0], gap_px=4, background=(1, 1, 1), ink=(0.1, 0.1, 0.1)))


def pictures(options: Options, person: Person, size: tuple[int, int]) -> list[np.ndarray]:
    """(height, width, 3) sRGB of each view."""
    hand = RiggedHand(load_identity(options.identity, forearm=True))
    skin = PersonSkin.of(hand.identity, person, options.levels, options.texels)
    if options.views == ("maps",):
        return maps(skin, size[1])
    names = sorted({VIEWS[view][0] for view in options.views})
    closing = Closing(hand)
    pose = hand.pose(np.stack([closing.closed(hand.angles_of(name)) for name in names]))
    cameras = tuple(camera(view, names, pose.joints_m, size) for view in options.views)
    sampling = dataclasses.asdict(Sampling(samples=options.samples, subdivisions=0))
    told = {"sampling": sampling, "light": dataclasses.asdict(LIGHT), "skin": skin.material}
    plan = CapturePlan(
        {}, told, tuple(names), pose.joints_m, hand.skin(pose).astype(np.float32), skin.surface.faces,
        skin.surface.face_uv.astype(np.float32), cameras, skin.files, skin,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        with drafted_mesh(Path(folder), plan) as mesh:
            write_plan(Path(folder), plan, mesh)
        jobs = plan.jobs(Path(folder))
        seconds = [done.seconds for done in render(Path(folder), jobs, find_blender_python(), processors())]
        print(f"{person}: {', '.join(f'{one:.0f} s' for one in seconds)}")
        shown = {job.camera: np.asarray(Image.open(job.file), np.float64) / 255 for job in jobs}
    pictures = []
    for number in range(len(options.views)):
        rgba = shown[number]
        rgb = rgba[..., 3:] * rgba[..., :3] + (1 - rgba[..., 3:]) * np.array(BACKDROP) ** (1 / 2.2)
        pictures.append(np.rint(255 * rgb).astype(np.uint8))
    return pictures


def maps(skin: PersonSkin, edge: int) -> list[np.ndarray]:
    """Color, and the relief of straight joints that is finer than the mesh, white 0.3 mm above black."""
    color = Image.open(io.BytesIO(skin.files["skin.png"]))
    layers = [np.asarray(Image.open(io.BytesIO(skin.files[name])), float) for name in PERSON_FILES[2:]]
    height_m = np.sum(layers, axis=0) / 65535 * skin.material["range_m"] + 3 * skin.material["low_m"]
    relief = Image.fromarray(to_bytes(0.5 + height_m / 3e-4))
    return [np.asarray(one.convert("RGB").resize((edge, edge))) for one in (color, relief)]


def camera(view: str, poses: list[str], joints_m: np.ndarray, size: tuple[int, int]) -> PlannedCamera:
    """One that sees the pose of its view alone. joints_m: (P, 21, 3)"""
    name, around, above, looked_at, field_m = VIEWS[view]
    around, above, pose = np.radians(around), np.radians(above), poses.index(name)
    target = joints_m[pose, list(looked_at)].mean(0)
    direction = np.array([np.sin(around) * np.cos(above), np.sin(above), np.cos(around) * np.cos(above)])
    focal = size[1] * DISTANCE_M / field_m
    eye, up = target + DISTANCE_M * direction, np.array([0.0, 1.0, 0.0])
    seen = Camera.looking_at(eye, target, up, width=size[0], height=size[1], focal_px=focal)
    return PlannedCamera(seen, pose)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
