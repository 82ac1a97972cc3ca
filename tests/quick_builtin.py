"""The built-in hand as tests of commands and requests have it, which look at no pore of it."""

import pytest
from small_avatars import coarse_builtin

from jghand_engine.avatar import BUILTIN, builtin


@pytest.fixture(autouse=True, scope="module")
def quick_builtin():
    """The built-in hand of few Gaussians and texels: ready and exported at once."""
    hand, load = coarse_builtin(), builtin._load_right
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(builtin, "_load_right", lambda name: hand if name == BUILTIN else load(name))
        yield
