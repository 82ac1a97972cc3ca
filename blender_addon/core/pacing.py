# SPDX-License-Identifier: GPL-3.0-or-later
"""When a view asks for a picture, how good a one, how long it may wait for it, and which picture it may show.

All of it is decided by functions of what a view remembers (`Pace`), what it should show (`Want`), and the moment; no
clock, no engine, no Blender. Source: BLENDER 7.1.

While something moves pictures are made fast; when it stops they get the settings of the viewport, and after a pause
those of renders. A picture from another side than the view's is never shown; one of an earlier pose is, as long as the
right one is on its way, though not for long.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum, IntEnum

from ..errors import GIVEN_UP

# while playing a view waits so long for its picture, or one frame if that is shorter: Blender's main thread is then
# never blocked for 50 ms, though a busy system wakes a sleeper up to 12 ms late (`scripts/benchmark_link.py`)
PLAY_WAIT_S = 0.033
# after so many late frames in a row nobody waits any more, until an answer was fast enough again: a hung renderer costs
# playback nothing
LATE_PATIENCE = 3
# a view that is orbited waits so long for the picture from the new side, where recent pictures came that fast: a view
# that turns 30 times a second with its hand is better than a faster one without
ORBIT_WAIT_S = 0.033
# after the last change: the settings of the viewport instead of the fast ones, and then the settings of renders
SETTLE_S, SHARPEN_S = 0.15, 0.6
# a picture of an earlier pose is shown for so long while no newer one comes, and while the engine says that it loads:
# afterwards it would be taken for the truth
STALE_S = 2.0
# pixels of one picture: while something moves (a little more than 512 x 334), while nothing moves, and the most that is
# asked for at all (full HD): larger views are drawn from a smaller picture. Making textures of it holds the main thread
# for 15 ms; of a 4K picture it was 50, and 300 the first time
MOVING_PIXELS_MAX, STILL_PIXELS_MAX, SHARP_PIXELS_MAX = 200_000, 1_000_000, 2_100_000
# requests and failures that a view remembers
ASKS_KEPT, FAILURES_KEPT = 8, 32


class Grade(IntEnum):
    MOVING = 0
    STILL = 1
    SHARP = 2


class Activity(Enum):
    """What the user does. POSING is everything that is neither playing nor scrubbing, nothing included."""

    POSING = "posing"
    SCRUBBING = "scrubbing"
    PLAYING = "playing"


@dataclass(frozen=True)
class ViewSettings:
    """What the scene says. preset: of pictures while nothing moves · sharp_preset: after a pause, None to leave it at
    that · budget_ms: choose the settings by this time instead of by presets"""

    preset: str = "viewport"
    sharp_preset: str | None = "final"
    budget_ms: float | None = None


@dataclass(frozen=True)
class Quality:
    """How one picture is made: settings of the request, and the most pixels that it may have."""

    preset: str
    budget_ms: float | None
    pixels_max: int


@dataclass(frozen=True)
class Want:
    """What a view should show. content: digest of the hands (joints, places, avatars) and of the settings · camera:
    digest of the camera and of the view's size · pixels: of the part of the view that can show the hands"""

    content: str
    camera: str
    pixels: int


@dataclass(frozen=True)
class Ask:
    want: Want
    quality: Quality
    grade: Grade
    asked_s: float

    @property
    def tag(self) -> str:
        """Names the picture; equal tags are equal pictures."""
        return _tag(self.want, self.quality)

    @property
    def droppable(self) -> bool:
        """Whether it is given up for whatever is wanted next: what only sharpens a picture, and takes long."""
        return self.grade is Grade.SHARP


@dataclass(frozen=True)
class DrawMoment:
    """now_s: on any clock that only goes forward · frame_s: how long a frame lasts · step_s: when Blender came to the
    present frame · answering: whether the engine can be expected to answer · loading: whether it says that it loads
    something first, as the avatar of another hand"""

    now_s: float
    activity: Activity = Activity.POSING
    frame_s: float = 1 / 24
    step_s: float = 0.0
    answering: bool = True
    loading: bool = False


@dataclass(frozen=True)
class Pace:
    """What one view remembers. grade: wanted at the last look · behind_s: since when the picture that is shown is of
    something else than wanted, and no other came; inf while it is right · late: frames of this or the last playback
    whose picture came too late · fast_enough: whether the last picture of something that moved came within an orbit's
    patience"""

    want: Want | None = None
    changed_s: float = 0.0
    activity: Activity = Activity.POSING
    grade: Grade = Grade.MOVING
    asks: tuple[Ask, ...] = ()
    shown: Ask | None = None
    behind_s: float = math.inf
    failures: tuple[tuple[str, str], ...] = ()
    late: int = 0
    late_in_a_row: int = 0
    late_want: Want | None = None
    fast_enough: bool = True

    def failure(self) -> str | None:
        """The kind of failure of what the view wants now; None when there is none."""
        if self.want is None:
            return None
        return next((kind for tag, kind in self.failures if tag.startswith(_content(self.want))), None)


@dataclass(frozen=True)
class Decision:
    """ask: the picture to ask for now, if any · wait_for: the tag of the picture to wait for, and how long"""

    ask: Ask | None = None
    wait_for: str | None = None
    wait_s: float = 0.0


class Turn:
    """One pass of Blender's event loop, which draws every view that needs it before it hears the user again: all of
    them together wait no longer than the first of them may."""

    def __init__(self) -> None:
        self._drawn: set[str] = set()
        self._ends_s = math.inf

    def end(self) -> None:
        """Blender did something else than drawing."""
        self._drawn.clear()
        self._ends_s = math.inf

    def draws(self, view: str) -> None:
        """A view is drawn. One that was drawn in this turn is drawn in the next one."""
        if view in self._drawn:
            self.end()
        self._drawn.add(view)

    def left_s(self, until_s: float, now_s: float) -> float:
        """How long a view that may wait until `until_s` waits now."""
        self._ends_s = min(self._ends_s, until_s)
        return max(0.0, self._ends_s - now_s)


def digest(parts: Iterable[bytes | str]) -> str:
    """A short name for what is equal."""
    whole = hashlib.blake2b(digest_size=8)
    for part in parts:
        piece = part.encode() if isinstance(part, str) else part
        whole.update(len(piece).to_bytes(8, "little") + piece)
    return whole.hexdigest()


def quality_of(grade: Grade, settings: ViewSettings) -> Quality:
    """The settings of a picture of a grade."""
    if grade is Grade.SHARP and settings.sharp_preset is not None:
        return Quality(settings.sharp_preset, None, SHARP_PIXELS_MAX)
    moving = grade is Grade.MOVING
    preset = "draft" if moving and settings.budget_ms is None else settings.preset
    pixels_max = MOVING_PIXELS_MAX if moving else STILL_PIXELS_MAX
    return Quality(preset, settings.budget_ms, pixels_max)


def step(pace: Pace, want: Want, moment: DrawMoment, settings: ViewSettings) -> tuple[Pace, Decision]:
    """What a view does when it is drawn, when its frame changed, or when `due_s` came."""
    pace = _noticed(pace, want, moment)
    grade = _grade(pace, moment, settings)
    ask = Ask(want, quality_of(grade, settings), grade, moment.now_s)
    pace = replace(_promoted(pace, ask), grade=grade)
    decision = Decision()
    if _is_new(pace, ask):
        pace = replace(pace, asks=(*pace.asks, ask)[-ASKS_KEPT:])
        decision = Decision(ask=ask)
    wait_s = _wait_s(pace, want, moment)
    if wait_s > 0 and pace.asks and pace.asks[-1].want == want:
        decision = replace(decision, wait_for=pace.asks[-1].tag, wait_s=wait_s)
    return pace, decision


def due_s(pace: Pace, settings: ViewSettings) -> float:
    """When the view should be looked at again although nothing changed: for a better picture; inf for never."""
    if pace.want is None:
        return math.inf
    if pace.grade is Grade.MOVING:
        return pace.changed_s + SETTLE_S
    if pace.grade is Grade.STILL and settings.sharp_preset is not None and _has_still(pace):
        return pace.changed_s + SHARPEN_S
    return math.inf


def answered(pace: Pace, tag: str, failure: str | None, round_trip_s: float, moment: DrawMoment) -> tuple[Pace, bool]:
    """An answer came. failure: its kind, None for a picture. Returns whether its picture is to be shown from now on."""
    ask = next((each for each in reversed(pace.asks) if each.tag == tag), None)
    if ask is None:
        return pace, False
    if failure in GIVEN_UP:
        newest = pace.asks[-1].tag == tag
        return replace(pace, asks=() if newest else tuple(each for each in pace.asks if each.tag != tag)), False
    if failure is not None:
        return replace(pace, failures=(*pace.failures, (tag, failure))[-FAILURES_KEPT:]), False
    if ask.grade is Grade.MOVING:
        pace = replace(pace, fast_enough=round_trip_s <= ORBIT_WAIT_S)
        if round_trip_s <= _play_wait_s(moment.frame_s):
            pace = replace(pace, late_in_a_row=0)
    if not _is_better(pace, ask):
        return pace, False
    return replace(pace, shown=ask, behind_s=math.inf if ask.want == pace.want else moment.now_s), True


def missed(pace: Pace, moment: DrawMoment) -> Pace:
    """The view is drawn without the picture it wants: counted once per frame while playing."""
    if moment.activity is not Activity.PLAYING or not moment.answering or pace.failure() is not None:
        return pace
    if pace.late_want != pace.want:
        return replace(pace, late=pace.late + 1, late_in_a_row=pace.late_in_a_row + 1, late_want=pace.want)
    return pace


def gave_up_waiting(pace: Pace) -> Pace:
    """The wait for a picture was in vain; an orbited view does not wait again before one came fast enough."""
    return replace(pace, fast_enough=False)


def may_show(pace: Pace, moment: DrawMoment) -> bool:
    """Whether the picture that the view has may be drawn in it now."""
    if pace.shown is None or pace.want is None or pace.shown.want.camera != pace.want.camera:
        return False
    if pace.shown.want == pace.want:
        return True
    return moment.answering and is_open(pace) and (moment.loading or moment.now_s - pace.behind_s <= STALE_S)


def is_open(pace: Pace) -> bool:
    """Whether an answer for what the view wants is awaited."""
    return bool(pace.asks) and pace.asks[-1].want == pace.want and not _is_answered(pace, pace.asks[-1])


def camera_rests(pace: Pace) -> bool:
    """Whether the last two pictures were asked for from the same side: the next will be as well."""
    return len(pace.asks) > 1 and pace.asks[-1].want.camera == pace.asks[-2].want.camera


def forgotten(pace: Pace) -> Pace:
    """Asks and failures do not count any more, as after a new start of the engine; the late counter stays."""
    return replace(
        Pace(), want=pace.want, changed_s=pace.changed_s, activity=pace.activity,
        shown=pace.shown, behind_s=pace.behind_s, late=pace.late,
    )  # fmt: skip


# ---- parts -----------------------------------------------------------------------------------------------------------


def _noticed(pace: Pace, want: Want, moment: DrawMoment) -> Pace:
    """What changed since the last look."""
    started = moment.activity is Activity.PLAYING and pace.activity is not Activity.PLAYING
    if started:
        pace = replace(pace, late=0, late_in_a_row=0, late_want=None)
    changed_s = pace.changed_s
    if pace.want is None:  # the first picture of a view need not be a fast one: nothing moves
        changed_s = moment.now_s - 2 * SETTLE_S
    elif want != pace.want or moment.activity is not Activity.POSING:
        changed_s = moment.now_s
    behind_s = math.inf
    if pace.shown is not None and pace.shown.want != want:
        behind_s = min(pace.behind_s, moment.now_s)
    # what failed because no renderer answers is asked for again when it is wanted again, as in every round of a loop:
    # only a wish starts another renderer
    failures = pace.failures if moment.answering or want == pace.want else ()
    return replace(pace, want=want, changed_s=changed_s, activity=moment.activity, behind_s=behind_s, failures=failures)


def _grade(pace: Pace, moment: DrawMoment, settings: ViewSettings) -> Grade:
    # the same sums as in `due_s`, so that what is due is done
    if moment.activity is not Activity.POSING or moment.now_s < pace.changed_s + SETTLE_S:
        return Grade.MOVING
    if settings.sharp_preset is None or moment.now_s < pace.changed_s + SHARPEN_S:
        return Grade.STILL
    return Grade.SHARP if _has_still(pace) else Grade.STILL


def _has_still(pace: Pace) -> bool:
    """Whether the picture with the viewport's settings is there, or will not come."""
    known = pace.asks if pace.shown is None else (*pace.asks, pace.shown)
    return any(ask.want == pace.want and ask.grade >= Grade.STILL and _is_answered(pace, ask) for ask in known)


def _promoted(pace: Pace, ask: Ask) -> Pace:
    """Where two grades mean the same picture, it counts as the better one."""

    def better(each: Ask) -> Ask:
        return replace(each, grade=max(each.grade, ask.grade)) if each.tag == ask.tag else each

    shown = better(pace.shown) if pace.shown is not None else None
    return replace(pace, asks=tuple(map(better, pace.asks)), shown=shown)


def _is_new(pace: Pace, ask: Ask) -> bool:
    """Whether the picture is neither there nor on its way, did not fail, and is no worse one than those that are."""
    if any(tag == ask.tag for tag, _ in pace.failures):
        return False
    failed = {tag for tag, _ in pace.failures}
    have = [pace.shown] if pace.shown is not None else []
    have += [each for each in pace.asks[-1:] if each.tag not in failed]
    return not any(each.want == ask.want and each.grade >= ask.grade for each in have)


def _is_better(pace: Pace, ask: Ask) -> bool:
    if pace.want is None or ask.want.camera != pace.want.camera:
        return False
    shown = pace.shown
    if shown is None or shown.want.camera != pace.want.camera:
        return True
    if ask.want == pace.want:
        return shown.want != pace.want or ask.grade >= shown.grade
    return shown.want != pace.want and ask.asked_s >= shown.asked_s


def _is_answered(pace: Pace, ask: Ask) -> bool:
    shown = pace.shown is not None and pace.shown.want == ask.want and pace.shown.grade >= ask.grade
    return shown or any(tag == ask.tag for tag, _ in pace.failures)


def _wait_s(pace: Pace, want: Want, moment: DrawMoment) -> float:
    shown = pace.shown
    if not moment.answering or (shown is not None and shown.want == want) or pace.failure() is not None:
        return 0.0
    if moment.activity is Activity.PLAYING:
        if pace.late_in_a_row >= LATE_PATIENCE or pace.late_want == want:
            return 0.0
        return max(0.0, _play_wait_s(moment.frame_s) - max(0.0, moment.now_s - moment.step_s))
    if moment.activity is Activity.SCRUBBING or shown is None or shown.want.camera == want.camera:
        return 0.0
    return ORBIT_WAIT_S if pace.fast_enough else 0.0


def _play_wait_s(frame_s: float) -> float:
    return min(PLAY_WAIT_S, frame_s)


def _content(want: Want) -> str:
    return f"{want.content}.{want.camera}."


def _tag(want: Want, quality: Quality) -> str:
    pixels = min(want.pixels, quality.pixels_max)
    budget = "" if quality.budget_ms is None else f"{quality.budget_ms:g}ms"
    return f"{_content(want)}{pixels}.{quality.preset}{budget}"
