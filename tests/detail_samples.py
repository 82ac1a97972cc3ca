"""A hand with a texture of detail: the painted one, with the template's skin around it."""

from dataclasses import replace
from functools import cache

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_painted
from jghand_engine.avatar.detail import Detail, ratio_bytes
from jghand_engine.avatar.detail_correctives import NUMBERS, DetailCorrectives
from jghand_engine.hand.joints import Handedness
from jghand_engine.template.builtin import load_template
from jghand_engine.template.subdivision import Subdivision

# of correctives at random, meters per step: they move the skin of a fist by a millimeter
STEP_M = 2e-6
# the Gaussians of the painted hand lie on its skin
DEPTH_M = 0.0


def noise(size: int, seed: int = 0, spread: float = 0.2) -> np.ndarray:
    """(size, size, 3) bytes of a texture of noise."""
    ratios = np.random.default_rng(seed).normal(0.0, spread, (size, size, 3))
    return ratio_bytes(ratios)


def flat(size: int, log_ratio: float) -> np.ndarray:
    """One ratio everywhere."""
    return np.broadcast_to(ratio_bytes(np.array(log_ratio)), (size, size, 3)).copy()


@cache
def _skin() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    template = load_template()
    fine = Subdivision.of(template.faces, template.face_uv, 1)
    skin = fine.faces[: 4 * template.skin_face_count]
    used, corners = np.unique(skin, return_inverse=True)
    weights = (fine.matrix @ template.bone_weights)[used]
    return (
        (fine.matrix @ template.vertices_m)[used].astype(np.float32),
        (weights / weights.sum(1, keepdims=True)).astype(np.float32),
        corners.reshape(-1, 3).astype(np.int32),
        fine.face_uv[: len(skin)].astype(np.float32),
    )


def detail_of(texture: np.ndarray) -> Detail:
    return Detail(*_skin(), texture, DEPTH_M)


def moving(avatar: HandAvatar) -> HandAvatar:
    """With a surface that poses move to one side or the other, all over alike."""
    detail = avatar.detail
    assert detail is not None
    one = np.random.default_rng(3).integers(-127, 128, (NUMBERS, 3)).astype(np.int8)
    direction = np.broadcast_to(one, (len(detail.position_m), NUMBERS, 3)).copy()
    scale_m = np.full(len(direction), STEP_M, np.float32)
    return replace(avatar, detail=replace(detail, correctives=DetailCorrectives(direction, scale_m)))


def detailed(texture: np.ndarray, handedness: Handedness = Handedness.RIGHT) -> HandAvatar:
    return replace(load_painted(handedness=handedness), detail=detail_of(texture))
