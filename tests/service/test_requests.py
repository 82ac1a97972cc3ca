"""Requests are checked, pictures come back in every asked form, and failures become answers."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stand_in_engine import StandInHands

from jghand_engine.errors import InputError, MemoryLimitError, RetryError
from jghand_engine.service.commands import Canceled, Commands, error_header
from jghand_engine.service.protocol import Array, Message

VIEW = {"width": 40, "height": 30, "settings": {"preset": "final"}}
PINHOLE = (80.0, 80.0, 20.0, 15.0)
RIGHT = {"avatar": "builtin", "handedness": "right"}
LEFT = {"avatar": "builtin", "handedness": "left"}


def joints_at(depth_m: float) -> np.ndarray:
    joints = np.zeros((21, 3), np.float32)
    joints[:, 2] = depth_m
    return joints


def request(*, hands=(RIGHT,), joints=None, arrays=None, **changes) -> Message:
    """One moment of hands 0.3 m before the camera; `arrays` are other or more arrays, None takes one away."""
    joints = np.stack([joints_at(0.3)] * len(hands))[None] if joints is None else joints
    values = {
        "pinholes": np.array([PINHOLE]),
        "camera_from_world": np.eye(4)[None].copy(),
        "joints": joints,
        "world_from_hand": np.tile(np.eye(4), (1, max(len(hands), 1), 1, 1)),
        **(arrays or {}),
    }
    header = {"kind": "render_picture", **VIEW, "outputs": ["rgba_f32"], "hands": list(hands), **changes}
    return Message(header, {name: Array.of(array) for name, array in values.items() if array is not None})


def run(message: Message) -> dict[str, np.ndarray]:
    reply = Commands(StandInHands()).run(message)
    return {name: np.asarray(array.view()) for name, array in reply.arrays.items()}


def test_a_picture_comes_in_every_form_that_is_asked_for():
    arrays = run(request(outputs=["rgba_f32", "rgba_u8", "depth", "ids"]))
    assert arrays["rgba_f32"].shape == (30, 40, 4)
    np.testing.assert_array_equal(arrays["rgba_u8"], np.rint(arrays["rgba_f32"] * 255))
    assert arrays["depth"][15, 20] == pytest.approx(0.3)
    assert arrays["depth"][0, 0] == 0
    assert arrays["ids"].dtype == np.uint8
    assert (arrays["ids"] > 0).sum() == (arrays["depth"] > 0).sum() > 0


def test_no_hand_at_all_is_an_empty_picture():
    none = {"joints": None, "world_from_hand": None}
    arrays = run(request(hands=[], joints=NAN, arrays=none, outputs=["rgba_f32", "depth", "ids"]))
    assert arrays["rgba_f32"].shape == (30, 40, 4)
    assert not arrays["rgba_f32"].any()
    assert not arrays["depth"].any()
    assert not arrays["ids"].any()


NAN = np.full((1, 1, 21, 3), np.nan, np.float32)
MIRROR, TWICE = (np.diag([x, y, z, 1.0])[None] for x, y, z in ((-1, 1, 1), (2, 2, 2)))
WRONG_HEADERS = {
    "an unknown request": {"kind": "train"},
    "a request without a kind": {"kind": None},
    "no width": {"width": 0},
    "a width with a fraction": {"width": 40.5},
    "a width that is true": {"width": True},
    "no outputs": {"outputs": []},
    "an unknown output": {"outputs": ["exr"]},
    "an output that is a list": {"outputs": [["ids"]]},
    "hands that are no list": {"hands": RIGHT},
    "a hand that is no object": {"hands": ["right"]},
    "a hand without an avatar": {"hands": [{"handedness": "right"}]},
    "a forearm that is a text": {"hands": [{**RIGHT, "forearm": "shown"}]},
    "more hands than joints": {"hands": [RIGHT, LEFT]},
    "a hundred hands": {"hands": [RIGHT] * 100},
    "parallel rays that are a number": {"orthographic": 1},
    "settings that are a text": {"settings": "final"},
    "an unknown setting": {"settings": {"quality": "best"}},
    "a preset that is no text": {"settings": {"preset": 3}},
    "a preset without end": {"settings": {"preset": "final" * 1000}},
    "no time at all": {"settings": {"budget_ms": 0}},
    "a time that is a text": {"settings": {"budget_ms": "16"}},
    "a time without end": {"settings": {"budget_ms": 1e300}},
}
WRONG_ARRAYS = {
    "no pinhole": {"pinholes": None},
    "three numbers of a pinhole": {"pinholes": np.ones((1, 3))},
    "a focal length of nothing": {"pinholes": np.array([(0.0, 80, 20, 15)])},
    "a focal length without end": {"pinholes": np.array([(1e300, 80, 20, 15)])},
    "a focal length that is no number": {"pinholes": np.array([(np.nan, 80, 20, 15)])},
    "more moments than anybody needs": {"pinholes": np.ones((1000, 4))},
    "more moments than cameras": {"pinholes": np.ones((2, 4))},
    "a lens behind its picture": {"lenses": np.array([(0.01, -1.0)])},
    "a lens of less than nothing": {"lenses": np.array([(-0.01, 1.0)])},
    "a lens without focus": {"lenses": np.array([(0.01, np.inf)])},
    "a moment that never was": {"weights": np.array([0.0])},
    "a moment that counts against": {"weights": np.array([-1.0])},
    "20 joints": {"joints": np.zeros((1, 1, 20, 3), np.float32)},
    "42 joints": {"joints": np.zeros((1, 1, 42, 3), np.float32)},
    "no joints": {"joints": None},
    "joints of another moment": {"joints": np.zeros((2, 1, 21, 3), np.float32)},
    "joints as whole numbers": {"joints": np.zeros((1, 1, 21, 3), np.int32)},
    "joints that are not numbers": {"joints": NAN},
    "joints beyond the stars": {"joints": np.full((1, 1, 21, 3), 1e30)},
    "a forearm turned by three numbers": {"forearms": np.ones((1, 1, 3))},
    "forearms of two hands": {"forearms": np.ones((1, 2, 4))},
    "a forearm that is turned by nothing": {"forearms": np.zeros((1, 1, 4))},
    "a camera without translation": {"camera_from_world": np.zeros((1, 3, 3))},
    "a camera that scales": {"camera_from_world": TWICE},
    "a camera that mirrors": {"camera_from_world": MIRROR},
    "a camera of nothing": {"camera_from_world": np.zeros((1, 4, 4))},
    "a camera beyond the stars": {"camera_from_world": np.full((1, 4, 4), 1e308)},
    "a place that scales": {"world_from_hand": TWICE[None]},
    "a place that mirrors": {"world_from_hand": MIRROR[None]},
    "a place that is not there": {"world_from_hand": None},
    "a place that is no number": {"world_from_hand": np.full((1, 1, 4, 4), np.nan)},
}


@pytest.mark.parametrize("changes", WRONG_HEADERS.values(), ids=WRONG_HEADERS.keys())
def test_a_wrong_request_is_bad_input(changes):
    message = request()
    message.header.update(changes)
    with pytest.raises(InputError):
        run(message)


@pytest.mark.parametrize("changes", WRONG_ARRAYS.values(), ids=WRONG_ARRAYS.keys())
def test_a_wrong_array_is_bad_input(changes):
    with pytest.raises(InputError):
        run(request(arrays=changes))


AT_POINTS = {
    "left": np.full((1, 2, 7), 255, np.uint8),
    "left_at": np.zeros((7, 3), np.float32),
    "baked": np.zeros((1, 9, 4, 3), np.float32),
    "baked_at": np.zeros((9, 3), np.float32),
}
WRONG_AT_POINTS = {
    "points that are not said": {"left_at": None},
    "points of light that are not said": {"baked_at": None},
    "points on a plane": {"baked_at": np.zeros((9, 2))},
    "fewer points": {"left_at": np.zeros((6, 3))},
    "parts of another lamp": {"left": np.full((1, 3, 7), 255, np.uint8)},
    "light of another hand": {"baked": np.zeros((2, 9, 4, 3))},
    "light that does not turn": {"baked": np.zeros((1, 9, 3))},
    "light that is one number": {"baked": np.zeros(1)},
    "light that is no number": {"baked": np.full((1, 9, 4, 3), np.nan)},
}


@pytest.mark.parametrize("changes", [*WRONG_AT_POINTS.values(), {}], ids=[*WRONG_AT_POINTS.keys(), "nothing wrong"])
def test_light_at_points_of_the_skin_fits_hands_lamps_and_points(changes):
    message = request(light={"lamps": [{}, {}], "world": None}, arrays=AT_POINTS | changes)
    with pytest.raises(InputError, match=r"left|baked") if changes else contextlib.nullcontext():
        run(message)


def test_parallel_rays_go_through_no_lens():
    with pytest.raises(InputError, match="orthographic"):
        run(request(orthographic=True, arrays={"lenses": np.array([(0.01, 1.0)])}))


def test_a_request_that_is_canceled_says_so():
    with pytest.raises(Canceled) as caught:
        Commands(StandInHands()).run(request(), lambda: True)
    assert error_header(caught.value)["kind"] == "canceled"


def test_a_picture_beyond_one_message_is_refused_before_it_is_drawn():
    with pytest.raises(MemoryLimitError):
        run(request(width=16000, height=16000))


def test_every_failure_has_its_kind():
    out_of_memory = RuntimeError("[enforce fail] DefaultCPUAllocator: not enough memory: you tried to allocate")
    assert error_header(out_of_memory)["kind"] == "out_of_memory"
    assert error_header(MemoryError())["kind"] == "out_of_memory"
    assert error_header(MemoryLimitError("a picture"))["kind"] == "out_of_memory"
    assert error_header(RetryError("busy"))["kind"] == "retry"
    assert error_header(InputError("joints", wanted="21"))["sentence"] == "joints: wanted 21."
    try:
        raise ZeroDivisionError("x" * 100_000)
    except ZeroDivisionError as error:
        answer = error_header(error)
    assert answer["kind"] == "internal"
    assert len(answer["detail"]) <= 8000


# ---- anything at all ------------------------------------------------------------------------------------------------

SCALARS = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=8)
)
ANYTHING = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
)
FIELDS = ("width", "height", "outputs", "hands", "settings", "orthographic", "kind")
SHAPES = st.lists(st.integers(1, 5), min_size=1, max_size=4)
ARRAYS = ("pinholes", "lenses", "weights", "camera_from_world", "joints", "world_from_hand")
NUMBERS = st.sampled_from([0.0, 1.0, -1.0, np.nan, np.inf, 1e308, 1e-308])


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(FIELDS), ANYTHING)
def test_whatever_stands_in_a_header_is_a_picture_or_bad_input(name, value):
    message = request()
    message.header[name] = value
    with contextlib.suppress(InputError, MemoryLimitError):
        run(message)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(ARRAYS), SHAPES, NUMBERS, st.sampled_from([np.float32, np.float64, np.uint8, np.int32]))
def test_whatever_comes_as_an_array_is_a_picture_or_bad_input(name, shape, number, dtype):
    with np.errstate(all="ignore"):
        array = np.full(shape, number).astype(dtype)
    with contextlib.suppress(InputError):
        run(request(arrays={name: array}))


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 15), NUMBERS)
def test_whatever_number_stands_in_a_camera_is_a_picture_or_bad_input(place, number):
    camera = np.eye(4)
    camera.flat[place] = number
    with contextlib.suppress(InputError):
        run(request(arrays={"camera_from_world": camera[None]}))
