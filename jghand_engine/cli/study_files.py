"""What the studies write: their folder, and the pages, figures and part of the README of those that have them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jghand_engine.cli.console import say, write_json
from jghand_engine.errors import InputError
from jghand_engine.files import make_folder, writing

if TYPE_CHECKING:
    from jghand_engine.study.pages import Section


@dataclass(frozen=True)
class Pages:
    """All that a study writes. section: which part of a README is its own · readme: that part, filled · figures: for
    JSON"""

    section: Section
    picture: bytes
    markdown: str
    html: str
    readme: str
    figures: dict[str, Any]


@dataclass(frozen=True)
class Places:
    """out: folder, None for study/ · checkout: whose docs and README get the page, too · json: another place for the
    figures"""

    out: Path | None
    checkout: Path | None
    json: Path | None

    def check(self) -> None:
        """InputError for what can be refused before anything is measured."""
        study_folder(self.out)
        if self.checkout is not None and not (self.checkout / "docs").is_dir():
            raise InputError("--checkout", wanted="a folder that holds docs/ and README.md", came=str(self.checkout))


def study_folder(out: Path | None) -> Path:
    """Where everything goes. InputError for a file."""
    folder = Path("study") if out is None else out
    if folder.exists() and not folder.is_dir():
        raise InputError("--out", wanted="a folder", came=f"the file {folder}")
    return folder


def write_pages(pages: Pages, places: Places) -> None:
    """Writes the folder, then what a checkout gets."""
    folder, study = study_folder(places.out), pages.section.study
    picture, markdown, html = f"{study}.png", f"{study.upper()}.md", f"{study}.html"
    make_folder(folder)
    write_bytes(folder / picture, pages.picture)
    write_bytes(folder / markdown, pages.markdown.encode())
    write_bytes(folder / html, pages.html.encode())
    content = {"command": f"study {study}", **pages.figures}
    for path in (folder / f"{study}.json", places.json):
        if path is not None:
            write_json(path, content)
    say(f"{folder / html} written; {picture}, {markdown} and {study}.json are beside it")
    if places.checkout is None:
        return
    docs, readme = places.checkout / "docs", places.checkout / "README.md"
    text = pages.section.renewed(readme.read_text(encoding="utf-8"), pages.readme)
    write_bytes(docs / picture, pages.picture)
    write_bytes(docs / markdown, pages.markdown.encode())
    write_bytes(readme, text.encode())
    say(f"{docs / markdown} and the README's section renewed")


def write_bytes(path: Path, content: bytes) -> None:
    """A whole file or none."""
    with writing(path) as temporary:
        temporary.write_bytes(content)
