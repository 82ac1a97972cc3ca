"""Options of the commands that read pictures of hands: which of a data set's pictures are meant."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jghand_engine.cli.console import say
from jghand_engine.cli.options import HandName
from jghand_engine.errors import InputError

if TYPE_CHECKING:
    from jghand_engine.captures.captures import Capture, CaptureChoice
    from jghand_engine.template.mesh import HandTemplate

ProtocolName = Literal["test-capture0", "test-capture1", "val-capture0", "hanco-0191"]


@dataclass(frozen=True)
class PictureSetOptions:
    """Which pictures of the folder are meant, where it holds those of several persons or hands. A folder inside a data
    set chooses too: InterHand2.6M_5fps_batch1/images/test/Capture0."""

    protocol: Annotated[ProtocolName | None, tyro.conf.arg(help_behavior_hint="")] = None
    """The pictures that published figures stand for: three persons of InterHand2.6M, one sequence of HanCo."""
    sequences: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: all)")] = ()
    """Only these sequences, such as ROM04_RT_Occlusion, or 0191 of HanCo."""
    hand: Annotated[HandName | None, tyro.conf.arg(help_behavior_hint="")] = None
    """Which hand, where both were recorded."""

    def open(self, folder: Path, template: HandTemplate | None = None) -> Capture:
        """The pictures of `folder` that are meant; what is left out of them is said. template, errors: as of
        `open_capture`."""
        from jghand_engine.captures.capture_folder import open_capture

        capture = open_capture(folder, protocol=self.protocol, choice=self.choice(), template=template)
        for why, count in capture.dropped:
            say(f"Left out: {count} {'picture' if count == 1 else 'pictures'}, {why}")
        return capture

    def check(self) -> None:
        """InputError when a protocol and another choice were given."""
        if self.protocol is not None and replace(self, protocol=None) != PictureSetOptions():
            raise InputError(
                "--protocol", wanted="no other choice of pictures beside it", came="both", remedy="Drop one of them."
            )

    def choice(self) -> CaptureChoice | None:
        """What `open_capture` takes beside `protocol`; None with a protocol. InputError as `check`."""
        from jghand_engine.captures.captures import CaptureChoice
        from jghand_engine.hand.joints import Handedness

        self.check()
        if self.protocol is not None:
            return None
        return CaptureChoice(sequences=self.sequences or None, handedness=Handedness(self.hand) if self.hand else None)
