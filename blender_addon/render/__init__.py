# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered pictures: the render engine, Cycles and EEVEE, many frames without a window."""

# the name by which Blender knows the render engine of this extension
ENGINE = "JGHAND"
