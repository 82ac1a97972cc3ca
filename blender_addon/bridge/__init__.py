# SPDX-License-Identifier: GPL-3.0-or-later
"""The only code that touches Blender's data.

versions   what differs between Blender versions, one function per difference
armature   one armature per hand: building it, finding it, reading its 21 joints
sources    hands that are no armature of ours: foreign rigs through bone maps, 21 objects
controls   finger controls on our armature: curl, spread, fist, splay, held tips, joint limits
shapes     what the controls look like
hand_poses   taking a pose, the other hand's pose, rest; keys of them
pose_pictures  small pictures of the poses for menus; pose_shelf shows the assets
bone_list  a bone map as rows that Blender can show and edit
folders    where the extension may write, and what paths of settings mean; owners, bake_folders  what is whose there
appended   paths of hands from another file
undo       changes that no operator makes, as a step
pose_library  the poses as Blender pose assets, in a folder made on demand
motion     a motion onto an armature, as keys
camera     a Blender camera as a pinhole, and back
scene      the opened file: its cameras and hands, and whether Blender evaluated them truly
framing    cameras and views that show a hand whole
views      the 3D views that show hands: what each wants, asked for, and has
seen_hands   which hands a view shows, read for it; view_camera is its pinhole
picture    the draw handler in Solid and Material Preview; viewport_engine the same in Rendered
gpu_picture  a picture as textures, drawn with depth; shown_bones keeps bones visible before it
sync       handlers and timer (clock) that keep views up to date; rendering says whether Blender renders
record     hands over a range of frames
baked_points  a bake as an object that plays by Blender's own USD; cache_player the same without USD
usd_hook   Blender's own USD export gets the baked splats
guard      no combined picture without its hands is written; popup  a word to the artist that no operator can say
redraw     areas drawn anew; icons  computed pictures as icons; classes  registering once
job_watch  looks after jobs, and after what a training shows; cards keeps what avatars say of themselves
kept       what panels show of disks and evaluated scenes, looked up on a timer
"""
