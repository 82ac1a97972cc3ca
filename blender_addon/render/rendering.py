# SPDX-License-Identifier: GPL-3.0-or-later
"""While Blender renders, and what is said of a picture's hands.

A render of hands has the engine for itself: views leave it alone meanwhile. The handlers of the viewport say when one
begins and ends: `is_job_running` is false for `blender -b -a`. Beside a render of Cycles or EEVEE alone views go on.

Says so when a picture has no hands: Cycles, EEVEE and Workbench do not draw them, and JGHand may fail to.

The viewport shows hands in Solid and Material Preview whatever the scene renders with, so F12 with another engine would
be empty without a word. The same is said where hands were combined with the scene and it has changed since. Said once
per scene and session: some pictures are meant to be without hands. In a window it is a menu with the two ways to get
them, without one a line on stderr.

Hands that fail while another scene's compositor asks for them cannot end that render: Blender only prints the error,
writes the picture and goes on. The frame is magenta then (`engine`), and once per render it is said here why.
"""

from __future__ import annotations

import math
import time
from typing import Any

import bpy
from bpy.app.handlers import persistent

from .. import ui
from ..errors import JGHandFailure
from ..hand import seen_hands
from ..renderer import runtime
from . import ENGINE, composite

# what was said: of which scene, and the sentence
_said: set[tuple[int, str]] = set()
# what was said of the hands of this render that failed; "" while none did
_failed = ""
# when the render of hands began that goes on, on the clock of time.monotonic()
_began_s = math.inf


def needs_engine(scene: bpy.types.Scene) -> bool:
    """Whether a render of this scene draws hands, itself or through a scene of its hands that is combined with it."""
    return scene.render.engine == ENGINE or composite.hands_scene_of(scene) is not None


def begin() -> None:
    global _began_s
    _began_s = time.monotonic()


def end() -> None:
    global _began_s
    _began_s = math.inf


def now() -> bool:
    return _began_s < math.inf


def lasts_s() -> float:
    """For how many seconds; below 0 while nothing is rendered."""
    return time.monotonic() - _began_s


def check() -> bool:
    """The same, asked while Blender's main thread is free in a window: a render that ended without a word is over."""
    if now() and not bpy.app.is_job_running("RENDER"):
        end()
    return now()


# ---- what is said ----------------------------------------------------------------------------------------------------


def hands_left_out(scene: bpy.types.Scene) -> list[str]:
    """Names of the hands that the scene has and its own engine will not draw; empty for scenes where they are drawn."""
    if scene.render.engine == ENGINE or composite.hands_scene_of(scene) or composite.is_hands_scene(scene):
        return []
    if not scene.jghand.show_in_viewport:
        return []
    found = {hand.name for layer in scene.view_layers if layer.use for hand in seen_hands.sources_at_any_frame(layer)}
    return sorted(found)


@persistent
def on_render(scene: bpy.types.Scene, *_: Any) -> None:
    global _failed
    if scene is None or composite.is_hands_scene(scene):
        return
    _failed = ""
    runtime.render_note = None
    text = sentence_of(scene)
    if not text or (scene.session_uid, text) in _said:
        return
    _said.add((scene.session_uid, text))
    ways = (("jghand.use_engine", "RESTRICT_RENDER_OFF"), ("jghand.combine_with_scene", "NODE_COMPOSITING"))
    ui.show_later(text, operators=ways)


def hands_failed(scene: bpy.types.Scene, failure: JGHandFailure) -> None:
    global _failed
    if _failed:
        return
    reason = f"{failure.advice.sentence}. {failure.advice.remedy}."
    _failed = f"The hands of frame {scene.frame_current} failed and are magenta: {reason}"
    ui.show_later(_failed, icon="ERROR")


def said_of_failed_hands() -> str:
    """What was said of the first hands that failed in the newest combined render; "" where none did."""
    return _failed


def sentence_of(scene: bpy.types.Scene) -> str:
    """What is to be said about the hands of a picture of this scene; nothing where they are as they should be."""
    if hands_left_out(scene):
        return sentence(scene.render.engine) + ' Press "Use JGHand Engine" or "Set Up Compositing".'
    differences = composite.out_of_date(scene)
    if differences:
        found = ", ".join(differences)
        return f'The hands of this image are not up to date: {found}. Press "Set Up Compositing" again.'
    return ""


def sentence(engine: str) -> str:
    name = engine.removeprefix("BLENDER_").removesuffix("_NEXT").replace("_", " ").title()
    name = {"Eevee": "EEVEE"}.get(name, name)
    return f"This image has no hands: {name} does not draw them."


APP_HANDLERS = (("render_init", on_render),)


def unregister() -> None:
    global _failed
    _said.clear()
    _failed = ""
