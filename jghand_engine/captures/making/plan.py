"""The plan of a capture: every hand, camera and light before the first ray, and the same again from its folder.

plan/plan.json     options, cameras, names of poses, what the worker needs to know
plan/hands.npz     vertices_m (P, V, 3) of the rig, joints_m (P, 21, 3) level order, faces, face_uv, and
                   forearm (P, 4), see `HandPose`; captures of before have none
plan/skin.png …    the skin, mesh.npy with it: see person_skin.py
plan/light.exr or .hdr   the environment, when it is a file of the user's
plan/lights.json, worlds/   the light of every image, when it varies (lights.py)
plan/made_by.json  which programs make the images    written by the first of them that is ready (worker.py)
annotations/…      InterHand2.6M, splits.json          written with the plan, so that any shard may be the first
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import tempfile
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.captures.capture_folder import FOREARM, HANDS_FILE, PLAN_FILE
from jghand_engine.captures.interhand_writer import RecordedHand, write_interhand
from jghand_engine.captures.making.cameras import PlannedCamera, plan_cameras
from jghand_engine.captures.making.close_ups import plan_close_ups
from jghand_engine.captures.making.closing import Closing
from jghand_engine.captures.making.lights import LIGHTS_FILE, VariedLight, lights_bytes, plan_lights
from jghand_engine.captures.making.options import CaptureOptions, Light, is_file
from jghand_engine.captures.making.person_skin import HAIR_FILE, MESH_FILE, PERSON_FILES, PersonSkin
from jghand_engine.captures.making.poses import varied_poses
from jghand_engine.captures.making.rig import RiggedHand, RigPose, identity_name, load_identity
from jghand_engine.captures.skin.person import Person
from jghand_engine.captures.splits import SPLITS_FILE, SPLITS_FORMAT
from jghand_engine.errors import InputError
from jghand_engine.files import file_error, make_folder, read_bytes, sync, write_file, writing
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.rotations import axis_rotation
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.lock import locked
from jghand_engine.npz_files import read_arrays
from jghand_engine.render.camera import Camera
from jghand_engine.template.builtin import load_fields

# every fifth pose, one of six cameras that see all, and every seventh close-up are kept for the test. Seven has no
# factor with the parts that close-ups show by turns, nor with the usual numbers of them in a pose
EVERY_POSE = 5
EVERY_CAMERA = 6
EVERY_CLOSE_UP = 7

FORMAT = 1
FOLDER = PLAN_FILE.parent
# waiting for another process that is just writing the plan, seconds: it needs some on a slow disk
LOCK_WAIT_S = 30.0
# arrays of hands.npz, which are fields of the plan
HANDS_ARRAYS = ("vertices_m", "joints_m", "faces", "face_uv")
# of hands.npz unpacked: 100 MB are the rig in as many poses as there may be, 40 MB the finest mesh's faces
HANDS_BYTES_MAX = 256 * 2**20
# joints of the middle of the palm, about which hands turn
_PALM = (0, 2, 3, 4, 5)
_FIRST_SERIAL = 400000


@dataclass(frozen=True)
class Job:
    """One image: which pose and camera, where it goes, width and height, the stamp that it must carry, and its entry in
    lights.json, or '' where the light does not vary."""

    pose: int
    camera: int
    file: Path
    size_px: tuple[int, int]
    stamp: str
    light: str = ""


@dataclass(frozen=True)
class CapturePlan:
    """Everything of a capture but its images.

    description: of the options, JSON
    render:      what the worker is told, JSON
    pose_names:  (P)
    joints_m:    (P, 21, 3) level order, world, meters
    vertices_m:  (P, V, 3) float32 of the rig, world, meters
    faces:       (F, 3) of what is rendered, finer than the rig's
    face_uv:     (F, 3, 2) float32
    cameras:     those that see all poses, then close-ups, which see one
    files:       name -> bytes, of the skin, of an environment that is the user's, of lights that vary and of skies
    person:      makes the fine mesh of a new plan; None where it is made
    forearm:     (P, 4) how the forearm is turned, see `HandPose`; None: not known
    """

    description: dict[str, Any]
    render: dict[str, Any]
    pose_names: tuple[str, ...]
    joints_m: np.ndarray
    vertices_m: np.ndarray
    faces: np.ndarray
    face_uv: np.ndarray
    cameras: tuple[PlannedCamera, ...]
    files: dict[str, bytes]
    person: PersonSkin | None = None
    forearm: np.ndarray | None = None

    @property
    def hand_vertices_m(self) -> np.ndarray:
        """(P, V, 3) of the hand alone, without its forearm."""
        return _of_hand(self.vertices_m)

    @cached_property
    def record(self) -> RecordedHand:
        """The capture as InterHand2.6M sees it."""
        cameras = {str(_FIRST_SERIAL + number): planned.camera for number, planned in enumerate(self.cameras)}
        boxes = {
            (pose, name): _box(camera, self.hand_vertices_m[pose])
            for pose in range(len(self.joints_m))
            for name, camera in self.cameras_of(pose).items()
        }
        return RecordedHand(cameras, dict(enumerate(self.joints_m)), boxes)

    def cameras_of(self, pose: int) -> dict[str, Camera]:
        """Those that see a pose, by name."""
        return {
            str(_FIRST_SERIAL + number): planned.camera
            for number, planned in enumerate(self.cameras)
            if planned.pose in (None, pose)
        }

    def jobs(self, folder: Path, shard: tuple[int, int] = (1, 1)) -> list[Job]:
        """The images of a shard (number from 1, of how many): whole poses, all cameras of each."""
        number, count = shard
        record = self.record
        return [
            Job(
                pose, int(name) - _FIRST_SERIAL, record.image(folder, pose, name), (camera.width, camera.height),
                self.stamp(pose, int(name) - _FIRST_SERIAL), f"{pose}/{name}" if LIGHTS_FILE in self.files else "",
            )
            for pose in range(number - 1, len(self.joints_m), count)
            for name, camera in self.cameras_of(pose).items()
        ]  # fmt: skip

    def stamp(self, pose: int, camera: int) -> str:
        """A hash of everything that decides one image."""
        digest = self._shared.copy()
        digest.update(json.dumps(_camera_json(self.cameras[camera])).encode())
        digest.update(np.ascontiguousarray(self.vertices_m[pose]).tobytes())
        # they say how bent the skin is
        digest.update(np.ascontiguousarray(self.joints_m[pose]).tobytes())
        return digest.hexdigest()[:32]

    @cached_property
    def _shared(self) -> hashlib._Hash:
        digest = hashlib.sha256(f"{FORMAT} {json.dumps(self.render, sort_keys=True)}".encode())
        for name in sorted(self.files):
            digest.update(self.files[name])
        digest.update(np.ascontiguousarray(self.faces).tobytes() + np.ascontiguousarray(self.face_uv).tobytes())
        return digest

    def split(self) -> dict[str, Any]:
        """Which poses, cameras and lights are kept for the test; see captures/splits.py."""
        frames = list(range(len(self.joints_m)))
        names = list(self.record.cameras)
        close_ups = [name for name, planned in zip(names, self.cameras, strict=True) if planned.pose is not None]
        whole = names[: len(names) - len(close_ups)]
        tests = len(whole) // EVERY_CAMERA
        chosen = {whole[int((k + 0.5) * len(whole) / tests)] for k in range(tests)}
        chosen.update(close_ups[EVERY_CLOSE_UP // 2 :: EVERY_CLOSE_UP])
        test_frames = frames[EVERY_POSE - 1 :: EVERY_POSE]
        # the camera of a close-up sees one pose: where that is not learned, neither is the camera
        chosen.update(name for name, planned in zip(names, self.cameras, strict=True) if planned.pose in test_frames)
        split = {
            "format": SPLITS_FORMAT, "test_frames": {self.record.sequence: test_frames}, "test_cameras": sorted(chosen)
        }  # fmt: skip
        if LIGHTS_FILE not in self.files:
            return split
        pictures = json.loads(self.files[LIGHTS_FILE])["pictures"]
        held_out = [key for key, picture in pictures.items() if picture["is_held_out"]]
        return {**split, "test_lights": {self.record.sequence: held_out}}


def make_plan(options: CaptureOptions) -> CapturePlan:
    """Everything of a capture but its images. InputError for options that cannot be."""
    options.check()
    hand = RiggedHand(load_identity(options.identity, forearm=True))
    if options.motion is None:
        poses, closing = varied_poses(hand, options.poses, options.seed), Closing(hand)
        names, posed = poses.names, hand.pose(np.stack([closing.closed(angles) for angles in poses.angles_deg]))
    else:
        names, posed = _of_motion(hand, options.motion, options.poses)
    turns = wrist_turns(len(names), options.wrist_turn_deg, options.seed)
    posed = posed.moved(turns, hand.identity.joints_m[list(_PALM)].mean(0))
    vertices_m = hand.skin(posed)
    whole, size_px = options.cameras - options.close_ups, (options.width, options.height)
    cameras = plan_cameras(whole, size_px, options.seed, _of_hand(vertices_m))
    samples = options.sampling.samples
    cameras += plan_close_ups(hand.identity, vertices_m, options.close_ups, options.seed, samples)
    person = PersonSkin.of(hand.identity, options.skin, options.sampling.subdivisions)
    # the mesh is fine already
    sampling = dataclasses.asdict(options.sampling) | {"subdivisions": 0}
    light, lit_by = _light(options.light)
    render = {"sampling": sampling, "light": light, "skin": person.material, FOREARM: True}
    plan = CapturePlan(
        description=json.loads(json.dumps(options.description())),
        render=json.loads(json.dumps(render)),
        pose_names=names,
        joints_m=posed.joints_m,
        vertices_m=vertices_m.astype(np.float32),
        faces=person.surface.faces,
        face_uv=person.surface.face_uv.astype(np.float32),
        cameras=tuple(cameras),
        files={**person.files, **lit_by},
        person=person,
        forearm=hand.forearm(posed),
    )
    if isinstance(options.light, Light):
        return plan
    split = plan.split()
    tests = set(split["test_frames"][plan.record.sequence]), set(split["test_cameras"])
    seen_by = [plan.cameras_of(pose) for pose in range(len(names))]
    lights = plan_lights(options.light, plan.hand_vertices_m, seen_by, tests, options.seed)
    return dataclasses.replace(plan, files={**plan.files, LIGHTS_FILE: lights_bytes(lights)})


def _of_hand(vertices_m: np.ndarray) -> np.ndarray:
    """(P, V, 3) of the hand alone; vertices of its forearm come after it."""
    return vertices_m[:, : len(load_fields()["base_index"])]


def _light(light: Light | VariedLight) -> tuple[dict[str, Any], dict[str, bytes]]:
    """What the worker is told of the light, and the files that it needs for it, but for lights.json."""
    if isinstance(light, VariedLight):
        skies = light.sky_files()
        return {"lights": LIGHTS_FILE, "skies": list(skies), "shipped": light.shipped}, skies
    told = dataclasses.asdict(light)
    if not is_file(light.hdri):
        return told, {}
    # a copy: the capture may go on in another place, where that file is not
    told["hdri"] = f"light{Path(light.hdri).suffix.lower()}"
    return told, {told["hdri"]: read_bytes(Path(light.hdri))}


def wrist_turns(count: int, largest_deg: float, seed: int) -> np.ndarray:
    """(count, 3, 3) rotations about any axis by up to `largest_deg` degrees; the first is none."""
    random = np.random.default_rng((seed, 1))
    axis = random.standard_normal((count, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.radians(largest_deg) * np.sqrt(random.random(count))
    angle[:1] = 0
    return axis_rotation(axis, angle)


@contextlib.contextmanager
def drafted_mesh(folder: Path, plan: CapturePlan) -> Iterator[Path]:
    """The fine mesh of a new plan in a file for `write_plan`, gone after the block.

    It takes long, of thousands of poses minutes: nobody should have to wait for it.
    """
    assert plan.person is not None
    file = folder / FOLDER / MESH_FILE
    try:
        with tempfile.TemporaryDirectory(dir=make_folder(file.parent), prefix=".begun_") as draft:
            plan.person.write_mesh(Path(draft) / MESH_FILE, plan.vertices_m, plan.joints_m)
            sync(Path(draft) / MESH_FILE)
            yield Path(draft) / MESH_FILE
    except OSError as error:
        raise file_error(file, error) from error


def write_plan(folder: Path, plan: CapturePlan, mesh: Path) -> None:
    """Writes plan, annotations and split; each file whole or not at all, the plan itself last. mesh: `drafted_mesh`"""
    os.replace(mesh, folder / FOLDER / MESH_FILE)
    for name, data in plan.files.items():
        write_file(folder / FOLDER / name, data)
    hands = {name: getattr(plan, name) for name in (*HANDS_ARRAYS, *([] if plan.forearm is None else [FOREARM]))}
    with writing(folder / HANDS_FILE) as path, open(path, "wb") as stream:
        np.savez_compressed(stream, **hands)
    write_interhand(folder, plan.record)
    write_file(folder / SPLITS_FILE, json.dumps(plan.split(), indent=2) + "\n")
    content = {
        "format": FORMAT, "options": plan.description, "render": plan.render, "poses": list(plan.pose_names),
        "cameras": [_camera_json(camera) for camera in plan.cameras],
    }  # fmt: skip
    write_file(folder / PLAN_FILE, json.dumps(content, indent=1, allow_nan=False) + "\n")


def annotate(folder: Path, plan: CapturePlan, poses: Collection[int] | None = None) -> None:
    """Writes the annotations of all poses, or of these only: of an unfinished capture those that are whole."""
    record = plan.record
    kept = {pose: joints for pose, joints in record.joints_m.items() if poses is None or pose in poses}
    write_interhand(folder, dataclasses.replace(record, joints_m=kept))


def shard_locked(folder: Path, shard: tuple[int, int]) -> contextlib.AbstractContextManager[None]:
    """Holds a shard of the capture in `folder`. RetryError while another process makes it."""
    number, count = shard
    file = folder / FOLDER / f"shard_{number}_of_{count}.lock"
    return locked(
        file, work=f"capture of shard {number}/{count}", remedy="Wait until it has ended, or take another one."
    )


def read_plan(folder: Path) -> CapturePlan | None:
    """The plan that a folder was begun with, None when there is none. InputError for one that is damaged."""
    file = folder / PLAN_FILE
    thing = f"the plan of the capture {folder}"
    remedy = "Choose another folder, or remove this one."
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        if content["format"] != FORMAT:
            raise InputError(thing, wanted=f"format {FORMAT}", came=str(content["format"]), remedy=remedy)
        light = content["render"]["light"]
        hands = read_arrays(folder / HANDS_FILE, HANDS_ARRAYS, thing, optional=(FOREARM,), max_bytes=HANDS_BYTES_MAX)
        wanted = (len(content["poses"]), int(hands["faces"].max()) + 1, 4)
        came = np.load(folder / FOLDER / MESH_FILE, mmap_mode="r", allow_pickle=False).shape
        if came != wanted:
            raise InputError(thing, wanted=f"a mesh of {wanted}", came=str(came), remedy=remedy)
        lit_by = [LIGHTS_FILE, *light["skies"]] if "lights" in light else [light["hdri"]]
        hair = [HAIR_FILE] if "hair_rgb" in content["render"]["skin"] else []
        names = [*PERSON_FILES, *hair, *(name for name in lit_by if is_file(str(name)))]
        files = {name: (folder / FOLDER / name).read_bytes() for name in names}
        return CapturePlan(
            content["options"], content["render"], tuple(content["poses"]), hands["joints_m"], hands["vertices_m"],
            hands["faces"], hands["face_uv"], tuple(_camera(one) for one in content["cameras"]), files,
            forearm=hands.get(FOREARM),
        )  # fmt: skip
    except FileNotFoundError as error:
        if not file.exists():
            return None
        raise InputError(thing, wanted="all its files", came=f"no {error.filename}", remedy=remedy) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            thing, wanted="a whole plan", came=f"{type(error).__name__}: {error}"[:200], remedy=remedy
        ) from error


def open_or_make(folder: Path, options: CaptureOptions) -> CapturePlan:
    """The plan of `folder`: the one that is there, if it was made with the same options, else a new one, written.

    Of processes that begin at once only one writes its plan. InputError when the folder holds a capture with other
    options.
    """
    options.check()
    plan = _opened(folder, options)
    if plan is not None:
        return plan
    # takes long, refuses, and writes nothing of its name: another process may begin the capture meanwhile
    made = make_plan(options)
    lock = make_folder(folder / FOLDER) / "plan.lock"
    with drafted_mesh(folder, made) as mesh, locked(lock, work="start of a capture", wait_s=LOCK_WAIT_S):
        plan = _opened(folder, options)
        if plan is None:
            write_plan(folder, made, mesh)
    return plan or made


def open_begun(folder: Path, options: CaptureOptions) -> CapturePlan:
    """The plan that is in `folder`; nothing is written. InputError when there is none, or one of other options."""
    options.check()
    plan = _opened(folder, options)
    if plan is None:
        raise InputError(
            f"--out {folder}",
            wanted="a capture that was begun",
            came="a folder without a plan" if folder.is_dir() else "no such folder",
            remedy="Check the name, or begin it without --finished-only.",
        )
    return plan


def _opened(folder: Path, options: CaptureOptions) -> CapturePlan | None:
    """The plan of the folder, None when there is none. InputError when it is one of other options."""
    present = read_plan(folder)
    if present is None:
        return None
    asked, began = _named(json.loads(json.dumps(options.description()))), _named(present.description)
    other = [name for name in asked if asked[name] != began.get(name)]
    if other:
        raise InputError(
            f"the capture in {folder}",
            wanted="the options that it was begun with",
            came=f"another {', '.join(name.replace('_', ' ') for name in other)}",
            remedy="Give the same options, or another --out.",
        )
    return present


def _named(description: dict[str, Any]) -> dict[str, Any]:
    """The same, with the hand's name, which may be called by its number too, and all numbers of its person: captures
    of before have no `hair`."""
    person = dataclasses.asdict(Person()) | description.get("skin", {})
    return {**description, "identity": identity_name(str(description.get("identity"))), "skin": person}


def _of_motion(hand: RiggedHand, motion: PoseSequence, count: int) -> tuple[tuple[str, ...], RigPose]:
    """`count` frames of a motion, evenly spread, on this hand; as a whole it stays in the canonical frame."""
    whole = motion.with_gaps_held()
    right = whole.mirrored() if whole.handedness is Handedness.LEFT else whole
    frames = np.unique(np.linspace(0, len(right) - 1, min(count, len(right))).round().astype(int))
    return tuple(f"frame_{frame}" for frame in frames), hand.follow(right.joints_m[frames], upright=True)


def _box(camera: Camera, vertices_m: np.ndarray) -> tuple[float, float, float, float]:
    """x, y, width, height of the hand in the image, cut off at its edges; pixels."""
    matrix = camera.camera_from_world
    seen = vertices_m.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    px = seen[:, :2] / seen[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    low, high = (np.clip(edge, 0, [camera.width, camera.height]) for edge in (px.min(0), px.max(0)))
    return (float(low[0]), float(low[1]), float(high[0] - low[0]), float(high[1] - low[1]))


def _camera_json(planned: PlannedCamera) -> dict[str, Any]:
    """Of a camera that sees all poses its own fields alone, as in plans of versions without others."""
    camera = planned.camera
    of_close_up = {"pose": planned.pose, "samples": planned.samples}
    return {
        **{name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")},
        "camera_from_world": camera.camera_from_world.tolist(),
        **{name: value for name, value in of_close_up.items() if value is not None},
    }


def _camera(content: dict[str, Any]) -> PlannedCamera:
    of_close_up = {name: content.pop(name) for name in ("pose", "samples") if name in content}
    return PlannedCamera(Camera(**content), **of_close_up)
