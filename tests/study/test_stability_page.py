"""The pages of the stability study: whole, self-contained, honest about what is missed; and the command."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from jghand_engine.cli import main
from jghand_engine.errors import InputError
from jghand_engine.study import figures, stability, stability_plot, stability_views
from jghand_engine.study.stability import Stability, short
from jghand_engine.study.stability_curves import AutocastRow, Curve
from jghand_engine.study.stability_measures import HandRow, Measured
from jghand_engine.study.stability_page import SECTION, html_page, markdown_page
from jghand_engine.study.stability_pictures import PictureError, PictureRow
from jghand_engine.study.stability_views import ViewPair

pytest.importorskip("matplotlib")

GOOD = Measured(finite=True, gradient=42.0, precision_mm=3e-5, nudged_mm=1.1, axes_mm=1.8)
PICTURE = PictureError(worst=1e-4, flipped=0, finite=True, visible=7, invalid=0)


@pytest.fixture
def study() -> Stability:
    bad = replace(GOOD, nudged_mm=6.1)
    broken = replace(GOOD, gradient=float("inf"), finite=False)
    hands = [
        HandRow("good <hand>", [], GOOD, broken, PICTURE),
        HandRow("bad hand", ["a bone has no length"], bad, GOOD, PICTURE, ["a nudge of 0.5 mm moves skin over 2 mm"]),
    ]
    distance = np.geomspace(10, 1e-3, 5)
    usual = np.array([1.0, 10, 100, np.nan, np.nan])
    curve = Curve("straight_twist", "title", "below", "x", "y", "way", distance, np.full(5, 0.5), usual, visible=2.0)
    pictures = [PictureRow("picture", PICTURE, 1.0, True, 0.5)]
    return Stability(hands, [], pictures, [AutocastRow("float16", 0.0, 0.5)], [curve])


def views() -> list[ViewPair]:
    blank = np.full((40, 40, 3), 200, np.uint8)
    return [ViewPair("view", blank, blank)]


def test_the_page_has_every_case_and_says_what_is_missed(study):
    text = markdown_page(study)
    assert "| good <hand> | yes | 42 | not finite |" in text
    assert "6.1 ✗" in text
    assert "* bad hand: a nudge of 0.5 mm moves skin over 2 mm" in text
    assert study.verdict == "3 of 3 hard cases have finite values and gradients; 2 meet every bound, 1 miss one."


def test_the_html_page_needs_nothing_from_outside(study):
    svg = figures.svg_of(stability_plot.draw_figure(study.curves, views()))
    page = html_page(study, svg)
    assert "<script" not in page
    assert "good &lt;hand&gt;" in page
    assert re.findall(r"(?:src|href)=[\"']?https?:", page) == []
    assert re.findall(r"@import|url\(['\"]?https?:", page) == []


def test_the_picture_is_small_and_opens(study):
    picture = figures.png_of(stability_plot.draw_figure(study.curves, views()))
    assert len(picture) < 300_000
    assert Image.open(io.BytesIO(picture)).width > 1200


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (1.84, "1.8"), (6112.0, "6112"), (3.1e-5, "3e-5"), (7e23, "7e23"), (float("nan"), "not finite")],
)
def test_numbers_are_short(value, text):
    assert short(value) == text


def test_only_the_marked_part_of_a_readme_changes():
    begin, end = SECTION.begin, SECTION.end
    assert SECTION.renewed(f"a\n{begin}\nold\n{end}\nb\n", f"{begin}\nnew\n{end}") == f"a\n{begin}\nnew\n{end}\nb\n"
    with pytest.raises(InputError, match="marks"):
        SECTION.renewed("nothing", "new")


def test_the_command_writes_folder_and_checkout(study, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(stability, "measure_stability", lambda tick: study)
    monkeypatch.setattr(stability_views, "view_pairs", views)
    checkout = tmp_path / "checkout"
    (checkout / "docs").mkdir(parents=True)
    (checkout / "README.md").write_text(f"# Name\n{SECTION.begin}\n{SECTION.end}\n", encoding="utf-8")
    out = tmp_path / "study"
    assert main(["study", "stability", "--out", str(out), "--checkout", str(checkout)]) == 0
    assert "2 meet every bound" in capsys.readouterr().out
    names = ["STABILITY.md", "stability.html", "stability.json", "stability.png"]
    assert sorted(path.name for path in out.iterdir()) == names
    hands = json.loads((out / "stability.json").read_text())["hands"]
    assert hands[0]["usual"]["gradient"] is None
    assert "docs/stability.png" in (checkout / "README.md").read_text(encoding="utf-8")
    assert sorted(path.name for path in (checkout / "docs").iterdir()) == ["STABILITY.md", "stability.png"]


def test_places_that_are_none_are_refused_before_anything_is_measured(tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("")
    assert main(["study", "stability", "--out", str(file)]) == 2
    assert main(["study", "stability", "--checkout", str(tmp_path)]) == 2
    assert "docs/" in capsys.readouterr().err
