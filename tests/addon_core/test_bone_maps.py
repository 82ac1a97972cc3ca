"""The 21 joints are found in rigs of every convention from names alone, and doubt is told, never resolved silently."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_addon.core import bone_maps
from blender_addon.core.bone_maps import HEAD, TAIL, JointSource
from blender_addon.core.joints import HANDEDNESSES, NAMES

ENGLISH = ("thumb", "index", "middle", "ring", "pinky")
LITTLE = ("thumb", "index", "middle", "ring", "little")

# The bones of both hands and some others, as the rigs have them, and the 16 bones of the joints other than tips.
# Written out by rule of each rig and not from the tables under test.


def rigify(prefix: str = "", *, generated: bool = False) -> tuple[list[str], dict]:
    """As Blender's Rigify makes them; `generated`: with all the other sets of the same bones."""
    bones, joints = ["spine", "spine.001"], {}
    for s, side in (("R", "right"), ("L", "left")):
        words = ("thumb", "f_index", "f_middle", "f_ring", "f_pinky")
        hand = [f"{prefix}hand.{s}", *(f"{prefix}{word}.0{n}.{s}" for word in words for n in (1, 2, 3))]
        joints[side] = hand
        bones += [*hand, *(f"{prefix}palm.0{n}.{s}" for n in (1, 2, 3, 4)), f"{prefix}forearm.{s}"]
        if generated:
            bones += [name.replace(prefix, "ORG-") for name in hand]
            bones += [name.replace(prefix, "MCH-") for name in hand[1:]]
            bones += [name.removeprefix(prefix) for name in hand[1:]]
            bones += [f"{word}.01.{s}.001" for word in words] + [f"{word}.01_master.{s}" for word in words]
            bones += [f"hand_ik.{s}", f"hand_fk.{s}", f"hand_tweak.{s}", f"palm.{s}", f"MCH-hand_ik.parent.{s}"]
    return bones, joints


def mixamo(prefix: str = "mixamorig:", *, tips: bool = True) -> tuple[list[str], dict]:
    bones, joints = [f"{prefix}Hips", f"{prefix}HeadTop_End"], {}
    for word, side in (("Right", "right"), ("Left", "left")):
        hand = [f"{prefix}{word}Hand"]
        hand += [f"{prefix}{word}Hand{finger.title()}{n}" for finger in ENGLISH for n in (1, 2, 3)]
        joints[side] = hand
        bones += [*hand, f"{prefix}{word}ForeArm", f"{prefix}{word}ToeBase", f"{prefix}{word}Toe_End"]
        if tips:
            bones += [f"{prefix}{word}Hand{finger.title()}4" for finger in ENGLISH]
    return bones, joints


def vrm(version: int, form: str) -> tuple[list[str], dict]:
    """form: `{side}{finger}{part}` (the specification), `{finger}_{part}.{s}` (the Blender add-on)."""
    bones, joints = ["hips", "leftEye"], {}
    for s, side in (("R", "right"), ("L", "left")):
        camel = "{side}" in form
        hand = [f"{side}Hand" if camel else f"hand.{s}"]
        for finger in LITTLE:
            parts = ["Proximal", "Intermediate", "Distal"]
            if finger == "thumb" and version == 1:
                parts = ["Metacarpal", "Proximal", "Distal"]
            hand += [
                form.format(side=side, s=s, finger=finger.title(), part=part)
                if camel
                else form.format(s=s, finger=finger, part=part.lower())
                for part in parts
            ]
        joints[side] = hand
        bones += [*hand, f"{side}LowerArm", f"{side}Toes"]
    return bones, joints


def vroid() -> tuple[list[str], dict]:
    bones, joints = ["J_Bip_C_Hips", "J_Adj_L_FaceEye"], {}
    for s, side in (("R", "right"), ("L", "left")):
        joints[side] = [f"J_Bip_{s}_Hand"] + [f"J_Bip_{s}_{f.title()}{n}" for f in LITTLE for n in (1, 2, 3)]
        bones += [*joints[side], f"J_Bip_{s}_LowerArm", f"J_Sec_{s}_Bust1"]
    return bones, joints


def makehuman() -> tuple[list[str], dict]:
    bones, joints = ["root", "spine05"], {}
    for s, side in (("R", "right"), ("L", "left")):
        joints[side] = [f"wrist.{s}"] + [f"finger{f}-{n}.{s}" for f in range(1, 6) for n in (1, 2, 3)]
        bones += [*joints[side], *(f"metacarpal{n}.{s}" for n in range(1, 5))]
        bones += [f"toe{f}-{n}.{s}" for f in range(1, 6) for n in (1, 2, 3)] + [f"lowerarm01.{s}"]
    return bones, joints


def unreal(generation: int) -> tuple[list[str], dict]:
    """Also MPFB's game engine rig (4)."""
    bones, joints = ["root", "pelvis", "spine_01", "ik_hand_root", "ik_hand_gun"], {}
    for s, side in (("r", "right"), ("l", "left")):
        joints[side] = [f"hand_{s}"] + [f"{finger}_0{n}_{s}" for finger in ENGLISH for n in (1, 2, 3)]
        bones += [*joints[side], f"ik_hand_{s}", f"lowerarm_{s}", f"lowerarm_twist_01_{s}"]
        if generation == 5:
            bones += [f"{finger}_metacarpal_{s}" for finger in ENGLISH[1:]]
    return bones, joints


def auto_rig_pro() -> tuple[list[str], dict]:
    bones, joints = ["root.x", "c_traj"], {}
    for s, side in (("r", "right"), ("l", "left")):
        hand = [f"hand.{s}"]
        for finger in ENGLISH:
            hand += [f"{finger}1.{s}", f"c_{finger}2.{s}", f"c_{finger}3.{s}"]
            bones += [f"c_{finger}1.{s}", f"c_{finger}1_base.{s}", f"c_toes_{finger}1.{s}", f"c_toes_{finger}2.{s}"]
        joints[side] = hand
        bones += [*hand, f"c_hand_fk.{s}", f"c_hand_ik.{s}", f"forearm_stretch.{s}", f"c_{finger}_ik.{s}"]
    return bones, joints


RIGS = {
    "rigify metarig": rigify(),
    "rigify generated": rigify("DEF-", generated=True),
    "rigify, only ORG-": rigify("ORG-"),
    "mixamo": mixamo(),
    "mixamo, several": mixamo("mixamorig9:"),
    "mixamo without a colon": mixamo("mixamorig"),
    "mixamo, HumanIK, MPFB without a prefix": mixamo("", tips=False),
    "mixamo in a namespace": mixamo("Hero_v2|mixamorig:"),
    "vrm 1": vrm(1, "{side}{finger}{part}"),
    "vrm 0": vrm(0, "{side}{finger}{part}"),
    "vrm 1, the add-on": vrm(1, "{finger}_{part}.{s}"),
    "vrm 0, the add-on": vrm(0, "{finger}_{part}.{s}"),
    "vroid": vroid(),
    "makehuman default": makehuman(),
    "unreal 4, MPFB game engine": unreal(4),
    "unreal 5": unreal(5),
    "auto-rig pro": auto_rig_pro(),
}
TITLES = {
    "rigify": "Rigify",
    "mixamo": "Mixamo",
    "vrm 1": "VRM 1",
    "vrm 0": "VRM 0",
    "vroid": "VRoid",
    "makehuman": "MakeHuman, MPFB",
    "unreal": "Unreal mannequin",
    "auto-rig": "Auto-Rig Pro",
}


def expected(joints: list[str], bones: list[str]) -> list[JointSource]:
    """21 sources from the 16 bones: tips from Mixamo's tip bones, else from tails."""
    sources = [JointSource(joints[0])]
    for finger in range(5):
        chain = joints[1 + 3 * finger : 4 + 3 * finger]
        tip = chain[-1][:-1] + "4"
        has_tip = tip in bones
        sources += [*map(JointSource, chain), JointSource(tip) if has_tip else JointSource(chain[-1], TAIL)]
    return sources


@pytest.mark.parametrize("handedness", HANDEDNESSES)
@pytest.mark.parametrize("rig", RIGS)
def test_every_convention_is_recognized_whole(rig, handedness):
    bones, joints = RIGS[rig]
    recognition = bone_maps.recognize(bones, handedness)
    assert recognition.bone_map is not None, recognition.sentences
    assert list(recognition.bone_map.sources) == expected(joints[handedness], bones)
    assert recognition.bone_map.complete
    assert recognition.bone_map.missing == ()
    (title,) = {title for word, title in TITLES.items() if rig.startswith(word)}
    assert recognition.sentences[0] == f"Recognized: {title}."


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_our_own_armature_is_recognized_with_its_controls(handedness):
    recognition = bone_maps.recognize([*NAMES, "control_hand", "control_index", "ik_index"], handedness)
    assert recognition.bone_map.sources == tuple(map(JointSource, NAMES))


def test_empties_named_after_landmarks_need_tips_of_their_own():
    fingers = {"thumb": ("cmc", "mcp", "ip", "tip")}
    names = []
    for side in HANDEDNESSES:
        names.append(f"{side}_hand_wrist")
        for finger in ENGLISH:
            word = "thumb" if finger == "thumb" else f"{finger}_finger"
            names += [f"{side}_hand_{word}_{joint}" for joint in fingers.get(finger, ("mcp", "pip", "dip", "tip"))]
    for side in HANDEDNESSES:
        found = bone_maps.recognize(names, side, tails=False).bone_map
        assert found.complete
        assert [source.bone for source in found.sources] == [name for name in names if name.startswith(side)]
    without = [name for name in names if not name.endswith("index_finger_tip")]
    found = bone_maps.recognize(without, "right", tails=False).bone_map
    assert found.missing == ("index4 has no bone: looked for index_finger_tip.",)


@pytest.mark.parametrize("rig", RIGS)
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32), extra=st.lists(st.text(max_size=12).map("prop_{}".format), max_size=6))
def test_order_case_separators_and_other_bones_do_not_matter(rig, seed, extra):
    bones, _ = RIGS[rig]
    plain = bone_maps.recognize(bones, "left")
    dice = random.Random(seed)
    shuffled = [*bones, *extra, "cloak_03.L", "DEF-spine", "tail.001", "eye_r", "ik_foot_root"]
    dice.shuffle(shuffled)
    assert bone_maps.recognize(shuffled, "left") == plain
    change = dice.choice([str.upper, str.lower, str.swapcase, lambda name: name.replace("_", "-").replace(":", "_")])
    changed = bone_maps.recognize([change(name) for name in shuffled], "left").bone_map
    assert changed.sources == tuple(JointSource(change(source.bone), source.end) for source in plain.bone_map.sources)


@pytest.mark.parametrize("ending", ["_end", "_tip", ".Nub"])
def test_tip_bones_are_used_where_there_are_any(ending):
    bones, _ = RIGS["unreal 4, MPFB game engine"]
    tip = f"index_03_r{ending}"
    found = bone_maps.recognize([*bones, tip], "right").bone_map
    assert found.sources[NAMES.index("index4")] == JointSource(tip, HEAD)
    assert found.sources[NAMES.index("ring4")] == JointSource("ring_03_r", TAIL)
    assert found.notes == ("No tip bones: the tips of thumb, middle, ring, pinky are the tails of the last bones.",)


def test_the_deforming_bones_of_rigify_are_used_and_the_others_are_told():
    found = bone_maps.recognize(RIGS["rigify generated"][0], "right").bone_map
    assert all(source.bone.startswith("DEF-") for source in found.sources)
    assert "The rig has these bones several times (ORG- too): those with DEF- are used." in found.notes


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("joint", ["wrist", "index2", "ring1", "pinky3"])
def test_a_missing_bone_is_named_and_the_others_are_kept(rig, joint):
    bones, joints = RIGS[rig]
    whole = expected(joints["right"], bones)
    gone = whole[NAMES.index(joint)].bone
    set_of_bones = {gone}
    if rig == "auto-rig pro":  # its control would step in
        set_of_bones |= {f"c_{gone}", gone.removeprefix("c_")}
    if rig == "rigify generated":  # the other sets would
        set_of_bones |= {gone.replace("DEF-", "ORG-")}
    found = bone_maps.recognize([name for name in bones if name not in set_of_bones], "right").bone_map
    assert found is not None
    assert not found.complete
    place = NAMES.index(joint)
    lost = {place} | ({place + 1} if joint == "pinky3" and whole[place + 1].end == TAIL else set())
    assert [at for at, source in enumerate(found.sources) if source is None] == sorted(lost)
    assert found.missing[0].startswith(f"{joint} has no bone: looked for ")


def test_two_characters_in_one_armature_are_a_question():
    bones = [*mixamo("mixamorig:")[0], *mixamo("mixamorig1:")[0]]
    recognition = bone_maps.recognize(bones, "right")
    assert recognition.bone_map is None
    assert len(recognition.candidates) == 2
    (sentence,) = recognition.sentences
    assert "mixamorig:RightHand" in sentence
    assert "mixamorig1:RightHand" in sentence


def test_copied_bones_are_a_question():
    bones, _ = RIGS["vrm 1"]
    recognition = bone_maps.recognize([*bones, *(f"{name}.001" for name in bones)], "left")
    assert recognition.bone_map is None
    assert len(recognition.candidates) == 2


def test_a_thumb_that_may_be_of_either_vrm_is_a_question():
    bones, _ = RIGS["vrm 1"]
    recognition = bone_maps.recognize([*bones, "rightThumbIntermediate"], "right")
    assert recognition.bone_map is None
    assert {candidate.convention for candidate in recognition.candidates} == {"VRM 0", "VRM 1"}
    assert "They differ in thumb1, thumb2" in recognition.sentences[0]


def test_a_thumb_with_two_of_its_three_vrm_bones_is_a_question():
    for version, gone in ((0, "rightThumbIntermediate"), (1, "rightThumbMetacarpal")):
        bones, _ = vrm(version, "{side}{finger}{part}")
        recognition = bone_maps.recognize([name for name in bones if name != gone], "right")
        assert {candidate.convention for candidate in recognition.candidates} == {"VRM 0", "VRM 1"}


def test_two_bones_that_may_be_one_joint_are_left_to_the_artist():
    bones, _ = RIGS["unreal 4, MPFB game engine"]
    found = bone_maps.recognize([*bones, "Index-02-R"], "right").bone_map
    assert found.sources[NAMES.index("index2")] is None
    assert found.missing == ("index2 may be Index-02-R or index_02_r: choose one.",)


def test_what_is_no_hand_is_said_to_be_none():
    for names in ([], ["Bone", "Bone.001"], ["wrist"], ["hand.R", "forearm.R"], ["index1", "index2", "index3"]):
        recognition = bone_maps.recognize(names, "right")
        assert recognition.candidates == ()
        assert recognition.sentences[0].startswith("No bones of a right hand were recognized.")


def test_a_map_survives_being_stored():
    found = bone_maps.recognize(RIGS["makehuman default"][0], "left").bone_map
    again = bone_maps.from_json(found.as_json())
    assert again.sources == found.sources
    assert again.handedness == "left"
    part = [None if name == "ring2" else source for name, source in zip(NAMES, found.sources, strict=True)]
    stored = bone_maps.by_hand("left", part).as_json()
    assert bone_maps.from_json(stored).missing == ("ring2 has no bone.",)
