"""Locks and claims on numbered pieces of work: one process each, given back however it ends."""

from __future__ import annotations

import errno
import os
import platform
import re
import subprocess
import sys
import threading
import time

import pytest

from jghand_engine import lock
from jghand_engine.errors import InputError, RetryError
from jghand_engine.lock import Claims, locked

HOLDER = """
import sys, time
from pathlib import Path
from jghand_engine.lock import Claims
claims = Claims(Path(sys.argv[1]))
with claims.held(int(sys.argv[2])) as free:
    print(free, flush=True)
    sys.stdin.read()
"""


def holder(path, number) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path), str(number)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "True"
    return process


def test_what_another_process_holds_is_not_free_and_the_next_piece_is(tmp_path):
    other = holder(tmp_path / "claims", 7)
    claims = Claims(tmp_path / "claims")
    with claims.held(7) as seven, claims.held(8) as eight:
        assert (seven, eight) == (False, True)
    other.kill()
    other.wait()
    with claims.held(7) as seven:
        assert seven, "the system takes it back from a killed process"
    still = holder(tmp_path / "claims", 9)
    claims.close()
    assert (tmp_path / "claims").exists(), "somebody holds a piece"
    still.kill()
    still.wait()


def test_one_can_wait_for_a_piece(tmp_path):
    other = holder(tmp_path / "claims", 3)
    claims = Claims(tmp_path / "claims")
    ended = threading.Timer(0.3, other.kill)
    ended.start()
    began_s = time.monotonic()
    with claims.held(3, wait_s=60) as free:
        assert free
    assert time.monotonic() - began_s > 0.2
    other.wait()
    asleep = holder(tmp_path / "claims", 3)
    with claims.held(3, wait_s=0.2) as free:
        assert not free, "nobody waits for ever"
    asleep.kill()
    asleep.wait()
    claims.close()
    assert not (tmp_path / "claims").exists(), "the last one removes it"


def test_where_the_file_system_has_no_locks_every_claim_is_granted(tmp_path, monkeypatch):
    def refused(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(lock, "_take_bytes", refused)
    claims = Claims(tmp_path / "claims")
    with claims.held(0) as free:
        assert free
    claims.close()


@pytest.mark.skipif(sys.platform == "win32", reason="locks are of another kind there")
@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_folder_without_locks_is_refused_where_two_processes_would_do_harm(tmp_path, monkeypatch, number):
    """As on Lustre without flock, or on NFS without its daemon: to try again would not help."""

    def refused(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(lock.fcntl, "flock", refused)
    with (
        pytest.raises(InputError, match=f"{tmp_path}: wanted a file system with locks.*another disk"),
        locked(tmp_path / "lock"),
    ):
        pytest.fail("nobody else can be kept out")


@pytest.mark.skipif(sys.platform == "win32", reason="nobody else can read the file there")
def test_who_holds_a_lock_is_told_with_the_machine(tmp_path):
    (tmp_path / "lock").write_bytes(b" 12345678        \n")  # of an earlier version
    with locked(tmp_path / "lock"):
        told = re.escape(f"process {os.getpid()} on {platform.node()}. Wait")
        with pytest.raises(RetryError, match=told), locked(tmp_path / "lock"):
            pytest.fail("it is held")


def test_a_folder_that_is_not_there_is_told(tmp_path):
    with pytest.raises(RetryError, match="cannot write"):
        Claims(tmp_path / "absent" / "claims")
