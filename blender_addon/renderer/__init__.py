# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine as a process: finding it, checking it, the link to it, and its jobs."""
