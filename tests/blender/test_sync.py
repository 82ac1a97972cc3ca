"""Views follow hands through edits, undo and files: handlers, timer, what is asked of the engine; without a window."""

import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from hands import camera_on, keyed_hand, moving_hand_m, put
from waiting import wait_until

from blender_addon import clock
from blender_addon.core import pacing, posing
from blender_addon.core.view import part_with
from blender_addon.errors import JGHandFailure
from blender_addon.hand import armature, avatar_files, seen_hands
from blender_addon.render import ENGINE, camera, composite, handover, rendering
from blender_addon.render.camera import ORTHO_ROOM_M, view_camera
from blender_addon.renderer import runtime, state
from blender_addon.renderer.link import EngineLink
from blender_addon.viewport import handlers, views

SIZE = (320, 200)


@pytest.fixture
def link(extension, stand_in_command):
    """The stand-in engine as the extension's own."""
    yield from linked(stand_in_command)


@pytest.fixture
def full_link(extension, stand_in_command):
    """The same, out of memory from its second picture on."""
    yield from linked([*stand_in_command, "memory:2"])


def linked(command: list[str]) -> Iterator[EngineLink]:
    link = EngineLink(lambda: command)
    runtime.use_link(link)
    yield link
    views.clear()
    runtime.use_link(None)


@pytest.fixture
def installed(extension):
    handlers.install()
    yield
    handlers.remove()


def space() -> bpy.types.SpaceView3D:
    """A 3D view of the startup file, though nobody sees it."""
    return next(area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D")


def add_hand(context: bpy.types.Context, side: str = "right", name: str = "") -> bpy.types.Object:
    hand = armature.build_armature(context, name or side, posing.rest_joints_m(side), side)
    context.view_layer.update()
    return hand


def seen(context: bpy.types.Context, *, switched_on_only: bool = True) -> list[str]:
    found = seen_hands.hands_in(context.scene, context.view_layer, space(), switched_on_only=switched_on_only)
    return [thing.name for thing in found]


def view_matrices(context: bpy.types.Context, thing: bpy.types.Object) -> tuple[SimpleNamespace, SimpleNamespace]:
    """A region and its data as a 3D view has them that looks through a camera."""
    depsgraph = context.evaluated_depsgraph_get()
    window = thing.calc_matrix_camera(depsgraph, x=SIZE[0], y=SIZE[1])
    region = SimpleNamespace(width=SIZE[0], height=SIZE[1])
    return region, SimpleNamespace(window_matrix=window, view_matrix=thing.matrix_world.normalized().inverted())


def view_on(context: bpy.types.Context, hand: bpy.types.Object) -> views.View:
    """A view that looks at a hand as Blender would draw it."""
    eye = camera_on(context, np.array([0.0, 0.08, 0.0]), 0.6)
    context.view_layer.update()
    view = views.View(1, views.SOLID)
    view.camera = view_camera(*view_matrices(context, eye), context.scene.unit_settings.scale_length)
    look(context, view, hand)
    return view


def look(context: bpy.types.Context, view: views.View, hand: bpy.types.Object) -> None:
    """What a draw does, but for the drawing."""
    view.settings = views.settings_of(context.scene)
    solid = SimpleNamespace(shading=SimpleNamespace(type="SOLID"))
    views.read_again(view, [hand], context.evaluated_depsgraph_get(), solid)
    views.look(view, views.moment_of(context.scene), drawing=True)


def wait_for(context: bpy.types.Context, view: views.View) -> None:
    wait_until(lambda: views.take(view, views.moment_of(context.scene)), "an answer")


# ---- handlers and timer ----------------------------------------------------------------------------------------------


def counts() -> dict[str, int]:
    return {name: getattr(bpy.app.handlers, name).count(function) for name, function in handlers.HANDLERS}


def test_a_session_without_a_hand_has_no_timer(installed, context):
    seen_hands.forget()
    assert not seen_hands.hands_of(context.scene, context.view_layer)
    assert not clock.runs()
    add_hand(context)
    seen_hands.forget()
    assert len(seen_hands.hands_of(context.scene, context.view_layer)) == 1
    assert clock.runs()


def test_handlers_and_timer_survive_opening_a_file(installed):
    clock.hasten(0.0)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert set(counts().values()) == {1}
    assert bpy.app.timers.is_registered(clock._call)


def test_without_a_window_the_extension_adds_no_handler(extension):
    assert set(counts().values()) == {0}


def test_without_a_hand_the_timer_starts_no_engine(link):
    assert handlers.tick() == clock.IDLE_TICK_S
    assert link.status.state == "stopped"


def test_while_blender_renders_or_bakes_the_timer_adds_and_removes_nothing(link, monkeypatch):
    """That would end Blender (5.2.2), also in a render of Cycles alone."""
    tended = []
    for each in (handlers.stand_ins, handlers.scene_light):
        monkeypatch.setattr(each, "tend", lambda: tended.append(1))
    for job in ("RENDER", "OBJECT_BAKE", None):
        assert job is None or bpy.app.is_job_running(job) is False  # Blender knows it
        running = SimpleNamespace(is_job_running=lambda asked, job=job: asked == job)
        monkeypatch.setattr(handover, "bpy", SimpleNamespace(app=running))
        handlers.tick()
        assert len(tended) == (2 if job is None else 0)


# ---- which hands -----------------------------------------------------------------------------------------------------


def test_a_view_shows_the_hands_that_are_visible_and_switched_on(extension):
    context = extension
    first, second = add_hand(context, "right"), add_hand(context, "left")
    assert seen(context) == ["left", "right"]
    first.hide_set(True)
    assert seen(context) == ["left"]
    second.jghand.show_in_viewport = False
    assert seen(context) == []
    assert seen(context, switched_on_only=False) == ["left"]


def test_a_hand_in_a_hidden_collection_is_not_shown(extension):
    context = extension
    hand = add_hand(context)
    group = bpy.data.collections.new("Props")
    context.scene.collection.children.link(group)
    context.scene.collection.objects.unlink(hand)
    group.objects.link(hand)
    seen_hands.forget()
    assert seen(context) == ["right"]
    context.view_layer.layer_collection.children["Props"].hide_viewport = True
    context.view_layer.update()
    assert seen(context) == []


def test_who_hides_armatures_still_sees_the_hand(extension):
    context = extension
    add_hand(context)
    space().show_object_viewport_armature = False
    assert seen(context) == ["right"]
    space().show_object_viewport_armature = True


@pytest.mark.parametrize("change", ["added", "duplicated", "deleted", "renamed"])
def test_hands_that_come_go_or_change_their_name_are_noticed(extension, installed, change):
    context = extension
    hand = add_hand(context)
    assert seen(context) == ["right"]
    if change == "added":
        add_hand(context, "left")
    elif change == "duplicated":
        copy = hand.copy()
        context.scene.collection.objects.link(copy)
    elif change == "deleted":
        bpy.data.objects.remove(hand)
    else:
        hand.name = "my hand"
    context.view_layer.update()
    wanted = {"added": ["left", "right"], "duplicated": ["right", "right.001"], "deleted": [], "renamed": ["my hand"]}
    assert seen(context) == wanted[change]


def test_undo_brings_a_hand_back_and_nothing_holds_the_old_one(extension, installed):
    context = extension
    bpy.ops.ed.undo_push(message="empty")
    add_hand(context)
    bpy.ops.ed.undo_push(message="hand")
    assert seen(context) == ["right"]
    bpy.ops.ed.undo()
    assert seen(bpy.context) == []
    bpy.ops.ed.redo()
    assert seen(bpy.context) == ["right"]


def test_a_hand_without_size_is_a_sentence_and_the_other_hand_is_still_read(extension):
    context = extension
    right, left = add_hand(context, "right"), add_hand(context, "left")
    put(left, ((0, 0, 0), (0, 0, 0), (0, 1, 1)))
    context.view_layer.update()
    hands, failures = seen_hands.read([right, left], context.evaluated_depsgraph_get())
    assert [hand.handedness for hand in hands] == ["right"]
    assert [(name, failure.kind) for name, failure in failures] == [("left", "zero_scale")]


# ---- the view's camera -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit_m", [1.0, 0.01])
@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_a_view_is_the_same_pinhole_as_the_camera_that_it_looks_through(extension, kind, unit_m):
    context = extension
    context.scene.unit_settings.scale_length = unit_m
    eye = camera_on(context, np.array([0.0, 0.1, 0.0]), 2.0, type=kind, shift_x=0.13, shift_y=-0.21, lens=70)
    render = context.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = *SIZE, 100
    context.view_layer.update()
    view = view_camera(*view_matrices(context, eye), unit_m)
    assert view.whole.orthographic == (kind == "ORTHO")
    whole = camera.pinhole(eye, context.evaluated_depsgraph_get())
    points_m = np.random.default_rng(0).uniform(-0.3, 0.3, (40, 3)) * unit_m
    assert np.allclose(view.whole.project(points_m), whole.project(points_m), rtol=2e-5, atol=2e-3)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_the_engines_depth_is_the_depth_of_the_view(extension, kind):
    context = extension
    eye = camera_on(context, np.zeros(3), 2.0, type=kind)
    context.view_layer.update()
    region, data = view_matrices(context, eye)
    camera_of_view = view_camera(region, data, 1.0)
    room_m = 0.7
    a, b, c, d = camera_of_view.clip_of_depth(room_m)
    for point in np.random.default_rng(1).uniform(-0.5, 0.5, (20, 3)):
        clip = np.array(data.window_matrix) @ np.array(data.view_matrix) @ (*point, 1.0)
        depth = camera_of_view.whole.project(point)[2] + room_m
        assert (a * depth + b) / (c * depth + d) == pytest.approx(clip[2] / clip[3], abs=1e-5)


def test_an_orthographic_view_steps_back_until_it_has_the_hand_in_front_of_it(extension):
    context = extension
    hand = add_hand(context)
    eye = camera_on(context, np.array([0.0, 0.1, 0.0]), -0.4, type="ORTHO")  # the hand is behind it
    context.view_layer.update()
    view = view_camera(*view_matrices(context, eye), 1.0)
    hands, _ = seen_hands.read([hand], context.evaluated_depsgraph_get())
    whole, room_m = view.in_front_of(hands)
    assert whole.project(hands[0].joints_world_m)[:, 2].min() == pytest.approx(ORTHO_ROOM_M)
    before = view.whole.project(hands[0].joints_world_m)
    assert np.allclose(whole.project(hands[0].joints_world_m), before + np.array([0, 0, room_m]))


# ---- asking ----------------------------------------------------------------------------------------------------------


def test_a_view_gets_the_picture_of_its_part_with_depth(link, extension):
    context = extension
    view = view_on(context, add_hand(context))
    wait_for(context, view)
    assert view.came is not None
    assert view.place is not None
    rgba, depth_m = view.came
    assert rgba.shape[:2] == depth_m.shape == (view.place.part.height, view.place.part.width)
    covered = depth_m > 0
    assert covered.any()
    assert (rgba[covered][:, 3] > 0).all()
    assert 0.3 < depth_m[covered].min() < depth_m[covered].max() < 0.9
    assert view.place.part == part_with(view.camera.whole, view.hands)


def test_nothing_is_asked_for_while_nothing_changes(link, extension, monkeypatch):
    context = extension
    hand = add_hand(context)
    context.scene.jghand.sharpen_when_still = False
    view = view_on(context, hand)
    wait_for(context, view)
    monkeypatch.setattr(link, "ask", lambda *_, **__: pytest.fail("asked for what is there"))
    for _ in range(3):
        look(context, view, hand)
    assert pacing.due_s(view.pace, view.settings) == float("inf")


@pytest.mark.parametrize("change", ["pose", "place", "avatar", "quality"])
def test_whatever_changes_the_picture_is_asked_for(link, extension, change):
    context = extension
    context.scene.jghand.sharpen_when_still = False
    hand = add_hand(context)
    view = view_on(context, hand)
    wait_for(context, view)
    if change == "pose":
        hand.pose.bones["index2"].rotation_quaternion = (0.9, 0.4, 0.0, 0.0)
    elif change == "place":
        hand.location.x += 0.01
    elif change == "avatar":
        hand.jghand.avatar = "/nowhere/at.jghand"
    else:
        context.scene.jghand.viewport_preset = "reference"
    context.view_layer.update()
    before = view.pace.asks
    look(context, view, hand)
    assert len(view.pace.asks) == len(before) + 1


def test_the_timer_rests_once_everything_is_there(link, extension):
    context = extension
    context.scene.jghand.sharpen_when_still = False
    view = view_on(context, add_hand(context))
    assert views.SHORTEST_TICK_S <= views.next_look_s(view) <= views.OPEN_TICK_S
    wait_for(context, view)
    assert views.next_look_s(view) == float("inf")
    assert not views.is_due(view)


def test_a_failure_is_told_with_the_view_and_asked_for_no_more(full_link, extension):
    context = extension
    context.scene.jghand.sharpen_when_still = False
    hand = add_hand(context)
    view = view_on(context, hand)
    views._views[1, views.SOLID] = view
    wait_for(context, view)
    first = view.came
    hand.location.x = 0.01
    context.view_layer.update()
    look(context, view, hand)
    wait_for(context, view)
    assert [(name, failure.kind) for name, failure in views.problems()] == [("", "out_of_memory")]
    assert not pacing.may_show(view.pace, views.moment_of(context.scene))
    asked = view.pace.asks
    look(context, view, hand)
    assert view.pace.asks == asked
    hand.location.x = 0.0
    context.view_layer.update()
    look(context, view, hand)
    assert view.came is first
    assert views.problems() == []


def test_a_view_keeps_its_picture_while_the_avatar_of_another_hand_is_loaded(link, extension, monkeypatch):
    context = extension
    hand = add_hand(context)
    view = view_on(context, hand)
    wait_for(context, view)
    monkeypatch.setattr(link, "ask", lambda *_, **__: None)  # nothing comes
    hand.jghand.avatar = "/another.jghand"
    look(context, view, hand)
    later_s = views.now_s() + 2 * pacing.STALE_S
    monkeypatch.setattr(views, "now_s", lambda: later_s)
    for doing, stays in (("", False), ("Loading the avatar", True)):
        status = replace(link.status, doing=doing)
        monkeypatch.setattr(runtime, "link", lambda status=status: SimpleNamespace(status=status))
        assert pacing.may_show(view.pace, views.moment_of(context.scene)) == stays
    monkeypatch.setattr(runtime, "link", lambda: link)


def test_a_view_at_rest_brings_a_killed_renderer_back_and_asks_again(link, extension, monkeypatch):
    monkeypatch.setattr(state, "RESTART_S", 0.3)
    context = extension
    hand = add_hand(context)
    view = view_on(context, hand)
    wait_for(context, view)
    views._views[1, views.SOLID] = view
    handlers._follow_status()
    pid = link.status.handshake["pid"]
    os.kill(pid, signal.SIGKILL)
    follow_until("failed")
    hand.location.x = 0.01  # too early for another renderer
    context.view_layer.update()
    look(context, view, hand)
    wait_for(context, view)
    assert view.failure.kind == "killed"
    follow_until("ready")
    assert view.failure is None
    look(context, view, hand)
    wait_for(context, view)
    assert view.pace.shown is not None
    assert view.pace.shown.want == view.pace.want


def follow_until(name: str) -> None:
    """The timer's look at the renderer, until that is in this state."""

    def is_seen() -> bool:
        state = runtime.link().status.state
        handlers._follow_status()
        return state == name

    wait_until(is_seen, name)


def test_a_view_survives_undo_and_asks_for_what_is_there_then(link, extension, installed):
    context = extension
    hand = keyed_hand(context, "right", moving_hand_m("right"))
    bpy.ops.ed.undo_push(message="hand")
    view = view_on(context, hand)
    wait_for(context, view)
    hand.location.x = 0.02
    bpy.ops.ed.undo_push(message="moved")
    bpy.ops.ed.undo()
    context = bpy.context
    found = seen_hands.hands_in(context.scene, context.view_layer, space(), switched_on_only=True)
    assert len(found) == 1
    look(context, view, found[0])
    assert view.unreadable == []


def test_opening_a_file_forgets_the_views_and_keeps_the_engine(link, extension, installed):
    context = extension
    view = view_on(context, add_hand(context))
    views._views[1, views.SOLID] = view
    wait_for(context, view)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert views.all_views() == []
    assert link.status.state == "ready"
    assert link.answer(view.slot) is None


def test_while_blender_renders_a_frame_change_asks_for_nothing(link, extension, installed, monkeypatch):
    context = extension
    hand = keyed_hand(context, "right", moving_hand_m("right"))
    view = view_on(context, hand)
    views._views[1, views.SOLID] = view
    wait_for(context, view)
    monkeypatch.setattr(link, "ask", lambda *_: pytest.fail("the engine belongs to the render"))
    rendering.begin()
    context.scene.frame_set(3)
    rendering.end()


def test_a_render_of_another_engine_leaves_the_views_alone_unless_it_is_combined_with_hands(extension):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    handlers.on_render_begin(scene)
    assert not rendering.now()
    ours = scene[composite.HANDS_SCENE] = bpy.data.scenes.new("Hands")
    ours[composite.OWNER] = scene
    handlers.on_render_begin(scene)
    assert rendering.now()
    rendering.end()


def test_during_a_render_a_picture_is_shown_for_a_while_only(link, extension, monkeypatch):
    context, drawn = extension, []
    view = view_on(context, add_hand(context))
    wait_for(context, view)
    views._views[1, views.SOLID] = view
    monkeypatch.setattr(views, "_draw", drawn.append)
    monkeypatch.setattr(views, "view_camera", lambda *_: view.camera)
    region = SimpleNamespace(as_pointer=lambda: 1)
    drawing = SimpleNamespace(region=region, region_data=None, scene=context.scene)
    rendering.begin()
    try:
        views.show_again(drawing, views.SOLID)
        assert (drawn, view.drawn) == ([view], True)
        monkeypatch.setattr(rendering, "lasts_s", lambda: pacing.STALE_S + 0.1)
        views.show_again(drawing, views.SOLID)
        assert (drawn, view.drawn) == ([view], False)
    finally:
        rendering.end()


def test_a_tick_that_raises_is_called_again_and_told_once(capfd):
    calls = []

    def tick() -> float:
        calls.append(1)
        raise KeyError("gone")

    clock.use(tick)
    clock.hasten(0.0)
    try:
        assert [clock._call() for _ in range(3)] == [clock.IDLE_TICK_S] * 3
        assert clock.runs()
        assert capfd.readouterr().err.count("Traceback") == 1
        bpy.app.timers.unregister(clock._call)
        assert not clock.runs()
    finally:
        clock.stop()
    assert len(calls) == 3


@pytest.mark.parametrize(
    ("shading", "engine", "switched_on", "solid", "rendered"),
    [
        ("SOLID", ENGINE, True, True, False),
        ("SOLID", ENGINE, False, False, False),
        ("MATERIAL", "CYCLES", True, True, False),
        ("WIREFRAME", ENGINE, True, False, False),
        ("RENDERED", ENGINE, False, False, True),
        ("RENDERED", "CYCLES", True, False, False),
    ],
)
def test_a_view_draws_hands_where_its_shading_and_its_scene_do(
    extension, shading, engine, switched_on, solid, rendered
):
    scene = extension.scene
    scene.render.engine, scene.jghand.show_in_viewport = engine, switched_on
    area = SimpleNamespace(shading=SimpleNamespace(type=shading))
    assert views.draws(area, scene, views.SOLID) is solid
    assert views.draws(area, scene, views.RENDERED) is rendered


def test_an_avatar_whose_file_changed_or_came_is_asked_for_again(link, extension, tmp_path, monkeypatch):
    monkeypatch.setattr(avatar_files, "LOOK_S", 0.0)
    context = extension
    context.scene.jghand.sharpen_when_still = False
    hand, path = add_hand(context), tmp_path / "hand.jghand"
    hand.jghand.avatar = str(path)
    view = view_on(context, hand)
    for content in (b"one", b"two more"):
        before = view.pace.asks[-1].want
        path.write_bytes(content)
        assert views.is_due(view)
        views.look(view, views.moment_of(context.scene), drawing=False)
        assert view.pace.asks[-1].want != before
        assert not views.is_due(view)


def test_a_hand_that_left_the_view_is_drawn_no_more_and_asked_for_when_it_comes_back(link, extension, monkeypatch):
    context = extension
    hand = add_hand(context)
    view = view_on(context, hand)
    wait_for(context, view)
    views._views[1, views.SOLID] = view
    view.drawn = True
    monkeypatch.setattr(seen_hands, "hands_in", lambda *_, **__: [hand])
    monkeypatch.setattr(views, "view_camera", lambda *_: view.camera)
    monkeypatch.setattr(views, "_draw", lambda _: None)
    region = SimpleNamespace(as_pointer=lambda: 1)
    drawing = SimpleNamespace(
        region=region,
        region_data=None,
        scene=context.scene,
        view_layer=context.view_layer,
        space_data=SimpleNamespace(shading=SimpleNamespace(type="SOLID")),
    )
    monkeypatch.setattr(views.gpu_picture, "keep_bones_visible", lambda *_: None)
    hand.location.x = 50.0
    context.view_layer.update()
    views.show(drawing, context.evaluated_depsgraph_get(), views.SOLID)
    assert not view.drawn
    assert link.answer(view.slot) is None
    hand.location.x = 0.01
    context.view_layer.update()
    views.show(drawing, context.evaluated_depsgraph_get(), views.SOLID)
    wait_for(context, view)
    assert view.came is not None


def test_panels_are_drawn_anew_when_a_hand_begins_or_ceases_not_to_show(extension, installed, monkeypatch):
    drawn = []
    monkeypatch.setattr(handlers, "_redraw_panels", lambda *, soon: drawn.append(soon))
    monkeypatch.setattr(handlers, "_follow_status", lambda: None)
    monkeypatch.setattr(handlers, "_problems", [])
    found: list[tuple[str, JGHandFailure]] = []
    monkeypatch.setattr(views, "problems", lambda: list(found))
    for problems in (
        [],
        [],
        [("hand", JGHandFailure("mirrored", "a"))],
        [("hand", JGHandFailure("mirrored", "b"))],
        [],
    ):
        found[:] = problems
        handlers.tick()
    assert drawn == [True, True]
