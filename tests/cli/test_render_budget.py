"""`jghand render --budget-ms`: what the budget buys is what is drawn."""

import json
from dataclasses import replace

import pytest
from small_avatars import trained_avatar

from jghand_engine.avatar.file import save_avatar
from jghand_engine.cli import main
from jghand_engine.render import budget
from jghand_engine.render.settings import preset
from jghand_engine.template.builtin import load_template

NAME = "viewport, no correctives"


@pytest.fixture
def avatar(tmp_path, monkeypatch):
    """A trained hand on a machine that can only afford it without correctives."""
    chosen = budget.Chosen(replace(preset("viewport"), effects=budget.NO_CORRECTIVES), NAME, f"5 ms buy {NAME}.")
    monkeypatch.setattr(budget, "best_for", lambda *_: chosen)
    made = trained_avatar(300)
    save_avatar(tmp_path / "hand.jghand", replace(made, info=replace(made.info, template=load_template().identifier)))
    return tmp_path / "hand.jghand"


@pytest.mark.parametrize(("words", "ran"), [((), False), (("--effects", "all"), True)], ids=["auto", "all"])
def test_what_a_budget_leaves_out_stays_out_unless_it_is_asked_for(avatar, tmp_path, capsys, words, ran):
    figures = tmp_path / "figures.json"
    rendered = ["render", "--poses", "open,fist", "--frames", "0:30:10", "--size", "64x48", "--avatar", str(avatar)]
    told = ["--budget-ms", "5", "--json", str(figures), "--out", str(tmp_path / "out")]
    assert main([*rendered, *told, *words]) == 0
    assert NAME in capsys.readouterr().out
    correctives = json.loads(figures.read_text())["effects"]["correctives"]
    assert (correctives["ran"] > 0) is ran
