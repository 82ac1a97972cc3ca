# SPDX-License-Identifier: GPL-3.0-or-later
"""Who waits for what of the engine: slots of which only the newest request counts, and exact requests in their order;
and what they get.

One request is with the engine at a time; the engine works on one anyway, and so nothing that is out of date is ever
sent. No thread, no clock, no socket here: the link holds its lock while it calls this. Does not use bpy.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ..core import protocol
from ..errors import GIVEN_UP, JGHandFailure
from . import state as machine
from .state import PASSING

Arrays = Mapping[str, protocol.Array]


@dataclass(frozen=True)
class Answer:
    """To the request with this tag: the engine's message, or a failure."""

    tag: Hashable
    message: protocol.Message | None
    failure: JGHandFailure | None = None
    round_trip_ms: float = 0.0


def failure_told(error: Any) -> JGHandFailure:
    """The failure that the engine reports; its own sentence is the detail."""
    if not isinstance(error, dict):
        return JGHandFailure("broken_stream", "an error without a description")
    return JGHandFailure(
        str(error.get("kind")), "\n".join(str(error[key]) for key in ("sentence", "detail") if error.get(key))
    )


@dataclass(eq=False)
class Call:
    id: int
    pieces: list[bytes | memoryview]
    # what the engine keeps of it, "" for nothing, and what tells it that
    kept: str = ""
    keeping: list[bytes | memoryview] = field(default_factory=list)
    # None for an exact one
    slot: str | None = None
    tag: Hashable = None
    # it gives way to whatever else is wanted
    droppable: bool = False
    # when the engine got it, None before
    sent_s: float | None = None
    # when the engine last said what it does before it comes to it
    told_s: float = 0.0
    # when nobody wanted the answer any more although the engine was at it
    given_up_s: float | None = None
    # of an exact one
    answer: Answer | None = None

    @property
    def begun_s(self) -> float | None:
        """Since when the engine may be at the request itself: not while it says what it loads for it, within reason."""
        if self.sent_s is None:
            return None
        return max(self.sent_s, min(self.told_s, self.sent_s + machine.LOAD_S))


@dataclass
class Slot:
    """A consumer of pictures: what it wants now, what of it the engine works on, and what it has."""

    waiting: Call | None = None
    flying: Call | None = None
    answer: Answer | None = None

    def expects(self, tag: Hashable) -> bool:
        """Whether an answer with this tag is still to come."""
        return any(call is not None and call.tag == tag for call in (self.waiting, self.flying))


class Waiting:
    def __init__(self) -> None:
        # what the engine works on, and what of it takes long, if it says so
        self.flying: Call | None = None
        self.doing = ""
        # numbers of requests that the engine is to be told to give up
        self.cancels: deque[int] = deque()
        self.exact: deque[Call] = deque()
        self._slots: OrderedDict[str, Slot] = OrderedDict()
        self._refused: OrderedDict[Hashable, JGHandFailure] = OrderedDict()
        self._next_id = 1

    # ---- wanting -----------------------------------------------------------------------------------------------------

    def ask(
        self,
        slot: str,
        header: Mapping[str, Any],
        arrays: Arrays | None,
        tag: Hashable,
        now_s: float,
        *,
        droppable: bool = False,
    ) -> bool:
        """The slot wants this now, in place of what it waits for; True when the engine is needed for it."""
        place = self._slots.setdefault(slot, Slot())
        if place.flying is not None and place.flying.droppable and place.flying.tag != tag:
            self.give_up(place.flying, now_s)
            place.flying = None
        if place.expects(tag):
            if place.waiting is not None and place.waiting.tag != tag:
                place.waiting = None  # what the engine works on is wanted again
            return False
        place.waiting = None
        failure = self._refused.get(tag)
        if failure is None:
            try:
                place.waiting = self._new_call(header, arrays, slot, tag, droppable=droppable)
                return True
            except JGHandFailure as error:
                failure = error
        place.answer = Answer(tag, None, failure)
        return False

    def append(self, header: Mapping[str, Any], arrays: Arrays | None, now_s: float) -> Call:
        """An exact request, after those that wait. JGHandFailure: bad_input."""
        call = self._new_call(header, arrays)
        self.exact.append(call)
        if self.flying is not None and self.flying.droppable:
            self.give_up(self.flying, now_s)  # its slot hears of it, and may ask again
        return call

    def give_up(self, call: Call, now_s: float) -> None:
        if call in self.exact:
            self.exact.remove(call)
        elif call is self.flying and call.given_up_s is None:
            call.given_up_s = now_s
            self.cancels.append(call.id)

    def drop(self, slot: str, now_s: float) -> None:
        place = self._slots.pop(slot, None)
        if place is not None and place.flying is not None:
            self.give_up(place.flying, now_s)

    def forget_refused(self) -> None:
        self._refused.clear()

    # ---- looking -----------------------------------------------------------------------------------------------------

    def slot(self, name: str) -> Slot:
        """To look at: what it wants and has, nothing for one that never asked."""
        return self._slots.get(name, Slot())

    def is_overdue(self, now_s: float) -> bool:
        """Whether the engine works for too long on something that it was told to give up, or on a picture."""
        call = self.flying
        if call is None or call.begun_s is None:
            return False
        if call.given_up_s is not None:
            return now_s - max(call.given_up_s, call.begun_s) > machine.SILENCE_S
        return call.slot is not None and now_s - call.begun_s > machine.LOAD_S

    # ---- the engine --------------------------------------------------------------------------------------------------

    def next(self, now_s: float) -> Call | None:
        """The request that the engine gets now: an exact one first, then that of the slot whose turn is longest ago."""
        if self.flying is not None:
            return None
        call = self.exact.popleft() if self.exact else self._next_of_slots()
        if call is not None:
            call.sent_s, self.flying = now_s, call
        return call

    def take(self, message: protocol.Message, now_s: float) -> None:
        """A message of the engine: a reply, or progress. What belongs to nothing is ignored."""
        call, header = self.flying, message.header
        if call is None or call.sent_s is None or header.get("id") != call.id:
            return
        if header.get("kind") == "progress":
            text = header.get("text")
            self.doing, call.told_s = text if isinstance(text, str) else "", now_s
        elif header.get("kind") == "reply":
            failure = None if header.get("ok") is True else failure_told(header.get("error"))
            round_trip_ms = 1e3 * (now_s - call.sent_s)
            self._arrived(call, Answer(call.tag, None if failure else message, failure, round_trip_ms))

    def release(self, failure: JGHandFailure) -> None:
        """Everybody who waits gets this failure. What the engine worked on when it failed is not asked for again,
        unless it was ended from outside."""
        flying, self.flying, self.doing = self.flying, None, ""
        if flying is not None and flying.slot is not None and failure.kind in PASSING - {"killed"}:
            self._refuse(flying.tag, failure)
        for call in (flying, *self.exact):
            if call is not None and call.slot is None:
                call.answer = Answer(call.tag, None, failure)
        self.exact.clear()
        self.cancels.clear()
        for place in self._slots.values():
            wanted = place.waiting or place.flying
            place.waiting = place.flying = None
            if wanted is not None:
                place.answer = Answer(wanted.tag, None, failure)

    # ---- parts -------------------------------------------------------------------------------------------------------

    def _new_call(
        self,
        header: Mapping[str, Any],
        arrays: Arrays | None,
        slot: str | None = None,
        tag: Hashable = None,
        *,
        droppable: bool = False,
    ) -> Call:
        identity, self._next_id = self._next_id, self._next_id + 1
        try:
            sent, kept, keeping = dict(arrays or {}), header.get("kept", ""), []
            if kept:
                keeping = protocol.encode(
                    {"kind": protocol.KEEP, "key": kept}, {protocol.WORLD: sent.pop(protocol.WORLD)}
                )
            pieces = protocol.encode({**header, "id": identity}, sent)
            return Call(identity, pieces, kept, keeping, slot, tag, droppable)
        except protocol.ProtocolError as error:
            raise JGHandFailure("bad_input", str(error)) from error

    def _next_of_slots(self) -> Call | None:
        for name, place in self._slots.items():
            if place.waiting is not None:
                place.flying, place.waiting = place.waiting, None
                self._slots.move_to_end(name)
                return place.flying
        return None

    def _arrived(self, call: Call, answer: Answer) -> None:
        self.flying, self.doing = None, ""
        if call.slot is None:
            call.answer = answer
            return
        if answer.failure is not None and answer.failure.kind not in GIVEN_UP:
            self._refuse(call.tag, answer.failure)
        place = self._slots.get(call.slot)
        if place is not None and place.flying is call:
            place.flying, place.answer = None, answer

    def _refuse(self, tag: Hashable, failure: JGHandFailure) -> None:
        self._refused[tag] = failure
        while len(self._refused) > machine.REFUSED_MAX:
            self._refused.popitem(last=False)
