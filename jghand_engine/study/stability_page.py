"""The stability study as pages: Markdown for a repository, one HTML file that needs nothing else, a README's part."""

from __future__ import annotations

import html
import textwrap

from jghand_engine.study.pages import Section, html_document, html_table
from jghand_engine.study.stability import Stability

TITLE = "Hard cases stay stable"
COMMAND = "jghand study stability --out study/"
PICTURE = "stability.png"
SECTION = Section("stability")

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
_LEARNED = (
    "The rows of the trained hand contain what it has learned to add to each pose (its correctives). They answer to "
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
        _LEARNED,
        "What misses a bound:",
        "\n".join(f"* {sentence}" for sentence in study.missed),
        *(table.markdown().rstrip() for table in study.tables()),
    ]
    return "\n\n".join(parts) + "\n"


def readme_section(study: Stability, picture: str) -> str:
    """The part of a README, between its marks."""
    crossed = {curve.name: curve for curve in study.curves}["straight_twist"]
    return SECTION.filled(
        f"![What careful formulas buy: hands and curves, usual and ours]({picture})",
        "",
        textwrap.fill(
            f"{study.verdict} A straightened finger whose joints are 0.5 mm off twists by {crossed.ours[-1]:.1f} "
            f"degrees, by the usual cross products {crossed.usual[-1]:.0f}. `{COMMAND}` measures it on your machine; "
            "[docs/STABILITY.md](docs/STABILITY.md) explains the picture and has every case.",
            width=120, break_on_hyphens=False, break_long_words=False,
        ),
    )  # fmt: skip


def html_page(study: Stability, svg: str) -> str:
    """One file that needs nothing else: no script, no font, no picture from outside."""
    body = [
        f"<h1>{TITLE}</h1>",
        f"<p class=lead>{html.escape(study.verdict)}</p>",
        f"<figure>{svg}</figure>",
        *(f"<p>{html.escape(text)}</p>" for text in (*_WHY, _HONEST, _LEARNED, "What misses a bound:")),
        f"<ul>{''.join(f'<li>{html.escape(sentence)}</li>' for sentence in study.missed)}</ul>",
        *(html_table(table) for table in study.tables()),
        f"<footer>Made by <code>{html.escape(COMMAND)}</code></footer>",
    ]
    return html_document(TITLE, body)
