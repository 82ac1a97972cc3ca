"""Motion files of other programs: one module for each format, one common result, recognized by content.

read         any motion file -> PoseSequence and sentences about it; what commands call. JGHand's own formats are
             those of `datasets.motion_files`
recognize    which format a file, or a folder, is
content      the common result of all readers: joints of one or more hands, and what the file says of itself
chosen       which hand of a file is meant
units        unit and joint order where a file does not say them; clocks: rates, clocks of unknown units, times of keys

openpose, mediapipe, webxr, freemocap, interhand, tables   joint positions
bvh, gltf, usd   skeletons that move: `skeleton` finds the hands in them by `bone_names`

frames       hands that were found frame by frame, put together
damage       what is wrong with a file, in one sentence
json_text    JSON an element at a time, with bounded memory; json_points: points however they are written
text_lines   lines that end
"""
