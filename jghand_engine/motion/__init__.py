"""Motions in files: our own, and those of other programs, recognized by what stands in them.

read         any motion file, whose format its content tells -> PoseSequence and sentences; what commands call
content      what every reader takes and gives, and what is said of a damaged file
choose       which hand of a file is meant; unit and joint order where a file does not say them
clocks       rates, clocks of unknown units

files   JGHand's own formats, read and written · tables   CSV · openpose, mediapipe, webxr, interhand, freemocap
bvh, usd   skeletons that move: `skeleton` finds the hands in them by `bone_names`, which knows more than the
extension's `conventions`; those are one module for both

repair       gaps filled · tools: cut, at other times, scaled, turned
"""
