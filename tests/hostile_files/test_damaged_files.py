"""Damaged files, files of another kind and files that attack the reader, of everything that is read.

Each is refused in one sentence that names the file, soon; nothing of it runs, and nothing huge is made of it.
"""

import contextlib
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sound_files import KINDS, Kind, pictures

from jghand_engine.errors import InputError

every_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Callable[[Kind], bytes]:
    made: dict[int, bytes] = {}

    def of(kind: Kind) -> bytes:
        if kind.read is pictures:
            pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")
        if id(kind) not in made:
            made[id(kind)] = kind.sound(tmp_path_factory.mktemp("sound") / kind.name)
        return made[id(kind)]

    return of


def refused(kind: Kind, path: Path, whole: bytes) -> str:
    path.write_bytes(whole)
    with pytest.raises(InputError) as caught:
        kind.read(path)
    message = str(caught.value)
    assert path.name in message
    assert "\n" not in message
    assert len(message) < 700
    return message


# ---- every kind ------------------------------------------------------------------------------------------------------


@every_kind
def test_a_file_that_was_cut_off_is_refused_and_a_whole_one_is_read(tmp_path, sound, kind):
    whole, path = sound(kind), tmp_path / kind.name
    for part in kind.cuts:
        refused(kind, path, whole[: int(part * len(whole))])
    path.write_bytes(whole)
    kind.read(path)


@pytest.mark.parametrize("kind", [pytest.param(kind, id=name) for name, kind in KINDS.items() if kind.flips])
@pytest.mark.filterwarnings("ignore:.*align:DeprecationWarning")
def test_flipped_bytes_give_what_the_file_holds_or_a_sentence(tmp_path, sound, kind):
    whole, path = sound(kind), tmp_path / kind.name

    # half of the flips in the header, where the harm is
    @settings(max_examples=kind.flips, suppress_health_check=list(HealthCheck), database=None)
    @given(st.lists(st.tuples(st.integers(0, 999) | st.integers(0, len(whole) - 1), st.integers(0, 255)), min_size=1))
    def flip(flips: list[tuple[int, int]]) -> None:
        changed = bytearray(whole)
        for place, value in flips:
            changed[place % len(whole)] = value
        path.write_bytes(changed)
        with contextlib.suppress(InputError):
            kind.read(path)

    flip()


@every_kind
@pytest.mark.filterwarnings("error")
def test_a_file_of_another_kind_is_refused(tmp_path, sound, kind):
    sound(kind)
    path = tmp_path / kind.name
    for other in (
        bytes(4096), b"\xff\xfe\x00", b"just some text\n" * 100, b"\x89PNG\r\n\x1a\n" + bytes(64), b"PK\x03\x04no",
        b"[" * 100_000, b'{"frames": ' + b"[" * 50_000 + b"]" * 50_000 + b"}", b"null", b"[1]", b"9" * 5000,
        b'"' * 200_000,
    ):  # fmt: skip
        refused(kind, path, other)
