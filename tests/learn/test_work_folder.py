"""The finished avatar: written over the training's own work, never over another's."""

from dataclasses import replace

import numpy as np
import pytest

from jghand_engine.avatar.builtin import load_painted
from jghand_engine.avatar.file import load_avatar
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.work_folder import check_output, write_output


@pytest.fixture(scope="module")
def avatars():
    """Two of 20 Gaussians that differ."""
    first = load_painted(handedness=Handedness.RIGHT).prefix(20)
    return first, replace(first, opacity=first.opacity * 0.5)


def test_a_training_may_replace_what_it_wrote(tmp_path, avatars):
    out, work = tmp_path / "hand.jghand", tmp_path / "work"
    for avatar in avatars:
        check_output(out, work, overwrite=False)
        write_output(out, work, avatar)
    assert np.allclose(load_avatar(out).opacity, avatars[1].opacity, atol=1 / 255)


@pytest.mark.parametrize("record", [None, b"", b"[1]", b'{"sha256": 3}'])
def test_a_file_of_somebody_else_is_never_replaced_unasked(tmp_path, avatars, record):
    out, work = tmp_path / "hand.jghand", tmp_path / "work"
    write_output(out, work, avatars[0])
    if record is None:
        out.write_bytes(b"mine")
    else:
        (work / "output.json").write_bytes(record)
    with pytest.raises(InputError, match="--overwrite"):
        check_output(out, work, overwrite=False)
    check_output(out, work, overwrite=True)
