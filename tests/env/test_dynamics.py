"""Motion behind an ideal drive: event-located solutions, order of the integrator, energy, and stiction."""

import math
from typing import Any

import numpy as np
import pytest
from driven_arms import (
    GEAR,
    LOSSLESS,
    MODELS,
    Command,
    apply,
    arm_env,
    at_rest,
    largest_distance,
    reversals,
    stops,
    wave,
)
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from scipy.integrate import solve_ivp

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams
from beltarm_env.observation import decode
from beltarm_env.task.ranges import IDEAL_RANGES
from eval.reference.event_located import EventLocatedArm, tip
from eval.studies.physics import measure_convergence

Floats = NDArray[np.float64]

LIMIT = 0.3
DEG_45, DEG_90 = math.pi / 4, math.pi / 2
LOW, HIGH = ({name: pair[end] for name, pair in IDEAL_RANGES.items()} for end in (0, 1))
FASTEST_TRAINED = LOW | {"belt_stiffness": HIGH["belt_stiffness"]}
SLOWEST_TRAINED = HIGH | {"belt_stiffness": LOW["belt_stiffness"]}
HAND = {"arm_inertia": 0.008, "arm_inertia_swing": 0.072, "payload_mass": 0.1}  # beside the rod
PULLEY = {"arm_inertia": 0.012, "arm_inertia_swing": 0.048, "gear_ratio": 60.0, "link_length": 0.3}


def still(_: int, __: EventLocatedArm) -> float:
    return 0.0


def back_and_forth(sample: int, arm: EventLocatedArm) -> float:
    """Table 2's position loop without friction compensation, after a joint that swings by 0.3 rad around 45 degrees."""
    time, rate = sample * CONTROL_PERIOD, 2 * math.pi * 1.2
    reference = DEG_45 + 0.3 * math.sin(rate * time)
    speed, acceleration = 0.3 * rate * math.cos(rate * time), -0.3 * rate**2 * math.sin(rate * time)
    demand = GEAR * acceleration + 20 * (GEAR * speed - arm.state[1]) + 25 * (GEAR * reference - arm.state[0])
    return min(max(6.3e-5 * demand + 3.5e-4 * arm.state[1], -LIMIT), LIMIT)


class TestAgainstEventLocatedIntegration:
    @pytest.mark.parametrize(
        ("model", "params", "command"),
        [
            pytest.param("lumped", {}, wave(0.06, 4), id="nominal"),
            pytest.param("lumped", {}, wave(0.042, 5), id="barely breaking away"),
            pytest.param("lumped", {"payload_mass": 0.5}, wave(0.058, 4), id="payload"),
            pytest.param("lumped", {"belt_stiffness": 16.5, "belt_damping_ratio": 0.0}, wave(0.058, 4), id="soft belt"),
            pytest.param("lumped", {"coulomb_friction": 0.1}, wave(0.15, 4), id="120 degrees of the motor"),
            pytest.param("lumped", FASTEST_TRAINED, wave(0.04, 4), id="fastest trained"),
            pytest.param("lumped", SLOWEST_TRAINED, wave(0.06, 4), id="slowest trained"),
            pytest.param("lumped", {"coulomb_friction": 0.1, "payload_mass": 0.2}, back_and_forth, id="moves"),
            pytest.param("lagrangian", {}, wave(0.046, 3), id="full arm"),
            pytest.param("lagrangian", HAND, wave(0.06, 5), id="full arm with a hand"),
            pytest.param("lagrangian", PULLEY, wave(0.046, 3), id="full arm with a pulley"),
        ],
    )
    def test_stick_slip_moves(self, model: str, params: dict[str, float], command: Command):
        start = at_rest(DEG_45, gear=params.get("gear_ratio", GEAR))
        worst, arm = largest_distance(params, start, command, model, 800)
        assert stops(arm) >= 3 and reversals(arm) >= 3
        assert sum(old == "stuck" for old, _ in arm.mode_changes) >= 3, "breaks away"
        assert worst < 1e-6

    @pytest.mark.parametrize("joint", [0.0, DEG_90])
    def test_stuck_motor_while_the_arm_rings(self, joint: float):
        worst, arm = largest_distance({}, at_rest(joint, 0.08), still)
        assert [new for _, new in arm.mode_changes] == ["stuck"]
        assert worst < 1e-6

    @pytest.mark.parametrize(("belt_damping_ratio", "command"), [(0.0, still), (0.01, wave(0.05, 3))])
    def test_zero_friction(self, belt_damping_ratio: float, command: Command):
        params = {"coulomb_friction": 0.0, "belt_damping_ratio": belt_damping_ratio}
        worst, arm = largest_distance(params, at_rest(DEG_45, 0.03), command)
        assert stops(arm) == 0 and reversals(arm) >= 4
        assert worst < 1e-6

    # An oiled motor crosses the whole band of sticking within one sample, either way.
    @pytest.mark.parametrize(("coulomb_friction", "torsion_speed"), [(1e-4, -5.0), (1e-3, 5.0)])
    def test_little_friction(self, coulomb_friction: float, torsion_speed: float):
        params = {"coulomb_friction": coulomb_friction, "belt_damping_ratio": 0.0}
        worst, arm = largest_distance(params, at_rest(0.8, 0.0, torsion_speed), still)
        assert arm.mode_changes[0][1] == "stuck" and len(arm.mode_changes) > 8
        assert worst < 1e-6

    @pytest.mark.parametrize("regime", ["smooth", "stick-slip"])
    @pytest.mark.parametrize("model", MODELS)
    def test_fourth_order(self, model: str, regime: str):
        result = measure_convergence(model, regime, 400)
        np.testing.assert_allclose(result.orders[:2], 4.0, atol=0.1)
        assert result.errors[0] < 1e-7
        assert result.stops >= 3 if regime == "stick-slip" else result.stops == 0


def energy(params: ArmParams, states: Floats) -> Floats:
    """Kinetic energy of motor and lumped arm plus the belt's [J]."""
    theta_a, omega_a, theta_s, omega_s = np.atleast_2d(states).T
    phi = theta_a / params.gear_ratio - theta_s
    phi_dot = omega_a / params.gear_ratio - omega_s
    swing = params.arm_inertia_swing + (2 * params.link_length) ** 2 * params.payload_mass
    m2 = params.arm_inertia + swing * np.sin(phi) ** 2
    return 0.5 * (params.motor_inertia * omega_a**2 + m2 * phi_dot**2 + params.belt_stiffness * theta_s**2)


def drift(energies: Floats) -> float:
    """Largest relative departure from the initial energy."""
    return float(np.abs(energies / energies[0] - 1).max())


def unforced(params: ArmParams, state: Floats, m2_slope: bool) -> Floats:
    """The lossless arm integrated by SciPy, with or without the term 1/2 M2' phi'^2: states at the samples."""
    swing = params.arm_inertia_swing + (2 * params.link_length) ** 2 * params.payload_mass

    def rates(_: float, y: Floats) -> list[float]:
        theta_a, omega_a, phi, phi_dot = y
        belt = params.belt_stiffness * (theta_a / params.gear_ratio - phi)
        m2 = params.arm_inertia + swing * math.sin(phi) ** 2
        centrifugal = swing * math.sin(phi) * math.cos(phi) * phi_dot**2 if m2_slope else 0.0
        return [omega_a, -belt / params.gear_ratio / params.motor_inertia, phi_dot, (belt - centrifugal) / m2]

    times = CONTROL_PERIOD * np.arange(EPISODE_STEPS + 1)
    theta_a, omega_a, theta_s, omega_s = state
    start = [theta_a, omega_a, theta_a / params.gear_ratio - theta_s, omega_a / params.gear_ratio - omega_s]
    y = solve_ivp(rates, (0, times[-1]), start, "DOP853", times, rtol=1e-11, atol=1e-12).y
    joint, joint_speed = y[0] / params.gear_ratio, y[1] / params.gear_ratio
    return np.column_stack([y[0], y[1], joint - y[2], joint_speed - y[3]])


def unforced_states(params: dict[str, float], start: Floats, model: str = "lumped") -> Floats:
    """States of an episode of the environment without torque."""
    env = arm_env(params, start, model)
    return np.array([env.state, *((apply(env, 0.0), env.state)[1] for _ in range(EPISODE_STEPS))])


class TestEnergy:
    @pytest.mark.parametrize(
        ("model", "params"),
        [
            *(("lumped", {}), ("lumped", {"payload_mass": 0.2})),
            *(("lagrangian", {}), ("lagrangian", HAND), ("lagrangian", PULLEY)),
        ],
    )
    @pytest.mark.parametrize(("joint", "torsion"), [(0.0, -0.1), (DEG_45, 0.1), (DEG_90, 0.1)])
    def test_conserved_without_losses(self, joint: float, torsion: float, model: str, params: dict[str, float]):
        # RK4 itself loses (58.0/s * 1.5 ms)^6 / 72 = 6e-9 of the energy per step: 7e-6 in 1200 steps.
        params = {**params, **LOSSLESS}
        states = unforced_states(params, at_rest(joint, torsion, gear=params.get("gear_ratio", GEAR)), model)
        energies = [EventLocatedArm(ArmParams(**params), state, model).energy for state in states[::60]]
        assert energies[0] == pytest.approx(0.5 * 33 * torsion**2)
        assert drift(np.array(energies)) < 1e-5

    def test_not_conserved_without_the_term_that_the_paper_leaves_out(self):
        params, start = ArmParams(**LOSSLESS), at_rest(DEG_45, 0.1)
        complete, as_printed = unforced(params, start, True), unforced(params, start, False)
        assert drift(energy(params, complete)) < 1e-7
        assert drift(energy(params, as_printed)) > 0.01
        end = tip(params, unforced_states(LOSSLESS, start)[-1])
        assert np.linalg.norm(end - tip(params, complete[-1])) < 1e-6
        assert np.linalg.norm(end - tip(params, as_printed[-1])) > 1e-3

    @examples(50)
    @given(
        params=st.fixed_dictionaries(
            {
                "motor_inertia": st.floats(3e-5, 1.2e-4),
                "motor_viscous_friction": st.floats(0, 1e-3),
                "coulomb_friction": st.sampled_from([0.0, 0.001, 0.032]) | st.floats(0, 0.1),
                "arm_inertia": st.floats(0.005, 0.03),
                "arm_inertia_swing": st.floats(0, 0.12),
                "payload_mass": st.floats(0, 0.5),
                "belt_stiffness": st.floats(10, 60),
                "belt_damping_ratio": st.floats(0, 0.05),
            }
        ),
        state=st.tuples(st.floats(GEAR * 0.1, GEAR * 1.4), st.floats(-50, 50), st.floats(-0.1, 0.1), st.floats(-3, 3)),
        torques=st.lists(st.sampled_from([0.0, 0.03]) | st.floats(-LIMIT, LIMIT), min_size=1, max_size=6),
    )
    def test_never_created(self, params: dict[str, float], state: tuple[float, ...], torques: list[float]):
        env = arm_env(params, np.array(state))
        states, supplied = [env.state], [0.0]
        for torque in np.repeat(torques, 50):
            terminated = env.step(np.array([torque / LIMIT]))[2]
            states.append(env.state)
            supplied.append(supplied[-1] + torque * (states[-1][0] - states[-2][0]))
            if terminated:
                break
        energies = energy(env.params, np.array(states))
        balance = energies - supplied
        created = balance - np.minimum.accumulate(balance)
        assert created.max() <= 1e-5 * energies.max()


class TestStiction:
    @pytest.mark.parametrize("torsion", [-0.085, 0.04])
    def test_encoder_is_blind_to_an_arm_that_rings_behind_a_stuck_motor(self, torsion: float):
        env = arm_env({}, at_rest(math.pi / 6, torsion), encoder_counts=10_000_000)
        start, torsions = env.state, []
        for _ in range(EPISODE_STEPS):
            seen: Any = decode(apply(env, 0.0))
            assert seen["motor_speed"] == 0 and env.state[:2].tolist() == start[:2].tolist()
            torsions.append(env.state[2])
        assert np.ptp(torsions[:200]) > abs(torsion)

    def test_beyond_85_mrad_the_belt_moves_the_motor(self):
        threshold = GEAR * 0.032 / 33
        assert threshold == pytest.approx(0.0853, abs=1e-4)
        for share in (0.999, 1.001, -1.001):
            states = unforced_states({}, at_rest(math.pi / 6, share * threshold))
            assert (np.ptp(states[:, 0]) > 0) == (abs(share) > 1)

    @pytest.mark.parametrize("torque", [0.0319, -0.0319, 0.0321, -0.0321])
    def test_motor_starts_only_beyond_coulomb_friction(self, torque: float):
        env = arm_env({}, at_rest(DEG_45))
        start = env.state[0]
        apply(env, torque)
        assert np.sign(env.state[0] - start) == (0 if abs(torque) < 0.032 else np.sign(torque))
