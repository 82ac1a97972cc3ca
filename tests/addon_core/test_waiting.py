"""Whatever is asked, answered, given up and released in whatever order: everybody gets what is his, and nothing old."""

from blender_addon.core import protocol
from blender_addon.renderer import state as renderer_state
from blender_addon.renderer.waiting import Call, Waiting

HEADER = {"kind": "info"}


def reply(call: Call, **more: object) -> protocol.Message:
    return protocol.Message({"kind": "reply", "id": call.id, "ok": True, "tag": call.tag, **more})


def progress(call: Call) -> protocol.Message:
    return protocol.Message({"kind": "progress", "id": call.id, "fraction": None, "text": "Loading the avatar"})


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
    assert waiting.slot("a").answer.tag == 1
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
    assert waiting.slot("a").answer is None
    assert {waiting.next(1.0).tag} <= {"another view", "next pose"}


def test_a_slow_picture_gives_way_to_a_render_and_its_view_hears_of_it():
    waiting = Waiting()
    waiting.ask("a", HEADER, None, "sharp", 0.0, droppable=True)
    sharp = waiting.next(0.0)
    render = waiting.append(HEADER, None, 1.0)
    assert list(waiting.cancels) == [sharp.id]
    waiting.take(reply(sharp, ok=False, error={"kind": "canceled"}), 1.0)
    assert waiting.slot("a").answer.failure.kind == "canceled"
    assert waiting.next(1.0) is render
    assert waiting.ask("a", HEADER, None, "sharp", 1.0, droppable=True)


def test_a_fast_picture_never_gives_way():
    waiting = Waiting()
    waiting.ask("a", HEADER, None, 1, 0.0)
    waiting.next(0.0)
    waiting.ask("a", HEADER, None, 2, 0.0)
    waiting.append(HEADER, None, 0.0)
    assert not waiting.cancels
