"""What `jghand study` writes: tables, figures and a plot in one folder, and nothing into anybody's pages."""

import csv
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_avatars import small_avatar

from jghand_engine.avatar.file import save_avatar
from jghand_engine.cli import main
from jghand_engine.study import accuracy_measures, accuracy_plot, stability, stability_plot
from jghand_engine.study.accuracy import Accuracy, Row, TruthScore
from jghand_engine.study.accuracy_growth import PANELS, Growth
from jghand_engine.study.accuracy_reference import Error
from jghand_engine.study.accuracy_variants import BLEND, TOGETHER
from jghand_engine.study.report import png_of
from jghand_engine.study.stability import Stability
from jghand_engine.study.stability_curves import Curve
from jghand_engine.study.stability_measures import HandRow, Measured
from jghand_engine.study.stability_pictures import PictureError, PictureRow

pytest.importorskip("matplotlib")

ROOT = Path(__file__).parents[2]
CROP = np.random.default_rng(0).integers(0, 255, (40, 40, 3), np.uint8)
GOOD = Measured(finite=True, gradient=42.0, precision_mm=3e-5, nudged_mm=1.1, signs_mm=1.8)
PICTURE = PictureError(worst=1e-4, flipped=0, finite=True, visible=7, invalid=0)


def row(name: str, ms: float, psnr_db: float, looks: str, on_front: bool = True) -> Row:
    stages = {"raster": 0.7 * ms, "skin": 0.2 * ms}
    truth = TruthScore(31.25, 0.5, -0.1, 0.02)
    return Row(TOGETHER, name, ms, 1.1 * ms, stages, Error(psnr_db, 0.1), truth, 90, 10, False, looks, on_front, CROP)


@pytest.fixture
def accuracy() -> Accuracy:
    rows = (
        row("draft", 6, 31, "soft fingertips"),
        row("viewport", 12, 56, "looks the same"),
        row("final", 14, 68, "looks the same"),
        row("reference", 16, 90, "looks the same"),
        row("slow", 20, 50, "looks the same", on_front=False),
        replace(row("cut at 1/255", 15, 60, ""), axis=BLEND, on_front=False),
    )
    growth = tuple(Growth(panel, x, 2.0 * x, 2.5 * x, False) for panel in PANELS for x in (1, 1000, 1_000_000))
    facts = {"processor": "a processor", "threads": 2, "cores": 2, "backend": "v3"}
    return Accuracy("hand", 40_000, (512, 334), facts, rows, growth, 6, "pictures of a capture")


@pytest.fixture
def hard_cases() -> Stability:
    broken = replace(GOOD, gradient=float("inf"), finite=False)
    bad = replace(GOOD, nudged_mm=6.1)
    hands = [
        HandRow("ordinary: good hand", [], GOOD, broken, PICTURE),
        HandRow("bad hand", ["a bone has no length"], bad, GOOD, PICTURE, ["a nudge of 0.5 mm moves skin over 2 mm"]),
    ]
    distance = np.geomspace(10, 1e-3, 5)
    usual = np.array([1.0, 10, 100, np.nan, 107])
    curve = Curve("straight_twist", "title", "below", "x", "y", "way", distance, np.full(5, 0.5), usual, visible=2.0)
    pictures = [PictureRow("picture", PICTURE, 1.0, True, 0.5)]
    trained = HandRow("trained hand, ordinary: good hand", [], replace(GOOD, signs_mm=3.1), None, PICTURE)
    return Stability(hands, [trained], pictures, [curve])


def views() -> list[stability_plot.ViewPair]:
    blank = np.full((40, 40, 3), 200, np.uint8)
    return [stability_plot.ViewPair("view", blank, blank)]


# ---- accuracy --------------------------------------------------------------------------------------------------------


def test_what_can_be_chosen_stands_in_one_table_with_its_looks(accuracy):
    choices, axes, growth = accuracy.tables()
    score = ("31.25 ± 0.50", "-0.10 ± 0.02")
    assert choices.rows[0] == ("draft", "6.0", "6.6", "31.0", "25.5", *score, "● soft fingertips")
    assert [cells[0] for cells in axes.rows] == ["blend: cut at 1/255"]
    assert ("Gaussians in the hand", "1,000,000", "2000000.0", "2500000.0") in growth.rows
    assert any("512 x 334 pixels, 40,000 Gaussians" in note for note in choices.notes)


def test_a_study_with_little_in_it_can_be_drawn(accuracy):
    for rows in (accuracy.rows[:1], accuracy.rows[-2:]):
        assert png_of(accuracy_plot.draw_figure(replace(accuracy, rows=rows, growth=())))


def test_at_most_five_of_the_front_are_shown_with_its_ends(accuracy):
    many = tuple(row(str(n), n + 1, 30 + n, "") for n in range(9))
    shown = [one.name for one in accuracy_plot.shown_rows(replace(accuracy, rows=many))]
    assert len(shown) == 5
    assert (shown[0], shown[-1]) == ("0", "8")


def test_the_study_of_accuracy_writes_its_folder(accuracy, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(accuracy_measures, "measure_accuracy", lambda plan, say: accuracy)
    avatar, out = small_avatar(30), tmp_path / "study"
    save_avatar(tmp_path / "small.jghand", avatar)
    words = ["study", "accuracy", str(tmp_path / "small.jghand"), "--size", "48x32"]
    assert main([*words, "--out", str(out)]) == 0
    assert "12 ms: looks the same; 6 ms: soft fingertips" in capsys.readouterr().out
    assert {"accuracy.json", "accuracy.png", "accuracy_what_can_be_chosen.csv"} <= {path.name for path in out.iterdir()}
    content = json.loads((out / "accuracy.json").read_text())
    assert content["headline"] == accuracy.headline
    with (out / "accuracy_what_can_be_chosen.csv").open(newline="") as stream:
        assert list(csv.reader(stream)) == [content["tables"][0]["columns"], *content["tables"][0]["rows"]]


# ---- stability -------------------------------------------------------------------------------------------------------


def test_every_hard_case_is_in_a_table_that_says_what_it_misses(hard_cases):
    good, bad, _ = hard_cases.tables()[0].rows
    assert good[:3] == ("ordinary: good hand", "42", "not finite")
    assert bad[-2:] == ("a nudge of 0.5 mm moves skin over 2 mm", "a bone has no length")
    assert "the built-in hand by up to 3.1 mm" in hard_cases.headline, "of what ships, not of the bare bones"
    assert hard_cases.headline.startswith("4 of 4 hard cases have finite values and gradients; 3 meet every bound")
    # of what ships, not of its bones alone
    assert "skin of the built-in hand by up to 3.1 mm, and by 1.8 mm where nothing but the bones" in hard_cases.headline
    assert "twists by 0.5 degrees, by the usual cross products 107" in hard_cases.headline


def test_the_study_of_stability_writes_its_folder(hard_cases, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(stability, "measure_stability", lambda tick: hard_cases)
    monkeypatch.setattr(stability_plot, "view_pairs", views)
    assert main(["study", "stability", "--out", str(tmp_path / "study")]) == 0
    assert "3 meet every bound" in capsys.readouterr().out
    hands = json.loads((tmp_path / "study" / "stability.json").read_text())["hands"]
    assert hands[0]["usual"]["gradient"] is None
    assert (tmp_path / "study" / "stability.png").stat().st_size < 300_000
    assert stability_plot.COLUMNS > 0


# ---- all of them -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [(("accuracy", "--size", "much"), "WIDTHxHEIGHT"), (("stability", "--out", "README.md"), "a folder")],
)
def test_what_cannot_be_done_is_refused_before_anything_is_measured(words, said, monkeypatch, capsys):
    monkeypatch.setattr(accuracy_measures, "variants", lambda *_: pytest.fail("measured"))
    monkeypatch.chdir(ROOT)
    assert main(["study", *words]) == 2
    assert said in capsys.readouterr().err


def test_without_matplotlib_the_command_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["study", "stability", "--out", str(tmp_path)]) == 2
    assert "study" in capsys.readouterr().err


def test_the_first_page_has_the_studys_figure_of_the_hand_that_ships():
    pages = [(ROOT / name).read_text(encoding="utf-8") for name in ("docs/STABILITY.md", "README.md")]
    said = re.search(r"move the skin of the built-in hand by up to ([\d.]+ mm)", pages[0])
    assert said
    assert f"the built-in hand's skin moves by {said[1]}" in pages[1]


def test_pages_quote_a_study_between_their_marks_alone(hard_cases, tmp_path, monkeypatch):
    monkeypatch.setattr(stability, "measure_stability", lambda tick: hard_cases)
    monkeypatch.setattr(stability_plot, "view_pairs", views)
    study, checkout = tmp_path / "study", tmp_path / "checkout"
    assert main(["study", "stability", "--out", str(study)]) == 0
    (checkout / "docs").mkdir(parents=True)
    marks = "<!-- jghand study stability: begin -->\nold\n<!-- jghand study stability: end -->"
    (checkout / "docs" / "STABILITY.md").write_text(f"before\n{marks}\nafter\n", encoding="utf-8")
    (checkout / "docs" / "FIGURES.md").write_text(f"# Figures\n{marks}\n", encoding="utf-8")
    command = [sys.executable, str(ROOT / "scripts" / "quote_studies.py"), str(study), "--root", str(checkout)]
    subprocess.run(command, check=True, capture_output=True)
    page = (checkout / "docs" / "STABILITY.md").read_text(encoding="utf-8")
    assert page.startswith("before\n")
    assert page.endswith("after\n")
    assert "old" not in page
    assert "| ordinary: good hand | 42 | not finite |" in page
    overview = (checkout / "docs" / "FIGURES.md").read_text(encoding="utf-8")
    assert "old" not in overview
    assert "[STABILITY.md](STABILITY.md)" in overview
    assert (checkout / "docs" / "stability.png").is_file()
