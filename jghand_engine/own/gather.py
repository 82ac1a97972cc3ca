"""What the pictures of a film show of every Gaussian: the rasterizer's own gradient says which pixels are whose.

With w_np the weight by which Gaussian n colors pixel p, occlusion and softness included, the gradient of
sum_p C_p . (I_p m_p) with respect to the Gaussians' colors is sum_p w_np I_p m_p, and that of sum_p C_p m_p is
sum_p w_np m_p: their quotient is the mean color that a Gaussian shows in a picture, the second how well it is seen
there. No texture is unwrapped, and no visibility tested.

Everything is of a right hand; pictures of a left one come mirrored (`film.FilmPictures`). Frames are those of motions:
y up, z towards the camera, which is the origin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import binary_erosion, distance_transform_edt
from torch import Tensor

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.color import srgb_to_linear
from jghand_engine.hand.joints import PARENTS, Handedness
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.light import unit
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.skeleton import BoneTransforms, JointTransform
from jghand_engine.learn.skinning import pose_skin, skin_maps
from jghand_engine.learn.tensors import HandTensors
from jghand_engine.own.film import BURNT_U8
from jghand_engine.own.masks import hand_size_px, wrist_side
from jghand_engine.render.camera import Camera
from jghand_engine.render.settings import RenderSettings
from jghand_engine.track.track import MOTION_FROM_CAMERA

# pixels of the outline that are mixed with what is behind it
EDGE_PX = 2
# what is farther from the hand than this, of its size, is surely behind it
BESIDE_PART = 0.05
# what is shown around the joints, of the hand's length in the picture
CROP_MARGIN = 0.25
# a Gaussian that colors less of a picture than this many pixels is not seen in it; from how many on it counts half
SEEN_MIN_PX, SEEN_HALF_PX = 0.15, 0.5
# of fewer pictures none is held out, and marks are those of the best one
FEW_PICTURES = 8
# how bent a finger is at which what a picture shows of it counts half, degrees of knuckle and middle joint. The fit of
# a fist is a little open: it paints its fingers on the palm, and what is behind them on their backs
BENT_DEG, BENT_POWER = 60.0, 4
# bones of index to pinky, by the joint at their end: of the palm, and the three of the finger
PALM_BONES, FIRST_BONES, MIDDLE_BONES, LAST_BONES = (slice(start, start + 4) for start in (2, 7, 12, 17))


@dataclass(frozen=True)
class Shown:
    """One picture and the hand that stands in it.

    camera:     of the part of the picture around the hand
    radiance:   (h, w, 3) that part, as linear light
    counts:     (h, w) 0 or 1: skin, away from its outline and the wrist, not burnt out
    bones:      of the pose
    position_m: (N, 3), normal (N, 3) unit, sigma_m (N,) of the posed Gaussians
    shade:      (N, 3) logarithm that the pose adds; 0 without correctives
    """

    camera: Camera
    radiance: Tensor
    counts: Tensor
    bones: BoneTransforms
    position_m: Tensor
    normal: Tensor
    sigma_m: Tensor
    shade: Tensor

    @property
    def facing(self) -> Tensor:
        """(N,) cosine between the normals and the way to the camera, 0 for what faces away."""
        return facing(self.normal, self.position_m)

    def draw(self, rgb: Tensor, opacity: Tensor) -> tuple[Tensor, Tensor]:
        """Color (h, w, 3), premultiplied, and alpha (h, w) of Gaussians with these colors (N, 3)."""
        gaussians = Gaussians(self.position_m, self.sigma_m, opacity, rgb)
        picture = rasterize(gaussians, self.camera, RenderSettings(threads=1))
        return picture.rgb, picture.alpha

    def given_back(self, rgb: Tensor, opacity: Tensor) -> tuple[Tensor, Tensor]:
        """What each Gaussian would have to add to its color (N, 3) for the picture to be the film's, as the mean over
        its pixels, and how many pixels (N,) it has."""
        rgb = rgb.detach().requires_grad_()
        drawn, alpha = self.draw(rgb, opacity)
        # what does not cover a pixel wholly is compared with as much of the picture
        return mean_of_pixels(drawn, rgb, (self.radiance * alpha[..., None] - drawn).detach(), self.counts)


def facing(normal: Tensor, position_m: Tensor) -> Tensor:
    """(N,) cosine between normals (N, 3) and the way to the camera, which is the origin; 0 for what faces away."""
    return (normal * unit(-position_m)).sum(-1).clamp_min(0)


def counted(seen: Tensor) -> Tensor:
    """0..1 how much a picture says of a Gaussian that has so many pixels in it."""
    return seen / (seen + SEEN_HALF_PX)


def mean_of_pixels(drawn: Tensor, rgb: Tensor, values: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """Mean (N, 3) of a picture's values (h, w, 3) over the pixels that each Gaussian has, and how many (N,) these are.

    The rasterizer says who has what: the gradient of a picture by the colors is the weight with which each Gaussian
    colors each pixel, what covers it and how softly it ends included. drawn: (h, w, 3) of colors `rgb` (N, 3) ·
    counts: (h, w) 0..1
    """
    (summed,) = torch.autograd.grad((drawn * values * counts[..., None]).sum(), rgb, retain_graph=True)
    (weight,) = torch.autograd.grad((drawn[..., 0] * counts).sum(), rgb)
    pixels = weight[:, 0]
    return summed / pixels.clamp_min(1e-6)[:, None], pixels


@dataclass(frozen=True)
class Observations:
    """What F pictures show of N Gaussians.

    shown:  the pictures
    color:  (F, N, 3) mean linear color of the pixels that a Gaussian has
    seen:   (F, N) how many pixels, times how squarely it faces the camera, squared; 0: not seen
    trust:  (F, N) 0..1, less for what is bent
    behind: (3,) mean linear color of what is behind the hand; None where it hides all
    """

    shown: tuple[Shown, ...]
    color: Tensor
    seen: Tensor
    trust: Tensor
    behind: Tensor | None

    def __len__(self) -> int:
        return len(self.shown)


def observe(
    avatar: HandAvatar, joints_m: np.ndarray, camera: Camera, pictures: np.ndarray, masks: np.ndarray
) -> Observations:
    """joints_m: (F, 21, 3) level order, in the camera's axes · camera: of one picture · pictures: (F, H, W, 3) uint8 ·
    masks: (F, H, W) where the hand is"""
    shown = tuple(_shown(avatar, joints_m, camera, pictures, masks))
    trust = torch.from_numpy(trusted(joints_m) @ avatar.bone_weights.T.astype(np.float64)).float()
    opacity, black = torch.tensor(avatar.opacity), torch.zeros(len(avatar), 3)
    color, seen = [], []
    for one in shown:
        mean, pixels = one.given_back(black, opacity)
        color.append(mean)
        seen.append(torch.where(pixels > SEEN_MIN_PX, pixels * one.facing.square(), 0))
    return Observations(shown, torch.stack(color), torch.stack(seen), trust, _behind(joints_m, camera, pictures, masks))


def _behind(joints_m: np.ndarray, camera: Camera, pictures: np.ndarray, masks: np.ndarray) -> Tensor | None:
    """Of `Observations`: the forearm is on the other side of the wrist. What is burnt out is at least so bright."""
    joints_px, _ = camera.project(joints_m)
    summed, count = np.zeros(3), 0
    for mask, side, size_px, picture in zip(
        masks, wrist_side(joints_px, camera.width, camera.height), hand_size_px(joints_px), pictures, strict=True
    ):
        away = side & (distance_transform_edt(~mask) > BESIDE_PART * size_px)
        summed, count = summed + srgb_to_linear(picture[away] / 255).sum(0), count + int(away.sum())
    return torch.from_numpy(summed / count).float() if count else None


def trusted(joints_m: np.ndarray) -> np.ndarray:
    """(F, 21) 0..1 by bones: of a bent finger its own, of the palm and the thumb the mean's of all four.
    joints_m: (F, 21, 3)"""
    bone = np.diff(joints_m[:, [list(PARENTS), list(range(21))]], axis=1)[:, 0]
    bone = bone / np.maximum(np.linalg.norm(bone, axis=-1, keepdims=True), 1e-9)

    def bend_deg(first: slice, second: slice) -> np.ndarray:
        return np.degrees(np.arccos(np.clip((bone[:, first] * bone[:, second]).sum(-1), -1, 1)))

    bend = bend_deg(PALM_BONES, FIRST_BONES) + bend_deg(FIRST_BONES, MIDDLE_BONES)
    every = np.repeat(bend.mean(1, keepdims=True), 21, 1)
    for bones in (FIRST_BONES, MIDDLE_BONES, LAST_BONES):
        every[:, bones] = bend
    return 1 / (1 + (every / BENT_DEG) ** BENT_POWER)


def _shown(
    avatar: HandAvatar, joints_m: np.ndarray, camera: Camera, pictures: np.ndarray, masks: np.ndarray
) -> Iterator[Shown]:
    hand = HandTensors.of(avatar.for_hand(Handedness.RIGHT))
    info, learned = avatar.info, hand.learned
    transform = JointTransform(
        avatar.canonical_joints_m, handedness=Handedness.RIGHT, swing=info.swing, scale_mode=info.scale_mode
    )
    assert learned is not None
    turned = np.diag([*MOTION_FROM_CAMERA, 1.0])
    every_px, _ = camera.project(joints_m)
    # the skin behind the wrist is the forearm's, whose place no joint says
    inside = masks & wrist_side(every_px, camera.width, camera.height)
    for joints, joints_px, picture, mask in zip(joints_m, every_px, pictures, inside, strict=True):
        with torch.no_grad():
            bones = transform.bones(torch.tensor(joints * MOTION_FROM_CAMERA, dtype=torch.float32))
            correction = None if learned.correctives is None else learned.correctives(bones.frames)
            skin = pose_skin(hand, bones, correction, maps=skin_maps(hand.bone_weights, bones))
        assert skin.normal is not None
        low, high = _window(joints_px, camera)
        part = np.s_[low[1] : high[1], low[0] : high[0]]
        counts = binary_erosion(mask, iterations=EDGE_PX)
        counts &= (picture < BURNT_U8).all(-1)
        crop = camera.part(*(int(edge) for edge in (*low, *(high - low))))
        yield Shown(
            replace(crop, camera_from_world=camera.camera_from_world @ turned),
            torch.from_numpy(srgb_to_linear(picture[part].astype(np.float32) / 255)),
            torch.from_numpy(counts[part].astype(np.float32)),
            bones,
            skin.matt.position_m.float(),
            skin.normal.float(),
            skin.matt.sigma_m.float(),
            torch.zeros(len(avatar), 3) if skin.shade is None else skin.shade.float(),
        )


def _window(joints_px: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """First and last column and row around a hand, within the picture, at least one of each."""
    margin = CROP_MARGIN * np.linalg.norm(np.ptp(joints_px, axis=0))
    size = np.array([camera.width, camera.height])
    low = np.clip(np.floor(joints_px.min(0) - margin).astype(int), 0, size - 1)
    return low, np.clip(np.ceil(joints_px.max(0) + margin).astype(int), low + 1, size)
