"""Posing an avatar for nobody's eye, for files: the native skin, with what it mirrors left out.

The same as `skinning.pose_gaussians` without an eye, ten times as fast and nearer to float64: centers are added to the
wrist in double precision. Its own correctives are used, never a cheaper tier of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.fast_learned import FastLearnedSkin
from jghand_engine.avatar.fast_skinning import FastSkinning, PosedArrays
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native.binding import Library, aligned_zeros
from jghand_engine.native.threads import shared_pool

_NO_SHIFT_M = np.zeros(3)


@dataclass(frozen=True)
class PosedFrame:
    """Centers (N, 3) and radii (N,) of the Gaussians in one frame, meters, float32; rgb (N, 3) display-referred sRGB
    where the colors change with the pose, else None; covariance_m2 (N, 6) xx, xy, xz, yy, yz, zz square meters of
    ellipsoids, None for balls."""

    positions_m: np.ndarray
    sigma_m: np.ndarray
    rgb: np.ndarray | None
    covariance_m2: np.ndarray | None = None


class FastPosing:
    """Poses one avatar again and again; the arrays of a frame are the caller's own.

    threads: 0 takes as many as is sensible
    """

    def __init__(self, library: Library, avatar: HandAvatar, threads: int = 0) -> None:
        learned = avatar.learned
        self._transform = avatar.skeleton()
        self._learned, self._plain = None, None
        if learned is None:
            skin = self._plain = FastSkinning(library, avatar)
        else:
            # without shine the kernel's colors are those that are the same from everywhere
            matt = replace(avatar, learned=replace(learned, shine=np.zeros_like(learned.shine)))
            self._learned = FastLearnedSkin(library, matt)
            skin = self._learned.skin
        rows = skin.rows
        ellipsoids = learned is not None and learned.ellipsoid is not None
        self._into = PosedArrays(
            aligned_zeros((rows, 3)), aligned_zeros((rows,)), aligned_zeros((rows, 6)) if ellipsoids else None
        )
        self._rgb = aligned_zeros((rows, 3))
        # the row in which each Gaussian stands
        self._row = np.argsort(skin.order)
        self._pool = shared_pool(threads)

    def __call__(self, joints_m: np.ndarray) -> PosedFrame:
        """The Gaussians of joints (21, 3), level order, meters; all of them have to be finite."""
        bones = self._transform.bones(joints_m)
        rgb = self._run(bones)
        into, row = self._into, self._row
        covariance = into.covariance_m2
        return PosedFrame(
            (into.position_m[row].astype(np.float64) + bones.root_m).astype(np.float32),
            into.sigma_m[row],
            None if rgb is None else np.clip(rgb[row], 0, 1),
            None if covariance is None else covariance[row],
        )

    def _run(self, bones: Bones) -> np.ndarray | None:
        """Poses into the arrays; the colors' rows, where they change."""
        if self._learned is not None:
            learned = self._learned
            learned.prepare(bones, self._into, self._rgb, _NO_SHIFT_M)
            self._pool.run(lambda _thread: learned.run())
            return self._rgb
        plain = self._plain
        if plain is not None:
            plain.prepare(bones, self._into, _NO_SHIFT_M)
            self._pool.run(lambda _thread: plain.run())
        return None
