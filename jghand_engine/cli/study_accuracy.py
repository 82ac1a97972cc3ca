"""`jghand study accuracy`: measures what accuracy costs in time, writes tables, picture and page, and keeps the profile
that budgets choose from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jghand_engine import limits
from jghand_engine.cli.console import say, say_whole_table
from jghand_engine.cli.options import pixels
from jghand_engine.cli.study_files import Pages, Places, write_pages
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.study.accuracy import Accuracy
    from jghand_engine.study.accuracy_growth import Reach
    from jghand_engine.study.accuracy_measures import Truth


@dataclass(frozen=True)
class AccuracyOptions:
    """Accuracy against time"""

    size: Annotated[str, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = "512x334"
    """pixels of the pictures."""
    rounds: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = limits.ACCURACY_ROUNDS
    """frames of every setting."""
    limit: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 3
    """held-out pictures of each kind."""
    threads: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """threads of the renderer; 0 chooses."""
    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """log.jsonl of a training, for accuracy against minutes. Left out: that beside the avatar, if any."""
    growth: bool = True
    """also measure how time grows, with up to a million Gaussians and pictures of 4K."""

    def reach(self) -> Reach:
        """How far the curves of growing time go."""
        from jghand_engine.study.accuracy_growth import Reach

        return Reach() if self.growth else Reach((), (), (), ())


@dataclass(frozen=True)
class AccuracyRequest:
    """avatar: as users call it · capture: folder, None for none"""

    avatar: str
    capture: Path | None
    places: Places
    options: AccuracyOptions


def run_accuracy(request: AccuracyRequest) -> None:
    """Measures, tells, writes, and keeps what budgets choose from."""
    from jghand_engine.avatar.builtin import load_avatar_called
    from jghand_engine.native.threads import thread_count
    from jghand_engine.render.profile import write_profile
    from jghand_engine.study.accuracy_measures import Plan, measure_accuracy, profile_of
    from jghand_engine.study.figures import check_matplotlib

    options, name = request.options, request.avatar
    request.places.check()
    for option, value in (("--rounds", options.rounds), ("--limit", options.limit)):
        if value < 1:
            raise InputError(option, wanted="1 or more", came=str(value))
    size_px = pixels(options.size)
    check_matplotlib()
    avatar = load_avatar_called(name)
    truth = None if request.capture is None else _truth(avatar, request.capture, options.limit)
    log = options.log or _log_beside(name)
    plan = Plan(avatar, name, size_px, options.threads, truth, options.rounds, options.reach(), log)
    study = measure_accuracy(plan, say)
    for table in study.short_tables():
        say_whole_table(table)
    say(study.headline)
    kept = write_profile(avatar, size_px, thread_count(options.threads), profile_of(study, plan))
    say("`jghand render --budget-ms` chooses from this." if kept else "The profile could not be kept.")
    _write(study, request.places)


def _log_beside(name: str) -> Path | None:
    log = Path(name).with_suffix(".training") / "log.jsonl"
    return log if log.is_file() else None


def _truth(avatar: HandAvatar, folder: Path, limit: int) -> Truth:
    from jghand_engine.captures.capture_folder import open_capture
    from jghand_engine.captures.splits import split_capture
    from jghand_engine.learn.evaluate import categories_of
    from jghand_engine.learn.held_out import held_out
    from jghand_engine.learn.metrics import FLIP_MISSING, flip_package
    from jghand_engine.learn.perceptual import ST_LPIPS_MISSING, st_lpips
    from jghand_engine.study.accuracy_measures import held_out_truth

    capture = open_capture(folder)
    told = held_out(avatar, capture, split_capture(capture))
    if told.warning:
        say(told.warning)
    # pictures that were all learned from can still be compared with; that is said above and in the table
    which = "test" if told.split.test else "train"
    stand_in = st_lpips()
    for missing, sentence in ((flip_package() is None, FLIP_MISSING), (stand_in is None, ST_LPIPS_MISSING)):
        if missing:
            say(sentence)
    categories = categories_of(told.split, which, limit)
    return held_out_truth(capture.name, categories, told.split.origin, [] if stand_in is None else [stand_in])


def _write(study: Accuracy, places: Places) -> None:
    from jghand_engine.study.accuracy_page import PICTURE, SECTION, html_page, markdown_page, readme_section
    from jghand_engine.study.accuracy_plot import draw_figure
    from jghand_engine.study.figures import png_of, svg_of

    figure = draw_figure(study)
    page, readme = html_page(study, svg_of(figure)), readme_section(study, f"docs/{PICTURE}")
    write_pages(Pages(SECTION, png_of(figure), markdown_page(study), page, readme, study.as_dict()), places)
