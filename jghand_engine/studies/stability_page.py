"""The stability study as pages: Markdown for a repository, one HTML file that needs nothing else, a README's part."""

from __future__ import annotations

import html
import textwrap

from jghand_engine.errors import InputError
from jghand_engine.studies.stability import Stability
from jghand_engine.training.tables import Table

TITLE = "Hard cases stay stable"
COMMAND = "jghand study stability --out study/"
PICTURE = "stability.png"
BEGIN, END = "<!-- jghand study stability: begin -->", "<!-- jghand study stability: end -->"

_WHY = (
    "A hand has places where the usual formulas break: a finger that is exactly straight, or turned to the side, has "
    "no axis to bend about; a palm that closes has no plane; a bone without length no direction. Motion capture, "
    "artists and the first steps of a training go there all the time. A hand then twists, jumps, or turns into NaN, "
    "and one NaN ends a training.",
    "How to read the picture: to the right the hand comes nearer to such a place, upwards the error grows, both by "
    "powers of ten. Orange is the usual way, green is JGHand; what is in the light green field nobody sees. A cross "
    "is a value that is no number.",
)
_HONEST = (
    "What care cannot buy: a bone has to lose its twist somewhere, one can only choose where. JGHand chooses a finger "
    "folded back through itself, which no joint can do, and the tables show the price there (skin that jumps). A hand "
    "whose palm is a point, or a bone without length, has no right answer; JGHand gives a finite one and says so "
    "(last column)."
)
_LEARNT = (
    "The rows of the trained hand contain what it has learnt to add to each pose (its correctives). They answer to "
    "small errors of the joints more strongly than the bones do, on ordinary poses too: compare their nudges with "
    "those of the same hand without."
)


def markdown_page(study: Stability, picture: str = PICTURE) -> str:
    """The page as GitHub shows it."""
    parts = [
        f"# {TITLE}",
        f"Made by `{COMMAND}`. {study.verdict}",
        f"![Hands drawn both ways, and error against distance to each singularity]({picture})",
        *_WHY,
        _HONEST,
        _LEARNT,
        "What misses a bound:",
        "\n".join(f"* {sentence}" for sentence in study.missed),
        *(table.markdown().rstrip() for table in study.tables()),
    ]
    return "\n\n".join(parts) + "\n"


def readme_section(study: Stability, picture: str) -> str:
    """The part of a README, between its marks."""
    crossed = {curve.name: curve for curve in study.curves}["straight_twist"]
    return "\n".join([
        BEGIN,
        f"![What careful formulas buy: hands and curves, usual and ours]({picture})",
        "",
        textwrap.fill(
            f"{study.verdict} A straightened finger whose joints are 0.5 mm off twists by {crossed.ours[-1]:.1f} "
            f"degrees, by the usual cross products {crossed.usual[-1]:.0f}. `{COMMAND}` measures it on your machine; "
            "[docs/STABILITY.md](docs/STABILITY.md) explains the picture and has every case.",
            width=120, break_on_hyphens=False, break_long_words=False,
        ),
        END,
    ])  # fmt: skip


def with_section(text: str, section: str) -> str:
    """A README's text with the section renewed. InputError when its marks are missing."""
    if BEGIN not in text or END not in text:
        raise InputError("README.md", wanted=f"the marks {BEGIN} and {END}", came="none")
    return text[: text.index(BEGIN)] + section + text[text.index(END) + len(END) :]


def html_page(study: Stability, svg: str) -> str:
    """One file that needs nothing else: no script, no font, no picture from outside."""
    body = [
        f"<h1>{TITLE}</h1>",
        f"<p class=lead>{html.escape(study.verdict)}</p>",
        f"<figure>{svg}</figure>",
        *(f"<p>{html.escape(text)}</p>" for text in (*_WHY, _HONEST, _LEARNT, "What misses a bound:")),
        f"<ul>{''.join(f'<li>{html.escape(sentence)}</li>' for sentence in study.missed)}</ul>",
        *(_html_table(table) for table in study.tables()),
        f"<footer>Made by <code>{html.escape(COMMAND)}</code></footer>",
    ]
    head = f"<meta charset=utf-8><meta name=viewport content='width=device-width'><title>{TITLE}</title>"
    return (
        f"<!doctype html><html lang=en><head>{head}<style>{_STYLE}</style></head><body>{''.join(body)}</body></html>\n"
    )


def _html_table(table: Table) -> str:
    head = "".join(f"<th>{html.escape(column)}</th>" for column in table.columns)
    rows = "".join(
        f"<tr{' class=missed' if any('✗' in cell for cell in row) else ''}>"
        + "".join(f"<td>{html.escape(cell)}</td>" for cell in row)
        + "</tr>"
        for row in table.rows
    )
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in table.notes)
    return (
        f"<h2>{html.escape(table.title)}</h2><div class=wide><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{rows}</tbody></table></div><ul>{notes}</ul>"
    )


_STYLE = """
body{font:16px/1.55 system-ui,sans-serif;color:#2b2b2e;background:#faf9f6;
max-width:1180px;margin:2rem auto;padding:0 1rem}
h1{font-size:2rem;margin:0}h2{margin-top:2.5rem}.lead{font-size:1.15rem;color:#0b7a75}
figure{margin:1rem 0}figure svg{width:100%;height:auto}.wide{overflow-x:auto}
table{border-collapse:collapse;font-size:.86rem}
th,td{padding:.3rem .6rem;text-align:right;border-bottom:1px solid #e2e0da}
th{position:sticky;top:0;background:#f0eee8;vertical-align:bottom}
td:first-child,th:first-child,td:last-child{text-align:left}
tr.missed td{background:#fbe9e2}li,footer{color:#6b6b6e;font-size:.9rem}
"""
