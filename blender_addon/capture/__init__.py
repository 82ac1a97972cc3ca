# SPDX-License-Identifier: GPL-3.0-or-later
"""What `jghand capture` starts: renders a written plan with Blender's Cycles, in a Python that has bpy.

It imports bpy, numpy and the standard library, and nothing of the rest of the extension or of JGHand's engine, which
starts it as a process of its own and never imports it. What passes between the two are files (the plan, the pictures)
and lines of JSON.

__main__   the process: reads jobs, renders, reports
scene      mesh, skin, light and camera in Blender; finished pictures with their stamp
lit        the same in another light in every picture, with a light group each
"""
