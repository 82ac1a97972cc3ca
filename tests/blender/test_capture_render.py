"""A real capture with Cycles, as small as can be: what is annotated is what the pictures show."""

import json
from pathlib import Path

import numpy as np
import pytest
from hands import pixels
from tiny_captures import HEIGHT, WIDTH, make

from blender_addon.capture.scene import SIGNATURE, STAMP_KEY

CAMERAS = 3
# the command with a person's skin of few texels
PROGRAM = (
    "import sys\nfrom jghand_engine.captures.making import person_skin\nfrom jghand_engine.cli import main\n"
    "person_skin.MAP_PX = 256\nsys.exit(main())\n"
)


def capture(engine_python: str, folder: Path) -> str:
    # of fewer samples the filter, 1.5 pixels wide, leaves half a pixel more of the outline: chance, not geometry
    # a joint lies 4 to 12 mm below the skin: it cannot be nearer to the outline than the smallest of that, in pixels
    words = ("--cameras", str(CAMERAS), "--poses", "2", "--samples", "8", "--subdivisions", "1")
    return make(engine_python, folder, PROGRAM, *words)


@pytest.fixture(scope="module")
def captured(engine_python, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("capture") / "tiny"
    capture(engine_python, folder)
    return folder


def annotations(folder: Path, name: str) -> dict:
    return json.loads((folder / f"annotations/train/InterHand2.6M_train_{name}.json").read_text(encoding="utf-8"))


def seen(folder: Path) -> list[tuple[Path, np.ndarray]]:
    """Every picture with its 21 joints in pixels, by nothing but the annotations."""
    data, cameras, joints = (annotations(folder, name) for name in ("data", "camera", "joint_3d"))
    result = []
    for image in data["images"]:
        rig = {name: np.array(values[image["camera"]]) for name, values in cameras[str(image["capture"])].items()}
        world_mm = np.array(joints[str(image["capture"])][str(image["frame_idx"])]["world_coord"])[:21]
        camera_mm = (world_mm - rig["campos"]) @ rig["camrot"].T
        px = camera_mm[:, :2] / camera_mm[:, 2:] * rig["focal"] + rig["princpt"]
        result.append((folder / "images/train" / image["file_name"], px))
    return result


def test_every_joint_projects_onto_the_hand(captured, context):
    pictures = seen(captured)
    assert len(pictures) == 2 * CAMERAS
    for path, px in pictures:
        alpha = pixels(path, as_it_is=True)[..., 3]
        assert alpha.shape == (HEIGHT, WIDTH)
        # tips lie on the skin, and half a pixel beside it is not on it: the nearest pixels count
        column, row = np.floor(px).astype(int).T
        around = [alpha[np.clip(row + dy, 0, HEIGHT - 1), np.clip(column + dx, 0, WIDTH - 1)]
                  for dy in (-1, 0, 1) for dx in (-1, 0, 1)]  # fmt: skip
        on_tips = np.isin(np.arange(21), [0, 4, 8, 12, 16])
        assert (np.max(around, axis=0)[on_tips] > 0.5).all(), path
        # the wrist is the last joint, on the cut's inner side; the others lie inside the hand
        assert (alpha[row, column][~on_tips] > 0.5).all(), path


def test_the_outline_is_that_of_the_annotated_box(captured, context):
    """A shift or a scale of the camera would show here at once."""
    boxes = {a["image_id"]: a["bbox"] for a in annotations(captured, "data")["annotations"]}
    compared = 0
    for number, (path, joints_px) in enumerate(seen(captured)):
        place = np.argwhere(pixels(path, as_it_is=True)[..., 3] > 0.5)[:, ::-1]
        # the box is that of the hand, without the forearm, which is on the other side of the wrist
        wrist, knuckle = joints_px[20], joints_px[11]
        is_hand = (place - wrist) @ (knuckle - wrist) > 0
        x, y, width, height = boxes[number]
        for axis, first, last in ((0, x, x + width), (1, y, y + height)):
            for found, annotated in ((place[:, axis].min(), first), (place[:, axis].max(), last - 1)):
                if is_hand[place[:, axis] == found].all():
                    # ... of the mesh, and the picture that of the mesh made round, up to 1 mm smaller: 0.3 px here
                    assert found == pytest.approx(annotated, abs=1.5), path
                    compared += 1
    assert compared >= 2 * len(boxes)


def test_pictures_are_lit_hands_with_straight_alpha_and_a_stamp(captured, context):
    for path, _ in seen(captured):
        assert path.read_bytes().startswith(SIGNATURE)
        assert STAMP_KEY.encode() in path.read_bytes()
        # nothing of the day, the machine or the render time
        assert b"RenderTime" not in path.read_bytes()
        values = pixels(path, as_it_is=True)
        inside = values[values[..., 3] > 0.99][:, :3]
        assert 0.25 < inside.mean() < 0.9
        assert (inside.mean(0)[:-1] > inside.mean(0)[1:]).all()  # skin: red over green over blue
        edge = (values[..., 3] > 0.2) & (values[..., 3] < 0.8)
        # premultiplied color would be dark where alpha is low; observed means within 25 % of the inside
        assert values[edge][:, 0].mean() > 0.6 * inside[:, 0].mean()


def test_the_same_plan_gives_the_same_pictures(captured, engine_python, tmp_path):
    """A picture that is lost comes back byte for byte, and the others are left alone."""
    lost, kept = (path for path, _ in seen(captured)[:2])
    before, kept_at = lost.read_bytes(), kept.stat().st_mtime_ns
    lost.unlink()
    assert "1 pictures" in capture(engine_python, captured)
    assert lost.read_bytes() == before
    assert kept.stat().st_mtime_ns == kept_at
