# SPDX-License-Identifier: GPL-3.0-or-later
"""The cards of avatars, asked from the engine once per file and kept beside the opened one."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from .. import folders
from ..core import limits
from ..errors import JGHandFailure
from ..renderer import engine_words, job_watch, runtime
from ..renderer.job_state import Phase
from ..renderer.jobs import JobSpec
from . import avatar_files
from .avatar_card import Card, read_card

# (avatar, the stamp of its file) -> its card
_cards: dict[tuple[str, str], Card] = {}


def card_of(avatar: str) -> Card | None:
    """The card of an avatar, None while it was not asked for."""
    return _cards.get(_key(avatar))


def ask(avatar: str, *, wait: bool = False) -> None:
    """Asks the engine for a card, unless it is there or another one is being asked for.

    JGHandFailure: no_interpreter, and with `wait` why there is none.
    """
    key = _key(avatar, fresh=True)
    job = runtime.jobs().get(job_watch.CARD)
    if key in _cards or (job is not None and not job.is_over and not wait):
        return
    program, folder = runtime.program(), folders.job_folder()
    figures = folder / "card.json"
    command = (*program, *engine_words.info(avatar, figures))
    done, over = partial(_keep, key, figures), partial(folders.remove_job_folder, folder)
    spec = JobSpec("card", "Reading the avatar", command, folder, on_done=done, on_over=over)
    job = runtime.jobs().start(job_watch.CARD, spec)
    job_watch.start()
    if wait:
        job.wait(limits.LOAD_S)
        if job.state.failure is not None:
            raise job.state.failure
        if job.state.phase is not Phase.DONE:
            job.kill()
            raise JGHandFailure("hung", avatar)


def gaussians_of(avatar: str) -> tuple[int, bool]:
    """How many Gaussians an avatar has and whether it is learned, for estimates: of a card that is not known yet, those
    of the avatar that comes with JGHand."""
    card = card_of(avatar)
    return (card.gaussians, card.learned) if card is not None else (limits.BUILTIN_GAUSSIANS, True)


def register() -> None:
    """Nothing is asked for before it is wanted."""


def unregister() -> None:
    """Forgets them."""
    _cards.clear()


def _key(avatar: str, *, fresh: bool = False) -> tuple[str, str]:
    return avatar, avatar_files.stamp(avatar, fresh=fresh)


def _keep(key: tuple[str, str], figures: Path) -> None:
    _cards[key] = read_card(figures)
