"""Requests are checked, pictures come back in every asked form, and failures become answers."""

from __future__ import annotations

import numpy as np
import pytest
from stand_in_engine import StandInHands

from jghand_engine.errors import InputError, MemoryLimitError, RetryError
from jghand_engine.service.commands import Commands, error_header
from jghand_engine.service.protocol import Array, Message

VIEW = {"width": 40, "height": 30, "fx": 80.0, "fy": 80, "cx": 20.0, "cy": 15.0, "preset": "final"}
RIGHT = {"avatar": "builtin", "handedness": "right"}
LEFT = {"avatar": "builtin", "handedness": "left"}


def joints_at(depth_m: float) -> np.ndarray:
    joints = np.zeros((21, 3), np.float32)
    joints[:, 2] = depth_m
    return joints


def request(*, hands=(RIGHT,), joints=None, cameras=None, **changes) -> Message:
    joints = np.stack([joints_at(0.3)] * len(hands)) if joints is None else joints
    cameras = np.tile(np.eye(4), (len(hands), 1, 1)) if cameras is None else cameras
    header = {"kind": "render_picture", **VIEW, "outputs": ["rgba_f32"], "hands": list(hands), **changes}
    return Message(header, {"joints": Array.of(joints), "camera_from_hand": Array.of(cameras)})


def run(message: Message) -> dict[str, np.ndarray]:
    reply = Commands(StandInHands()).run(message)
    return {name: np.asarray(array.view()) for name, array in reply.arrays.items()}


def test_a_picture_comes_in_every_form_that_is_asked_for():
    arrays = run(request(outputs=["rgba_f32", "rgba_u8", "depth", "png"]))
    assert arrays["rgba_f32"].shape == (30, 40, 4)
    np.testing.assert_array_equal(arrays["rgba_u8"], np.rint(arrays["rgba_f32"] * 255))
    assert arrays["depth"][15, 20] == pytest.approx(0.3)
    assert arrays["depth"][0, 0] == 0
    assert bytes(arrays["png"][:4]) == b"\x89PNG"


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_hand_covers_the_farther_one_whatever_their_order(order):
    hands = [(RIGHT, joints_at(0.3)), (LEFT, joints_at(0.2))]
    arrays = run(
        request(
            hands=[hands[i][0] for i in order],
            joints=np.stack([hands[i][1] for i in order]),
            outputs=["rgba_f32", "depth"],
        )
    )
    np.testing.assert_array_equal(arrays["rgba_f32"][15, 20], (0, 0, 1, 1))  # the left hand's blue
    assert arrays["depth"][15, 20] == pytest.approx(0.2)


def test_no_hand_at_all_is_an_empty_picture():
    header = {"kind": "render_picture", **VIEW, "outputs": ["rgba_f32", "depth"], "hands": []}
    arrays = run(Message(header))
    assert arrays["rgba_f32"].shape == (30, 40, 4)
    assert not arrays["rgba_f32"].any()
    assert not arrays["depth"].any()


NAN = np.full((1, 21, 3), np.nan, np.float32)
WRONG = {
    "an unknown request": {"kind": "train"},
    "a request without a kind": {"kind": None},
    "no width": {"width": 0},
    "a width with a fraction": {"width": 40.5},
    "a width that is true": {"width": True},
    "a focal length that is a text": {"fx": "50"},
    "a focal length without end": {"fx": 1e300},
    "no outputs": {"outputs": []},
    "an unknown output": {"outputs": ["exr"]},
    "a preset that is no text": {"preset": 3},
    "hands that are no list": {"hands": RIGHT},
    "a hand that is no object": {"hands": ["right"]},
    "a hand without an avatar": {"hands": [{"handedness": "right"}]},
    "more hands than joints": {"hands": [RIGHT, LEFT]},
    "20 joints": {"joints": np.zeros((1, 20, 3), np.float32)},
    "42 joints": {"joints": np.zeros((1, 42, 3), np.float32)},
    "joints as whole numbers": {"joints": np.zeros((1, 21, 3), np.int32)},
    "joints that are not numbers": {"joints": NAN},
    "a camera without translation": {"cameras": np.zeros((1, 3, 3))},
    "a camera that scales": {"cameras": np.diag([2.0, 2, 2, 1])[None].copy()},
    "a camera that mirrors": {"cameras": np.diag([-1.0, 1, 1, 1])[None].copy()},
    "a camera of nothing": {"cameras": np.zeros((1, 4, 4))},
}


@pytest.mark.parametrize("changes", WRONG.values(), ids=WRONG.keys())
def test_a_wrong_request_is_bad_input(changes):
    good = {"hands": (RIGHT,), "joints": np.stack([joints_at(0.3)]), "cameras": np.eye(4)[None].copy()}
    message = request(**{**good, **{k: v for k, v in changes.items() if k in good and k != "hands"}})
    message.header.update({k: v for k, v in changes.items() if k not in ("joints", "cameras")})
    with pytest.raises(InputError):
        run(message)


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
