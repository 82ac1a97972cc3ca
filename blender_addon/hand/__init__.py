# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands: armature, finger controls, poses, other people's rigs, motions."""
