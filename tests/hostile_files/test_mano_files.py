"""A file that calls itself MANO and is not: refused with the reason, and nothing of it runs."""

import os
import pickle
import sys

import numpy as np
import pytest
from mano_samples import Thing, csc, mano_fields, python2_pickle

from jghand_engine.errors import InputError
from jghand_engine.template.mano import load_mano, read_mano


class Calls:
    """An object whose pickle calls `function(*arguments)` when it is loaded."""

    def __init__(self, function, *arguments):
        self.function, self.arguments = function, arguments

    def __reduce__(self):
        return self.function, self.arguments


@pytest.fixture
def trap(tmp_path):
    """A command that leaves a mark, and the mark."""
    mark = tmp_path / "it_ran"
    return f"{sys.executable} -c \"open(r'{mark}', 'w')\"", mark


def read(tmp_path, content: bytes):
    (tmp_path / "MANO_RIGHT.pkl").write_bytes(content)
    return read_mano(tmp_path / "MANO_RIGHT.pkl")


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_a_file_that_runs_a_command_is_refused_by_name(tmp_path, trap, protocol):
    content = pickle.dumps({**mano_fields(), "hands_mean": Calls(os.system, trap[0])}, protocol=protocol)
    with pytest.raises(InputError, match=r"got the global (posix|nt)\.system.*Nothing in it was executed"):
        read(tmp_path, content)
    code = pickle.dumps({"v_template": Calls(eval, f"open({str(trap[1])!r}, 'w')")}, protocol=protocol)
    with pytest.raises(InputError, match=r"got the global (builtins|__builtin__)\.eval"):
        read(tmp_path, code)
    assert not trap[1].exists()


@pytest.mark.parametrize(
    "content",
    [
        b"cos\nsystem\n.",
        b"(S'true'\nios\nsystem\n.",
        b"(cos\nsystem\nS'true'\no.",
        b"\x80\x04\x8c\x02os\x8c\x06system\x93.",
        b"\x80\x04\x8c\x05numpy\x8c\x0endarray.tofile\x93.",
        b"cnumpy\nload\n.",
        b"cnumpy.core.multiarray\nfromfile\n.",
        b"cbuiltins\ngetattr\n.",
        b"cchumpy.ch\npickle\n.",
        b"cnumpy.core.multiarray\n_reconstruct\n(cos\nsystem\n(S'true'\ntRtR.",
    ],
)
def test_every_way_to_mention_another_global_is_watched(tmp_path, content):
    with pytest.raises(InputError, match="got the global"):
        read(tmp_path, content)


@pytest.mark.parametrize(
    "change",
    [
        {"indices": np.array([0, 1, 3], np.int32)},
        {"indptr": np.array([0, 2, 1, 3], np.int32)},
        {"data": np.zeros(2)},
        {"_shape": (2**30, 3)},
    ],
)
def test_a_sparse_matrix_whose_parts_do_not_fit_is_refused(tmp_path, change):
    good = csc(np.eye(3))
    broken = Thing(good.module, good.name, {**good.state, **change})
    with pytest.raises(InputError, match="J_regressor"):
        read(tmp_path, python2_pickle({**mano_fields(), "J_regressor": broken}))


def test_a_huge_file_is_not_read(tmp_path):
    path = tmp_path / "MANO_RIGHT.pkl"
    with open(path, "wb") as stream:
        stream.truncate(10 * 2**30)  # sparse: takes no room on disk
    with pytest.raises(InputError, match="at most"):
        load_mano(path)


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    for path in (tmp_path / "nothing.pkl", tmp_path):
        with pytest.raises(InputError, match="a file that can be read"):
            load_mano(path)
