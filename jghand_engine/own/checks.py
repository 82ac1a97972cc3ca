"""What is wrong with a film, in sentences for whoever films: what it is, when, and what to do."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import LEVEL_NAMES, Handedness
from jghand_engine.own.film import BURNT_U8, FilmPictures, Looked, blurred
from jghand_engine.own.fit_terms import flat_hands, guides
from jghand_engine.own.masks import FilmColors, Zones, camera_moved, hand_size_px
from jghand_engine.own.start import Start
from jghand_engine.track.hands_over_time import FoundHands, HandOverTime

# of the pictures: with the hand, at least; with another hand, at most; blurred, at most
SEEN_PART_MIN, OTHER_HAND_PART_MAX, BLURRED_PART_MAX = 0.8, 0.1, 0.3
# about the hand's length in the pictures that are kept, pixels
HAND_SIZE_MIN_PX = 250.0
# how square palm or back must be seen once
VIEW_ANGLE_DEG = 45.0
# of the skin: the part that is burnt out, and its mean, of 255
BURNT_PART_MAX, DARK_U8 = 0.02, 45.0
# more than this is too much to make an avatar of; less are highlights (5 % of a film of dark skin between two lamps)
BURNT_PART_REFUSED = 0.15
# how much the mean of the background changes, of itself
BRIGHTNESS_STEP_MAX = 0.08
# what the colors of skin and background have in common
OVERLAP_MAX = 0.25
# of the forearm behind the wrist: what has not the skin's color, median of the pictures. 0.00 in films of bare arms, a
# real one too (0.14 in its worst picture), 0.44 in one whose sleeve begins a third of the palm behind the wrist
CLOTHED_PART_MAX = 0.2
# mask against the outline of the fit, intersection over union, mean of all pictures; what a single one may differ
FIT_IOU_MIN, PICTURE_RESIDUAL_MAX = 0.85, 0.12
# of held-out pictures, within the mask: two films as they should be have 17.9 and 18.3 (docs/OWN_HAND.md). No faulty
# film that was made is below: it is for faults that have no check of their own
HELD_OUT_MIN_DB = 17.5

_WRIST, _INDEX, _PINKY = (LEVEL_NAMES.index(name) for name in ("wrist", "index1", "pinky1"))


@dataclass(frozen=True)
class Finding:
    """check: its name · sentence: for people · refuses: whether no avatar can be made of this film"""

    check: str
    sentence: str
    refuses: bool = False


def refuse(findings: list[Finding]) -> None:
    """InputError with the sentences of those that refuse; nothing where there is none."""
    sentences = [finding.sentence for finding in findings if finding.refuses]
    if sentences:
        raise InputError(" ".join(sentences))


def wanted_hand(found: FoundHands, looked: Looked, name: str, wanted: Handedness | None) -> HandOverTime:
    """The hand that the avatar is made of. InputError where there is none, and where two are seen and none is wanted.

    name: of the film
    """
    remedy = "Film it large, with its wrist, on a plain wall."
    if wanted is not None:
        if wanted not in found.hands:
            came = f"the {next(iter(found.hands))} one alone" if found.hands else "none in any picture"
            raise InputError(name, wanted=f"a {wanted} hand", came=came, remedy=remedy)
        return found.hands[wanted]
    if not found.hands:
        few = next(iter(found.doubted.values()), None)
        came = "none in any picture" if few is None else f"one in {few.seen.sum()} of {len(few.seen)} pictures"
        raise InputError(name, wanted="a hand", came=came, remedy=remedy)
    first, *others = sorted(found.hands.values(), key=lambda hand: -hand.seen.sum())
    for other in others:
        if other.seen.mean() > OTHER_HAND_PART_MAX:
            at = _seen_at(looked, other.seen)
            raise InputError(f"Two hands are seen{at}. Film one hand alone, or say --hand right or --hand left")
    return first


def seen_findings(looked: Looked, hand: HandOverTime) -> list[Finding]:
    """Of the whole film: whether the hand is seen, and sharp."""
    seen, findings = hand.seen, []
    if not looked.is_film and not seen.all():
        numbers = ", ".join(str(number + 1) for number in np.flatnonzero(~seen))
        findings.append(Finding("hand found", f"Photographs without a hand are left out: {numbers}. Take others, the "
                                "hand large, with its wrist, on a plain wall."))  # fmt: skip
    elif seen.mean() < SEEN_PART_MIN:
        at = _seen_at(looked, ~seen)
        findings.append(Finding("hand found", f"The hand is seen in {seen.sum()} of {len(seen)} pictures; it is not{at}"
                                ". Film it larger, with its wrist, on a plain wall."))  # fmt: skip
    soft = blurred(looked.sharpness) & seen
    if soft.sum() > BLURRED_PART_MAX * seen.sum():
        at, what = _seen_at(looked, soft), "film is" if looked.is_film else "photographs are"
        findings.append(Finding("blur", f"{round(100 * soft.sum() / seen.sum())} % of the {what} blurred, such as{at}: "
                                "move more slowly, or with more light."))  # fmt: skip
    return findings


def picture_findings(pictures: FilmPictures, start: Start, zones: Zones, colors: FilmColors) -> list[Finding]:
    """Of the pictures that are kept: size, camera, views, light, and what is behind the hand."""
    moved = camera_moved(pictures, zones.away)
    findings = [_size(pictures, start), _moving(pictures, moved), *_views(pictures, start), _ruler(pictures, start)]
    findings += [_burnt(pictures, zones), _dark(pictures, zones)]
    if colors.overlap > OVERLAP_MAX:
        findings.append(Finding("skin and background", "The wall has the color of the skin. Take another one."))
    findings.append(_sleeve(pictures, zones, colors))
    if pictures.is_film:
        findings.append(_brightness(pictures, zones.away & ~moved[:, None, None]))
    return [finding for finding in findings if finding is not None]


def fit_findings(pictures: FilmPictures, masks: np.ndarray, outlines: np.ndarray) -> list[Finding]:
    """Whether the fitted hand is what the masks show. masks, outlines: (F, H, W) bool, on the hand's side"""
    overlap = (masks & outlines).sum((1, 2)) / np.maximum((masks | outlines).sum((1, 2)), 1)
    if overlap.mean() >= FIT_IOU_MIN:
        return []
    at = _where(pictures, int(overlap.argmin()))
    return [Finding("mask against fit", f"The outline does not fit ({overlap.mean():.2f}), least of all{at}. "
                    "Sleeve, ring, or a second hand?", refuses=True)]  # fmt: skip


def left_out(pictures: FilmPictures, used: np.ndarray) -> list[Finding]:
    """That no skin is made of some pictures. used: (F,) bool"""
    if used.all():
        return []
    at = _where(pictures, int(np.flatnonzero(~used)[0]))
    return [Finding("pictures", f"{(~used).sum()} of {len(used)} pictures are left out, as the fitted outline is not "
                    f"theirs, such as{at}. Sleeve, ring, or a blurred hand?")]  # fmt: skip


def report_findings(report: dict[str, Any]) -> list[Finding]:
    """How good the avatar is, of what `report.write_report` returns: on pictures that it was not made of."""
    found = report["mean"].get("psnr_mask")
    if found is None or found >= HELD_OUT_MIN_DB:
        return []
    return [Finding("result", f"It did not learn well ({found:.1f} dB); sheet.png shows where.")]


# ---- one after the other ---------------------------------------------------------------------------------------------


def _size(pictures: FilmPictures, start: Start) -> Finding | None:
    size = hand_size_px(start.camera.project(start.joints_m)[0])
    typical = float(np.median(size))
    if typical >= HAND_SIZE_MIN_PX:
        return None
    at = _where(pictures, int(size.argmin()))
    return Finding("size", f"The hand is about {typical:.0f} pixels long, least{at}. Come nearer: 300 or more make the "
                   "skin sharp.")  # fmt: skip


def _moving(pictures: FilmPictures, moved: np.ndarray) -> Finding | None:
    if not moved.any():
        return None
    return Finding("camera", f"The camera moves{_where(pictures, int(moved.argmax()))}. Lean the telephone on "
                   "something; what moved is worked out from colors alone, a little worse.")  # fmt: skip


def facing(start: Start) -> np.ndarray:
    """(F,) cosine between what the palm faces and the way to the camera: 1 the palm is seen squarely, -1 the back."""
    joints = start.joints_m
    wrist = joints[:, _WRIST]
    out = np.cross(joints[:, _INDEX] - wrist, joints[:, _PINKY] - wrist)
    towards = -joints.mean(1)
    return (out * towards).sum(1) / (np.linalg.norm(out, axis=1) * np.linalg.norm(towards, axis=1))


def _views(pictures: FilmPictures, start: Start) -> list[Finding]:
    square, limit = facing(start), math.cos(math.radians(VIEW_ANGLE_DEG))
    findings = []
    for side, towards in (("palm", square), ("back", -square)):
        best = int(towards.argmax())
        if towards[best] <= limit:
            at = f" squarely, best{_where(pictures, best)}" if towards[best] > 0 else ""
            words = f"The {side} of the hand is never seen{at}: it is invented from other skins. Turn the hand over."
            findings.append(Finding("views", words))
    return findings


def _ruler(pictures: FilmPictures, start: Start) -> Finding | None:
    if guides(start.detector_directions).any():
        return None
    bent, tilted, _ = flat_hands(start.detector_directions)
    at = _where(pictures, int((bent + tilted).argmin()))
    return Finding("ruler", f"No picture shows the flat hand; the flattest one is{at}. Bone lengths are guessed; hold "
                   "it flat for two seconds, palm and back.")  # fmt: skip


def _burnt(pictures: FilmPictures, zones: Zones) -> Finding | None:
    parts = [float((rgb[bones].max(-1) >= BURNT_U8).mean()) if bones.any() else 0.0
             for rgb, bones in zip(pictures.rgb_u8, zones.bones, strict=True)]  # fmt: skip
    burnt = float(np.mean(parts))
    if burnt <= BURNT_PART_MAX:
        return None
    return Finding("light", f"The skin is burnt out, most{_where(pictures, int(np.argmax(parts)))}. Film it with less "
                   "light, and lock the exposure on the hand.", refuses=burnt > BURNT_PART_REFUSED)  # fmt: skip


def _dark(pictures: FilmPictures, zones: Zones) -> Finding | None:
    means = [float(rgb[bones].mean()) if bones.any() else 255.0
             for rgb, bones in zip(pictures.rgb_u8, zones.bones, strict=True)]  # fmt: skip
    if np.mean(means) >= DARK_U8:
        return None
    return Finding("light", f"The skin is too dark, most{_where(pictures, int(np.argmin(means)))}. Film it with more "
                   "light, from the front or the side.", refuses=True)  # fmt: skip


def _brightness(pictures: FilmPictures, away: np.ndarray) -> Finding | None:
    """Each picture against the first, where no hand is in either. away: (F, H, W) bool, nowhere after a move"""
    steps = []
    for rgb, free in zip(pictures.rgb_u8, away, strict=True):
        both = free & away[0]
        first = float(pictures.rgb_u8[0][both].mean()) if both.any() else 0.0
        steps.append(abs(float(rgb[both].mean()) / first - 1) if first > 0 else 0.0)
    if max(steps) <= BRIGHTNESS_STEP_MAX:
        return None
    return Finding("exposure", f"The brightness changes while filming, most{_where(pictures, int(np.argmax(steps)))}. "
                   "Lock exposure and focus.", refuses=True)  # fmt: skip


def _sleeve(pictures: FilmPictures, zones: Zones, colors: FilmColors) -> Finding | None:
    parts = [float(colors.unlike_skin(rgb)[arm].mean()) if arm.any() else 0.0
             for rgb, arm in zip(pictures.rgb_u8, zones.arm, strict=True)]  # fmt: skip
    if np.median(parts) <= CLOTHED_PART_MAX:
        return None
    at = _where(pictures, int(np.argmax(parts)))
    return Finding("sleeve", f"Behind the wrist no bare forearm is seen, least{at}. Push the sleeve up by a hand's "
                   "breadth, and take a watch off.")  # fmt: skip


def _where(pictures: FilmPictures, picture: int) -> str:
    """` at 0:07`, or which photograph."""
    return _at(float(pictures.time_s[picture])) if pictures.is_film else f" in photograph {pictures.index[picture] + 1}"


def _seen_at(looked: Looked, which: np.ndarray) -> str:
    """As `_where`, of the first of the pictures that were looked at. which: (F,) bool"""
    first = int(which.argmax())
    return _at(first / looked.sightings.fps) if looked.is_film else f" in photograph {first + 1}"


def _at(time_s: float) -> str:
    return f" at {int(time_s) // 60}:{int(time_s) % 60:02d}"
