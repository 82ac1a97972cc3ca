"""Stamps of files: what is drawn waits for no disk."""

from __future__ import annotations

import threading
import time

import pytest

from blender_addon.core import limits
from blender_addon.core.file_stamps import UNKNOWN, FileStamps


class Disk:
    """A disk that can hang, and counts who asks it."""

    def __init__(self) -> None:
        self.answers = threading.Event()
        self.answers.set()
        self.stamp, self.asked = "first", 0

    def look(self, _path: str) -> str:
        self.asked += 1
        self.answers.wait()
        return self.stamp


@pytest.fixture
def disk(monkeypatch):
    monkeypatch.setattr(limits, "FILE_WAIT_S", 5.0)  # a busy machine is no disk that hangs
    one = Disk()
    yield one
    one.answers.set()


def test_the_first_answer_of_a_disk_that_is_there_is_its_own(disk):
    assert FileStamps(disk.look).get("a") == "first"


def test_a_changed_file_is_noticed_later_by_itself_and_at_once_by_who_wants_it_fresh(disk, monkeypatch):
    monkeypatch.setattr(limits, "FILE_LOOK_S", 1e9)
    stamps = FileStamps(disk.look)
    stamps.get("a")
    disk.stamp = "second"
    assert stamps.get("a") == "first"
    assert disk.asked == 1
    assert stamps.get("a", fresh=True) == "second"
    disk.stamp = "third"
    monkeypatch.setattr(limits, "FILE_LOOK_S", 0.0)
    ends_s = time.monotonic() + 30.0
    while stamps.get("a") != "third":
        assert time.monotonic() < ends_s
        time.sleep(0.005)


def test_a_disk_that_hangs_is_waited_for_once_and_asked_once(disk, monkeypatch):
    monkeypatch.setattr(limits, "FILE_LOOK_S", 0.0)
    monkeypatch.setattr(limits, "FILE_WAIT_S", 0.2)
    disk.answers.clear()
    stamps = FileStamps(disk.look)
    assert stamps.get("a") == UNKNOWN
    monkeypatch.setattr(limits, "FILE_WAIT_S", 60.0)
    for _ in range(100):
        assert stamps.get("a") == UNKNOWN
    assert disk.asked == 1


def test_one_file_that_hangs_holds_no_other_one_up(monkeypatch):
    monkeypatch.setattr(limits, "FILE_WAIT_S", 0.2)
    over = threading.Event()

    def look(path: str) -> str:
        if path == "gone":
            over.wait()
        return path

    stamps = FileStamps(look)
    try:
        assert stamps.get("gone") == UNKNOWN
        monkeypatch.setattr(limits, "FILE_WAIT_S", 5.0)
        assert stamps.get("here") == "here"
    finally:
        over.set()


def test_what_is_forgotten_is_looked_at_anew(disk):
    stamps = FileStamps(disk.look)
    stamps.get("a")
    disk.stamp = "second"
    stamps.clear()
    assert stamps.get("a") == "second"
