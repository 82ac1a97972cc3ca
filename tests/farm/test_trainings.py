"""Lists of trainings, read and refused."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from jghand_engine.cli import main
from jghand_engine.cli.train_many import TrainMany
from jghand_engine.errors import InputError
from jghand_engine.farm import trainings
from jghand_engine.farm.records import FarmFolder, Record, State
from jghand_engine.farm.runner import Runner
from jghand_engine.farm.trainings import Training, read_trainings


@pytest.fixture
def listed(tmp_path):
    """Writes a list beside two folders."""
    for name in ("id3", "id4"):
        (tmp_path / "captures" / name).mkdir(parents=True)

    def write(text: str):
        path = tmp_path / "list.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_what_holds_for_all_holds_until_a_training_says_otherwise(listed, tmp_path):
    path = listed(
        "minutes = 60\nall_pictures = true\n"
        '[[training]]\nfolder = "captures/id3"\n'
        '[[training]]\nfolder = "captures/id4"\nname = "other hand"\nminutes = 1.5\nall_pictures = false\n'
        'sequences = ["a", "b"]\n'
    )
    first, second = read_trainings(path)
    folder = tmp_path / "captures"
    assert first == Training("id3", ("train", str(folder / "id3"), "--minutes", "60", "--all-pictures"))
    assert second == Training("other hand", ("train", str(folder / "id4"), "--minutes", "1.5", "--sequences", "a", "b"))


def test_the_order_of_the_lines_means_nothing(listed):
    one, other = "steps = 100\nseed = 1\n", "seed = 1\nsteps = 100\n"
    table = '[[training]]\nfolder = "captures/id3"\n'
    assert read_trainings(listed(one + table)) == read_trainings(listed(other + table))
    assert read_trainings(listed(table + one)) == read_trainings(listed(one + table))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "[[training]] tables"),
        ("training = 3", "[[training]] tables"),
        ("[training]\nfolder = 'captures/id3'", "[[training]] tables"),
        ("[[training]]", 'wanted folder = "…"'),
        ("[[training]]\nfolder = 3", 'wanted folder = "…"'),
        ("[[training]]\nfolder = 'absent'", "training 1: folder"),
        ("[[training]]\nfolder = 'captures/id3'\nmintues = 3", "mintues: wanted folder, name and options"),
        ("[[training]]\nfolder = 'captures/id3'\nminutes = '3'", "minutes: wanted int or float"),
        ("[[training]]\nfolder = 'captures/id3'\nsteps = true", "steps: wanted int"),
        ("[[training]]\nfolder = 'captures/id3'\nsequences = []", "sequences: wanted a list of texts"),
        ("[[training]]\nfolder = 'captures/id3'\nname = '../up'", "name: wanted letters"),
        ("[[training]]\nfolder = 'captures/id3'\nname = '..'", "name: wanted letters"),
        ("[[training]]\nfolder = 'captures/id3'\n" * 2, "id3 more than once"),
        (
            "[[training]]\nfolder = 'captures/id3'\nname='A'\n[[training]]\nfolder = 'captures/id3'\nname='a'",
            "more than",
        ),
        ("[[training", "wanted TOML"),
        ("a = " + "[" * 5000, "wanted TOML"),
        ("\xff", "wanted TOML"),
    ],
)
def test_a_list_that_makes_no_sense_is_refused_by_the_entry(listed, text, told):
    path = listed(text)
    if text == "\xff":
        path.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError) as refused:
        read_trainings(path)
    assert told in str(refused.value)


@pytest.mark.parametrize(
    ("entry", "told"),
    [("steps = 0", "--steps"), ("preset = 'best'", "options that jghand train takes"), ("seed = -1", "--seed"),
     ("protocol = 'test-capture0'\nhand = 'right'", "--protocol"), ("minutes = inf", "--minutes"),
     ("device = 'cuda'", "device: wanted the CPU")],
)  # fmt: skip
def test_what_train_would_refuse_is_refused_before_any_job(listed, tmp_path, capsys, entry, told):
    path = listed(f"[[training]]\nfolder = 'captures/id3'\n{entry}\n")
    assert main(["train-many", str(path), "--out", str(tmp_path / "out")]) == 2
    assert told in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


def test_what_trainings_have_in_common_is_looked_at_once(listed, tmp_path, monkeypatch):
    many = "".join(f"[[training]]\nfolder = 'captures/id3'\nname = 'hand {number}'\n" for number in range(50))
    path = listed(f"steps = 100\n{many}[[training]]\nfolder = 'captures/id4'\nseed = 3\n")
    looked_at = []
    monkeypatch.setattr(TrainMany, "_check", lambda self, training: looked_at.append(training.name))
    monkeypatch.setattr(TrainMany, "_see_through", lambda *_: 0)
    monkeypatch.setattr(TrainMany, "_executor", lambda *_: Idle())
    assert main(["train-many", str(path), "--out", str(tmp_path / "out")]) == 0
    assert looked_at == ["hand 0", "id4"]


class Idle:
    """A scheduler of which nothing is asked."""

    def __init__(self) -> None:
        self.at_once: int | None = None
        self.poll_s, self.outlived = 0.0, False

    def submit(self, jobs):
        raise AssertionError

    def alive(self, numbers):
        raise AssertionError

    def stop(self):
        raise AssertionError


def test_looking_at_a_list_waits_for_no_imports(listed, tmp_path):
    path = listed("[[training]]\nfolder = 'captures/id3'\nhand = 'right'\nsteps = 0\n")
    code = "import sys; from jghand_engine.cli import main; main(sys.argv[1:]); sys.exit('torch' in sys.modules)"
    words = ["train-many", str(path), "--out", str(tmp_path / "out")]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=60)
    assert "--steps" in done.stderr
    assert done.returncode == 0


def test_what_a_list_cannot_say_is_told_in_other_words(tmp_path, capsys):
    folder = FarmFolder(tmp_path)
    folder.make()
    folder.write_record("id3", Record([], State.FAILED, 1, 2, "Start anew with --fresh."))
    runner = Runner([Training("id3", ())], folder, Idle())
    TrainMany(tmp_path / "list.toml", tmp_path)._show(runner, folder)
    assert f"begins a training anew when {tmp_path / 'id3.training'} is moved away" in capsys.readouterr().out


def test_a_list_without_an_end_is_refused_when_it_is_too_long(listed, monkeypatch):
    monkeypatch.setattr(trainings, "LIST_BYTES_MAX", 1000)
    path = listed("# a remark\n" * 100)
    with pytest.raises(InputError, match="at most 1000 bytes"):
        read_trainings(path)
    with pytest.raises(InputError, match="at most 1000 bytes"):
        read_trainings(Path("/dev/zero"))


def test_a_list_of_more_trainings_than_an_array_of_slurm_holds_is_refused(listed):
    with pytest.raises(InputError, match="at most 1000 trainings, got 1001"):
        read_trainings(listed("[[training]]\n" * 1001))


def test_a_list_that_is_not_there_is_told(tmp_path, capsys):
    assert main(["train-many", str(tmp_path / "absent.toml"), "--out", str(tmp_path / "out")]) == 2
    assert "cannot read" in capsys.readouterr().err


def test_options_of_a_cluster_without_one_are_refused(listed, tmp_path, capsys, monkeypatch):
    path = listed("[[training]]\nfolder = 'captures/id3'\n")
    assert main(["train-many", str(path), "--out", str(tmp_path / "out"), "--cpus", "3"]) == 2
    assert "--executor local" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    slurm = ("--executor", "slurm")
    for words, told in (
        (("--time-limit", "2"), "--time-limit: wanted 10 minutes"),
        (("--cpus", "0"), "--cpus: wanted more than 0"),
        (("--memory-gb", "nan"), "--memory-gb: wanted more than 0"),
        (("--sbatch", "account"), "--sbatch: wanted NAME=VALUE"),
    ):
        assert main(["train-many", str(path), "--out", str(tmp_path / "out"), *slurm, *words]) == 2
        assert told in capsys.readouterr().err
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["train-many", str(path), "--out", str(tmp_path / "out"), "--executor", "slurm"]) == 2
    assert "no srun or squeue" in capsys.readouterr().err
