# OpenUSD's Python modules are made at run time and carry no types: whatever comes from pxr is of any type.
from typing import Any

def __getattr__(name: str) -> Any: ...
