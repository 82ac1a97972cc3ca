"""`jghand bench`: where the milliseconds of a frame go on this machine."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, get_args

import tyro

from jghand_engine.cli.console import progress, say, say_table, write_figures
from jghand_engine.cli.options import AvatarOptions, FiguresFile, PresetName, pixels

DESCRIPTION = """Measure where the milliseconds of a frame go on this machine, for every preset.

Examples:
  jghand bench
  jghand bench --size 1024x1024 --json bench.json"""

# pictures of each preset, which take turns, and those before them, which are not counted
ROUNDS, WARM_UP = 100, 10


@dataclass(frozen=True)
class Bench:
    size: Annotated[str, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = "512x334"
    """Pixels."""
    avatar: AvatarOptions = field(default_factory=AvatarOptions)
    json: FiguresFile = None

    def run(self) -> None:
        from jghand_engine.avatar.builtin import load_avatar_called
        from jghand_engine.render.settings import preset
        from jghand_engine.render.subject import moving_subject
        from jghand_engine.render.timing import COLUMNS, frame_case, machine, measure, table_rows

        width, height = pixels(self.size)
        avatar = load_avatar_called(self.avatar.avatar)
        facts = machine(0)
        subject = moving_subject(avatar.info.name, avatar, width, height)
        cases = [
            # a frame that only repeats the last one would say nothing
            frame_case(subject, replace(preset(name), reuse=False), f"preset {name}")
            for name in get_args(PresetName)
        ]
        with progress("Measuring", WARM_UP + ROUNDS) as bar:
            measured = measure(cases, rounds=ROUNDS, warm_up=WARM_UP, tick=lambda: bar.advance(bar.task_ids[0]))
        say(", ".join(f"{name} {value}" for name, value in facts.items()))
        say_table(f"From joints to picture, {len(avatar)} Gaussians", COLUMNS, table_rows(measured))
        write_figures(self.json, {
            "command": "bench", "machine": facts, "size_px": [width, height], "avatar": avatar.info.name,
            "rounds": ROUNDS, "measurements": [asdict(one) for one in measured],
        })  # fmt: skip
