"""The pool of threads: everything runs once, errors come back, nothing hangs."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from jghand_engine.avatar.builtin import load_painted
from jghand_engine.hand.joints import Handedness
from jghand_engine.native import threads
from jghand_engine.native.threads import (
    AUTOMATIC_THREADS,
    WorkerPool,
    _Call,
    physical_cores,
    processors,
    shared_pool,
    thread_count,
)
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.subject import moving_subject


@pytest.fixture(params=[1, 2, 3, 5])
def pool(request):
    some = WorkerPool(request.param)
    yield some
    some.close()


def all_together(pool: WorkerPool):
    """A function for a pool that ends on no thread before all have come."""
    barrier = threading.Barrier(pool.threads)
    return lambda _index: barrier.wait(20)


def test_every_thread_runs_the_function_once_and_the_caller_is_one_of_them(pool):
    seen: dict[int, threading.Thread] = {}
    together = all_together(pool)

    def work(index: int) -> None:
        assert seen.setdefault(index, threading.current_thread()) is threading.current_thread()
        together(index)

    pool.run(work)
    assert sorted(seen) == list(range(pool.threads))
    assert seen[0] is threading.current_thread()
    assert len(set(seen.values())) == pool.threads


@contextlib.contextmanager
def without_a_processor(pool: WorkerPool):
    """The pool's other threads get none meanwhile: to them every call comes late."""
    let_go = threading.Event()
    for worker in pool._workers:
        worker._calls.put(_Call(lambda _index: let_go.wait(20)))
    while any(not worker._calls.empty() for worker in pool._workers):
        time.sleep(0.001)
    yield
    let_go.set()


def test_a_thread_that_gets_no_processor_does_not_hold_the_call_and_never_begins_it(pool):
    seen: list[int] = []
    with without_a_processor(pool):
        for _ in range(3):
            pool.run(seen.append)
        assert pool.map(lambda i: i * i, 20) == [i * i for i in range(20)]
    pool.run(all_together(pool))  # they have come back, and what was called off does not run
    assert seen == [0, 0, 0]


def test_a_picture_has_the_same_bits_whoever_comes():
    avatar = load_painted(handedness=Handedness.RIGHT).prefix(2000)
    subject = moving_subject("painted", avatar, 64, 48)
    joints_m, camera = subject.poses[0], subject.camera
    alone = HandRenderer(avatar, RenderSettings(threads=1)).render(joints_m, camera).rgba
    with without_a_processor(shared_pool(3)):
        late = HandRenderer(avatar, RenderSettings(threads=3)).render(joints_m, camera).rgba
    together = HandRenderer(avatar, RenderSettings(threads=3)).render(joints_m, camera).rgba
    assert alone.any()
    assert np.array_equal(alone, late)
    assert np.array_equal(alone, together)


def test_items_come_back_in_order_and_each_is_done_once(pool):
    done: list[int] = []

    def square(i: int) -> int:
        done.append(i)
        return i * i

    assert pool.map(square, 100) == [i * i for i in range(100)]
    assert sorted(done) == list(range(100))
    assert pool.map(square, 0) == []


def test_an_error_in_any_thread_is_raised_and_the_pool_lives_on(pool):
    together = all_together(pool)

    def fail(index: int) -> None:
        together(index)
        if index == pool.threads - 1:
            raise ValueError("in the last thread")

    for _ in range(3):
        with pytest.raises(ValueError, match="in the last thread"):
            pool.run(fail)
    assert pool.map(lambda i: i, 3) == [0, 1, 2]


def interrupted_after(seconds: float) -> threading.Timer:
    """A running timer that sends Ctrl-C to the main thread."""
    main = threading.main_thread().ident
    assert main is not None
    timer = threading.Timer(seconds, signal.pthread_kill, (main, signal.SIGINT))
    timer.start()
    return timer


needs_signals = pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signals to a thread here")


@needs_signals
@pytest.mark.parametrize("caller_s", [0.0, 0.3], ids=["while it waits", "while it works"])
def test_ctrl_c_comes_through_only_when_all_threads_are_done(caller_s):
    pool, done = WorkerPool(3), []
    together = all_together(pool)

    def work(index: int) -> None:
        together(index)
        time.sleep(0.4 if index else caller_s)
        done.append(index)

    timers = [interrupted_after(seconds) for seconds in (0.1, 0.2)]  # also an impatient second one
    with pytest.raises(KeyboardInterrupt):
        pool.run(work)
    assert {1, 2} <= set(done)
    for timer in timers:
        timer.join()
    assert pool.map(lambda i: i, 10) == list(range(10))
    pool.close()


def test_calls_from_several_threads_wait_for_each_other(pool):
    results: list[list[int]] = []
    callers = [threading.Thread(target=lambda: results.append(pool.map(lambda i: i, 50))) for _ in range(4)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join(20)
    assert results == [list(range(50))] * 4


def test_the_automatic_number_of_threads_is_at_most_the_cores():
    assert thread_count(5) == 5
    assert 1 <= thread_count(0) <= min(physical_cores(), AUTOMATIC_THREADS)


def test_a_containers_limit_is_respected(monkeypatch):
    assert physical_cores() <= processors()
    monkeypatch.setattr(threads, "_container_limit", lambda: 1)
    assert physical_cores() == processors() == 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_child_makes_threads_of_its_own():
    shared_pool(2).map(lambda i: i, 4)
    child = os.fork()
    if child == 0:
        os._exit(0 if shared_pool(2).map(lambda i: i, 4) == [0, 1, 2, 3] else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_threads_of_torch_that_wait_sleep():
    environment = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    command = [sys.executable, "-c", "import jghand_engine.learn.gaussians"]
    done = subprocess.run(
        command, env={**environment, "OMP_DISPLAY_ENV": "TRUE"}, capture_output=True, text=True, check=True
    )
    assert "PASSIVE" in next(line for line in done.stderr.splitlines() if "OMP_WAIT_POLICY" in line)
