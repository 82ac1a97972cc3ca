# SPDX-License-Identifier: GPL-3.0-or-later
"""What is saved with a scene: `scene.jghand`, how its images are made; `.output` and `.training`, what is written of it
and learned.

As with those of hands (`hand/properties`), names and the numbers of enum items stay.
"""

from __future__ import annotations

import bpy

from ..export.recording import USD_PRESETS
from ..versions import path_options

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


# diameter of a baked point in two standard deviations of its splat: balls of this size close the skin
POINT_WIDTH_FACTOR = 2.0

FORMATS = (
    ("usd", "USD", "One animated OpenUSD stage per hand: splats, points, skeleton and mesh", "NONE", 0),
    ("ply", "PLY Sequence", "A file of Gaussian splats for every frame, in the common layout", "NONE", 1),
    ("motion", "Motion File", "The 21 joints of every frame, for jghand and for Import Motion", "NONE", 2),
)
CHOICES = (
    ("selected", "Selected", "The selected hands", "NONE", 0),
    ("all", "All", "All hands of the view layer that are rendered", "NONE", 1),
)
VARIANTS = (
    ("splats", "Splats", "For renderers that know Gaussian splats; others show points", "NONE", 0),
    ("points", "Points", "For Blender and others that know no splats", "NONE", 1),
    (
        "points_skinned",
        "Skinned Points",
        "Points that follow the skeleton, without learned detail, for usdview",
        "NONE",
        3,
    ),
    ("mesh", "Mesh", "The skinned hand without learned detail, for every program", "NONE", 2),
)
PROGRAMS = (
    ("generic", "Any Program", "Splats; programs without them show points", "NONE", 0),
    ("omniverse", "Omniverse", "Splats", "NONE", 1),
    ("usdview", "usdview", "Points that follow the skeleton, which its renderer draws without a plug-in", "NONE", 2),
    ("blender", "Blender", "Points", "NONE", 3),
    ("houdini", "Houdini", "Points whose width is two standard deviations", "NONE", 4),
)
RADIANCES = (
    ("srgb", "sRGB", "Colors as a screen shows them, for most viewers", "NONE", 0),
    ("linear", "Linear", "Colors as light, for path tracers", "NONE", 1),
    (
        "albedo",
        "Albedo",
        "Colors without light: other programs light splats and points, as they do the mesh",
        "NONE",
        2,
    ),
)
AXES = (
    ("rdf", "Viewers", "X right, Y down, Z forward, as splat viewers expect it", "NONE", 0),
    ("rub", "Y Up", "X right, Y up, Z towards the viewer", "NONE", 1),
)
TRAINING_PRESETS = (
    ("default", "Default", "JGHand's best", "NONE", 0),
    ("paper-faithful", "Paper", "As close to the paper as it says; slower", "NONE", 1),
)
# as jghand_engine names them; a test compares
IDENTITIES = (
    ("slim_woman", "Slim Woman", "Narrow, with slender fingers", "NONE", 0),
    ("big_man", "Big Man", "Large and broad", "NONE", 1),
    ("old_person", "Old Person", "The shape of a hand at great age", "NONE", 2),
    ("adult_man", "Adult Man", "Of middle size", "NONE", 3),
    ("adult_woman", "Adult Woman", "Of middle size, narrower", "NONE", 4),
    ("child", "Child", "Small, with short fingers", "NONE", 5),
    ("long_fingers", "Long Fingers", "A palm of middle size with long fingers", "NONE", 6),
)


def _choose_light(settings: JGHandSceneSettings, _context: bpy.types.Context) -> None:
    settings.id_data.pop(LIGHT_OF_HANDS, None)


def _suit_program(settings: bpy.types.PropertyGroup, _context: bpy.types.Context) -> None:
    """Sets what the chosen program wants; both stay in sight and may be changed."""
    settings.variant, settings.width_factor = USD_PRESETS[settings.program]


class JGHandOutputSettings(bpy.types.PropertyGroup):
    """`scene.jghand.output`: what is written, and where."""

    format: bpy.props.EnumProperty(name="Format", description="What Export writes", items=FORMATS, default="usd")
    folder: bpy.props.StringProperty(
        name="Folder",
        description="Where exports are written; // is the folder of this file, {blend_name} its name",
        subtype="DIR_PATH",
        options=path_options(),
        default="//jghand_export/{blend_name}",
    )
    bake_folder: bpy.props.StringProperty(
        name="Bake Folder",
        description="Where bakes are written, a folder for each hand; // is the folder of this file, "
        "{blend_name} its name",
        subtype="DIR_PATH",
        options=path_options(),
        default="//jghand_bake/{blend_name}",
    )
    hands: bpy.props.EnumProperty(
        name="Hands", description="Which hands are written", items=CHOICES, default="selected"
    )
    use_scene_range: bpy.props.BoolProperty(
        name="Scene Range", description="Write the frames of the scene, or of its preview range", default=True
    )
    frame_start: bpy.props.IntProperty(name="Start", description="First frame that is written", default=1)
    frame_end: bpy.props.IntProperty(name="End", description="Last frame that is written", default=250)
    program: bpy.props.EnumProperty(
        name="Program",
        description="The program that will read the stage: sets what is shown first and the size of points",
        items=PROGRAMS,
        default="generic",
        update=_suit_program,
    )
    variant: bpy.props.EnumProperty(
        name="Default Variant",
        description="What a program shows that cannot choose between splats, points and mesh; all are written",
        items=VARIANTS,
        default="splats",
    )
    radiance: bpy.props.EnumProperty(
        name="Colors", description="What the splats' colors mean", items=RADIANCES, default="srgb"
    )
    width_factor: bpy.props.FloatProperty(
        name="Point Size",
        description="Diameter of the points, in two standard deviations of a splat: more closes gaps between them",
        default=USD_PRESETS["generic"][1],
        min=0.1,
        soft_max=4.0,
        max=100.0,
    )
    bake_width_factor: bpy.props.FloatProperty(
        name="Point Size",
        description="Diameter of the baked points, in two standard deviations of a splat: more closes gaps between "
        "them",
        default=POINT_WIDTH_FACTOR,
        min=0.1,
        soft_max=4.0,
        max=100.0,
    )
    axes: bpy.props.EnumProperty(name="Axes", description="Axes of the numbers in PLY files", items=AXES, default="rdf")
    use_surfels: bpy.props.BoolProperty(
        name="Surfels",
        description="Write the skin as flat splats with the colors of the hand's texture, for close-ups. Off, the "
        "hand's own splats, which are coarser than its skin",
    )
    surfel_count: bpy.props.IntProperty(
        name="Count",
        description="How many surfels, at least 56,000 for most hands",
        default=200_000,
        min=1,
        soft_min=56_000,
        soft_max=400_000,
        max=2_000_000,
        step=100_000,
    )


class JGHandTrainingSettings(bpy.types.PropertyGroup):
    """`scene.jghand.training`: the training set, and what is learned from it."""

    capture_folder: bpy.props.StringProperty(
        name="Training Set",
        description="Folder of the images to learn from: one that Render Training Set made, InterHand2.6M or HanCo",
        subtype="DIR_PATH",
        options=path_options(),
        default="//jghand_capture",
    )
    identity: bpy.props.EnumProperty(
        name="Hand Model", description="The rigged hand that is rendered", items=IDENTITIES, default="adult_man"
    )
    cameras: bpy.props.IntProperty(
        name="Cameras", description="Views of every pose", default=16, min=1, soft_max=64, max=256
    )
    poses: bpy.props.IntProperty(
        name="Poses", description="How many poses are made up", default=25, min=1, soft_max=500, max=100000
    )
    use_motion: bpy.props.BoolProperty(
        name="Poses of Active Hand",
        description="Take the poses from the active hand's animation over the frames of the export, instead",
    )
    size: bpy.props.IntVectorProperty(
        name="Resolution",
        description="Width and height of the images of the whole hand; close-ups are always 384 x 384",
        size=2,
        default=(501, 768),
        min=16,
        max=8192,
    )
    samples: bpy.props.IntProperty(
        name="Samples",
        description="Rays per pixel of images of the whole hand; noise is filtered away",
        default=6,
        min=1,
        soft_max=256,
        max=4096,
    )
    seed: bpy.props.IntProperty(name="Seed", description="Of poses, cameras and the training", default=0, min=0)
    avatar_file: bpy.props.StringProperty(
        name="Avatar",
        description="The file of the avatar that is learned",
        subtype="FILE_PATH",
        options=path_options(),
        default="//my_hand.jghand",
    )
    preset: bpy.props.EnumProperty(
        name="Preset", description="What is learned, and how", items=TRAINING_PRESETS, default="default"
    )
    time_s: bpy.props.FloatProperty(
        name="Time",
        description="How long to train, all sessions together",
        default=3600.0,
        min=6.0,
        soft_max=36000.0,
        step=6000,  # hundredths: the arrows beside it count minutes
        precision=1,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )
    all_pictures: bpy.props.BoolProperty(
        name="Use Validation Images",
        description="Learn from the images too that are held out to judge by, for a final avatar",
    )


class JGHandSceneSettings(bpy.types.PropertyGroup):
    """`scene.jghand`: how pictures of this scene are made, and what is written of it."""

    output: bpy.props.PointerProperty(type=JGHandOutputSettings)
    training: bpy.props.PointerProperty(type=JGHandTrainingSettings)

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
    )
    use_exact_light: bpy.props.BoolProperty(
        name="Exact Light",
        description="Renders bake all light that falls on the hands with Cycles, frame by frame: soft shadows, panels "
        "that shine, what walls throw back. Takes a second or more for each frame; views stay as they are",
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


CLASSES = (JGHandOutputSettings, JGHandTrainingSettings, JGHandSceneSettings)
SETTINGS = ((bpy.types.Scene, JGHandSceneSettings),)
