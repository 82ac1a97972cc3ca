import numpy as np
from scipy.spatial.transform import Rotation

from jghand_engine.export.motion import BonePoses
from jghand_engine.export.usd.rig import (
    FINE_SHARE,
    build_skeleton,
    in_motion,
    split_scales,
)
from jghand_engine.template.builtin import load_template


def test_coarse_and_fine_scale_make_up_what_half_precision_loses():
    scales = np.random.default_rng(0).uniform(0.3, 3, (1000, 21, 3))
    coarse, fine = split_scales(scales)
    for part in (coarse, fine):
        assert (part == part.astype(np.float16)).all()
        assert (part > 0).all()
    together = (1 - FINE_SHARE) * coarse + FINE_SHARE * fine
    # half a step of half precision times the share, 2^-11 * 2^-8, and a little for twins above 2; observed 2.0e-6
    assert np.abs(together / scales - 1).max() < 2.2e-6
    assert np.abs(coarse / scales - 1).max() > 4e-4, "half precision alone would do, then the twins are not needed"


def test_rotations_do_not_jump_between_the_parts_of_a_motion():
    """A wrist that turns twice all round: without care its quaternions change sign somewhere."""
    frames = 60
    angle = np.linspace(0, 4 * np.pi, frames)
    turn = Rotation.from_rotvec(angle[:, None] * [0.6, -0.48, 0.64]).as_matrix()
    axes = np.broadcast_to(turn[:, None], (frames, 21, 3, 3))
    joints_m = np.einsum("fab,jb->fja", turn, load_template().joints_m)
    poses = BonePoses(joints_m, axes, np.ones((frames, 21, 3)))
    parts = [BonePoses(*(getattr(poses, name)[part] for name in ("joints_m", "axes", "scales")))
             for part in (slice(0, 1), *(slice(first, first + 7) for first in range(0, frames, 7)))]  # fmt: skip
    skeleton = build_skeleton(parts[0])
    rotations = np.concatenate([one.rotations_xyzw for one in in_motion(skeleton, parts[1:])])
    assert len(rotations) == frames
    assert ((rotations[1:] * rotations[:-1]).sum(-1) > 0.9).all()
