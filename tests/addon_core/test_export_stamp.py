"""Exports of one owner are kept apart from those of others, whatever lies in the folder."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from blender_addon.errors import JGHandFailure
from blender_addon.export import export_stamp
from blender_addon.export.recording import Recording
from blender_addon.renderer import engine_words
from blender_addon.renderer.engine_words import UsdChoices

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


@pytest.mark.parametrize("layer", ["hand.usda", "hand.shot.usda"])
def test_its_own_stage_is_not_replaced_when_somebody_has_changed_a_layer(tmp_path, layer):
    export_stamp.claim(tmp_path, "hand", "usd", "a")
    for name in ("hand.usda", "hand.shot.usda"):
        content = b"#usda 1.0\n"
        seal = f"# as JGHand wrote it: {hashlib.sha256(content).hexdigest()}\n".encode()
        (tmp_path / name).write_bytes(content + seal)
    export_stamp.check(tmp_path, "hand", "usd", "a")
    sealed = (tmp_path / layer).read_bytes()
    for changed in (sealed + b"# my lights\n", sealed.replace(b"1.0", b"1.1"), b'#usda 1.0\ndef "sun" {}\n'):
        (tmp_path / layer).write_bytes(changed)
        with pytest.raises(JGHandFailure, match=rf"{layer}") as told:
            export_stamp.check(tmp_path, "hand", "usd", "a")
        assert told.value.kind == "changed_export"
    (tmp_path / layer).write_bytes(b"PXR-USDC, of which the engine asks who made it")
    export_stamp.check(tmp_path, "hand", "usd", "a")


@pytest.mark.parametrize("stamp", [b"", b"\xff\xfe", b"[]", b"{}", b'{"format": "jghand export"}', b"[" * 100_000])
def test_a_damaged_stamp_is_nobodys(tmp_path, stamp):
    (tmp_path / FILES["usd"]).write_bytes(b"mine")
    export_stamp.stamp_path(tmp_path, "hand", "usd").write_bytes(stamp)
    with pytest.raises(JGHandFailure, match="not known who made it"):
        export_stamp.check(tmp_path, "hand", "usd", "a")


def test_a_folder_that_is_not_there_has_nothing(tmp_path):
    for kind in FILES:
        export_stamp.check(tmp_path / "nowhere", "hand", kind, "a")


def test_the_engine_may_replace_changed_layers_where_others_may_be_replaced():
    recording = Recording("Hand", "right", "builtin", np.zeros((1, 21, 3)), 1, 24.0)
    there = Path("somewhere")
    for allowed in (False, True):
        words = engine_words.export_usd(recording, there, there, there, UsdChoices(overwrite=allowed))
        assert ("--overwrite" in words) == allowed
