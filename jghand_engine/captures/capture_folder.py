"""One door to all data sets: a folder goes in, a capture comes out, whatever its layout; and the choices of images
that published figures stand for, by name. Source: DATA 5.

The avatar papers (HandAvatar and those after it) learn from one sequence of a person of InterHand2.6M and show
another, at 5 frames per second, and leave out images by the rules of HandAvatar's published preparation. Their masks
are MANO's silhouette, stored as masks_removeblack; where those are absent a template's stands in, and figures say so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from jghand_engine.captures.captures import Capture, CaptureChoice, Layout
from jghand_engine.captures.hanco import is_hanco, read_hanco
from jghand_engine.captures.image_files import read_image, read_mask
from jghand_engine.captures.interhand import read_interhand
from jghand_engine.captures.interhand_files import InterHandImage, is_interhand
from jghand_engine.captures.known_light import LIGHTS_FILE, KnownLight, groups_file, read_lights
from jghand_engine.captures.masks import template_mask
from jghand_engine.captures.reading import Report, find_roots, subfolders
from jghand_engine.captures.sample import MaskSource, Sample
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.wrist import unit_turns
from jghand_engine.json_files import JsonObject
from jghand_engine.npz_files import read_arrays
from jghand_engine.template.mesh import HandTemplate

# the same papers leave an image out when the hand's box is nearer to the border than this or smaller, pixels; when it
# is as dark as this; when two color channels differ nowhere by more than this; when the mask has fewer pixels
PAPER_BORDER_PX = 10
PAPER_BOX_MIN_PX = 80
PAPER_DARK = 20
PAPER_CHANNEL_DIFFERENCE = 1
PAPER_MASK_MIN_PX = 3000

# what `jghand capture` says of its pictures and of their poses; the mark among the one of those that show the forearm
# too, and the array among the other that says how it is turned
PLAN_FILE, HANDS_FILE, FOREARM = Path("plan") / "plan.json", Path("plan") / "hands.npz", "forearm"

_LEARN, _SHOW = "ROM04_RT_Occlusion", "ROM03_RT_No_Occlusion"


@dataclass(frozen=True)
class Protocol:
    """layout: the data set · choice: its images · train, test: sequences to learn from and to be judged by; both
    empty: the fixed rule"""

    name: str
    layout: Layout
    choice: CaptureChoice
    train: tuple[str, ...]
    test: tuple[str, ...]


def _avatar_papers(split: str, capture: str) -> Protocol:
    """Of HandAvatar and the papers after it."""
    choice = CaptureChoice(split, capture, (_LEARN, _SHOW), Handedness.RIGHT, some=True)
    return Protocol(f"{split}-{capture}".lower(), Layout.INTERHAND, choice, (_LEARN,), (_SHOW,))


PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        *(_avatar_papers(*of) for of in (("test", "Capture0"), ("test", "Capture1"), ("val", "Capture0"))),
        # the papers do not state their split, ours holds out every n-th pose and camera
        Protocol("hanco-0191", Layout.HANCO, CaptureChoice(sequences=("0191",)), (), ()),
    )
}


def open_capture(
    folder: Path | str,
    *,
    protocol: str | None = None,
    choice: CaptureChoice | None = None,
    report: Report | None = None,
    template: HandTemplate | None = None,
) -> Capture:
    """The images of one hand in a folder of InterHand2.6M, of HanCo, or made by `jghand capture`.

    folder:   the data set, the folder around it, or one inside it, which then chooses (images/test/Capture0)
    protocol: a name of PROTOCOLS, instead of a choice
    choice:   which images, where there are those of several persons or hands
    report:   is told of broken images and implausible joints instead of the error, and the reading goes on
    template: whose silhouette stands in for masks that are not there; None: the built-in hand's
    InputError names what is wrong: the folder, an annotation, the first image that is missing or broken.
    """
    place = Path(folder)
    if protocol is not None:
        if choice is not None:
            raise InputError("choice of images", wanted="a protocol or a choice", came="both", remedy="Drop one.")
        if protocol.lower() not in PROTOCOLS:
            raise InputError("protocol", wanted=f"one of {', '.join(PROTOCOLS)}", came=repr(protocol))
        capture = _by_protocol(place, PROTOCOLS[protocol.lower()], report, template)
    elif layout_of(place) is Layout.HANCO:
        capture = read_hanco(place, choice, report=report)
    else:
        capture = read_interhand(place, choice, report=report)
    capture, lights = replace(capture, shows_forearm=_shows_forearm(capture.folder)), read_lights(capture.folder)
    forearm = _forearm(capture) if capture.shows_forearm else None
    return capture.only(
        replace(
            sample,
            template=template,
            light=_light(sample, lights) if lights else None,
            forearm=None if forearm is None else forearm[sample.frame],
        )
        for sample in capture.samples
    )


def _shows_forearm(folder: Path) -> bool:
    file = folder / PLAN_FILE
    if not file.exists():
        return False
    plan = JsonObject.of_file(file, "Start the command that made the capture again, in another folder.")
    render = plan.object("render")
    return render is not None and render.flag(FOREARM, False)


def _forearm(capture: Capture) -> np.ndarray | None:
    """(P, 4) how the forearm is turned in each frame of a capture of ours; None for one of before that was known."""
    file, thing = capture.folder / HANDS_FILE, f"the poses of the capture {capture.folder}"
    turns = read_arrays(file, (), thing, optional=(FOREARM,)).get(FOREARM) if file.exists() else None
    if turns is None:
        return None
    if turns.shape[1:] != (4,) or len(turns) <= max(sample.frame for sample in capture.samples):
        raise InputError(f"{FOREARM} in {thing}", wanted="(poses, 4) quaternions", came=f"shape {turns.shape}")
    return unit_turns(turns)


def _light(sample: Sample, lights: dict[tuple[int, str], KnownLight]) -> KnownLight:
    known = lights.get((sample.frame, sample.camera_name))
    if known is None:
        came = f"none of {sample.frame}/{sample.camera_name}"
        raise InputError(f"{LIGHTS_FILE}", wanted="the light of every picture", came=came)
    return replace(known, file=groups_file(sample.image))


def layout_of(folder: Path) -> Layout:
    """How the files in, around or above a folder are arranged. InputError when it is no layout that we know."""
    if find_roots(folder, is_interhand):
        return Layout.INTERHAND
    if find_roots(folder, is_hanco):
        return Layout.HANCO
    names = [entry.name for entry in subfolders(folder)]
    if "images" in names:
        came, remedy = (
            "images/, but no annotations/",
            "Download InterHand2.6M's annotations, and unpack them beside it.",
        )
    elif "annotations" in names:
        came, remedy = "annotations/ without InterHand2.6M's files", "Download and unpack the annotations again."
    else:
        came = f"folders {', '.join(names[:6])}" if names else "no folders"
        remedy = "Name the folder that holds images/ and annotations/, or HanCo's rgb/ and meta.json."
    raise InputError(f"data set {folder}", wanted="InterHand2.6M, HanCo or our own capture", came=came, remedy=remedy)


def _by_protocol(folder: Path, protocol: Protocol, report: Report | None, template: HandTemplate | None) -> Capture:
    came = layout_of(folder)
    if came is not protocol.layout:
        raise InputError(f"protocol {protocol.name}", wanted=protocol.layout.value, came=f"{came.value} in {folder}")
    if protocol.layout is Layout.HANCO:
        capture = read_hanco(folder, protocol.choice, report=report)
    else:
        drop = partial(avatar_papers_drop, template=template)
        capture = read_interhand(folder, protocol.choice, drop_rule=drop, report=report)
        capture = with_papers_masks(capture)
    return replace(capture, protocol=protocol.name, train_sequences=protocol.train, test_sequences=protocol.test)


# ---- the rules of the avatar papers ----------------------------------------------------------------------------------


def avatar_papers_drop(sample: Sample, image: InterHandImage, template: HandTemplate | None = None) -> str | None:
    """Why the avatar papers leave an image out, or None. It reads the image. template: as in `open_capture`."""
    reason = _box_reason(image)
    if reason is not None:
        return reason
    rgb = read_image(sample.image)[..., :3].astype(np.float64)
    if rgb.max() < PAPER_DARK:
        return "dark"
    pairs = ((0, 1), (1, 2), (0, 2))
    if any(np.abs(rgb[..., a] - rgb[..., b]).max() <= PAPER_CHANNEL_DIFFERENCE for a, b in pairs):
        return "gray camera"
    mask = _mask(sample, template) > 0
    if mask.sum() < PAPER_MASK_MIN_PX:
        return "small mask"
    return "dark hand" if rgb[mask].mean(axis=-1).max() < PAPER_DARK else None


def _box_reason(image: InterHandImage) -> str | None:
    if len(image.bbox_px) != 4:
        raise InputError(f"bbox of {image.where}", wanted="x, y, width, height", came=str(image.bbox_px))
    x, y, width, height = image.bbox_px
    border = PAPER_BORDER_PX
    if min(x, y, image.width - x - width, image.height - y - height) < border:
        return "hand near the border"
    return "small hand" if max(width, height) < PAPER_BOX_MIN_PX else None


def _mask(sample: Sample, template: HandTemplate | None) -> np.ndarray:
    if sample.mask is not None:
        return read_mask(sample.mask)
    return template_mask(sample.camera, sample.joints_m, sample.handedness, template)


def with_papers_masks(capture: Capture) -> Capture:
    """Images without a mask file get the papers' rule on the projected template; without any, nothing changes."""
    samples = tuple(
        replace(sample, mask_source=MaskSource.TEMPLATE_LIT) if sample.mask_source is MaskSource.TEMPLATE else sample
        for sample in capture.samples
    )
    return capture.only(samples)
