"""The native library in every variant that this processor runs."""

import pytest

from jghand_engine.native import library as native_library
from jghand_engine.native.binding import Library


@pytest.fixture(scope="module", params=native_library.runnable_variants() or ["none"])
def library(request) -> Library:
    if request.param == "none":
        pytest.skip("no native variant runs on this processor")
    loaded = native_library.load(request.param)
    assert loaded is not None
    return loaded
