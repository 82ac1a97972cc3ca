# Blender's own module: of what jghand_cycles uses of it nothing is typed, and the checker's Python does not have it.
from typing import Any

def __getattr__(name: str) -> Any: ...
