# SPDX-License-Identifier: GPL-3.0-or-later
"""JGHand for Blender: an armature's 21 joints become a photorealistic hand.

    core/     what needs no Blender: joints, poses, cameras as numbers, the engine as a child process, sentences
    bridge/   the only code that touches Blender's data: armature, motion, camera, version differences
    cli.py    rendering without a window (`scripts/render_blend.py`)

Pictures come from the engine, a process of its own (`jghand serve`); Blender's Python never imports torch. The panel
comes with a later version, so enabling the extension registers nothing yet.

This package is free software under the GNU General Public License, version 3 or later; see LICENSE beside this file.
"""

from __future__ import annotations


def register() -> None:
    """Called by Blender when the extension is enabled. There are no classes yet."""


def unregister() -> None:
    """Called by Blender when the extension is disabled."""
