# SPDX-License-Identifier: GPL-3.0-or-later
"""JGHand for Blender: an armature's 21 joints become a photorealistic hand.

    core/            what needs no Blender: joints, poses, bone maps, cameras as numbers, pacing, sentences
    renderer/        the renderer as a process: finding it, its link, its jobs
    hand/            armature, finger controls, poses, other people's rigs, motions
    viewport/        the 3D views that show hands
    render/          F12, animations, Cycles and EEVEE, many frames without a window
    export/          bakes, exports, Blender's own USD export
    train/           training sets and trainings
    registration.py  the ordered lists of what is added to Blender
    preferences.py   what holds for this user and machine
    versions.py      what differs between Blender versions
    ui.py, ops.py    what panels and operators share; folders.py, clock.py: where files go, timers
    errors.py        one sentence and one remedy for everything that can fail

A feature's operators (`ops`), panels and properties lie beside its logic.

Pictures come from the renderer, a process of its own (`jghand serve`); Blender's Python never imports torch.

This package is free software under the GNU General Public License, version 3 or later; see LICENSE beside this file.
"""

from __future__ import annotations


def register() -> None:
    # here, so that `core` can be imported where there is no Blender
    global glTF2ExportUserExtension  # Blender's glTF exporter looks for it
    from . import registration
    from .hand.stand_ins import GltfHook as glTF2ExportUserExtension

    registration.register()


def unregister() -> None:
    from . import registration

    registration.unregister()
    globals().pop("glTF2ExportUserExtension", None)
