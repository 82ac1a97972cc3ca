"""Prints how far the skin of fingers, palm and thumb is apart in a pose, on every hand that captures show: millimeters,
negative inside.

    python scripts/show_skin_gaps.py --pose fist

captured: as a capture shows the pose · by bones: the same before its skin is closed · driven: the named pose that
animators apply, on an avatar that is exactly that hand · unknown: the same where its skin is not known · assets: with
the built-in hand's angles, as Blender's pose library has them. Neighbors: index to middle, ring to middle, pinky to
ring, the mean of the nearest quarter of the last two phalanges. Palm: index to pinky; thumb: to index and middle; the
nearest hundredth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import tyro

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.captures.making.closing import Closing
from jghand_engine.captures.making.rig import RiggedHand, identity_names, load_identity
from jghand_engine.captures.making.skin_gaps import IdentitySkin, SkinGaps
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import NO_FIST, ArchingHand
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.shapes import angles_on
from jghand_engine.hand.skeleton import Skeleton
from jghand_engine.learn.fist import fist_by_skin
from jghand_engine.template.mesh import skinned


@dataclass(frozen=True)
class Options:
    pose: str = "fist"


def main(options: Options) -> None:
    builtin = load_builtin(handedness=Handedness.RIGHT)
    of_builtin = angles_on(ArchingHand(builtin.rest_joints_m, builtin.fist), options.pose)
    print(f"{options.pose:26}{'neighbors':^24}{'palm':^30}{'thumb':^14}")
    for name in identity_names():
        hand = RiggedHand(load_identity(name))
        by_bones, closing = hand.angles_of(options.pose), Closing(hand)
        rows = {
            "by bones": closing.gaps(by_bones),
            "captured": closing.gaps(closing.closed(by_bones)),
            "driven": driven_gaps(hand, options.pose),
            "unknown": driven_gaps(hand, options.pose, is_known=False),
            "assets": gaps_of(hand)(ArchingHand(hand.identity.joints_m).joints(of_builtin[None])[0]),
        }
        for kind, row in rows.items():
            parts = (row.neighbors(), row.palm(), row.thumb()[:2])
            print(f"{name:14}{kind:10}" + "  ".join("".join(f"{gap:7.1f}" for gap in part) for part in parts))


def driven_gaps(hand: RiggedHand, pose: str, *, is_known: bool = True) -> SkinGaps:
    """Of an avatar that is exactly this hand in a named pose. is_known: whether it knows its skin"""
    joints_m, gaps = hand.identity.joints_m, gaps_of(hand)
    fist = fist_by_skin(joints_m, gaps) if is_known else NO_FIST
    return gaps(named_pose(pose, joints_m, handedness=Handedness.RIGHT, fist=fist))


def gaps_of(hand: RiggedHand) -> Callable[[np.ndarray], SkinGaps]:
    """Of an avatar that is exactly this hand, for joints (21, 3) of a right hand."""
    identity, skin = hand.identity, IdentitySkin(hand.identity)
    skeleton = Skeleton(identity.joints_m, handedness=Handedness.RIGHT)
    return lambda joints_m: skin.gaps(skinned(identity.vertices_m, identity.bone_weights, skeleton, joints_m))


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
