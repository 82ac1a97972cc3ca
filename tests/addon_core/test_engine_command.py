"""The engine is found where it is promised to be, and is told nothing of Blender's own Python."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from stand_ins import ROOT

from blender_addon.errors import ADVICE, JGHandFailure
from blender_addon.renderer import process as engine_commands
from blender_addon.renderer.process import VARIABLE, cleaned_environment, engine_command, engine_program


def test_blenders_own_variables_do_not_reach_the_engine():
    kept = {"PATH": "p", "HOME": "h", "CUDA_VISIBLE_DEVICES": "0", "LANG": "C"}
    dropped = {"PYTHONPATH": "x", "PYTHONHOME": "x", "LD_LIBRARY_PATH": "x", "OCIO": "x", "BLENDER_USER_CONFIG": "x"}
    assert cleaned_environment({**kept, **dropped, "DYLD_LIBRARY_PATH": "x"}) == kept | {
        "JGHAND_BLENDER_ADDON": str(ROOT / "blender_addon")
    }


def test_the_engine_is_found_in_the_order_that_is_promised(tmp_path, monkeypatch):
    chosen, tools = tmp_path / "chosen", tmp_path / "tools/bin/python"
    in_checkout = tmp_path / "checkout/.envs/engine/bin/python"
    for file in (chosen, tools, in_checkout):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch(mode=0o755)
    checkout = tmp_path / "checkout"
    module = ("-I", "-m", "jghand_engine")
    named = {VARIABLE: str(chosen)}
    assert engine_program(str(chosen), checkout=checkout, environment={}) == (str(chosen), *module)
    assert engine_program(None, checkout=checkout, environment=named) == (str(chosen), *module)
    assert engine_program(None, checkout=checkout, environment={}) == (str(in_checkout), *module)
    assert engine_program(tools=tools, learns=True, environment={}) == (str(tools), *module)
    nothing = str(tmp_path / "nothing")
    for python, variables, kind in (
        (nothing, named, "no_python"),
        (None, {VARIABLE: nothing}, "no_named_python"),
        (None, {}, "no_interpreter"),
    ):
        with pytest.raises(JGHandFailure) as caught:
            engine_program(python, environment=variables)
        assert caught.value.kind == kind


def test_the_engine_that_the_extension_carries_draws_and_does_not_learn(tmp_path, monkeypatch):
    (tmp_path / "engine" / "common").mkdir(parents=True)
    monkeypatch.setattr(engine_commands, "CARRIED", tmp_path / "engine")
    (tmp_path / "engine" / "common" / "jghand_engine").mkdir()
    (tmp_path / "engine" / "common" / "jghand_engine" / "__init__.py").touch()
    main = "import sys\ndef main():\n    print(*sys.argv[1:])\n    return 3\n"
    (tmp_path / "engine" / "common" / "jghand_engine" / "cli.py").write_text(main)
    done = subprocess.run(engine_command(environment={}), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (3, "serve\n")
    assert engine_command(environment={}, on_gpu=True)[-3:] == ("serve", "--backend", "gpu")
    with pytest.raises(JGHandFailure) as caught:
        engine_program(learns=True, environment={})
    assert caught.value.kind == "no_tools"


@pytest.mark.skipif(os.name == "nt", reason="paths are written as POSIX has them")
@pytest.mark.parametrize("inside", ["bin/python", "Scripts/python.exe", "python.exe"])
def test_the_folder_of_an_environment_means_its_python_and_quotation_marks_mean_nothing(tmp_path, monkeypatch, inside):
    python = tmp_path / "my environment" / inside
    python.parent.mkdir(parents=True, exist_ok=True)
    python.touch(mode=0o755)
    monkeypatch.setenv("HOME", str(tmp_path))
    for text in (str(python), f'"{python}"', f" {python}\n", str(tmp_path / "my environment"), "~/my environment"):
        assert engine_program(text, environment={})[0] == str(python)


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


def test_every_process_of_the_extension_is_started_without_a_window():
    for path in Path(engine_commands.__file__).parent.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        starts = text.count("subprocess.Popen(") + text.count("subprocess.run(")
        assert text.count("creationflags=HIDDEN") == starts, path
