# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist can do, one module per thing. An operator does one thing and leaves the how to `bridge` and `core`.

common           failures as reports, polls that say what is missing, long work in turns
hand             add, select and forget hands, rigs and objects that are hands
bone_map         the bones of a foreign rig
pose             poses: take, copy to the other hand, reset, make assets
finger_controls  curl, spread, held tips, joint limits
imports          what makes keys of a file: it is chosen, the engine reads it, hands are keyed in turns
motion           motion files as keys
track            hands in videos as keys
engine           check, start, stop, log
help_page        the page that explains the panels
bake             bakes: made, played, compared, forgotten
export           exports
training         training sets, trainings, avatars from disk
output_common    what both share: first the hands are recorded, then a job works
picture          the scene's settings for pictures, cameras, small print
"""
