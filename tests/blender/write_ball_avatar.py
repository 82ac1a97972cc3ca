"""Writes an avatar that is a matt gray ball in the palm, as it is seen from +z: run by the engine's Python.

    python write_ball_avatar.py FILE ALBEDO RADIUS_M X Y Z     middle at X Y Z, canonical, meters

It learned in known light, as its file says, and is Lambertian: no gloss, no softness. Its Gaussians lie in a plane
of square facets with the normals that a ball has at their middles: there nothing but that normal is seen.
"""

import sys
from pathlib import Path

import numpy as np

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.avatar.file import save_avatar
from jghand_engine.avatar.learned import Anchors, CastShadow, Learned, SkinResponse, bone_flesh, no_light
from jghand_engine.avatar.scene_light import CELLS
from jghand_engine.hand.joints import Handedness
from jghand_engine.template.builtin import load_template

COUNT, ANCHORS = 16_000, 3
# side of a facet, radii of the ball
FACET = 0.125
# as wide as they are apart: nothing is seen between them
SIGMA_RADII, OPACITY = 0.014, 0.95


def main(path: Path, albedo: float, radius_m: float, middle_m: np.ndarray) -> None:
    aside = np.sqrt((np.arange(COUNT) + 0.5) / COUNT)  # a Fibonacci lattice, as dense everywhere
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(COUNT)
    place = aside * np.stack([np.cos(turn), np.sin(turn), 0 * turn])
    position_m = (middle_m + radius_m * place.T).astype(np.float32)
    x, y, _ = FACET * (np.floor(place / FACET) + 0.5)
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], 1)
    normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
    on_wrist = np.zeros((COUNT, 21), np.float32)
    on_wrist[:, 0] = 1
    anchors = Anchors(
        position_m[:ANCHORS],
        normal[:ANCHORS],
        on_wrist[:ANCHORS],
        np.tile(np.arange(3), (COUNT, 1)),
        np.tile(np.array([1, 0, 0], np.float32), (COUNT, 1)),
    )
    # all flesh is its own, and throws no shadow on it
    dark = np.zeros((CELLS, 3), np.float32)
    own, joints_m = np.ones((ANCHORS, 20), np.float32), np.array(load_template().joints_m, np.float64)
    cast = CastShadow(dark, np.zeros(3, np.float32), anchors, bone_flesh(joints_m), own)
    each, none = np.ones(COUNT, np.float32), np.zeros(3, np.float32)
    response = SkinResponse(each, 0.5 * each, 0 * each, softness=none, bounce=none, shade_gain=1.0)
    save_avatar(
        path,
        HandAvatar(
            info=AvatarInfo(name="ball", template="built-in", license="CC0-1.0"),
            handedness=Handedness.RIGHT,
            canonical_joints_m=joints_m,
            position_m=position_m,
            sigma_m=SIGMA_RADII * radius_m * each,
            opacity=OPACITY * each,
            rgb=np.full((COUNT, 3), albedo, np.float32),
            bone_weights=on_wrist,
            uvd=np.full((COUNT, 3), 0.5, np.float32),
            learned=Learned(normal, 0 * each, no_light(), None, None, cast=cast, response=response),
        ),
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]), np.array(sys.argv[4:], np.float64))
