"""`jghand bench`: where the milliseconds of a frame go on this machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, get_args

import tyro

from jghand_engine.cli.console import progress, say, say_table, write_figures
from jghand_engine.cli.options import AvatarOptions, BackendName, FiguresFile, PresetName, pixels

if TYPE_CHECKING:
    from jghand_engine.render.timing import Measurement

DESCRIPTION = """Measure where the milliseconds of a frame go on this machine, for every preset.

Examples:
  jghand bench
  jghand bench --size 1024x1024 --json bench.json
  jghand bench --backend gpu"""

# pictures of each preset, which take turns, and those before them, which are not counted
ROUNDS, WARM_UP = 100, 10


@dataclass(frozen=True)
class Bench:
    size: Annotated[str, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = "512x334"
    """Pixels."""
    backend: BackendName = "auto"
    """What draws. gpu: every preset by the graphics card and, in turn with it, by the processor; what `viewport`
    says is kept, and from then on auto takes the faster one (docs/GPU.md)."""
    avatar: AvatarOptions = field(default_factory=AvatarOptions)
    json: FiguresFile = None

    def run(self) -> None:
        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.native.library import GPU, load
        from jghand_engine.render.settings import preset
        from jghand_engine.render.subject import moving_subject
        from jghand_engine.render.timing import COLUMNS, frame_case, machine, measure, table_rows

        width, height = pixels(self.size)
        avatar = load_avatar_called(self.avatar.avatar)
        facts = machine(0, self.backend)
        subject = moving_subject(avatar.info.name, avatar, width, height)
        # beside a card the processor, by the kernels that it has
        names = {"": self.backend} if self.backend != GPU else {", gpu": GPU, ", processor": load().variant}
        cases = [
            # a frame that only repeats the last one would say nothing
            frame_case(subject, replace(preset(name), reuse=False, backend=backend), f"preset {name}{said}")
            for name in get_args(PresetName)
            for said, backend in names.items()
        ]
        with progress("Measuring", WARM_UP + ROUNDS) as bar:
            measured = measure(cases, rounds=ROUNDS, warm_up=WARM_UP, tick=bar.advance)
        say(", ".join(f"{name} {value}" for name, value in facts.items()))
        say_table(f"From joints to picture, {len(avatar)} Gaussians", COLUMNS, table_rows(measured))
        card = {} if self.backend != GPU else self._remember(measured)
        write_figures(self.json, {
            "command": "bench", **card, "machine": facts, "size_px": [width, height], "avatar": avatar.info.name,
            "rounds": ROUNDS, "measurements": [asdict(one) for one in measured],
        })  # fmt: skip

    def _remember(self, measured: Sequence[Measurement]) -> dict[str, str]:
        """Says which was faster and keeps it. -> the name of the card, for the figures."""
        from jghand_engine.gpu.choice import remember
        from jghand_engine.gpu.device import open_device

        frames = {one.section: one.median_ms for one in reversed(measured)}  # a case's first line is the whole frame
        card, gpu_ms, processor_ms = open_device(), *(frames[f"preset viewport, {by}"] for by in ("gpu", "processor"))
        faster = remember(card, gpu_ms=gpu_ms, processor_ms=processor_ms)
        say(f"{card.name}: {gpu_ms:.2f} ms, processor {processor_ms:.2f} ms for a frame of viewport at {self.size}: "
            f"auto draws with the {'graphics card' if faster else 'processor'} from now on.")  # fmt: skip
        return {"graphics_card": card.name}
