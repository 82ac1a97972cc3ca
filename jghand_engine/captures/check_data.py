"""What is wrong with a data set, in words that say what to do: for people who have just unpacked tens of gigabytes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.captures import Capture, CaptureChoice
from jghand_engine.captures.known_light import load_groups
from jghand_engine.captures.projection import CHECK_ON_MASK_MIN, Seen, likely_mistake, look_at
from jghand_engine.captures.splits import split_capture
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import bone_lengths, hand_length
from jghand_engine.motion.choose import CURL_MIN, curl_towards_palm
from jghand_engine.template.mesh import HandTemplate

# check-data looks at so many images of a larger set, and names so many examples of what is wrong
CHECK_IMAGES = 400
CHECK_EXAMPLES = 8
# images on which it tries out which mistake would explain joints beside the hand
CHECK_MISTAKE_IMAGES = 24
# part of the joints on the mask below which an image is named, and, as the median over all, the set refused; masks
# that leave out what an object hides have less than 1
CHECK_ON_MASK_IMAGE_MIN = 0.7
# a mask with fewer pixels is empty, one that covers more of an image of a whole hand is most likely inverted or of
# something else
CHECK_MASK_MIN_PX = 50
CHECK_MASK_MAX = 0.9
# variation of a bone's length, standard deviation over mean, above which joints are told to be noisy (triangulated
# ones of real sets vary by a few per cent)
CHECK_BONE_WOBBLE = 0.08


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong. is_error: nothing can be learned like this; else: look at it."""

    is_error: bool
    text: str

    def __str__(self) -> str:
        return f"{'ERROR' if self.is_error else 'warning'}: {self.text}"


@dataclass(frozen=True)
class DataReport:
    """capture: what could be read, or None · findings: errors first · seen: the images that were looked at"""

    capture: Capture | None
    findings: tuple[Finding, ...]
    seen: tuple[Seen, ...]

    @property
    def is_usable(self) -> bool:
        """Whether there is something to learn from and no error."""
        return self.capture is not None and not any(finding.is_error for finding in self.findings)

    def worst_and_typical(self, count: int) -> tuple[Seen, ...]:
        """Up to `count` images to show: a third those whose joints fit worst, the others spread over the set."""
        ordered = sorted(self.seen, key=lambda one: one.on_mask)
        worst = ordered[: count // 3]
        shown = {one.sample for one in worst}
        others = [one for one in self.seen if one.sample not in shown]
        return (*worst, *_spread(others, count - len(worst)))


def check_data(
    folder: Path | str,
    *,
    protocol: str | None = None,
    choice: CaptureChoice | None = None,
    most: int = CHECK_IMAGES,
    template: HandTemplate | None = None,
    tick: Callable[[int, int], None] | None = None,
) -> DataReport:
    """Opens a data set as training would, looks at up to `most` of its images, and says what is wrong.

    Never raises for a bad data set: that is its result. protocol, choice, template: as in `open_capture` · tick: is
    called with the number of images looked at and to be looked at.
    """
    troubles: list[InputError] = []
    try:
        capture = open_capture(folder, protocol=protocol, choice=choice, report=troubles.append, template=template)
    except InputError as error:
        return DataReport(None, tuple(_errors([*troubles, error])), ())
    seen: list[Seen] = []
    chosen = _spread(capture.samples, most)
    for number, sample in enumerate(chosen):
        try:
            seen.append(look_at(sample))
            if sample.light is not None:
                load_groups(sample)
        except InputError as error:
            troubles.append(error)
        if tick is not None:
            tick(number + 1, len(chosen))
    findings = [*_errors(troubles), *_on_images(seen), *_on_joints(capture), *_on_split(capture)]
    return DataReport(capture, tuple(sorted(findings, key=lambda finding: not finding.is_error)), tuple(seen))


def facts(report: DataReport) -> dict[str, Any]:
    """What the set is, by name, for a table or a JSON file. Empty when it could not be read."""
    capture = report.capture
    if capture is None:
        return {}
    sizes = Counter((sample.camera.width, sample.camera.height) for sample in capture.samples)
    masks = Counter(sample.mask_source.value for sample in capture.samples)
    named: dict[str, Any] = {
        "layout": capture.layout.value,
        "name": capture.name,
        "folder": str(capture.folder),
        "hand": capture.handedness.value,
        "pictures": len(capture),
        "poses": len(capture.poses),
        "cameras": len(capture.cameras),
        "sequences": ", ".join(capture.sequences),
        "sizes": ", ".join(f"{w} x {h} ({count})" for (w, h), count in sizes.items()),
        "masks": ", ".join(f"{source} ({count})" for source, count in masks.items()),
        "left out": ", ".join(f"{why} ({count})" for why, count in capture.dropped) or "none",
        "hand length mm": round(1e3 * hand_length(capture.joints_m()), 1),
        "bone lengths vary by %": round(100 * _bone_wobble(capture), 2),
        "pictures looked at": len(report.seen),
    }
    known = [sample.light for sample in capture.samples if sample.light is not None]
    if known:
        lamps = Counter(lamp.kind.name.lower() for one in known for lamp in one.lamps)
        kinds = ", ".join(f"{kind} ({count})" for kind, count in sorted(lamps.items()))
        held_out = sum(one.is_held_out for one in known)
        named["known light"] = f"{len(known)} pictures, lamps: {kinds}; held out: {held_out} pictures"
    told = _telling(report.seen)
    if told:
        named["joints on the mask %"] = round(100 * float(np.mean([one.on_mask for one in told])), 2)
        for kind, is_whole in (("whole hands", True), ("close-ups", False)):
            if parts := [one.mask_part for one in told if one.is_whole is is_whole]:
                named[f"mask covers % of {kind}"] = round(100 * float(np.mean(parts)), 1)
    return named


# ---- findings -------------------------------------------------------------------------------------------------------


def _errors(troubles: Sequence[InputError]) -> list[Finding]:
    """A few examples of each kind of trouble: a thousand missing images must not hide joints in a wrong unit."""
    kinds: dict[tuple[str, str], list[InputError]] = {}
    for trouble in troubles:
        kinds.setdefault((re.sub(r"\d+", "", trouble.came), trouble.remedy), []).append(trouble)
    shown = []
    for alike in kinds.values():
        shown += [Finding(True, str(trouble)) for trouble in alike[:CHECK_EXAMPLES]]
        if len(alike) > CHECK_EXAMPLES:
            shown.append(Finding(True, f"… and {len(alike) - CHECK_EXAMPLES} more like these."))
    return shown


def _telling(seen: Sequence[Seen]) -> list[Seen]:
    """Those whose mask does not itself come from the joints."""
    return [one for one in seen if not one.sample.mask_source.is_projected]


def _on_images(seen: Sequence[Seen]) -> list[Finding]:
    if not seen:
        return []
    told = _telling(seen)
    if not told:
        return [Finding(False, "No image has a mask: joints cannot be held against images. Look at the overlay.")]
    findings = []
    empty = [one for one in told if one.mask_px < CHECK_MASK_MIN_PX]
    if empty:
        text = f"{len(empty)} of {len(told)} masks are empty, such as that of {empty[0].sample.image}."
        findings.append(Finding(2 * len(empty) > len(told), text))
    full = [one for one in told if one.mask_part > CHECK_MASK_MAX and one.is_whole]
    if full:
        text = f"{len(full)} of {len(told)} masks cover nearly the whole image, such as {full[0].sample.image}."
        findings.append(Finding(2 * len(full) > len(told), text))
    whole = [one for one in told if one not in empty]
    if not whole:
        return findings
    median = float(np.median([one.on_mask for one in whole]))
    if median < CHECK_ON_MASK_MIN:
        reason = likely_mistake([one.sample for one in _spread(whole, CHECK_MISTAKE_IMAGES)])
        reason = reason or "Check units, camera convention, joint order, and that images and cameras belong together."
        text = f"Joints do not project onto the hand: half of the images have {100 * median:.0f} % or less on the mask."
        findings.append(Finding(True, f"{text} {reason}"))
        return findings
    off = [one for one in whole if one.on_mask < CHECK_ON_MASK_IMAGE_MIN]
    if off:
        worst = min(off, key=lambda one: one.on_mask)
        text = (
            f"In {len(off)} of {len(whole)} images the joints miss the hand, most in {worst.sample.image} "
            f"({100 * worst.on_mask:.0f} % on the mask)."
        )
        findings.append(Finding(False, text))
    return findings


def _on_joints(capture: Capture) -> list[Finding]:
    findings = []
    wobble = _bone_wobble(capture)
    if wobble > CHECK_BONE_WOBBLE:
        text = f"A bone's length varies by {100 * wobble:.0f} % over the poses; a hand's bones do not."
        findings.append(Finding(False, text))
    curl = curl_towards_palm(capture.joints_m(), capture.handedness)
    if curl is not None and curl < -CURL_MIN:
        other = "left" if capture.handedness is Handedness.RIGHT else "right"
        findings.append(Finding(True, f"Fingers bend backwards in most poses: is this a {other} hand?"))
    return findings


def _on_split(capture: Capture) -> list[Finding]:
    try:
        split = split_capture(capture)
    except InputError as error:
        return [Finding(True, str(error))]
    return [] if split.test else [Finding(False, f"Nothing is held out to be judged by ({split.origin}).")]


def _bone_wobble(capture: Capture) -> float:
    """Largest standard deviation of a bone's length over the poses, as a part of its mean."""
    lengths = bone_lengths(capture.joints_m())
    return float((lengths.std(axis=0) / np.maximum(lengths.mean(axis=0), 1e-9)).max())


def _spread(items: Sequence[Any], most: int) -> list[Any]:
    """At most `most` of the items, evenly over all of them."""
    if len(items) <= most:
        return list(items)
    return [items[int(place)] for place in (np.arange(most) + 0.5) * len(items) / most]
