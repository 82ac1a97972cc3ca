"""What a program wants of a stage is one click, and stays changeable."""

import pytest

pytest.importorskip("bpy", reason="needs the bpy wheel of this Python")

from blender_addon.export.recording import USD_PRESETS
from blender_addon.render import properties


@pytest.mark.parametrize("program", USD_PRESETS)
def test_a_program_sets_what_is_shown_first_and_the_size_of_points(extension, program):
    settings = extension.scene.jghand.output
    settings.program = program
    variant, width_factor = USD_PRESETS[program]
    assert (settings.variant, settings.width_factor) == (variant, width_factor)
    settings.variant = "mesh"
    assert settings.program == program


def test_the_settings_begin_with_what_the_program_shown_wants_and_bakes_with_points_that_close_the_skin(extension):
    settings = extension.scene.jghand.output
    variant, width_factor = USD_PRESETS[settings.program]
    assert (settings.variant, settings.width_factor) == (variant, width_factor)
    assert settings.bake_width_factor == properties.POINT_WIDTH_FACTOR
    settings.program = "houdini"
    assert settings.bake_width_factor == properties.POINT_WIDTH_FACTOR, "an export's program is none of a bake's"


def test_every_program_and_variant_of_the_engine_can_be_chosen(extension):
    properties = extension.scene.jghand.output.bl_rna.properties
    assert set(properties["program"].enum_items.keys()) == set(USD_PRESETS)
    assert {variant for variant, _ in USD_PRESETS.values()} | {"mesh"} == set(properties["variant"].enum_items.keys())
