"""Exports of one owner are kept apart from those of others, whatever lies in the folder."""

from __future__ import annotations

import pytest

from blender_addon.errors import JGHandFailure
from blender_addon.export import export_stamp

FILES = {"usd": "hand.usda", "motion": "hand.npz", "ply": "hand.0001.ply"}


@pytest.mark.parametrize("kind", FILES)
def test_only_the_owner_may_write_again(tmp_path, kind):
    export_stamp.check(tmp_path, "hand", kind, "a")
    export_stamp.claim(tmp_path, "hand", kind, "a")
    export_stamp.check(tmp_path, "hand", kind, "b")  # nothing of it is there yet
    (tmp_path / FILES[kind]).write_bytes(b"mine")
    export_stamp.check(tmp_path, "hand", kind, "a")
    with pytest.raises(JGHandFailure, match="of a"):
        export_stamp.check(tmp_path, "hand", kind, "b")
    for other in set(FILES) - {kind}:
        export_stamp.check(tmp_path, "hand", other, "b")
    export_stamp.check(tmp_path, "hand2", kind, "b")


@pytest.mark.parametrize("stamp", [b"", b"\xff\xfe", b"[]", b"{}", b'{"format": "jghand export"}', b"[" * 100_000])
def test_a_damaged_stamp_is_nobodys(tmp_path, stamp):
    (tmp_path / FILES["usd"]).write_bytes(b"mine")
    export_stamp.stamp_path(tmp_path, "hand", "usd").write_bytes(stamp)
    with pytest.raises(JGHandFailure, match="not known who made it"):
        export_stamp.check(tmp_path, "hand", "usd", "a")


def test_a_folder_that_is_not_there_has_nothing(tmp_path):
    for kind in FILES:
        export_stamp.check(tmp_path / "nowhere", "hand", kind, "a")
