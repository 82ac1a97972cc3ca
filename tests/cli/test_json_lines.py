"""What a program reads that started a command: lines of JSON, and how the end of its input stops the command."""

import errno
import io
import json
import subprocess
import sys

import pytest
from rich.progress import Progress

from jghand_engine.cli.console import Bar, progress
from jghand_engine.cli.failures import explain
from jghand_engine.cli.progress_json import JsonLines, JsonTraining, json_lines
from jghand_engine.errors import DiskFullError, InputError, RetryError
from jghand_engine.learn.progress import Status


def told(stream: io.StringIO) -> list[dict]:
    return [json.loads(line) for line in stream.getvalue().splitlines()]


def test_a_bar_is_told_in_lines_its_first_and_its_last_always():
    stream = io.StringIO()
    bar = Bar(Progress(disable=True), "Writing", 500, JsonLines(stream))
    for _ in range(500):
        bar.advance()
    lines = told(stream)
    assert (lines[0]["done"], lines[-1]["done"], lines[-1]["total"]) == (0, 500, 500)
    assert len(lines) < 50, "not one line for every step"
    assert {line["jghand"] for line in lines} == {"progress"}


def test_without_a_program_that_reads_along_nothing_is_told(capsys):
    assert json_lines() is None
    with progress("Writing", 3) as bar:
        bar.advance()
    assert capsys.readouterr().err == ""


def test_a_training_tells_its_step_its_sentence_and_what_happened():
    stream = io.StringIO()
    display = JsonTraining(JsonLines(stream))
    display.update(Status(step=0, steps=90, seconds_left=None))
    display.note("Resuming at step 40.")
    first, second = told(stream)
    assert (first["jghand"], first["total"], first["eta_s"]) == ("training", 90, None)
    assert second == {"jghand": "note", "text": "Resuming at step 40."}


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (InputError("joints", wanted="21", came="20"), "bad_input"),
        (RetryError("the engine is busy"), "retry"),
        (DiskFullError("cannot write the stage: the disk is full"), "disk_full"),
        (OSError(errno.ENOSPC, "No space left on device", "x"), "disk_full"),
        (MemoryError(), "out_of_memory"),
        (KeyboardInterrupt(), "canceled"),
        (ZeroDivisionError(), "internal"),
    ],
)
def test_an_error_has_the_kind_that_the_service_gives_it(error, kind):
    stream = io.StringIO()
    JsonLines(stream).error(explain(error), error)
    (line,) = told(stream)
    assert (line["jghand"], line["kind"]) == ("error", kind)
    assert line["text"] == explain(error).sentence


def test_the_end_of_standard_input_stops_a_command_as_ctrl_c_does(tmp_path):
    words = ["export", "--poses", "open,fist,point,open", "--avatar", "painted", "--out", str(tmp_path / "usd")]
    command = [sys.executable, "-I", "-m", "jghand_engine", *words, "--progress-json"]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False, timeout=120, text=True)
    assert done.returncode == 130
    assert json.loads(done.stderr.splitlines()[-1])["kind"] == "canceled"
    assert not (tmp_path / "usd" / "hand.usda").exists()
