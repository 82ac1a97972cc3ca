# SPDX-License-Identifier: GPL-3.0-or-later
"""What is saved with a scene: `scene.jghand`, how its images are made, and what is written of it.

As with those of hands (`hand/properties`), names and the numbers of enum items stay.
"""

from __future__ import annotations

import bpy

from ..export import properties as output_settings

# identifier, name, tooltip, icon, number in files
PRESETS = (
    ("draft", "Draft", "Fastest: fewer splats, no self-shadow", "NONE", 0),
    ("viewport", "Viewport", "Fast, with self-shadow where fingers are close", "NONE", 1),
    ("final", "Final", "What the avatar looks like, for renders", "NONE", 2),
    ("reference", "Reference", "Slow and exact, for comparisons", "NONE", 3),
)
# what hands are lit by, as PRESETS
LIGHTS = (
    (
        "CAPTURE",
        "Capture",
        "As hands were lit when they were captured; in a studio, where they learned in known light",
        "NONE",
        0,
    ),
    ("SCENE", "Scene", "By the lamps and the world of the scene", "NONE", 1),
)
# custom property of a scene whose light was chosen by the kind of its hands, not by an artist
LIGHT_OF_HANDS = "jghand_light_of_hands"
# a viewport image at sixty frames a second
BUDGET_MS = 16.0
# sub-frames of motion blur: enough for a finger that crosses its own width; beyond, seconds a frame for nothing
MOTION_SAMPLES, MOTION_SAMPLES_MAX = 8, 64


def _choose_light(settings: JGHandSceneSettings, _context: bpy.types.Context) -> None:
    settings.id_data.pop(LIGHT_OF_HANDS, None)


class JGHandSceneSettings(bpy.types.PropertyGroup):
    """`scene.jghand`: how pictures of this scene are made, and what is written of it."""

    output: bpy.props.PointerProperty(type=output_settings.JGHandOutputSettings)
    training: bpy.props.PointerProperty(type=output_settings.JGHandTrainingSettings)

    show_in_viewport: bpy.props.BoolProperty(
        name="Show Hands",
        description="Draw the avatars in Solid and Material Preview",
        default=True,
    )
    viewport_preset: bpy.props.EnumProperty(
        name="Viewport Quality",
        description="How the viewport is drawn while nothing moves",
        items=PRESETS,
        default="viewport",
    )
    sharpen_when_still: bpy.props.BoolProperty(
        name="Sharpen When Still",
        description="After a pause, draw the viewport with the settings of renders",
        default=True,
    )
    use_viewport_budget: bpy.props.BoolProperty(
        name="Frame Budget",
        description="Choose the most accurate measured settings that draw a viewport frame in the given time",
    )
    viewport_budget_ms: bpy.props.FloatProperty(
        name="Milliseconds",
        description="Time that the renderer may take for a viewport frame, in milliseconds",
        default=BUDGET_MS,
        min=1.0,
        soft_max=100.0,
        precision=1,
    )
    render_preset: bpy.props.EnumProperty(
        name="Render Quality",
        description="How F12 and animation renders are made",
        items=PRESETS,
        default="final",
    )
    light: bpy.props.EnumProperty(
        name="Light",
        description="What lights hands in Material Preview, Rendered and renders; Solid has no lamps",
        items=LIGHTS,
        default="CAPTURE",
        update=_choose_light,
    )
    use_surroundings: bpy.props.BoolProperty(
        name="Surroundings",
        description="Light hands with what comes from the objects around them, too: emission, walls that throw light "
        "back and hide the world. Cycles measures it at the hands, again whenever one of these objects changes",
        default=False,
    )
    use_exact_light: bpy.props.BoolProperty(
        name="Exact Light",
        description="Renders bake all light that falls on the hands with Cycles, frame by frame: soft shadows, panels "
        "that shine, what walls throw back. Takes a second or more for each frame; views stay as they are",
        default=False,
    )
    motion_samples: bpy.props.IntProperty(
        name="Motion Samples",
        description="Sub-frames that are averaged when the scene uses motion blur",
        default=MOTION_SAMPLES,
        min=2,
        soft_max=32,
        max=MOTION_SAMPLES_MAX,
    )
    use_pass_ids: bpy.props.BoolProperty(
        name="Bone Ids",
        description="Add a pass with the number of the bone that a pixel belongs to, 0 where there is no hand",
    )


CLASSES = (*output_settings.CLASSES, JGHandSceneSettings)
SETTINGS = ((bpy.types.Scene, JGHandSceneSettings),)
