"""Jobs end in time whatever their program does, say why, and take nothing of Blender with them."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from waiting import wait_for_count, wait_until

from blender_addon.errors import ADVICE, JGHandFailure
from blender_addon.renderer import jobs
from blender_addon.renderer import jobs as renderer_jobs
from blender_addon.renderer import state as renderer_state
from blender_addon.renderer.jobs import Job, JobSpec, JobState, JobTable, Phase
from blender_addon.renderer.process import Child, told_in

STAND_IN = Path(__file__).with_name("stand_in_job.py")
ROOT = Path(__file__).resolve().parents[2]
LONG_S = 20.0

posix = pytest.mark.skipif(os.name == "nt", reason="the stand-in uses signals of POSIX")


def spec(*words: str, **more) -> JobSpec:
    return JobSpec("Testing", (sys.executable, "-I", str(STAND_IN), *words), **more)


def ended(job: Job, wait_s: float = LONG_S) -> JobState:
    assert job.wait(wait_s), f"still {job.state}"
    assert job._process is None or job._process.popen.poll() is not None
    return job.state


def until_it_counts(job: Job) -> None:
    wait_for_count(job)
    assert job.state.text == "Counting"


# ---- states ----------------------------------------------------------------------------------------------------------


def test_a_line_of_progress_becomes_a_sentence_with_the_remaining_time():
    line = '{"jghand": "progress", "text": "Baking", "done": 34, "total": 240, "eta_s": 12}'
    content = told_in(line)
    assert content is not None
    state = JobState().after(content)
    assert state.sentence() == "Baking 34 of 240 · 12 s left"
    assert state.fraction == pytest.approx(34 / 240)


def test_the_sentence_of_a_training_is_not_counted_twice():
    content = {"jghand": "training", "text": "step 4 of 9 · loss 0.1 · 7 s left", "done": 4, "total": 9, "eta_s": 7.0}
    assert JobState().after(content).sentence() == "step 4 of 9 · loss 0.1 · 7 s left"


@pytest.mark.parametrize("line", ["", "text", "{", "[]", "{}", '{"jghand": 1}', "{" * 5000, "{" + "[" * 200000])
def test_any_other_line_is_no_news(line):
    assert not isinstance(told_in(line).get("jghand"), str)


@pytest.mark.parametrize(
    ("code", "error", "log", "kind"),
    [
        (3, {"kind": "disk_full", "text": "full"}, "", "disk_full"),
        (2, {"kind": "bad_input", "text": "wanted 1, got 2"}, "", "bad_input"),
        (1, {"kind": "made up", "text": ""}, "", "internal"),
        (1, None, "python: No module named jghand_engine", "no_engine"),
        (2, None, "usage: jghand", "protocol"),
        (4, None, "", "out_of_memory"),
        (-9, None, "", "killed"),
        (137, None, "", "killed"),
        (1, None, "Traceback", "crashed"),
    ],
)
def test_every_bad_end_has_its_sentence(code, error, log, kind):
    failure = jobs.failure_of(code, error, log)
    assert failure.kind == kind
    assert failure.advice is ADVICE[kind]


# ---- processes -------------------------------------------------------------------------------------------------------


@posix
def test_a_job_runs_says_how_far_it_is_and_is_done(tmp_path):
    done = []
    job = Job(spec("short", on_done=lambda: done.append(True)))
    seen = set()
    while not job.is_over:
        job.tick()
        seen.add(job.state.fraction)
        time.sleep(0.005)
    assert job.state.phase is Phase.DONE
    assert done == [True]
    assert len(seen) > 2
    assert not job.tick()


@posix
def test_a_canceled_training_writes_its_checkpoint_first(tmp_path):
    job = Job(spec("long", f"file={tmp_path / 'checkpoint'}"))
    until_it_counts(job)
    job.cancel()
    assert job.state.phase is Phase.CANCELLING
    assert ended(job).phase is Phase.CANCELLED
    assert (tmp_path / "checkpoint").read_text() == "checkpoint"


@posix
def test_a_failure_while_it_stops_is_told(tmp_path):
    job = Job(spec("full at the end"))
    until_it_counts(job)
    job.cancel()
    state = ended(job)
    assert state.phase is Phase.FAILED
    assert state.failure is not None
    assert state.failure.kind == "disk_full"


@posix
def test_a_look_at_a_job_never_waits_for_those_who_hold_its_pipes(tmp_path, monkeypatch):
    monkeypatch.setattr(renderer_jobs, "JOB_LAST_WORDS_S", 20.0)
    job = Job(spec("orphan"))
    assert job._process is not None
    job._process.ends_within(LONG_S)
    job.tick()
    assert not job.is_over, "its last words may still come"
    monkeypatch.setattr(renderer_jobs, "JOB_LAST_WORDS_S", 0.0)
    job.tick()
    assert job.state.phase is Phase.DONE
    os.killpg(job._process.popen.pid, signal.SIGKILL)


@posix
@pytest.mark.parametrize("fault", ["short", "die"])
def test_what_only_the_job_needed_is_taken_away_when_it_is_over(tmp_path, fault):
    (tmp_path / "scratch").mkdir()
    job = Job(spec(fault, scratch=(tmp_path / "scratch",)))
    assert (tmp_path / "scratch").is_dir()
    ended(job)
    assert not list(tmp_path.iterdir())


@posix
def test_a_program_that_does_not_listen_is_ended_by_force(tmp_path, monkeypatch):
    monkeypatch.setattr(renderer_jobs, "JOB_STOP_S", 0.2)
    monkeypatch.setattr(renderer_state, "TERMINATE_S", 0.2)
    job = Job(spec("deaf"))
    until_it_counts(job)
    job.cancel()
    assert ended(job).phase is Phase.CANCELLED


@posix
def test_a_program_that_hangs_in_the_system_does_not_hold_blender(tmp_path, monkeypatch):
    """As one does that waits for a disk that is gone: it cannot be killed."""
    monkeypatch.setattr(renderer_state, "KILL_S", 0.1)
    end_tree = Child.end_tree
    monkeypatch.setattr(Child, "end_tree", lambda *_, **__: None)
    job = Job(spec("deaf"))
    until_it_counts(job)
    killing = threading.Thread(target=job.kill, daemon=True)
    killing.start()
    killing.join(LONG_S)
    held = killing.is_alive()
    end_tree(job._process, at_once=True)  # type: ignore[arg-type]
    killing.join()
    assert not held
    ended(job)


@posix
@pytest.mark.parametrize(("fault", "kind"), [("die", "crashed"), ("killed", "killed"), ("disk full", "disk_full")])
def test_a_program_that_fails_says_why(tmp_path, fault, kind):
    state = ended(Job(spec(fault)))
    assert state.phase is Phase.FAILED
    assert state.failure is not None
    assert state.failure.kind == kind


@posix
def test_a_flood_of_output_neither_blocks_nor_fills_memory(tmp_path):
    job = Job(spec("flood"))
    assert ended(job, 60.0).phase is Phase.DONE
    assert job.state.done == 19999
    assert len(job._output) <= renderer_state.LOG_LINES
    assert max(map(len, job._output)) <= renderer_state.LOG_LINE_MAX


@posix
def test_nonsense_on_standard_error_is_survived(tmp_path):
    assert ended(Job(spec("nonsense"))).phase is Phase.DONE


def test_a_program_that_is_not_there_is_a_failed_job(tmp_path):
    job = Job(JobSpec("Testing", (str(tmp_path / "python"),)))
    assert job.state.phase is Phase.FAILED
    assert job.state.failure is not None
    assert job.state.failure.kind == "no_interpreter"
    job.tick()
    job.cancel()
    job.kill()


@posix
def test_the_steps_of_a_job_follow_one_another_and_the_end_is_told_once(tmp_path):
    done = []
    more = tuple((sys.executable, "-I", str(STAND_IN), "short") for _ in range(2))
    started = time.monotonic()
    assert ended(Job(spec("short", more=more, on_done=lambda: done.append(True)))).phase is Phase.DONE
    assert done == [True]
    assert time.monotonic() - started > 3 * 3 * 0.02


@posix
@pytest.mark.parametrize("fault", ["die", "killed"])
def test_a_step_that_fails_is_the_last_one(tmp_path, fault):
    steps = ((sys.executable, "-I", str(STAND_IN), fault), (sys.executable, str(tmp_path / "never")))
    state = ended(Job(spec("short", more=steps)))
    assert state.failure is not None
    assert state.failure.kind in ("crashed", "killed")


@posix
def test_no_step_follows_one_that_was_canceled(tmp_path):
    job = Job(spec("long", more=((sys.executable, "-I", str(STAND_IN), "long", f"file={tmp_path / 'never'}"),)))
    until_it_counts(job)
    job.cancel()
    assert ended(job).phase is Phase.CANCELLED
    assert not (tmp_path / "never").exists()


# ---- the table -------------------------------------------------------------------------------------------------------


@posix
def test_one_job_of_a_key_runs_at_a_time_and_others_beside_it(tmp_path):
    table = JobTable()
    first = table.start("train", spec("long"))
    with pytest.raises(JGHandFailure) as caught:
        table.start("train", spec("long"))
    assert caught.value.kind == "job_running"
    other = table.start("bake", spec("short"))
    ended(other)
    assert table.running == [first]
    first.cancel()
    ended(first)
    assert table.start("train", spec("short")) is table.get("train")
    ended(table.get("train"))  # type: ignore[arg-type]


@posix
def test_the_end_of_blender_ends_jobs_politely_and_soon(tmp_path):
    table = JobTable()
    polite = table.start("train", spec("long", f"file={tmp_path / 'checkpoint'}"))
    until_it_counts(polite)
    deaf = table.start("bake", spec("deaf"))
    until_it_counts(deaf)
    started = time.monotonic()
    table.close()
    assert time.monotonic() - started < renderer_jobs.JOB_END_S + 2
    assert (tmp_path / "checkpoint").exists()
    deaf.kill()


@posix
def test_a_job_notices_that_blender_was_killed(tmp_path):
    """The end of its standard input reaches it from whatever ended its parent."""
    file = f"file={tmp_path / 'left'}"
    code = f"""
import os, sys
sys.path.insert(0, {str(ROOT)!r})
from blender_addon.renderer.jobs import Job, JobSpec
job = Job(JobSpec("T", (sys.executable, "-I", {str(STAND_IN)!r}, "long", {file!r})))
while not job.state.total:
    job.tick()
os.kill(os.getpid(), 9)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == -9
    wait_until((tmp_path / "left").exists, "its checkpoint")
    assert (tmp_path / "left").read_text() == "checkpoint"
