"""`jghand study stability`: measures the hard cases and writes tables, picture and page."""

from __future__ import annotations

from jghand_engine.cli.console import progress, say, say_whole_table
from jghand_engine.cli.study_files import Pages, Places, write_pages


def run_stability(places: Places) -> None:
    """Measures, tells and writes."""
    from jghand_engine.study.figures import check_matplotlib, png_of, svg_of
    from jghand_engine.study.stability import COUNT, measure_stability
    from jghand_engine.study.stability_page import PICTURE, SECTION, html_page, markdown_page, readme_section
    from jghand_engine.study.stability_plot import draw_figure
    from jghand_engine.study.stability_views import view_pairs

    places.check()
    check_matplotlib()
    with progress("Measuring", COUNT) as bar:
        task = bar.task_ids[0]
        study = measure_stability(lambda: bar.advance(task))
    for table in study.short_tables():
        say_whole_table(table)
    say(study.verdict)
    figure = draw_figure(study.curves, view_pairs())
    page, readme = html_page(study, svg_of(figure)), readme_section(study, f"docs/{PICTURE}")
    write_pages(Pages(SECTION, png_of(figure), markdown_page(study), page, readme, study.as_dict()), places)
