# SPDX-License-Identifier: GPL-3.0-or-later
"""JGHand for Blender: an armature's 21 joints become a photorealistic hand.

    core/            what needs no Blender: joints, poses, cameras as numbers, the engine as a child process, sentences
    bridge/          the only code that touches Blender's data: armature, motion, camera, version differences
    operators/       what an artist can do
    panels/          the sidebar's tab
    properties.py    what is saved with a file: settings of a hand and of a scene, of output in output_settings.py
    preferences.py   what holds for this user and machine: where the engine is
    runtime.py       the one link to the engine, and the jobs
    registration.py  the ordered list of what is added to Blender
    render_engine.py F12, animations and `blender -b -a`
    cli.py           many frames without a window (`blender --command jghand render`, `scripts/render_blend.py`)

Pictures come from the engine, a process of its own (`jghand serve`); Blender's Python never imports torch.

This package is free software under the GNU General Public License, version 3 or later; see LICENSE beside this file.
"""

from __future__ import annotations


def register() -> None:
    """Called by Blender when the extension is enabled."""
    from . import registration  # here, so that `core` can be imported where there is no Blender

    registration.register()


def unregister() -> None:
    """Called by Blender when the extension is disabled."""
    from . import registration

    registration.unregister()
