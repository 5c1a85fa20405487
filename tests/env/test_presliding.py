"""LuGre friction of `eval/reference/lugre.py` against the kernels."""

import numpy as np
import pytest
from driven_arms import push

from beltarm_env import BeltArmVectorEnv
from eval.reference.lugre import LuGreArms

ARMS, SEED = 3, 4_200_900


def motion(deflection: float | None, samples: int = 200, steps: int = 60) -> np.ndarray:
    """States of arms of the training ranges that are pushed back and forth, shape (samples, ARMS, 4)."""
    env = BeltArmVectorEnv(ARMS, randomization="train", autoreset_mode="Disabled")
    if deflection is not None:
        env._batch.engine = LuGreArms(env._batch, deflection, steps)
    env.reset(seed=SEED)
    states = np.empty((samples, ARMS, 4))
    for k in range(samples):
        env.step(np.full((ARMS, 1), push(k) / 0.3, np.float32))
        states[k] = env.state
    return states


def test_located_friction_is_the_limit_of_a_stiff_bristle():
    there = motion(None)
    assert np.ptp(there[:, :, 0], axis=0).min() > 1 and (there[100:, :, 1] == 0).any(), "moves and sticks"
    apart = [np.abs(motion(deflection) - there)[:, :, 0].max() for deflection in (3e-3, 3e-4, 3e-5)]
    assert apart[1] < 0.5 * apart[0] and apart[2] < 0.5 * apart[1]
    assert apart[2] < 0.01 * np.ptp(there[:, :, 0], axis=0).max()


def test_steps_are_fine_enough():
    np.testing.assert_allclose(motion(1e-3), motion(1e-3, steps=240), rtol=0, atol=1e-4)


def test_bristle_gives_way_by_its_deflection():
    """Half the breakaway torque, slowly, turns a motor at rest by ln 2 times the deflection."""
    env = BeltArmVectorEnv(1, autoreset_mode="Disabled")
    env._batch.engine = LuGreArms(env._batch, 2e-3)
    env.reset(seed=SEED, options={"params": {"belt_stiffness": 1e-3, "motor_viscous_friction": 0.0}})
    start, params = env.state[0, 0], env.params[0]
    pull = 0.5 * params.coulomb_friction / params.torque_limit
    for k in range(300):
        env.step(np.full((1, 1), pull * min(k / 200, 1.0), np.float32))
    # dz/dtheta_a = 1 - z / z_max on the way: the bristle is at z_max / 2 when the motor has turned by z_max ln 2
    assert env.state[0, 0] - start == pytest.approx(2e-3 * np.log(2), rel=0.01)
