# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension knows without Blender: no module here imports bpy, and each is tested with plain Python.

joints          names, parents and bones of the 21 joints; the rest hand
bone_maps       which bones of somebody else's rig are the 21 joints
posing          joint positions to bone matrices and back (numpy)
controls        finger controls as numbers: axes, what their turns do, joint ranges (numpy)
stand_in        the surface of a hand at rest for any joints: what throws its shadow (numpy)
poses           hand poses with names, for both hands (numpy); the pose library is a shipped .blend
view            pinhole cameras, hands in their own space, the part of a view that shows them, the request for a picture
lamps           Blender's lights as the engine's lamps (numpy)
worlds          pictures of a world: averaged, or from what a light probe measured; facets for baked light (numpy)
film            that picture as Blender's passes (numpy)
files           files that appear under their name only when they are whole
wire            what extension and engine share: the protocol, and how other people name the bones of a hand
pacing          when a view asks for a picture, how good a one, how long it waits, which one it may show
panel_text      what panels say: the renderer's state, a picture's receipt, a bone map
"""
