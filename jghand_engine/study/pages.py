"""What the pages of all studies share: tables and documents in HTML, the part of a page that a study fills."""

from __future__ import annotations

import html
from collections.abc import Iterable
from dataclasses import dataclass

from jghand_engine.errors import InputError
from jghand_engine.learn.tables import Table


@dataclass(frozen=True)
class Section:
    """The part of a page between two marks. study: its name."""

    study: str

    @property
    def begin(self) -> str:
        return f"<!-- jghand study {self.study}: begin -->"

    @property
    def end(self) -> str:
        return f"<!-- jghand study {self.study}: end -->"

    def filled(self, *lines: str) -> str:
        """The section with its marks."""
        return "\n".join([self.begin, *lines, self.end])

    def renewed(self, text: str, section: str, page: str = "README.md") -> str:
        """A page's text with the section (as `filled` makes it) renewed. InputError when its marks are missing."""
        if self.begin not in text or self.end not in text:
            raise InputError(page, wanted=f"the marks {self.begin} and {self.end}", came="none")
        return text[: text.index(self.begin)] + section + text[text.index(self.end) + len(self.end) :]


def html_document(title: str, body: Iterable[str], style: str = "") -> str:
    """One file that needs nothing else: no font, no picture from outside. style: more CSS"""
    head = f"<meta charset=utf-8><meta name=viewport content='width=device-width'><title>{html.escape(title)}</title>"
    return (
        f"<!doctype html><html lang=en><head>{head}<style>{_STYLE}{style}</style></head>"
        f"<body>{''.join(body)}</body></html>\n"
    )


def html_table(table: Table) -> str:
    """A table with its title and notes; rows with a ✗ stand out."""
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
