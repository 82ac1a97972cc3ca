"""Draws how to film a hand for `jghand own`: docs/filming.png.

    python scripts/draw_filming.py --out docs/filming.png

Wants the extra `study`. The hands are the built-in one's, before a telephone's camera at the distance that is advised.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle
from matplotlib.transforms import Affine2D

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset
from jghand_engine.track import CAMERA_ANGLE_DEG

INK, WALL, TABLE, CASE, BOOK, SUN = "#33363b", "#dfe5e3", "#c9b79c", "#3d4249", "#8fa6a0", "#e0a63a"
SIZE_PX = (270, 480)
# so that the hand is well in the frame; where the wrist is, so that the forearm leaves the frame
DISTANCE_M, WRIST_M = 0.32, -0.095
# what is shown in the frames: the pose, how far the hand has turned about the forearm, and tilted, degrees; the words
MOVES = (
    ("open", 0, 0, "1  flat palm,\nhold 2 s"),
    ("fist", 0, 0, "2  fist,\nand open"),
    ("open", -90, 0, "3  turn over the\nthumb's side, 3 s"),
    ("open", 180, 0, "4  flat back,\nhold 2 s"),
    ("fist", 180, 0, "5  fist,\nand open"),
    ("open", 180, -28, "6  finger tips near\nand far; turn back"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    out: Path = parser.parse_args().out
    mpl.rcParams["font.family"] = "DejaVu Sans"
    figure = Figure(figsize=(12.4, 3.7), dpi=100, facecolor="white")
    scene(figure.add_axes((0.0, 0.0, 0.32, 1.0)))
    width = 0.101
    for place, (pose, turn_deg, tilt_deg, words) in enumerate(MOVES):
        axes = figure.add_axes((0.335 + place * (width + 0.0085), 0.2, width, 0.74))
        screen(axes, seen(pose, turn_deg, tilt_deg), words)
    figure.savefig(out, pil_kwargs={"optimize": True})


def seen(pose: str, turn_deg: float, tilt_deg: float) -> np.ndarray:
    """(H, W, 3) the right hand in a pose, as the telephone sees it: fingers up, on the color of the wall."""
    width, height = SIZE_PX
    focal_px = height / (2 * math.tan(math.radians(CAMERA_ANGLE_DEG) / 2))
    camera = Camera(width, height, focal_px, focal_px, width / 2, height / 2, np.diag([1.0, -1.0, -1.0, 1.0]))
    avatar = load_builtin(handedness=Handedness.RIGHT)
    joints_m = named_pose(pose, avatar.canonical_joints_m, handedness=Handedness.RIGHT)
    turns = np.radians([[0.0, turn_deg, 0.0], [tilt_deg, 0.0, 0.0]])
    turn = vector_rotation(turns)
    placed = (joints_m - joints_m[0]) @ turn[0].T @ turn[1].T + (0.0, WRIST_M, -DISTANCE_M)
    rgba = HandRenderer(avatar, preset("final")).render(placed, camera).rgba
    return np.clip(rgba[..., :3] + (1 - rgba[..., 3:]) * to_rgb(WALL), 0, 1)


def screen(axes: Axes, picture: np.ndarray, words: str) -> None:
    """What the telephone shows, in its case, with words below."""
    height, width = picture.shape[:2]
    axes.set(xlim=(-14, width + 14), ylim=(height + 14, -14), aspect="equal")
    axes.axis("off")
    box = FancyBboxPatch((0, 0), width, height, boxstyle="round,pad=10,rounding_size=26", color=CASE, lw=0)
    axes.add_patch(box)
    image = axes.imshow(picture, extent=(0, width, height, 0), interpolation="lanczos", zorder=2)
    clip = FancyBboxPatch((8, 8), width - 16, height - 16, boxstyle="round,pad=8,rounding_size=16", lw=0)
    clip.set_transform(axes.transData)
    image.set_clip_path(clip)
    axes.text(width / 2, height + 24, words, ha="center", va="top", fontsize=10, color=INK, linespacing=1.3)


def scene(axes: Axes) -> None:
    """From the side, centimeters: a telephone that leans on books, and the hand before it."""
    axes.set(xlim=(-18, 62), ylim=(-28, 78), aspect="equal")
    axes.axis("off")
    axes.add_patch(Rectangle((-18, -4), 37, 4, color=TABLE, lw=0))
    axes.add_patch(Rectangle((57, -14), 5, 74, color=WALL, lw=0))
    axes.text(55.6, 58, "plain wall", rotation=90, ha="right", va="top", fontsize=9, color=INK)
    for height, (left, width) in enumerate(((-15, 13), (-14, 11), (-14.5, 12))):
        axes.add_patch(Rectangle((left, 5 * height + 0.3), width, 4.4, color=BOOK, lw=0))
    lean = Affine2D().rotate_deg(12).translate(2.2, 0.2) + axes.transData
    case = FancyBboxPatch((-1.1, 0.3), 1.1, 15.0, boxstyle="round,pad=0.2", color=CASE, lw=0, transform=lean)
    axes.add_patch(case)
    # what it sees
    eye, half = np.array([0.0, 13.0]), math.radians(CAMERA_ANGLE_DEG / 2)
    ends = [eye + 44 * np.array([math.cos(0.12 + side * half), math.sin(0.12 + side * half)]) for side in (-1, 1)]
    axes.add_patch(Polygon([eye, *ends], closed=True, color="#a8c4d8", alpha=0.28, lw=0))
    # the hand, from its thumb's side
    picture = side_view()
    axes.imshow(picture, extent=(24, 54, -14, 39.3), interpolation="lanczos", zorder=3)
    axes.annotate("", (0, 43), (39, 43), arrowprops={"arrowstyle": "<->", "color": INK, "lw": 1.3})
    axes.text(19.5, 45, "30 to 60 cm", ha="center", fontsize=10, color=INK)
    # light from the front
    axes.add_patch(Rectangle((-17, 48), 13, 24, color=SUN, alpha=0.35, lw=0))
    axes.plot([-10.5, -10.5], [48, 72], color="white", lw=2)
    axes.plot([-17, -4], [60, 60], color="white", lw=2)
    for offset in (0, 6):
        axes.annotate(
            "", (16, 52 + offset), (-2, 62 + offset), arrowprops={"arrowstyle": "->", "color": SUN, "lw": 1.6}
        )
    axes.text(-17, 75, "light from the front or the side", fontsize=9, color=INK, va="center")
    axes.text(-17, -16, "the telephone leans: it must not move;", fontsize=10, color=INK, va="top")
    axes.text(-17, -22, "wrist and bare forearm are in the frame", fontsize=10, color=INK, va="top")


def side_view() -> np.ndarray:
    """(H, W, 4) the right hand from the side, its palm to the left; straight alpha."""
    width, height = SIZE_PX
    camera = Camera(width, height, 2200.0, 2200.0, width / 2, height / 2, np.diag([1.0, -1.0, -1.0, 1.0]))
    avatar = load_builtin(handedness=Handedness.RIGHT)
    joints_m = named_pose("open", avatar.canonical_joints_m, handedness=Handedness.RIGHT)
    turn = vector_rotation(np.radians([[0.0, -90.0, 0.0]]))[0]
    rgba = (
        HandRenderer(avatar, preset("final")).render((joints_m - joints_m[0]) @ turn.T + (0, -0.03, -1.5), camera).rgba
    )
    alpha = rgba[..., 3:]
    return np.clip(np.concatenate([rgba[..., :3] / np.maximum(alpha, 1e-3), alpha], -1), 0, 1)


if __name__ == "__main__":
    main()
