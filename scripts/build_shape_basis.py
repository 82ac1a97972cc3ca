"""Builds the shapes in which hands differ beyond the lengths of their bones, for `jghand own`. From the package alone.

    python scripts/build_shape_basis.py   # writes jghand_engine/assets/hand_shapes.npz

Two are what the identities of captures differ in once their joints are those of the template: principal components,
of one standard deviation each. Six more are growths of a tenth about the bones: of each finger, and of the palm. The
rest are bumps along the normals: the smoothest functions on the skin (eigenvectors of its Laplacian).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import coo_matrix, diags

sys.path.insert(0, str(Path(__file__).parents[1]))

from jghand_engine.captures.making.rig import identity_names, load_identity
from jghand_engine.files import writing
from jghand_engine.hand.joints import FINGERS, PARENTS, Handedness
from jghand_engine.hand.rotations import unit
from jghand_engine.hand.skeleton import Skeleton
from jghand_engine.template.builtin import load_template, load_template_with_forearm
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.reshape import pulled_back

OUT = Path(__file__).parents[1] / "jghand_engine" / "assets" / "hand_shapes.npz"
# the identity that the built-in hand was learned from: its shape is the built-in hand's own
LEARNED_FROM = "adult_woman"
# of seven identities the first holds 98 % of what they differ in, the second 1 %
COMPONENTS = 2
GROWTH = 0.1
# a palm grows in its breadth and its height less than in its thickness (out of the palm is z)
PALM_GROWTH = np.array([0.3, 0.3, 1.0])
# how many functions, how high the mean spread of the first is together, meters, and from which one on they become
# smaller
BUMPS, BUMPS_OF_SPREAD, BUMP_M, BUMP_SMOOTH = 200, 48, 0.0008, 12
# from the wrist to this far from it they begin, meters
WRIST_FADE_M = 0.015


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=OUT)
    out = parser.parse_args().out
    components, shares = principal(differences())
    print("of what identities differ in:", *(f"{100 * share:.1f} %" for share in shares))
    hand, arm = load_template(), load_template_with_forearm()
    shapes = np.concatenate([components, joined(growths(hand), growths(arm))])
    # the middle of the wrist's cap, which the forearm has not, stays
    height_m = np.insert(bumps(arm), len(hand.vertices_m) - 1, 0, 1)
    with writing(out) as path, open(path, "wb") as stream:
        np.savez_compressed(stream, shapes=shapes.astype("f2"), bumps=height_m.astype("f2"))
    print(f"wrote {out}")


def differences() -> np.ndarray:
    """(n, V, 3) meters: identities and the template, each in the template's canonical hand, less the built-in one."""
    own = {name: joined(residual(name, forearm=False), residual(name, forearm=True)) for name in identity_names()}
    base = own.pop(LEARNED_FROM)
    return np.stack([*(residual - base for residual in own.values()), -base])


def residual(name: str, *, forearm: bool) -> np.ndarray:
    """(V, 3) what an identity's skin is away from the template's, in the template's canonical hand."""
    template = load_template_with_forearm() if forearm else load_template()
    hand = load_identity(name, forearm=forearm)
    skeleton = Skeleton(template.joints_m, handedness=Handedness.RIGHT)
    bones = skeleton.bones(hand.joints_m, np.float64)
    return pulled_back(skeleton, hand.vertices_m, template.bone_weights, bones) - template.vertices_m


def principal(differences_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(COMPONENTS, V, 3) of one standard deviation about the built-in hand, and their shares of the variance.

    Those of the hand: forearms differ more, and only go with it.
    """
    count, hand = len(differences_m), len(load_template().vertices_m)
    mixed, size, _ = np.linalg.svd(differences_m[:, :hand].reshape(count, -1), full_matrices=False)
    spread = np.einsum("nk,nvc->kvc", mixed[:, :COMPONENTS], differences_m) / np.sqrt(count)
    return spread, (size**2 / (size**2).sum())[:COMPONENTS]


def growths(template: HandTemplate) -> np.ndarray:
    """(6, V, 3) meters: thumb, index, middle, ring, pinky and palm, thicker by GROWTH."""
    joints, grown = template.joints_m, np.zeros((len(FINGERS) + 1, len(template.vertices_m), 3))
    for bone in range(1, len(joints)):
        finger, start = (bone - 1) % len(FINGERS), joints[PARENTS[bone]]
        # the thumb's first bone is the thumb's; the other metacarpals are the palm
        in_palm = 1 < bone <= len(FINGERS)
        away = template.vertices_m - start
        along = unit((joints[bone] - start)[None])[0]
        radial = away - (away @ along)[:, None] * along
        grown[-1 if in_palm else finger] += (
            GROWTH * template.bone_weights[:, bone, None] * radial * (PALM_GROWTH if in_palm else 1.0)
        )
    return grown


def bumps(template: HandTemplate) -> np.ndarray:
    """(BUMPS, V) meters along the normals; the hand alone is moved, and less towards the wrist."""
    vertices, faces = template.vertices_m, template.faces
    count, edges = len(vertices), np.concatenate([faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    corner = vertices[faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
    # cotangent of the angle that faces an edge
    cotangent = []
    for near in (2, 0, 1):
        one, other = (corner[:, (near + k) % 3] - corner[:, near] for k in (1, 2))
        cotangent.append((one * other).sum(1) / np.maximum(np.linalg.norm(np.cross(one, other), axis=1), 1e-12))
    stiff = coo_matrix((np.concatenate(cotangent).clip(0, 20) / 2, edges.T), (count, count))
    stiff = (stiff + stiff.T).tocsr()
    laplacian = diags(np.asarray(stiff.sum(1))[:, 0]) - stiff
    mass = np.bincount(faces.ravel(), np.repeat(area / 3, 3), count)
    value, function = eigh(laplacian.toarray(), np.diag(mass + 1e-9), subset_by_index=[0, BUMPS - 1])
    function = function * np.sign(function[np.abs(function).argmax(0), np.arange(BUMPS)])
    size = 1 / np.sqrt(1 + value / value[BUMP_SMOOTH])
    away = np.clip(vertices[:, 1] / WRIST_FADE_M, 0, 1)[:, None] * function * size
    spread = (mass[:, None] * away[:, :BUMPS_OF_SPREAD] ** 2).sum() / (mass * (vertices[:, 1] > 0)).sum()
    return away.T * (BUMP_M / np.sqrt(spread))


def joined(of_hand: np.ndarray, with_forearm: np.ndarray) -> np.ndarray:
    """(..., S + 1 + A, 3): the hand's skin and the middle of its wrist's cap, then the forearm."""
    skin = of_hand.shape[-2] - 1
    return np.concatenate([of_hand, with_forearm[..., skin:, :]], -2)


if __name__ == "__main__":
    main()
