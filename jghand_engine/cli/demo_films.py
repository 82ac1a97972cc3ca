"""What the demo makes of its pictures: a video of all cameras side by side, a contact sheet, a page that explains."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jghand_engine import limits
from jghand_engine.cli.console import progress
from jghand_engine.cli.demo_scene import Scene
from jghand_engine.export.pictures import (
    VIDEO_BACKGROUND,
    Cell,
    SheetStyle,
    contact_sheet,
    flatten,
    premultiplied,
    read_png,
    write_png,
)
from jghand_engine.export.video import write_video
from jghand_engine.files import writing


def write_video_of(scene: Scene) -> None:
    """hand.mp4: the cameras side by side."""
    write_video(scene.out / "hand.mp4", _side_by_side(scene), scene.sequence.fps)


def _side_by_side(scene: Scene) -> Iterator[np.ndarray]:
    with progress("Writing the video", len(scene.sequence)) as bar:
        for index in range(len(scene.sequence)):
            yield np.concatenate([_shown(scene, name, index) for name in scene.cameras], axis=1)
            bar.advance(bar.task_ids[0])


def write_sheet_of(scene: Scene) -> None:
    """contact_sheet.png: moments of the motion in columns, one row per camera."""
    count = min(limits.SHEET_COLUMNS, len(scene.sequence))
    moments = np.linspace(0, len(scene.sequence) - 1, count).round().astype(int)
    cells = [
        Cell(f"{name} · {index / scene.sequence.fps:.1f} s", _shown(scene, name, int(index)))
        for name in scene.cameras
        for index in moments
    ]
    write_png(scene.out / "contact_sheet.png", contact_sheet(cells, SheetStyle(columns=count)))


def _shown(scene: Scene, camera: str, index: int) -> np.ndarray:
    return flatten(premultiplied(read_png(scene.frames(camera).path(index))), VIDEO_BACKGROUND)


def write_readme(scene: Scene) -> None:
    """README.txt: what is where, and how to look at it."""
    cameras = ", ".join(scene.cameras)
    files = {
        "hand.mp4": f"the motion seen from {cameras}, side by side",
        "contact_sheet.png": "moments of it at one glance",
        "frames/": f"PNG pictures with alpha, one folder per camera ({cameras})",
        "motion.npz": "the 21 joint positions of every frame, meters, standard order",
        "hand.blend": "the rigged armature with the motion on it, and the cameras",
        "cameras.json": "its cameras: pixels, meters, OpenCV axes",
        "usd/hand.usda": "the animated hand for other programs; choose its variant splats, points or mesh",
        "usd/hand.shot.usda": "the hand with the cameras of this demo",
    }
    files |= {path.name: "a hand.blend that was changed before a later demo" for path in scene.previous_blends()}
    there = {name: text for name, text in files.items() if (scene.out / name).exists()}
    lines = ["What this folder holds", ""]
    there["report.json"] = "how long everything took"
    width = max(map(len, there)) + 2
    lines += [f"{name:<{width}}{text}" for name, text in there.items()]
    if scene.blend.exists():
        lines += [
            "",
            "Change the motion in hand.blend and render it anew, from the folder of the project:",
            f"  .envs/blender/bin/python scripts/render_blend.py {scene.blend} --camera {','.join(scene.cameras)} "
            "--out new_frames",
        ]
    with writing(scene.out / "README.txt") as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
