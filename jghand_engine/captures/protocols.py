"""The choices of pictures that published figures stand for, by name. Sources: PAPER 2, DATA 5.

The avatar papers (HandAvatar and those after it) learn from one sequence of a person of InterHand2.6M and show
another, at 5 frames per second, and leave out pictures by the rules of HandAvatar's published preparation. Their masks
are MANO's silhouette, stored as masks_removeblack; where those are absent our template's stands in, and figures say so.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from jghand_engine.captures.captures import Capture, CaptureChoice, Layout
from jghand_engine.captures.interhand_annotations import InterHandPicture
from jghand_engine.captures.masks import template_mask
from jghand_engine.captures.pictures_in import read_mask, read_picture
from jghand_engine.captures.sample import MaskSource, Sample
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness

# the same papers leave a picture out when the hand's box is nearer to the border than this or smaller, pixels; when it
# is as dark as this; when two color channels differ nowhere by more than this; when the mask has fewer pixels
PAPER_BORDER_PX = 10
PAPER_BOX_MIN_PX = 80
PAPER_DARK = 20
PAPER_CHANNEL_DIFFERENCE = 1
PAPER_MASK_MIN_PX = 3000

_LEARN, _SHOW = "ROM04_RT_Occlusion", "ROM03_RT_No_Occlusion"


@dataclass(frozen=True)
class Protocol:
    """layout: the data set · choice: its pictures · train, test: sequences to learn from and to be judged by; both
    empty: the fixed rule · papers: which figures it stands for"""

    name: str
    layout: Layout
    choice: CaptureChoice
    train: tuple[str, ...]
    test: tuple[str, ...]
    papers: str


def _avatar_papers(split: str, capture: str) -> Protocol:
    choice = CaptureChoice(split, capture, (_LEARN, _SHOW), Handedness.RIGHT)
    papers = f"{split}/{capture} of HandAvatar and the papers after it"
    return Protocol(f"{split}-{capture}".lower(), Layout.INTERHAND, choice, (_LEARN,), (_SHOW,), papers)


_HANCO = Protocol(
    "hanco-0191",
    Layout.HANCO,
    CaptureChoice(sequences=("0191",)),
    (),
    (),
    "HanCo/0191; the papers do not state their split, ours holds out every n-th pose and camera",
)
PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        *(_avatar_papers(*of) for of in (("test", "Capture0"), ("test", "Capture1"), ("val", "Capture0"))),
        _HANCO,
    )
}


def find_protocol(name: str) -> Protocol:
    """The protocol called `name`. InputError lists the known ones."""
    if name.lower() not in PROTOCOLS:
        raise InputError("protocol", wanted=f"one of {', '.join(PROTOCOLS)}", came=repr(name))
    return PROTOCOLS[name.lower()]


def avatar_papers_drop(sample: Sample, picture: InterHandPicture) -> str | None:
    """Why the avatar papers leave a picture out, or None. It reads the picture."""
    reason = _box_reason(picture)
    if reason is not None:
        return reason
    rgb = read_picture(sample.picture)[..., :3].astype(np.float64)
    if rgb.max() < PAPER_DARK:
        return "dark"
    pairs = ((0, 1), (1, 2), (0, 2))
    if any(np.abs(rgb[..., a] - rgb[..., b]).max() <= PAPER_CHANNEL_DIFFERENCE for a, b in pairs):
        return "gray camera"
    mask = _mask(sample) > 0
    if mask.sum() < PAPER_MASK_MIN_PX:
        return "small mask"
    return "dark hand" if rgb[mask].mean(axis=-1).max() < PAPER_DARK else None


def _box_reason(picture: InterHandPicture) -> str | None:
    if len(picture.bbox_px) != 4:
        raise InputError(f"bbox of {picture.where}", wanted="x, y, width, height", came=str(picture.bbox_px))
    x, y, width, height = picture.bbox_px
    border = PAPER_BORDER_PX
    if min(x, y, picture.width - x - width, picture.height - y - height) < border:
        return "hand near the border"
    return "small hand" if max(width, height) < PAPER_BOX_MIN_PX else None


def _mask(sample: Sample) -> np.ndarray:
    if sample.mask is not None:
        return read_mask(sample.mask)
    return template_mask(sample.camera, sample.joints_m, sample.handedness)


def with_papers_masks(capture: Capture) -> Capture:
    """Pictures without a mask file get the papers' rule on the projected template; without any, nothing changes."""
    samples = tuple(
        dataclasses.replace(sample, mask_source=MaskSource.TEMPLATE_LIT)
        if sample.mask_source is MaskSource.TEMPLATE
        else sample
        for sample in capture.samples
    )
    return capture.only(samples)
