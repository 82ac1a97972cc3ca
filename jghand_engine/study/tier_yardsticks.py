"""What the accuracy of a tier is measured with: pictures that were held out, or the exact tier's own pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.pose_range import trained_range
from jghand_engine.captures.captures import Capture
from jghand_engine.captures.splits import Split
from jghand_engine.color import decibels
from jghand_engine.hand.poses import MotionOptions, pose_names, pose_sequence_of_names
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.evaluate import avatar_picturer, categories_of, means, measure_pictures
from jghand_engine.learn.pose_features import flat_angles
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset
from jghand_engine.study.frame_time import Subject, builtin_subject

# accuracy of the paper's avatars (RENDERING 9.1): what an error beside it costs is said of a model as good as this, dB
MODEL_PSNR_DB = 33.4
# pictures are drawn as `jghand evaluate` draws them
PRESET = "final"
# pixels of the pictures of made-up poses, and every how manieth pose of their motion
SIZE_PX = (512, 334)
EVERY_POSE = 8
# how much the poses that the avatar is said to know vary around the named ones, degrees
KNOWN_VARIATION_DEG = 6.0


class Yardstick(Protocol):
    """measured_on: in words, for the avatar's description."""

    @property
    def measured_on(self) -> str: ...

    def known_poses(self, avatar: HandAvatar) -> Tensor:
        """(P, 37) angles of poses that the avatar knows."""
        ...

    def psnr_db(self, avatar: HandAvatar) -> float:
        """How near its pictures come."""
        ...

    def lost_db(self, exact_db: float, psnr_db: float) -> float:
        """What a tier of `psnr_db` loses of the exact one's accuracy."""
        ...

    def subject(self, avatar: HandAvatar) -> Subject:
        """A motion before a camera, for times."""
        ...


class HeldOutPictures:
    """Pictures of a capture that the avatar did not learn from. limit: of each kind, at most; 0: all.
    doubt: what is to be told of them where the avatar may have learned from them; empty where it has not.

    Pictures of learned poses are left out where there are others: tiers are fitted to these poses, which would flatter
    them.
    """

    def __init__(self, capture: Capture, split: Split, limit: int, doubt: str = "") -> None:
        self._capture, self._split, self._doubt = capture, split, doubt
        unseen = replace(split, novel_view=()) if split.novel_pose or split.novel_both else split
        self._categories = categories_of(unseen, "test", limit)

    @property
    def measured_on(self) -> str:
        """See Yardstick."""
        counts = ", ".join(f"{len(samples)} of {kind}" for kind, samples in self._categories.items())
        told = f"held-out pictures of {self._capture.name} ({counts}), preset {PRESET}"
        return f"{told}; {self._doubt}" if self._doubt else told

    def known_poses(self, avatar: HandAvatar) -> Tensor:
        """See Yardstick: the poses of the pictures that were learned."""
        poses = {sample.pose: sample.joints_m for sample in self._split.train}
        return _flat(avatar.for_hand(self._capture.handedness), np.stack(list(poses.values())))

    def psnr_db(self, avatar: HandAvatar) -> float:
        """See Yardstick: mean over whole pictures, over black."""
        return means(measure_pictures(self._categories, avatar_picturer(avatar, preset(PRESET))))["psnr_full"]

    def lost_db(self, exact_db: float, psnr_db: float) -> float:
        """See Yardstick."""
        return exact_db - psnr_db

    def subject(self, avatar: HandAvatar) -> Subject:
        """See Yardstick."""
        hand = avatar.for_hand(self._capture.handedness)
        return Subject(self._capture.name, hand, self._capture.joints_m(), self._capture.samples[0].camera)


class ExactPictures:
    """The exact tier's own pictures of named poses and those between them."""

    def __init__(self, exact: HandAvatar) -> None:
        self._exact = exact

    @property
    def measured_on(self) -> str:
        """See Yardstick."""
        against = f"{len(self._poses_m)} made-up poses against the exact tier, preset {PRESET}"
        return f"{against}; lost of an avatar of {MODEL_PSNR_DB:g} dB"

    @cached_property
    def _subject(self) -> Subject:
        return builtin_subject(*SIZE_PX, self._exact, self._exact.info.name)

    @property
    def _poses_m(self) -> np.ndarray:
        return self._subject.poses[::EVERY_POSE]

    def known_poses(self, avatar: HandAvatar) -> Tensor:
        """See Yardstick: another motion than the one that is measured, kept inside the angles that were trained."""
        options = MotionOptions(hold_s=0.0, variation_deg=KNOWN_VARIATION_DEG, seed=1)
        canonical = avatar.canonical_joints_m
        motion = pose_sequence_of_names(pose_names(), canonical, handedness=avatar.handedness, options=options)
        poses = _flat(avatar, motion.joints_m[::EVERY_POSE])
        limits_rad = trained_range(avatar.info)
        if limits_rad is not None:
            low, high = torch.from_numpy(limits_rad).float().reshape(2, 30)
            poses[:, :30] = torch.minimum(torch.maximum(poses[:, :30], low), high)
        return poses

    @cached_property
    def _wanted(self) -> list[np.ndarray]:
        return self._pictures(self._exact)

    def _pictures(self, avatar: HandAvatar) -> list[np.ndarray]:
        renderer = HandRenderer(avatar, preset(PRESET))
        frames = (renderer.render(pose_m, self._subject.camera) for pose_m in self._poses_m)
        return [np.clip(frame.rgba[..., :3], 0, 1) for frame in frames]

    def psnr_db(self, avatar: HandAvatar) -> float:
        """See Yardstick: of all pictures together."""
        pairs = zip(self._pictures(avatar), self._wanted, strict=True)
        error = float(np.mean([np.square(ours - theirs).mean() for ours, theirs in pairs]))
        return decibels(error)

    def lost_db(self, exact_db: float, psnr_db: float) -> float:
        """See Yardstick: of an avatar of MODEL_PSNR_DB, when an independent error is added (RENDERING 9.1)."""
        if psnr_db >= exact_db:
            return 0.0
        return 10 * math.log10(1 + 10 ** ((MODEL_PSNR_DB - psnr_db) / 10))

    def subject(self, avatar: HandAvatar) -> Subject:
        """See Yardstick."""
        return self._subject


def _flat(avatar: HandAvatar, joints_m: Sequence[np.ndarray] | np.ndarray) -> Tensor:
    """(P, 37) float32 angles of joints (P, 21, 3)."""
    transform = transform_of(avatar)
    return torch.stack([flat_angles(transform.frames(torch.from_numpy(np.array(each)))) for each in joints_m]).float()
