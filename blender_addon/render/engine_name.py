# SPDX-License-Identifier: GPL-3.0-or-later
"""The name by which Blender knows the render engine of this extension."""

ENGINE = "JGHAND"
