"""What signals mean to a command."""

import os
import signal
import sys

import pytest

from jghand_engine.cli.failures import polite_kill_is_ctrl_c

if sys.platform == "win32":
    pytest.skip("there os.kill ends a process outright", allow_module_level=True)

POLITE = [signal.SIGTERM, signal.SIGHUP]


@pytest.mark.parametrize("number", POLITE)
def test_a_polite_kill_and_a_closed_terminal_are_ctrl_c_for_so_long(number):
    # `nohup` starts programs with some of them ignored
    before = signal.signal(number, signal.SIG_DFL)
    try:
        with pytest.raises(KeyboardInterrupt), polite_kill_is_ctrl_c():
            os.kill(os.getpid(), number)
        assert signal.getsignal(number) == signal.SIG_DFL
    finally:
        signal.signal(number, before)


@pytest.mark.parametrize("number", POLITE)
def test_what_is_ignored_stays_so(number):
    before = signal.signal(number, signal.SIG_IGN)
    try:
        with polite_kill_is_ctrl_c():
            os.kill(os.getpid(), number)
        assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)
