"""Files that older versions saved open with their settings.

saved_by_0_1_0.blend: a left hand with finger controls, saved by version 0.1.0 in Blender 5.0.1 with every setting away
from its default; saved_by_0_1_0.json says what was set.
"""

import json
from pathlib import Path

import pytest

SAVED = Path(__file__).with_name("saved_by_0_1_0.blend")
# settings of version 0.1.0 that this version does not have, and why
GONE = {
    "scene.viewport_density": "a view that is to be faster has a frame budget",
    "scene.shadow_strength": "the hands that ship have no such shadow, and no light of a scene has",
    "scene.shadow_radius_mm": "as the strength",
    "scene.output.use_cache": "a bake is played by Blender's own USD reader alone",
    "scene.output.sizes": "radii are written in every frame where a hand changes its size",
    "scene.output.replace_others": "a click is asked about what it overwrites",
    "hand.bake_id": "a bake lies in the folder of its hand's name",
    "scene.training.overwrite": "a click is asked about what it overwrites",
}


@pytest.fixture
def opened(extension):
    import bpy

    bpy.ops.wm.open_mainfile(filepath=str(SAVED))
    return bpy.context


def test_a_file_of_version_0_1_0_opens_with_every_setting(opened):
    owners = {"scene": opened.scene.jghand, "hand": opened.scene.objects["Hand"].jghand}
    expected = json.loads(SAVED.with_suffix(".json").read_text(encoding="utf-8"))
    expected = {path: value for path, value in expected.items() if path not in GONE}
    found = {}
    for path in expected:
        owner, *names = path.split(".")
        value = owners[owner]
        for name in names:
            value = getattr(value, name)
        found[path] = list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
    assert found == expected


def test_its_hand_is_a_left_hand_with_controls_and_the_scene_renders_with_jghand(opened):
    from blender_addon.hand import armature

    hand = opened.scene.objects["Hand"]
    assert armature.is_hand(hand)
    assert armature.handedness_of(hand) == "left"
    assert opened.scene.render.engine == "JGHAND"
    assert {"JGHand Controls", "JGHand Tips"} <= {one.name for one in hand.data.collections}


def test_another_avatar_leaves_its_finger_controls_as_they_are_until_they_are_made_anew(opened):
    import bpy

    from blender_addon.hand import controls

    hand = opened.scene.objects["Hand"]
    before = [(rule.name, rule.type) for rule in controls.rules_of(hand)]
    hand.jghand.avatar = "strong"
    assert [(rule.name, rule.type) for rule in controls.rules_of(hand)] == before
    assert not controls.may_use_fist(hand)
    opened.view_layer.objects.active = hand
    hand.select_set(True)
    assert bpy.ops.jghand.add_controls() == {"FINISHED"}
    assert controls.may_use_fist(hand)
