"""How one knows whether a layer is still as it was written.

The extension knows text layers by the same comment (its export/export_stamp.py).
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from pxr import Sdf, Tf

from jghand_engine.export.usd.provenance import CREATOR
from jghand_engine.motion.usd_files import TEXT

_SEAL = re.compile(rb"# as JGHand wrote it: ([0-9a-f]{64})\n\Z")


def seal(path: Path) -> None:
    """Adds a comment to a text layer by which `is_as_written` knows it. A program that saves the layer drops it."""
    content = path.read_bytes()
    with path.open("ab") as stream:
        stream.write(f"# as {CREATOR} wrote it: {hashlib.sha256(content).hexdigest()}\n".encode())


def is_as_written(path: Path) -> bool:
    """Whether a file is an export's, and no text layer that somebody has changed since, as one puts lights into the
    shot. Of binary files, which nobody edits by hand, it asks only who made them."""
    try:
        content = path.read_bytes() if path.suffix == ".usda" else b""
    except OSError:  # cannot be looked at
        return False
    if content.startswith(TEXT):
        last = _SEAL.search(content)
        return last is not None and hashlib.sha256(content[: last.start()]).hexdigest() == last.group(1).decode()
    try:
        layer = Sdf.Layer.OpenAsAnonymous(str(path), True)
    except Tf.ErrorException:
        return False
    return layer is not None and str(layer.customLayerData.get("creator", "")).startswith(f"{CREATOR} ")
