"""One door to all data sets: a folder goes in, a capture comes out, whatever its layout."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from jghand_engine.captures.captures import Capture, CaptureChoice, Layout
from jghand_engine.captures.checks import Report
from jghand_engine.captures.folders import find_roots, subfolders
from jghand_engine.captures.hanco import is_hanco, read_hanco
from jghand_engine.captures.interhand import read_interhand
from jghand_engine.captures.interhand_files import is_interhand
from jghand_engine.captures.protocols import (
    Protocol,
    avatar_papers_drop,
    find_protocol,
    with_papers_masks,
)
from jghand_engine.errors import InputError


def open_capture(
    folder: Path | str,
    *,
    protocol: str | None = None,
    choice: CaptureChoice | None = None,
    report: Report | None = None,
) -> Capture:
    """The pictures of one hand in a folder of InterHand2.6M, of HanCo, or made by `jghand capture`.

    folder:   the data set, the folder around it, or one inside it, which then chooses (images/test/Capture0)
    protocol: a name of PROTOCOLS, instead of a choice
    choice:   which pictures, where there are those of several persons or hands
    report:   is told of broken pictures and implausible joints instead of the error, and the reading goes on
    InputError names what is wrong: the folder, an annotation, the first picture that is missing or broken.
    """
    place = Path(folder)
    if protocol is None:
        if layout_of(place) is Layout.HANCO:
            return read_hanco(place, choice, report=report)
        return read_interhand(place, choice, report=report)
    if choice is not None:
        raise InputError("choice of pictures", wanted="a protocol or a choice", came="both", remedy="Drop one.")
    return _by_protocol(place, find_protocol(protocol), report)


def layout_of(folder: Path) -> Layout:
    """How the files in, around or above a folder are arranged. InputError when it is no layout that we know."""
    if find_roots(folder, is_interhand):
        return Layout.INTERHAND
    if find_roots(folder, is_hanco):
        return Layout.HANCO
    names = [entry.name for entry in subfolders(folder)]
    if "images" in names:
        came, remedy = (
            "images/, but no annotations/",
            "Download InterHand2.6M's annotations, and unpack them beside it.",
        )
    elif "annotations" in names:
        came, remedy = "annotations/ without InterHand2.6M's files", "Download and unpack the annotations again."
    else:
        came = f"folders {', '.join(names[:6])}" if names else "no folders"
        remedy = "Name the folder that holds images/ and annotations/, or HanCo's rgb/ and meta.json."
    raise InputError(f"data set {folder}", wanted="InterHand2.6M, HanCo or our own capture", came=came, remedy=remedy)


def _by_protocol(folder: Path, protocol: Protocol, report: Report | None) -> Capture:
    came = layout_of(folder)
    if came is not protocol.layout:
        raise InputError(f"protocol {protocol.name}", wanted=protocol.layout.value, came=f"{came.value} in {folder}")
    if protocol.layout is Layout.HANCO:
        capture = read_hanco(folder, protocol.choice, report=report)
    else:
        capture = read_interhand(folder, protocol.choice, drop_rule=avatar_papers_drop, report=report)
        capture = with_papers_masks(capture)
    return replace(capture, protocol=protocol.name, train_sequences=protocol.train, test_sequences=protocol.test)
