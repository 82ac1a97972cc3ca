# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered pictures: the render engine, Cycles and EEVEE, many frames without a window."""
