"""`jghand study stability`: measures the hard cases and writes tables, picture and page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from jghand_engine.cli.console import progress, say, say_whole_table, write_json
from jghand_engine.errors import InputError
from jghand_engine.files import make_folder, writing

if TYPE_CHECKING:
    from jghand_engine.studies.stability import Stability


def run_stability(out: Path | None, checkout: Path | None, json: Path | None) -> None:
    """out: folder of what is written · checkout: a checkout of JGHand whose docs and README get the page, too."""
    from jghand_engine.studies.figures import check_matplotlib, png_of, svg_of
    from jghand_engine.studies.stability import COUNT, measure_stability
    from jghand_engine.studies.stability_page import PICTURE, html_page, markdown_page
    from jghand_engine.studies.stability_plot import draw_figure
    from jghand_engine.studies.stability_views import view_pairs

    folder = Path("study") if out is None else out
    if folder.exists() and not folder.is_dir():
        raise InputError("--out", wanted="a folder", came=f"the file {folder}")
    if checkout is not None and not (checkout / "docs").is_dir():
        raise InputError("--checkout", wanted="a folder that holds docs/ and README.md", came=str(checkout))
    check_matplotlib()
    with progress("Measuring", COUNT) as bar:
        task = bar.task_ids[0]
        study = measure_stability(lambda: bar.advance(task))
    for table in study.short_tables():
        say_whole_table(table)
    say(study.verdict)
    figure = draw_figure(study.curves, view_pairs())
    picture = png_of(figure)
    make_folder(folder)
    _write(folder / PICTURE, picture)
    _write(folder / "stability.html", html_page(study, svg_of(figure)).encode())
    _write(folder / "STABILITY.md", markdown_page(study).encode())
    content = {"command": "study stability", **study.as_dict()}
    write_json(folder / "stability.json", content)
    if json is not None:
        write_json(json, content)
    say(f"{folder / 'stability.html'} written; stability.png, STABILITY.md and stability.json are beside it")
    if checkout is not None:
        _publish(checkout, study, picture)


def _publish(checkout: Path, study: Stability, picture: bytes) -> None:
    from jghand_engine.studies.stability_page import PICTURE, markdown_page, readme_section, with_section

    readme = checkout / "README.md"
    text = with_section(readme.read_text(encoding="utf-8"), readme_section(study, f"docs/{PICTURE}"))
    _write(checkout / "docs" / PICTURE, picture)
    _write(checkout / "docs" / "STABILITY.md", markdown_page(study).encode())
    _write(readme, text.encode())
    say(f"{checkout / 'docs' / 'STABILITY.md'} and the README's section renewed")


def _write(path: Path, content: bytes) -> None:
    with writing(path) as temporary:
        temporary.write_bytes(content)
