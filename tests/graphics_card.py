"""The graphics card that tests draw on; where there is none, software that stands in for one (Mesa's llvmpipe)."""

import functools
import os

import pytest

from jghand_engine.errors import InputError
from jghand_engine.gpu import device


def needs_gpu() -> None:
    """Skips the test, with the reason, where nothing draws by WebGPU; with JGHAND_REQUIRE_GPU it fails instead."""
    if why := missing():
        if os.environ.get("JGHAND_REQUIRE_GPU") == "1":
            pytest.fail(why)
        pytest.skip(why)


@functools.cache
def missing() -> str:
    os.environ.setdefault(device.ADAPTER_VARIABLE, device.ANY)
    try:
        device.open_device()
    except InputError as error:
        return str(error)
    return ""
