"""`jghand distill`: cheaper ways to the corrections of a trained avatar's poses, and what they cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jghand_engine.avatar.correctives import BASIS_MAX
from jghand_engine.cli.console import progress, say, say_table, write_figures
from jghand_engine.cli.options import FiguresFile
from jghand_engine.cli.picture_sets import PictureSetOptions
from jghand_engine.errors import InputError

# poses that are made up beside the trained ones
DISTIL_POSES = 400

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.learn.tier_prices import Measure, Offer

DESCRIPTION = """Prepare a trained avatar for fast drawing, and say what each way costs.

What a pose changes on the skin comes from a network. `distill` adds a linear form of it, which is quick, measures how
much accuracy that loses and how much time it saves, and writes both into the avatar. The renderer then takes the linear
form where it loses at most 0.1 dB and saves a tenth of a frame or more; presets final and reference always take the
network. It also measures how much the shadow of the hand on itself ever darkens: one that nobody sees is not drawn.

Examples:
  jghand distill id3.jghand captures/id3 --out id3_fast.jghand
  jghand distill id3.jghand --out id3_fast.jghand            without pictures: against the network itself"""

# said of prices that were measured on pictures which the avatar may have learned from
NOT_CERTAIN = "it may have learned from them"


@dataclass(frozen=True)
class Distill:
    avatar: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="AVATAR")]
    """A trained .jghand file, or builtin."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.jghand")]
    """The avatar, and its forms with what they cost."""
    folder: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="")] = None
    """The pictures it was trained on: poses come from there, and accuracy is measured on those held out."""
    overwrite: bool = False
    """Replace --out if it is there."""
    basis: Annotated[str, tyro.conf.arg(metavar="K,K,…")] = "4,8,16,32"
    """Sizes of the linear form to try; the smallest that loses at most 0.1 dB is kept, else the most accurate."""
    limit: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 40
    """At most so many held-out pictures of each kind; 0 takes all."""
    pictures: PictureSetOptions = field(default_factory=PictureSetOptions)
    json: FiguresFile = None

    def run(self) -> None:
        import torch

        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.avatar.correctives import largest_basis
        from jghand_engine.avatar.file import save_avatar, stored_form
        from jghand_engine.avatar.storage import Storage
        from jghand_engine.avatar.validation import as_text
        from jghand_engine.files import check_place
        from jghand_engine.learn.distill import distill, poses_near
        from jghand_engine.learn.shadow_seen import with_shadow_seen
        from jghand_engine.learn.tier_prices import distilled, pose_net_of, price_tiers
        from jghand_engine.native.machine import processor
        from jghand_engine.native.threads import thread_count

        if self.out.suffix != ".jghand":
            raise InputError("--out", wanted="a file that ends with .jghand", came=str(self.out))
        if self.limit < 0:
            raise InputError("--limit", wanted="0 or more", came=str(self.limit))
        if self.folder is None and self.pictures != PictureSetOptions():
            remedy = "Give the folder of the pictures after the avatar, or drop the choice of pictures."
            raise InputError("pictures of which folder", wanted="a folder of pictures", came="none", remedy=remedy)
        check_place(self.out, overwrite=self.overwrite)
        # what is measured is what will be read again
        avatar = stored_form(load_avatar_called(self.avatar), Storage.COMPACT)
        bases = self._bases(min(BASIS_MAX, largest_basis(pose_net_of(avatar).shape)))
        by = self._measure(avatar)
        poses = torch.cat([by.known_poses, poses_near(by.known_poses, DISTIL_POSES, seed=0)])
        with progress("Distilling", 100) as bar:
            linear = distill(avatar, poses, bases, tick=lambda part: bar.reach(100 * part))
        measured_on = as_text(f"{by.on}; times on {processor()}, {thread_count(0)} threads")
        say(f"Measuring {len(linear) + 1} tiers on {measured_on}.")
        offers = price_tiers(avatar, linear, by)
        with progress("Measuring the shadow", 100) as bar:
            measured = with_shadow_seen(avatar, lambda part: bar.reach(100 * part))
        finished = distilled(measured, offers, measured_on)
        save_avatar(self.out, finished, storage=Storage.COMPACT)
        self._tell(offers, finished, measured_on)

    def _bases(self, most: int) -> list[int]:
        try:
            bases = sorted({int(word) for word in self.basis.split(",") if word.strip()})
        except ValueError:
            bases = []
        if not bases or not all(1 <= basis <= most for basis in bases):
            raise InputError("--basis", wanted=f"numbers of 1 to {most}, such as 4,8", came=repr(self.basis))
        return bases

    def _measure(self, avatar: HandAvatar) -> Measure:
        from jghand_engine.learn.tier_prices import exact_tier_measure, held_out_measure

        if self.folder is None:
            return exact_tier_measure(avatar)
        from jghand_engine.captures.splits import split_capture
        from jghand_engine.learn.evaluate import held_out

        capture = self.pictures.open(self.folder)
        split = split_capture(capture)
        told = held_out(avatar, capture, split)
        if told.warning:
            say(f"Warning: {told.warning}")
        return held_out_measure(avatar, capture, split, self.limit, NOT_CERTAIN if told.warning else "")

    def _tell(self, offers: Sequence[Offer], avatar: HandAvatar, measured_on: str) -> None:
        from jghand_engine.avatar.tiers import Tier

        learned = avatar.learned
        assert learned is not None
        assert learned.distilled is not None
        kept = {price.name for price in learned.distilled.prices}
        rows = [
            (one.name, f"{one.frame_ms:.1f}", f"{one.megabytes:.2f}", f"{one.psnr_db:.2f}", f"{one.lost_db:.3f}",
             "yes" if one.name in kept else "")
            for one in (offer.price for offer in offers)
        ]  # fmt: skip
        say_table(f"Tiers, on {measured_on}", ("tier", "frame ms", "MB", "PSNR dB", "lost dB", "kept"), rows)
        taken = learned.with_tier(Tier.AUTO)[1]
        say(f"The renderer takes {taken.name if taken else 'exact'} unless told otherwise.")
        seen = None if learned.shadow is None else learned.shadow.seen
        if learned.shadow is not None and seen is not None:
            drawn = "it is drawn where the pose asks for it" if learned.shadow.is_seen else "it is not drawn"
            say(f"Its shadow on itself changes a pixel by at most {255 * seen:.1f} of 255 steps: {drawn}.")
        say(f"{self.out}: {len(avatar)} Gaussians, {self.out.stat().st_size / 1e6:.1f} MB")
        write_figures(self.json, {
            "command": "distill", "measured_on": measured_on, "bytes": self.out.stat().st_size, "shadow_seen": seen,
            "tiers": [{**vars(offer.price), "kept": offer.price.name in kept} for offer in offers],
        })  # fmt: skip
