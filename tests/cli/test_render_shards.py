"""`jghand render --shard --skip-existing`: parts that are one whole, workers that meet, are killed, and go on."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from jghand_engine.captures.image_files import probe_image
from jghand_engine.cli import main
from jghand_engine.cli.frame_files import FrameWriter
from jghand_engine.errors import InputError
from jghand_engine.export.frame_folder import STAMP, Shard, settle_folder
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.motion.files import write_motion
from jghand_engine.template.builtin import load_template

SMALL = ("--poses", "open,fist", "--avatar", "painted", "--size", "64x48", "--threads", "1")
TEN = (*SMALL, "--frames", "0-9")


def render(folder: Path, *words: str) -> int:
    return main(["render", *(words if "--frames" in words else (*TEN, *words)), "--out", str(folder)])


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, bytes]:
    """What one run of TEN leaves."""
    folder = tmp_path_factory.mktemp("render") / "whole"
    assert render(folder) == 0
    return contents(folder)


@pytest.fixture
def half(tmp_path) -> Path:
    """A render of which the second of two shards is missing."""
    assert render(tmp_path / "half", "--shard", "1/2") == 0
    return tmp_path / "half"


def test_shards_in_any_order_are_byte_for_byte_what_one_run_makes(tmp_path, whole):
    for number in (3, 1, 2):
        assert render(tmp_path / "out", "--shard", f"{number}/3", "--skip-existing") == 0
    assert contents(tmp_path / "out") == whole


@pytest.mark.parametrize("words", [("--shutter", "0.7"), ("--aperture", "20"), ("--background", "#336699")])
def test_so_they_are_with_a_shutter_a_lens_or_a_background(tmp_path, words):
    some = (*SMALL, "--frames", "8:20:3", "--preset", "viewport")
    assert render(tmp_path / "whole", *some, *words) == 0
    for number in (2, 1):
        assert render(tmp_path / "out", *some, *words, "--shard", f"{number}/2") == 0
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


@pytest.mark.parametrize("avatar", ["painted", "builtin"])
def test_a_hand_that_hardly_moves_does_not_remember_earlier_frames(tmp_path, avatar):
    """Other renders keep what they posed until a joint has moved by 0.05 mm, and correctives until one has turned."""
    canonical_m = load_template().joints_m
    poses_m = pose_sequence_of_names(["open", "fist"], canonical_m, handedness=Handedness.RIGHT).joints_m
    # a hand that drifts, and one whose fingers creep
    step_m = np.array([2e-5, 0, 0])
    drift_m = poses_m[12] + step_m * np.arange(4)[:, None, None]
    creep_m = poses_m[12] + (poses_m[13] - poses_m[12]) * np.linspace(0, 0.004, 4)[:, None, None]
    write_motion(tmp_path / "slow.npz", PoseSequence(np.concatenate([drift_m, creep_m]), 30.0, Handedness.RIGHT))
    words = ("--motion", str(tmp_path / "slow.npz"), "--avatar", avatar, "--size", "160x120", "--threads", "1")
    words += ("--frames", ":", "--keep-bone-lengths")
    assert render(tmp_path / "whole", *words) == 0
    for number in (2, 1):
        assert render(tmp_path / "out", *words, "--shard", f"{number}/2") == 0
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


def test_a_second_run_draws_nothing_and_touches_nothing(half, capsys, tmp_path):
    times = {path: path.stat().st_mtime_ns for path in half.glob("*.png")}
    capsys.readouterr()
    figures = tmp_path / "figures.json"
    assert render(half, "--shard", "1/2", "--skip-existing", "--json", str(figures)) == 0
    assert "0 drawn, 5 there already; others are still missing" in capsys.readouterr().out
    told = json.loads(figures.read_text())
    assert (told["made"], told["kept"], told["broken"], told["complete"]) == (0, 5, 0, False)
    assert {path: path.stat().st_mtime_ns for path in half.glob("*.png")} == times


@pytest.mark.parametrize("words", [(), ("--skip-existing",)])
def test_a_shard_does_not_begin_among_pictures_of_another_render(half, capsys, words):
    """They would stay beside its own: half of them of one camera, half of the other."""
    before = contents(half)
    assert render(half, "--camera", "back", "--shard", "2/2", *words) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "wanted frames that this very command made, got frames of another look" in error
    assert "a run without --shard and --skip-existing replaces what is there" in error
    assert contents(half) == before


def test_of_two_different_renders_that_begin_together_in_an_empty_folder_one_is_refused(tmp_path):
    """Such as of a machine that still has an older motion."""
    with ThreadPoolExecutor() as pool:
        begun = [pool.submit(settle_folder, tmp_path, {"motion": name}, [], Shard(1, 2)) for name in "ab"]
    assert sum(isinstance(one.exception(), InputError) for one in begun) == 1
    assert all(one.exception() is None or isinstance(one.exception(), InputError) for one in begun)


def test_a_plain_run_that_is_stopped_leaves_no_picture_that_a_later_one_would_keep(half, whole, monkeypatch):
    """The folder then says what the new pictures are made from: the old ones must be gone."""

    def stopped(_writer: FrameWriter, _index: int) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(FrameWriter, "write", stopped)
        assert render(half, "--camera", "back") == 130
    assert not list(half.glob("*.png"))
    assert render(half, "--camera", "back", "--skip-existing") == 0
    assert contents(half) != whole


def test_half_written_and_damaged_pictures_are_made_again_and_no_others(half, whole, capsys):
    paths = sorted(half.glob("*.png"))
    paths[0].write_bytes(whole[paths[0].name][:-30])
    paths[1].write_bytes(b"")
    damaged = bytearray(whole[paths[2].name])
    damaged[damaged.rindex(b"IDAT") + 9] ^= 0xFF
    paths[2].write_bytes(bytes(damaged))
    assert render(half, "--skip-existing") == 0
    assert "8 drawn, 2 there already, 3 of the drawn ones were there, but broken." in capsys.readouterr().out
    assert contents(half) == whole


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--preset", "draft"), "of another settings, look"),
        (("--camera", "back"), "of another look"),
        (("--poses", "open,point"), "of another motion"),
        (("--avatar", "builtin"), "of another avatar"),
        (("--no-forearm",), "of another look"),
        (("--passes", "joints"), "of another settings, look"),
    ],
)
def test_pictures_of_something_else_are_refused_and_stay(half, capsys, words, told):
    before = contents(half)
    assert render(half, "--frames", "0-9", *SMALL, *words, "--skip-existing") == 2
    error = " ".join(capsys.readouterr().err.split())
    assert told in error
    assert "--shard and --skip-existing replaces" in error
    assert contents(half) == before


def test_pictures_of_nobody_knows_what_are_refused_and_stay(half, capsys):
    (half / STAMP).unlink()
    before = contents(half)
    assert render(half, "--skip-existing") == 2
    assert "frames of an unknown render" in capsys.readouterr().err
    assert contents(half) == before


@pytest.mark.parametrize("passes", ["joints", "depth,normal,ids,alpha,joints"])
def test_ground_truth_of_shards_is_that_of_one_run(tmp_path, passes):
    if "depth" in passes:
        pytest.importorskip("OpenEXR", reason="the extra formats is not installed")
    words = (*SMALL, "--frames", "4:7", "--passes", passes)
    assert render(tmp_path / "whole", *words) == 0
    assert render(tmp_path / "out", *words, "--shard", "2/2") == 0
    assert not (tmp_path / "out" / "joints.json").exists(), "not yet: half of the pictures are missing"
    assert render(tmp_path / "out", *words, "--shard", "1/2", "--skip-existing") == 0
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


def test_a_picture_whose_maps_are_missing_or_broken_is_made_again(tmp_path):
    pytest.importorskip("OpenEXR", reason="the extra formats is not installed")
    words = (*SMALL, "--frames", "4:6", "--passes", "depth,joints")
    assert render(tmp_path, *words) == 0
    before = contents(tmp_path)
    (tmp_path / "passes" / "frame_00004.exr").unlink()
    (tmp_path / "passes" / "frame_00005.exr").write_bytes(before["passes/frame_00005.exr"][:-100])
    # whole, but of another size
    assert main(["render", *words, "--size", "32x24", "--out", str(tmp_path / "other")]) == 0
    shutil.move(tmp_path / "other" / "passes" / "frame_00006.exr", tmp_path / "passes" / "frame_00006.exr")
    shutil.rmtree(tmp_path / "other")
    assert render(tmp_path, *words, "--skip-existing") == 0
    assert contents(tmp_path) == before


# ---- workers ---------------------------------------------------------------------------------------------------------


def started(folder: Path, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "jghand_engine", "render", *words, "--out", str(folder)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


MANY = (*SMALL[:-4], "--size", "160x120", "--threads", "1", "--skip-existing")


def test_a_killed_worker_loses_at_most_the_picture_that_it_was_at(tmp_path):
    out = tmp_path / "out"
    worker = started(out, *MANY)
    until = time.monotonic() + 60
    while len(list(out.glob("frame_*.png"))) < 4:
        assert worker.poll() is None, worker.communicate()
        assert time.monotonic() < until
        time.sleep(0.002)
    worker.send_signal(signal.SIGKILL)
    worker.communicate()
    there = contents(out)
    names = [name for name in there if name.startswith("frame_")]
    for name in names:
        probe_image(out / name)
    assert len([name for name in there if name.startswith(".frame_")]) <= 1
    figures = tmp_path / "figures.json"
    assert main(["render", *MANY, "--out", str(out), "--json", str(figures)]) == 0
    told = json.loads(figures.read_text())
    assert (told["kept"], told["broken"], told["complete"]) == (len(names), 0, True)
    assert main(["render", *MANY[:-1], "--out", str(tmp_path / "whole")]) == 0
    left = {name for name in there if name.startswith(".frame_")}
    assert {name: content for name, content in contents(out).items() if name not in left} == contents(
        tmp_path / "whole"
    )


def test_two_workers_that_meet_make_what_one_makes(tmp_path):
    out = tmp_path / "out"
    files = [tmp_path / f"{number}.json" for number in range(2)]
    workers = [started(out, *MANY, "--json", str(file)) for file in files]
    for worker in workers:
        said = worker.communicate(timeout=120)
        assert worker.returncode == 0, said
    told = [json.loads(file.read_text()) for file in files]
    total = len(list(out.glob("frame_*.png")))
    assert sum(one["made"] for one in told) >= total
    assert all(one["made"] + one["kept"] == total for one in told)
    assert all(one["complete"] for one in told)
    assert main(["render", *MANY[:-1], "--out", str(tmp_path / "whole")]) == 0
    assert contents(out) == contents(tmp_path / "whole")
