# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension knows without Blender: no module here imports bpy, and each is tested with plain Python.

joints          names, parents and bones of the 21 joints; the rest hand
bone_maps       which bones of somebody else's rig are the 21 joints
posing          joint positions to bone matrices and back (numpy)
controls        finger controls as numbers: axes, what their turns do, joint ranges (numpy)
stand_in        the surface of a hand at rest for any joints: what throws its shadow (numpy)
poses           hand poses with names, solved for each hand (numpy); the pose library is a shipped .blend
view            pinhole cameras, hands in their own space, the part of a view that shows them, the request for a
                picture, and that as Blender's passes
lamps           Blender's lights as the engine's lamps (numpy)
worlds          pictures of a world: averaged, or from what a light probe measured; facets for baked light (numpy)
files           files that appear under their name only when they are whole
pacing          when a view asks for a picture, how good a one, how long it waits, which one it may show
panel_text      what panels say: the renderer's state, a picture's receipt, a bone map

And what extension and engine share: `protocol`, and `conventions`, how other people name the bones of a hand; and of
the hand itself `kinematics` and `shapes`, how its joints bend and what the named poses are. The extension's build
copies them here, these two with what they import into `shared`; a checkout has them there.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

# the file decides, not whether its import works: a broken copy must not be taken for a missing one
if TYPE_CHECKING or not Path(__file__).with_name("protocol.py").is_file():
    from jghand_engine.hand import kinematics, shapes
    from jghand_engine.motion import conventions
    from jghand_engine.service import protocol
else:
    from . import conventions, protocol
    from .shared.hand import kinematics, shapes

__all__ = ["conventions", "kinematics", "protocol", "shapes"]
