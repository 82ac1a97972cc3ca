"""How well the transform from joints to skin does beside simpler ones: the paper's transform table (PAPER 3).

    .envs/engine/bin/python scripts/compare_transforms.py [--json FILE]

The truth is another hand than the template: each identity of the captures, of other proportions, posed and skinned by
its own rig of 25 joints. Each transform is given the 21 joints of that hand and carries the template's skin there.

    joints, matrices   mean distance of B_i j_i from joint i over the 21 joints: does the transform itself hit them
    joints, skinned    the same for the joint blended by the skin weights at its place (METHOD 3.5)
    Chamfer-L1         mean distance to the nearest of the points on the other surface, both ways averaged
    skin               mean distance of corresponding points of the two surfaces: also sees twist, which Chamfer hides

Part of the last two is the shape of the other hand itself (thickness, fingernails), which no transform can know.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import KDTree

sys.path.insert(0, str(Path(__file__).parents[1]))

from jghand_engine.captures.making.poses import varied_poses
from jghand_engine.captures.making.rig import RiggedHand, identity_names, load_identity
from jghand_engine.cli.console import progress, say, say_whole_table, write_json
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.learn import rotations as rot
from jghand_engine.learn.baselines import HaloLikeTransform
from jghand_engine.learn.frames import CanonicalTensors, ComponentFrames
from jghand_engine.learn.skeleton import BoneTransforms, JointTransform
from jghand_engine.learn.skinning import apply, blend
from jghand_engine.learn.tables import CAVEAT, NONE, Table, number
from jghand_engine.template.builtin import load_template
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.weight_field import WeightField

# poses of each hand
POSES = 30
# points on the skin: 1.4 mm apart, well below the distances that the table tells apart
SKIN_POINTS = 20_000
# MPJPE and Chamfer-L1 on test/Capture0 and test/Capture1; the units are not given, meters fit the former
PAPER_TRANSFORM = {"HALO": ((0.0103, 5.14), (0.0120, 5.97)), "JGHand (paper)": ((0.0, 0.92), (0.0, 0.97))}


class NaiveTransform(JointTransform):
    """Every bone by itself: the smallest rotation from its canonical direction to the posed one, start on start.

    A direction says nothing of the twist about it, so the skin tears where the hand as a whole has turned; the lengths
    are the canonical hand's, so the end of a bone misses its joint.
    """

    def maps(
        self, joints: torch.Tensor, frames: ComponentFrames, canonical: CanonicalTensors
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """See JointTransform.maps."""
        palm = rot.mat_mul(frames.S0, canonical.S0.transpose(0, 1))
        # at its pole (a bone turned back to front) any half turn about an axis across the bone will do
        flips = rot.half_turn(canonical.S[:, 1])
        turn = rot.minimal_rotation(canonical.direction, frames.direction, flips)
        return torch.cat([palm, turn], 2), joints, torch.ones_like(frames.size)


TRANSFORMS: dict[str, Callable[[np.ndarray], JointTransform]] = {
    "naive": lambda joints: NaiveTransform(joints, handedness=Handedness.RIGHT),
    "HALO-like": lambda joints: HaloLikeTransform(joints, handedness=Handedness.RIGHT),
    "ours, uniform": lambda joints: JointTransform(joints, handedness=Handedness.RIGHT, scale_mode="uniform"),
    "ours, axial": lambda joints: JointTransform(joints, handedness=Handedness.RIGHT, scale_mode="axial"),
}


@dataclass(frozen=True)
class TransformScore:
    """Means over poses, millimeters; see the module."""

    joints_matrices_mm: float
    joints_skinned_mm: float
    chamfer_mm: float
    skin_mm: float


@dataclass(frozen=True)
class _Subject:
    """The template as points on its skin: places and weights of the points (S, 3), (S, 21), and of the joints."""

    joints_m: torch.Tensor
    joint_weights: torch.Tensor
    points_m: torch.Tensor
    point_weights: torch.Tensor

    def moved(self, bones: BoneTransforms) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One pose: joints by their own matrices, joints by blended matrices (21, 3) and the skin (S, 3), meters."""
        matrices = bones.matrices()
        by_matrix = apply(matrices[..., :3], self.joints_m) + matrices[..., 3]
        return by_matrix.numpy(), _skinned(self.joints_m, self.joint_weights, bones), _skinned(
            self.points_m, self.point_weights, bones
        )  # fmt: skip


def _skinned(points_m: torch.Tensor, weights: torch.Tensor, bones: BoneTransforms) -> np.ndarray:
    linear, offset_m = blend(weights, bones)
    return (apply(linear, points_m - bones.canonical_root_m) + offset_m + bones.root_m).numpy()


def measure_transforms(
    identity: str, poses: int, *, seed: int = 0, tick: Callable[[], None] = lambda: None
) -> dict[str, TransformScore]:
    """The scores of every transform on one identity in `poses` varied poses. `tick` is called after each pose.

    identity: name or number as `jghand capture` takes it. InputError for one that there is not.
    """
    template, hand = load_template(), RiggedHand(load_identity(identity))
    pose = hand.pose(varied_poses(hand, poses, seed).angles_deg)
    faces, barycentric = _places(template)
    subject = _subject(template, faces, barycentric)
    transforms = {name: make(template.joints_m) for name, make in TRANSFORMS.items()}
    sums = {name: np.zeros(4) for name in transforms}
    for joints_m, vertices_m in zip(pose.joints_m, hand.skin(pose), strict=True):
        truth_m = np.einsum("sk,skc->sc", barycentric, vertices_m[faces])
        for name, transform in transforms.items():
            moved = subject.moved(transform.bones(torch.from_numpy(np.ascontiguousarray(joints_m))))
            sums[name] += list(_distances_m(moved, joints_m, truth_m))
        tick()
    return {name: TransformScore(*(1e3 * total / poses).tolist()) for name, total in sums.items()}


def _places(template: HandTemplate) -> tuple[np.ndarray, np.ndarray]:
    """Faces (S, 3 corners) and barycentric coordinates (S, 3) of points spread evenly over the template's skin."""
    random = np.random.default_rng(0)
    skin = template.faces[: template.skin_face_count]
    corners = template.vertices_m[skin]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = random.choice(len(skin), SKIN_POINTS, p=area / area.sum())
    return skin[chosen], random.dirichlet(np.ones(3), SKIN_POINTS)


def _subject(template: HandTemplate, faces: np.ndarray, barycentric: np.ndarray) -> _Subject:
    return _Subject(
        joints_m=torch.from_numpy(template.joints_m.copy()),
        joint_weights=WeightField.build(template).query(template.joints_m.copy()).double(),
        points_m=torch.from_numpy(np.einsum("sk,skc->sc", barycentric, template.vertices_m[faces])),
        point_weights=torch.from_numpy(np.einsum("sk,skj->sj", barycentric, template.bone_weights[faces])),
    )


def _distances_m(
    moved: tuple[np.ndarray, np.ndarray, np.ndarray], joints_m: np.ndarray, truth_m: np.ndarray
) -> Iterator[float]:
    """The four distances of TransformScore, meters."""
    by_matrix, by_skin, skin = moved
    yield float(np.linalg.norm(by_matrix - joints_m, axis=-1).mean())
    yield float(np.linalg.norm(by_skin - joints_m, axis=-1).mean())
    yield 0.5 * float(KDTree(truth_m).query(skin)[0].mean() + KDTree(skin).query(truth_m)[0].mean())
    yield float(np.linalg.norm(skin - truth_m, axis=-1).mean())


def transform_table(scores: dict[str, dict[str, TransformScore]], poses: int) -> Table:
    """The paper's table with our rows: mean over the hands, and their spread. scores: of each hand, by transform."""
    columns = ("Transform", "Joints, matrices", "Joints, skinned", "Chamfer-L1", "Skin")
    rows = []
    for name in TRANSFORMS:
        of_hands = np.array([[*vars(by_transform[name]).values()] for by_transform in scores.values()])
        cells = zip(of_hands.mean(0), of_hands.std(0), strict=True)
        rows.append((name, *(f"{number(mean, 2)} ± {number(spread, 2)}" for mean, spread in cells)))
    for name, sets in PAPER_TRANSFORM.items():
        for capture, (joints, chamfer) in zip(("test/Capture0", "test/Capture1"), sets, strict=True):
            rows.append((f"{name}, {capture}", f"{joints:.4f} †", NONE, f"{chamfer:.2f} †", NONE))
    return Table(
        f"Transformation, {poses} poses of each of {len(scores)} hands, millimeters",
        columns,
        tuple(rows),
        (
            f"Mean ± standard deviation over the hands ({', '.join(scores)}).",
            f"Joints: mean over {JOINT_COUNT} joints. Truth: a mesh of other proportions, posed by its own 25 joints.",
            "naive and HALO-like: written from descriptions (METHOD 2.2), not code. HALO's canonical skeleton has the "
            "lengths of the posed hand, which its network is told; the template's skin has its own and misses by the "
            "difference. The naive transform starts every bone on its joint, and so misses by one bone's difference.",
            "† In the paper's units, which it does not give (meters fit the joints).",
            CAVEAT,
        ),
    )


def headline(scores: dict[str, dict[str, TransformScore]]) -> str:
    """How far the skin of our transform is from the truth, beside the others', mean over the hands."""
    skin_mm = {name: np.mean([by_transform[name].skin_mm for by_transform in scores.values()]) for name in TRANSFORMS}
    others = ", ".join(f"by the {name} transform {skin_mm[name]:.2f} mm" for name in ("naive", "HALO-like"))
    return f"Skin of other hands: {skin_mm['ours, axial']:.2f} mm from where it belongs, {others}."


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the figures here too")
    options = parser.parse_args()
    names = identity_names()
    with progress("Measuring", POSES * len(names)) as bar:
        scores = {name: measure_transforms(name, POSES, tick=bar.advance) for name in names}
    say_whole_table(transform_table(scores, POSES))
    say(headline(scores))
    if options.json:
        by_hand = {hand: {name: asdict(score) for name, score in found.items()} for hand, found in scores.items()}
        write_json(options.json, {"poses": POSES, "scores": by_hand})


if __name__ == "__main__":
    main()
