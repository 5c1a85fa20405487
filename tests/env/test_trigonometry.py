"""What is written out instead of a maths library, against one, to the last digits."""

import math

import numpy as np
import pytest

from beltarm_env.physics.trigonometry import exponential, polar_angle, sine_cosine, wrapped

TURN = 2 * math.pi


@pytest.mark.parametrize("radius", [1e-200, 1.0, 3e7])
def test_polar_angle(radius: float):
    for angle in np.linspace(0, TURN, 721)[:-1]:
        x, y = radius * math.cos(angle), radius * math.sin(angle)
        assert polar_angle(x, y) == pytest.approx(math.atan2(y, x) % TURN, rel=4e-16, abs=1e-15)


@pytest.mark.parametrize(
    ("x", "y", "quarters"), [(1, 0, 0), (1, 1, 0.5), (0, 1, 1), (-1, 0, 2), (-1, -1, 2.5), (0, -1, 3), (0, 0, 0)]
)
def test_polar_angle_by_hand(x: float, y: float, quarters: float):
    assert polar_angle(float(x), float(y)) == pytest.approx(quarters * math.pi / 2, rel=4e-16, abs=0)


def test_exponential():
    for x in np.append(np.linspace(-700, 700, 1001), np.linspace(-1, 1, 101)):
        assert exponential(float(x)) == pytest.approx(math.exp(x), rel=1e-15, abs=0)
    assert exponential(0.0) == 1.0


@pytest.mark.parametrize("x", [700.5, 1e4, math.inf])
def test_exponential_ends_at_700(x: float):
    assert exponential(x) == exponential(700.0)
    assert exponential(-x) == exponential(-700.0)


def test_sine_and_cosine_of_any_angle():
    for angle in np.append(np.linspace(-20, 20, 2001), [-9e5, 3e5]):
        rounding = 1e-15 + 2.3e-16 * abs(angle)  # of whole turns
        assert sine_cosine(float(angle)) == pytest.approx((math.sin(angle), math.cos(angle)), abs=rounding)


def test_wrapped_is_the_remainder():
    for angle in np.linspace(-30, 30, 1201):
        assert wrapped(float(angle)) == pytest.approx(math.remainder(angle, TURN), abs=1e-14)
