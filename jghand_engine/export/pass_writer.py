"""`jghand render --passes`: ground truth beside the pictures.

passes/frame_00000.exr    the maps of a picture, as channels
joints.json               joints of every picture in 3D and 2D, and which of them one sees
colmap/, transforms.json  the camera of every picture, for COLMAP and for nerfstudio

The last three are about all pictures and are written when all are there, whoever made them. Until then the joints of a
picture stand in its own head; those of earlier pictures go with the first one that is drawn anew.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from jghand_engine import __version__
from jghand_engine.captures.image_files import image_texts
from jghand_engine.errors import InputError
from jghand_engine.export.camera_file import COLMAP_FILES, write_colmap, write_transforms
from jghand_engine.export.exr import exr_package, probe_exr, write_exr
from jghand_engine.export.passes import JOINTS, MAPS, JointWitness, channels, pass_names
from jghand_engine.files import remove_file
from jghand_engine.hand.joints import STANDARD_NAMES
from jghand_engine.json_files import write_json

if TYPE_CHECKING:
    import numpy as np

    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.render.camera import Camera
    from jghand_engine.render.renderer import Frame, HandRenderer
    from jghand_engine.render.settings import RenderSettings


JOINTS_KEY = "jghand-joints"


class PassWriter:
    """Writes the passes in `text` into `folder`, picture by picture. InputError for unknown names, and where EXR's
    package is missing."""

    def __init__(self, text: str, folder: Path) -> None:
        self.names, self._folder = pass_names(text), folder
        self._withdrawn = False
        self._maps = [name for name in self.names if name in MAPS]
        if self._maps:
            exr_package()

    def settings(self, settings: RenderSettings) -> RenderSettings:
        """The same with the maps that the passes need, in whole resolution."""
        return replace(settings, depth=set(self.names) != {"alpha"}, normals="normal" in self.names)

    def start(self, avatar: HandAvatar, renderer: HandRenderer, joints_m: np.ndarray, camera: Camera) -> None:
        """What is drawn. joints_m: (F, 21, 3) level order"""
        self._renderer, self._joints_m, self._camera = renderer, joints_m, camera
        self._hand, self._witness = avatar.handedness, JointWitness(avatar)

    def add(self, index: int, frame: Frame, picture: Path) -> dict[str, str]:
        """Writes the maps of a frame that was drawn just now; gives the texts that the head of its picture shall
        have."""
        self._withdraw()
        bones = self._renderer.bone_ids(self._camera) if "ids" in self.names else None
        if self._maps:
            about = {"jghand": __version__, "units": "meters", "axes": "camera: x right, y down, z forward"}
            write_exr(self.path(picture), channels(frame, bones, self._maps), about)
        if JOINTS not in self.names:
            return {}
        view = self._witness.look(self._joints_m[index], self._camera, frame.depth_m)
        return {JOINTS_KEY: json.dumps({"picture": picture.name, **view.as_dict()}, allow_nan=False)}

    def _withdraw(self) -> None:
        """Removes what an earlier run wrote about all pictures, once: the first of them is about to be replaced.
        RetryError when it cannot be removed."""
        if self._withdrawn:
            return
        for name in ("joints.json", "transforms.json", *(f"colmap/{file}" for file in COLMAP_FILES)):
            remove_file(self._folder / name)
        self._withdrawn = True

    def is_whole(self, picture: Path) -> bool:
        """Whether the maps of a picture are there too, undamaged."""
        if not self._maps:
            return True
        try:
            probe_exr(self.path(picture), (self._camera.width, self._camera.height))
        except InputError:
            return False
        return True

    def path(self, picture: Path) -> Path:
        """The file of the maps of a picture."""
        return self._folder / "passes" / f"{picture.stem}.exr"

    def finish(self, pictures: Sequence[Path]) -> None:
        """Writes the files about all pictures, which are there. InputError when one of them cannot be read."""
        if JOINTS in self.names:
            content = {
                "order": "standard", "names": list(STANDARD_NAMES), "unit": "m", "hand": str(self._hand),
                "frames": [json.loads(image_texts(picture)[JOINTS_KEY]) for picture in pictures],
            }  # fmt: skip
            write_json(self._folder / "joints.json", content)
        names = [picture.name for picture in pictures]
        write_colmap(self._folder / "colmap", names, self._camera)
        write_transforms(self._folder / "transforms.json", names, self._camera)


def refuse_older_truth(folder: Path, names: Sequence[str] = ()) -> None:
    """InputError when `folder` holds ground truth that a run which writes the passes `names` would leave as it is: it
    would not be true of the new pictures."""
    written = {
        "passes": any(name in MAPS for name in names), "joints.json": JOINTS in names,
        "colmap": bool(names), "transforms.json": bool(names),
    }  # fmt: skip
    left = [name for name, again in written.items() if not again and (folder / name).exists()]
    if left:
        raise InputError(
            f"--out {folder}",
            wanted="a folder without ground truth of other pictures",
            came=f"{', '.join(left)} of an earlier run",
            remedy="Remove them, choose another folder, or name the same --passes.",
        )
