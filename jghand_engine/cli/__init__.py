"""The command `jghand`: a thin face on the engine, one module per verb.

A verb is a frozen dataclass whose fields are its options and whose `run` does the work. Only the verb that is called is
imported, and what is heavy inside its `run`: help and mistakes in the arguments come at once.
"""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from collections.abc import Sequence
from typing import Annotated, Any, Union

import tyro

from jghand_engine import __version__
from jghand_engine.cli.console import say, say_error
from jghand_engine.cli.failures import explain
from jghand_engine.cli.progress_json import PROGRESS_JSON, JsonLines, started_by_a_program

DESCRIPTION = """JGHand: 21 joint positions go in, a photorealistic hand comes out.

Examples:
  jghand render --poses open,fist --out pictures
  jghand render --help                          all about one command
  jghand --version

With the variable JGHAND_DEBUG=1 an error shows where in the program it happened. With --progress-json, for programs
that start this one, every command tells its progress and errors as lines of JSON on standard error, and the end of
standard input stops it as Ctrl-C does."""

# each is a module of this package, `train-many` is cli/train_many.py with the dataclass TrainMany; only the one that is
# called gets imported
VERBS = (
    *("render", "export", "info", "motion", "check-data", "check-usd", "track", "own", "capture"),
    *("train", "train-many", "evaluate", "distill", "ablate", "bench", "study", "serve"),
)
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


def _main(words: list[str]) -> int:
    if words == ["--version"]:
        say(f"jghand {__version__}")
        return 0
    lines = JsonLines(sys.stderr) if PROGRESS_JSON in words else None
    verb = parsed([word for word in words if word != PROGRESS_JSON])
    # around all of it: where its input has ended already, the stop comes before the command has begun
    try:
        with started_by_a_program(lines):
            return verb.run() or 0
    except (Exception, KeyboardInterrupt) as error:
        if os.environ.get("JGHAND_DEBUG"):
            traceback.print_exc()
        failure = explain(error)
        if lines is not None:
            lines.error(failure, error)
        else:
            say_error(failure.sentence)
        return failure.exit_code


def parsed(words: Sequence[str]) -> Any:
    """The verb with its options. SystemExit for mistakes in them, and for help."""
    if words and words[0] in VERBS:
        verb, description = verb_called(words[0])
        prog = f"jghand {words[0]}"
        return tyro.cli(verb, prog=prog, description=description, args=words[1:], config=STYLE)
    listed = [
        Annotated[verb, tyro.conf.subcommand(name, description=description.splitlines()[0])]
        for name, (verb, description) in ((name, verb_called(name)) for name in VERBS)
    ]
    parsed: Any = Union[tuple(listed)]  # noqa: UP007  (made at run time)
    return tyro.cli(parsed, prog="jghand", description=DESCRIPTION, args=words, config=STYLE)


def verb_called(name: str) -> tuple[type, str]:
    """The dataclass of a verb, and its description."""
    module = importlib.import_module(f"jghand_engine.cli.{name.replace('-', '_')}")
    return getattr(module, name.title().replace("-", "")), module.DESCRIPTION
