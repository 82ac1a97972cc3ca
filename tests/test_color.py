import numpy as np

from jghand_engine.color import linear_to_srgb, srgb_to_linear


def test_known_values_of_the_standard():
    assert np.allclose(srgb_to_linear(np.array([0.0, 0.5, 1.0])), [0, 0.21404114, 1], atol=1e-8)


def test_the_way_back_is_the_inverse():
    colors = np.linspace(0, 1, 1001)
    # worst observed 2e-16
    assert np.abs(linear_to_srgb(srgb_to_linear(colors)) - colors).max() < 1e-15


def test_straight_part_meets_the_curve():
    # the standard's own rounded constants leave a step of 3e-8
    below, above = srgb_to_linear(np.array([0.04045, np.nextafter(0.04045, 1)]))
    assert abs(above - below) < 1e-7


def test_type_and_shape_stay():
    assert srgb_to_linear(np.zeros((2, 3), np.float32)).dtype == np.float32
    assert linear_to_srgb(np.zeros((2, 3), np.float32)).shape == (2, 3)


def test_negative_values_stay_finite():
    assert np.isfinite(srgb_to_linear(np.array([-0.2]))).all()
    assert np.isfinite(linear_to_srgb(np.array([-0.2]))).all()
