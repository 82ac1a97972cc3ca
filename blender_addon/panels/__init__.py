# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar's tab JGHand. A panel shows and calls operators; it decides nothing and changes nothing.

common      where panels are, in which order, and the pieces they are drawn of
hand        the engine's state, the hands of the scene
bones       the bones of a foreign rig
pose        poses and finger controls
motion      motion files
picture     what the viewport and renders show
quality     how good and how fast, and what the last picture did
output      bake and export, and how a job stands
training    training set, training with its loss and preview, the avatar's card
advanced    the engine's small print
"""
