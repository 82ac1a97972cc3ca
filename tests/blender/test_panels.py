"""Every panel draws in every state of a scene, with what Blender's layouts take, and says what an artist needs."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import hands
import pytest
from recording_layout import RecordingLayout, draw, draw_rows

from blender_addon import registration, versions
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, controls, pose_library
from blender_addon.hand import panel as hand_panel
from blender_addon.render import panel as picture
from blender_addon.render import panel_quality
from blender_addon.renderer import panel as advanced
from blender_addon.renderer import runtime
from blender_addon.renderer.link import Status
from blender_addon.viewport import views

PANELS = {
    panel.bl_idname: panel
    for module in registration.WITH_CLASSES
    for panel in module.CLASSES
    if issubclass(panel, bpy.types.Panel) and hasattr(panel, "bl_idname")
    if panel.bl_space_type == "VIEW_3D"
}
READY = Status("ready", 90.0, None, {"device": "cpu", "engine_version": "0.1.0", "pid": 7, "protocol": 2})
RECEIPT = {
    "total_ms": 7.2,
    "backend": "avx2",
    "threads": 2,
    "gaussians": 60000,
    "visible_gaussians": 51000,
    "notes": ["index1 flexion 105°: 12° outside the 0° to 93° that was trained"],
    "stages": [
        {"name": "skin", "ran": True, "milliseconds": 3.6},
        {"name": "ids", "ran": False, "reason": "not asked"},
    ],
    "effects": [
        {"effect": "depth", "runs": True, "reason": "requested", "estimated_ms": 0.5},
        {"effect": "self-shadow", "runs": False, "reason": "no finger is near another", "estimated_ms": 0.4},
    ],
}


@pytest.fixture
def engine(extension, monkeypatch):
    """The engine as the panels see it: `engine.status` may be changed."""
    link = SimpleNamespace(status=READY, log="last words")
    monkeypatch.setattr(runtime, "link", lambda: link)
    return link


def drawn(context: bpy.types.Context) -> dict[str, RecordingLayout]:
    """What is seen of the tab."""
    layouts = {name: draw(panel, context) for name, panel in PANELS.items()}
    return {name: layout for name, layout in layouts.items() if layout is not None}


def text_of(layout: RecordingLayout) -> str:
    return " ".join(layout.texts)


def add(side: str = "right", **options: bool) -> bpy.types.Object:
    bpy.ops.jghand.add_hand(handedness=side, **options)
    return bpy.context.object


def test_an_empty_scene_shows_one_sentence_and_one_button(extension, engine):
    seen = draw(hand_panel.HandPanel, extension)
    assert seen.operators == ["jghand.add_hand"]
    assert "Add a hand" in text_of(seen)
    for panel in (
        hand_panel.PosePanel,
        hand_panel.BonesPanel,
        hand_panel.MotionPanel,
        picture.ViewPanel,
        picture.RenderPanel,
    ):
        assert draw(panel, extension) is None
    assert draw(panel_quality.QualityPanel, extension) is None


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("with_controls", [True, False])
def test_all_panels_draw_for_a_hand_of_ours(extension, engine, side, with_controls):
    thing = add(side, use_controls=with_controls)
    runtime.set_report(runtime.VIEWPORT, RECEIPT)
    runtime.set_report(runtime.RENDER, RECEIPT)
    seen = drawn(extension)
    assert hand_panel.ControlsPanel.bl_idname in seen
    assert hand_panel.BonesPanel.bl_idname not in seen
    assert ("jghand.hold_tip" in seen[hand_panel.ControlsPanel.bl_idname].operators) == with_controls
    bpy.ops.object.mode_set(mode="POSE")
    drawn(extension)
    if with_controls:
        controls.hold_tip(thing, "index")
        controls.use_joint_limits(thing, False)
        drawn(extension)
        controls.mute_controls(thing, True)
        assert "JGHand" not in text_of(drawn(extension)[hand_panel.ControlsPanel.bl_idname])


def test_all_panels_draw_with_a_camera_or_nothing_active(extension, engine):
    add()
    for active in (extension.scene.camera, None):
        extension.view_layer.objects.active = active
        seen = drawn(extension)
        assert hand_panel.HandPanel.bl_idname in seen
        assert hand_panel.PosePanel.bl_idname not in seen


def test_an_armature_that_is_no_hand_may_become_one(extension, engine):
    hands.mixamo_rig(extension)
    seen = draw(hand_panel.HandPanel, extension)
    assert "jghand.use_armature" in seen.operators


def test_the_bones_of_a_foreign_rig_are_a_list_that_says_what_is_missing(extension, engine):
    rig, _ = hands.mixamo_rig(extension)
    bpy.ops.jghand.use_armature()
    seen = draw(hand_panel.BonesPanel, extension)
    assert "All 21 joints have a bone" in text_of(seen)
    rows = draw_rows(hand_panel.JointList, extension, rig.jghand, rig.jghand.joints)
    assert {"thumb4", "…Thumb3", "tail"} <= set(rows.texts)
    assert not [one for one in rows.drawn if one.function == "prop_search"]
    rig.jghand.joints["index2"].bone = ""
    rig.jghand.joints["ring1"].bone = "nothing of that name"
    said = text_of(draw(hand_panel.BonesPanel, extension))
    assert "1 of 21 joints have no bone: index2" in said
    assert "ring1 (nothing of that name)" in " ".join(said.split())
    rows = draw_rows(hand_panel.JointList, extension, rig.jghand, rig.jghand.joints)
    assert len([one for one in rows.drawn if one.function == "prop_search"]) == 2
    rig.jghand.map_hand = "left"
    assert "All 21 joints have a bone" in text_of(draw(hand_panel.BonesPanel, extension))
    bpy.ops.jghand.forget(handedness="left")
    assert "not used for this hand" in text_of(draw(hand_panel.BonesPanel, extension))
    rig.jghand.joints.clear()
    rig.jghand.map_hand = "right"
    assert "jghand.edit_bone_map" in draw(hand_panel.BonesPanel, extension).operators
    drawn(extension)


def test_a_hand_of_objects_shows_its_objects_and_which_are_gone(extension, engine):
    things = hands.joint_empties(extension, "left")
    bpy.ops.jghand.use_objects()
    seen = draw(hand_panel.BonesPanel, extension)
    assert len([one for one in seen.drawn if one.function == "prop"]) == 21
    bpy.data.objects.remove(things[7])
    assert "index3" in text_of(draw(hand_panel.BonesPanel, extension))
    drawn(extension)


def test_every_hand_has_a_row_that_selects_it(extension, engine):
    first, second = add("right"), add("left")
    seen = draw(hand_panel.HandPanel, extension)
    rows = [one for one in seen.drawn if one.arguments.get("operator") == "jghand.select_hand"]
    assert [one.settings["uid"] for one in rows] == [second.session_uid, first.session_uid]
    assert [one.arguments["depress"] for one in rows] == [True, False]


def test_the_pose_library_is_installed_once_and_then_shown(extension, engine):
    add()
    assert "jghand.make_pose_assets" in draw(hand_panel.PosePanel, extension).operators
    pose_library.use_library()
    assert "jghand.show_pose_shelf" in draw(hand_panel.PosePanel, extension).operators


@pytest.mark.parametrize(
    ("status", "wanted"),
    [
        (Status("stopped", 0.0), "Engine off"),
        (Status("starting", 12.0), "Starting…  12 s"),
        (READY, "Ready · CPU"),
        (Status("slow", 12.0, None, READY.handshake), "The engine is not answering"),
        (Status("stopping", 2.0), "Stopping…  2 s"),
        (Status("failed", 5.0, JGHandFailure("killed", "signal 9")), "The system ended the engine"),
        (Status("failed", 5.0, None), "The engine stopped"),
    ],
)
def test_the_first_line_says_how_the_engine_is(extension, engine, status, wanted):
    add()
    engine.status = status
    assert wanted in text_of(draw(hand_panel.HandPanel, extension))
    drawn(extension)


def test_a_failed_engine_is_told_even_in_an_empty_scene(extension, engine):
    engine.status = Status("failed", 5.0, JGHandFailure("no_interpreter", "nothing found"))
    seen = draw(hand_panel.HandPanel, extension)
    assert "No engine is set up" in text_of(seen)
    assert "jghand.open_preferences" in seen.operators


def test_a_hand_that_cannot_be_shown_says_why_once(extension, engine, monkeypatch):
    add()
    found = [("Right Hand", JGHandFailure("mirrored", "small print")), ("", JGHandFailure("killed"))]
    monkeypatch.setattr(views, "problems", lambda: found)
    engine.status = Status("failed", 5.0, JGHandFailure("killed"))
    said = text_of(draw(hand_panel.HandPanel, extension))
    assert "Right Hand: Mirrored scale is not supported" in said
    assert said.count("The system ended the engine") == 1


def test_late_pictures_are_counted(extension, engine, monkeypatch):
    add()
    assert "Late" not in text_of(draw(picture.ViewPanel, extension))
    monkeypatch.setattr(views, "late_frames", lambda: 7)
    assert "Late: 7" in draw(picture.ViewPanel, extension).texts


def test_quality_shows_what_the_last_picture_did_and_why(extension, engine):
    add()
    runtime.set_report(runtime.VIEWPORT, RECEIPT)
    extension.scene.jghand.use_viewport_budget = True
    extension.scene.jghand.viewport_budget_ms = 5.0
    seen = draw(panel_quality.QualityPanel, extension)
    assert "index1: flexion 12° beyond training" in seen.texts
    assert "Over Budget" in seen.texts
    bars = [one.arguments for one in seen.drawn if one.function == "progress"]
    assert [(bar["text"], bar["factor"]) for bar in bars] == [("7.2 ms", 1.0), ("3.6 ms", 0.5)]
    effects = draw(panel_quality.EffectsPanel, extension)
    tips = {one.text: one.settings["text"] for one in effects.drawn if one.function == "operator"}
    assert tips["Self-Shadow"] == "Not run: no finger is near another"
    assert tips["Depth"] == "Ran: requested"


def test_without_a_picture_quality_says_so(extension, engine):
    add()
    runtime._reports.clear()
    assert "No picture yet" in text_of(draw(panel_quality.QualityPanel, extension))
    assert draw(panel_quality.EffectsPanel, extension) is None


def test_render_says_what_the_view_transform_does_and_offers_standard(extension, engine):
    add()
    extension.scene.view_settings.view_transform = "AgX"
    seen = draw(picture.RenderPanel, extension)
    assert "View transform is AgX" in text_of(seen)
    assert "jghand.use_standard" in seen.operators
    bpy.ops.jghand.use_standard()
    assert "jghand.use_standard" not in draw(picture.RenderPanel, extension).operators
    extension.scene.view_settings.exposure = 1.0
    assert "exposure" in text_of(draw(picture.RenderPanel, extension))


def test_a_camera_that_cannot_be_used_is_told(extension, engine):
    add(use_camera=True)
    extension.scene.camera.data.type = "PANO"
    assert "Panoramic" in text_of(draw(picture.RenderPanel, extension))
    extension.scene.camera = None
    assert "no camera" in text_of(draw(picture.RenderPanel, extension))


@pytest.mark.parametrize("native", [True, False])
def test_where_blender_has_splat_objects_the_view_says_that_hands_are_pictures_there_too(
    extension, engine, monkeypatch, native
):
    add()
    monkeypatch.setattr(versions, "has_native_splats", lambda: native)
    assert ("splat objects" in text_of(draw(picture.ViewPanel, extension))) is native


def test_a_view_that_shows_no_hands_says_why():
    assert "Wireframe" in picture._shading_hint("WIREFRAME", "CYCLES")
    assert "JGHand engine" in picture._shading_hint("RENDERED", "CYCLES")
    assert picture._shading_hint("RENDERED", "JGHAND") == ""
    assert picture._shading_hint("SOLID", "CYCLES") == ""


def test_advanced_shows_the_engine_and_the_last_render(extension, engine):
    add()
    runtime.set_report(runtime.RENDER, RECEIPT)
    seen = draw(advanced.AdvancedPanel, extension)
    assert {"Device", "cpu", "Process", "7"} <= set(seen.texts)
    assert "Last Picture" in seen.texts


def test_panels_do_not_ask_every_object_of_a_scene_at_every_redraw(extension, monkeypatch):
    for place in range(50):
        extension.scene.collection.objects.link(bpy.data.objects.new(f"thing {place}", None))
    extension.view_layer.update()
    drawn(extension)
    asked = []
    is_any_hand = armature.is_any_hand
    monkeypatch.setattr(armature, "is_any_hand", lambda thing: asked.append(thing) or is_any_hand(thing))
    assert picture.ViewPanel.bl_idname not in drawn(extension)
    assert len(asked) < 20
    monkeypatch.undo()
    add()
    assert picture.ViewPanel.bl_idname in drawn(extension)


def test_panels_stand_in_the_tab_in_the_order_of_work():
    top = [panel for panel in PANELS.values() if not hasattr(panel, "bl_parent_id")]
    assert {panel.bl_category for panel in top} == {"JGHand"}
    wanted = ["Hand", "Bones", "Pose", "Motion", "View", "Render", "Quality and Speed", "Advanced"]
    ordered = [panel.bl_label for panel in sorted(top, key=lambda panel: panel.bl_order)]
    assert [label for label in ordered if label in wanted] == wanted
