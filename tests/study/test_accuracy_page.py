"""The pages of accuracy against time: whole, self-contained, with something under the pointer; and the command."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from small_avatars import small_avatar

from jghand_engine.avatar.file import save_avatar
from jghand_engine.cli import main
from jghand_engine.render.profile import read_profile
from jghand_engine.study import accuracy_measures
from jghand_engine.study.accuracy import Accuracy, Row
from jghand_engine.study.accuracy_growth import PANELS, Growth
from jghand_engine.study.accuracy_page import SECTION, html_page, markdown_page, readme_section
from jghand_engine.study.accuracy_plot import draw_figure, shown_rows
from jghand_engine.study.accuracy_reference import Error
from jghand_engine.study.accuracy_variants import BLEND, SEPARABLE, TOGETHER
from jghand_engine.study.figures import png_of, svg_of

pytest.importorskip("matplotlib")

CROP = np.random.default_rng(0).integers(0, 255, (40, 40, 3), np.uint8)


def row(name: str, ms: float, psnr_db: float, looks: str, on_front: bool = True) -> Row:
    stages = {"raster": 0.7 * ms, "skin": 0.2 * ms}
    truth = {"psnr_full": 31.25, "flip_box": 0.123}
    return Row(TOGETHER, name, ms, 1.1 * ms, stages, Error(psnr_db, 0.1), truth, 90, 10, False, looks, on_front, CROP)


@pytest.fixture
def study() -> Accuracy:
    rows = (
        row("draft", 6, 31, "soft <fingertips>"),
        row("viewport", 12, 56, "looks the same"),
        row("final", 14, 68, "looks the same"),
        row("reference", 16, 90, "looks the same"),
        row("slow", 20, 50, "looks the same", on_front=False),
        Row(BLEND, SEPARABLE, None, None, {}, Error(60, 0.01)),
    )
    growth = tuple(Growth(panel, x, 2.0 * x, 2.5 * x, False) for panel in PANELS for x in (1, 1000, 1_000_000))
    facts = {"processor": "a processor", "threads": 2, "cores": 2, "backend": "v3"}
    learning = ((0.0, 13.0), (1.0, 22.0), (20.0, 27.0))
    return Accuracy("hand", 40_000, (512, 334), facts, rows, growth, 6, "pictures of a capture", learning)


def test_the_page_tells_the_whole_story_in_words(study):
    text = markdown_page(study)
    assert "**12 ms: looks the same; 6 ms: soft <fingertips>**" in text
    assert "| **draft** | 6.0 | 6.6 | 31.0 | 25.5 | 31.25 | 0.123 | ● soft <fingertips> |" in text
    assert f"| {SEPARABLE} | - | - | 60.0 |" in text
    assert "512 x 334 pixels, 40,000 Gaussians" in text
    assert "2 of 2 threads" in text
    assert "| Gaussians in the hand | 1,000,000 | 2000000.0 |" in text


def test_the_html_page_needs_nothing_from_outside_and_shows_every_timed_point(study):
    page = html_page(study, svg_of(draw_figure(study)))
    assert "soft &lt;fingertips&gt;" in page
    assert re.findall(r"(?:src|href)=[\"']?https?:", page) == []
    assert re.findall(r"@import|url\(['\"]?https?:", page) == []
    assert page.count("<circle class=") == 5
    rows = json.loads(re.findall(r"const rows=(\[.*?\]);\n", page)[0].replace("<\\/", "</"))
    assert [one["name"] for one in rows] == ["draft", "viewport", "final", "reference", "slow"]
    assert all(one["picture"].startswith("data:image/jpeg;base64,") for one in rows)
    assert rows[0]["stages"] == ["raster 4.20 ms", "skin 1.20 ms"]


def test_a_name_cannot_end_the_script(study):
    bad = replace(study.rows[0], name="</script><b>")
    page = html_page(replace(study, rows=(bad,)), "")
    assert page.count("</script>") == 1


@pytest.mark.parametrize("learning", [True, False])
def test_the_picture_is_small_and_opens(study, learning):
    picture = png_of(draw_figure(study if learning else replace(study, learning=())))
    assert len(picture) < 300_000
    assert Image.open(io.BytesIO(picture)).width > 1200


def test_a_study_with_little_in_it_can_be_drawn(study):
    for rows in (study.rows[:1], study.rows[-2:]):
        assert png_of(draw_figure(replace(study, rows=rows, growth=(), learning=())))


def test_at_most_five_of_the_front_are_shown_with_its_ends(study):
    many = tuple(row(str(n), n + 1, 30 + n, "") for n in range(9))
    shown = [one.name for one in shown_rows(replace(study, rows=many))]
    assert len(shown) == 5
    assert (shown[0], shown[-1]) == ("0", "8")


def test_the_readme_gets_its_section(study):
    text = SECTION.renewed(f"a\n{SECTION.begin}\nold\n{SECTION.end}\nb", readme_section(study, "docs/accuracy.png"))
    assert "old" not in text
    assert "12 ms: looks the same" in text
    assert max(map(len, text.splitlines())) <= 120


def test_the_command_writes_folder_checkout_and_profile(study, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("JGHAND_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(accuracy_measures, "measure_accuracy", lambda plan, say: study)
    checkout, avatar = tmp_path / "checkout", small_avatar(30)
    save_avatar(tmp_path / "small.jghand", avatar)
    (checkout / "docs").mkdir(parents=True)
    (checkout / "README.md").write_text(f"# Name\n{SECTION.begin}\n{SECTION.end}\n", encoding="utf-8")
    out = tmp_path / "study"
    monkeypatch.setattr(accuracy_measures, "variants", lambda *_: [])
    words = ["study", "accuracy", str(tmp_path / "small.jghand"), "--threads", "1", "--size", "48x32"]
    monkeypatch.setattr(accuracy_measures, "profile_of", lambda found, plan: _profile(plan))
    assert main([*words, "--out", str(out), "--checkout", str(checkout)]) == 0
    assert "12 ms: looks the same" in capsys.readouterr().out
    assert sorted(path.name for path in out.iterdir()) == [
        "ACCURACY.md", "accuracy.html", "accuracy.json", "accuracy.png"
    ]  # fmt: skip
    assert "docs/accuracy.png" in (checkout / "README.md").read_text(encoding="utf-8")
    assert sorted(path.name for path in (checkout / "docs").iterdir()) == ["ACCURACY.md", "accuracy.png"]
    assert json.loads((out / "accuracy.json").read_text())["headline"] == study.headline
    assert read_profile(avatar, (48, 32), 1) is not None


def _profile(plan):
    from jghand_engine.render.profile import Profile, Rated
    from jghand_engine.render.settings import RenderSettings

    assert plan.size_px == (48, 32)
    return Profile((Rated("one", RenderSettings(), 1.0, 1.0, 50.0),), "the study", False)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--rounds", "0"), "1 or more"),
        (("--limit", "0"), "1 or more"),
        (("--size", "much"), "WIDTHxHEIGHT"),
        (("--checkout", "tests"), "docs/"),
        (("--out", "README.md"), "a folder"),
        (("--log", "nowhere.jsonl"), "no such file"),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_is_measured(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(accuracy_measures, "variants", lambda *_: pytest.fail("measured"))
    assert main(["study", "accuracy", "painted", *words]) == 2
    assert said in capsys.readouterr().err
