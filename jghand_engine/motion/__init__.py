"""Motions in files: our own, and those of other programs, recognized by what stands in them.

read         any motion file -> PoseSequence and sentences about it; what commands call
recognize    which format a file, or a folder, is, and its content
files        JGHand's own formats: read and written
content      the common result of all readers, and what is said of a damaged file
choose       which hand of a file is meant; unit and joint order where a file does not say them
clocks       rates, clocks of unknown units, times of keys

openpose, mediapipe, webxr, interhand, freemocap, tables   joint positions
bvh, gltf, usd   skeletons that move: `skeleton` finds the hands in them by `bone_names`

repair       gaps filled · tools: cut, at other times, scaled, turned
"""
