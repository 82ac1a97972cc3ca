"""Motion files of other programs with joints that are known: written here, by the published layouts, not by JGHand.

The motion is a hand of constant bone lengths whose palm is rigid, so that a skeleton of rotations alone moves exactly
as its joints do. Skeletons are written as BVH and UsdSkel; detections as their packages name them.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hand import sampled_hands as hands
from scipy.spatial.transform import Rotation

from jghand_engine.hand.joints import LEVEL_NAMES, PARENTS, Handedness
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.hand.sequence import PoseSequence

WEBXR_FINGERS = ("index-finger", "middle-finger", "ring-finger", "pinky-finger")
WEBXR_NAMES = (
    "wrist",
    *(f"thumb-{bone}" for bone in ("metacarpal", "phalanx-proximal", "phalanx-distal", "tip")),
    *(
        f"{finger}-{bone}"
        for finger in WEBXR_FINGERS
        for bone in ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
    ),
)
MEDIAPIPE_NAMES = (
    "wrist",
    *(f"thumb_{bone}" for bone in ("cmc", "mcp", "ip", "tip")),
    *(
        f"{finger}_{bone}"
        for finger in ("index_finger", "middle_finger", "ring_finger", "pinky")
        for bone in ("mcp", "pip", "dip", "tip")
    ),
)
RTMPOSE_NAMES = (
    "hand_root",
    *(
        f"{finger}{bone}"
        for finger in ("thumb", "forefinger", "middle_finger", "ring_finger", "pinky_finger")
        for bone in (1, 2, 3, 4)
    ),
)
# names of bones by joint, in level order; tips have none
MIXAMO = tuple(
    "RightHand" if name == "wrist" else None if name.endswith("4") else f"RightHand{name.capitalize()}"
    for name in LEVEL_NAMES
)
MIXAMO_TIPS = tuple(name or f"RightHand{LEVEL_NAMES[place].capitalize()}" for place, name in enumerate(MIXAMO))


def motion(handedness: Handedness = Handedness.RIGHT, frames: int = 40, fps: float = 30.0) -> PoseSequence:
    """A hand that opens and closes while it turns by more than half a turn and travels. Its palm keeps its shape, as in
    rigs of other programs: of these poses none bends the knuckles so far that it arches."""
    still = pose_sequence_of_names(["open", "claw", "relaxed", "open"], hands.canonical_np(), handedness=handedness)
    joints = still.joints_m[:frames]
    part = np.linspace(0, 1, len(joints))
    turn = Rotation.from_rotvec(part[:, None] * np.array([1.9, -1.1, 2.3])).as_matrix()
    place = np.stack([0.4 * part, 1.2 + 0.1 * np.sin(7 * part), -0.3 * part], axis=-1)
    moved = np.einsum("fij,fkj->fki", turn, joints - joints[:, :1]) + place[:, None]
    return PoseSequence(moved, fps, handedness)


def standard(sequence: PoseSequence) -> np.ndarray:
    """(F, 21, 3) in the order of files."""
    return from_level(sequence.joints_m, JointOrder.STANDARD)


# ---- a skeleton -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rig:
    """A skeleton that moves as a motion does. rest: (21, 3) joints at rest, world · local: (F, 21, 3, 3) rotations of
    every joint in its parent's frame · wrist: (F, 3)."""

    names: tuple[str | None, ...]
    rest: np.ndarray
    local: np.ndarray
    wrist: np.ndarray
    fps: float

    @property
    def offsets(self) -> np.ndarray:
        """(21, 3) from the parent at rest; the wrist's own place."""
        return np.concatenate([self.rest[:1], self.rest[1:] - self.rest[list(PARENTS[1:])]])

    @property
    def children(self) -> list[list[int]]:
        return [[child for child in range(21) if PARENTS[child] == place] for place in range(21)]


def rig(sequence: PoseSequence, names: tuple[str | None, ...] = MIXAMO_TIPS, scale: float = 1.0) -> Rig:
    """The skeleton of a motion; lengths times `scale`."""
    joints = sequence.joints_m * scale
    rest = joints[0] - joints[0, 0]
    world = np.empty((len(joints), 21, 3, 3))
    world[:, 0] = [_kabsch(rest[1:6], pose[1:6] - pose[0]) for pose in joints]
    local = np.tile(np.eye(3), (len(joints), 21, 1, 1))
    local[:, 0] = world[:, 0]
    for joint in range(1, 21):
        parent = PARENTS[joint]
        child = next((one for one in range(21) if PARENTS[one] == joint), None)
        world[:, joint] = world[:, parent]
        if child is None:
            continue
        before = np.einsum("fij,j->fi", world[:, parent], rest[child] - rest[joint])
        turn = _turn_between(before, joints[:, child] - joints[:, joint])
        world[:, joint] = turn @ world[:, parent]
        local[:, joint] = world[:, parent].transpose(0, 2, 1) @ world[:, joint]
    return Rig(names, rest, local, joints[:, 0], sequence.fps)


def _kabsch(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    u, _, vt = np.linalg.svd(after.T @ before)
    return u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt


def _turn_between(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    axis = np.cross(before, after)
    angle = np.arctan2(np.linalg.norm(axis, axis=-1), (before * after).sum(-1))
    size = np.linalg.norm(axis, axis=-1, keepdims=True)
    return Rotation.from_rotvec(axis / np.where(size > 0, size, 1) * angle[:, None]).as_matrix()


def write_bvh(
    path: Path, skeleton: Rig, order: str = "ZXY", *, end_sites: bool = True, all_positions: bool = False
) -> None:
    """A BVH with a root above the hand, `Hips`, that stands still; degrees with six digits."""
    lines = [
        "HIERARCHY",
        "ROOT Hips",
        "{",
        "\tOFFSET 0 0 0",
        "\tCHANNELS 6 Xposition Yposition Zposition " + _rotations(order),
    ]
    columns: list[tuple[int, bool]] = []

    def joint(place: int, depth: int) -> None:
        indent = "\t" * depth
        moves = place == 0 or all_positions
        lines.extend([f"{indent}JOINT {skeleton.names[place]}", indent + "{"])
        lines.append(f"{indent}\tOFFSET " + " ".join(f"{x:.6f}" for x in skeleton.offsets[place]))
        positions = "Xposition Yposition Zposition " if moves else ""
        lines.append(f"{indent}\tCHANNELS {6 if moves else 3} {positions}{_rotations(order)}")
        columns.append((place, moves))
        named = [child for child in skeleton.children[place] if skeleton.names[child] is not None]
        for child in named:
            joint(child, depth + 1)
        if not named and end_sites:
            end = skeleton.offsets[skeleton.children[place][0]] if skeleton.children[place] else (0, 0, 0)
            lines.extend(
                [f"{indent}\tEnd Site", indent + "\t{", f"{indent}\t\tOFFSET " + " ".join(f"{x:.6f}" for x in end)]
            )
            lines.append(indent + "\t}")
        lines.append(indent + "}")

    joint(0, 1)
    lines += ["}", "MOTION", f"Frames: {len(skeleton.local)}", f"Frame Time: {1 / skeleton.fps:.6f}"]
    for frame in range(len(skeleton.local)):
        numbers = [0.0] * 6
        for place, moves in columns:
            if moves:
                numbers += list(skeleton.wrist[frame] if place == 0 else skeleton.offsets[place])
            numbers += list(Rotation.from_matrix(skeleton.local[frame, place]).as_euler(order, degrees=True))
        lines.append(" ".join(f"{number:.6f}" for number in numbers))
    path.write_text("\n".join(lines) + "\n")


def _rotations(order: str) -> str:
    return " ".join(f"{axis}rotation" for axis in order)


def write_usd(path: Path, skeleton: Rig, *, meters_per_unit: float = 1.0) -> None:
    """A stage with one skeleton and its animation, at one time code a frame."""
    from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

    kept = [place for place in range(21) if skeleton.names[place] is not None]
    paths: dict[int, str] = {}
    for place in kept:
        above = f"{paths[PARENTS[place]]}/" if place else "Root/"
        paths[place] = above + str(skeleton.names[place]).replace(":", "_")
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetTimeCodesPerSecond(skeleton.fps)
    root = UsdSkel.Root.Define(stage, "/Character")
    stage.SetDefaultPrim(root.GetPrim())
    joints = UsdSkel.Skeleton.Define(stage, "/Character/Skeleton")
    animation = UsdSkel.Animation.Define(stage, "/Character/Skeleton/Take")
    tokens = ["Root", *(paths[place] for place in kept)]
    offsets = [np.zeros(3), *(skeleton.offsets[place] for place in kept)]
    rest = [Gf.Matrix4d().SetTranslate(Gf.Vec3d(*map(float, offset))) for offset in offsets]
    bind = [
        Gf.Matrix4d(1.0),
        *(Gf.Matrix4d().SetTranslate(Gf.Vec3d(*map(float, skeleton.rest[place]))) for place in kept),
    ]
    for attribute in (joints.CreateJointsAttr(), animation.CreateJointsAttr()):
        attribute.Set(tokens)
    joints.CreateRestTransformsAttr(Vt.Matrix4dArray(rest))
    joints.CreateBindTransformsAttr(Vt.Matrix4dArray(bind))
    UsdSkel.BindingAPI.Apply(joints.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    animation.CreateScalesAttr([Gf.Vec3h(1, 1, 1)] * len(tokens))
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    for frame in range(len(skeleton.local)):
        places = [np.zeros(3), skeleton.wrist[frame], *(skeleton.offsets[place] for place in kept[1:])]
        turns = [(0, 0, 0, 1), *(Rotation.from_matrix(skeleton.local[frame, place]).as_quat() for place in kept)]
        translations.Set([Gf.Vec3f(*map(float, place)) for place in places], frame)
        rotations.Set([Gf.Quatf(float(w), float(x), float(y), float(z)) for x, y, z, w in turns], frame)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(skeleton.local) - 1)
    stage.Save()


# ---- detections -----------------------------------------------------------------------------------------------------


def mediapipe_tasks(joints: np.ndarray, side: str = "Right") -> list[dict]:
    """Results of MediaPipe's Tasks in JavaScript, with milliseconds; a frame of NaN has no hand."""
    frames = []
    for number, frame in enumerate(joints):
        seen = bool(np.isfinite(frame).all())
        world = [{"x": x, "y": y, "z": z, "visibility": 0} for x, y, z in frame.tolist()]
        image = [{"x": 0.5, "y": 0.5, "z": 0.0, "visibility": 0}] * 21
        category = {"score": 0.98, "index": 0, "categoryName": side, "displayName": side}
        frames.append({
            "timestamp": round(1000 * number / 30, 3),
            "landmarks": [image] if seen else [],
            "worldLandmarks": [world] if seen else [],
            "handedness": [[category]] if seen else [],
        })  # fmt: skip
    return frames


def mediapipe_solutions(joints: np.ndarray, label: str = "Left") -> list[dict]:
    """Results of MediaPipe's old interface in Python, as protocol buffers print them."""
    return [
        {
            "frame_index": number,
            "multi_hand_landmarks": [{"landmark": [{"x": 0.5, "y": 0.5, "z": 0.0}] * 21}],
            "multi_hand_world_landmarks": [{"landmark": [{"x": x, "y": y, "z": z} for x, y, z in frame.tolist()]}],
            "multi_handedness": [{"classification": [{"index": 0, "score": 0.97, "label": label}]}],
        }
        for number, frame in enumerate(joints)
    ]


def openpose_frame(joints: np.ndarray, side: str = "right") -> dict:
    """A frame of OpenPose with --3d; NaN points have 0 0 0 0."""
    numbers = [[*point, 1.0] if np.isfinite(point).all() else [0.0] * 4 for point in joints.tolist()]
    empty = {
        f"{part}_keypoints_{kind}": [] for part in ("pose", "face", "hand_left", "hand_right") for kind in ("2d", "3d")
    }
    person = {**empty, f"hand_{side}_keypoints_3d": np.ravel(numbers).tolist()}
    return {"version": 1.3, "people": [{"person_id": [-1], **person}]}


def write_openpose(folder: Path, joints: np.ndarray, side: str = "right", first: int = 7) -> None:
    """One file for each frame."""
    folder.mkdir()
    for number, frame in enumerate(joints, first):
        (folder / f"video_{number:012d}_keypoints.json").write_text(json.dumps(openpose_frame(frame, side)))


def webxr_joints(sequence: PoseSequence) -> np.ndarray:
    """(F, 25, 3) joints of WebXR."""
    return from_level(sequence.joints_m, JointOrder.OPENXR)[:, 1:]


def iwer_recording(sequence: PoseSequence) -> dict:
    """A recording of IWER's action recorder: a controller, and a hand whose joints are relative to its ray."""
    names = list(WEBXR_NAMES)
    common = {"targetRayMode": "tracked-pointer", "profiles": [], "hasGrip": True}
    gamepad = {"hasGamepad": True, "mapping": "xr-standard", "numButtons": 1, "numAxes": 1}
    hand = {"hasHand": True, "jointSequence": names, "hasGamepad": False}
    schema = [
        [0, {"handedness": "left", **common, "hasHand": False, **gamepad}],
        [1, {"handedness": sequence.handedness.value, **common, **hand}],
    ]
    frames = []
    for number, joints in enumerate(webxr_joints(sequence)):
        ray = Rotation.from_rotvec([0.3, 0.1 * number, -0.2])
        place = joints[0] + 0.05
        local = ray.inv().apply(joints - place)
        numbers = [value for point in local.tolist() for value in (*(round(x, 3) for x in point), 0, 0, 0, 1, 0.01)]
        controller = [0, 0, 0, 0, 0, 0, 0, 1, [0] * 7, [[0, 0, 0], 0]]
        source = [1, *place.tolist(), *ray.as_quat().tolist(), [0] * 7, numbers]
        frames.append([1000 * number / sequence.fps, 0, 1.7, 0, 0, 0, 0, 1, controller, source])
    return {"schema": schema, "frames": frames}


def interhand_document(sequence: PoseSequence, captures: tuple[str, ...] = ("0",)) -> dict:
    """Joints of InterHand2.6M: millimeters, right hand first, an absent hand filled with ones."""
    joints = from_level(sequence.joints_m, JointOrder.INTERHAND) * 1000
    other, absent = np.ones((21, 3)), [0] * 21
    right = sequence.handedness is Handedness.RIGHT
    return {
        capture: {
            str(20 + 3 * number): {
                "world_coord": np.concatenate([frame, other] if right else [other, frame]).tolist(),
                "joint_valid": [[flag] for flag in ([1] * 21 + absent if right else absent + [1] * 21)],
                "hand_type": sequence.handedness.value,
                "hand_type_valid": True,
            }
            for number, frame in enumerate(joints)
        }
        for capture in captures
    }


def freemocap_table(sequence: PoseSequence, names: Sequence[str] = MEDIAPIPE_NAMES) -> str:
    """mediapipe_right_hand_3d_xyz.csv, millimeters."""
    side = f"{sequence.handedness.value}_hand"
    header = ",".join(f"{side}_{name}_{axis}" for name in names for axis in "xyz")
    rows = (standard(sequence) * 1000).reshape(len(sequence), -1)
    return "\n".join([header, *(",".join("" if np.isnan(x) else repr(x) for x in row) for row in rows.tolist())]) + "\n"


def freemocap_lines(sequences: Sequence[PoseSequence], version: int) -> str:
    """NAME_by_frame.csv of version 1, or freemocap_data_by_frame.csv of version 2, which has RTMPose's names; with
    what is no measured point of a hand."""
    columns = {1: "frame,timestamp,timestamp_by_camera,model,keypoint,x,y,z,reprojection_error",
               2: "frame,keypoint,x,y,z,model,trajectory,reprojection_error"}[version]  # fmt: skip
    lines = [columns]
    for frame in range(len(sequences[0])):
        for sequence in sequences:
            side = sequence.handedness.value
            for joint, point in enumerate((standard(sequence)[frame] * 1000).tolist()):
                x, y, z = ("" if np.isnan(number) else repr(number) for number in point)
                if version == 1:
                    lines.append(f"{frame},{frame / 50!r},{{}},mediapipe_hand,{side}_{joint:04d},{x},{y},{z},4.1")
                else:
                    lines.append(f"{frame},{RTMPOSE_NAMES[joint]},{x},{y},{z},rtmpose.{side}_hand,3d_xyz,")
                    lines.append(f"{frame},{RTMPOSE_NAMES[joint]},0,0,0,rtmpose.{side}_hand,rigid_3d_xyz,")
        if version == 1:
            lines.append(f"{frame},{frame / 50!r},{{}},mediapipe_body,left_0000,1.0,2.0,3.0,4.1")
        else:
            lines.append(f"{frame},left_hand_root,1.0,2.0,3.0,rtmpose.left_body,3d_xyz,")
    return "\n".join(lines) + "\n"
