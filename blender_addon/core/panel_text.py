# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels say, as plain text: the renderer's state, a picture's receipt, a bone map. Does not use bpy.

A receipt is a `FrameReport.as_dict()` of the engine as it came over the wire. Tooltips have no final full stop, as
Blender's have none.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .joints import NAMES

# the engine's words for stages -> what an artist reads
STAGES = {
    "transform": "Bones",
    "plan": "Plan",
    "skin": "Skin",
    "light": "Light",
    "gloss": "Gloss",
    "raster": "Drawing",
    "detail": "Skin Texture",
    "shadow + compose": "Shadow",
    "compose": "Compose",
}
# which of several hands a note of the engine is about
_HAND = re.compile(r"hand (\d+): (.*)", re.DOTALL)
# `OutOfRange.sentence()` of the engine: index1 flexion 105°: 12° outside the 0° to 93° that was trained
_OUTSIDE = re.compile(
    r"(?P<joint>[a-z]+\d) (?P<angle>\w+) -?[\d.]+°: (?P<beyond>[\d.]+)° outside the .* that was trained"
)
# remedies that a button can do: failure -> operator and label
_MENDS = {
    "no_interpreter": ("preferences.addon_show", "Choose Python"),
    "no_python": ("preferences.addon_show", "Choose Python"),
    "no_named_python": ("preferences.addon_show", "Choose Python"),
    "no_engine": ("preferences.addon_show", "Choose Python"),
    "no_tools": ("preferences.addon_show", "Preferences"),
    "protocol": ("preferences.addon_show", "Preferences"),
}
_START = ("jghand.restart_engine", "Try Again")
# the engine's options that trainings, training sets and exports are given, and the labels of their controls
CONTROLS = {
    **{"--resume": "Resume", "--fresh": "Restart…", "--preset": "Preset", "--minutes": "Time"},
    **{"--size": "Resolution", "--samples": "Samples", "--seed": "Seed", "--cameras": "Cameras"},
    **{"--poses": "Poses", "--identity": "Hand Model", "--default-variant": "Default Variant"},
}
# an option as the engine writes one, with its command and what it is to be given: two hyphens within a word are of
# somebody's path
_OPTION = re.compile(r'(?:jghand [a-z]+ )?(?<![^\s("])(--[a-z][a-z-]*)(?: (?:NUMBER|NAME|true|left|right)\b)?')
# what else an artist cannot type
_COMMAND = re.compile(r"(?:^|[\s(])(?:--[a-z]|jghand [a-z]+ -|\S*python\S* -m )")
_SENTENCES = re.compile(r"(?<=[.!?;])\s+(?=\S)")
# what stands before the part of a sentence that says what to do
_REASON = re.compile(r"(.+): |(.+), ")
# the names of a picture's hands, in their order, which its report gets on this side
HANDS = "hands"


@dataclass(frozen=True)
class Line:
    """One line of a panel. value: a figure beside it · part: 0 to 1, its share of a whole · tip: the small print ·
    good: whether nothing is wrong with it."""

    text: str
    value: str = ""
    part: float = 0.0
    tip: str = ""
    good: bool = True


@dataclass(frozen=True)
class StatusText:
    """How the renderer is. text: one line · which: path or module, where somebody has to mend it · remedy: what an
    artist can do, "" when all is well · since: since when, where the line does not say it · detail: the small print ·
    buttons: operators and labels."""

    text: str
    good: bool
    which: str = ""
    remedy: str = ""
    since: str = ""
    detail: str = ""
    buttons: tuple[tuple[str, str], ...] = ()


def duration(seconds: float) -> str:
    """ "12 s", "3 min", "1 h 05 min", as the engine tells a training's."""
    if seconds < 59.5:
        return f"{max(seconds, 0):.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min"


def in_blenders_words(text: str, controls: Mapping[str, str] = CONTROLS) -> str:
    """The engine's sentences without options of its command line: by the label of their control, in quotes. A sentence
    that names another option, or a command, ends before it: after its reason, where it has one, else it is left out."""
    told = []
    for sentence in _SENTENCES.split(text):
        named = _OPTION.sub(lambda found: f'"{controls[found[1]]}"' if found[1] in controls else found[0], sentence)
        if command := _COMMAND.search(named):
            reason = _REASON.match(named, 0, command.start() + 1)
            named = f"{reason[1] or reason[2]}." if reason else ""
        told.append(named)
    return re.sub(";$", ".", " ".join(filter(None, told))).replace('"Hand" or "Hand"', '"Hand"')


def milliseconds(value: float) -> str:
    """ "7.3 ms", "31 ms"."""
    return f"{value:.1f} ms" if value < 9.95 else f"{value:.0f} ms"


def wrapped(text: str, width: float, width_of: Callable[[str], float] = len) -> list[str]:
    """The lines of a paragraph. width: of the widest line, in what `width_of` measures (letters, or pixels of a font);
    a word that is wider has a line of its own."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and width_of(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def status_text(status: Any, report: Mapping[str, Any] | None = None) -> StatusText:
    """The state of the renderer's link (`renderer.link.Status`). report: of the last picture, None before one."""
    since, state = duration(status.since_s), status.state
    if state == "failed":
        return _failed(status.failure, since)
    if state == "stopped":
        return StatusText("Renderer off: starts when needed", True)
    if state in ("starting", "stopping"):
        return StatusText(f"{state.capitalize()}…  {since}", True)
    if state == "slow":
        remedy = 'It may be at work: wait, or press "Restart Renderer"'
        buttons = (("jghand.restart_engine", "Restart Renderer"),)
        text, running = "The renderer is not answering", f"Running for {since}"
        return StatusText(text, False, remedy=remedy, since=running, buttons=buttons)
    facts = status.handshake or {}
    if status.doing:
        parts = [f"{status.doing}…"]
    elif status.busy and report is None:  # it warms up
        parts = ["First frame…"]
    else:
        parts = ["Ready"]
        if report is not None:  # beside the kernels it names the graphics card, if one drew
            parts += ["GPU" if ", " in report["backend"] else "CPU", milliseconds(report["total_ms"])]
    version, pid = facts.get("engine_version", "?"), facts.get("pid", "?")
    detail = f"Running for {since}, version {version}, process {pid}"
    return StatusText(" · ".join(parts), True, detail=detail)


def receipt_lines(report: Mapping[str, Any], budget_ms: float | None = None) -> list[Line]:
    """The whole of a receipt and its stages. budget_ms: what a picture was allowed to take, None without a budget."""
    total_ms, drawn, posed = report["total_ms"], report["visible_gaussians"], report["gaussians"]
    tip = f"{drawn:,} of {posed:,} splats, drawn by {report['backend']} on {report['threads']} threads"
    part, good = 1.0, True
    if budget_ms is not None:
        tip = f"{tip}; the budget is {milliseconds(budget_ms)}"
        part, good = min(total_ms / max(budget_ms, 1e-3), 1.0), total_ms <= budget_ms
    lines = [Line("Last Frame" if good else "Over Budget", milliseconds(total_ms), part, tip, good)]
    for stage in report["stages"]:
        name: str = stage["name"]
        spent_ms = stage["milliseconds"]
        part = min(spent_ms / total_ms, 1.0) if total_ms > 0 else 0.0
        lines.append(Line(STAGES.get(name, name.capitalize()), milliseconds(spent_ms), part, stage["reason"]))
    return lines


def shortened(name: str, names: Sequence[str]) -> str:
    """A bone's name without what all of them begin with: the end of a name tells bones apart, and lists are narrow."""
    first, last = min(filter(None, names), default=""), max(names, default="")
    prefix = first[: next((at for at, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), len(first))]
    rest = name[len(prefix) :] if name.startswith(prefix) else name
    return f"…{rest}" if rest and len(prefix) > 1 and rest != name else name


def map_lines(sources: Sequence[Any], known: Sequence[str]) -> list[Line]:
    """What a bone map misses. sources: 21 of `bone_maps.JointSource` or None; known: the bones that there are."""
    bones = set(known)
    empty = [name for name, source in zip(NAMES, sources, strict=True) if source is None]
    gone = [
        f"{name} ({source.bone})"
        for name, source in zip(NAMES, sources, strict=True)
        if source is not None and source.bone not in bones
    ]
    lines = []
    if empty:
        lines.append(Line(f"{len(empty)} of 21 joints have no bone: {listed(empty)}", good=False))
    if gone:
        lines.append(Line(f"Bones that are gone: {listed(gone)}", good=False))
    twice = _used_twice(sources)
    if twice:
        lines.append(Line(f"Several joints on one place: {listed(twice)}", good=False))
    return lines or [Line("All 21 joints have a bone")]


def _failed(failure: Any, since: str) -> StatusText:
    log = ("jghand.show_log", "Show Log")
    if failure is None:
        return StatusText("The renderer stopped", False, buttons=(_START, log))
    mend = _MENDS.get(failure.kind, _START)
    which = failure.detail.partition("\n")[0] if failure.kind in _MENDS else ""
    advice = failure.advice
    return StatusText(advice.sentence, False, which, advice.remedy, f"{since} ago", failure.detail, (mend, log))


def warnings(report: Mapping[str, Any]) -> tuple[Line, ...]:
    """What an artist should look at in the last picture, the joint out of its trained range first; by the names of the
    hands where there are several (`HANDS` of the report)."""
    outside, others = [], []
    for note in report.get("notes", ()):
        of, note = _hand_of(note, report.get(HANDS, ()))
        match = _OUTSIDE.fullmatch(note)
        if match is None:
            others.append(Line(f"{of}{note.rstrip('.')}", tip=note.rstrip("."), good=False))
            continue
        text = f"{of}{match['joint']}: {match['angle']} {round(float(match['beyond']))}° outside trained range"
        tip = f"{note}. Such a pose was in no image that the avatar learned from, so its skin is a guess"
        outside.append(Line(text, tip=tip, good=False))
    invalid = report.get("invalid_gaussians", 0)
    if invalid:
        text = f"{invalid} splats could not be drawn"
        others.append(Line(text, tip="Their numbers are not finite: the avatar may be damaged", good=False))
    return (*outside, *others)


def _hand_of(note: str, names: Sequence[str]) -> tuple[str, str]:
    """The name of the hand that a note is about, with a colon, and the note itself; "" where there is but one hand."""
    match = _HAND.fullmatch(note)
    number = int(match[1]) if match is not None else 0
    if match is None or not 1 <= number <= len(names):
        return "", note
    return f"{names[number - 1]}: ", match[2]


def folded(lines: Sequence[Line], most: int) -> tuple[Line, ...]:
    """The first lines, and one for all others, whose tip has their texts."""
    if len(lines) <= most + 1:
        return tuple(lines)
    others = lines[most:]
    tip = "\n".join(line.text for line in others)
    return (*lines[:most], Line(f"{len(others)} more warnings", tip=tip, good=False))


def listed(names: Sequence[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (", …" if len(names) > most else "")


def _used_twice(sources: Sequence[Any]) -> list[str]:
    seen: dict[tuple[str, str], str] = {}
    twice = []
    for name, source in zip(NAMES, sources, strict=True):
        if source is None:
            continue
        place = (source.bone, source.end)
        if place in seen:
            twice.append(f"{seen[place]} = {name}")
        seen.setdefault(place, name)
    return twice
