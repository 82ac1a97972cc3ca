"""Files of other programs, written by their published layouts, come back with the joints they were written from."""

import dataclasses
import json

import motion_samples as samples
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, bone_lengths, from_level
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.motion.content import MotionFormat
from jghand_engine.motion.read import read_motion_file

RIGHT, LEFT = Handedness.RIGHT, Handedness.LEFT
# largest distance of a joint, meters: worst seen 3e-8 for six digits of centimeters and degrees, 9e-8 for single
# precision; a whole double is the joint itself
TEXT_M, SINGLE_M, EXACT_M = 5e-8, 2e-7, 1e-15


@pytest.fixture(scope="module")
def motion():
    return samples.motion()


def distance(read, motion):
    assert len(read.sequence) == len(motion)
    assert read.sequence.handedness is motion.handedness
    return np.abs(read.sequence.joints_m - motion.joints_m).max()


def dumped(path, content):
    path.write_text(json.dumps(content))
    return path


# ---- skeletons -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["ZXY", "XYZ", "ZYX", "YXZ", "YZX", "XZY"])
def test_bvh_turns_in_the_order_of_its_channels(tmp_path, motion, order):
    samples.write_bvh(tmp_path / "a.bvh", samples.rig(motion, scale=100), order)
    read = read_motion_file(tmp_path / "a.bvh")
    assert distance(read, motion) < TEXT_M
    assert read.sequence.fps == 30.0
    assert any("centimeters" in note and "--unit" in note for note in read.notes)
    assert any("Mixamo" in note for note in read.notes)


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_body_in_bvh_shows_which_axis_points_up(tmp_path, motion, up):
    """Its root is called Hips, and its hand stands above it."""
    above = np.array([0.0, 120.0, 0.0] if up == "y" else [0.0, 0.0, 120.0])
    rig = samples.rig(motion, scale=100)
    samples.write_bvh(tmp_path / "a.bvh", dataclasses.replace(rig, rest=rig.rest + above))
    read = read_motion_file(tmp_path / "a.bvh")
    assert read.up == up
    assert distance(read, motion) < TEXT_M


def test_positions_of_every_joint_take_the_place_of_offsets(tmp_path, motion):
    samples.write_bvh(tmp_path / "a.bvh", samples.rig(motion, scale=100), all_positions=True)
    assert distance(read_motion_file(tmp_path / "a.bvh"), motion) < TEXT_M


def test_positions_around_zero_are_added_to_offsets(tmp_path, motion):
    path = tmp_path / "a.bvh"
    rig = samples.rig(motion, scale=100)
    samples.write_bvh(path, rig, all_positions=True)
    header, frames = path.read_text().split("Frame Time:")
    lines = frames.splitlines()
    rows = np.array([[float(x) for x in line.split()] for line in lines[1:]])
    for place in range(1, 21):
        first = 6 + 6 * _written(rig).index(place)
        rows[:, first : first + 3] = 0.0
    body = "\n".join(" ".join(f"{x:.6f}" for x in row) for row in rows)
    path.write_text(f"{header}Frame Time:{lines[0]}\n{body}\n")
    read = read_motion_file(path)
    assert distance(read, motion) < TEXT_M
    assert any("added to the offsets" in note for note in read.notes)


def _written(rig):
    """Joints in the order in which BVH lists them: depth first."""
    order = []

    def visit(place):
        order.append(place)
        for child in rig.children[place]:
            visit(child)

    visit(0)
    return order


def test_a_rig_without_tips_gets_usual_ones_and_says_so(tmp_path, motion):
    samples.write_bvh(tmp_path / "a.bvh", samples.rig(motion, samples.MIXAMO, 100), end_sites=False)
    read = read_motion_file(tmp_path / "a.bvh")
    assert any("no tips of thumb, index, middle, ring, pinky" in note for note in read.notes)
    tips, others = slice(16, 21), slice(0, 16)
    assert np.abs(read.sequence.joints_m[:, others] - motion.joints_m[:, others]).max() < TEXT_M
    # within 5 mm of the sample's own tips, whose proportions are not those of the table; worst seen 4.2 mm
    assert np.linalg.norm(read.sequence.joints_m[:, tips] - motion.joints_m[:, tips], axis=-1).max() < 5e-3
    assert np.ptp(bone_lengths(read.sequence.joints_m), axis=0).max() < 2 * TEXT_M


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_usd_says_its_unit(tmp_path, motion, suffix, unit):
    path = tmp_path / f"a.{suffix}"
    samples.write_usd(path, samples.rig(motion, scale=1 / unit), meters_per_unit=unit)
    read = read_motion_file(path)
    assert distance(read, motion) < SINGLE_M
    assert read.sequence.fps == 30.0


def test_the_place_of_a_usd_skeleton_counts(tmp_path, motion):
    """A character that walks: its skeleton moves and turns as a whole."""
    from pxr import Gf, Usd, UsdGeom

    samples.write_usd(tmp_path / "a.usda", samples.rig(motion))
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    place = UsdGeom.Xformable(stage.GetPrimAtPath("/Character"))
    moved, turned = place.AddTranslateOp(), place.AddRotateZOp()
    for frame in range(len(motion)):
        moved.Set(Gf.Vec3d(0.1 * frame, 0.0, -1.0), frame)
        turned.Set(3.0 * frame, frame)
    stage.Save()
    turns = Rotation.from_rotvec(np.outer(3.0 * np.arange(len(motion)), [0, 0, 1]), degrees=True).as_matrix()
    walk = np.stack([0.1 * np.arange(len(motion)), np.zeros(len(motion)), np.full(len(motion), -1.0)], axis=-1)
    wanted = np.einsum("fij,fkj->fki", turns, motion.joints_m) + walk[:, None]
    read = read_motion_file(tmp_path / "a.usda")
    # single precision of angles and of joints some meters away; worst seen 3e-7 m
    np.testing.assert_allclose(read.sequence.joints_m, wanted, atol=1e-6)


def test_our_own_stage_is_read_back(tmp_path, motion):
    """Control joints of JGHand's USD, whose names say no side."""
    from jghand_engine.cli import main
    from jghand_engine.motion.files import write_motion

    part = motion.section(0, 5)
    write_motion(tmp_path / "motion.npz", part)
    words = ["export", "--motion", str(tmp_path / "motion.npz"), "--avatar", "painted", "--out", str(tmp_path / "usd")]
    assert main([*words, "--keep-bone-lengths"]) == 0
    read = read_motion_file(tmp_path / "usd" / "hand.usda", MotionFormat(handedness=RIGHT))
    assert distance(read, part) < SINGLE_M


def test_both_hands_of_a_character_are_told_apart(tmp_path, motion):
    """A left hand beside the right one: which one is wanted has to be said."""
    path = tmp_path / "a.bvh"
    samples.write_bvh(path, samples.rig(motion, scale=100))
    text = path.read_text()
    header, frames = text.split("MOTION\n")
    hand = header[header.index("\tJOINT RightHand\n") : header.rindex("}")]
    doubled = header[: header.rindex("}")] + hand.replace("Right", "Left") + "}\n"
    counts, rows = frames.split("\n", 2)[:2], frames.split("\n", 2)[2].splitlines()
    body = "\n".join(row + " " + " ".join(row.split()[6:]) for row in rows)
    path.write_text(f"{doubled}MOTION\n{counts[0]}\n{counts[1]}\n{body}\n")
    with pytest.raises(InputError, match="--hand"):
        read_motion_file(path)
    assert distance(read_motion_file(path, MotionFormat(handedness=RIGHT)), motion) < TEXT_M
    assert read_motion_file(path, MotionFormat(handedness=LEFT)).sequence.handedness is LEFT


def test_a_hand_that_lacks_fingers_names_them(tmp_path, motion):
    names = tuple(None if name and "Pinky" in name else name for name in samples.MIXAMO)
    samples.write_bvh(tmp_path / "a.bvh", samples.rig(motion, names, 100))
    with pytest.raises(InputError, match="lacks pinky1, pinky2, pinky3"):
        read_motion_file(tmp_path / "a.bvh")


def test_the_other_hand_than_the_bones_say_is_refused(tmp_path, motion):
    samples.write_bvh(tmp_path / "a.bvh", samples.rig(motion, scale=100))
    with pytest.raises(InputError, match="--mirror"):
        read_motion_file(tmp_path / "a.bvh", MotionFormat(handedness=LEFT))


# ---- detections ------------------------------------------------------------------------------------------------------


def test_mediapipe_tasks_in_a_list_of_results(tmp_path, motion):
    joints = samples.standard(motion).copy()
    joints[5:8] = np.nan
    read = read_motion_file(dumped(tmp_path / "a.json", samples.mediapipe_tasks(joints)))
    assert read.sequence.gaps.frames == (5, 6, 7)
    seen = read.sequence.valid.all(axis=1)
    assert np.abs(read.sequence.joints_m[seen] - motion.joints_m[seen]).max() < EXACT_M
    assert read.sequence.fps == 30.0


def test_mediapipes_old_interface_calls_a_right_hand_left(tmp_path, motion):
    path = dumped(tmp_path / "a.json", {"frames": samples.mediapipe_solutions(samples.standard(motion))})
    read = read_motion_file(path)
    assert distance(read, motion) < EXACT_M
    assert any("turned round" in note for note in read.notes)
    kept = read_motion_file(path, MotionFormat(mirrored_labels=False))
    assert kept.sequence.handedness is LEFT
    said = read_motion_file(path, MotionFormat(handedness=LEFT))
    assert said.sequence.handedness is LEFT
    assert any("as requested" in note for note in said.notes)


def test_a_label_counts_less_than_the_way_the_fingers_bend(tmp_path, motion):
    """Older versions of Tasks label a hand as its mirror image, and do not say which version they are."""
    path = dumped(tmp_path / "a.json", samples.mediapipe_tasks(samples.standard(motion), "Left"))
    read = read_motion_file(path)
    assert distance(read, motion) < EXACT_M
    assert any("labeled left, but its fingers bend as those of a right hand" in note for note in read.notes)
    kept = read_motion_file(path, MotionFormat(mirrored_labels=False))
    assert kept.sequence.handedness is LEFT
    assert any("bend as those of a right hand" in note for note in kept.notes)


def test_a_hand_that_bends_the_other_way_is_warned_of(tmp_path, motion):
    np.save(tmp_path / "a.npy", samples.standard(motion))
    for side, warned in ((LEFT, True), (RIGHT, False)):
        notes = read_motion_file(tmp_path / "a.npy", MotionFormat(handedness=side)).notes
        assert any("bend as those of a right hand" in note for note in notes) is warned


def test_landmarks_of_the_image_alone_are_refused(tmp_path, motion):
    frames = samples.mediapipe_tasks(samples.standard(motion))
    for frame in frames:
        del frame["worldLandmarks"]
    with pytest.raises(InputError, match="world landmarks"):
        read_motion_file(dumped(tmp_path / "a.json", frames))


def test_openpose_is_a_folder_of_frames(tmp_path, motion):
    joints = samples.standard(motion) * 1000
    joints[3, 4] = np.nan
    samples.write_openpose(tmp_path / "op", joints)
    (tmp_path / "op" / "video_000000000020_keypoints.json").unlink()
    read = read_motion_file(tmp_path / "op")
    assert read.sequence.gaps.frames == (3, 13), "a point of confidence 0, and a file that is not there"
    seen = read.sequence.valid
    assert np.abs(read.sequence.joints_m[seen] - motion.joints_m[seen]).max() < EXACT_M
    assert any("millimeters" in note for note in read.notes)


def test_flat_keypoints_of_openpose_are_refused(tmp_path):
    person = {"hand_right_keypoints_2d": [1.0] * 63, "hand_left_keypoints_2d": []}
    with pytest.raises(InputError, match="hands in 3D"):
        read_motion_file(dumped(tmp_path / "x_000000000001_keypoints.json", {"version": 1.3, "people": [person]}))


def test_a_recording_of_iwer_is_relative_to_its_ray(tmp_path, motion):
    read = read_motion_file(dumped(tmp_path / "a.json", samples.iwer_recording(motion)))
    # its own rounding to a millimeter: half of one in every axis
    assert distance(read, motion) < 0.9e-3
    assert read.sequence.fps == 30.0


@pytest.mark.parametrize("way", ["by name", "in lists", "openxr", "plain"])
def test_headsets_list_25_or_26_joints_in_many_ways(tmp_path, motion, way):
    joints = samples.webxr_joints(motion)
    wanted = None
    if way == "by name":
        named = [dict(zip(samples.WEBXR_NAMES, frame, strict=True)) for frame in joints.tolist()]
        frames = [{"time": number / 30, "right": frame} for number, frame in enumerate(named)]
    elif way == "in lists":
        hands = [
            {"handedness": "right", "joints": [{"position": point} for point in frame]} for frame in joints.tolist()
        ]
        frames = {"fps": 30, "frames": [{"hands": [hand]} for hand in hands]}
    elif way == "openxr":
        palms = np.concatenate([joints[:, :1], joints], axis=1)
        frames = {"frames": [{"right_hand": frame} for frame in palms.tolist()]}
    else:
        frames, wanted = joints.tolist(), MotionFormat(handedness=RIGHT)
    assert distance(read_motion_file(dumped(tmp_path / "a.json", frames), wanted), motion) < EXACT_M


def test_joints_are_known_by_openxrs_own_names(tmp_path, motion):
    fingers = ("INDEX", "MIDDLE", "RING", "LITTLE")
    bones = ("METACARPAL", "PROXIMAL", "INTERMEDIATE", "DISTAL", "TIP")
    names = ["WRIST", *(f"THUMB_{bone}" for bone in ("METACARPAL", "PROXIMAL", "DISTAL", "TIP"))]
    names += [f"{finger}_{bone}" for finger in fingers for bone in bones]
    names = [f"XR_HAND_JOINT_{name}_EXT" for name in names]
    joints = samples.webxr_joints(samples.motion(LEFT)).tolist()
    named = [dict(zip(names, ({"pose": {"position": point}} for point in frame), strict=True)) for frame in joints]
    frames = [{"left": frame} for frame in named]
    read = read_motion_file(dumped(tmp_path / "a.json", {"frames": frames}))
    assert distance(read, samples.motion(LEFT)) < EXACT_M
    assert read.kind == "joints of a headset"


def test_interhand_marks_the_absent_hand(tmp_path, motion):
    read = read_motion_file(dumped(tmp_path / "joint_3d.json", samples.interhand_document(motion)))
    assert distance(read, motion) < EXACT_M


def test_one_of_several_captures_has_to_be_named(tmp_path, motion):
    path = dumped(tmp_path / "joint_3d.json", samples.interhand_document(motion, ("0", "1")))
    with pytest.raises(InputError, match=r"Capture0.*--part"):
        read_motion_file(path)
    assert distance(read_motion_file(path, MotionFormat(part="Capture1")), motion) < EXACT_M


@pytest.mark.parametrize("side", [RIGHT, LEFT])
def test_freemocap_says_the_hand_by_names(tmp_path, side):
    motion = samples.motion(side)
    array, table = (tmp_path / f"mediapipe_{side}_hand_3d_xyz{suffix}" for suffix in (".npy", ".csv"))
    np.save(array, samples.standard(motion) * 1000)
    table.write_text(samples.freemocap_table(motion))
    for path in (array, table):
        assert distance(read_motion_file(path), motion) < EXACT_M
    body = np.full((len(motion), 553, 3), np.nan)
    first = 33 if side is RIGHT else 54
    body[:, first : first + 21] = samples.standard(motion) * 1000
    np.save(tmp_path / "mediapipe_skeleton_3d.npy", body)
    assert distance(read_motion_file(tmp_path / "mediapipe_skeleton_3d.npy"), motion) < EXACT_M


@pytest.mark.parametrize("side", [RIGHT, LEFT])
@pytest.mark.parametrize("names", [tuple(f"{number:04d}" for number in range(21)), samples.RTMPOSE_NAMES])
def test_freemocap_numbers_joints_or_names_them_after_rtmpose(tmp_path, side, names):
    motion = samples.motion(side)
    path = tmp_path / f"mediapipe_{side}_hand_3d_xyz.csv"
    path.write_text(samples.freemocap_table(motion, names))
    assert distance(read_motion_file(path), motion) < EXACT_M


def test_a_whole_recording_of_freemocap_in_a_table_has_both_hands_and_times(tmp_path):
    both = [samples.motion(RIGHT), samples.motion(LEFT)]
    numbers = tuple(f"{number:04d}" for number in range(21))
    right, left = (samples.freemocap_table(motion, numbers).splitlines() for motion in both)
    lines = [
        "timestamp,timestamp_by_camera,body_left_wrist_x,body_left_wrist_y,body_left_wrist_z,"
        + right[0]
        + ","
        + left[0]
    ]
    lines += [f"{k / 50},{{}},1,2,3,{right[1 + k]},{left[1 + k]}" for k in range(len(both[0]))]
    path = tmp_path / "recording_15_30_36_by_trajectory.csv"
    path.write_text("\n".join(lines) + "\n")
    for motion in both:
        read = read_motion_file(path, MotionFormat(handedness=motion.handedness))
        assert distance(read, motion) < EXACT_M
        assert read.sequence.fps == 50


@pytest.mark.parametrize("version", [1, 2])
def test_freemocap_with_a_line_for_each_joint(tmp_path, version):
    both = [samples.motion(RIGHT), samples.motion(LEFT)]
    path = tmp_path / {1: "recording_by_frame.csv", 2: "freemocap_data_by_frame.csv"}[version]
    path.write_text(samples.freemocap_lines(both, version))
    for motion in both:
        read = read_motion_file(path, MotionFormat(handedness=motion.handedness))
        assert distance(read, motion) < EXACT_M
        assert read.sequence.fps == {1: 50, 2: 30}[version]


@pytest.mark.parametrize("side", [RIGHT, LEFT])
def test_freemocap_with_a_line_for_each_joint_of_one_hand(tmp_path, side):
    motion = samples.motion(side)
    rows = [line.split(",")[:5] for line in samples.freemocap_lines([motion], 2).splitlines() if "rigid" not in line]
    path = tmp_path / f"rtmpose_{side}_hand_3d_xyz.csv"
    path.write_text("\n".join(",".join(row) for row in rows if row[1] != "left_wrist") + "\n")
    assert distance(read_motion_file(path), motion) < EXACT_M


def test_frames_that_such_a_table_leaves_out_are_a_gap(tmp_path, motion):
    path = tmp_path / "recording_by_frame.csv"
    lines = samples.freemocap_lines([motion], 2).splitlines()
    path.write_text("\n".join(line for line in lines if not line.startswith("3,")) + "\n")
    read = read_motion_file(path).sequence
    assert len(read) == len(motion)
    assert np.flatnonzero(~read.valid.any(axis=1)).tolist() == [3]


def test_arrays_of_freemocap_whose_hands_stand_elsewhere_are_refused(tmp_path):
    np.save(tmp_path / "rtmpose_skeleton_3d.npy", np.zeros((2, 133, 3)))
    with pytest.raises(InputError, match="beside it"):
        read_motion_file(tmp_path / "rtmpose_skeleton_3d.npy")


def test_hands_of_two_trackers_are_told_apart_by_their_names(tmp_path):
    first, second = samples.motion(RIGHT), samples.motion(RIGHT, frames=30)
    path = tmp_path / "freemocap_data_by_frame.csv"
    lines = samples.freemocap_lines([first], 2).splitlines()
    lines += [line.replace("rtmpose", "holistic") for line in samples.freemocap_lines([second], 2).splitlines()[1:]]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"right hand, rtmpose\.right_hand.*--part"):
        read_motion_file(path)
    assert distance(read_motion_file(path, MotionFormat(part="rtmpose")), first) < EXACT_M


def test_each_file_of_a_recording_has_its_own_times(tmp_path):
    hands = {side: samples.motion(side, frames=frames) for side, frames in ((RIGHT, 40), (LEFT, 30))}
    for (side, motion), fps in zip(hands.items(), (50, 25), strict=True):
        header, *rows = samples.freemocap_table(motion).splitlines()
        lines = [f"timestamp,{header}", *(f"{k / fps},{row}" for k, row in enumerate(rows))]
        (tmp_path / f"{side}_hand_3d_xyz.csv").write_text("\n".join(lines) + "\n")
    for (side, motion), fps in zip(hands.items(), (50, 25), strict=True):
        read = read_motion_file(tmp_path, MotionFormat(handedness=side))
        assert (len(read.sequence), read.sequence.fps) == (len(motion), fps)


@pytest.mark.parametrize(("centers", "face"), [(0, 0), (0, 478), (4, 0), (4, 136)])
def test_the_hands_of_a_whole_body_stand_behind_its_points(tmp_path, motion, centers, face):
    first = 33 + centers
    body = np.full((len(motion), first + 42 + face, 3), np.nan)
    body[:, first : first + 21] = samples.standard(motion) * 1000
    np.save(tmp_path / "mediapipe_skeleton_3d.npy", body)
    assert distance(read_motion_file(tmp_path / "mediapipe_skeleton_3d.npy"), motion) < EXACT_M


@pytest.mark.parametrize(
    ("name", "heights"),
    [
        ("mediapipe_right_hand_3d_xyz.npy", 1),
        ("output_data/mediapipe_right_hand_3d_xyz.npy", 2),
        ("output_data/mediapipe_right_hand_3d_xyz.csv", 2),
        ("output_data/freemocap_data_by_frame.csv", 2),
        ("recording_by_frame.csv", 1),
        ("recording_by_trajectory.csv", 1),
        ("saved_data/npy/right_hand_frame_name_xyz.npy", 3),
    ],
)
def test_a_folder_of_freemocap_may_be_named_at_any_height(tmp_path, motion, name, heights):
    file = tmp_path / "recording" / name
    file.parent.mkdir(parents=True)
    if file.suffix == ".npy":
        np.save(file, samples.standard(motion) * (1 if "saved" in name else 1000))
    elif "by_frame" in name:
        file.write_text(samples.freemocap_lines([motion], 2))
    else:
        file.write_text(samples.freemocap_table(motion))
    for folder in list(file.parents)[:heights]:
        assert distance(read_motion_file(folder, MotionFormat(handedness=RIGHT)), motion) < EXACT_M


def test_a_recording_of_freemocap_is_a_folder_with_both_hands(tmp_path, motion):
    folder = tmp_path / "recording" / "output_data"
    folder.mkdir(parents=True)
    for side in (RIGHT, LEFT):
        np.save(folder / f"mediapipe_{side}_hand_3d_xyz.npy", samples.standard(samples.motion(side)) * 1000)
    with pytest.raises(InputError, match="--hand"):
        read_motion_file(tmp_path / "recording")
    assert distance(read_motion_file(tmp_path / "recording", MotionFormat(handedness=RIGHT)), motion) < EXACT_M


# ---- what files do not say -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [JointOrder.STANDARD, JointOrder.INTERHAND, JointOrder.MANO16_TIPS, JointOrder.LEVEL])
@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
def test_order_and_unit_of_a_plain_array_are_recognized_and_told(tmp_path, motion, order, unit):
    from jghand_engine.hand.orders import METERS_PER_UNIT

    np.save(tmp_path / "a.npy", from_level(motion.joints_m, order) / METERS_PER_UNIT[unit])
    read = read_motion_file(tmp_path / "a.npy", MotionFormat(handedness=RIGHT))
    assert distance(read, motion) < EXACT_M
    assert any(f"'{order}'" in note and "--order" in note for note in read.notes)
    assert any("--unit" in note for note in read.notes) is (unit != "m"), "a plain array is documented to be meters"


def test_what_is_no_hand_in_any_unit_asks_for_its_length(tmp_path, motion):
    samples.write_bvh(tmp_path / "a.bvh", samples.rig(motion, scale=5))
    with pytest.raises(InputError, match="--hand-length"):
        read_motion_file(tmp_path / "a.bvh")
    read = read_motion_file(tmp_path / "a.bvh", MotionFormat(hand_length_m=0.195))
    bones, wanted = (one - one[:, :1] for one in (read.sequence.joints_m, motion.joints_m))
    assert np.abs(bones - wanted).max() < 5e-4, "0.195 for 0.19496 m"


def test_content_decides_not_the_suffix(tmp_path, motion):
    samples.write_bvh(tmp_path / "a.json", samples.rig(motion, scale=100))
    read = read_motion_file(tmp_path / "a.json")
    assert distance(read, motion) < TEXT_M
    assert "by its content it is BVH" in read.notes[0]


def test_own_files_say_all_and_are_read_without_a_note(tmp_path, motion):
    from jghand_engine.motion.files import write_motion

    for suffix in ("npz", "json", "csv"):
        path = tmp_path / f"a.{suffix}"
        write_motion(path, PoseSequence(motion.joints_m, 25.0, LEFT))
        read = read_motion_file(path)
        assert (read.sequence.fps, read.sequence.handedness, read.notes) == (25.0, LEFT, ())
