# SPDX-License-Identifier: GPL-3.0-or-later
"""The only code that touches Blender's data.

Hands
    armature       one armature per hand: building it, finding it, reading its 21 joints
    sources        hands that are no armature of ours: foreign rigs through bone maps, 21 objects
    bone_list      a bone map as rows that Blender can show and edit
    controls       finger controls on our armature: curl, spread, fist, splay, held tips, joint limits
    shapes         what the controls look like
    hand_poses     taking a pose, the other hand's pose, rest; keys of them
    pose_library   the poses as Blender pose assets, in a folder made on demand; pose_shelf shows it
    pose_pictures  small pictures of the poses for menus
    motion         a motion onto an armature, as keys
    record         hands over a range of frames

Cameras and the opened file
    camera         a Blender camera as a pinhole, and back
    framing        cameras and views that show a hand whole
    scene          the opened file: its cameras and hands, and whether Blender evaluated them truly
    world          what lies behind the hands
    versions       what differs between Blender versions, one function per difference
    folders        where the extension may write, and what paths of settings mean
    owners         what is whose in a folder that files share; bake_folders: which bake is whose
    appended       paths of hands from another file
    undo           changes that no operator makes, as a step

Pictures in the viewport
    views          the 3D views that show hands: what each wants, asked for, and has
    seen_hands     which hands a view shows, read for it; view_camera is its pinhole
    avatar_files   whether the files of their avatars changed
    picture        the draw handler in Solid and Material Preview; viewport_engine the same in Rendered
    gpu_picture    a picture as textures, drawn with depth; shown_bones keeps bones visible before it
    sync           handlers and timer that keep views up to date
    clock          that timer, and what all timers of the extension share

Renders
    moments        the hands and the camera of a picture, or of its sub-frames, as Blender evaluated them for it
    rendering      whether Blender renders, and with it what is left to views
    combination    hands in pictures of Cycles and EEVEE: a scene of their own, combined by depth
    guard          no combined picture without its hands is written
    left_out       a word where a picture leaves the hands out
    engine_name    the name by which Blender knows the render engine

Bakes and exports
    baked_points   a bake as an object that plays by Blender's own USD; cache_player the same without USD
    usd_hook       Blender's own USD export gets the baked splats

Panels and jobs
    job_watch      looks after jobs, and after what a training shows
    cards          keeps what avatars say of themselves
    kept           what panels show of disks and evaluated scenes, looked up on a timer
    popup          a word to the artist that no operator can say
    redraw         areas drawn anew; icons: computed pictures as icons; classes: registering once
"""
