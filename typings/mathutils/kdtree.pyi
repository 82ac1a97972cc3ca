# Comes with bpy, see there.
from typing import Any

def __getattr__(name: str) -> Any: ...
