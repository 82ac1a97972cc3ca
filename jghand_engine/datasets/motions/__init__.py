"""Motion files of other programs: one module for each format, one common result, recognised by content.

read            any motion file -> PoseSequence and sentences about it; what commands call
recognise       which format a file, or a folder, is
content         the common result of all readers: joints of one or more hands, and what the file says of itself
units           unit, joint order and frame rate where a file does not say them

own             JGHand's own .npz, .json, .csv and plain .npy
openpose, mediapipe, webxr, freemocap, interhand   joint positions
bvh, gltf, usd  skeletons that move: `skeleton` finds the hands in them by `bone_names`

json_text       JSON an element at a time, with bounded memory · json_points   points however they are written
tables          columns that are named after joints
"""
