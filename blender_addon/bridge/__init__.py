# SPDX-License-Identifier: GPL-3.0-or-later
"""The only code that touches Blender's data.

versions   what differs between Blender versions, one function per difference
armature   one armature per hand: building it, finding it, reading its 21 joints
motion     a motion onto an armature, as keys
camera     a Blender camera as a pinhole, and back
scene      the opened file: its cameras and hands, and whether Blender evaluated them truly
framing    cameras that show a hand over a whole motion
"""
