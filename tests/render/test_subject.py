"""The hand in motion that times are measured on."""

import numpy as np
from small_avatars import small_avatar

from jghand_engine.hand.joints import Handedness
from jghand_engine.render.subject import STEP_MIN_M, moving_subject


def test_no_frame_could_be_reused_and_the_hand_is_in_the_picture():
    for handedness in Handedness:
        subject = moving_subject("small", small_avatar(10).for_hand(handedness), 96, 64)
        assert np.abs(np.diff(subject.poses, axis=0)).max((1, 2)).min() > STEP_MIN_M
        pixels, depth_m = subject.camera.project(subject.poses)
        assert float(depth_m.min()) > 0.3
        inside = (pixels > 0) & (pixels < np.array([96, 64]))
        assert float(inside.all(-1).mean()) > 0.95
