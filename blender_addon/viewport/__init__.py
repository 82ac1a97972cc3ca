# SPDX-License-Identifier: GPL-3.0-or-later
"""The 3D views that show hands."""
