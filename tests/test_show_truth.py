"""The script that shows a hand beside its truth: which pictures it keeps."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
import show_truth

from jghand_engine.captures.skin.person import Person
from jghand_engine.errors import InputError


@pytest.mark.parametrize(
    "change",
    [{"identity": "child"}, {"person": Person(seed=99)}, {"views": ("fist",)}, {"size": "96x108"}, {"samples": 2}],
    ids=lambda change: next(iter(change)),
)
def test_pictures_of_other_options_are_refused(tmp_path, monkeypatch, change):
    options = show_truth.Options(tmp_path)
    plan = SimpleNamespace(description=show_truth.described(options))
    monkeypatch.setattr(show_truth, "read_plan", lambda folder: plan)
    with pytest.raises(InputError, match=next(iter(change))):
        show_truth.opened(replace(options, **change))
    assert show_truth.opened(replace(options, avatar="strong", cell_px=8)) is plan
