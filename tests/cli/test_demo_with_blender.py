"""The demo's way with Blender, played by a stand-in: what happens to files, failures and figures.

With Blender itself: tests/blender/test_demo.py.
"""

from __future__ import annotations

import json
import os
import sys
import textwrap

import pytest

from jghand_engine.cli import demo_scene
from jghand_engine.cli.demo_scene import Blender, Scene, hash_of, remove_old_results
from jghand_engine.errors import InputError, JGHandError, MemoryLimitError, RetryError

pytestmark = pytest.mark.skipif(os.name == "nt", reason="the stand-in is a shell script")

FAILURE = {"kind": "retry", "sentence": "The engine did not start", "remedy": "Look at the log", "detail": "port 1"}


@pytest.fixture
def scene(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    return Scene([], {}, "draft", "builtin", out)  # type: ignore[arg-type]  (nothing looks at the motion)


@pytest.fixture
def blender(tmp_path):
    """A Python that has Blender, which runs these lines instead of a script; `given` maps its options to values."""

    def make(*lines):
        body = textwrap.dedent("""
            import json, sys
            from pathlib import Path
            given = dict(zip(sys.argv[1:], sys.argv[2:]))
            def report(**content):
                Path(given["--report"]).write_text(json.dumps({"failure": None, "pictures": [], **content}))
        """)
        (tmp_path / "stand_in.py").write_text(body + "\n".join(lines))
        python = tmp_path / "python"
        python.write_text(f'#!/bin/sh\nexec {sys.executable} {tmp_path}/stand_in.py "$@"\n')
        python.chmod(0o755)
        return Blender(python)

    return make


def write(text):
    return f'Path(given["--out"]).write_text("{text}")'


def test_a_blend_file_as_the_demo_wrote_it_is_replaced(scene, blender):
    for content in ("first", "second"):
        assert remove_old_results(scene, keeps_blend=True) == ""
        blender(write(content)).build(scene)
        assert scene.blend.read_text() == content
    assert sorted(path.name for path in scene.out.iterdir()) == ["cameras.json", "hand.blend", "report.json"]


def test_blend_files_that_were_changed_are_kept_each_under_its_own_name(scene, blender):
    for count in range(3):
        note = remove_old_results(scene, keeps_blend=True)
        assert bool(note) == bool(count)
        blender(write("made")).build(scene)
        scene.blend.write_text(f"work of day {count}")
    assert [path.name for path in scene.previous_blends()] == ["hand.previous.2.blend", "hand.previous.blend"]
    assert "hand.previous.2.blend" in note
    assert (scene.out / "hand.previous.blend").read_text() == "work of day 0"
    assert (scene.out / "hand.previous.2.blend").read_text() == "work of day 1"
    assert scene.blend.read_text() == "work of day 2"


def test_a_demo_without_blender_leaves_no_blend_file_of_another_motion(scene, blender):
    written = blender(write("made")).build(scene)
    assert json.loads(scene.report.read_text())[demo_scene.BLEND_HASH] == written == hash_of(scene.blend)
    assert remove_old_results(scene, keeps_blend=False) == ""
    assert not scene.blend.exists()


def test_a_failing_build_leaves_the_blend_file_that_was_there(scene, blender):
    scene.blend.write_text("mine")
    with pytest.raises(InputError, match="the motion is torn"):
        blender(write("half"), "print('the motion is torn', file=sys.stderr)", "sys.exit(2)").build(scene)
    assert scene.blend.read_text() == "mine"
    assert sorted(path.name for path in scene.out.iterdir()) == ["cameras.json", "hand.blend"]


@pytest.mark.parametrize(("code", "kind"), [(1, JGHandError), (2, InputError), (3, RetryError), (4, MemoryLimitError)])
def test_what_failed_in_blender_is_told_with_its_remedy(scene, blender, code, kind):
    with pytest.raises(JGHandError) as raised:
        blender(f"report(failure={FAILURE})", "print('noise', file=sys.stderr)", f"sys.exit({code})").render(scene)
    assert type(raised.value) is kind
    assert raised.value.exit_code == code
    assert str(raised.value) == "The engine did not start (port 1). Look at the log."


def test_what_the_engine_printed_is_kept(scene, blender):
    log = "Path(given['--report']).with_suffix('.engine.log')"
    lines = (f"{log}.write_text('no such symbol')", f"report(failure={FAILURE} | {{'log': str({log})}})", "sys.exit(3)")
    with pytest.raises(RetryError, match=r"engine\.log"):
        blender(*lines).render(scene)
    assert (scene.out / "engine.log").read_text() == "no such symbol"


def test_without_a_report_the_last_line_is_told(scene, blender):
    with pytest.raises(RetryError, match=r"render_blend\.py failed: got Segmentation fault"):
        blender("print('Segmentation fault', file=sys.stderr)", "sys.exit(139)").render(scene)


def test_the_time_of_blender_of_the_request_and_of_writing_are_told_apart(scene, blender):
    frame = {"total_ms": 20.0, "backend": "v4", "stages": [{"name": "blend", "ran": True, "milliseconds": 9.0}]}
    picture = {"skipped": False, "reports": [frame], "evaluate_ms": 1.0, "request_ms": 30.0, "write_ms": 2.0}
    timings = blender(f"report(pictures={[picture]})").render(scene)
    medians = {name: entry["median_ms"] for name, entry in timings.figures().items()}
    assert list(medians.values()) == [9.0, 20.0, 1.0, 30.0, 2.0]
    assert "Blender's evaluation" in medians
    assert timings.backend == "v4"
