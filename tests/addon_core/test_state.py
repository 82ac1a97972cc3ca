"""What becomes of the engine's process is decided the same way every time, and nobody is left waiting."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_addon.errors import ADVICE
from blender_addon.renderer import state
from blender_addon.renderer import state as renderer_state
from blender_addon.renderer.state import (
    Broke,
    CloseStdin,
    Exited,
    Failed,
    Greeted,
    Heard,
    Kill,
    Ready,
    Release,
    RestartAsked,
    Spawn,
    StartAsked,
    Starting,
    StopAsked,
    Stopped,
    Stopping,
    Tick,
    transition,
)

READY = Ready(1, since_s=10.0, looked_s=10.0)
CRASHED = Failed(1, since_s=10.0, kind="crashed")
LATER_S = 10.0 + renderer_state.RESTART_S
STOPPED = (CloseStdin(), Release("stopped"))

# state, event, next state, effects
TABLE = {
    "the first wish starts an engine": (Stopped(), StartAsked(10.0), Starting(1, since_s=10.0), (Spawn(1),)),
    "a greeting makes it ready": (Starting(1, since_s=9.0), Greeted(10.0, 1), READY, ()),
    "a greeting of an earlier run does not": (Starting(2), Greeted(10.0, 1), Starting(2), ()),
    "an end while it starts is a failure": (
        Starting(1),
        Exited(10.0, 1, "no_engine"),
        Failed(1, since_s=10.0, kind="no_engine"),
        (Release("no_engine"),),
    ),
    "another version is a failure, and the process is ended": (
        Starting(1),
        Broke(10.0, 1, "protocol", "2 and 3"),
        Failed(1, since_s=10.0, kind="protocol", detail="2 and 3"),
        (Kill(), Release("protocol", "2 and 3")),
    ),
    "a start takes its time": (Starting(1, since_s=10.0), Tick(39.0), Starting(1, since_s=10.0), ()),
    "but not for ever": (
        Starting(1, since_s=9.0),
        Tick(39.5),
        Failed(1, since_s=39.5, kind="start_timeout"),
        (Kill(), Release("start_timeout")),
    ),
    "a start can be stopped": (Starting(1), StopAsked(10.0, 0.3), Stopping(1, 0, 10.0, False, 0.3), STOPPED),
    "a crash releases everybody": (
        READY,
        Exited(10.0, 1, "crashed", "exit code 7"),
        Failed(1, since_s=10.0, kind="crashed", detail="exit code 7"),
        (Release("crashed", "exit code 7"),),
    ),
    "an engine that makes no sense is ended": (
        READY,
        Broke(10.0, 1),
        Failed(1, since_s=10.0, kind="broken_stream"),
        (Kill(), Release("broken_stream")),
    ),
    "the end of an earlier run changes nothing": (READY, Exited(10.0, 0), READY, ()),
    "a sign of life ends the silence": (Ready(1, silent_s=20.0), Heard(10.0, 1), Ready(1, looked_s=10.0), ()),
    "a stop closes stdin": (READY, StopAsked(11.0, 0.3), Stopping(1, 0, 11.0, False, 0.3), STOPPED),
    "a restart does too": (READY, RestartAsked(11.0), Stopping(1, 0, 11.0, True, renderer_state.STOP_S), STOPPED),
    "a restart ends in a start": (
        Stopping(1, 2, 0.0, True, renderer_state.STOP_S),
        Exited(10.0, 1),
        Starting(2, since_s=10.0),
        (Spawn(2),),
    ),
    "a stop ends in silence": (Stopping(1, 0, 9.0, False, 0.3), Exited(10.0, 1), Stopped(1, since_s=10.0), ()),
    "where somebody waits for the end it is ended soon": (
        Stopping(1, 0, 10.0, False, 0.3),
        Tick(10.4),
        Stopping(1, 0, 10.0, False, 0.3),
        (Kill(),),
    ),
    "an engine that does not end is ended": (
        Stopping(1, 0, 10.0, True, 3.0),
        Tick(13.5),
        Stopping(1, 0, 10.0, True, 3.0),
        (Kill(),),
    ),
    "after a crash a picture starts it again": (CRASHED, StartAsked(LATER_S), Starting(2, 1, LATER_S), (Spawn(2),)),
    "but not at once": (CRASHED, StartAsked(12.0), CRASHED, (Release("crashed"),)),
    "and not too often": (
        Failed(9, renderer_state.RESTARTS_MAX, kind="crashed"),
        StartAsked(1e6),
        Failed(9, renderer_state.RESTARTS_MAX, kind="crashed"),
        (Release("crashed"),),
    ),
    "and not when nothing was mended": (
        Failed(1, kind="no_engine"),
        StartAsked(1e6),
        Failed(1, kind="no_engine"),
        (Release("no_engine"),),
    ),
    "the user may always, and counts anew": (
        Failed(9, renderer_state.RESTARTS_MAX, 10.0, kind="no_engine"),
        StartAsked(10.1, by_user=True),
        Starting(10, 0, 10.1),
        (Spawn(10),),
    ),
    "a failure is put aside by a stop": (CRASHED, StopAsked(11.0, 0.3), Stopped(1, since_s=11.0), ()),
}


@pytest.mark.parametrize(("before", "event", "after", "effects"), TABLE.values(), ids=TABLE.keys())
def test_table(before, event, after, effects):
    assert transition(before, event) == (after, effects)


def after_silence(seconds: float, step_s: float) -> state.State:
    """What becomes of a ready engine that says nothing for so long while somebody listens every `step_s`."""
    now: state.State = READY
    for count in range(1, round(seconds / step_s) + 1):
        now, _ = transition(now, Tick(10.0 + count * step_s))
    return now


def test_an_engine_that_is_silent_is_slow_and_then_hangs():
    assert not after_silence(4.0, 0.5).slow
    assert after_silence(6.0, 0.5).slow
    assert isinstance(after_silence(29.0, 0.5), Ready)
    hung = after_silence(31.0, 0.5)
    assert (type(hung), hung.kind) == (Failed, "hung")


def test_a_computer_that_slept_does_not_blame_the_engine():
    assert not after_silence(3600.0, 3600.0).slow


def test_what_may_pass_is_a_known_failure():
    assert set(ADVICE) >= state.PASSING


TIMES = st.floats(0, 1e6)
RUNS = st.integers(0, 2)
KINDS = st.sampled_from(sorted(ADVICE))
STATES = st.one_of(
    st.builds(Stopped, RUNS, st.integers(0, 5), TIMES),
    st.builds(Starting, RUNS, st.integers(0, 5), TIMES),
    st.builds(Ready, RUNS, st.integers(0, 5), TIMES, TIMES, TIMES),
    st.builds(Stopping, RUNS, st.integers(0, 5), TIMES, st.booleans(), TIMES),
    st.builds(Failed, RUNS, st.integers(0, 5), TIMES, KINDS),
)
EVENTS = st.one_of(
    st.builds(StartAsked, TIMES, st.booleans()),
    st.builds(StopAsked, TIMES, TIMES),
    st.builds(RestartAsked, TIMES),
    st.builds(Tick, TIMES),
    st.builds(Greeted, TIMES, RUNS),
    st.builds(Heard, TIMES, RUNS),
    st.builds(Broke, TIMES, RUNS, KINDS),
    st.builds(Exited, TIMES, RUNS, KINDS),
)


@settings(max_examples=500)
@given(STATES, EVENTS)
def test_every_pair_is_decided_and_a_failure_releases_everybody(before, event):
    after, effects = transition(before, event)
    assert isinstance(after, Stopped | Starting | Ready | Stopping | Failed)
    assert after.run in (before.run, before.run + 1)
    # a new run and nothing else is a new process
    assert [effect for effect in effects if isinstance(effect, Spawn)] == (
        [Spawn(after.run)] if after.run > before.run else []
    )
    if isinstance(after, Failed) and not isinstance(before, Failed):
        assert effects[-1] == Release(after.kind, after.detail)
        # the process is gone, or it is ended
        assert isinstance(event, Exited) or Kill() in effects
    if isinstance(after, Starting | Ready):
        assert not any(isinstance(effect, Release) for effect in effects)


@settings(max_examples=300)
@given(st.lists(st.tuples(st.floats(0, 20), EVENTS), max_size=60))
def test_there_is_never_more_than_one_process(history):
    """Whatever happens in whatever order: a process is started only when the one before is gone or was ended."""
    now: state.State = Stopped()
    time_s, lives, restarts = 0.0, False, 0
    for passed_s, event in history:
        time_s += passed_s
        event = type(event)(**{**vars(event), "now_s": time_s})
        if isinstance(event, state.OfRun) and (event.run != now.run or not lives):
            continue  # heard late; the table says that it changes nothing
        before, (now, effects) = now, transition(now, event)
        if isinstance(event, Exited):
            lives = False
        for effect in effects:
            lives = lives and not isinstance(effect, Kill)
            if isinstance(effect, Spawn):
                assert not lives
                lives = True
                asked_by_user = isinstance(event, RestartAsked) or getattr(event, "by_user", False)
                unasked = isinstance(before, Failed) and not asked_by_user
                restarts = restarts + 1 if unasked else 0 if asked_by_user else restarts
                assert restarts <= renderer_state.RESTARTS_MAX or isinstance(before, Stopped | Stopping)
        assert lives or isinstance(now, Stopped | Failed | Stopping)
