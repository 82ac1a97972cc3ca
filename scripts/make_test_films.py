"""Makes films of a hand by the instructions for filming, with their truth, by the program that renders captures.

    python scripts/make_test_films.py --out films --films man woman      # 106 pictures and 40 held-out ones of each
    python scripts/make_test_films.py --out films --films man --every 2  # every second picture first; go on without it
    python scripts/make_test_films.py --out films --films man --size 96x160 --samples 2 --texels 256 --every 12

What is rendered is kept: the same command goes on. Of each film:

film.mp4     the hand with its forearm before a wall, noise, H.264
truth.npz    joints_m (F, 21, 3) level order, camera axes, meters; landmarks_px (F, 21, 2); mask (F, H, W) of the hand,
             arm_mask of hand and forearm; time_s (F,); focal_px; size_px; canonical_joints_m (21, 3) of this hand;
             gain (F,) of the exposure, linear: that of the pictures in capture/ is 1
capture/     the rendered pictures as a capture: its last ten poses are held out, each seen by four other cameras
NAME_FAULT/  with --faults: film.mp4 and truth.npz of the same film with a fault, see FAULTS
"""

from __future__ import annotations

import dataclasses
import io
import itertools
import json
import math
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import tyro
from PIL import Image, ImageDraw
from scipy.ndimage import gaussian_filter, map_coordinates

from jghand_engine.avatar.scene_light import World
from jghand_engine.captures.capture_folder import FOREARM
from jghand_engine.captures.making.cameras import PlannedCamera
from jghand_engine.captures.making.closing import Closing
from jghand_engine.captures.making.options import AreaLight, Light, Sampling
from jghand_engine.captures.making.person_skin import PersonSkin, png_bytes
from jghand_engine.captures.making.plan import FOLDER, CapturePlan, Job, annotate, drafted_mesh, read_plan, write_plan
from jghand_engine.captures.making.rig import METACARPAL_BASES, RIG_JOINTS, Identity, RiggedHand, RigPose, load_identity
from jghand_engine.captures.making.worker import fault_of, find_blender_python, find_program, render
from jghand_engine.captures.skin.canvas import MM, Texels
from jghand_engine.captures.skin.person import Person
from jghand_engine.captures.splits import SPLITS_FILE, SPLITS_FORMAT
from jghand_engine.color import linear_to_srgb, srgb_to_linear, to_bytes
from jghand_engine.export.light_file import ENV_FROM_WORLD, read_world_picture
from jghand_engine.export.video import write_video
from jghand_engine.files import writing
from jghand_engine.hand.orders import hand_length
from jghand_engine.hand.poses import minimum_jerk
from jghand_engine.hand.rotations import unit, vector_rotation
from jghand_engine.own.masks import wrist_side
from jghand_engine.render.camera import Camera
from jghand_engine.template.surface import vertex_normals

FPS = 7.5
# seconds, pose, and how the hand is turned by then: about the forearm, tips to the camera, in the picture's plane; deg.
# The flat palm for two seconds, a fist, over the thumb's side to the back, two seconds, a fist, tips to the camera and
# away, back to the palm
MOTION = (
    (0.0, "open", 0, 0, 0), (2.0, "open", 0, 0, 0), (2.8, "fist", 0, 0, 0), (3.0, "fist", 0, 0, 0),
    (3.8, "open", 0, 0, 0), (6.8, "open", -180, 0, 0), (8.8, "open", -180, 0, 0), (9.6, "fist", -180, 0, 0),
    (9.8, "fist", -180, 0, 0), (10.6, "open", -180, 0, 0), (11.2, "open", -180, 20, 0), (12.0, "open", -180, -20, 0),
    (12.5, "open", -180, 0, 0), (14.0, "open", 0, 0, 0),
)  # fmt: skip
# what people add to that: of each pose, degrees of its angles and turns; and all the time, as (rate in Hz, meters,
# degrees): they sway, and their muscles tremble
POSE_SIGMA_DEG, TURN_SIGMA_DEG = 4.0, 5.0
UNREST = ((0.23, 0.006, 2.0), (0.9, 0.0015, 0.6), (8.7, 0.0003, 0.2))
# the largest delay of a finger, as a part of a move
FINGER_DELAY = 0.2
# standard deviations of the logarithm of bones' lengths, and of bumps of the skin (meters, and how far they reach)
BONE_SIGMA, BUMP_M, BUMP_REACH_M, BUMPS = 0.05, 0.0006, 0.012, 60
# the forearm is so many times as long as that of captures from here on, meters behind the wrist: nobody sees its end
ARM_LONGER, ARM_FROM_M = 3.4, 0.03
# how long the hand is for the picture's height, and how far below its middle the palm is
HAND_PART, BELOW_PART = 0.45, 0.06
# held out: pose, and turns like those of MOTION
HELD_OUT = (
    ("point", 20, 0, 0), ("victory", 160, 5, 0), ("ok", 60, 0, 5), ("grasp", -20, 10, 0), ("claw", 140, -10, 0),
    ("call", 190, 0, 0), ("open", 0, 0, 0), ("fist", 175, 5, 0), ("relaxed", 90, 0, 0), ("spread", -10, 0, 0),
)  # fmt: skip
# its cameras: degrees around the hand and above, meters away, pixels (for the height of the film's) and hand's lengths
VIEWS_DEG, VIEW_AWAY_M, VIEW_PX, VIEW_PART = ((0, 0), (50, 15), (-65, -10), (180, 10)), 0.5, (3 / 8, 1 / 2), 1.5
# of the mesh: an edge is about a pixel
LEVELS = 2
# joints of the middle of the palm
_PALM = [0, 2, 3, 4, 5]
# a film's camera: at the origin, along -z, y up
_CAMERA_FROM_WORLD = np.diag([1.0, -1.0, -1.0])
_WALL_SIZE = 1.25
# the wall lights the hand: how far behind it it stands, and from its middle to its edges; the room goes on from there
WALL_BEHIND_M, WALL_EDGE_M = 0.8, 2.0
# what lights the hand from afar, a file of the plan
ROOM = "light.hdr"
# standard deviation of a telephone's lens and of the smoothing of its picture, pixels
LENS_PX = 0.6


@dataclass(frozen=True)
class Film:
    """identity: of captures, then changed · angle_deg: of view, along the longer edge · wall: linear color of the
    background · gain: of the exposure · noise: standard deviation, of 255 · tattoo_mm, mole_mm: half their sizes"""

    identity: str
    person: Person
    light: Light
    angle_deg: float
    wall: tuple[float, float, float]
    seed: int
    gain: float = 1.0
    noise: float = 2.2
    tattoo_mm: float = 6.0
    mole_mm: float = 1.8


FILMS = {
    "woman": Film(
        "slim_woman", Person(melanin=0.16, age=0.35, freckles=0.5, seed=21),
        Light("courtyard", 0.35, 40.0, (AreaLight((-1.0, 0.35, 0.15), 0.9, 22.0, (0.93, 0.97, 1.0)),)),
        66.0, (0.30, 0.36, 0.42), 1,
    ),
    "man": Film(
        "adult_man", Person(melanin=0.80, age=0.5, dryness=0.55, seed=22),
        Light("interior", 1.1, 35.0, (
            AreaLight((-0.55, 0.45, -0.05), 0.5, 3.5, (1.0, 0.96, 0.9)),
            AreaLight((0.5, 0.3, -0.7), 0.6, 1.5, (0.9, 0.95, 1.0)),
        )),
        68.0, (0.42, 0.44, 0.40), 2,
    ),
    "old": Film(
        "old_person", Person(melanin=0.26, age=0.95, freckles=0.4, seed=23),
        Light("forest", 0.35, 0.0, (AreaLight((-1.8, 1.1, 0.4), 0.02, 85.0, (1.0, 0.94, 0.85)),)),
        70.0, (0.22, 0.30, 0.24), 3,
    ),
    "child": Film(
        "child", Person(melanin=0.10, age=0.0, blood=0.5, seed=24),
        Light("night", 0.9, 0.0, (AreaLight((0.6, 0.7, 0.1), 0.25, 5.0, (1.0, 0.82, 0.62)),)),
        63.0, (0.26, 0.22, 0.20), 4, gain=0.55, noise=8.0, tattoo_mm=4.0, mole_mm=1.3,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Options:
    """size: of the film's pictures · samples: rays per pixel · texels: along an edge of the maps of the skin
    every: only each so many-th picture is rendered and shown · held_out: also the pictures of other poses
    faults: also the films with a fault"""

    out: Path
    films: tuple[str, ...] = tuple(FILMS)
    size: str = "360x640"
    samples: int = 8
    texels: int = 1024
    every: int = 1
    threads: int = 1
    held_out: bool = True
    faults: bool = False


def main(options: Options) -> None:
    for name in options.films:
        film, folder = FILMS[name], options.out / name / "capture"
        plan = open_plan(film, folder, options)
        jobs = plan.jobs(folder)
        filmed = [job for job in jobs if job.pose < _film_count(plan) and job.pose % options.every == 0]
        held_out = [job for job in jobs if job.pose >= _film_count(plan) and options.held_out]
        render_missing(folder, filmed, options.threads)
        shown = pictures_of(plan, filmed, film)
        write_film(options.out / name, shown, film, FPS / options.every)
        for fault, change in FAULTS.items() if options.faults else ():
            write_film(options.out / f"{name}_{fault}", change(shown), film, FPS / options.every)
        render_missing(folder, held_out, options.threads)
        annotate(folder, plan, {job.pose for job in filmed + held_out})


# ---- whose hand ------------------------------------------------------------------------------------------------------


def another(identity: Identity, seed: int) -> Identity:
    """The same person with other bones, an uneven skin and a long forearm."""
    random = np.random.default_rng(seed)
    factors = np.exp(BONE_SIGMA * random.standard_normal(RIG_JOINTS).clip(-2, 2))
    hand = with_bones(identity, factors)
    normals = vertex_normals(hand.vertices_m, hand.faces)
    places = hand.vertices_m[random.choice(len(hand.vertices_m), BUMPS)]
    near = np.exp(-np.square(hand.vertices_m[:, None] - places).sum(-1) / (2 * BUMP_REACH_M**2))
    bumps = (near @ (BUMP_M * random.standard_normal(BUMPS))).clip(-2 * BUMP_M, 2 * BUMP_M)
    vertices = hand.vertices_m + bumps[:, None] * normals
    behind = np.minimum(vertices[:, 1] + ARM_FROM_M, 0)
    vertices[:, 1] += (ARM_LONGER - 1) * behind
    return replace(hand, vertices_m=vertices)


def with_bones(identity: Identity, factors: np.ndarray) -> Identity:
    """Bones so many times as long (25,), of the bone that ends at each joint; the skin goes along by the rig's weights,
    stretched along each bone."""
    joints, skin = identity.joints25_m, identity.vertices_m
    placed, moved = joints.copy(), np.zeros_like(skin)
    for joint in range(1, RIG_JOINTS):
        placed[joint] = placed[_parent(joint)] + factors[joint] * (joints[joint] - joints[_parent(joint)])
    for joint in range(RIG_JOINTS):
        there = skin + placed[joint] - joints[joint]
        # the wrist has many children, a tip has none
        if joint and _parent(joint + 1) == joint:
            bone = unit(joints[joint + 1] - joints[joint])
            there = there + (factors[joint + 1] - 1) * ((skin - joints[joint]) @ bone)[:, None] * bone
        moved += identity.weights25[:, joint : joint + 1] * there
    return replace(identity, vertices_m=moved, joints25_m=placed)


def _parent(joint: int) -> int:
    """In the rig; of the thumb's first bone and of metacarpals the wrist."""
    return 0 if joint in (1, *METACARPAL_BASES, RIG_JOINTS) else joint - 1


def with_marks(skin: PersonSkin, hand: Identity, film: Film, texels: int) -> PersonSkin:
    """A tattoo on the back, a cross in a ring, and a mole on the ball of the thumb."""
    on, joints = Texels.of(hand, texels), hand.joints_m / MM
    rgb = np.array(Image.open(io.BytesIO(skin.files["skin.png"])))

    def from_mark(place: np.ndarray, side: float) -> np.ndarray:
        """(N, 3) mm from where a place in the hand shows on its palm (1) or its back (-1)."""
        across = np.linalg.norm((on.point - place)[:, :2], axis=1)
        on_side = np.where(side * on.normal[:, 2] > 0.3, across, np.inf)
        return on.point - on.point[on_side.argmin()]

    def paint(where: np.ndarray, color: tuple[int, int, int]) -> None:
        row, column = np.nonzero(on.covered)
        rgb[row[where], column[where]] = color

    offset, size = from_mark(0.35 * joints[3] + 0.35 * joints[4] + 0.3 * joints[0], -1.0), film.tattoo_mm
    away, line = np.linalg.norm(offset, axis=1), 0.1 * size
    cross = np.abs(np.abs(offset[:, 0]) - np.abs(offset[:, 1])) < 1.4 * line
    paint((np.abs(away - size) < line) | (cross & (away < 0.7 * size)), (22, 40, 48))
    paint(np.linalg.norm(from_mark(0.5 * joints[1] + 0.5 * joints[6], 1.0), axis=1) < film.mole_mm, (58, 30, 22))
    return replace(skin, files={**skin.files, "skin.png": png_bytes(rgb)})


# ---- how it moves ----------------------------------------------------------------------------------------------------


def motion(hand: RiggedHand, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """MOTION of this hand at FPS: times (F,), angles (F, 5, 4), turns (F, 3); degrees."""
    random, closing = np.random.default_rng((seed, 1)), Closing(hand)
    own = POSE_SIGMA_DEG * random.standard_normal((5, 4))
    # a pose that is held stays the same
    kinds = {key[1:]: None for key in MOTION}
    angles = {kind: hand.angles_of(kind[0]) + own + 0.3 * own.std() * random.standard_normal((5, 4)) for kind in kinds}
    angles = {kind: closing.closed(one) if kind[0] == "fist" else one for kind, one in angles.items()}
    turns = {kind: np.array(kind[1:]) + TURN_SIGMA_DEG * random.standard_normal(3) for kind in kinds}
    starts = np.array([key[0] for key in MOTION])
    times = np.arange(round(starts[-1] * FPS) + 1) / FPS
    after = np.clip(np.searchsorted(starts, times, side="right"), 1, len(MOTION) - 1)
    delays = random.uniform(0, FINGER_DELAY, (len(MOTION), 5, 1))
    posed, turned = [], []
    for time, end in zip(times, after, strict=True):
        before, behind = MOTION[end - 1][1:], MOTION[end][1:]
        part = (time - starts[end - 1]) / (starts[end] - starts[end - 1])
        moved = minimum_jerk((part - delays[end]) / (1 - delays[end]))
        posed.append(angles[before] + (angles[behind] - angles[before]) * moved)
        turned.append(turns[before] + (turns[behind] - turns[before]) * minimum_jerk(np.array(part)))
    return times, np.stack(posed), np.stack(turned)


def unrest(times: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(F, 3) meters and (F, 3) degrees by which a hand that is held still moves."""
    random = np.random.default_rng((seed, 2))
    waves = [
        np.sin(2 * math.pi * (rate * random.uniform(0.8, 1.25, 6) * times[:, None] + random.random(6)))
        for rate, _, _ in UNREST
    ]
    way = sum(size_m * wave[:, :3] for wave, (_, size_m, _) in zip(waves, UNREST, strict=True))
    turn = sum(size_deg * wave[:, 3:] for wave, (_, _, size_deg) in zip(waves, UNREST, strict=True))
    return np.asarray(way), np.asarray(turn)


def placed(hand: RiggedHand, angles: np.ndarray, turns_deg: np.ndarray, middle_m: np.ndarray) -> RigPose:
    """The hand in poses (P, 5, 4), turned by (P, 3) about the middle of its palm, which is at middle_m (P, 3)."""
    about_forearm, tips, roll = (np.radians(turns_deg[:, [k]]) * np.eye(3)[axis] for k, axis in enumerate((1, 0, 2)))
    turn = vector_rotation(roll) @ vector_rotation(tips) @ vector_rotation(about_forearm)
    palm = hand.identity.joints_m[_PALM].mean(0)
    pose = hand.pose(angles).moved(turn, palm)
    return RigPose(pose.turn, pose.joints25_m + (middle_m - palm)[:, None])


# ---- what is rendered ------------------------------------------------------------------------------------------------


def open_plan(film: Film, folder: Path, options: Options) -> CapturePlan:
    """The plan that is there, else a new one. SystemExit for one of another film."""
    about = {"film": dataclasses.asdict(film), "size": options.size, "samples": options.samples, "maps": options.texels}
    about["wall_m"] = (WALL_BEHIND_M, WALL_EDGE_M)
    about = json.loads(json.dumps(about))
    plan = read_plan(folder)
    if plan is None:
        plan = make_plan(film, options, about)
        with drafted_mesh(folder, plan) as mesh:
            write_plan(folder, plan, mesh)
        split = {
            "format": SPLITS_FORMAT,
            "test_frames": {plan.record.sequence: [k for k, name in enumerate(plan.pose_names) if not _is_film(name)]},
            "test_cameras": [name for k in range(len(HELD_OUT)) for name in plan.cameras_of(_film_count(plan) + k)],
        }
        with writing(folder / SPLITS_FILE) as path:
            path.write_text(json.dumps(split) + "\n", encoding="utf-8")
    if plan.description != about:
        raise SystemExit(f"{folder / FOLDER} is of another film: give the same options, or another --out.")
    return plan


def make_plan(film: Film, options: Options, about: dict) -> CapturePlan:
    width, height = map(int, options.size.split("x"))
    identity = another(load_identity(film.identity, forearm=True), film.seed)
    hand = RiggedHand(identity)
    times, angles, turns = motion(hand, film.seed)
    way, sway = unrest(times, film.seed)
    focal = height / (2 * math.tan(math.radians(film.angle_deg) / 2))
    away = focal * hand_length(identity.joints_m) / (HAND_PART * height)
    middle = np.array([0.0, -BELOW_PART * height * away / focal, -away])
    filmed = placed(hand, angles, turns + sway, middle + way)
    closing = Closing(hand)
    others = np.stack([closing.closed(hand.angles_of(name)) for name, *_ in HELD_OUT])
    held = placed(hand, others, np.array([turn for _, *turn in HELD_OUT], float), np.tile(middle, (len(HELD_OUT), 1)))
    pose = RigPose(*(np.concatenate(pair) for pair in ((filmed.turn, held.turn), (filmed.joints25_m, held.joints25_m))))
    skin = PersonSkin.of(identity, film.person, LEVELS, options.texels)
    skin = with_marks(skin, identity, film, options.texels)
    sampling = dataclasses.asdict(Sampling(samples=options.samples, subdivisions=0))
    light = {**dataclasses.asdict(film.light), "hdri": ROOM}
    told = {"sampling": sampling, "light": light, "skin": skin.material, FOREARM: True}
    still = np.eye(4)
    still[:3, :3] = _CAMERA_FROM_WORLD
    camera = Camera(width, height, focal, focal, width / 2, height / 2, still)
    cameras = [PlannedCamera(camera, frame) for frame in range(len(times))]
    size, length_m = [round(part * height) for part in VIEW_PX], hand_length(identity.joints_m)
    target, up, away = middle + np.array([0.0, 0.1 * length_m, 0.0]), (0.0, 1.0, 0.0), VIEW_AWAY_M
    for number, (around, above) in itertools.product(range(len(HELD_OUT)), np.radians(VIEWS_DEG)):
        out = np.array([math.sin(around) * math.cos(above), math.sin(above), math.cos(around) * math.cos(above)])
        focal_px = size[1] * away / (VIEW_PART * length_m)
        seen = Camera.looking_at(target + away * out, target, up, width=size[0], height=size[1], focal_px=focal_px)
        cameras.append(PlannedCamera(seen, len(times) + number))
    files = {**skin.files, ROOM: lit_by(film, focal, middle, (width, height))}
    names = (*(f"film {time:.3f} s" for time in times), *(f"held out {name}" for name, *_ in HELD_OUT))
    # what was told is compared with what is read again
    return CapturePlan(
        about, json.loads(json.dumps(told)), names, pose.joints_m, hand.skin(pose).astype(np.float32),
        skin.surface.faces, skin.surface.face_uv.astype(np.float32), tuple(cameras), files, skin,
        hand.forearm(pose),
    )  # fmt: skip


def _is_film(name: str) -> bool:
    return name.startswith("film ")


def _film_count(plan: CapturePlan) -> int:
    return sum(map(_is_film, plan.pose_names))


def render_missing(folder: Path, jobs: Sequence[Job], threads: int) -> None:
    missing = [job for job in jobs if fault_of(job)]
    for done, finished in enumerate(render(folder, missing, find_blender_python(), threads), 1):
        print(f"{folder.parent.name} {done}/{len(missing)}: {finished.cpu_seconds:.1f} CPU s", flush=True)


# ---- the film --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Shown:
    """What is seen. rgba (F, H, W, 4) uint8, straight alpha · wall (h, w, 3) linear, larger than the picture
    turn (F, 3, 3) from where directions were to where they are, for a camera that turns · gain (F,) of the exposure"""

    rgba: np.ndarray
    wall: np.ndarray
    joints_m: np.ndarray
    time_s: np.ndarray
    turn: np.ndarray
    gain: np.ndarray
    focal_px: float
    canonical_joints_m: np.ndarray


def pictures_of(plan: CapturePlan, jobs: Sequence[Job], film: Film) -> Shown:
    """The film's pictures as they were rendered."""
    rgba = np.stack([np.asarray(Image.open(job.file)) for job in jobs])
    frames = [job.pose for job in jobs]
    camera = plan.cameras[0].camera
    identity = another(load_identity(film.identity, forearm=True), film.seed)
    return Shown(
        rgba, wall(film, (camera.width, camera.height)), plan.joints_m[frames] @ _CAMERA_FROM_WORLD,
        np.array(frames) / FPS, np.tile(np.eye(3), (len(frames), 1, 1)), np.full(len(frames), film.gain), camera.fx,
        identity.joints_m,
    )  # fmt: skip


def wall(film: Film, size: tuple[int, int]) -> np.ndarray:
    """(h, w, 3) linear: a wall that is not even, with a picture and a shelf on it, a little out of focus."""
    random = np.random.default_rng((film.seed, 3))
    width, height = (round(_WALL_SIZE * edge) for edge in size)
    y, x = np.mgrid[:height, :width] / height
    shade = 1 + 0.35 * (random.random() - x) + 0.25 * (0.5 - y)
    for cell in (0.2, 0.04, 0.008):
        shade = shade * (1 + 0.05 * _smooth_noise((height, width), cell * height, random))
    picture = Image.fromarray(to_bytes(linear_to_srgb(np.clip(shade[..., None] * film.wall, 0, 1))))
    draw = ImageDraw.Draw(picture)

    def box(left: float, top: float, wide: float, high: float, rgb: tuple[int, ...]) -> None:
        draw.rectangle([height * left, height * top, height * (left + wide), height * (top + high)], rgb)

    def color(low: int, high: int) -> tuple[int, ...]:
        return tuple(int(value) for value in random.integers(low, high, 3))

    box(0.05, 0.08, 0.16, 0.22, color(20, 60))
    box(0.065, 0.095, 0.13, 0.19, color(120, 200))
    box(0.085, 0.15, 0.06, 0.08, color(60, 140))
    left = 0.33
    while left < width / height:
        wide, high = random.uniform(0.015, 0.04), random.uniform(0.1, 0.16)
        box(left, 0.36 - high, wide, high, color(30, 150))
        left += wide + 0.004
    box(0.32, 0.36, 0.3, 0.012, (70, 55, 45))
    sharp = srgb_to_linear(np.asarray(picture, np.float64) / 255)
    return gaussian_filter(sharp, (0.003 * height, 0.003 * height, 0))


def lit_by(film: Film, focal_px: float, middle_m: np.ndarray, size: tuple[int, int]) -> bytes:
    """A file of what lights the hand from afar: the film's environment with its wall in it."""
    turn = vector_rotation(np.array([0, 0, math.radians(film.light.hdri_turn_deg)]))
    around = World(read_world_picture(shipped_environment(film.light.hdri)), turn @ ENV_FROM_WORLD)
    # the capture makes all of it as strong as the environment
    radiance = room(around, wall(film, size) / film.light.hdri_strength, focal_px, middle_m)
    done, file = cv2.imencode(Path(ROOM).suffix, radiance[..., ::-1].astype(np.float32))
    assert done
    return file.tobytes()


def room(around: World, shown: np.ndarray, focal_px: float, middle_m: np.ndarray) -> np.ndarray:
    """(H, W, 3) of an environment, a wall in it as the hand at middle_m (3,) sees it. shown: (h, w, 3) as the camera at
    the origin sees it; farther out it is like its edges"""
    direction, _ = around.samples
    far_m = WALL_BEHIND_M / np.maximum(-direction[..., 2], 1e-6)
    point = middle_m + far_m[..., None] * direction
    across, down = (focal_px * point[..., axis] / point[..., 2] for axis in (0, 1))
    at = [shown.shape[0] / 2 - 0.5 + down, shown.shape[1] / 2 - 0.5 - across]
    seen = np.stack([map_coordinates(shown[..., k], at, order=1, mode="nearest") for k in range(3)], -1)
    is_wall = (np.abs(point[..., :2]) < WALL_EDGE_M).all(-1) & (direction[..., 2] < 0)
    return np.where(is_wall[..., None], seen, around.radiance)


def shipped_environment(name: str) -> Path:
    """The file of an environment that comes with Blender, as captures find it."""
    # the folder of captures as a package of its own, as in its __main__.py
    code = "import sys; sys.path.insert(0, sys.argv[1]); from capture import scene"
    code += "; print(scene.shipped_environment(sys.argv[2]))"
    command = [find_blender_python(), "-c", code, find_program().parents[1], name]
    told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return Path(told.splitlines()[-1])


def _smooth_noise(shape: tuple[int, int], cell: float, random: np.random.Generator) -> np.ndarray:
    field = gaussian_filter(random.standard_normal(shape), cell, mode="wrap")
    return field / field.std()


def seen(shown: Shown, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) sRGB 0..1 without noise, and (H, W) alpha of what is before the wall."""
    height, width = shown.rgba.shape[1:3]
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    ray = np.stack([x / shown.focal_px, y / shown.focal_px, np.ones_like(x)], -1) @ shown.turn[frame]
    column, row = (shown.focal_px * ray[..., k] / ray[..., 2] for k in (0, 1))

    def looked_up(values: np.ndarray) -> np.ndarray:
        # the arm goes on below the picture
        at = [row + values.shape[0] / 2 - 0.5, column + values.shape[1] / 2 - 0.5]
        planes = [map_coordinates(values[..., k], at, order=1, mode="nearest") for k in range(values.shape[-1])]
        return np.stack(planes, -1)

    rgba = shown.rgba[frame] / np.float64(255)
    premultiplied = np.concatenate([srgb_to_linear(rgba[..., :3]) * rgba[..., 3:], rgba[..., 3:]], -1)
    hand, behind = looked_up(premultiplied), looked_up(shown.wall)
    hand = gaussian_filter(hand, (LENS_PX, LENS_PX, 0))
    flat = hand[..., :3] + (1 - hand[..., 3:]) * behind
    return linear_to_srgb(np.clip(shown.gain[frame] * flat, 0, 1)), hand[..., 3]


def write_film(folder: Path, shown: Shown, film: Film, fps: float) -> None:
    """film.mp4 and truth.npz."""
    random = np.random.default_rng((film.seed, 4))
    height, width = shown.rgba.shape[1:3]
    joints = shown.joints_m @ np.swapaxes(shown.turn, -1, -2)
    landmarks = _pixels(joints, shown)
    pictures, masks = [], []
    for frame in range(len(shown.time_s)):
        rgb, alpha = seen(shown, frame)
        pictures.append(to_bytes(np.clip(rgb + film.noise / 255 * random.standard_normal(rgb.shape), 0, 1)))
        masks.append(alpha >= 0.5)
    folder.mkdir(parents=True, exist_ok=True)
    # a new film is another file, not a refusal
    (folder / "film.mp4").unlink(missing_ok=True)
    write_video(folder / "film.mp4", pictures, fps)
    arm = np.stack(masks)
    with writing(folder / "truth.npz") as path, open(path, "wb") as stream:
        np.savez_compressed(
            stream, joints_m=joints, landmarks_px=landmarks, arm_mask=arm, time_s=shown.time_s,
            mask=arm & wrist_side(landmarks, width, height),
            focal_px=shown.focal_px, size_px=(width, height), gain=shown.gain, handedness="right",
            canonical_joints_m=shown.canonical_joints_m,
        )  # fmt: skip


def _pixels(joints_m: np.ndarray, shown: Shown) -> np.ndarray:
    height, width = shown.rgba.shape[1:3]
    return shown.focal_px * joints_m[..., :2] / joints_m[..., 2:] + np.array([width / 2, height / 2])


# ---- faults ----------------------------------------------------------------------------------------------------------


def moving_camera(shown: Shown) -> Shown:
    """Held in the other hand: it turns by some degrees."""
    _, sway = unrest(shown.time_s, 5)
    return replace(shown, turn=vector_rotation(np.radians(sway)))


def no_hand(shown: Shown) -> Shown:
    return replace(shown, rgba=np.zeros_like(shown.rgba))


def two_hands(shown: Shown) -> Shown:
    """The other one, behind this one and lower, does what this one will do."""
    count, height, width = shown.rgba.shape[:3]
    down, aside = round(0.15 * height), round(0.3 * width)
    far = np.zeros_like(shown.rgba)
    far[:, down:, : width - aside] = np.roll(shown.rgba[:, :, ::-1], count // 3, axis=0)[:, : height - down, aside:]
    return replace(shown, rgba=np.where(shown.rgba[..., 3:] < 128, far, shown.rgba))


def back_never_seen(shown: Shown) -> Shown:
    """The frames in which the palm looks to the camera."""
    across = np.cross(shown.joints_m[:, 2] - shown.joints_m[:, 0], shown.joints_m[:, 5] - shown.joints_m[:, 0])
    palm = unit(across)[:, 2] < -0.5
    kept = {name: getattr(shown, name)[palm] for name in ("rgba", "joints_m", "turn", "gain")}
    return replace(shown, time_s=shown.time_s[: palm.sum()], **kept)


def burnt_out(shown: Shown) -> Shown:
    return replace(shown, gain=2.5 * shown.gain)


def exposure(shown: Shown) -> Shown:
    """It follows what is in the middle of the picture."""
    return replace(shown, gain=shown.gain * 2 ** (0.5 * np.sin(0.9 * shown.time_s)))


def sleeve(shown: Shown) -> Shown:
    """Striped cloth from a third of the palm's length behind the wrist on."""
    pixels = _pixels(shown.joints_m, shown)
    height, width = shown.rgba.shape[1:3]
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    clothed = shown.rgba.copy()
    for picture, joints in zip(clothed, pixels, strict=True):
        palm = joints[0] - joints[2:6].mean(0)
        along = ((np.stack([x, y], -1) - joints[0]) @ palm) / (palm @ palm)
        cloth = np.where(np.sin(40 * along)[..., None] > 0, (60, 75, 130), (150, 150, 155))
        shade = picture[..., :3].mean(-1, keepdims=True) / picture[(along > 0) & (picture[..., 3] > 127), :3].mean()
        picture[..., :3] = np.where((along > 0.33)[..., None], np.clip(cloth * shade, 0, 255), picture[..., :3])
    return replace(shown, rgba=clothed)


FAULTS: dict[str, Callable[[Shown], Shown]] = {
    one.__name__: one for one in (moving_camera, no_hand, two_hands, back_never_seen, burnt_out, exposure, sleeve)
}


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
