"""Every property can be reached in the interface, and every control that a message names is there."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import bpy
import hands
import pytest
from recording_layout import Drawn, RecordingLayout, draw, draw_rows, operator_type

from blender_addon import errors, preferences, registration
from blender_addon.core import panel_text
from blender_addon.export import panel as export_panel
from blender_addon.hand import avatar_files, properties
from blender_addon.hand import panel as hand_panel
from blender_addon.train import panel as training

ADDON = Path(registration.__file__).parent
CLASSES = [each for module in registration.WITH_CLASSES for each in module.CLASSES]
PANELS = [each for each in CLASSES if issubclass(each, bpy.types.Panel) and hasattr(each, "bl_idname")]
OPERATORS = [each for each in CLASSES if issubclass(each, bpy.types.Operator)]
SETTINGS = [each for each in CLASSES if issubclass(each, bpy.types.PropertyGroup | bpy.types.AddonPreferences)]
# what the file browser draws itself
FILE_BROWSERS = {"filepath", "filter_glob", "check_existing"}
# what no artist sees: options of a command line, names in a program, the process by its inner name
INNER = re.compile(r"(^|\s)--[a-z]|[a-z0-9]_[a-z]|\bf[xy]\b|\.envs|(?<!JGHand )\bengine\b")
# controls of Blender's own that messages name, and where Blender has them
BLENDERS = {
    "Allow Online Access": (bpy.types.PreferencesSystem, "use_online_access"),
    "Custom Distance": (bpy.types.PointLight, "use_custom_distance"),
}


@pytest.fixture
def everything(extension, tmp_path, monkeypatch) -> list[Drawn]:
    """What all panels draw, in the states in which each of their parts shows."""
    monkeypatch.setattr(training, "preferences", lambda: SimpleNamespace(show_training=True))
    monkeypatch.setattr(avatar_files, "has_forearm", lambda avatar: True)
    monkeypatch.setattr(properties, "hand_items", lambda: [("builtin",), ("child",)])
    seen = RecordingLayout()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    for stale in (True, False):  # a bake that shows something else than the scene, and one that does not
        baked = export_panel._SeenBake("", 1, 2, ("it moved",) * stale)
        monkeypatch.setattr(export_panel, "_look_at_bake", lambda *_, baked=baked: baked)
        bpy.ops.jghand.add_hand()
        bpy.context.object.jghand.bake = str(tmp_path)
        _draw_panels(seen)
    for engine in ("JGHAND", "CYCLES"):
        bpy.context.scene.render.engine = engine
        bpy.context.scene.view_settings.view_transform = "AgX"
        for kind in ("usd", "ply", "motion"):
            bpy.context.scene.jghand.output.format = kind
            bpy.context.scene.jghand.output.use_scene_range = False
            _draw_panels(seen)
    (tmp_path / "my_hand.jghand").write_bytes(b"another's")  # in the way of a training
    hands.mixamo_rig(bpy.context)
    _draw_panels(seen)
    (tmp_path / "my_hand.training").mkdir()
    (tmp_path / "my_hand.training" / "training.json").write_text("{}")  # one that can go on
    _draw_panels(seen)
    bpy.ops.jghand.use_armature()
    _draw_panels(seen)
    rig = bpy.context.object
    rig.jghand.joints[3].bone = ""
    seen.drawn.extend(draw_rows(hand_panel.JointList, bpy.context, rig.jghand, rig.jghand.joints).drawn)
    page = SimpleNamespace(layout=seen, bl_rna=preferences.JGHandPreferences.bl_rna)
    preferences.JGHandPreferences.draw(page, bpy.context)
    return seen.drawn


def _draw_panels(seen: RecordingLayout) -> None:
    for panel in PANELS:
        layout = draw(panel, bpy.context)
        seen.drawn.extend(layout.drawn if layout is not None else [])


def own_properties(owner: type) -> Iterator[str]:
    """The properties that a class of ours adds, without those that Blender shows to nobody."""
    names = {
        name for each in owner.__mro__ if each.__module__.startswith("blender_addon") for name in each.__annotations__
    }
    table = operator_type(owner.bl_idname) if issubclass(owner, bpy.types.Operator) else owner.bl_rna
    known = table.properties
    return (name for name in sorted(names) if name in known and not known[name].is_hidden)


def test_every_setting_is_drawn(everything):
    shown = set()
    for one in everything:
        for data, name in (("data", "property"), ("dataptr", "propname"), ("active_dataptr", "active_propname")):
            if name in one.arguments and data in one.arguments:
                shown.add((one.arguments[data].bl_rna.identifier, one.arguments[name]))
    groups = {one.bl_rna.identifier for one in SETTINGS}
    lost = [
        f"{owner.__name__}.{name}"
        for owner in SETTINGS
        for name in own_properties(owner)
        if getattr(getattr(owner.bl_rna.properties[name], "fixed_type", None), "identifier", "") not in groups
        or owner.bl_rna.properties[name].type == "COLLECTION"
        if (owner.bl_rna.identifier, name) not in shown
    ]
    assert not lost


def test_every_choice_of_an_operator_is_in_its_redo_panel_or_made_by_a_button(everything, extension):
    pressed = {
        (one.arguments["operator"], name) for one in everything if "operator" in one.arguments for name in one.settings
    }
    pressed |= {
        (one.arguments["operator"], one.arguments["property"])
        for one in everything
        if one.function == "operator_menu_enum"
    }
    lost = []
    for operator in OPERATORS:
        wanted = set(own_properties(operator)) - FILE_BROWSERS
        if "draw" in vars(operator) or hasattr(operator, "choices"):
            wanted -= set(drawn_by(operator))
        elif "REGISTER" in operator.bl_options:
            wanted = set()
        lost += [f"{operator.bl_idname}: {name}" for name in wanted if (operator.bl_idname, name) not in pressed]
    assert not lost


def drawn_by(operator: type) -> list[str]:
    """The properties that an operator draws beside the file browser, or in its dialog."""
    layout = RecordingLayout()
    table = operator_type(operator.bl_idname)
    values = {name: getattr(one, "default", None) for name, one in table.properties.items()}
    rest = {name: getattr(operator, name) for name in ("choices", "headings") if hasattr(operator, name)}
    operator.draw(SimpleNamespace(layout=layout, bl_rna=table, **values, **rest), bpy.context)
    return [one.arguments["property"] for one in layout.drawn if one.function == "prop"]


def messages() -> Iterator[tuple[str, str]]:
    """Every text of several words in a function that begins as a sentence does, with its place; {} for what is put into
    it."""
    for kind, advice in errors.ADVICE.items():
        yield f"errors: {kind}", f"{advice.sentence}. {advice.remedy}"
    for path in sorted(ADDON.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for function in (each for each in ast.walk(tree) if isinstance(each, ast.FunctionDef)):
            skipped = {id(node.value) for node in ast.walk(function) if isinstance(node, ast.Expr)}  # docstrings
            for node in ast.walk(function):
                text = getattr(node, "value", "") if isinstance(node, ast.Constant) and id(node) not in skipped else ""
                if isinstance(node, ast.JoinedStr):
                    skipped |= set(map(id, node.values))
                    text = "".join(
                        getattr(part, "value", "") if isinstance(part, ast.Constant) else "{}" for part in node.values
                    )
                if isinstance(text, str) and re.match(r"([A-Z]|{).* ", text):
                    yield f"{path.relative_to(ADDON)}:{node.lineno}", text


def labels(everything: list[Drawn]) -> set[str]:
    """What can be read on controls."""
    for owner, name in BLENDERS.values():
        assert name in owner.bl_rna.properties
    return {one.text for one in everything} | {one.bl_label for one in OPERATORS} | set(BLENDERS)


def test_every_control_that_a_message_names_is_there(everything):
    named = [(place, label) for place, text in messages() for label in re.findall(r'"([A-Z][\w …-]+)"', text)]
    assert len(named) > 10
    known = labels(everything)
    assert not [(place, label) for place, label in named if label not in known]


def test_messages_name_controls_in_quotes_and_no_options_of_a_command_line(everything):
    several = {label for label in labels(everything) if len(re.findall(r"\b[A-Z]\w+", label)) > 1 and label.istitle()}
    unmarked = [
        (place, label)
        for place, text in messages()
        for label in several
        if text != label and label in re.sub(r'"[^"]*"', "", text)
    ]
    assert not unmarked
    inner = [(place, text) for place, text in messages() if " " in text and INNER.search(re.sub(r"{\w*", "", text))]
    assert not inner


def test_the_labels_that_stand_for_options_are_there(everything):
    assert set(panel_text.CONTROLS.values()) <= labels(everything)


def test_durations_are_written_by_one_function():
    found = [(place, text) for place, text in messages() if re.search(r"\} (s|min|h|ms|seconds|minutes)\b", text)]
    # that function, and lines of a batch run
    assert not [each for each in found if not each[0].startswith(("core/panel_text.py", "render/command.py"))]
