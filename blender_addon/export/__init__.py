# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes, exports, and Blender's own USD export."""
