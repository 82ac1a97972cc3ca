"""What the pose changes on the surface of a detail beyond skinning: an offset of every vertex, from the joint angles.

A texture is where its surface is. Half a pixel beside the truth a wrinkle is another one, and a blend of 21 bones is a
millimeter beside a palm that cups or a finger that turns about itself. Each vertex has its own map, linear in the
angles of the bones near it and in products of two of these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.blocks import Blocks
from jghand_engine.avatar.correctives import products
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.skeleton import ANGLE_COUNT

# of a bone: the angles of its finger, flexion and abduction of three joints, and a 0; of a metacarpal those of the palm
SIMPLE = 7
# ... of which products of two of the first four follow: more of them brought a twentieth
NUMBERS = SIMPLE + 10
_FIRST, _SECOND = products(SIMPLE, NUMBERS)
# bones 0 to 5 are the palm's
_PALM_BONES, _FINGER_ANGLES = 6, 30


@dataclass(frozen=True)
class DetailCorrectives:
    """offset = scale sum_k (sum_i W_i changes_ik) direction_k in canonical axes, which turns with the skin as those of
    Gaussians do. changes: what the `angle_numbers` of a pose have more than those of the canonical hand.

    direction: (V, NUMBERS, 3) int8
    scale_m:   (V,) float32, meters
    """

    direction: np.ndarray
    scale_m: np.ndarray

    def of(self, vertices: np.ndarray) -> DetailCorrectives:
        """Those of some vertices, by their numbers."""
        return DetailCorrectives(self.direction[vertices], self.scale_m[vertices])

    def offset_m(self, bone_weights: np.ndarray, changes: np.ndarray) -> np.ndarray:
        """(V, 3) canonical axes, meters, of vertices of weights (V, 21) in a pose of changes (21, NUMBERS)."""
        mixed = bone_weights.astype(np.float64) @ changes
        return self.scale_m[:, None] * np.einsum("vk,vkc->vc", mixed, self.direction.astype(np.float64))

    def arrays(self, blocks: Blocks) -> dict[str, np.ndarray]:
        """What the kernel reads of the linear tier, by its fields of LearnedTask: no constant, no shade."""
        direction = np.pad(self.direction, ((0, 0), (0, 0), (0, 3))).reshape(len(self.direction), -1)
        constant = np.zeros((len(self.scale_m), 8), np.float32)
        constant[:, 6] = self.scale_m
        return {"direction": blocks.blocked(direction, np.int8), "constant": blocks.blocked(constant)}


def angle_numbers(angles_rad: np.ndarray) -> np.ndarray:
    """(..., 21, NUMBERS) what the bones say of a pose, of its (..., 37) angles."""
    fingers = np.moveaxis(angles_rad[..., :_FINGER_ANGLES].reshape(*angles_rad.shape[:-1], 3, 5, 2), -2, -3)
    of_finger = fingers.reshape(*angles_rad.shape[:-1], 5, 6)
    numbers = np.zeros((*angles_rad.shape[:-1], JOINT_COUNT, NUMBERS))
    numbers[..., :_PALM_BONES, :SIMPLE] = angles_rad[..., None, _FINGER_ANGLES:ANGLE_COUNT]
    numbers[..., _PALM_BONES:, : SIMPLE - 1] = np.concatenate([of_finger] * 3, -2)
    numbers[..., SIMPLE:] = numbers[..., _FIRST] * numbers[..., _SECOND]
    return numbers
