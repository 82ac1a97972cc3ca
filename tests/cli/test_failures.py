"""Every way a command can end badly has a sentence and an exit code."""

import errno

import pytest
import torch

from jghand_engine.cli.failures import explain
from jghand_engine.errors import InputError, MemoryLimitError, RetryError


class OutOfMemoryError(RuntimeError):
    """As torch's own is called."""


@pytest.mark.parametrize(
    ("error", "exit_code", "word"),
    [
        (InputError("joints", wanted="21", came="20"), 2, "wanted 21, got 20"),
        (RetryError("cannot write x: the disk is full"), 3, "disk is full"),
        (MemoryLimitError("a picture of 9 pixels"), 4, "9 pixels"),
        (MemoryError(), 4, "memory"),
        (OutOfMemoryError("CUDA out of memory"), 4, "memory"),
        (OSError(errno.ENOSPC, "No space left on device", "x.png"), 3, "disk is full"),
        (PermissionError(errno.EACCES, "Permission denied", "x.png"), 2, "x.png"),
        (FileNotFoundError(errno.ENOENT, "No such file", "x.npz"), 2, "x.npz"),
        (OSError(errno.EIO, "Input/output error"), 3, "Input/output"),
        (KeyboardInterrupt(), 130, "Stopped"),
        (ModuleNotFoundError("No module named 'torch'", name="torch"), 2, "jghand[learn]"),
        (ZeroDivisionError("division by zero"), 1, "JGHAND_DEBUG=1"),
    ],
)
def test_an_error_has_its_exit_code_and_its_sentence(error, exit_code, word):
    failure = explain(error)
    assert failure.exit_code == exit_code
    assert word in failure.sentence
    assert "\n" not in failure.sentence


def test_what_torch_really_raises_without_memory_is_understood():
    with pytest.raises(RuntimeError) as caught:
        torch.empty(10**15)
    assert explain(caught.value).exit_code == 4
