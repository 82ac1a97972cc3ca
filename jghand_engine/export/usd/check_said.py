"""Sentences about a stage, and how those about many moments become one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from pxr import Usd

WHEN, WHAT = "{when}", "{what}"


class Advice(str):
    """A sentence about what is no error: look at it."""

    __slots__ = ()


@dataclass(frozen=True)
class Said:
    """Of one time: a sentence with WHEN where the time belongs, and WHAT where `what` does, which differs in time."""

    sentence: str
    time: Usd.TimeCode | float
    what: str = ""


def merged(found: Iterable[str | Said]) -> Iterator[str]:
    """Whole sentences. What is said of many times is said once, with how many there are, and as it was at the first:
    an animated file would else have a line for every frame."""
    moments: dict[str, list[Said]] = {}
    for one in found:
        if isinstance(one, Said):
            moments.setdefault(one.sentence, []).append(one)
        else:
            yield one
    for sentence, said in moments.items():
        first = time_name(said[0].time)
        when = f"at {first}" if len(said) == 1 else f"at {len(said)} times (first {first})"
        text = sentence.replace(WHEN, when).replace(WHAT, said[0].what)
        yield Advice(text) if isinstance(sentence, Advice) else text


def time_name(time: Usd.TimeCode | float) -> str:
    """A time for a sentence."""
    code = Usd.TimeCode(time)
    return "Default time" if code.IsDefault() else f"time {code.GetValue():g}"


def extent_finding(count: int, time: Usd.TimeCode | float) -> Said:
    """What is wrong with an extent of `count` vectors."""
    return Said(f"the extent {WHEN} has {WHAT} vectors: wanted 2, the corners of a box", time, str(count))
