"""Every panel draws in every state of a scene, with what Blender's layouts take, and says what an artist needs."""

from types import SimpleNamespace

import bpy
import hands
import pytest
from recording_layout import RecordingLayout, draw, draw_rows
from test_avatar_cards import write_avatar

from blender_addon import registration
from blender_addon.core.poses import ALL_POSES
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, controls, seen_hands
from blender_addon.hand import panel as hand_panel
from blender_addon.hand import poses as pose_library
from blender_addon.render import panel as picture
from blender_addon.renderer import runtime
from blender_addon.renderer.link import Status
from blender_addon.renderer.panel import draw_status
from blender_addon.viewport import views

PANELS = {
    panel.bl_idname: panel
    for module in registration.WITH_CLASSES
    for panel in module.CLASSES
    if issubclass(panel, bpy.types.Panel) and hasattr(panel, "bl_idname")
    if panel.bl_space_type == "VIEW_3D"
}
# functions of a layout that draw something to click
CONTROLS = {"prop", "prop_search", "operator", "operator_menu_enum", "menu", "popover", "template_list"}
READY = Status("ready", 90.0, None, {"engine_version": "0.1.0", "pid": 7, "protocol": 2})
RECEIPT = {
    "total_ms": 7.2,
    "backend": "avx2",
    "threads": 2,
    "gaussians": 60000,
    "visible_gaussians": 51000,
    "notes": ["index1 flexion 105°: 12° outside the 0° to 93° that was trained"],
    "stages": [{"name": "skin", "ran": True, "milliseconds": 3.6, "reason": "exact"}],
}


@pytest.fixture
def engine(extension, monkeypatch):
    """The engine as the panels see it: `engine.status` may be changed."""
    link = SimpleNamespace(status=READY, log="last words")
    monkeypatch.setattr(runtime, "link", lambda: link)
    return link


def drawn(context: bpy.types.Context) -> dict[str, RecordingLayout]:
    """What is seen of the tab; a panel in another one only with that."""
    seen: dict[str, RecordingLayout] = {}
    for name, panel in PANELS.items():
        if getattr(panel, "bl_parent_id", name) in {*seen, name}:
            layout = draw(panel, context)
            seen |= {name: layout} if layout is not None else {}
    return seen


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
        picture.RenderPanel,
        picture.QualityPage,
    ):
        assert draw(panel, extension) is None


def test_a_scene_whose_hands_are_instanced_alone_shows_its_problems_and_the_other_panels(
    extension, engine, monkeypatch
):
    thing = add()
    collection = bpy.data.collections.new("asset")
    collection.objects.link(thing)
    for owner in thing.users_collection:
        if owner != collection:
            owner.objects.unlink(thing)
    placed = bpy.data.objects.new("placed", None)
    placed.instance_type, placed.instance_collection = "COLLECTION", collection
    extension.scene.collection.objects.link(placed)
    extension.view_layer.update()
    seen_hands.forget()
    monkeypatch.setattr(views, "problems", lambda: [("placed", JGHandFailure("no_avatar"))])
    engine.status = Status("starting", 0.0)
    seen = drawn(extension)
    text = text_of(seen[hand_panel.HandPanel.bl_idname])
    assert "placed" in text
    assert "Add a hand" not in text
    assert "jghand.select_hand" not in seen[hand_panel.HandPanel.bl_idname].operators
    assert {hand_panel.MotionPanel.bl_idname, picture.RenderPanel.bl_idname} <= set(seen)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("with_controls", [True, False])
def test_all_panels_draw_for_a_hand_of_ours(extension, engine, side, with_controls):
    thing = add(side, use_controls=with_controls)
    runtime.reports[runtime.VIEWPORT] = RECEIPT
    runtime.reports[runtime.RENDER] = RECEIPT
    seen = drawn(extension)
    assert hand_panel.ControlsPanel.bl_idname in seen
    assert hand_panel.BonesPanel.bl_idname not in seen
    assert (hand_panel.PinsPanel.bl_idname in seen) == with_controls
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


def test_a_ready_renderer_is_told_in_the_preferences_alone(extension, engine):
    add()
    layout = RecordingLayout()
    draw_status(layout, extension)
    assert "Ready" in text_of(layout)
    assert "Ready" not in text_of(draw(hand_panel.HandPanel, extension))


def test_a_failed_engine_is_told_even_in_an_empty_scene(extension, engine):
    engine.status = Status("failed", 5.0, JGHandFailure("no_interpreter", "nothing found"))
    seen = draw(hand_panel.HandPanel, extension)
    assert "The renderer cannot be started" in text_of(seen)
    assert "preferences.addon_show" in seen.operators


@pytest.mark.parametrize("damaged", [True, False])
def test_an_avatar_that_is_damaged_or_gone_is_told_in_the_panel(extension, engine, monkeypatch, tmp_path, damaged):
    file, hand = tmp_path / "mine.jghand", add()
    file.write_bytes(b"no avatar") if damaged else None
    hand.jghand.avatar = str(file)
    sentence = "The avatar is damaged" if damaged else "The file of the avatar does not exist"
    assert sentence in text_of(draw(hand_panel.CardPanel, extension))
    told = f"{file}: wanted a .jghand file, got a header of no length."
    monkeypatch.setattr(views, "problems", lambda: [("", JGHandFailure("bad_avatar", told))])
    assert told in text_of(draw(hand_panel.HandPanel, extension))


def test_the_details_of_an_avatar_have_the_whole_width_that_their_lines_are_broken_for(extension, engine):
    add()
    seen = draw(hand_panel.CardPanel, extension)
    assert "Name: JGHand built-in" in text_of(seen)
    assert "split" not in [one.function for one in seen.drawn]


def test_a_hand_that_cannot_be_shown_says_why_once(extension, engine, monkeypatch):
    add()
    found = [("Right Hand", JGHandFailure("zero_scale", "small print")), ("", JGHandFailure("killed"))]
    monkeypatch.setattr(views, "problems", lambda: found)
    engine.status = Status("failed", 5.0, JGHandFailure("killed"))
    said = text_of(draw(hand_panel.HandPanel, extension))
    assert "Right Hand: A scale of zero is not supported" in said
    assert said.count("The system ended the renderer") == 1


def test_dropped_frames_are_counted(extension, engine, monkeypatch):
    add()
    assert "Dropped" not in text_of(draw(picture.StatisticsPage, extension))
    monkeypatch.setattr(views, "late_frames", lambda: 7)
    assert "Dropped frames: 7" in draw(picture.StatisticsPage, extension).texts


def test_statistics_show_what_the_last_picture_did_and_why(extension, engine):
    add()
    runtime.reports[runtime.VIEWPORT] = RECEIPT
    extension.scene.jghand.use_viewport_budget = True
    extension.scene.jghand.viewport_budget_ms = 5.0
    seen = draw(picture.StatisticsPage, extension)
    assert "index1: flexion 12° outside trained range" in seen.texts
    assert "Over Budget" in seen.texts
    bars = [one.arguments for one in seen.drawn if one.function == "progress"]
    assert [(bar["text"], bar["factor"]) for bar in bars] == [("7.2 ms", 1.0), ("3.6 ms", 0.5)]


def test_a_pose_beyond_training_is_told_below_the_hands(extension, engine):
    add()
    runtime.reports[runtime.VIEWPORT] = RECEIPT
    assert "index1: flexion 12° outside trained range" in text_of(draw(hand_panel.HandPanel, extension))


def test_render_says_what_the_view_transform_does_and_offers_standard(extension, engine):
    add()
    extension.scene.jghand.light = "CAPTURE"
    extension.scene.render.engine = "JGHAND"
    extension.scene.view_settings.view_transform = "AgX"
    seen = draw(picture.RenderPanel, extension)
    assert "View transform is AgX" in text_of(seen)
    assert "jghand.use_standard" in seen.operators
    bpy.ops.jghand.use_standard()
    assert "jghand.use_standard" not in draw(picture.RenderPanel, extension).operators
    extension.scene.view_settings.exposure = 1.0
    assert "exposure" in text_of(draw(picture.RenderPanel, extension))


def test_common_poses_are_offered_first_and_letters_in_a_menu_of_their_own(extension, engine):
    add()
    panel, common, letters = (
        draw(each, extension) for each in (hand_panel.PosePanel, hand_panel.PoseMenu, hand_panel.LetterMenu)
    )
    menus = [
        [one.arguments["menu"] for one in seen.drawn if one.function == "menu"] for seen in (panel, common, letters)
    ]
    assert menus == [[hand_panel.PoseMenu.bl_idname], [hand_panel.LetterMenu.bl_idname], []]
    assert common.texts[:5] == ["Open", "Flat", "Spread", "Relaxed", "Fist"]
    assert letters.texts[0] == "ASL A"
    named = [one.settings["pose"] for one in (*common.drawn, *letters.drawn) if one.settings]
    assert named == [pose.name for pose in ALL_POSES]


def test_no_class_of_ours_is_made_from_another_that_blender_knows():
    """Blender then loses the first: its menu is empty (5.2.2)."""
    known = {one for module in registration.WITH_CLASSES for one in module.CLASSES}
    assert not [one for one in known if known.intersection(one.__mro__[1:])]


def test_curl_and_spread_say_what_their_numbers_mean(extension, engine):
    add()
    tips = [one.settings["text"] for one in draw(hand_panel.ControlsPanel, extension).drawn if "text" in one.settings]
    assert [tip.partition("°")[0] for tip in tips] == ["90", "25"]


def test_an_avatar_that_is_loaded_is_told_of(extension, engine):
    add()
    engine.status = Status("ready", 1.0)
    assert "Loading" not in text_of(draw(hand_panel.HandPanel, extension))
    engine.status = Status("ready", 1.0, busy=True, doing="Loading the avatar")
    assert "Loading the avatar…" in text_of(draw(hand_panel.HandPanel, extension))


def test_the_light_panel_says_how_each_hand_answers_the_light_of_the_scene(extension, engine, monkeypatch, tmp_path):
    light = picture.LightPanel
    add()
    assert "Lit by lamps and world" in text_of(draw(light, extension))
    add("left").jghand.avatar = str(write_avatar(tmp_path / "a.jghand", name="a", gaussians=7, learnt={"lobes": 8}))
    seen_hands.forget()
    seen = text_of(draw(light, extension))
    assert "Right Hand: Lit by lamps and world" in seen
    assert "Left Hand: Lit by lamps and world, as is estimated" in seen


def test_a_camera_that_cannot_be_used_is_told(extension, engine):
    add()
    bpy.ops.jghand.add_camera()
    extension.scene.camera.data.type = "PANO"
    assert "Panoramic" in text_of(draw(picture.RenderPanel, extension))


def test_a_view_that_shows_no_hands_says_why(extension, engine):
    add()
    seen = {}
    for shading in ("SOLID", "WIREFRAME", "RENDERED"):
        around = SimpleNamespace(
            space_data=SimpleNamespace(shading=SimpleNamespace(type=shading)), scene=extension.scene
        )
        seen[shading] = hand_panel._shading_hint(around)
    assert seen["SOLID"] == ""
    assert "Wireframe" in seen["WIREFRAME"]
    assert "JGHand Engine" in seen["RENDERED"]
    assert "Material Preview" in seen["RENDERED"]  # with the scene, whose engine is another one


def test_material_preview_says_that_hands_have_no_view_transform_there(extension, engine):
    add()
    scene = extension.scene
    shading = SimpleNamespace(type="MATERIAL")
    around = SimpleNamespace(space_data=SimpleNamespace(shading=shading), scene=scene)
    scene.view_settings.view_transform, scene.jghand.light = "AgX", "CAPTURE"
    assert hand_panel._shading_hint(around) == ""
    scene.jghand.light = "SCENE"
    assert "without the view transform AgX" in hand_panel._shading_hint(around)
    scene.view_settings.view_transform = "Standard"
    assert hand_panel._shading_hint(around) == ""


def test_panels_do_not_ask_every_object_of_a_scene_at_every_redraw(extension, monkeypatch):
    for place in range(50):
        extension.scene.collection.objects.link(bpy.data.objects.new(f"thing {place}", None))
    extension.view_layer.update()
    drawn(extension)
    asked = []
    is_any_hand = armature.is_any_hand
    monkeypatch.setattr(armature, "is_any_hand", lambda thing: asked.append(thing) or is_any_hand(thing))
    assert picture.RenderPanel.bl_idname not in drawn(extension)
    assert len(asked) < 20
    monkeypatch.undo()
    add()
    assert picture.RenderPanel.bl_idname in drawn(extension)


def test_the_tab_has_what_is_used_all_the_time_open_and_the_rest_closed():
    top = sorted(
        (panel for panel in PANELS.values() if not hasattr(panel, "bl_parent_id")), key=lambda one: one.bl_order
    )
    assert {panel.bl_category for panel in top} == {"JGHand"}
    closed = {panel.bl_label: "DEFAULT_CLOSED" in getattr(panel, "bl_options", ()) for panel in top}
    assert list(closed) == ["Hand", "Bones", "Pose", "Render", "Import Motion", "Bake", "Export", "Train"]
    assert [label for label in closed if not closed[label]] == ["Hand", "Bones", "Pose", "Render"]


def test_one_hand_shows_at_most_25_controls(extension, engine):
    add()
    seen = {name: layout for name, layout in drawn(extension).items() if is_open(PANELS[name])}
    controls_seen = [
        (name, one.text or one.arguments.get("property"))
        for name, layout in seen.items()
        for one in layout.drawn
        if one.function in CONTROLS and one.arguments.get("operator") != "jghand.explain"  # a text with a tooltip
    ]
    assert 10 < len(controls_seen) <= 25, controls_seen


def is_open(panel) -> bool:
    """Whether a panel is open at first, and those that it stands in."""
    if "DEFAULT_CLOSED" in getattr(panel, "bl_options", ()):
        return False
    return not hasattr(panel, "bl_parent_id") or is_open(PANELS[panel.bl_parent_id])
