"""The command `jghand`: a thin face on the engine, one module per verb.

A verb is a frozen dataclass whose fields are its options and whose `run` does the work. Heavy modules are imported
inside `run`, so that help and argument errors come at once.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from typing import Annotated, Any, Union

import tyro

from jghand_engine import __version__
from jghand_engine.cli import (
    ablate,
    bake,
    bench,
    capture,
    check_data,
    check_usd,
    demo,
    evaluate,
    export,
    info,
    motion,
    render,
    serve,
    study,
    track,
    train,
    train_many,
)
from jghand_engine.cli.console import say, say_error
from jghand_engine.cli.failures import explain
from jghand_engine.cli.machine import JsonLines, started_by_a_program
from jghand_engine.cli.options import ReportOptions

DESCRIPTION = """JGHand: 21 joint positions go in, a photorealistic hand comes out.

Examples:
  jghand demo --out demo_output                 the whole job, to see what JGHand does
  jghand render --poses open,fist --out pictures
  jghand render --help                          all about one command
  jghand --version"""

VERBS = {
    "demo": (demo.Demo, demo.DESCRIPTION),
    "render": (render.Render, render.DESCRIPTION),
    "export": (export.Export, export.DESCRIPTION),
    "info": (info.Info, info.DESCRIPTION),
    "motion": (motion.Motion, motion.DESCRIPTION),
    "check-data": (check_data.CheckData, check_data.DESCRIPTION),
    "check-usd": (check_usd.CheckUsd, check_usd.DESCRIPTION),
    "track": (track.Track, track.DESCRIPTION),
    "capture": (capture.Capture, capture.DESCRIPTION),
    "train": (train.Train, train.DESCRIPTION),
    "train-many": (train_many.TrainMany, train_many.DESCRIPTION),
    "evaluate": (evaluate.Evaluate, evaluate.DESCRIPTION),
    "bake": (bake.Bake, bake.DESCRIPTION),
    "ablate": (ablate.Ablate, ablate.DESCRIPTION),
    "bench": (bench.Bench, bench.DESCRIPTION),
    "study": (study.Study, study.DESCRIPTION),
    "serve": (serve.Serve, serve.DESCRIPTION),
}
STYLE = (
    tyro.conf.OmitArgPrefixes,
    tyro.conf.OmitSubcommandPrefixes,
    tyro.conf.FlagCreatePairsOff,
    tyro.conf.DisallowNone,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code: 0 done, 2 bad input, 3 try again, 4 out of memory, 130 stopped.

    A mistake in the arguments ends by SystemExit(2), as `--help` does by SystemExit(0).
    """
    try:
        return _main(list(sys.argv[1:] if arguments is None else arguments))
    except BrokenPipeError:
        # whoever read what this prints, such as `head`, has seen enough; the interpreter's own flush must not complain
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _main(words: Sequence[str]) -> int:
    if words == ["--version"]:
        say(f"jghand {__version__}")
        return 0
    verb: Any = tyro.cli(_parsed_type(words), prog="jghand", description=DESCRIPTION, args=words, config=STYLE)
    report = getattr(verb, "report", None)
    report = report if isinstance(report, ReportOptions) else ReportOptions()
    lines = JsonLines(sys.stderr) if report.progress_json else None
    # around all of it: where its input has ended already, the stop comes before the command has begun
    try:
        with started_by_a_program(lines):
            return verb.run() or 0
    except (Exception, KeyboardInterrupt) as error:
        if os.environ.get("JGHAND_DEBUG") or report.traceback:
            traceback.print_exc()
        failure = explain(error)
        if lines is not None:
            lines.error(failure, error)
        else:
            say_error(failure.sentence)
        return failure.exit_code


def _parsed_type(words: Sequence[str]) -> Any:
    """The union of the verbs. The list of all verbs shows one line of each, the help of one verb its examples too."""
    alternatives = []
    for name, (verb, description) in VERBS.items():
        text = description if words and words[0] == name else description.splitlines()[0]
        alternatives.append(Annotated[verb, tyro.conf.subcommand(name, description=text)])
    return Union[tuple(alternatives)]  # noqa: UP007  (made at run time)
