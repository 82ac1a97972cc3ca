"""The shapes in which hands differ beyond the lengths of their bones: an avatar in one of them, and the fit's basis."""

from __future__ import annotations

import functools

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.npz_files import read_arrays
from jghand_engine.template.builtin import ASSETS, WITH_FOREARM, load_fields, template_called
from jghand_engine.template.reshape import places_after, reshaped
from jghand_engine.template.surface import vertex_normals

# two that the identities of captures differ in, in standard deviations; six growths of a tenth about the bones: of
# thumb, index, middle, ring, pinky and palm; smooth bumps of the skin (scripts/build_shape_basis.py), and finer ones
COARSE_COUNT = 2 + 6 + 48
SHAPE_COUNT = COARSE_COUNT + 152
# step of the differences by which the basis of an avatar's Gaussians is found
_STEP = 0.1


def in_shape(avatar: HandAvatar, shape: np.ndarray) -> HandAvatar:
    """The avatar on the built-in template with so much (SHAPE_COUNT,) of each shape; bones keep their lengths."""
    template = template_called(avatar.info.template)
    after_m = template.vertices_m + np.einsum("k,kvc->vc", np.asarray(shape, np.float64), _shapes(template.identifier))
    return reshaped(avatar, template.faces, template.vertices_m, after_m)


def shape_basis(avatar: HandAvatar, place_m: np.ndarray) -> np.ndarray:
    """(SHAPE_COUNT, N, 3) float32 how far each shape carries places (N, 3) of an avatar's canonical hand, meters."""
    template = template_called(avatar.info.template)
    after_m = template.vertices_m + _STEP * _shapes(template.identifier)
    moved = places_after(place_m, template.faces, template.vertices_m, after_m).astype(np.float64)
    return ((moved - place_m) / _STEP).astype(np.float32)


@functools.cache
def _shapes(identifier: str) -> np.ndarray:
    """(SHAPE_COUNT, V, 3) meters of a template's vertices."""
    template = template_called(identifier)
    stored = read_arrays(ASSETS / "hand_shapes.npz", ("shapes", "bumps"), "the shapes that come with JGHand")
    outwards = vertex_normals(template.vertices_m, template.faces)
    # stored: the hand's skin, the middle of the cap that closes its wrist, the forearm
    cap, end = len(load_fields()["base_index"]), stored["bumps"].shape[1]
    kept = np.r_[:cap, cap + 1 : end] if identifier == WITH_FOREARM else np.r_[: cap + 1]
    return np.concatenate([stored["shapes"][:, kept], stored["bumps"][:, kept, None] * outwards], dtype=np.float64)
