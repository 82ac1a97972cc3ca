"""What a trained avatar knows beyond its Gaussians: prefixes of it."""

from dataclasses import replace

import numpy as np
from small_avatars import trained_avatar

from jghand_engine.avatar.learned import Ellipsoid, Learned, ShadowLook
from jghand_engine.native.contract import SHADOW_GAIN, SHADOW_TINT


def with_ellipsoids() -> Learned:
    learned = trained_avatar(40).learned
    assert learned is not None
    g = np.random.default_rng(1)
    return replace(learned, ellipsoid=Ellipsoid(g.normal(size=(40, 3)), g.normal(size=(40, 4))), world_offsets=True)


def test_a_prefix_keeps_the_first_of_everything_that_belongs_to_a_gaussian():
    whole = with_ellipsoids()
    part = whole.prefix(7)
    assert np.array_equal(part.normal, whole.normal[:7])
    assert np.array_equal(part.shine, whole.shine[:7])
    assert whole.ellipsoid is not None
    assert part.ellipsoid is not None
    assert np.array_equal(part.ellipsoid.log_stretch, whole.ellipsoid.log_stretch[:7])
    assert np.array_equal(part.ellipsoid.quaternion, whole.ellipsoid.quaternion[:7])


def test_a_prefix_keeps_what_belongs_to_the_hand():
    whole = with_ellipsoids()
    part = whole.prefix(7)
    assert part.light is whole.light
    assert part.shadow is whole.shadow
    assert part.world_offsets


def test_what_was_not_learned_stays_so_in_a_prefix():
    bare = replace(with_ellipsoids(), correctives=None, ellipsoid=None, shadow=None)
    part = bare.prefix(7)
    assert (part.correctives, part.ellipsoid, part.shadow) == (None, None, None)


def test_a_shadow_that_was_not_learned_has_the_looks_of_the_painted_hand():
    assert ShadowLook() == ShadowLook(SHADOW_GAIN, SHADOW_TINT)
