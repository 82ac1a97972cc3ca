"""An engine without torch that speaks the real protocol: 21 discs as a hand, and faults on request.

    python stand_in_engine.py [FAULT]

Runs in the engine's and in Blender's environment. FAULT: one of the names in `main`, or of those in
`StandInHands._misbehave`, with ":N" for one that comes with the N-th picture.
"""

import json
import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from jghand_engine.errors import InputError, MemoryLimitError
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.render.blur import Moment
from jghand_engine.service import protocol, server
from jghand_engine.service.commands import Canceled, LoadedAvatar, RenderedImage, never
from jghand_engine.service.image_request import ImageRequest

# radius of a joint's disc, meters
DISC_M = 0.004


class StandInHands:
    """A ImageSource: a disc at every joint, white for the right hand, blue for the left; the nearest one wins."""

    def __init__(self, fault: str = "") -> None:
        """fault: NAME, or NAME:N to behave well before the N-th picture."""
        self.fault, _, first = fault.partition(":")
        self._first, self._pictures = int(first or 1), 0
        self._canvas: np.ndarray | None = None
        self.doing = ""

    def load(self, avatar: str) -> LoadedAvatar:
        if avatar != "builtin" and not Path(avatar).is_file():
            raise InputError(f"avatar {avatar}", wanted="a file", came="nothing of that name")
        joints = np.stack([np.linspace(0, 0.1, 21), np.zeros(21), np.zeros(21)], -1)
        return LoadedAvatar({"avatar": avatar, "gaussians": 21}, joints)

    def render(self, picture: ImageRequest, canceled: Callable[[], bool] = never) -> RenderedImage:
        self._pictures += 1
        if self._pictures >= self._first:
            self._misbehave(canceled)
        if self.fault == "blank":  # for measuring the way there and back
            return self._blank(picture)
        total = sum(picture.weights)
        rgba, depth, ids, behind, near = (
            np.zeros((picture.height, picture.width, *more), np.float32) for more in ((4,), (), (), (), ())
        )
        for index, (moment, weight) in enumerate(zip(picture.moments, picture.weights, strict=True)):
            if canceled():
                raise Canceled
            color, near_m, numbers = _discs(picture, moment)
            rgba += weight / total * color
            behind, near = behind + weight * (near_m > 0), near + weight * near_m
            if index == (len(picture.moments) - 1) // 2:
                depth, ids = near_m, numbers
        covered = near / np.where(behind > 0, behind, 1)
        return RenderedImage(rgba, {"total_ms": 1.0, "stages": []}, depth, ids, covered)

    def rest(self) -> None:
        self._canvas = None

    def _blank(self, picture: ImageRequest) -> RenderedImage:
        size = (picture.height, picture.width)
        if self._canvas is None or self._canvas.shape[:2] != size:
            self._canvas = np.zeros((*size, 4), np.float32)
        return RenderedImage(self._canvas, {"total_ms": 0.0, "stages": []})

    def _misbehave(self, canceled: Callable[[], bool]) -> None:
        match self.fault:
            case "die":
                os._exit(7)
            case "killed":
                os.kill(os.getpid(), signal.SIGKILL)
            case "hang":
                print("the last words", flush=True)
                time.sleep(600)
            case "frozen":
                print("the last words", flush=True)
                os.kill(os.getpid(), signal.SIGSTOP)
            case "slow":
                self.doing = "Taking my time"
                time.sleep(1.5)
            case "late":
                time.sleep(0.2)
            case "patient":  # long, but to be stopped
                for _ in range(6000):
                    if canceled():
                        raise Canceled
                    time.sleep(0.01)
            case "late memory":  # long enough to be seen at work
                time.sleep(0.2)
                raise MemoryLimitError("a picture", wanted="less")
            case "memory":
                raise MemoryLimitError("a picture", wanted="less")
            case "bug":
                raise ZeroDivisionError("a bug")
            case "print":
                print("printed by a library " * 10000)


def _discs(picture: ImageRequest, moment: Moment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Color, depth, and the number of the joint, of one moment."""
    size = (picture.height, picture.width)
    x, y = np.meshgrid(np.arange(picture.width) + 0.5, np.arange(picture.height) + 0.5)
    rgba, depth, ids = np.zeros((*size, 4), np.float32), np.zeros(size, np.float32), np.zeros(size, np.uint8)
    camera = moment.camera
    turn, offset_m = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    points = [
        (*point, number, (1, 1, 1, 1) if hand.handedness == "right" else (0, 0, 1, 1))
        for hand, joints_m in zip(picture.hands, moment.joints_m, strict=True)
        for number, point in enumerate(from_level(joints_m, JointOrder.STANDARD) @ turn.T + offset_m)
    ]
    for px, py, pz, number, color in sorted(points, key=lambda point: -point[2]):
        if pz <= 0:
            continue
        scale = 1.0 if camera.orthographic else pz
        u, v = camera.fx * px / scale + camera.cx, camera.fy * py / scale + camera.cy
        inside = ((x - u) / camera.fx) ** 2 + ((y - v) / camera.fy) ** 2 <= (DISC_M / scale) ** 2
        rgba[inside], depth[inside], ids[inside] = color, pz, max(number, 1)
    return rgba, depth, ids


def _send_rubbish_after_welcome(connection: socket.socket, header: Mapping, *rest: object, **more: object) -> None:
    if header["kind"] == "welcome":
        connection.sendall(b"".join(protocol.encode(header)))
    else:
        connection.sendall(b"rubbish " * 8)


def main(fault: str) -> int:
    if fault == "die_at_start":
        print("ImportError: no torch here", file=sys.stderr)
        return 5
    if fault == "silent":
        time.sleep(600)
    if fault == "chatty":
        print("a library says hello", flush=True)
    if fault == "flood":
        print("noise\n" * 100_000, flush=True)
    if fault == "rubbish":
        protocol.send = _send_rubbish_after_welcome
    if fault == "stubborn":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        server._end_with_stdin = lambda *_: None
    if fault in ("garbage", "wrong_version", "wrong_port"):
        version = protocol.PROTOCOL_VERSION + (fault == "wrong_version")
        line = {"protocol": version, "port": 9, "pid": os.getpid(), "engine_version": "x"}
        print("{" if fault == "garbage" else json.dumps({**line, "capabilities": []}), flush=True)
        sys.stdin.read()
        return 0
    if fault == "mute":
        server._beat = lambda *_: None  # says nothing
    server.__version__ = os.environ.get("JGHAND_STAND_IN_VERSION", server.__version__)
    return server.serve(StandInHands(fault))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1] if len(sys.argv) > 1 else ""))
