"""A stand-in for Blender's UILayout that takes only what the real one takes, and remembers what was drawn.

There is no layout without a window. Names of functions, of their arguments, of properties, icons, operators and their
properties are looked up in Blender's own tables, so that a panel which draws here does not raise there.
"""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import bpy

_RNA = bpy.types.UILayout.bl_rna
_ICONS = set(_RNA.functions["label"].parameters["icon"].enum_items.keys())
# the order of arguments that Blender lets stand without a name
_PLACED = {
    "prop": ("data", "property"),
    "prop_search": ("data", "property", "search_data", "search_property"),
    "operator": ("operator",),
    "operator_menu_enum": ("operator", "property"),
    "template_icon_view": ("data", "property"),
    "template_list": (*("listtype_name", "list_id", "dataptr", "propname", "active_dataptr", "active_propname"),),
    "template_curve_mapping": ("data", "property"),
    "menu": ("menu",),
    "popover": ("panel",),
}


@dataclass
class Drawn:
    """One thing that was drawn: the function of the layout, its arguments, and what was set on what it returned."""

    function: str
    arguments: dict[str, Any]
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """What can be read of it."""
        if "text" in self.arguments:
            return self.arguments["text"]
        if self.function == "operator":
            return operator_type(self.arguments["operator"]).name
        if self.function == "prop" and not self.arguments["property"].startswith("["):
            return self.arguments["data"].bl_rna.properties[self.arguments["property"]].name
        return ""


class RecordingLayout:
    """Draw into it; `drawn` is what was drawn, in order, through all columns and rows."""

    def __init__(self, drawn: list[Drawn] | None = None) -> None:
        self.__dict__["drawn"] = [] if drawn is None else drawn

    def __setattr__(self, name: str, value: object) -> None:
        assert name in _RNA.properties, f"a layout has no {name}"
        self.__dict__[name] = value

    def __getattr__(self, name: str) -> Any:
        assert name in _RNA.functions, f"a layout cannot {name}"

        def call(*placed: Any, **named: Any) -> Any:
            arguments = {**dict(zip(_PLACED.get(name, ()), placed, strict=False)), **named}
            assert len(placed) <= len(_PLACED.get(name, ())), f"{name}: arguments without a name"
            return self._draw(name, arguments)

        return call

    @property
    def texts(self) -> list[str]:
        """Everything that can be read, in order."""
        return [one.text for one in self.drawn if one.text]

    @property
    def operators(self) -> list[str]:
        """The operators of all buttons, in order."""
        return [one.arguments["operator"] for one in self.drawn if one.function.startswith("operator")]

    def _draw(self, function: str, arguments: dict[str, Any]) -> Any:
        known = _RNA.functions[function].parameters
        unknown = [name for name in arguments if name not in known]
        assert not unknown, f"{function} has no argument {unknown}"
        icon = arguments.get("icon", "NONE")
        assert icon in _ICONS, f"there is no icon {icon}"
        drawn = Drawn(function, arguments)
        self.drawn.append(drawn)
        if function in ("prop", "template_icon_view"):
            check_property(arguments["data"], arguments["property"])
        if function == "prop_search":
            check_property(arguments["data"], arguments["property"])
            check_property(arguments["search_data"], arguments["search_property"])
        if function == "template_list":
            check_property(arguments["dataptr"], arguments["propname"])
            check_property(arguments["active_dataptr"], arguments["active_propname"])
            assert hasattr(bpy.types, arguments["listtype_name"])
        if function == "operator_menu_enum":
            assert arguments["property"] in operator_type(arguments["operator"]).properties
        if function in ("operator", "operator_menu_enum"):
            return _Button(drawn)
        returned = [one for one in known if one.is_output]
        return RecordingLayout(self.drawn) if returned and returned[0].type == "POINTER" else None


class _Button:
    """What `layout.operator` returns: the operator's properties."""

    def __init__(self, drawn: Drawn) -> None:
        self.__dict__["_drawn"] = drawn
        self.__dict__["_properties"] = operator_type(drawn.arguments["operator"]).properties

    def __setattr__(self, name: str, value: object) -> None:
        assert name in self._properties, f"{self._drawn.arguments['operator']} has no {name}"
        kind = self._properties[name].type
        assert isinstance(value, {"INT": int, "FLOAT": float, "BOOLEAN": bool}.get(kind, str)), f"{name}: {value!r}"
        self._drawn.settings[name] = value


class _Shown:
    """A panel that Blender draws: its class's own attributes, and a layout."""

    def __init__(self, panel: type, layout: RecordingLayout) -> None:
        self.layout, self._panel = layout, panel

    def __getattr__(self, name: str) -> Any:
        return getattr(self._panel, name)


def operator_type(name: str) -> Any:
    """Blender's table of an operator; KeyError where there is none."""
    family, _, action = name.partition(".")
    return getattr(getattr(bpy.ops, family), action).get_rna_type()


def check_property(data: Any, name: str) -> None:
    """That data has a property, one of Blender's or, as ["name"], a custom one."""
    if name.startswith('["'):
        assert name[2:-2] in data, f"{data} has no {name}"
    else:
        assert name in data.bl_rna.properties, f"{data} has no {name}"


def draw(panel: type, context: Any) -> RecordingLayout | None:
    """Draws a panel, its header included, as Blender would; None where its poll says no."""
    if hasattr(panel, "poll") and not panel.poll(context):
        return None
    layout = RecordingLayout()
    for function in ("draw_header", "draw_header_preset", "draw"):
        own = getattr(panel, function, None)
        if own is not None:
            own(_Shown(panel, layout), context)
    return layout


def draw_rows(list_type: type, context: Any, data: Any, items: Any) -> RecordingLayout:
    """Draws every row of a list."""
    layout = RecordingLayout()
    for item in items:
        list_type.draw_item(SimpleNamespace(), context, layout, data, item, 0, data, "")
    return layout
