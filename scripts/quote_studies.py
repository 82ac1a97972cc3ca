"""Renews what docs/ quotes of the studies: headlines, tables and plots, from the files of `jghand study`.

    jghand study accuracy builtin --out study && jghand study stability --out study && jghand study effects --out study
    .envs/engine/bin/python scripts/benchmark_trainings.py CAPTURE --out study
    .envs/engine/bin/python scripts/quote_studies.py study

A page is renewed between its marks <!-- jghand study NAME: begin --> and <!-- jghand study NAME: end -->.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import textwrap
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
# the page with the headlines of all that was measured
OVERVIEW = "FIGURES.md"
# study -> its page in docs/, and what its plot shows
PAGES = {
    "accuracy": ("ACCURACY.md", "What accuracy costs in time: finger tips, and every setting as a point"),
    "stability": ("STABILITY.md", "Hands drawn both ways, and error against distance to each singularity"),
    "trainings": ("ACCURACY.md", "Accuracy against planned minutes of training, and against milliseconds of drawing"),
    "effects": ("EFFECTS.md", "What ran on each frame of a motion, and what that saved"),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where the studies were written")
    parser.add_argument("--root", type=Path, default=ROOT, help="the checkout whose pages are renewed")
    options = parser.parse_args()
    present = [name for name in PAGES if (options.folder / f"{name}.json").is_file()]
    if not present:
        print(f"{options.folder} holds none of {', '.join(f'{name}.json' for name in PAGES)}", file=sys.stderr)
        return 1
    for name in present:
        quote(name, options.folder, options.root)
    return 0


def quote(name: str, folder: Path, root: Path) -> None:
    """Renews the page of a study, its plot, and its part of docs/FIGURES.md where that has one."""
    docs = root / "docs"
    study = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    page, caption = PAGES[name]
    shutil.copyfile(folder / f"{name}.png", docs / f"{name}.png")
    headline = textwrap.fill(study["headline"], width=120, break_on_hyphens=False, break_long_words=False)
    tables = [markdown(table) for table in study["tables"]]
    renew(docs / page, name, "\n\n".join([f"**{study['headline']}**", f"![{caption}]({name}.png)", *tables]))
    if begin_mark(name) in (docs / OVERVIEW).read_text(encoding="utf-8"):
        more = f"[{page}]({page}) has every figure; `jghand study {name}` measures it on your machine."
        renew(docs / OVERVIEW, name, f"![{caption}]({name}.png)\n\n{headline}\n\n{more}")


def begin_mark(name: str) -> str:
    return f"<!-- jghand study {name}: begin -->"


def renew(page: Path, name: str, content: str) -> None:
    """Replaces what stands between the marks of a study. SystemExit where they are missing."""
    text, begin, end = page.read_text(encoding="utf-8"), begin_mark(name), f"<!-- jghand study {name}: end -->"
    if begin not in text or end not in text:
        raise SystemExit(f"{page} lacks the marks {begin} and {end}")
    before, after = text[: text.index(begin) + len(begin)], text[text.index(end) :]
    page.write_text(f"{before}\n{content}\n{after}", encoding="utf-8")
    print(f"{page} renewed")


def markdown(table: dict[str, Any]) -> str:
    """A table as GitHub reads it, with its title as a heading of level 3."""
    rows = [[str(cell).replace("|", "\\|") for cell in row] for row in (table["columns"], *table["rows"])]
    rows.insert(1, ["---", *["---:"] * (len(table["columns"]) - 1)])
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    notes = [f"* {note}" for note in table["notes"]]
    return "\n".join([f"### {table['title']}", "", *lines, *([""] if notes else []), *notes])


if __name__ == "__main__":
    sys.exit(main())
