"""The study of accuracy against time as pages: Markdown, one HTML file with what the pointer shows, a README's part."""

from __future__ import annotations

import base64
import html
import io
import json
import math
import textwrap
from collections.abc import Sequence

from PIL import Image

from jghand_engine import limits
from jghand_engine.render.profile import pareto_front
from jghand_engine.study.accuracy import Accuracy, Row
from jghand_engine.study.accuracy_variants import TOGETHER
from jghand_engine.study.figures import INK, OURS, QUIET, UNSEEN
from jghand_engine.study.pages import Section, html_document, html_table

TITLE = "What accuracy costs in time"
COMMAND = "jghand study accuracy AVATAR --out study/"
PICTURE = "accuracy.png"
SECTION = Section("accuracy")

_HOW = (
    "How to read the picture: above, finger tips as they look for the milliseconds of one frame. Below, every setting "
    "is a point: to the left is faster, upwards is nearer to the most exact picture. On the line is what is worth "
    "choosing: nothing is both faster and more exact. In the green field we saw no difference. Gray points change "
    "one thing alone, beside preset final.",
    "`jghand render --budget-ms 16`, and `RenderSettings.for_budget(16)` in Python, choose from these points: the most "
    "exact that takes at most nine tenths of the time in 95 of 100 frames. What was measured is kept for this machine "
    "and avatar; where nothing is kept, two seconds of drawing make up for it.",
    "Two things are accuracy here. The dB of the picture say how far a setting is from the most exact drawing of the "
    "same hand. How far that hand is from a real one, or from the pictures it was learned from, is another matter; "
    "where a capture was given, the columns PSNR, SSIM, FLIP and ST-LPIPS say it.",
)


def markdown_page(study: Accuracy, picture: str = PICTURE) -> str:
    """The page as GitHub shows it."""
    parts = [
        f"# {TITLE}",
        f"Made by `{COMMAND}`. **{study.headline}**",
        *([f"**{study.warning}**"] if study.warning else []),
        f"![What less time looks like, every setting as a point, where the time goes and how it grows]({picture})",
        *_HOW,
        *(table.markdown().rstrip() for table in study.tables()),
    ]
    return "\n\n".join(parts) + "\n"


def readme_section(study: Accuracy, picture: str) -> str:
    """The part of a README, between its marks."""
    text = (
        f"{study.headline} ({study.how_timed}). {study.warning} `jghand study accuracy` measures it on your machine, "
        "and `jghand render --budget-ms 16` uses it; [docs/ACCURACY.md](docs/ACCURACY.md) has every setting."
    )
    return SECTION.filled(
        f"![What accuracy costs in time: finger tips for so many milliseconds, every setting as a point]({picture})",
        "",
        textwrap.fill(" ".join(text.split()), width=120, break_on_hyphens=False, break_long_words=False),
    )


def html_page(study: Accuracy, svg: str) -> str:
    """One file that needs nothing else: the points show what they are under the pointer."""
    timed = [row for row in study.rows if row.median_ms is not None]
    data = json.dumps([_card(row) for row in timed]).replace("</", "<\\/")
    warning = [f"<p class=warning>{html.escape(study.warning)}</p>"] if study.warning else []
    body = [
        f"<h1>{TITLE}</h1>",
        f"<p class=lead>{html.escape(study.headline)}</p>",
        *warning,
        f"<p>{html.escape(study.how_timed)}.</p>",
        "<p>Point at a setting to see what it is, what it looks like and where its time goes.</p>",
        f"<div class=hover>{_points(timed)}<div id=card><p>Point at a setting.</p></div></div>",
        f"<figure>{svg}</figure>",
        *(f"<p>{html.escape(text.replace('`', ''))}</p>" for text in _HOW),
        *(html_table(table) for table in study.tables()),
        f"<footer>Made by <code>{html.escape(COMMAND)}</code></footer>",
        f"<script>const rows={data};{_SCRIPT}</script>",
    ]
    return html_document(TITLE, body, _STYLE)


def _card(row: Row) -> dict:
    """What the pointer shows of a setting."""
    stages = sorted(row.stages_ms.items(), key=lambda stage: -stage[1])
    return {
        "name": row.name if row.axis == TOGETHER else f"{row.axis}: {row.name}",
        "looks": row.looks,
        "time": f"{row.median_ms:.1f} ms, 95 % below {row.p95_ms:.1f} ms{' (disturbed)' if row.disturbed else ''}",
        "accuracy": f"{row.error.psnr_db:.1f} dB, worst {255 * row.error.worst:.1f} of 255 steps",
        "stages": [f"{name} {ms:.2f} ms" for name, ms in stages if ms >= 0.005],
        "picture": _data_url(row),
    }


def _data_url(row: Row) -> str:
    if row.crop is None:
        return ""
    stream = io.BytesIO()
    Image.fromarray(row.crop).save(stream, format="JPEG", quality=92)
    return f"data:image/jpeg;base64,{base64.b64encode(stream.getvalue()).decode()}"


# ---- the points, as SVG ----------------------------------------------------------------------------------------------

_WIDE, _HIGH, _EDGE = 760, 440, 50
_TICKS_MS = (1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 300, 500, 1000)


def _points(rows: Sequence[Row]) -> str:
    """An SVG element; every point has a title too, for who has no script."""
    times = [math.log10(max(row.median_ms or 0, 1e-3)) for row in rows]
    low, high = min(times, default=0) - 0.05, max(times, default=1) + 0.05
    bottom = min((row.error.psnr_db for row in rows), default=0) - 3
    top = max([row.error.psnr_db for row in rows] + [limits.LOOKS_SAME_DB]) + 3

    def x(time: float) -> float:
        return _EDGE + (time - low) / (high - low) * (_WIDE - 1.4 * _EDGE)

    def y(psnr_db: float) -> float:
        return 10 + (top - psnr_db) / (top - bottom) * (_HIGH - _EDGE - 10)

    parts = [
        f'<rect x="{_EDGE}" y="10" width="{_WIDE - 1.4 * _EDGE:.0f}" height="{y(limits.LOOKS_SAME_DB) - 10:.1f}" '
        f'fill="{UNSEEN}"/>',
        f'<text x="{_EDGE + 6}" y="{y(limits.LOOKS_SAME_DB) - 5:.1f}" fill="#5c8a58">looks the same</text>',
    ]
    parts += [
        f'<text x="{x(math.log10(value)):.1f}" y="{_HIGH - 22}" text-anchor="middle">{value} ms</text>'
        for value in _TICKS_MS
        if low <= math.log10(value) <= high
    ]
    parts += [
        f'<text x="{_EDGE - 6}" y="{y(value) + 4:.1f}" text-anchor="end">{value} dB</text>'
        for value in range(10, 101, 10)
        if bottom <= value <= top
    ]
    points = [(time, row.error.psnr_db) for row, time in zip(rows, times, strict=True) if row.on_front]
    front = pareto_front((*point, point) for point in points)
    line = " ".join(f"{x(time):.1f},{y(psnr_db):.1f}" for time, psnr_db in front)
    parts.append(f'<polyline points="{line}" fill="none" stroke="{OURS}" stroke-width="2"/>')
    # what lies on top of others is what can be chosen
    for place in sorted(range(len(rows)), key=lambda one: (rows[one].axis == TOGETHER, rows[one].on_front)):
        row = rows[place]
        kind = "front" if row.on_front else "choice" if row.axis == TOGETHER else "axis"
        center = f'cx="{x(times[place]):.1f}" cy="{y(row.error.psnr_db):.1f}"'
        title = html.escape(f"{row.name}: {row.median_ms:.1f} ms, {row.error.psnr_db:.1f} dB. {row.looks}")
        radius = 8 if row.on_front else 6 if row.axis == TOGETHER else 4
        point = f'<circle class={kind} data-row="{place}" tabindex="0" {center} r="{radius}">'
        parts.append(f"{point}<title>{title}</title></circle>")
    return f'<svg viewBox="0 0 {_WIDE} {_HIGH}" role="img" aria-label="{TITLE}">{"".join(parts)}</svg>'


_SCRIPT = """
const card=document.getElementById("card");
function show(circle){
const row=rows[circle.dataset.row];card.replaceChildren();
const add=(tag,text,kind)=>{const one=document.createElement(tag);one.textContent=text;if(kind)one.className=kind;
card.append(one)};
if(row.picture){const picture=document.createElement("img");
picture.src=row.picture;picture.alt=row.name;card.append(picture)}
add("h3",row.name);if(row.looks)add("p",row.looks,"looks");add("p",row.time);add("p",row.accuracy);
for(const stage of row.stages)add("div",stage,"stage");
for(const one of document.querySelectorAll(".here"))one.classList.remove("here");circle.classList.add("here")}
for(const circle of document.querySelectorAll("circle[data-row]"))
for(const event of["mouseenter","focus","click"])circle.addEventListener(event,()=>show(circle));
"""

_STYLE = f"""
.warning{{color:#a8421f;font-weight:600}}
.hover{{display:flex;gap:1.5rem;flex-wrap:wrap;background:#fff;padding:1rem;border:1px solid #e2e0da}}
.hover svg{{flex:3 1 30rem;min-width:0}}.hover svg text{{font-size:12px;fill:{QUIET}}}
#card{{flex:1 1 15rem;color:{INK}}}#card img{{width:100%;max-width:20rem;display:block}}
#card h3{{margin:.6rem 0 0}}#card p{{margin:.2rem 0}}#card .looks{{color:{OURS};font-weight:600}}
#card .stage{{color:{QUIET};font-size:.85rem}}
circle{{cursor:pointer}}circle.front{{fill:{OURS}}}circle.choice{{fill:#e2a48f}}circle.axis{{fill:#c9c7c1}}
circle:hover,circle.here{{stroke:{INK};stroke-width:2.5;outline:none}}
"""
