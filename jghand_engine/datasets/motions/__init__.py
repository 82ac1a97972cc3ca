"""Motion files of other programs: one module for each format, one common result, recognised by content.

read         any motion file -> PoseSequence and sentences about it; what commands call. JGHand's own formats are
             those of `datasets.motion_files`
recognise    which format a file, or a folder, is
content      the common result of all readers: joints of one or more hands, and what the file says of itself
units        unit, joint order and frame rate where a file does not say them

openpose, mediapipe, webxr, freemocap, interhand, tables   joint positions
bvh, gltf, usd   skeletons that move: `skeleton` finds the hands in them by `bone_names`

frames       hands that were found frame by frame, put together; clocks of unknown units
json_text    JSON an element at a time, with bounded memory; json_points: points however they are written
text_lines   lines that end
"""
