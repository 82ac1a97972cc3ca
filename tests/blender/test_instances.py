"""Hands that instances of their collections show are found where Blender draws them, and a mirrored hand is the other
one."""

from types import SimpleNamespace

import bpy
import hands
import numpy as np
import pytest

from blender_addon.core import posing
from blender_addon.core.joints import HANDEDNESSES, NAMES, OTHER
from blender_addon.errors import JGHandFailure
from blender_addon.export import ops_common
from blender_addon.hand import armature, seen_hands, sources
from blender_addon.render import camera, samples

EXACT_M = 1e-6
MIRRORED = ((0.2, -0.1, 0.3), (0.4, 0.1, -0.6), (-1.0, 1.0, 1.0))


def instance_of(collection: bpy.types.Collection, name: str, where: bpy.types.Collection) -> bpy.types.Object:
    thing = bpy.data.objects.new(name, None)
    thing.instance_type, thing.instance_collection = "COLLECTION", collection
    where.objects.link(thing)
    return thing


def asset(context: bpy.types.Context, name: str = "asset") -> bpy.types.Collection:
    """A collection outside the scene with a keyed right hand, whose origin is aside."""
    collection = bpy.data.collections.new(name)
    hand = hands.keyed_hand(context, "right", hands.moving_hand_m("right"))
    collection.objects.link(hand)
    context.scene.collection.objects.unlink(hand)
    collection.instance_offset = (0.1, -0.2, 0.05)
    return collection


def nested_scene(context: bpy.types.Context) -> bpy.types.Collection:
    """An instance, a mirrored one, and one within another; and what Blender does not show."""
    inner, top = asset(context), context.scene.collection
    for place, thing in ((hands.PLACES["stretched"], "plain"), (MIRRORED, "mirrored")):
        hands.put(instance_of(inner, thing, top), place)
    outer = bpy.data.collections.new("outer")
    hands.put(instance_of(inner, "within", outer), hands.PLACES["scaled"])
    hands.put(instance_of(outer, "nested", top), hands.PLACES["moved and turned"])
    hidden = bpy.data.collections.new("hidden")
    hidden.hide_viewport = hidden.hide_render = True
    inner.children.link(hidden)
    for owner, name in ((hidden, "in a hidden collection"), (inner, "hidden itself")):
        twin = inner.objects[0].copy()
        twin.name, twin.hide_viewport, twin.hide_render = name, owner is inner, owner is inner
        owner.objects.link(twin)
    context.view_layer.update()
    return inner


def shown(context: bpy.types.Context) -> list:
    depsgraph = context.evaluated_depsgraph_get()
    things = seen_hands.hands_of(context.scene, context.view_layer)
    found, failures = seen_hands.read(things, depsgraph)
    assert not failures
    return found


def drawn_by_blender(context: bpy.types.Context) -> list[np.ndarray]:
    """(21, 3) joints in the world of every hand among the instances that Blender itself lists."""
    return [
        np.array([each.matrix_world @ each.object.pose.bones[name].head for name in NAMES])
        for each in context.evaluated_depsgraph_get().object_instances
        if armature.is_hand(each.object)
    ]


def test_every_hand_that_blender_instances_is_found_where_blender_draws_it(extension):
    nested_scene(extension)
    wanted = drawn_by_blender(extension)
    found = shown(extension)
    assert len(found) == len(wanted) == 3
    left = list(wanted)
    for hand in found:
        distance = [np.abs(hand.joints_world_m - joints).max() for joints in left]
        assert min(distance) < EXACT_M
        left.pop(int(np.argmin(distance)))
    assert sorted(hand.handedness for hand in found) == ["left", "right", "right"]


def test_a_linked_collection_shows_its_hands_with_their_avatars(extension, tmp_path):
    collection = asset(extension, "library")
    collection.objects[0].jghand.avatar = "//own.jghand"
    bpy.data.libraries.write(str(tmp_path / "library.blend"), {collection})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.collections = ["library"]
    hands.put(instance_of(wanted.collections[0], "placed", bpy.context.scene.collection), hands.PLACES["scaled"])
    bpy.context.view_layer.update()
    (hand,) = shown(bpy.context)
    (joints,) = drawn_by_blender(bpy.context)
    np.testing.assert_allclose(hand.joints_world_m, joints, atol=EXACT_M)
    assert hand.avatar == str(tmp_path / "own.jghand")


def test_a_render_has_every_instance_as_a_hand_of_its_own(extension):
    nested_scene(extension)
    extension.scene.camera = hands.camera_on(extension, (0, 0, 0), 3)
    depsgraph = extension.evaluated_depsgraph_get()
    frame = samples.Frame(lambda: extension.scene.camera, (64, 64), camera.region(extension.scene.render, (64, 64)))
    (moment,) = samples.read_moments(depsgraph, frame, lambda *_: None)
    assert len({hand.joints_world_m.tobytes() for hand in moment.hands}) == 3


def test_a_render_finds_the_instanced_hand_beside_instances_without_any(extension):
    instance_of(bpy.data.collections.new("grass"), "bush", extension.scene.collection)
    instance_of(asset(extension), "placed", extension.scene.collection)
    extension.view_layer.update()
    found = [thing.name for thing in seen_hands.evaluated_sources(extension.evaluated_depsgraph_get())]
    assert found == ["placed"]


def test_an_instance_appears_and_goes_as_blender_tells_of_it(extension):
    collection = asset(extension)
    thing = bpy.data.objects.new("placed", None)
    extension.scene.collection.objects.link(thing)
    extension.view_layer.update()
    assert not shown(extension)
    # opening the next test's scene removes it again
    bpy.app.handlers.depsgraph_update_post.append(lambda _, depsgraph: seen_hands.notice(depsgraph))
    for wanted in (collection, None):
        thing.instance_type, thing.instance_collection = "COLLECTION", wanted
        extension.view_layer.update()
        assert len(shown(extension)) == (wanted is not None)


def beside_a_meadow(context: bpy.types.Context) -> tuple[bpy.types.Collection, bpy.types.Collection]:
    """An instanced collection with a hand and with instances of another one, which has none."""
    inner, meadow = asset(context), bpy.data.collections.new("meadow")
    for place in range(20):
        meadow.objects.link(bpy.data.objects.new(f"grass {place}", None))
    for place in range(3):
        instance_of(meadow, f"patch {place}", inner)
    instance_of(inner, "placed", context.scene.collection)
    context.view_layer.update()
    return inner, meadow


def test_an_edit_beside_instances_looks_into_none_of_them_again(extension, monkeypatch):
    inner, meadow = beside_a_meadow(extension)
    other = bpy.data.objects.new("other", None)
    extension.scene.collection.objects.link(other)
    extension.view_layer.update()
    seen_hands.forget()
    assert len(shown(extension)) == 1
    asked, is_any_hand = [], armature.is_any_hand
    monkeypatch.setattr(armature, "is_any_hand", lambda thing: asked.append(thing.name) or is_any_hand(thing))
    update = SimpleNamespace(
        updates=[SimpleNamespace(id=thing) for thing in (other, extension.scene.objects["placed"])]
    )
    seen_hands.notice(update)
    assert asked == ["other", "placed"]
    monkeypatch.undo()
    bpy.app.handlers.depsgraph_update_post.append(lambda _, depsgraph: seen_hands.notice(depsgraph))
    meadow.objects.link(inner.objects[0])
    extension.view_layer.update()
    assert len(shown(extension)) == 4
    meadow.objects.unlink(inner.objects[0])
    extension.view_layer.update()
    assert len(shown(extension)) == 1


# ---- mirrored hands --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", HANDEDNESSES)
def test_a_mirrored_hand_is_the_other_hand_where_its_bones_are(context, side):
    hand = hands.keyed_hand(context, side, hands.moving_hand_m(side))
    hands.put(hand, MIRRORED)
    context.view_layer.update()
    seen = armature.read_hand(hand, context.evaluated_depsgraph_get())
    assert seen.handedness == OTHER[side]
    np.testing.assert_allclose(seen.joints_world_m, drawn_by_blender(context)[0], atol=EXACT_M)
    turn = seen.world_from_hand[:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1)


def test_a_mirrored_rest_hand_has_the_joints_of_the_other_rest_hand(context):
    hand = armature.build_armature(context, "Hand", posing.rest_joints_m("right"), "right")
    hand.scale.x = -1
    context.view_layer.update()
    seen = armature.read_hand(hand, context.evaluated_depsgraph_get())
    np.testing.assert_allclose(seen.joints_m, posing.rest_joints_m("left"), atol=EXACT_M)


def test_an_instance_mirrors_foreign_rigs_and_hands_of_objects_too(extension):
    rig, _ = hands.mixamo_rig(extension)
    for side in HANDEDNESSES:
        sources.store_map(rig, sources.recognize(rig, side).bone_map)
    holder = bpy.data.objects.new("holder", None)
    joints = hands.joint_empties(extension, "right")
    sources.store_objects(holder, joints, "right")
    collection = bpy.data.collections.new("asset")
    for thing in (rig, holder, *joints):
        collection.objects.link(thing)
    placed = instance_of(collection, "placed", extension.scene.collection)
    hands.put(placed, MIRRORED)
    extension.view_layer.update()
    depsgraph = extension.evaluated_depsgraph_get()
    for thing in (rig, holder):
        plain = sources.read_hands(thing, depsgraph)
        mirrored = sources.read_hands(thing, depsgraph, np.array(placed.matrix_world))
        assert [hand.handedness for hand in mirrored] == [OTHER[hand.handedness] for hand in plain]
        for one, other in zip(plain, mirrored, strict=True):
            wanted = one.joints_world_m @ np.array(placed.matrix_world)[:3, :3].T + np.array(placed.location)
            np.testing.assert_allclose(other.joints_world_m, wanted, atol=EXACT_M)


def flips_at(context: bpy.types.Context, frame: int) -> bpy.types.Object:
    """A hand that is mirrored from a frame on."""
    hand = hands.keyed_hand(context, "right", hands.moving_hand_m("right"))
    driver = hand.driver_add("scale", 0).driver
    driver.expression = f"-1 if frame >= {frame} else 1"
    return hand


def test_a_hand_that_flips_while_the_shutter_is_open_is_blurred_as_the_one_of_its_frame(extension):
    flips_at(extension, 3)
    scene = extension.scene
    scene.camera = hands.camera_on(extension, (0, 0.09, 0), 0.5)
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    scene.render.motion_blur_position = "CENTER"
    for at, side in ((2, "right"), (3, "left")):
        scene.frame_set(at)
        frame = samples.Frame(lambda: scene.camera, (64, 64), camera.region(scene.render, (64, 64)))
        depsgraph = extension.evaluated_depsgraph_get()
        moments = samples.read_moments(depsgraph, frame, lambda whole, part: scene.frame_set(whole, subframe=part))
        assert len(moments) > 1
        assert {hand.handedness for moment in moments for hand in moment.hands} == {side}


def test_an_export_over_a_flip_is_refused_and_parts_of_it_are_written(extension):
    hand = flips_at(extension, 3)
    for frames, side in ((range(1, 3), "right"), (range(3, 6), "left")):
        recordings: list = []
        list(ops_common.record_steps(extension, [hand], frames, recordings))
        assert [recording.handedness for recording in recordings] == [side]
    with pytest.raises(JGHandFailure, match="frame 3") as caught:
        list(ops_common.record_steps(extension, [hand], range(1, 6), []))
    assert caught.value.kind == "mirrored"
