"""The hand and its motion that explain a film: bones, palm, thickness, and the pose and place in every picture.

First by what the detector says, then by pictures: outlines, and the colors that the pictures themselves give to the
skin, which are found anew as the fit goes on. Focal length and the hand's size stay as they are: a film of a turning
hand says neither.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.errors import InputError
from jghand_engine.files import writing
from jghand_engine.hand.orders import bone_lengths, hand_length
from jghand_engine.hand.sequence import bone_directions, rebuilt
from jghand_engine.npz_files import read_arrays
from jghand_engine.own.chain import Chain, chain_of, rotation
from jghand_engine.own.fit_colors import SkinColors, skin_colors
from jghand_engine.own.fit_outlines import STEPS, OutlineSurface, Sought, outline_step
from jghand_engine.own.fit_surface import FIT_GAUSSIANS, FitSurface, Kept, outline_factor
from jghand_engine.own.fit_terms import (
    Evidence,
    anatomy_terms,
    direction_term,
    directions_of,
    guide_term,
    hand_term,
    landmark_term,
    smooth_term,
)
from jghand_engine.own.fit_views import Sight, sights
from jghand_engine.own.shape import COARSE_COUNT, SHAPE_COUNT, in_shape
from jghand_engine.own.start import PACKED, Start, packed, unpacked
from jghand_engine.render.camera import Camera
from jghand_engine.track.poses import JointChain, Poses

# what is sought, and by how much a step changes it at first: radians, meters, logarithms, standard deviations
RATES = {
    "angle_rad": 0.012,
    "turn_rad": 0.008,
    "place_m": 0.0015,
    "log_length": 0.004,
    "palm_shift_m": 0.0003,
    "shape": 0.05,
}
# those that every picture has of its own
POSE_NUMBERS = ("angle_rad", "turn_rad", "place_m")
ADAM_BETAS = (0.8, 0.95)
# pictures in a step, and steps in a round: at least, for a few photographs have as much to learn, and at most, for Adam
# moves every picture in every step; rates fall by half a cosine to this part
BATCH, STEPS_MIN, STEPS_MAX, RATE_END = 10, 5, 6, 0.1
# the palm never turns farther than this from where the tracker has it: an outline does not know palm from back
TURN_MAX_RAD = math.radians(60.0)
# rounds of all pictures by landmarks alone; how often colors are found, and rounds with each
LANDMARK_ROUNDS, COLOR_TIMES, PICTURE_ROUNDS = 26, 5, 9
# what changes slowly is found anew after so many rounds: crops, the wrist's line, what the pose's network adds
RENEW_ROUNDS = 6
PICTURE_RATE = 0.7
# weights of landmarks and of directions, without pictures and with them
DETECTOR_WEIGHTS, DETECTOR_WEIGHTS_WITH_PICTURES = (0.05, 0.05), (0.03, 0.03)
OUTLINE_WEIGHT, COLOR_WEIGHT = 4.0, 4.0
# of so many poses the size of outlines is calibrated
CALIBRATION_POSES = 3
# how far outlines are likely to take what stands, as RATES; least is known of places along the camera's axis. Half or
# twice as much hardly matters
OUTLINE_SPREADS = {
    "angle_rad": (math.radians(10.0),) * 20,
    "turn_rad": (math.radians(8.0),) * 3,
    "place_m": (0.006, 0.006, 0.04),
    "log_length": (0.02,) * 20,
    "palm_shift_m": (0.0015,) * 15,
}
# masks are off by parts of a pixel, differently in each picture: of a known hand in every picture of a film, what
# outlines change is smoothed over so many seconds (standard deviation). Bones then jitter as little as without outlines
# and are nearer to the truth than unsmoothed; half or twice as much hardly matters
OUTLINE_SMOOTH_S = 0.1
# by so much numbers grow to see what the joints do
DIFFERENCE = 1e-3
_NPZ_BYTES_MAX = 2**26

# of pictures (B,) and their joints (B, 21, 3)
Cost = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True, eq=False)
class FittedHand:
    """What a fit found, of a right hand in every case, as `Start` has it.

    camera:             of a picture
    poses:              turn (F, 3, 3), place_m (F, 3), angle_rad (F, 20)
    joints_m:           (F, 21, 3) level order, camera axes, meters
    own_joints_m:       (21, 3) the prior's canonical hand with the bones of this one
    shape:              (SHAPE_COUNT,) see shape.in_shape
    outline_residual:   (F,) mean squared error of outlines, part of the hand's area; NaN where no picture was looked at
    """

    camera: Camera
    poses: Poses
    joints_m: np.ndarray
    own_joints_m: np.ndarray
    shape: np.ndarray
    outline_residual: np.ndarray

    def avatar_shape(self, avatar: HandAvatar) -> HandAvatar:
        """The avatar with the thickness of this hand, and with its bones where no joints say them."""
        return replace(in_shape(avatar, self.shape), own_joints_m=self.own_joints_m)

    def save(self, path: Path) -> None:
        """As .npz."""
        arrays = {**vars(self), **packed(self.camera, self.poses)}
        del arrays["poses"]
        with writing(path) as temporary:
            np.savez_compressed(temporary, **arrays)

    @classmethod
    def load(cls, path: Path) -> FittedHand:
        """What `save` wrote. InputError for a file that is none."""
        own = ("joints_m", "own_joints_m", "shape", "outline_residual")
        arrays = read_arrays(path, (*own, *PACKED), str(path), max_bytes=_NPZ_BYTES_MAX)
        if arrays["shape"].shape != (SHAPE_COUNT,):
            raise InputError(f"shape in {path}", wanted=f"{SHAPE_COUNT} numbers", came=f"{arrays['shape'].shape}",
                             remedy="Begin anew, without --resume.")  # fmt: skip
        return cls(*unpacked(arrays), *(arrays[name] for name in own))


@dataclass(eq=False)
class Unknowns:
    """angle_rad: (F, 20) · turn_rad: (F, 3) upon the tracker's · place_m: (F, 3) · log_length: (20,), against the
    prior's · palm_shift_m: (5, 3) · shape: (COARSE_COUNT,) · fine_shape: the rest of SHAPE_COUNT, found by outlines
    alone: Adam's steps are as long for all, and would roughen the skin"""

    angle_rad: Tensor
    turn_rad: Tensor
    place_m: Tensor
    log_length: Tensor
    palm_shift_m: Tensor
    shape: Tensor
    fine_shape: Tensor


@dataclass(frozen=True)
class Effort:
    """times: how often the skin's colors are found anew at least · least_s: go on with that for so many seconds ·
    rounds: of all pictures with each"""

    times: int = COLOR_TIMES
    least_s: float = 0.0
    rounds: int = PICTURE_ROUNDS


class HandFit:
    """One fit, of a right hand. What stands is where the next stage begins.

    prior: the avatar whose surface is fitted · time_s: (F,) of a film's pictures; None of photographs, which have
    nothing to do with one another · hand: one that was fitted to this prior: only poses and places are sought ·
    count: how many Gaussians are drawn · dtype: float64 for tests of derivatives
    """

    def __init__(
        self,
        prior: HandAvatar,
        start: Start,
        time_s: np.ndarray | None,
        hand: FittedHand | None = None,
        *,
        count: int = FIT_GAUSSIANS,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self.prior, self.start = prior, start
        self.evidence = Evidence.of(start, time_s, dtype)
        self.chain = Chain.of(prior.canonical_joints_m, hand_length(start.canonical_joints_m), dtype)
        self.surface = FitSurface(prior, count, dtype)
        self._turn = torch.from_numpy(start.poses.turn).to(dtype)
        longer = np.log(bone_lengths(start.canonical_joints_m) / bone_lengths(prior.canonical_joints_m))
        begin = {"angle_rad": start.poses.angle_rad, "place_m": start.poses.place_m, "log_length": longer}
        begin |= {
            "turn_rad": np.zeros((len(self), 3)),
            "palm_shift_m": np.zeros((5, 3)),
            "shape": np.zeros(COARSE_COUNT),
            "fine_shape": np.zeros(SHAPE_COUNT - COARSE_COUNT),
        }
        if hand is not None:
            first = JointChain.of(prior.canonical_joints_m)
            known = chain_of(prior.canonical_joints_m, hand.own_joints_m)
            begin |= {"palm_shift_m": (known.palm_m - first.palm_m)[1:]}
            begin["shape"], begin["fine_shape"] = np.split(hand.shape, [COARSE_COUNT])
            begin["log_length"] = np.r_[np.zeros(5), np.log(known.bone_lengths_m / first.bone_lengths_m)[5:]]
        sought = RATES if hand is None else POSE_NUMBERS
        tensors = {
            name: torch.tensor(array, dtype=dtype, requires_grad=name in sought) for name, array in begin.items()
        }
        self.unknowns = Unknowns(**tensors)
        self.outline_residual = np.full(len(self), np.nan)
        # of the fit by pictures: how often colors were found, in how many seconds, and the factor of the radii
        self.done, self.spent_s, self.factor = 0, 0.0, math.nan

    def __len__(self) -> int:
        return len(self._turn)

    # ---- the hand as it stands ----

    def turns(self, pictures: Tensor) -> Tensor:
        """(B, 3, 3) camera from canonical hand."""
        return self._turn[pictures] @ rotation(self.unknowns.turn_rad[pictures])

    def joints(self, pictures: Tensor) -> Tensor:
        """(B, 21, 3) camera axes."""
        now = self.unknowns
        inside = self.chain.joints(now.angle_rad[pictures], now.log_length, now.palm_shift_m)
        return inside @ self.turns(pictures).mT + now.place_m[pictures, None]

    def projected(self, joints_m: Tensor) -> Tensor:
        """(..., 21, 2) pixels of whole pictures."""
        camera = self.start.camera
        lens, middle = (joints_m.new_tensor(pair) for pair in ((camera.fx, camera.fy), (camera.cx, camera.cy)))
        return joints_m[..., :2] / joints_m[..., 2:] * lens + middle

    @property
    def shape(self) -> Tensor:
        """(SHAPE_COUNT,) see shape.in_shape."""
        return torch.cat([self.unknowns.shape, self.unknowns.fine_shape])

    @property
    def everything(self) -> Tensor:
        """(F,) the numbers of all pictures."""
        return torch.arange(len(self))

    def detector_cost(self, pictures: Tensor, joints_m: Tensor, weights: tuple[float, float]) -> Tensor:
        """What needs no picture, of some pictures: the detector, anatomy, steadiness, and how likely the hand is.
        joints_m: (B, 21, 3) of those · weights: of landmarks and of directions"""
        now, evidence, directions = self.unknowns, self.evidence, directions_of(joints_m)
        angle = now.angle_rad[pictures]
        return (
            weights[0] * landmark_term(evidence, pictures, self.projected(joints_m))
            + weights[1] * direction_term(evidence, pictures, directions)
            + anatomy_terms(angle)
            + guide_term(evidence, pictures, angle, directions)
            + smooth_term(evidence.time_s, now.angle_rad, now.place_m, self.turns(self.everything))
            + hand_term(now.log_length, now.palm_shift_m, now.shape)
        )

    # ---- stages ----

    def fit_landmarks(self, rounds: int = LANDMARK_ROUNDS) -> None:
        """By what the detector says."""

        def cost(pictures: Tensor, joints_m: Tensor) -> Tensor:
            return self.detector_cost(pictures, joints_m, DETECTOR_WEIGHTS)

        self._descend(rounds, 1.0, lambda: cost)

    def fit_pictures(
        self,
        rgb_u8: np.ndarray,
        masks: np.ndarray,
        effort: Effort | None = None,
        colored: np.ndarray | None = None,
        tick: Callable[[int, int], None] = lambda done, total: None,
        ended: Callable[[], object] = lambda: None,
    ) -> None:
        """By pictures (F, H, W, 3) and masks (F, H, W) of the hand, too. What lies beyond the wrist counts nowhere.

        colored: numbers of the pictures that the skin's colors are found from; all · tick: is told how often they were
        found, of how often · ended: is called where `save` has all that goes on, before the first time and after each
        """
        effort, started = effort or Effort(), time.monotonic() - self.spent_s
        if math.isnan(self.factor):
            self.factor = self._outline_factor(rgb_u8, masks)
            ended()
        factor, rows = self.factor, np.arange(len(self)) if colored is None else colored
        while self.done < effort.times or self.spent_s < effort.least_s:
            tick(self.done, max(effort.times, self.done + 1))
            standing = self.joints(torch.from_numpy(rows)).detach(), self.shape.detach()
            colors = self._shown(rgb_u8, masks, factor, rows).colors(*standing)
            self._descend(effort.rounds, PICTURE_RATE, partial(self._picture_cost, rgb_u8, masks, factor, colors))
            self.done, self.spent_s = self.done + 1, time.monotonic() - started
            ended()
        tick(self.done, self.done)
        if self.prior.detail is not None:
            self.fit_outlines(masks)
        shown = self._shown(rgb_u8, masks, factor)
        with torch.no_grad():
            left = shown.errors(self.everything, self.joints(self.everything), self.shape)
        self.outline_residual = left[:, 0].numpy()

    @torch.no_grad()
    def fit_outlines(self, masks: np.ndarray) -> None:
        """By the outlines of masks (F, H, W) alone, from a fit that is near, which what is sought stays near."""
        now = vars(self.unknowns)
        sought = [name for name in OUTLINE_SPREADS if now[name].requires_grad]
        of_poses, of_hand = ([name for name in sought if (name in POSE_NUMBERS) == own] for own in (True, False))
        start = {name: now[name].clone() for name in sought}
        is_known = not now["shape"].requires_grad
        surface = OutlineSurface(self.prior, self.shape.double().numpy(), is_known=is_known)
        for _ in range(STEPS):
            both = self._sought(of_poses, start), self._sought(of_hand, start)
            joints_m = self.joints(self.everything).double().numpy()
            moved, grown = outline_step(surface, joints_m, self.start.camera, masks, *both)
            of_shape, grown = np.split(grown, [len(surface.basis)])
            for names, change in ((of_poses, moved), (of_hand, grown)):
                ends = np.cumsum([len(OUTLINE_SPREADS[name]) for name in names]).astype(int)
                for name, part in zip(names, np.split(change, ends, -1), strict=False):
                    now[name] += torch.from_numpy(part).reshape(now[name].shape)
            if len(of_shape):
                surface.in_shape(surface.shape + of_shape)
        if is_known:
            for name in of_poses:
                now[name].copy_(start[name] + self._smoothed(now[name] - start[name]))
        for name, part in zip(("shape", "fine_shape"), np.split(surface.shape, [COARSE_COUNT]), strict=True):
            now[name].copy_(torch.from_numpy(part))

    def _smoothed(self, change: Tensor) -> Tensor:
        """(F, ...) over the time of a film's pictures."""
        time_s = self.evidence.time_s
        assert time_s is not None
        near = (-((time_s[:, None] - time_s) / OUTLINE_SMOOTH_S).square() / 2).exp().to(change)
        return torch.einsum("fg,g...->f...", near / near.sum(1, keepdim=True), change)

    def _sought(self, names: Sequence[str], start: dict[str, Tensor]) -> Sought:
        """Numbers that outlines may change: all of the pictures', or all of the hand's."""
        before = self.joints(self.everything)
        rows = () if not names or names[0] not in POSE_NUMBERS else (len(self),)
        off, slopes, spread = [torch.zeros((*rows, 0))], [torch.zeros(len(self), 63, 0)], [np.zeros(0)]
        for name in names:
            numbers = getattr(self.unknowns, name).view((*rows, -1))
            off.append(numbers - start[name].view((*rows, -1)))
            spread.append(np.array(OUTLINE_SPREADS[name]))
            for column in range(numbers.shape[-1]):
                kept = numbers[..., column].clone()
                numbers[..., column] += DIFFERENCE
                slopes.append((self.joints(self.everything) - before).view((len(self), 63, 1)) / DIFFERENCE)
                numbers[..., column] = kept
        by_number, away = (torch.cat(each, -1).double().numpy() for each in (slopes, off))
        return Sought(by_number, away, np.concatenate(spread))

    def _picture_cost(self, rgb_u8: np.ndarray, masks: np.ndarray, factor: float, colors: SkinColors) -> Cost:
        """With the crops, the wrist's line and what the pose's network adds as they are now."""
        shown = self._shown(rgb_u8, masks, factor)

        def cost(pictures: Tensor, joints_m: Tensor) -> Tensor:
            outline, color = shown.errors(pictures, joints_m, self.shape, colors).mean(0)
            known = self.detector_cost(pictures, joints_m, DETECTOR_WEIGHTS_WITH_PICTURES)
            return known + OUTLINE_WEIGHT * outline + COLOR_WEIGHT * color

        return cost

    def _descend(self, rounds: int, rate: float, cost_now: Callable[[], Cost]) -> None:
        """Steps of Adam through all pictures. cost_now: is called every RENEW_ROUNDS, from the first on"""
        rates = {name: step for name, step in RATES.items() if getattr(self.unknowns, name).requires_grad}
        groups = [{"params": [getattr(self.unknowns, name)]} for name in rates]
        adam = torch.optim.Adam(groups, betas=ADAM_BETAS)
        generator = torch.Generator().manual_seed(0)
        batches = min(len(self), max(STEPS_MIN, min(len(self) // BATCH, STEPS_MAX)))
        cost = cost_now()
        for number in range(rounds):
            if number and number % RENEW_ROUNDS == 0:
                cost = cost_now()
            slower = RATE_END + (1 - RATE_END) * (1 + math.cos(math.pi * number / rounds)) / 2
            for group, fastest in zip(adam.param_groups, rates.values(), strict=True):
                group["lr"] = rate * slower * fastest
            for pictures in torch.randperm(len(self), generator=generator).tensor_split(batches):
                pictures = pictures.sort().values
                adam.zero_grad()
                cost(pictures, self.joints(pictures)).backward()
                adam.step()
                turn = self.unknowns.turn_rad.detach()
                turn.mul_(TURN_MAX_RAD / turn.norm(dim=-1, keepdim=True).clamp_min(TURN_MAX_RAD))

    @torch.no_grad()
    def _shown(
        self, rgb_u8: np.ndarray, masks: np.ndarray, factor: float, rows: np.ndarray | slice = slice(None)
    ) -> FitPictures:
        joints = self.joints(self.everything[rows])
        seen = sights(rgb_u8[rows], masks[rows], joints.double().numpy(), self.start.camera)
        return FitPictures(self.surface, seen, self.surface.keep(joints), factor)

    @torch.no_grad()
    def _outline_factor(self, rgb_u8: np.ndarray, masks: np.ndarray) -> float:
        some = torch.linspace(0, len(self) - 1, min(CALIBRATION_POSES, len(self))).round().long()
        joints, rows = self.joints(some), some.numpy()
        seen = sights(rgb_u8[rows], masks[rows], joints.double().numpy(), self.start.camera)
        return outline_factor(self.prior, self.surface, joints, [sight.view for sight in seen])

    # ---- what was found ----

    def save(self, path: Path) -> None:
        """As .npz, so that a fit of the same pictures goes on from there."""
        arrays = {name: tensor.detach().numpy() for name, tensor in vars(self.unknowns).items()}
        with writing(path) as temporary:
            np.savez(temporary, done=self.done, spent_s=self.spent_s, factor=self.factor, **arrays)

    def load(self, path: Path) -> None:
        """Goes on with what `save` wrote. InputError for a file that is none."""
        names = ("done", "spent_s", "factor", *vars(self.unknowns))
        arrays = read_arrays(path, names, str(path), max_bytes=_NPZ_BYTES_MAX)
        for name, tensor in vars(self.unknowns).items():
            if arrays[name].shape != tuple(tensor.shape) or not np.isfinite(arrays[name]).all():
                raise InputError(f"{name} in {path}", wanted=f"{tuple(tensor.shape)} numbers", came="others")
        self.done, self.spent_s, self.factor = int(arrays["done"]), float(arrays["spent_s"]), float(arrays["factor"])
        for name, tensor in vars(self.unknowns).items():
            tensor.data.copy_(torch.from_numpy(arrays[name]))

    @torch.no_grad()
    def result(self) -> FittedHand:
        """The hand as it stands."""
        now, everything = self.unknowns, self.everything
        poses = Poses(*(array.double().numpy() for array in (self.turns(everything), now.place_m, now.angle_rad)))
        straight = self.chain.joints(now.angle_rad[:1] * 0, now.log_length, now.palm_shift_m).double().numpy()
        directions = bone_directions(self.prior.canonical_joints_m[None])
        directions[:, :5] = bone_directions(straight)[:, :5]
        own = rebuilt(np.zeros((1, 3)), directions, bone_lengths(straight[0]))[0]
        joints = self.joints(everything).double().numpy()
        shape = self.shape.double().numpy()
        return FittedHand(self.start.camera, poses, joints, own, shape, self.outline_residual)


# ---- a hand before pictures -----------------------------------------------------------------------------------------

# where a hand covers more than this its color is compared; color is divided by no less than the second
COVERED_MIN, COVERED_FLOOR = 0.7, 0.3


@dataclass(frozen=True)
class FitPictures:
    """A hand before the pictures, with all that changes slowly as the fit goes on.

    factor: of the radii, see fit_surface.outline_factor
    """

    surface: FitSurface
    pictures: Sequence[Sight]
    kept: Kept
    factor: float

    def colors(self, joints_m: Tensor, shape: Tensor) -> SkinColors:
        """What the pictures give to the skin as joints (F, 21, 3) and shape (SHAPE_COUNT,) stand."""
        with torch.no_grad():
            posed = self.surface.posed(joints_m, shape, self.kept)
        return skin_colors(self.surface, posed, self.kept, self.pictures, self.factor)

    def errors(self, pictures: Tensor, joints_m: Tensor, shape: Tensor, colors: SkinColors | None = None) -> Tensor:
        """(B, 2) of some pictures: squared errors of the outline, and absolute ones of the color, part of the hand's
        area. joints_m: (B, 21, 3) of those. Without colors the second is 0."""
        kept = self.kept.of(pictures)
        posed = self.surface.posed(joints_m, shape, kept)
        errors = []
        for row, picture in enumerate(pictures.tolist()):
            sight = self.pictures[picture]
            rgb = self.surface.hand.rgb if colors is None else colors.of(posed.normal[row], kept.shade[row])
            drawn = self.surface.draw(posed, row, sight.view.camera, rgb.to(joints_m), self.factor)
            area = (sight.side * sight.mask).sum().clamp_min(1)
            outline = (sight.side * (drawn.alpha - sight.mask) ** 2).sum() / area
            covered = sight.side * sight.mask * (drawn.alpha.detach() > COVERED_MIN)
            shown = drawn.rgb / drawn.alpha.clamp_min(COVERED_FLOOR)[..., None]
            color = (covered * (shown - sight.rgb).abs().sum(-1)).sum() / area
            errors.append(torch.stack([outline, torch.zeros_like(color) if colors is None else color]))
        return torch.stack(errors)
