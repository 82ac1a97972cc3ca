"""Error against distance to a singularity, our formulation beside the usual one: the curves of the study's picture.

Each curve answers one question that somebody who animates a hand would ask; what is usual is named beside it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import ZERO_BONE_EPS
from jghand_engine.learn import rotations as rot
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.render.camera import Camera
from jghand_engine.study.stability_hands import (
    GRADIENT_MAX,
    NUDGE_M,
    HandCase,
    abducted,
    backwards_sideways,
    bent_finger,
    flattened_palm,
    posed,
    template_joints_m,
    template_size_m,
)
from jghand_engine.study.stability_measures import (
    Formulation,
    moved_mm,
    ours,
    random_nudges,
    transform_for,
    usual,
)
from jghand_engine.study.stability_pictures import against_reference
from jghand_engine.study.stability_usual import UsualTransform, usual_ink, usual_unit

RIGHT = Handedness.RIGHT
_INDEX, _MIDDLE = 1, 2
F32, F64 = torch.float32, torch.float64


@dataclass(frozen=True)
class Curve:
    """name: for files · title, below: what is asked, and what happens, in plain words · x, y: names of the axes with
    their units · distance: (D,) from far to near · ours, usual: (D,) errors · way: the usual way's formula
    visible: error from which somebody sees it, in the unit of y, or None"""

    name: str
    title: str
    below: str
    x: str
    y: str
    way: str
    distance: np.ndarray
    ours: np.ndarray
    usual: np.ndarray
    visible: float | None = None


def _both(xs: Sequence[float], one: Callable[[Formulation, float], float]) -> tuple[np.ndarray, np.ndarray]:
    mine, theirs = (partial(way, handedness=RIGHT) for way in (ours, usual))
    return np.array([one(mine, x) for x in xs]), np.array([one(theirs, x) for x in xs])


# ---- the curves -----------------------------------------------------------------------------------------------------


def straight_twist() -> Curve:
    """A finger is straightened: how far does its skin spin when the joints are 0.5 mm off?"""
    crossed = UsualTransform(template_joints_m(), handedness=RIGHT, crossed=True)
    angles_deg = np.geomspace(30, 0.01, 22)
    base, nudges = posed("relaxed"), NUDGE_M * random_nudges()

    def twist_deg(frames: Callable[[Tensor], Tensor], angle_deg: float) -> float:
        """How much the frame of the middle phalanx turns about the bone, root of the mean square."""
        joints_m = bent_finger(base, _INDEX, math.radians(angle_deg))
        exact, off = frames(joints_m[None]), frames(joints_m + nudges)
        # turned back by the smallest rotation between the two bones, so that only the twist is left
        z0, z1 = exact[..., 2].expand_as(off[..., 2]), off[..., 2]
        back = rot.minimal_rotation(z1.T, z0.T, torch.eye(3, dtype=F64)[..., None]).permute(2, 0, 1)
        y = (back @ off[..., 1, None])[..., 0]
        cosine, sine = (y * exact[..., 1]).sum(-1), (y * exact[..., 0]).sum(-1)
        return math.degrees(float(torch.atan2(sine, cosine).square().mean().sqrt()))

    middle = 10 + _INDEX
    mine = [twist_deg(lambda joints_m: transform_for(RIGHT).frames(joints_m).S[:, middle], a) for a in angles_deg]
    theirs = [twist_deg(lambda joints_m: crossed.frames(joints_m)[:, middle], a) for a in angles_deg]
    return Curve(
        "straight_twist", "A finger is straightened", "How far its skin spins, joints 0.5 mm off",
        "bend of the finger, degrees", "twist of the skin, degrees",
        "axis = cross product of two phalanges", angles_deg,
        np.array(mine), np.array(theirs),
        visible=10.0,
    )  # fmt: skip


def straight_error() -> Curve:
    """A finger is straightened: how far is its tip from where it belongs?"""
    angles_deg = np.geomspace(30, 1e-4, 26)
    base = posed("relaxed")
    transform = UsualTransform(template_joints_m(), handedness=RIGHT)

    def tip_mm(bones, joints_m: Tensor) -> float:
        tip = 16 + _INDEX
        there = bones.linear[tip] @ (template_joints_m()[tip].float() - bones.canonical_root_m) + bones.offset_m[tip]
        return 1e3 * float((there.double() - joints_m[tip]).norm())

    hands = [bent_finger(base, _INDEX, math.radians(a)) for a in angles_deg]
    hands = [hand - hand[0] for hand in hands]
    return Curve(
        "straight_error", "… and where is its tip?", "How far the tip is from its joint, float32",
        "bend of the finger, degrees", "error of the finger tip, mm",
        "angle = acos of a clipped dot product", angles_deg,
        np.array([tip_mm(transform_for(RIGHT).bones(hand.float()), hand) for hand in hands]),
        np.array([tip_mm(transform.bones(hand.float()), hand) for hand in hands]),
        visible=0.1,
    )  # fmt: skip


def _jumps(
    name: str, title: str, below: str, x: str, turned: Callable[[Tensor, int, float], Tensor], finger: int
) -> Curve:
    """How far the skin jumps of a relaxed hand whose finger is `turned` so far (radians) beside the trouble."""
    beside_deg = np.geomspace(60, 0.01, 20)
    base, nudges = posed("relaxed"), random_nudges()

    def jump_mm(way: Formulation, degrees: float) -> float:
        return moved_mm(way, HandCase("turned", turned(base, finger, math.radians(degrees))), nudges)

    mine, theirs = _both(beside_deg.tolist(), jump_mm)
    return Curve(
        name, title, below, x, "jump of the skin, mm", "flexion, then abduction (Euler angles)",
        beside_deg, mine, theirs, visible=2.0,
    )  # fmt: skip


def sideways() -> Curve:
    """A finger turns sideways to 90 degrees: how far does the skin jump when the joints are 0.5 mm off?"""
    below = "How far the skin jumps, joints 0.5 mm off"
    return _jumps("sideways", "A finger turns sideways", below, "degrees short of 90 sideways", abducted, _MIDDLE)


def flat_palm() -> Curve:
    """The palm bones close like a fan: how hard do they pull at the joints while something learns from them?"""
    parts = np.geomspace(1, 1e-6, 22)
    base = posed("relaxed")

    def pull(way: Formulation, part: float) -> float:
        joints_m = flattened_palm(base, part)[None].requires_grad_()
        (gradient,) = torch.autograd.grad(way(joints_m, F32).loss, joints_m)
        return float(gradient.abs().max()) * template_size_m()

    mine, theirs = _both(parts.tolist(), pull)
    return Curve(
        "flat_palm", "The palm closes like a fan", "How hard it pulls when something learns",
        "width of the palm, % of a real one", "gradient, per hand size",
        "palm = normalized cross products", 100 * parts, mine, theirs, visible=GRADIENT_MAX,
    )  # fmt: skip


def folded() -> Curve:
    """A finger turns backwards and sideways, which no joint can do: ours has to lose its twist somewhere."""
    below, x = "The price: how far its skin jumps", "degrees beside the worst direction"
    return _jumps("folded", "A finger folds back, sideways", below, x, backwards_sideways, _INDEX)


def short_bone() -> Curve:
    """A bone loses its length: how hard does it pull at the joints while something learns from it?"""
    lengths_mm = np.geomspace(30, 1e-7, 24)

    def pull(unit: Callable[[Tensor], Tensor], length_mm: float) -> float:
        direction = torch.tensor([0.6, 0.0, 0.8])
        bone = (1e-3 * length_mm * direction).requires_grad_()
        (gradient,) = torch.autograd.grad(unit(bone)[0], bone)
        # as one bone of a hand of ordinary size
        return float(gradient.abs().max()) * template_size_m()

    def mine(bone: Tensor) -> Tensor:
        relative = bone[:, None] / template_size_m()
        fallback = torch.tensor([[0.0], [0.0], [1.0]])
        return rot.safe_unit(relative, fallback, ZERO_BONE_EPS * torch.finfo(bone.dtype).eps)[0][:, 0]

    return Curve(
        "short_bone", "A bone loses its length", "How hard it pulls when something learns",
        "length of the bone, mm", "gradient, per hand size",
        "direction = b / (|b| + 1e-8)", lengths_mm,
        np.array([pull(mine, x) for x in lengths_mm]), np.array([pull(usual_unit, x) for x in lengths_mm]),
        visible=GRADIENT_MAX,
    )  # fmt: skip


def far_away() -> Curve:
    """The hand is far from the origin of the scene: how far is the skin from where it belongs?"""
    meters = np.geomspace(0.1, 1e5, 19)
    base = posed("relaxed")
    direction = torch.tensor([0.7, 0.5, 0.51], dtype=F64)

    def error_mm(way: Formulation, distance_m: float) -> float:
        joints_m = (base + distance_m * direction)[None]
        return 1e3 * float((way(joints_m, F32).skin.double() - way(joints_m, F64).skin).norm(dim=-1).max())

    mine, theirs = _both(meters.tolist(), error_mm)
    return Curve(
        "far_away", "The hand is far from home", "How far the skin is off, float32",
        "meters from the origin", "error of the skin, mm",
        "absolute coordinates", meters, mine, theirs, visible=0.1,
    )  # fmt: skip


def thin_needle() -> Curve:
    """A needle-thin splat comes close and grows long on the picture: how wrong is the ink that it leaves?"""
    lengths_px = np.geomspace(1, 2e4, 22)
    camera = Camera(64, 64, 100.0, 100.0, 32.0, 32.0, np.eye(4))
    grid = torch.arange(64, dtype=F64) - 31.5
    offsets = torch.stack(torch.meshgrid(grid, grid, indexing="xy"), -1).reshape(-1, 2)

    def errors(length_px: float) -> tuple[float, float]:
        # as thin as a hundredth of a pixel, along the diagonal
        half = 0.5 * (length_px**2 + 1e-4)
        flat_px2 = torch.tensor([half, half - 1e-4, half], dtype=F64)
        covariance_m2 = torch.zeros(1, 6)
        covariance_m2[0, [0, 1, 3]] = (flat_px2 / 100**2).float()
        covariance_m2[0, 5] = 1e-8
        needle = Gaussians(
            torch.tensor([[0.0, 0.0, 1.0]]), torch.ones(1), torch.tensor([0.9]), torch.ones(1, 3), covariance_m2
        )
        given_px2 = 100**2 * covariance_m2[0, [0, 1, 3]]
        exact, wrong = (usual_ink(given_px2.to(dtype), offsets, 0.9).double() for dtype in (F64, F32))
        return against_reference(needle, camera).worst, float((wrong - exact).abs().max())

    both = np.array([errors(length) for length in lengths_px])
    return Curve(
        "thin_needle", "A thin splat comes close", "How wrong its ink is, float32",
        "length on the picture, pixels", "error of the ink, 0 to 1",
        "determinant = a c - b²", lengths_px, both[:, 0], both[:, 1], visible=1 / 255,
    )  # fmt: skip


CURVES = (straight_twist, straight_error, sideways, folded, flat_palm, short_bone, far_away, thin_needle)
