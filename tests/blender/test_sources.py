"""Foreign rigs and sets of objects are read as hands, where they stand and as they are posed."""

import bpy
import hands
import numpy as np
import pytest
from mathutils import Vector

from blender_addon.core import bone_maps, posing
from blender_addon.core.bone_maps import JointSource
from blender_addon.core.joints import HANDEDNESSES, NAMES
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, sources

# float32 of bone chains more than a meter from the origin; worst observed 6.6e-7 m, of Rigify's
EXACT_M = 1e-6


def test_both_hands_of_a_character_are_read_posed_and_constrained(context):
    rig, joints = hands.mixamo_rig(context)
    for side in HANDEDNESSES:
        sources.store_map(rig, sources.recognize(rig, side).bone_map)
    assert armature.is_foreign(rig)
    assert not armature.is_hand(rig)
    assert armature.hands_at_any_frame(context.view_layer) == [rig]
    for hand, side in zip(sources.read_hands(rig, context.evaluated_depsgraph_get()), HANDEDNESSES, strict=True):
        assert hand.handedness == side
        np.testing.assert_allclose(hand.joints_world_m, joints[side], atol=EXACT_M)
    target = bpy.data.objects.new("Target", None)
    target.location = (0.1, 0.2, 1.4)
    context.scene.collection.objects.link(target)
    rig.pose.bones["mixamorig:RightHand"].constraints.new("COPY_LOCATION").target = target
    hands.put(rig, hands.PLACES["scaled"])
    context.view_layer.update()
    right, _left = sources.read_hands(rig, context.evaluated_depsgraph_get())
    np.testing.assert_allclose(right.joints_world_m[0], target.location, atol=EXACT_M)
    bones = rig.evaluated_get(context.evaluated_depsgraph_get()).pose.bones
    expected = rig.matrix_world @ bones["mixamorig:RightHandIndex3"].tail
    np.testing.assert_allclose(right.joints_world_m[NAMES.index("index4")], expected, atol=EXACT_M)


@pytest.fixture
def rigify(context):
    """Blender's own Rigify, switched on for one test."""
    import addon_utils  # there once bpy is

    addon_utils.enable("rigify", default_set=True)
    yield
    addon_utils.disable("rigify", default_set=True)


@pytest.mark.usefixtures("rigify")
def test_a_real_rigify_metarig_and_what_it_generates_are_recognized(context):
    bpy.ops.object.armature_human_metarig_add()
    metarig = context.object
    bpy.ops.pose.rigify_generate()
    (rig,) = (thing for thing in bpy.data.objects if thing.type == "ARMATURE" and thing != metarig)
    depsgraph = context.evaluated_depsgraph_get()
    for side in HANDEDNESSES:
        plain, made = (sources.recognize(thing, side).bone_map for thing in (metarig, rig))
        assert plain.sources[0] == JointSource(f"hand.{side[0].upper()}")
        assert {source.bone[:4] for source in made.sources} == {"DEF-"}
        from_plain, from_made = (
            sources.read_mapped(thing, bone_map, depsgraph).joints_world_m
            for thing, bone_map in ((metarig, plain), (rig, made))
        )
        # the generated fingers lie where the metarig's do
        np.testing.assert_allclose(from_made, from_plain, atol=EXACT_M)
        other = sources.recognize(rig, side)
        assert any("DEF-" in sentence for sentence in other.sentences)


def test_21_objects_serve_as_a_hand_wherever_they_hang(context):
    joints = posing.rest_joints_m("left")
    parent = bpy.data.objects.new("Tracker", None)
    context.scene.collection.objects.link(parent)
    things = []
    for name, place in zip(NAMES, joints, strict=True):
        thing = bpy.data.objects.new(f"left_{name}", None)
        thing.parent, thing.location = parent, place
        context.scene.collection.objects.link(thing)
        things.append(thing)
    hands.put(parent, hands.PLACES["moved and turned"])
    context.scene.unit_settings.scale_length = 0.01
    context.view_layer.update()
    found = sources.recognize_objects(context.scene.objects, "left")
    assert sources.recognize_objects(context.scene.objects, "right").candidates == ()
    holder = bpy.data.objects.new("Hand", None)
    context.scene.collection.objects.link(holder)
    sources.store_objects(holder, sources.objects_of(found.bone_map, context.scene.objects), "left")
    things[3].name = "renamed"
    (hand,) = sources.read_hands(holder, context.evaluated_depsgraph_get())
    expected = 0.01 * np.array([parent.matrix_world @ Vector(place) for place in joints])
    np.testing.assert_allclose(hand.joints_world_m, expected, atol=EXACT_M)
    assert hand.handedness == "left"
    bpy.data.objects.remove(things[7])
    with pytest.raises(JGHandFailure, match="index3"):
        sources.read_hands(holder, context.evaluated_depsgraph_get())
    sources.forget(holder)
    with pytest.raises(JGHandFailure) as caught:
        sources.read_hands(holder, context.evaluated_depsgraph_get())
    assert caught.value.kind == "not_a_hand"


def test_a_map_that_is_not_whole_or_whose_bones_went_away_is_refused_by_name(context):
    rig, _ = hands.mixamo_rig(context)
    found = sources.recognize(rig, "right").bone_map
    depsgraph = context.evaluated_depsgraph_get()
    with pytest.raises(JGHandFailure, match="no bone for ring2"):
        part = [None if name == "ring2" else one for name, one in zip(NAMES, found.sources, strict=True)]
        sources.read_mapped(rig, bone_maps.by_hand("right", part), depsgraph)
    rig.data.bones["mixamorig:RightHandRing2"].name = "something"
    with pytest.raises(JGHandFailure, match="not there any more: mixamorig:RightHandRing2"):
        sources.read_mapped(rig, found, context.evaluated_depsgraph_get())
    rig[armature.MAP_PROPERTIES["right"]] = "nonsense"
    with pytest.raises(JGHandFailure) as caught:
        sources.read_hands(rig, context.evaluated_depsgraph_get())
    assert caught.value.kind == "bad_bone_map"


def test_a_foreign_rig_is_refused_for_the_same_reasons_as_ours(context):
    rig, _ = hands.mixamo_rig(context)
    found = sources.recognize(rig, "right").bone_map
    rig.scale = (0, 1, 1)
    context.view_layer.update()
    with pytest.raises(JGHandFailure) as caught:
        sources.read_mapped(rig, found, context.evaluated_depsgraph_get())
    assert caught.value.kind == "zero_scale"
    rig.scale, rig.hide_viewport = (1, 1, 1), True
    context.view_layer.update()
    with pytest.raises(JGHandFailure) as caught:
        sources.read_mapped(rig, found, context.evaluated_depsgraph_get())
    assert caught.value.kind == "hidden"


def test_objects_that_are_no_hand_are_refused(context):
    thing = bpy.data.objects.new("Thing", None)
    context.scene.collection.objects.link(thing)
    with pytest.raises(JGHandFailure) as caught:
        sources.read_hands(thing, context.evaluated_depsgraph_get())
    assert caught.value.kind == "not_a_hand"
