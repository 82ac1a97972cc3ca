# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension knows without Blender: no module here imports bpy, and each is tested with plain Python.

limits          every number, with its reason
joints          names, parents and bones of the 21 joints; the rest hand
conventions     how other people name the bones of a hand
bone_maps       which bones of somebody else's rig are the 21 joints
posing          joint positions to bone matrices and back (numpy)
controls        finger controls as numbers: axes, what their turns do, joint ranges (numpy)
poses           hand poses with names, for both hands (numpy); pose_picture draws them for the pose library
motion_files    motions in files that say what they hold (numpy); motion_conversion: those of others, by the engine
video_tracking  motions of hands in videos, by the engine
view            pinhole cameras, hands in their own space, and the request for a picture (numpy)
file_stamps     whether the file of an avatar changed
film            that picture as Blender's passes (numpy)
wire            the protocol module, from the extension or from the engine's package
engine_command  where the engine is; programs: what systems differ in about other programs
engine_check    what that engine is made of, what is missing, what mends it
link            the engine as everybody sees it: pictures, exact requests, its state
state           what becomes of its process, decided by a pure function
waiting         who waits for what of it
answers         what it gives back
connection      one process and the socket to it; process has its pipes and its log
pacing          when a view asks for a picture, how good a one, how long it waits, which one it may show; attempts: what
                failed is tried again, and left alone after a few times
cropping        the part of a view that can show hands
batch           frames, names and files of a batch run, and its report
stamp           what the pictures of a folder were made from; export_stamp whose the exports of a folder are
obstacle        keeps a picture from being written
aside           work in a thread, and in turns
jobs            child processes of the engine's command line: progress, pause, cancel; job_state decides, purely
engine_words    the words of their commands
recording       a hand over a range of frames, what is exported and baked, and how large that gets (numpy)
bakes           what lies in the folder of a bake, and whether it is still so; splat_cache reads its frames (numpy)
training_folder  what a training leaves on disk: loss, previews; avatar_card what an avatar says of itself
panel_text      what panels say: the engine's state, a picture's receipt, a bone map
messages        one sentence and one remedy for everything that can fail
"""
