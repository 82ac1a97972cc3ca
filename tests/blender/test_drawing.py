"""A graphics driver that refuses to draw costs neither view nor console: it is said once, and tried again."""

from contextlib import nullcontext
from types import SimpleNamespace

import pytest
from recording_layout import RecordingLayout

from blender_addon import clock, ui
from blender_addon.render import rendering
from blender_addon.viewport import drawing, views

REGION = 0x1234


class Driver:
    """Stands for what draws. refuses: what it raises, None where it draws."""

    def __init__(self) -> None:
        self.refuses: Exception | None = RuntimeError("GPUTexture.__new__(...) failed with 'out of memory'")
        self.calls = 0

    def draw(self, _view: views.View) -> None:
        self.calls += 1
        if self.refuses is not None:
            raise self.refuses


@pytest.fixture
def driver(extension, monkeypatch):
    """A view with a picture, drawn as Blender would."""
    driver = Driver()
    context = SimpleNamespace(region=SimpleNamespace(as_pointer=lambda: REGION), scene=extension.scene, space_data=None)

    def show(_context: object, _depsgraph: object, kind: str) -> None:
        view = views._views.setdefault((REGION, kind), views.View(REGION, kind))
        view.drawn = True
        with views._by_the_driver():
            driver.draw(view)
        view.undrawn = None

    monkeypatch.setattr(views, "show", show)
    monkeypatch.setattr(views, "remove", lambda view: views._views.pop((view.region, view.kind)))
    driver.context = context
    yield driver
    views._views.clear()


def redraw(driver: Driver, times: int = 1, kind: str = views.SOLID) -> None:
    for _ in range(times):
        views.draw(driver.context, lambda: None, kind)


def test_it_is_said_once_and_tried_at_each_redraw(driver, capfd):
    clock._told.clear()
    redraw(driver, 50)
    assert driver.calls == 50
    assert capfd.readouterr().err.count("Traceback") == 2  # the driver's, and what became of it
    (problem,) = views.problems()
    assert problem[1].kind == "no_graphics"
    assert "out of memory" in problem[1].detail


def test_a_driver_that_recovers_shows_the_hand_and_the_sentence_goes(driver):
    redraw(driver, 10)
    driver.refuses = None
    redraw(driver)
    assert views.problems() == []
    assert views._views[REGION, views.SOLID].drawn


def test_one_view_that_fails_does_not_stop_another(driver):
    redraw(driver)
    driver.refuses = None
    redraw(driver, kind=views.RENDERED)
    assert driver.calls == 2
    assert (REGION, views.RENDERED) in views._views


def test_a_mistake_of_ours_is_no_fault_of_the_driver(driver, monkeypatch):
    def mistaken(*_: object) -> None:
        raise ZeroDivisionError("ours")

    monkeypatch.setattr(views, "show", mistaken)
    redraw(driver, 10)
    (problem,) = views.problems()
    assert problem[1].kind == "internal"


def test_rendered_mode_and_solid_are_drawn_alike(driver, monkeypatch):
    monkeypatch.setattr(drawing, "free_unwanted", lambda: None)
    depsgraph = SimpleNamespace(scene_eval=SimpleNamespace(render=SimpleNamespace(film_transparent=True)))
    views.ViewportEngine().view_draw(driver.context, depsgraph)
    assert [key[1] for key in views._views] == [views.RENDERED]
    monkeypatch.setattr(rendering, "now", lambda: True)
    views.ViewportEngine().view_draw(driver.context, depsgraph)


def test_a_word_of_the_extension_fits_the_small_window_of_a_picture(extension, monkeypatch):
    shown = []
    manager = SimpleNamespace(
        windows=["main", "picture"], popup_menu=lambda draw, **options: shown.append((draw, options))
    )
    context = SimpleNamespace(window_manager=manager, temp_override=lambda window: nullcontext(window))
    monkeypatch.setattr(ui, "bpy", SimpleNamespace(app=SimpleNamespace(background=False), context=context))
    text = "Frame 3 has no hands and is not written: A scale of zero is not supported. Give the object a scale"
    ui.show_message(text, icon="ERROR", operators=(("jghand.use_engine", "RESTRICT_RENDER_OFF"),))
    ((draw, options),) = shown
    layout = RecordingLayout()
    draw(SimpleNamespace(layout=layout), context)
    assert options == {"title": "JGHand", "icon": "ERROR"}
    assert " ".join(layout.texts[: len(layout.texts) - 1]) == text
    assert max(map(len, layout.texts)) <= ui.POPUP_LETTERS
    assert layout.operators == ["jghand.use_engine"]
