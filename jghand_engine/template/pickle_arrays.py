"""Turns the inert records of a pickle into arrays: NumPy arrays, scipy's sparse matrices, chumpy's variables.

Every size is compared with the bytes that are there before anything is made of it.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.limits import PICKLE_ELEMENTS_MAX, PICKLE_NESTING_MAX
from jghand_engine.template.pickle_records import Name, Record

_NUMPY = tuple(f"numpy.{core}.multiarray" for core in ("core", "_core"))
RECONSTRUCT = frozenset(Name(module, "_reconstruct") for module in _NUMPY)
SCALAR = frozenset(Name(module, "scalar") for module in _NUMPY)
CSC = frozenset(Name(f"scipy.sparse.{module}", "csc_matrix") for module in ("csc", "_csc"))
CSR = frozenset(Name(f"scipy.sparse.{module}", "csr_matrix") for module in ("csr", "_csr"))
CHUMPY = frozenset(Name("chumpy.ch", name) for name in ("Ch", "ch", "MatVecMult"))
SELECT = Name("chumpy.reordering", "Select")
NDARRAY, DTYPE = Name("numpy", "ndarray"), Name("numpy", "dtype")

# all globals that a file of arrays may mention
ALLOWED = frozenset(
    {
        *RECONSTRUCT,
        *SCALAR,
        *CSC,
        *CSR,
        *CHUMPY,
        SELECT,
        NDARRAY,
        DTYPE,
        Name("chumpy.reordering", "vstack"),
        Name("chumpy.reordering", "transpose"),
        Name("copyreg", "_reconstructor"),
        Name("copyreg", "__newobj__"),
        Name("_codecs", "encode"),
        Name("builtins", "object"),
        Name("builtins", "set"),
        Name("collections", "OrderedDict"),
        Name("collections", "defaultdict"),
    }
)
# kind and bytes of a number; everything else (objects, text, records) is refused
_NUMBER = re.compile(r"b1|[iu][1248]|f[248]")


# of an array; None where any will do
Shape = tuple[int, ...] | None


def to_array(value: Any, thing: str, shape: Shape = None) -> np.ndarray:
    """The array that `value` (a record, or a plain number) describes. `thing` names it in the InputError otherwise.

    shape: what the array must have; compared with what the record declares before anything is built.
    """
    return _to_array(value, thing, 0, shape)


def _to_array(value: Any, thing: str, depth: int, wanted: Shape = None) -> np.ndarray:
    if depth > PICKLE_NESTING_MAX:
        raise InputError(thing, wanted=f"at most {PICKLE_NESTING_MAX} nested records", came="more")
    if isinstance(value, bool | int | float):
        return _number(value, thing, wanted)
    if not isinstance(value, Record):
        raise InputError(thing, wanted="an array", came=f"a {type(value).__name__}")
    if value.maker in RECONSTRUCT:
        return _numpy_array(value, thing, wanted)
    if value.maker in SCALAR:
        return _numpy_scalar(value, thing, wanted)
    if value.maker in CSC or value.maker in CSR:
        return _sparse(value, thing, depth, wanted)
    state = _state_dict(value, thing)
    if value.maker == SELECT:
        return _select(state, thing, depth, wanted)
    if value.maker in CHUMPY and "x" in state:
        return _to_array(state["x"], thing, depth + 1, wanted)
    raise InputError(thing, wanted="an array", came=f"a record of {value.maker} that JGHand cannot rebuild")


def _number(value: float, thing: str, wanted: Shape) -> np.ndarray:
    _count((), thing, wanted)
    try:
        return np.asarray(float(value))
    except OverflowError as error:
        raise InputError(thing, wanted="a number that a float64 can hold", came="a larger one") from error


def _numpy_array(record: Record, thing: str, wanted: Shape) -> np.ndarray:
    """State of an ndarray: (version, shape, dtype, column-major?, bytes)."""
    if not (isinstance(record.state, tuple) and len(record.state) in (4, 5)):
        raise InputError(thing, wanted="an array's state", came="another")
    shape, dtype_record, column_major, raw = record.state[-4:]
    count = _count(shape, thing, wanted)
    dtype = _dtype(dtype_record, thing)
    data = _bytes(raw, thing)
    if len(data) != count * dtype.itemsize:
        raise InputError(thing, wanted=f"{count * dtype.itemsize} bytes", came=f"{len(data)}")
    order = "F" if column_major else "C"
    return np.frombuffer(data, dtype=dtype).reshape(shape, order=order).astype(dtype.newbyteorder("="))


def _numpy_scalar(record: Record, thing: str, wanted: Shape) -> np.ndarray:
    _count((), thing, wanted)
    if len(record.arguments) != 2:
        raise InputError(thing, wanted="a number", came="a broken one")
    dtype, data = _dtype(record.arguments[0], thing), _bytes(record.arguments[1], thing)
    if len(data) != dtype.itemsize:
        raise InputError(thing, wanted=f"{dtype.itemsize} bytes", came=f"{len(data)}")
    return np.frombuffer(data, dtype=dtype)[0].astype(dtype.newbyteorder("="))


def _dtype(record: Any, thing: str) -> np.dtype:
    """dtype('f8', ...) with the state (version, byte order, ...)."""
    if not (isinstance(record, Record) and record.maker == DTYPE and record.arguments):
        raise InputError(thing, wanted="a type of numbers", came="something else")
    kind = record.arguments[0]
    if not (isinstance(kind, str) and _NUMBER.fullmatch(kind)):
        came = kind[:20] if isinstance(kind, str) else type(kind).__name__
        raise InputError(thing, wanted="integers or floating-point numbers", came=f"type {came!r}")
    state = record.state
    order = state[1] if isinstance(state, tuple) and len(state) > 1 else "="
    if order not in ("<", ">", "=", "|"):
        raise InputError(thing, wanted="a byte order", came="something else")
    return np.dtype(kind).newbyteorder(order)


def _bytes(raw: Any, thing: str) -> bytes:
    """Bytes; Python 2 wrote them as text, which was read as latin-1."""
    if isinstance(raw, str):
        try:
            return raw.encode("latin-1")
        except UnicodeEncodeError as error:
            raise InputError(thing, wanted="bytes", came="text") from error
    if not isinstance(raw, bytes):
        raise InputError(thing, wanted="bytes", came=f"a {type(raw).__name__}")
    return raw


def _count(shape: Any, thing: str, wanted: Shape = None) -> int:
    """How many numbers an array of `shape` holds; InputError unless it is the wanted one."""
    if not (isinstance(shape, tuple) and len(shape) <= 8 and all(isinstance(n, int) and n >= 0 for n in shape)):
        raise InputError(thing, wanted="a shape", came="something else")
    # each first: the product of numbers of a million digits takes minutes
    if max(shape, default=0) > PICKLE_ELEMENTS_MAX or math.prod(shape) > PICKLE_ELEMENTS_MAX:
        raise InputError(thing, wanted=f"at most {PICKLE_ELEMENTS_MAX} numbers", came="more")
    if wanted is not None and shape != wanted:
        raise InputError(thing, wanted=f"shape {wanted}", came=str(shape))
    return math.prod(shape)


def _state_dict(record: Record, thing: str) -> dict:
    """The attributes of an object: its state, or the first part of (attributes, slots)."""
    state = record.state
    if isinstance(state, tuple) and state:
        state = state[0]
    if not isinstance(state, dict):
        raise InputError(thing, wanted=f"the state of a {record.maker}", came="none")
    return state


def _field(state: dict, name: str, thing: str) -> Any:
    if name not in state:
        raise InputError(thing, wanted=f"a record with {name!r}", came="one without")
    return state[name]


def _integers(value: Any, thing: str, depth: int) -> np.ndarray:
    array = _to_array(value, thing, depth + 1)
    if array.dtype.kind not in "iu":
        raise InputError(thing, wanted="whole numbers as places", came=str(array.dtype))
    return array.astype(np.int64).ravel()


def _sparse(record: Record, thing: str, depth: int, wanted: Shape) -> np.ndarray:
    """A dense copy of a compressed sparse matrix; entries at the same place add up, as in scipy."""
    state = _state_dict(record, thing)
    shape = state.get("_shape", state.get("shape"))
    _count(shape, thing, wanted)
    if not isinstance(shape, tuple) or len(shape) != 2:
        raise InputError(thing, wanted="a matrix", came="another shape")
    by_column = record.maker in CSC
    lines, places = (shape[1], shape[0]) if by_column else shape
    values = _to_array(_field(state, "data", thing), thing, depth + 1).ravel()
    index = _integers(_field(state, "indices", thing), thing, depth)
    start = _integers(_field(state, "indptr", thing), thing, depth)
    steps = np.diff(start)
    if len(start) != lines + 1 or start[0] != 0 or (steps < 0).any() or not start[-1] == len(index) == len(values):
        raise InputError(thing, wanted="a sparse matrix", came="parts that do not fit together")
    if len(index) and not (index.min() >= 0 and index.max() < places):
        raise InputError(thing, wanted="a sparse matrix", came="entries outside it")
    dense = np.zeros((lines, places))
    np.add.at(dense, (np.repeat(np.arange(lines), steps), index), values)
    return dense.T if by_column else dense


def _select(state: dict, thing: str, depth: int, wanted: Shape) -> np.ndarray:
    """chumpy's Select: entries `idxs` of the flattened variable `a`, in a preferred shape."""
    shape = state.get("preferred_shape")
    if shape is not None:
        _count(shape, thing, wanted)
    whole = _to_array(_field(state, "a", thing), thing, depth + 1).ravel()
    index = _integers(_field(state, "idxs", thing), thing, depth)
    if len(index) and not (index.min() >= 0 and index.max() < len(whole)):
        raise InputError(thing, wanted="a selection", came="entries that are not there")
    if shape is None:
        _count(index.shape, thing, wanted)
        return whole[index]
    if _count(shape, thing) != len(index):
        raise InputError(thing, wanted="a selection", came="a shape that does not fit")
    return whole[index].reshape(shape)
