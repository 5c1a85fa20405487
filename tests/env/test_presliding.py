"""A motor that gives before it slips: elastic, with hysteresis, and never a source of energy."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from commands import python
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples

from beltarm_env import ArmParams, design_model
from beltarm_env.physics.drive import SMALLEST_DEFLECTION
from beltarm_env.physics.friction import SLIPS
from beltarm_env.simulation import ArmSimulation
from eval.reference.drive import friction_level, presliding, stribeck
from eval.reference.event_located import EventLocatedArm

GIVES = replace(design_model(), static_friction_excess=0.0, presliding_deflection=0.003, friction_drift=0.0)
ANGLE = 40.0
DEFLECTION = 8


def moved(params: ArmParams, torques: NDArray[np.float64], model: str = "lumped") -> NDArray[np.float64]:
    """States of an arm at rest after each command [N m], shape (T, 9)."""
    simulation = ArmSimulation(params, model=model)
    x, states = simulation.at_rest(np.array([ANGLE])), []
    for torque in torques:
        x = simulation.advance(x, np.array([torque]))
        states.append(x[0])
    return np.array(states)


@pytest.mark.parametrize("model", ["lumped", "lagrangian"])
def test_a_pull_below_breakaway_is_given_way_to_and_springs_back(model: str):
    pull = 0.6 * GIVES.coulomb_friction
    states = moved(GIVES, np.repeat([pull, 0.0], 600), model)
    assert states[599, 0] - ANGLE == pytest.approx(0.6 * GIVES.presliding_deflection, rel=0.05)
    assert states[-1, 0] == pytest.approx(ANGLE, abs=2e-5)
    assert (np.abs(states[:, DEFLECTION]) < SLIPS).all(), "it never slips"


def test_what_has_slipped_springs_back_by_the_deflection_alone():
    states = moved(GIVES, np.repeat([1.2 * GIVES.coulomb_friction, 0.0], [150, 1000]))
    assert (states[:, DEFLECTION] == SLIPS).any()
    farthest, end = states[:, 0].max(), states[-1, 0]
    assert farthest - ANGLE > 10 * GIVES.presliding_deflection
    assert 0.2 * GIVES.presliding_deflection < farthest - end < 3 * GIVES.presliding_deflection


def test_a_deflection_too_small_to_count_is_none():
    torques = 0.1 * np.sin(0.05 * np.arange(200))
    least = replace(GIVES, presliding_deflection=0.9 * SMALLEST_DEFLECTION)
    clean = replace(GIVES, presliding_deflection=0.0)
    np.testing.assert_array_equal(moved(least, torques), moved(clean, torques))


@examples(25)
@given(
    p=st.builds(
        partial(ArmParams, torque_ripple=0.004, belt_stiffening=0.2),
        presliding_deflection=st.floats(2e-4, 0.02),
        static_friction_excess=st.floats(0, 0.8),
        friction_variation=st.floats(0, 0.4),
        friction_variation_phase=st.floats(0, 6.28),
    ),
    push=st.floats(0.01, 0.2),
    torsion=st.floats(-0.1, 0.1),
    model=st.sampled_from(["lumped", "lagrangian"]),
)
def test_energy_never_grows_without_torque(p: ArmParams, push: float, torsion: float, model: str):
    simulation, clean = ArmSimulation(p, model=model), replace(p, presliding_deflection=0.0)
    x = simulation.at_rest(np.array([ANGLE]))
    x[0, 2] += torsion
    for _ in range(10):
        x = simulation.advance(x, np.array([push]))
    energies = []
    for _ in range(300):
        x = simulation.advance(x, np.zeros(1))
        spring, z = presliding(p)[0], float(x[0, DEFLECTION])
        most = friction_level(p, x[0, 0]) * stribeck(p, 0.0)
        load = most if abs(z) >= SLIPS else spring * z
        energies.append(EventLocatedArm(clean, x[0, :4], model).energy + load * load / (2 * spring))
    assert np.diff(energies).max() < 1e-8


def test_an_arm_that_takes_too_many_steps_has_left_its_workspace():
    code = "from beltarm_env.kernels import pieces; import beltarm_env, sys; pieces.MOST_STEPS = int(sys.argv[1])\n"
    code += "env = beltarm_env.BeltArmEnv(randomization='train'); env.reset(seed=0); print(env.step([1.0])[2])"
    ended = [python("-c", code, steps, BELTARM_ENGINE="plain").split() for steps in (1, 20_000)]
    assert ended == [["True"], ["False"]]


def test_a_motor_that_has_just_stopped_does_not_break_away_again_and_again():
    """Within a piece of a nanosecond, until a command arrives: such a motor would not come to the sample's end."""
    ends = []
    for latency in (0.0, 1.5e-9):
        arm = replace(GIVES, presliding_deflection=0.0078, friction_variation=0.06, command_latency=latency)
        random, arms = np.random.default_rng(0), ArmSimulation(arm, len(torques := np.full(4000, 0.03)))
        states = arms.at_rest(random.uniform(-60, 60, 4000))
        states[:, 1:4] += random.uniform(0, [1e-9, 1e-4, 2e-3], (4000, 3))
        states[:, 4:-1], states[:, -1] = random.uniform(0, 0.033, (4000, 1)), SLIPS
        ends.append(arms.advance(states, torques)[:, 1])
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-4)
