"""A file that calls itself MANO and is not: refused with the reason, and nothing of it runs."""

from __future__ import annotations

import pickle
import random
import struct
import sys
import tracemalloc

import numpy as np
import pytest
from mano_samples import Thing, csc, mano_fields, python2_pickle

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.template.mano import load_mano
from jghand_engine.template.pickle_arrays import ALLOWED, to_array
from jghand_engine.template.pickle_records import read_pickle


def read(data: bytes):
    return read_pickle(data, ALLOWED, "a test file")


def array_of(value) -> np.ndarray:
    return to_array(read(python2_pickle(value)), "a test file")


class Calls:
    """An object whose pickle calls `function(*arguments)` when it is loaded."""

    def __init__(self, function, *arguments):
        self.function, self.arguments = function, arguments

    def __reduce__(self):
        return self.function, self.arguments


def marked(tmp_path):
    """A command that leaves a mark, and the mark."""
    mark = tmp_path / "it_ran"
    return f"{sys.executable} -c \"open(r'{mark}', 'w')\"", mark


def test_the_trap_itself_works(tmp_path):
    """Otherwise the tests below would prove nothing."""
    import os

    command, mark = marked(tmp_path)
    pickle.loads(pickle.dumps(Calls(os.system, command)))
    assert mark.exists()


@pytest.mark.parametrize("protocol", range(5))
def test_a_file_that_runs_a_command_is_refused_by_name(tmp_path, protocol):
    import os

    command, mark = marked(tmp_path)
    path = tmp_path / "MANO_RIGHT.pkl"
    path.write_bytes(pickle.dumps({**mano_fields(), "hands_mean": Calls(os.system, command)}, protocol=protocol))
    with pytest.raises(InputError, match=r"got the global (posix|nt)\.system"):
        load_mano(path, handedness=Handedness.RIGHT)
    assert not mark.exists()


@pytest.mark.parametrize("protocol", range(5))
def test_a_file_that_evaluates_code_is_refused_by_name(tmp_path, protocol):
    _, mark = marked(tmp_path)
    trap = Calls(eval, f"open({str(mark)!r}, 'w')")
    with pytest.raises(InputError, match=r"got the global builtins\.eval"):
        read(pickle.dumps({"v_template": trap}, protocol=protocol))
    assert not mark.exists()


def test_a_call_hidden_in_the_arguments_of_an_allowed_call_is_refused(tmp_path):
    command, mark = marked(tmp_path)
    inner = b"cos\nsystem\n(S" + repr(command).encode() + b"\ntR"
    for outer in (b"cnumpy.core.multiarray\n_reconstruct\n", b"ccopy_reg\n_reconstructor\n", b"c_codecs\nencode\n"):
        with pytest.raises(InputError, match=r"got the global os\.system"):
            read(outer + b"(" + inner + b"tR.")
    assert not mark.exists()


@pytest.mark.parametrize(
    "data",
    [
        b"cos\nsystem\n.",
        b"(S'true'\nios\nsystem\n.",
        b"(cos\nsystem\nS'true'\no.",
        b"\x80\x04\x8c\x02os\x8c\x06system\x93.",
        b"\x80\x02cos\nsystem\n(tR}b.",
        b"\x80\x02cos\nsystem\n)\x81.",
    ],
)
def test_every_way_to_mention_a_global_is_watched(data):
    with pytest.raises(InputError, match=r"os\.system"):
        read(data)


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("numpy", "load"),
        ("numpy.core.multiarray", "fromfile"),
        ("numpy", "ndarray.tofile"),
        ("numpy.core.multiarray", "_reconstruct.__globals__"),
        ("scipy.sparse.csc", "os.system"),
        ("chumpy.ch", "pickle"),
        ("builtins", "getattr"),
        ("copy_reg", "add_extension"),
        ("this", "s"),
    ],
)
def test_neighbors_of_allowed_globals_are_refused_and_not_imported(module, name):
    with pytest.raises(InputError, match="got the global"):
        read(f"c{module}\n{name}\n.".encode())
    assert "this" not in sys.modules


def test_only_records_and_names_come_out_of_allowed_globals():
    record = read(b"cchumpy.ch\nCh\n(S'text'\ntR.")
    assert type(record).__name__ == "Record"
    assert not callable(record)
    assert not callable(record.maker)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"\x82\x01.", "EXT1"),
        (b"P12\n.", "PERSID"),
        (b"N\x51.", "BINPERSID"),
        (b"\x80\x05\x97.", "NEXT_BUFFER"),
        (b"\x80\x05\x96" + struct.pack("<Q", 3) + b"abc.", "BYTEARRAY8"),
    ],
)
def test_operations_that_need_the_outside_world_are_refused(data, what):
    with pytest.raises(InputError, match=what):
        read(data)


def test_a_cut_file_is_refused_wherever_it_is_cut():
    fields = {"v_template": np.zeros((2, 3)), "shapedirs": csc(np.eye(3)), "name": "lbs"}
    for protocol in (0, 2):
        whole = python2_pickle(fields, protocol)
        for length in range(len(whole)):
            with pytest.raises(InputError):
                read(whole[:length])


@pytest.mark.parametrize(
    "header",
    [
        b"T" + struct.pack("<i", 2**31 - 1),
        b"B" + struct.pack("<I", 2**32 - 1),
        b"X" + struct.pack("<I", 2**32 - 1),
        b"\x8e" + struct.pack("<Q", 2**64 - 1),
        b"\x8d" + struct.pack("<Q", 2**62),
        b"\x8b" + struct.pack("<i", 2**31 - 1),
        b"T" + struct.pack("<i", -5),
    ],
)
def test_a_header_that_promises_gigabytes_is_refused_without_reserving_them(header):
    tracemalloc.start()
    try:
        with pytest.raises(InputError):
            read(header + b"abc.")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1_000_000


def test_an_array_larger_than_its_bytes_is_refused():
    good = python2_pickle(np.zeros((2, 3)))
    for wrong in (2**31 - 1, -1):
        shape = b"J" + struct.pack("<i", 2) + b"J" + struct.pack("<i", 3)
        bad = good.replace(shape, b"J" + struct.pack("<i", wrong) + b"J" + struct.pack("<i", 3))
        assert bad != good
        with pytest.raises(InputError):
            to_array(read(bad), "a test file")
    empty_but_wide = python2_pickle(np.zeros((0, 3))).replace(
        b"J" + struct.pack("<i", 3) + b"t", b"\x8a\x0a" + b"\xff" * 9 + b"\x00t"
    )
    with pytest.raises(InputError):
        to_array(read(empty_but_wide), "a test file")


def test_arrays_of_objects_are_refused():
    data = pickle.dumps(np.array([print, eval], dtype=object), protocol=2)
    with pytest.raises(InputError, match="builtins"):
        read(data)
    with pytest.raises(InputError, match="type 'O8'"):
        to_array(read(pickle.dumps(np.array([1, "a"], dtype=object), protocol=2)), "a test file")


@pytest.mark.parametrize(
    "change",
    [
        {"indices": np.array([0, 1, 3], np.int32)},
        {"indices": np.array([0, -1, 2], np.int32)},
        {"indptr": np.array([0, 1, 2], np.int32)},
        {"indptr": np.array([0, 2, 1, 3], np.int32)},
        {"indptr": np.array([0, 1, 2, 2**31 - 1], np.int32)},
        {"data": np.zeros(2)},
        {"_shape": (2**30, 3)},
        {"_shape": (3,)},
        {"_shape": None},
        {"indices": np.array([0.0, 1.0, 2.0])},
    ],
)
def test_a_sparse_matrix_whose_parts_do_not_fit_is_refused(change):
    good = csc(np.eye(3))
    np.testing.assert_array_equal(array_of(good), np.eye(3))
    with pytest.raises(InputError):
        array_of(Thing(good.module, good.name, {**good.state, **change}))


@pytest.mark.parametrize(
    "change",
    [{"idxs": np.array([0, 9])}, {"idxs": np.array([-1, 0])}, {"preferred_shape": (2**20, 2**20)}, {"a": "text"}],
)
def test_a_selection_that_reaches_outside_is_refused(change):
    state = {"a": Thing("chumpy.ch", "Ch", {"x": np.arange(9.0)}), "idxs": np.array([1, 2]), "preferred_shape": (2, 1)}
    np.testing.assert_array_equal(array_of(Thing("chumpy.reordering", "Select", state)), [[1], [2]])
    with pytest.raises(InputError):
        array_of(Thing("chumpy.reordering", "Select", {**state, **change}))


def test_records_nested_without_end_are_refused():
    deep = b"\x80\x02" + b"cchumpy.ch\nCh\n)\x81}S'x'\n" * 3000 + b"N" + b"sb" * 3000 + b"."
    with pytest.raises(InputError, match="nested"):
        to_array(read(deep), "a test file")
    itself = b"\x80\x02cchumpy.ch\nCh\n)\x81q\x00}S'x'\nh\x00sb."
    with pytest.raises(InputError, match="nested"):
        to_array(read(itself), "a test file")


def test_tuples_that_double_do_not_take_for_ever():
    """Sixty lines of (t, t): hashing or printing the result would take 2^60 steps."""
    doubling = b"\x80\x02)" + b"q\x00h\x00\x86" * 60
    with pytest.raises(InputError, match="keys"):
        read(b"\x80\x02}" + doubling[2:] + b"Ns.")
    with pytest.raises(InputError):
        to_array(read(doubling + b"."), "a test file")


def test_a_long_text_that_is_encoded_again_and_again_is_refused():
    """Each call makes new bytes of the same megabyte; a hundred thousand would fill any memory."""
    text = b"\x80\x02c_codecs\nencode\nq\x00X" + struct.pack("<I", 2**20) + b"a" * 2**20 + b"\x85q\x01R0"
    assert read(text + b"N.") is None
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="at most 67108864 bytes"):
            read(text + b"(" + b"h\x00h\x01R" * 200 + b"l.")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 100_000_000


@pytest.mark.parametrize("key", [b"K\x01", b"N", b"I1\n", b"C\x01a", b")", b"G" + b"\0" * 8])
def test_a_key_that_is_no_text_is_refused(key):
    with pytest.raises(InputError, match="text as keys"):
        read(b"\x80\x03}" + key + b"Ns.")


@pytest.mark.parametrize("number", [b"-1", b"200000", str((2**61 - 1) * 7).encode()])
def test_a_memo_with_strange_numbers_is_refused(number):
    with pytest.raises(InputError, match="memo"):
        read(b"Np" + number + b"\n.")


def test_errors_about_long_rubbish_are_short():
    for data in (b"I" + b"9" * 100_000 + b"\n.", b"S'" + b"x" * 100_000 + b"\n.", b"c" + b"o" * 100_000 + b"\ns\n."):
        with pytest.raises(InputError) as caught:
            read(data)
        assert len(str(caught.value)) < 500


def test_a_number_beyond_any_float_is_refused():
    with pytest.raises(InputError, match="float64"):
        to_array(10**400, "a test file")


@pytest.mark.parametrize(
    "value",
    [
        np.zeros((3, 2)),
        csc(np.zeros((3, 2))),
        Thing("chumpy.ch", "Ch", {"x": np.zeros((3, 2))}),
        Thing("chumpy.reordering", "Select", {"a": np.zeros(9), "idxs": np.arange(6), "preferred_shape": (3, 2)}),
        Thing("chumpy.reordering", "Select", {"a": np.zeros(9), "idxs": np.arange(6)}),
        1.5,
    ],
)
def test_a_shape_other_than_the_field_s_is_refused(value):
    record = value if isinstance(value, float) else read(python2_pickle(value))
    with pytest.raises(InputError, match=r"wanted shape \(2, 3\)"):
        to_array(record, "a test file", (2, 3))


def test_a_field_of_another_shape_is_refused_before_it_is_built(tmp_path):
    """A sparse matrix of a few bytes would become 160 MB of zeros."""
    huge = csc(np.zeros((2, 2)))
    state = {**huge.state, "_shape": (4000, 4000), "indptr": np.zeros(4001, np.int32)}
    path = tmp_path / "MANO_RIGHT.pkl"
    path.write_bytes(python2_pickle({**mano_fields(), "J_regressor": Thing(huge.module, huge.name, state)}))
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"J_regressor: wanted shape \(16, 778\), got \(4000, 4000\)"):
            load_mano(path, handedness=Handedness.RIGHT)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 60_000_000


def test_too_many_operations_are_refused():
    with pytest.raises(InputError, match="operations"):
        read(b"\x80\x02" + b"N0" * 600_000 + b"N.")


def test_a_huge_file_is_not_read(tmp_path):
    path = tmp_path / "MANO_RIGHT.pkl"
    with open(path, "wb") as stream:
        stream.truncate(10 * 2**30)  # sparse: takes no room on disk
    with pytest.raises(InputError, match="at most"):
        load_mano(path, handedness=Handedness.RIGHT)


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    for path in (tmp_path / "nothing.pkl", tmp_path):
        with pytest.raises(InputError, match="a file that can be read"):
            load_mano(path, handedness=Handedness.RIGHT)


@pytest.mark.filterwarnings("ignore:invalid (octal )?escape sequence")
@pytest.mark.parametrize("protocol", [0, 2])
def test_damaged_files_give_one_kind_of_error(protocol):
    """Bytes changed at random: an array, or an InputError; never another error, never a hang."""
    shapes = Thing("chumpy.ch", "Ch", {"x": np.arange(4.0)})
    small = {"a": np.eye(2), "b": csc(np.eye(2)), "c": shapes, "d": (1, "x", None, True)}
    whole, rng = python2_pickle(small, protocol), random.Random(0)
    for _ in range(4000):
        damaged = bytearray(whole)
        for _ in range(rng.randint(1, 4)):
            damaged[rng.randrange(len(damaged))] = rng.randrange(256)
        try:
            value = read(bytes(damaged))
            for part in value.values() if isinstance(value, dict) else [value]:
                to_array(part, "a test file")
        except InputError:
            pass
