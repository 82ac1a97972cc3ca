"""What all tests share."""

import os
import signal
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

# points that are placed in one test serve the others; the user's own cache is neither used nor filled
_CACHE = tempfile.TemporaryDirectory(prefix="jghand_tests_", ignore_cleanup_errors=True)


def pytest_configure(config: pytest.Config) -> None:
    """Ctrl-C interrupts, also where the tests were started in the background of a shell, which has it ignored."""
    config.addinivalue_line("markers", "graphics_card: draws by WebGPU; skipped, with the reason, where nothing does")
    os.environ["JGHAND_CACHE_DIR"] = _CACHE.name
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # nothing here is timed: on a busy machine an example may take any time
    settings.register_profile("untimed", deadline=None)
    settings.load_profile("untimed")


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("graphics_card"):
        from graphics_card import needs_gpu  # the engine, which the tests of the extension do without

        needs_gpu()


@pytest.fixture
def soft_fingers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fingers before others without the edges of surfaces, as a graphics card draws them."""
    from jghand_engine.native import contract

    monkeypatch.setattr(contract, "OTHERS_PART", 1.0)
    monkeypatch.setattr(contract, "EDGE_STEEPNESS", 1e9)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real input that is not part of the project; a test that wants it is skipped where it is absent."""
    named = os.environ.get("JGHAND_SHARED_DATA", "")
    if not named or not Path(named).is_dir():
        pytest.skip(f"real input is not here: JGHAND_SHARED_DATA {f'is {named}' if named else 'is not set'}")
    return Path(named)
