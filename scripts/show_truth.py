"""Shows a hand beside the pictures that Cycles makes of the same person, pose and light, as large as a film shows it.

    python scripts/show_truth.py --work truth --out docs/close_up.jpg

The views are those of scripts/show_skin.py; none of them was learned from. Below each stands its PSNR on the pixels of
the hand. The maps of the skin take minutes of one core, and so does each picture of 960x1080; what a run with the same
options left in the folder is kept.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from PIL import Image
from show_skin import VIEWS, camera

from jghand_engine.avatar.builtin import load_avatar_called
from jghand_engine.captures.capture_folder import FOREARM, open_capture
from jghand_engine.captures.known_light import load_groups, mix
from jghand_engine.captures.making.closing import Closing
from jghand_engine.captures.making.lights import FORMAT, GROUPS, LIGHTS_FILE, lights_bytes
from jghand_engine.captures.making.options import Sampling
from jghand_engine.captures.making.person_skin import PersonSkin
from jghand_engine.captures.making.plan import CapturePlan, drafted_mesh, read_plan, write_plan
from jghand_engine.captures.making.rig import RiggedHand, load_identity
from jghand_engine.captures.making.worker import fault_of, find_blender_python, render
from jghand_engine.captures.skin.person import Person
from jghand_engine.color import linear_to_srgb, to_bytes
from jghand_engine.errors import InputError
from jghand_engine.export.light_file import ENV_FROM_WORLD
from jghand_engine.export.pictures import Cell, SheetStyle, contact_sheet
from jghand_engine.learn.evaluate import AvatarPicturer
from jghand_engine.learn.metrics import compare
from jghand_engine.native.threads import processors
from jghand_engine.render.settings import preset

# W/m2 that each lamp gives to what faces it in the middle of the hand; a world gives 2 pi
IRRADIANCE = 2 * np.pi
# how far the lamps stand and how large they are, meters
AWAY_M, LAMP_M = 0.7, 0.2
# of the world, of the lamp on the palm's side, of that on the back's
WEIGHTS = (0.35, 1.0, 1.0)
# linear, behind the hand
BACKDROP = 0.045
LEVELS = 3


@dataclass(frozen=True)
class Options:
    """out: the sheet · work: folder of the pictures, a capture · avatar: a .jghand file or builtin, learned from
    captures of the identity and the person · size: of a picture, pixels · samples: rays per pixel · cell_px: width of
    a picture on the sheet"""

    work: Path
    out: Path = Path("docs/close_up.jpg")
    avatar: str = "builtin"
    identity: str = "adult_woman"
    person: Person = field(default_factory=Person)
    views: tuple[str, ...] = ("palm", "back", "knuckles", "fist", "pinch")
    size: str = "960x1080"
    samples: int = 24
    cell_px: int = 640


def main(options: Options) -> None:
    plan = opened(options)
    jobs = [job for job in plan.jobs(options.work) if fault_of(job)]
    for done in render(options.work, jobs, find_blender_python(), processors()):
        print(f"{done.job.file}: {done.seconds:.0f} s")
    draw = AvatarPicturer(load_avatar_called(options.avatar), preset("final"))
    truth, ours = [], []
    samples = {one.camera_name: one for one in open_capture(options.work).samples}
    for view, name in zip(options.views, sorted(samples), strict=True):
        picture = mix(load_groups(samples[name]), np.repeat(np.array(WEIGHTS)[:, None], 3, 1))
        rgba = draw.in_light(samples[name], picture.light)
        both = [
            to_bytes(linear_to_srgb(np.clip(picture.exposure * rgb + (1 - alpha[..., None]) * BACKDROP, 0, 1)))
            for rgb, alpha in ((picture.rgb, picture.alpha), (rgba[..., :3], rgba[..., 3]))
        ]
        psnr_db = compare(both[1] / 255, both[0] / 255, picture.alpha)["psnr_mask"]
        for cells, who, note, shown in (
            (truth, "Cycles", "", both[0]),
            (ours, "JGHand", f", {psnr_db:.1f} dB", both[1]),
        ):
            Image.fromarray(shown).save(options.work / f"{view}_{who}.png")
            cells.append(Cell(f"{view}, {who}{note}", shown))
    style = SheetStyle(len(truth), options.cell_px, gap_px=4, background=(1, 1, 1), ink=(0.1, 0.1, 0.1))
    Image.fromarray(contact_sheet([*truth, *ours], style)).save(options.out, quality=88)


def opened(options: Options) -> CapturePlan:
    """The plan of the folder, begun where there is none. InputError for one of other options."""
    plan, asked = read_plan(options.work), described(options)
    if plan is None:
        return begun(options)
    other = [name for name in asked if asked[name] != plan.description.get(name)]
    if other:
        raise InputError(
            f"the pictures in {options.work}",
            wanted="the options that they were begun with",
            came=f"another {', '.join(other)}",
            remedy="Give the same options, or another --work.",
        )
    return plan


def described(options: Options) -> dict[str, Any]:
    """The options that change what Cycles renders, as JSON has them."""
    return json.loads(
        json.dumps(
            {
                "identity": options.identity,
                "person": dataclasses.asdict(options.person),
                "views": options.views,
                "size": options.size,
                "samples": options.samples,
            }
        )
    )


def begun(options: Options) -> CapturePlan:
    """A capture of the views, each in the same light about the hand."""
    width, height = map(int, options.size.split("x"))
    hand = RiggedHand(load_identity(options.identity, forearm=True))
    skin, closing = PersonSkin.of(hand.identity, options.person, LEVELS), Closing(hand)
    names = sorted({VIEWS[view][0] for view in options.views})
    pose = hand.pose(np.stack([closing.closed(hand.angles_of(name)) for name in names]))
    sampling = dataclasses.asdict(Sampling(samples=options.samples, subdivisions=0))
    light = {"lights": LIGHTS_FILE, "skies": [], "shipped": ["studio"]}
    plan = CapturePlan(
        description=described(options),
        render={"sampling": sampling, "light": light, "skin": skin.material, FOREARM: True},
        pose_names=tuple(names),
        joints_m=pose.joints_m,
        vertices_m=hand.skin(pose).astype(np.float32),
        faces=skin.surface.faces,
        face_uv=skin.surface.face_uv.astype(np.float32),
        cameras=tuple(camera(view, names, pose.joints_m, (width, height)) for view in options.views),
        files=skin.files,
        person=skin,
        forearm=hand.forearm(pose),
    )
    pictures = {
        f"{number}/{name}": {
            "is_held_out": False,
            "world": {"picture": "worlds/studio.npy", "env_from_world": ENV_FROM_WORLD.tolist()},
            "lamps": [lamp(plan.joints_m[number].mean(0), side) for side in (1, -1)],
        }
        for number in range(len(names))
        for name in plan.cameras_of(number)
    }
    told = {"format": FORMAT, "primaries": "rec709", "up": "y", "groups": list(GROUPS), "pictures": pictures}
    plan = dataclasses.replace(plan, files={**plan.files, LIGHTS_FILE: lights_bytes(told)})
    with drafted_mesh(options.work, plan) as mesh:
        write_plan(options.work, plan, mesh)
    return plan


def lamp(middle_m: np.ndarray, side: int) -> dict[str, object]:
    """A small square one, high on the left of the palm's side (1), or of the back's (-1)."""
    towards = np.array([-0.5 * side, 0.65, 0.57 * side])
    towards /= np.linalg.norm(towards)
    across = np.cross(towards, [0.0, 1.0, 0.0])
    return {
        "kind": "area",
        "rgb": [IRRADIANCE * AWAY_M**2 / LAMP_M**2] * 3,
        "place_m": (middle_m + AWAY_M * towards).tolist(),
        "axis": (-towards).tolist(),
        "side": (across / np.linalg.norm(across)).tolist(),
        "size_m": [LAMP_M, LAMP_M],
        "is_ellipse": False,
        "spread_rad": float(np.pi),
    }


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
