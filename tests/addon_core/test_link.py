"""The link to the engine: the newest picture wins, exact requests are answered, and nothing that the engine does (or
does not) makes the calling thread wait, leaves somebody waiting, or leaves a process behind."""

import contextlib
import json
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from unittest import mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from stand_ins import PATIENCE_S, command, linked, picture
from waiting import wait_until

from blender_addon.core import protocol
from blender_addon.core.view import SceneLight
from blender_addon.errors import JGHandFailure
from blender_addon.renderer import state as renderer_state
from blender_addon.renderer.link import Answer, EngineLink


def answered(link: EngineLink, tag: object, slot: str = "viewport") -> Answer:
    answer = link.wait(slot, tag, PATIENCE_S)
    assert answer is not None
    return answer


def pid_of(link: EngineLink) -> int:
    return link.request({"kind": "info"}, timeout_s=PATIENCE_S).header["pid"]


# ---- pictures --------------------------------------------------------------------------------------------------------


def test_a_picture_starts_the_engine_and_comes():
    with linked() as link:
        assert (link.status.state, link.status.since_s, link.answer("viewport")) == ("stopped", 0.0, None)
        link.ask("viewport", *picture(), tag="a")
        assert link.status.state == "starting"
        answer = answered(link, "a")
        assert answer.failure is None
        assert answer.message.arrays["rgba_u8"].shape == (48, 64, 4)
        assert answer.round_trip_ms > 0
        assert link.answer("viewport") == answer
        assert link.status.state == "ready"
        assert link.status.handshake["pid"] > 0


def test_a_slot_that_is_dropped_gets_nothing_and_its_picture_stops():
    with linked("patient") as link:
        link.ask("viewport", *picture(), tag="a")
        wait_until(lambda: link.status.busy, "work")
        link.drop("viewport")
        link.drop("viewport")
        assert link.answer("viewport") is None
        assert pid_of(link)  # the engine is free again
        assert link.answer("viewport") is None


def test_a_picture_that_failed_is_not_asked_for_again_until_the_user_starts_anew():
    with linked("late memory") as link:
        link.ask("viewport", *picture(), tag="a")
        assert answered(link, "a").failure.kind == "out_of_memory"
        for _ in range(5):
            link.ask("viewport", *picture(), tag="a")
            assert not link.status.busy
            assert link.answer("viewport").failure.kind == "out_of_memory"
        link.start()
        link.ask("viewport", *picture(), tag="a")
        wait_until(lambda: link.status.busy, "work")


# ---- exact requests --------------------------------------------------------------------------------------------------


def test_exact_requests_of_many_threads_are_all_answered():
    replies = []

    def work(number: int) -> None:
        for turn in range(5):
            reply = link.request(*picture(), timeout_s=PATIENCE_S)
            replies.append((number, turn, reply.header["ok"]))

    with linked() as link:
        threads = [threading.Thread(target=work, args=(number,)) for number in range(6)]
        for thread in threads:
            thread.start()
        link.ask("viewport", *picture(), tag="between")
        for thread in threads:
            thread.join(PATIENCE_S)
        assert answered(link, "between").failure is None
    assert sorted(replies) == [(number, turn, True) for number in range(6) for turn in range(5)]


def test_a_request_that_is_canceled_ends_in_the_engine_too():
    with linked("patient") as link:
        asked = iter([False, False, True])
        with pytest.raises(JGHandFailure) as caught:
            link.request(*picture(), timeout_s=PATIENCE_S, canceled=lambda: next(asked))
        assert caught.value.kind == "canceled"
        assert pid_of(link)


def test_a_request_that_takes_too_long_is_given_up_and_the_next_one_is_answered():
    with linked("patient") as link:
        with pytest.raises(JGHandFailure) as caught:
            link.request(*picture(), timeout_s=0.1)
        assert caught.value.kind == "hung"
        assert pid_of(link)
        assert link.status.state == "ready"


def test_an_engine_that_does_not_stop_what_was_given_up_is_ended(monkeypatch):
    monkeypatch.setattr(renderer_state, "SILENCE_S", 2.0)
    with linked("hang") as link:
        with pytest.raises(JGHandFailure):
            link.request(*picture(), timeout_s=0.1)
        wait_until(lambda: link.status.state == "failed", "failed")
        assert link.status.failure.kind == "hung"
        assert "does not end" in link.status.failure.detail


# ---- what may happen to the engine -----------------------------------------------------------------------------------

# fault of the stand-in -> kind of the failure that a picture ends in; None: it comes
FAULTS = {
    "die_at_start": "crashed",
    "wrong_version": "protocol",
    "wrong_port": "broken_stream",
    "rubbish": "broken_stream",
    "die": "crashed",
    "killed": "killed",
    "memory": "out_of_memory",
    "bug": "internal",
    "flood": None,
    "chatty": None,
    "print": None,
    "late": None,
}


@pytest.mark.parametrize(("fault", "kind"), FAULTS.items(), ids=FAULTS.keys())
def test_whatever_the_engine_does_a_picture_comes_or_says_why_not(fault, kind):
    with linked(fault) as link:
        link.ask("viewport", *picture(), tag="a")
        failure = answered(link, "a").failure
        assert (failure.kind if failure is not None else None) == kind


def test_an_engine_that_is_killed_from_outside_is_noticed_by_everybody():
    if os.name == "nt":
        pytest.skip("killing by signal")
    caught = []

    def render() -> None:
        try:
            link.request(*picture(), timeout_s=PATIENCE_S)
        except JGHandFailure as failure:
            caught.append(failure.kind)

    with linked("hang") as link:
        pid = pid_of(link)
        link.ask("viewport", *picture(), tag="a")
        wait_until(lambda: link.status.busy, "work")
        thread = threading.Thread(target=render)
        thread.start()
        time.sleep(0.1)  # it waits, too
        os.kill(pid, signal.SIGKILL)
        answer = answered(link, "a")
        thread.join(PATIENCE_S)
        assert (answer.failure.kind, caught) == ("killed", ["killed"])
        assert link.status.state == "failed"
        assert link.status.failure.kind == "killed"


def test_a_crashed_engine_is_started_again_but_not_with_what_crashed_it(monkeypatch):
    monkeypatch.setattr(renderer_state, "RESTART_S", 0.2)
    with linked("die:2") as link:
        link.ask("viewport", *picture(), tag="good")
        assert answered(link, "good").failure is None
        link.ask("viewport", *picture(), tag="bad")
        assert answered(link, "bad").failure.kind == "crashed"
        time.sleep(0.3)
        link.ask("viewport", *picture(), tag="bad")
        assert link.status.state == "failed"
        link.ask("viewport", *picture(), tag="next")
        assert link.status.state == "starting"
        assert answered(link, "next").failure is None


def test_what_a_killed_engine_was_at_is_asked_for_again(monkeypatch):
    monkeypatch.setattr(renderer_state, "RESTART_S", 0.0)
    with linked("killed:2") as link:
        link.ask("viewport", *picture(), tag="good")
        assert answered(link, "good").failure is None
        link.ask("viewport", *picture(), tag="a")
        assert answered(link, "a").failure.kind == "killed"
        link.ask("viewport", *picture(), tag="a")
        wait_until(lambda: link.answer("viewport").failure is None, "a picture")


def test_after_a_few_crashes_only_the_user_starts_it_again(monkeypatch):
    monkeypatch.setattr(renderer_state, "RESTART_S", 0.0)
    with linked("die") as link:
        for tag in range(renderer_state.RESTARTS_MAX + 1):
            link.ask("viewport", *picture(), tag=tag)
            assert answered(link, tag).failure.kind == "crashed"
        link.ask("viewport", *picture(), tag="one more")
        assert link.answer("viewport").failure.kind == "crashed"
        assert link.status.state == "failed"
        link.start()
        wait_until(lambda: link.status.state == "ready", "ready")


def test_no_engine_is_a_failure_and_a_button_looks_anew(tmp_path):
    found: list[list[str]] = []

    def look() -> list[str]:
        if not found:
            raise JGHandFailure("no_interpreter", "nowhere")
        return found[0]

    link = EngineLink(look)
    try:
        link.ask("viewport", *picture(), tag="a")
        assert answered(link, "a").failure.kind == "no_interpreter"
        with pytest.raises(JGHandFailure) as caught:
            link.request({"kind": "info"})
        assert caught.value.kind == "no_interpreter"
        found.append([str(tmp_path / "nothing")])
        link.start()
        wait_until(lambda: link.status.state == "failed", "failed")
        assert link.status.failure.kind == "no_interpreter"
        found[0] = command()
        link.start()
        wait_until(lambda: link.status.state == "ready", "ready")
    finally:
        link.close()


@contextlib.contextmanager
def ready(*faults: str) -> Iterator[EngineLink]:
    """A link whose engine is ready; JGHandFailure when it does not become so."""
    with linked(*faults) as link:
        link.start()
        link.wait_until_ready()
        yield link


def failure_of_start(*faults: str) -> JGHandFailure:
    """What a start fails with."""
    with pytest.raises(JGHandFailure) as caught, ready(*faults):
        pass
    return caught.value


def failure_of(*faults: str, **options) -> JGHandFailure:
    """What a picture fails with."""
    with pytest.raises(JGHandFailure) as caught, ready(*faults) as engine:
        engine.request(*picture(), **options)
    return caught.value


def failure_of_command(*command: str) -> JGHandFailure:
    """What a start with this command fails with."""
    link = EngineLink(lambda: command)
    link.start()
    with pytest.raises(JGHandFailure) as caught:
        link.wait_until_ready()
    link.close()
    return caught.value


def test_a_request_that_cannot_be_sent_is_a_failure_and_the_engine_lives_on():
    with ready() as engine:
        for header in ({"kind": "info", "fx": float("nan")}, {"kind": "info", "text": "x" * 100_000}):
            with pytest.raises(JGHandFailure) as caught:
                engine.request(header)
            assert caught.value.kind == "bad_input"
        assert engine.request({"kind": "info"}).header["ok"]


def test_an_engine_that_hangs_is_ended_in_time_and_its_last_words_are_told():
    started = time.monotonic()
    failure = failure_of("hang", timeout_s=2.0)
    assert time.monotonic() - started < 20
    assert failure.kind == "hung"
    assert "in time" in failure.detail
    assert "the last words" in failure.detail
    assert "the last words" in failure.log


@pytest.mark.skipif(os.name == "nt", reason="Windows cannot stop a process for a while")
def test_an_engine_whose_heart_stops_is_ended_before_the_time_of_the_request_is_over(monkeypatch):
    monkeypatch.setattr(renderer_state, "SILENCE_S", 2.5)
    started = time.monotonic()
    failure = failure_of("frozen", timeout_s=300.0)
    assert time.monotonic() - started < 30
    assert failure.kind == "hung"
    assert "no sign of life" in failure.detail
    assert "the last words" in failure.detail


@pytest.mark.parametrize("fault", ["silent", "garbage"])
def test_an_engine_without_a_handshake_is_given_up(fault, monkeypatch):
    monkeypatch.setattr(renderer_state, "HANDSHAKE_S", 1.0)
    assert failure_of_start(fault).kind == "start_timeout"


def test_a_python_without_the_engine_is_told_so():
    failure = failure_of_command(sys.executable, "-I", "-S", "-m", "jghand_engine", "serve")
    assert failure.kind == "no_engine"


@pytest.mark.parametrize("name", ["tyro_of_another_name", "jghand_engine_of_another_name", "jghand_engine.nothing"])
def test_a_python_that_lacks_something_that_the_engine_needs_is_told_so_by_name(name, tmp_path):
    (tmp_path / "jghand_engine").mkdir()
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import {name}  # jghand_engine"
    failure = failure_of_command(sys.executable, "-I", "-S", "-c", code)
    assert failure.kind == "no_engine"
    assert name in failure.detail


# ---- start and stop --------------------------------------------------------------------------------------------------


def test_a_restart_is_another_process_and_waiting_pictures_are_told():
    with linked() as link:
        first = pid_of(link)
        link.restart()
        assert pid_of(link) != first
        assert link.status.state == "ready"


def test_a_link_is_closed_long_before_an_engine_that_will_not_end_would_be_asked_again():
    with linked("stubborn") as link:
        link.start()
        link.wait_until_ready()
        process = link._engine
        begun_s = time.monotonic()
        link.close()
        # the thread came to it, and was not given up
        assert time.monotonic() - begun_s < renderer_state.CLOSE_S + 2 * renderer_state.KILL_S
        assert process.popen.poll() is not None


def test_a_closed_link_starts_nothing():
    link = EngineLink(command)
    link.start()
    link.close()
    link.close()
    link.start()
    link.ask("viewport", *picture(), tag="a")
    assert link.answer("viewport").failure.kind == "stopped"
    with pytest.raises(JGHandFailure) as caught:
        link.request({"kind": "info"})
    assert caught.value.kind == "stopped"
    assert link._engine is None


# ---- engines that say anything ---------------------------------------------------------------------------------------


class AnyEngine:
    """A process with a good handshake, whose socket is in the hands of the test."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        line = {"protocol": protocol.PROTOCOL_VERSION, "port": self._listener.getsockname()[1], "pid": 0}
        code = f"import sys; print({json.dumps(json.dumps(line))}, flush=True); sys.stdin.read()"
        self.link = EngineLink(lambda: [sys.executable, "-I", "-S", "-c", code])
        self.link.start()
        self._listener.settimeout(PATIENCE_S)
        self.connection, _ = self._listener.accept()
        self.connection.settimeout(PATIENCE_S)

    def close(self) -> None:
        self.connection.close()
        self._listener.close()
        self.link.close()

    def __enter__(self) -> "AnyEngine":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


NUMBERS = st.integers(-(2**40), 2**40) | st.floats(allow_nan=False, allow_infinity=False)
VALUES = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)
HEADERS = st.fixed_dictionaries(
    {},
    optional={
        "kind": st.sampled_from(["welcome", "refused", "reply", "progress", "heartbeat", "x"]) | VALUES,
        "id": st.integers(0, 3) | VALUES,
        "ok": VALUES,
        "error": st.fixed_dictionaries({}, optional={"kind": VALUES, "sentence": VALUES, "detail": VALUES}) | VALUES,
        "fraction": VALUES,
        "text": VALUES,
        "eta_s": VALUES,
    },
)


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(HEADERS, max_size=6), st.binary(max_size=60), st.booleans())
def test_whatever_comes_over_the_wire_nobody_waits_for_ever(headers, rubbish, welcomed):
    # its process lives on: whether it is about to end need not be found out here
    with mock.patch.object(renderer_state, "TERMINATE_S", 0.02), AnyEngine() as engine:
        if welcomed:
            protocol.send(engine.connection, {"kind": "welcome"})
        engine.link.ask("viewport", *picture(), tag="a")
        with contextlib.suppress(OSError, protocol.Disconnected):
            for header in headers:
                protocol.send(engine.connection, header)
            engine.connection.sendall(rubbish)
            engine.connection.shutdown(socket.SHUT_WR)
        answer = engine.link.wait("viewport", "a", PATIENCE_S)
        assert answer is not None
        assert (answer.message is None) != (answer.failure is None)
        assert engine.link._thread.is_alive()


def test_of_all_that_was_asked_meanwhile_only_the_newest_is_sent():
    with AnyEngine() as engine:
        protocol.send(engine.connection, {"kind": "welcome"})
        assert protocol.receive_greeting(engine.connection, engine.link._engine.token, deadline=time.monotonic() + 9)
        for tag in range(1, 50):
            engine.link.ask("viewport", *picture(), tag=tag)
            if tag == 1:
                wait_until(lambda: engine.link.status.busy, "work")
        for tag in (1, 49):
            asked = protocol.receive(engine.connection)
            assert asked.header["id"] == tag
            protocol.send(engine.connection, {"kind": "reply", "id": tag, "ok": True})
            assert answered(engine.link, tag).failure is None
        wait_until(lambda: not engine.link.status.busy, "rest")


def test_a_world_is_sent_before_the_first_request_in_it_and_again_after_another_one():
    sent = []
    with AnyEngine() as engine:
        protocol.send(engine.connection, {"kind": "welcome"})
        assert protocol.receive_greeting(engine.connection, engine.link._engine.token, deadline=time.monotonic() + 9)
        for number, key in enumerate(["sky", "sky", "", "sky", "noon", "sky"], 1):
            sky = np.full((2, 4, 3), len(key), np.float32)
            engine.link.ask("viewport", *picture(light=SceneLight((), {"key": key}, sky) if key else None), tag=number)
            while True:
                came = protocol.receive(engine.connection)
                sent.append((came.header.get("key"), came.header.get("kept")))
                if came.header["kind"] == protocol.KEEP:
                    np.testing.assert_array_equal(np.asarray(came.arrays["world"].view()), sky)
                    continue
                assert "world" not in came.arrays
                assert came.header["id"] == number
                break
            protocol.send(engine.connection, {"kind": "reply", "id": number, "ok": True})
            answered(engine.link, number)
    sky, noon = [("sky", None), (None, "sky")], [("noon", None), (None, "noon")]
    assert sent == [*sky, sky[1], (None, None), sky[1], *noon, *sky]


def test_a_reply_that_comes_in_pieces_is_one_reply():
    with AnyEngine() as engine:
        protocol.send(engine.connection, {"kind": "welcome"})
        engine.link.ask("viewport", *picture(), tag="a")
        values = np.arange(3000, dtype="<f4")
        content = b"".join(protocol.encode({"kind": "reply", "id": 1, "ok": True}, {"x": protocol.Array.of(values)}))
        wait_until(lambda: engine.link.status.busy, "work")
        for start in range(0, len(content), 997):
            engine.connection.sendall(content[start : start + 997])
            time.sleep(0.001)
        answer = answered(engine.link, "a")
        np.testing.assert_array_equal(np.asarray(answer.message.arrays["x"].view()), values)
