"""The engine as seen from Blender: whatever goes wrong becomes one sentence, in time, with nothing left running."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest
from stand_ins import ROOT, linked, picture

from blender_addon.core import limits
from blender_addon.errors import ADVICE, JGHandFailure
from blender_addon.renderer import engine_command as engine_commands
from blender_addon.renderer.engine_command import VARIABLE, engine_command, engine_program
from blender_addon.renderer.link import EngineLink
from blender_addon.renderer.process import cleaned_environment


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


def failure_of_command(*command: str) -> JGHandFailure:
    """What a start with this command fails with."""
    link = EngineLink(lambda: command)
    link.start()
    with pytest.raises(JGHandFailure) as caught:
        link.wait_until_ready()
    link.close()
    return caught.value


def failure_of(*faults: str, **options) -> JGHandFailure:
    """What a picture fails with."""
    with pytest.raises(JGHandFailure) as caught, ready(*faults) as engine:
        engine.request(*picture(), **options)
    return caught.value


def test_a_picture_is_asked_for_and_comes():
    with ready() as engine:
        reply = engine.request(*picture())
        assert reply.arrays["rgba_u8"].shape == (48, 64, 4)
        assert np.asarray(reply.arrays["rgba_u8"].view())[24, 32, 3] == 255
        process = engine._engine.popen
    assert process.poll() == 0


def test_a_long_pause_between_requests_does_no_harm():
    with ready() as engine:
        engine.request({"kind": "info"})
        time.sleep(2.5)  # two heart-beats wait to be read
        assert engine.request({"kind": "info"}).header["ok"]


def test_a_request_may_take_longer_than_a_heart_beat():
    with ready("slow") as engine:
        assert engine.request(*picture()).header["ok"]


def test_a_chatty_engine_is_understood_and_its_words_are_kept():
    with ready("chatty") as engine:
        assert engine.request({"kind": "info"}).header["ok"]
        assert "a library says hello" in engine.log


@pytest.mark.parametrize("fault", ["flood", "print"])
def test_an_engine_that_floods_its_output_does_not_block(fault):
    with ready(fault) as engine:
        assert engine.request(*picture()).header["ok"]


@pytest.mark.parametrize(("fault", "kind"), [("die", "crashed"), ("killed", "killed"), ("memory", "out_of_memory")])
def test_an_end_in_the_middle_of_a_picture_has_its_sentence(fault, kind):
    assert failure_of(fault).kind == kind


def test_a_mistake_of_the_engine_is_told_with_its_trace():
    failure = failure_of("bug")
    assert failure.kind == "internal"
    assert "ZeroDivisionError" in failure.detail


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
    monkeypatch.setattr(limits, "SILENCE_S", 2.5)
    started = time.monotonic()
    failure = failure_of("frozen", timeout_s=300.0)
    assert time.monotonic() - started < 30
    assert failure.kind == "hung"
    assert "no sign of life" in failure.detail
    assert "the last words" in failure.detail


def test_what_makes_no_sense_is_a_broken_stream_and_no_other_version():
    assert failure_of("rubbish").kind == "broken_stream"


def test_an_engine_that_dies_at_once_is_told_with_its_last_words():
    failure = failure_of_start("die_at_start")
    assert failure.kind == "crashed"
    assert "no torch here" in failure.detail


@pytest.mark.parametrize("fault", ["silent", "garbage"])
def test_an_engine_without_a_handshake_is_given_up(fault, monkeypatch):
    monkeypatch.setattr(limits, "HANDSHAKE_S", 1.0)
    assert failure_of_start(fault).kind == "start_timeout"


@pytest.mark.parametrize(("fault", "kind"), [("wrong_version", "protocol"), ("wrong_port", "broken_stream")])
def test_an_engine_that_is_not_ours_is_told_so(fault, kind):
    assert failure_of_start(fault).kind == kind


def test_a_python_that_does_not_exist_is_told_so(tmp_path):
    assert failure_of_command(str(tmp_path / "python"), "-m", "jghand_engine").kind == "no_interpreter"


def test_a_python_without_the_engine_is_told_so():
    failure = failure_of_command(sys.executable, "-I", "-S", "-m", "jghand_engine", "serve", "--stdio-handshake")
    assert failure.kind == "no_engine"


@pytest.mark.parametrize("name", ["tyro_of_another_name", "jghand_engine_of_another_name", "jghand_engine.nothing"])
def test_a_python_that_lacks_something_that_the_engine_needs_is_told_so_by_name(name, tmp_path):
    (tmp_path / "jghand_engine").mkdir()
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import {name}  # jghand_engine"
    failure = failure_of_command(sys.executable, "-I", "-S", "-c", code)
    assert failure.kind == "no_engine"
    assert name in failure.detail


def test_after_a_failure_there_is_no_engine():
    with ready("die") as engine:
        with pytest.raises(JGHandFailure):
            engine.request(*picture())
        with pytest.raises(JGHandFailure) as caught:
            engine.request({"kind": "info"})
    assert caught.value.kind == "crashed"


def test_blenders_own_variables_do_not_reach_the_engine():
    kept = {"PATH": "p", "HOME": "h", "CUDA_VISIBLE_DEVICES": "0", "LANG": "C"}
    dropped = {"PYTHONPATH": "x", "PYTHONHOME": "x", "LD_LIBRARY_PATH": "x", "OCIO": "x", "BLENDER_USER_CONFIG": "x"}
    assert cleaned_environment({**kept, **dropped, "DYLD_LIBRARY_PATH": "x"}) == kept | {
        "JGHAND_BLENDER_ADDON": str(ROOT / "blender_addon")
    }


def test_the_engine_is_found_in_the_order_that_is_promised(tmp_path, monkeypatch):
    chosen, tools = tmp_path / "chosen", tmp_path / "tools/bin/python"
    in_checkout, noted = tmp_path / "checkout/.envs/engine/bin/python", tmp_path / "noted"
    for file in (chosen, tools, in_checkout, noted):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch(mode=0o755)
    (tmp_path / engine_commands.NOTE).write_text(f"{noted}\n", "utf-8")
    home, checkout = {"JGHAND_CONFIG_DIR": str(tmp_path)}, tmp_path / "checkout"
    module = ("-I", "-m", "jghand_engine")
    named = {**home, VARIABLE: str(chosen)}
    assert engine_program(str(chosen), checkout=checkout, environment=home) == (str(chosen), *module)
    assert engine_program(None, checkout=checkout, environment=named) == (str(chosen), *module)
    assert engine_program(None, checkout=checkout, environment=home) == (str(in_checkout), *module)
    assert engine_program(None, environment=home) == (str(noted), *module)
    assert engine_program(tools=tools, learns=True, environment=home) == (str(tools), *module)
    for wrong in ({"python": str(tmp_path / "nothing")}, {}):
        with pytest.raises(JGHandFailure) as caught:
            engine_program(environment={}, **wrong)
        assert caught.value.kind == "no_interpreter"


def test_the_engine_that_the_extension_carries_draws_and_does_not_learn(tmp_path, monkeypatch):
    (tmp_path / "engine" / "common").mkdir(parents=True)
    monkeypatch.setattr(engine_commands, "CARRIED", tmp_path / "engine")
    carried = (sys.executable, "-I", str(engine_commands.ENGINE_MAIN))
    assert engine_command(environment={}) == (*carried, "serve", "--stdio-handshake")
    with pytest.raises(JGHandFailure) as caught:
        engine_program(learns=True, environment={})
    assert caught.value.kind == "no_tools"


def test_every_failure_has_a_sentence_without_numbers():
    for advice in ADVICE.values():
        for text in (advice.sentence, advice.remedy):
            assert text
            assert not any(letter.isdigit() for letter in text)
            assert not text.endswith(".")
        assert advice.exit_code in (1, 2, 3, 4, 130)


def test_nothing_here_needs_blender():
    code = (
        "import importlib, pkgutil, sys; sys.path.insert(0, sys.argv[1]); sys.modules['bpy'] = None\n"
        "import blender_addon.core as core, blender_addon.renderer.jobs, blender_addon.renderer.link\n"
        "for module in pkgutil.iter_modules(core.__path__): importlib.import_module(f'{core.__name__}.{module.name}')"
    )
    subprocess.run([sys.executable, "-I", "-c", code, str(ROOT)], check=True)


def test_an_engine_that_will_not_end_is_ended_by_force():
    started = time.monotonic()
    with ready("stubborn") as engine:
        process = engine._engine.popen
    assert process.poll() is not None
    assert time.monotonic() - started < 20


def test_the_death_of_the_engine_is_noticed_long_before_the_time_of_the_request_is_over():
    started = time.monotonic()
    assert failure_of("die", timeout_s=300.0).kind == "crashed"
    assert time.monotonic() - started < 30


@pytest.mark.parametrize(
    ("content", "seen"), [(None, "engine"), ("x = 1", "copy"), ("import nothing_of_that_name", "")]
)
def test_the_protocol_is_the_extensions_copy_where_there_is_one_even_a_broken_one(tmp_path, content, seen):
    core = tmp_path / "addon" / "core"
    core.mkdir(parents=True)
    for path in (tmp_path / "addon/__init__.py", core / "__init__.py"):
        path.touch()
    (core / "wire.py").write_text((ROOT / "blender_addon/core/wire.py").read_text())
    if content is not None:
        (core / "protocol.py").write_text(content)
    code = (
        "import sys; sys.path[:0] = sys.argv[1:]; from addon.core.wire import protocol\n"
        "print('copy' if protocol.__name__ == 'addon.core.protocol' else 'engine')"
    )
    command = [sys.executable, "-I", "-c", code, str(tmp_path), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == seen
    assert ("nothing_of_that_name" in done.stderr) == (seen == "")
