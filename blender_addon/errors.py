# SPDX-License-Identifier: GPL-3.0-or-later
"""One sentence and one remedy for everything that can fail.

Details (a path, the last lines of the log) stand apart. Source: BLENDER 3.4.
"""

from __future__ import annotations

from dataclasses import dataclass

# exit codes of a batch run: 2 to 4 are the engine's own, 1 is what Python gives a mistake in a program, 130 what a
# shell gives a command that was interrupted
MISTAKE, BAD_INPUT, TRY_AGAIN, OUT_OF_MEMORY, INTERRUPTED = 1, 2, 3, 4, 130


# what the exit code of a process says that said nothing itself, else that it crashed; the system kills for memory, a
# shell tells it so
EXIT_KINDS = {-9: "killed", 137: "killed", OUT_OF_MEMORY: "out_of_memory"}

# failures of a picture that say nothing about it: somebody gave it up
GIVEN_UP = frozenset({"canceled", "stopped"})


@dataclass(frozen=True)
class Advice:
    """What an artist reads, and the exit code of a batch run that ends with it."""

    sentence: str
    remedy: str
    exit_code: int = BAD_INPUT


ADVICE = {
    "no_interpreter": Advice(
        "The renderer cannot be started", 'Leave "Renderer\'s Python" empty, or choose a Python that has JGHand'
    ),
    "no_python": Advice(
        "The chosen Python does not exist", 'Correct the path of "Renderer\'s Python", or leave it empty'
    ),
    "no_named_python": Advice(
        "The Python that JGHAND_ENGINE_PYTHON names does not exist", "Correct or unset this variable"
    ),
    "no_tools": Advice(
        "Training, video tracking and your own hand need PyTorch, which is not installed",
        'Press "Install Training Tools" in the extension\'s preferences',
    ),
    "tools_failed": Advice(
        "The training tools could not be installed", 'Look at "Show Log" and install again', TRY_AGAIN
    ),
    "no_engine": Advice(
        "The chosen Python has no JGHand, or lacks something that it needs",
        'Leave "Renderer\'s Python" empty, or install JGHand there',
    ),
    "protocol": Advice("Extension and renderer are of different versions", "Update the older one"),
    "start_timeout": Advice("The renderer did not start in time", 'Look at "Show Log" and try again', TRY_AGAIN),
    "out_of_memory": Advice("Out of memory", 'Choose a smaller resolution or a lower "Quality"', OUT_OF_MEMORY),
    "killed": Advice(
        "The system ended the renderer, most likely for memory",
        'Close other programs, or choose a lower "Quality"',
        OUT_OF_MEMORY,
    ),
    "crashed": Advice(
        "The renderer stopped unexpectedly", 'Look at "Show Log" and press "Restart Renderer"', TRY_AGAIN
    ),
    "hung": Advice(
        "The renderer does not answer in time",
        'Press "Restart Renderer", or allow a longer "Render Timeout"',
        TRY_AGAIN,
    ),
    "broken_stream": Advice("The connection to the renderer broke", 'Look at "Show Log" and try again', TRY_AGAIN),
    "stopped": Advice("The renderer was stopped", "It starts again with the next image", TRY_AGAIN),
    "canceled": Advice("Canceled", "Start it again when it is wanted", INTERRUPTED),
    "no_graphics": Advice(
        "The graphics driver does not draw the hand", "Make the view smaller, or update the driver", TRY_AGAIN
    ),
    "token": Advice("Unexpected server", 'Press "Restart Renderer"', TRY_AGAIN),
    "busy": Advice("The renderer serves another program", 'Press "Restart Renderer"', TRY_AGAIN),
    "bad_avatar": Advice("The avatar is damaged, or no JGHand avatar", 'Choose another "Avatar", or empty the field'),
    "no_avatar": Advice("The file of the avatar does not exist", 'Choose another "Avatar", or put the file back'),
    "bad_pack": Advice("There are no hands in this file", "Choose a zip of JGHand's hands"),
    "bad_input": Advice("JGHand cannot use what it was given", "Correct it and try again"),
    "retry": Advice("The renderer could not do it now", "Try again", TRY_AGAIN),
    "internal": Advice("Internal error", 'Look at "Show Log" and report it', MISTAKE),
    "interrupted": Advice("The run was interrupted", "Start it again to continue where it stopped", INTERRUPTED),
    "no_place": Advice("There is no folder to write to yet", "Save the file first, or choose a folder"),
    "no_bake": Advice("There is no finished bake here", 'Press "Bake", or choose the folder of a bake'),
    "stale_bake": Advice("The bake is not of what the scene has now", "Bake again"),
    "no_pictures": Advice(
        "There are no images to learn from", 'Press "Render Training Set", or choose the folder of a "Training Set"'
    ),
    "no_usd": Advice("This Blender cannot read or write USD", "Use a Blender that was built with USD"),
    "job_running": Advice("This is running already", "Wait until it has ended, or cancel it", TRY_AGAIN),
    # what this side refuses
    "not_a_hand": Advice(
        "This armature is not a JGHand hand", 'Press "Add Hand", or "Use Existing Armature" and map its bones'
    ),
    "bad_bone_map": Advice("This armature's bones do not make a whole hand", "Complete the bone map"),
    "no_hand": Advice(
        "There is no hand in this scene that is rendered",
        "Add a hand, enable one in renders, or choose another Render Engine in Render Properties",
    ),
    "hidden": Advice(
        "This object is disabled in viewports, so Blender does not evaluate it", "Enable it or its collection"
    ),
    "scripts_blocked": Advice(
        "This file needs its Python scripts or drivers, and they are blocked",
        "If you trust the file, allow its scripts",
    ),
    "mirrored": Advice(
        "This hand is mirrored on some of the frames only",
        "Export the frames before the flip and those after it separately",
    ),
    "zero_scale": Advice("A scale of zero is not supported", "Give the object a scale"),
    "constrained": Advice(
        "Constraints or drivers move bones of this hand, so keys alone cannot", "Mute or remove them"
    ),
    "bad_joints": Advice("These joints are not a hand's motion", "Check the file"),
    "not_editable": Advice(
        "The bones of this armature cannot be changed: it is hidden, or linked from another file",
        "Show it, or make it local",
    ),
    "bad_motion": Advice(
        "This file is no motion that JGHand can read",
        "Choose a motion file, and beside it in the file browser what it does not say itself: hand, unit, order, frame "
        "rate or part",
    ),
    "offline": Advice(
        "The networks that find a hand are not on this computer, and Blender may not go online",
        'Switch "Allow Online Access" on in the preferences, under System',
        TRY_AGAIN,
    ),
    "other_hand": Advice("This motion is of the other hand", "Choose an armature of that hand"),
    "not_a_camera": Advice("There is no camera of this name", "Choose a camera of the scene"),
    "no_camera": Advice("The scene has no camera", 'Press "Add Hand Camera", or choose one in Scene Properties'),
    "panoramic": Advice("Panoramic cameras are not supported", "Choose a perspective or orthographic camera"),
    "orthographic_lens": Advice(
        "Orthographic cameras have no depth of field here", "Switch it off, or choose a perspective camera"
    ),
    "stereo": Advice("Stereoscopy and multiple views are not supported", "Switch them off and render each view"),
    "no_world_image": Advice(
        "The image of the world is missing", "Choose another one in World Properties, or put the file back"
    ),
    "world_not_measured": Advice(
        "The light of the world is not measured at this frame",
        "Show a hand in a view, then render again, or render without a window",
        TRY_AGAIN,
    ),
    "exact_light": Advice(
        "The exact light of this frame was not baked",
        'Render again, in a window while a viewport shows a hand, or switch "Exact Light" off',
        TRY_AGAIN,
    ),
    "world_bake": Advice(
        "Cycles could not measure the light of the world",
        "Let other renders and bakes end, then change the world or render without a window",
        TRY_AGAIN,
    ),
    "no_cycles": Advice(
        "The light of the scene is measured by Cycles, which is disabled",
        "Enable Cycles Render Engine in the preferences, under Add-ons",
    ),
    "other_region": Advice(
        "The render region is not that of the scene that the hands are combined with",
        'Press "Set Up Compositing" again',
    ),
    "empty_region": Advice("The render region has no pixels", "Draw it larger, or switch it off"),
    "sheared_camera": Advice(
        "The camera is sheared or mirrored by its parents", "Clear their scale or the camera's parent"
    ),
    "same_folder": Advice(
        "The images of two cameras would lie in one folder", "Rename one of them, or render them apart"
    ),
    "bad_file": Advice("This file cannot be opened", "Choose a .blend file"),
    "cannot_write": Advice("The file cannot be written", "Choose a folder that you may write to"),
    "disk_full": Advice("The disk is full", "Free some space and start again", TRY_AGAIN),
}


class JGHandFailure(Exception):  # noqa: N818 - the extension's word for it
    """Something failed that an artist can do something about. kind: a key of ADVICE; detail: small print; log: what
    the engine printed last, where it was the engine that failed."""

    def __init__(self, kind: str, detail: str = "", *, log: str = "") -> None:
        self.log = log
        known = kind if kind in ADVICE else "internal"
        self.kind, self.detail = known, detail if known == kind else f"{kind}: {detail}"
        self.advice = ADVICE[known]
        text = f"{self.advice.sentence}. {self.advice.remedy}."
        super().__init__(f"{text} ({self.detail})" if self.detail else text)
