"""Servos about a flat motion: PID (`flat`) and active disturbance rejection (`adrc`)."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from baselines.loops.laws import law_of
from baselines.models.actuator import dead_time
from baselines.models.flatness import CORNERS, SpreadGains, write_corners
from baselines.models.linear import ANGLES
from baselines.models.rigid_arm import inertia_at
from baselines.servo.adrc import AdrcController, AdrcGains, ExtendedState, feedback, observe, observer_gains
from baselines.servo.flat import FlatController, FlatGains, joint_motion
from baselines.servo.shaping import ShapingController
from beltarm_env import CONTROL_PERIOD
from beltarm_env.arrays import Floats
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import design_model
from beltarm_env.task.reference import MoveShape

SEED = 5_000_000
KNOWN = replace(design_model(), coulomb_friction=0.0, belt_stiffening=0.0)
"""An arm as the flat motion has it, behind a drive."""
MOVE = {"start": 0.2, "goal": 1.4, "duration": 0.9, "ramp_time": 0.25}


def smoothed(gains: SpreadGains) -> Floats:
    """Corners of `MOVE`, shape (CORNERS,)."""
    corners = np.empty(CORNERS)
    write_corners(MoveShape(**MOVE), KNOWN.plant(), gains.first_spread, gains.spread, corners)
    return corners


def known_arm_run(controller: FlatController | AdrcController) -> Floats:
    """Motor's error from the flat motion on an arm that is known in all but its friction, shape (1200,)."""
    run = rollout(controller, 1, options={"params": asdict(KNOWN), "move": MOVE}, encoder_counts=10_000_000)
    corners = smoothed(controller.gains)
    wanted = [joint_motion(corners, time, KNOWN.plant()).angle for time in run.time]
    return run.state[:, 0, 0] - 88 * np.array(wanted)


class TestFeedForward:
    def test_motion_is_that_of_its_own_derivatives(self):
        times = np.linspace(0.01, 1.0, 2000)
        corners = smoothed(SpreadGains(0.4, 0.7))
        angle, speed, acceleration = np.array([joint_motion(corners, time, KNOWN.plant()) for time in times]).T
        np.testing.assert_allclose(np.gradient(angle, times)[1:-1], speed[1:-1], atol=2e-3)
        off = np.abs(np.gradient(speed, times) - acceleration)
        assert np.median(off) < 2e-3 and (off < 0.1).mean() > 0.98  # but where the link's fourth derivative jumps

    def test_a_known_arm_follows_with_hardly_any_feedback(self):
        weak = FlatGains(angle=10.0, speed=5.0, integral=0.01, friction=0.0)
        error = known_arm_run(FlatController(weak, KNOWN))
        assert np.abs(error).max() < 0.05  # of 106 rad
        late = FlatController(weak, replace(KNOWN, command_latency=KNOWN.command_latency + CONTROL_PERIOD))
        assert np.abs(known_arm_run(late)).max() > 3 * np.abs(error).max()

    def test_rings_less_than_a_rigid_arms_torque_on_a_shaped_move(self):
        arms = {"randomization": {"payload_mass": (0.0999, 0.1001)}, "seed": SEED}
        flat, shaped = (rollout(kind(), 24, **arms).metrics() for kind in (FlatController, ShapingController))
        assert np.mean(flat["cost"]) < 0.8 * np.mean(shaped["cost"])


class TestObserver:
    @pytest.mark.parametrize("bandwidth", [1.0, 30.0, 400.0])
    def test_its_poles_lie_where_the_bandwidth_says(self, bandwidth: float):
        gains = observer_gains(bandwidth)
        step = [observe(ExtendedState(*row), 0.0, 0.0, gains) for row in np.eye(3)]
        poles = np.linalg.eigvals(np.array(step).T)
        np.testing.assert_allclose(poles, np.exp(-bandwidth * CONTROL_PERIOD), atol=2e-4)

    def test_finds_a_constant_acceleration(self):
        z, times = ExtendedState(0.0, 0.0, 0.0), CONTROL_PERIOD * np.arange(1, 400)
        for time in times:
            z = observe(z, 2.0, 0.5 * 5.0 * time**2, observer_gains(60.0))
        np.testing.assert_allclose(z, [2.5 * times[-1] ** 2, 5.0 * times[-1], 3.0], rtol=1e-6)

    def test_law_cancels_what_is_found_and_places_two_poles(self):
        h, z = 1e-4, np.array([1.0, 0.0, 7.0])
        transition = np.eye(3) + h * np.array([[0, 1, 0], [0, 0, 1], [0, 0, 0]])
        transition[1] += h * np.array([feedback(ExtendedState(*unit), 20.0) for unit in np.eye(3)])
        for _ in range(20_000):
            z = transition @ z
        np.testing.assert_allclose(z, [0, 0, 7], atol=1e-9)
        poles = np.sort(np.linalg.eigvals(transition[:2, :2]).real)
        np.testing.assert_allclose(np.log(poles) / h, -20.0, rtol=2e-3)

    def test_gains_are_small_for_a_slow_one(self):
        # Continuous: 3 w, 3 w^2, w^3.
        w = 0.1
        np.testing.assert_allclose(np.array(observer_gains(w)) / CONTROL_PERIOD, [3 * w, 3 * w**2, w**3], rtol=1e-3)


class TestAdrc:
    @pytest.mark.parametrize(("known", "found"), [(True, (0.0, 1e-9)), (False, (10.0, 1000.0))])
    def test_commands_on_their_way_are_no_disturbance(self, known: bool, found: tuple[float, float]):
        """On a motor that is an inertia behind the drive's dead time, pushed at will, the observer finds nothing."""
        params = KNOWN if known else replace(KNOWN, command_latency=0.0, current_loop_time_constant=0.0)
        law = law_of(AdrcController(AdrcGains(observer=200.0), params), 20)
        inertia = inertia_at(ANGLES[20], KNOWN.plant())
        whole, rest = divmod(dead_time(KNOWN) / CONTROL_PERIOD, 1.0)
        memory, error, rate, largest = np.zeros(law.size), 0.0, 0.0, 0.0
        pushes = 0.02 * np.sin(0.2 * np.arange(-3, 300)) * (np.arange(-3, 300) >= 0)
        for k in range(3, 300):
            acting = (pushes[k - int(whole)] * (1 - rest) + pushes[k - int(whole) - 1] * rest) / inertia
            error += CONTROL_PERIOD * (rate + 0.5 * CONTROL_PERIOD * acting)
            rate += CONTROL_PERIOD * acting
            _, memory = law.step(error, rate, float(pushes[k]), memory)
            largest = max(largest, abs(float(memory[2])))
        assert found[0] <= largest < found[1]

    def test_gets_rid_of_a_constant_torque(self):
        weak = replace(KNOWN, torque_constant_error=-0.1, motor_viscous_friction=2 * KNOWN.motor_viscous_friction)
        left = {}
        for observer in (1.0, 40.0):
            gains = AdrcGains(friction=0.0, observer=observer)
            options = {"params": asdict(weak), "move": MOVE}
            run = rollout(AdrcController(gains, KNOWN), 1, options=options, encoder_counts=10_000_000)
            left[observer] = np.abs(run.state[400:560, 0, 0] - 88 * (0.2 + 1.2 * (run.time[400:560] - 0.125) / 0.65))
        assert left[40.0].mean() < 0.5 * left[1.0].mean()

    def test_a_motor_that_rests_on_its_goal_is_left_alone(self):
        run = rollout(AdrcController(), 16, seed=SEED, randomization="train")
        assert np.median(run.metrics()["torque_reversals_hz"]) < 10
        assert (np.abs(run.state[-100:, :, 1]).max(axis=0) == 0).mean() > 0.3
