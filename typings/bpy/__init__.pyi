# Blender's own module: what blender_addon/capture uses of it is not typed, and the checker's Python does not have it.
from typing import Any

def __getattr__(name: str) -> Any: ...
