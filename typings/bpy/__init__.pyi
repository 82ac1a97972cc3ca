# Blender's own module: what blender_addon uses of it is of any type, and the checker's Python does not have it. The
# stubs on PyPI (fake-bpy-module) know neither the properties that this extension adds nor what an object's data is.
from typing import Any

def __getattr__(name: str) -> Any: ...
