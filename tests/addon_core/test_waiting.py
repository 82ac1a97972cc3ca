"""Whatever is asked, answered, given up and released in whatever order: everybody gets what is his, and nothing old."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from blender_addon.core.wire import protocol
from blender_addon.errors import JGHandFailure
from blender_addon.renderer import state as renderer_state
from blender_addon.renderer.waiting import Call, Waiting

SLOTS = st.sampled_from("ab")
TAGS = st.integers(0, 2)
HEADER = {"kind": "info"}


def reply(call: Call, **more: object) -> protocol.Message:
    return protocol.Message({"kind": "reply", "id": call.id, "ok": True, "tag": call.tag, **more})


def progress(call: Call) -> protocol.Message:
    return protocol.Message({"kind": "progress", "id": call.id, "fraction": None, "text": "Loading the avatar"})


class Histories(RuleBasedStateMachine):
    """Two slots and exact requests against what they should be, kept in the simplest way."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting = Waiting()
        self.wanted: dict[str, int] = {}  # slot -> the tag that it wants
        self.exact: list[Call] = []  # in their order, not answered and not given up
        self.refused: set[int] = set()
        self.now_s = 0.0

    @rule(slot=SLOTS, tag=TAGS, droppable=st.booleans())
    def ask(self, slot: str, tag: int, droppable: bool) -> None:
        flying = self.waiting.flying
        given_up = flying is not None and flying.given_up_s is not None
        needs = self.waiting.ask(slot, HEADER, None, tag, self.now_s, droppable=droppable)
        if flying is not None and not given_up:
            gives_way = flying.droppable and flying.slot == slot and flying.tag != tag
            assert (flying.given_up_s is not None) == gives_way
            assert (flying.id in self.waiting.cancels) == gives_way
        if tag in self.refused and not self.waiting.expects(slot, tag):
            assert not needs
            assert self.waiting.answer(slot).failure is not None
            self.wanted.pop(slot, None)
        else:
            self.wanted[slot] = tag
            assert self.waiting.expects(slot, tag)

    @rule()
    def append(self) -> None:
        flying = self.waiting.flying
        self.exact.append(self.waiting.append(HEADER, None, self.now_s))
        if flying is not None and flying.droppable:
            assert flying.given_up_s is not None

    @rule()
    def send(self) -> None:
        before = self.waiting.flying
        call = self.waiting.next(self.now_s)
        if before is not None:
            assert call is None
        elif self.exact:
            assert call is self.exact[0]
        elif call is not None:
            assert call.tag == self.wanted[call.slot]
        else:
            assert not self.wanted

    @precondition(lambda self: self.waiting.flying is not None)
    @rule(kind=st.sampled_from(["", "", "bad_input", "canceled"]))
    def answer(self, kind: str) -> None:
        call = self.waiting.flying
        before = self.waiting.answer(call.slot) if call.slot is not None else None
        more = {"ok": False, "error": {"kind": kind}} if kind else {}
        self.waiting.take(reply(call, **more), self.now_s)
        assert self.waiting.flying is None
        if call.slot is None:
            assert call.answer is not None
            assert (call.answer.message is None) == bool(kind)
            self.exact = [each for each in self.exact if each is not call]
            return
        if kind == "bad_input":
            self.refused.add(call.tag)
        if call.given_up_s is not None and not call.droppable:
            assert self.waiting.answer(call.slot) is before
        elif not self.waiting.expects(call.slot, call.tag) and self.wanted.get(call.slot) == call.tag:
            assert self.waiting.answer(call.slot).tag == call.tag
            del self.wanted[call.slot]

    @precondition(lambda self: self.waiting.flying is not None)
    @rule(number=st.integers(-5, -1))
    def answer_to_something_else(self, number: int) -> None:
        before = self.waiting.flying
        self.waiting.take(protocol.Message({"kind": "reply", "id": number, "ok": True}), self.now_s)
        assert self.waiting.flying is before

    @precondition(lambda self: self.exact)
    @rule(data=st.data())
    def give_up(self, data: st.DataObject) -> None:
        call = data.draw(st.sampled_from(self.exact))
        self.waiting.give_up(call, self.now_s)
        self.exact.remove(call)
        assert (call.id in self.waiting.cancels) == (call is self.waiting.flying)

    @rule(slot=SLOTS)
    def drop(self, slot: str) -> None:
        self.waiting.drop(slot, self.now_s)
        self.wanted.pop(slot, None)
        assert self.waiting.answer(slot) is None

    @rule(kind=st.sampled_from(["crashed", "killed", "stopped"]))
    def release(self, kind: str) -> None:
        flying = self.waiting.flying
        self.waiting.release(JGHandFailure(kind))
        if flying is not None and flying.slot is not None and kind == "crashed":
            self.refused.add(flying.tag)
        for call in self.exact:
            assert call.answer.failure.kind == kind
        for slot, tag in self.wanted.items():
            assert self.waiting.answer(slot).tag == tag
        self.exact, self.wanted = [], {}
        assert self.waiting.next(self.now_s) is None
        assert not self.waiting.cancels

    @rule()
    def forget(self) -> None:
        self.waiting.forget_refused()
        self.refused.clear()

    @invariant()
    def nobody_is_forgotten(self) -> None:
        for slot, tag in self.wanted.items():
            assert self.waiting.expects(slot, tag)


TestHistories = Histories.TestCase
TestHistories.settings = settings(max_examples=150, stateful_step_count=40, deadline=None)


def test_slots_take_turns():
    waiting = Waiting()
    sent = []
    for turn in range(6):
        for slot in "abc":
            waiting.ask(slot, HEADER, None, (slot, turn), 0.0)
        call = waiting.next(0.0)
        sent.append(call.slot)
        waiting.take(reply(call), 0.0)
    assert sent == list("abcabc")


def test_what_takes_too_long_is_known():
    waiting = Waiting()
    waiting.ask("a", HEADER, None, 0, 0.0)
    assert not waiting.is_overdue(1e6)
    call = waiting.next(0.0)
    assert not waiting.is_overdue(renderer_state.LOAD_S)
    assert waiting.is_overdue(renderer_state.LOAD_S + 1)
    waiting.give_up(call, 1.0)
    assert not waiting.is_overdue(renderer_state.SILENCE_S)
    assert waiting.is_overdue(renderer_state.SILENCE_S + 2)
    waiting.take(progress(call), 20.0)
    assert not waiting.is_overdue(renderer_state.SILENCE_S + 2)
    waiting.take(progress(call), 2 * renderer_state.LOAD_S)
    assert waiting.is_overdue(renderer_state.LOAD_S + renderer_state.SILENCE_S + 2)


def test_what_is_wanted_again_while_the_engine_is_at_it_is_not_followed_by_what_was_wanted_between():
    waiting = Waiting()
    waiting.ask("a", HEADER, None, 1, 0.0)
    call = waiting.next(0.0)
    waiting.ask("a", HEADER, None, 2, 0.0)
    assert not waiting.ask("a", HEADER, None, 1, 0.0)
    waiting.take(reply(call), 0.0)
    assert waiting.answer("a").tag == 1
    assert waiting.next(0.0) is None


def test_a_slow_picture_gives_way_to_the_next_pose_and_is_not_heard_of_again():
    waiting = Waiting()
    waiting.ask("a", HEADER, None, "sharp", 0.0, droppable=True)
    sharp = waiting.next(0.0)
    assert not waiting.ask("a", HEADER, None, "sharp", 0.0, droppable=True)
    assert not waiting.cancels
    waiting.ask("b", HEADER, None, "another view", 0.0)
    assert not waiting.cancels
    waiting.ask("a", HEADER, None, "next pose", 1.0)
    assert (list(waiting.cancels), waiting.next(1.0)) == ([sharp.id], None)
    waiting.take(reply(sharp, ok=False, error={"kind": "canceled"}), 1.0)
    assert waiting.answer("a") is None
    assert {waiting.next(1.0).tag} <= {"another view", "next pose"}


def test_a_slow_picture_gives_way_to_a_render_and_its_view_hears_of_it():
    waiting = Waiting()
    waiting.ask("a", HEADER, None, "sharp", 0.0, droppable=True)
    sharp = waiting.next(0.0)
    render = waiting.append(HEADER, None, 1.0)
    assert list(waiting.cancels) == [sharp.id]
    waiting.take(reply(sharp, ok=False, error={"kind": "canceled"}), 1.0)
    assert waiting.answer("a").failure.kind == "canceled"
    assert waiting.next(1.0) is render
    assert waiting.ask("a", HEADER, None, "sharp", 1.0, droppable=True)


def test_a_fast_picture_never_gives_way():
    waiting = Waiting()
    waiting.ask("a", HEADER, None, 1, 0.0)
    waiting.next(0.0)
    waiting.ask("a", HEADER, None, 2, 0.0)
    waiting.append(HEADER, None, 0.0)
    assert not waiting.cancels
