"""Linear loops of the classical controllers: each against its controller at work, margins against poles and latency."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, cast

import control
import numpy as np
import pytest
from refusals import refused

from baselines import CONTROLLERS, TUNABLE
from baselines.estimation.observer import QUANTUM
from baselines.gains import tuned
from baselines.loops.condition import MarginCondition, believing, least_margins
from baselines.loops.laws import law_of
from baselines.loops.margins import Margins, margins, margins_from_poles
from baselines.loops.models import Loop, System, closed_poles, law_system, loop_at, sampled_arm
from baselines.models.corners import CORNERS, LOOP_FIELDS, corner
from baselines.models.linear import ANGLES
from baselines.optimal.adaptive import AdaptiveController, AdaptiveGains, AdaptiveMemory
from baselines.servo.paper import PaperController, rigid_controller
from beltarm_env import CONTROL_PERIOD, ArmParams, observation, sampled_state_space
from beltarm_env.arrays import Floats
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.ranges import TRAIN_RANGES, design_model

FRICTIONLESS = ArmParams(coulomb_friction=0.0)
LATE = [replace(design_model(), coulomb_friction=0.0, command_latency=k * CONTROL_PERIOD) for k in (0.75, 1.6)]
untuned: Callable[[str], Any] = cache(lambda name: TUNABLE[name]())
usual: Callable[[str], Any] = cache(lambda name: CONTROLLERS[name]())
STEPS = 500
SETTLED = {"adaptive": 2500}
"""Samples after which a filter that begins with doubts has its steady gain, by controller."""
TOLERANCE = {"adaptive": 0.1}
"""Its filter takes derivatives by differences over steps at which the arm is not quite linear, and some of a torque for
what else it identifies."""


def as_control(system: System) -> control.StateSpace:
    return control.StateSpace(system.a, system.b[:, None], system.c[None], system.d, CONTROL_PERIOD)


@cache
def frictionless(name: str, params: ArmParams) -> Any:
    """A controller with its gains that believes in an arm without Coulomb friction, and in a motor without ripple."""
    if name in ("paper", "rigid"):
        return {"paper": PaperController, "rigid": rigid_controller}[name](params)
    if name == "adaptive":
        gains = tuned(name, AdaptiveGains)
        return AdaptiveController(gains, params, replace(gains.uncertainty(), ripple=0.0))
    return TUNABLE[name](tuned(name, TUNABLE[name].gains_type), params=params)


def resting_observation(joint: float, state: Floats, before: float, last_command: float) -> Any:
    """What the environment shows of an arm near rest at an angle, the encoder's resolution and float32 left out."""
    values = dict.fromkeys((entry.name for entry in observation.ENTRIES["encoder"]), 0.0)
    speed = (state[0] - before) / CONTROL_PERIOD
    values |= {"motor_angle_error": 88 * joint - state[0], "motor_speed_error": -speed, "motor_speed": speed}
    values |= {"motor_angle": state[0], "sin_2_motor_angle": math.sin(2 * state[0])}
    values |= {"cos_2_motor_angle": math.cos(2 * state[0])}
    values |= {"reference_angle": joint, "start": joint + (0.5 if joint < 0.8 else -0.5), "goal": joint}
    values |= {"duration": 0.5, "ramp_time": 0.2, "elapsed_time": 0.9, "last_command": last_command / 0.3}
    return np.array([list(values.values())]) / observation.scales()


def responses(name: str, controller: Any, places: tuple[int, ...], pulse: float) -> Floats:
    """What a pulse of torque adds to the angles of motors under the real controller, shape (STEPS, places) [rad].

    The move ended long ago and time stands still, so that the plan is that of a rest. A faint noise keeps the motors
    from standing still, which observers take for sticking, and is too faint for an identification to see how fine the
    encoder is: it is told. Two arms are simulated at each place, of which the first gets the pulse.
    """
    begin, joints = SETTLED.get(name, 300), np.repeat(np.float32(ANGLES[[*places]]), 2).astype(float)
    plant, noise = ArmSimulation(controller.params, len(joints)), np.random.default_rng(0)
    states, pulses = plant.at_rest(88 * joints), pulse * (np.arange(len(joints)) % 2 == 0)
    angles, memory, last = [states[:, 0]], None, np.zeros(len(joints))
    for i in range(begin + STEPS):
        angles.append(states[:, 0])
        seen = [resting_observation(*arm) for arm in zip(joints, states, angles[i], last, strict=True)]
        action, memory = controller.predict(np.concatenate(seen), memory, i == 0)
        if isinstance(memory, AdaptiveMemory):
            memory = replace(memory, belief=memory.belief._replace(counts=np.full(len(joints), QUANTUM)))
        last = action[:, 0].astype(float) * 0.3
        states = plant.advance(states, last + 1e-8 * noise.standard_normal() + (pulses if i == begin else 0.0))
    both = np.array(angles[begin + 1 :])
    return both[:, ::2] - both[:, 1::2]


@pytest.mark.parametrize(
    ("name", "params", "places"),
    [
        *((name, FRICTIONLESS, (0, 45)) for name in CONTROLLERS),
        ("adaptive", replace(FRICTIONLESS, belt_stiffening=0.25), (0, 45)),
        *((name, arm, (k,)) for name in ("ei", "lqg", "preview", "mpc") for arm, k in zip(LATE, (0, 30), strict=True)),
    ],
)
def test_a_controller_responds_to_a_pulse_as_its_linear_loop(name: str, params: ArmParams, places: tuple[int, ...]):
    """Its own `predict`, in closed loop with the environment's arm, ideal and behind a drive."""
    controller, pulse = frictionless(name, params), 1e-6
    for k, motion in zip(places, responses(name, controller, places, pulse).T, strict=True):
        law, arm = as_control(law_system(law_of(controller, k))), as_control(sampled_arm(params, ANGLES[k]))
        closed: Any = control.feedback(arm, cast("Any", law), sign=1)
        torques = np.where(np.arange(len(motion)) == 0, pulse, 0.0)
        expected = np.asarray(closed.forced_response(inputs=torques).outputs)
        assert np.abs(motion - expected).max() < TOLERANCE.get(name, 1e-4) * np.abs(expected).max(), k


def test_a_subclass_does_not_get_the_law_of_its_class():
    another = type("Another", (TUNABLE["flat"],), {})
    refused(ValueError, ("Another", "LAWS"), lambda: law_of(another(), 20))


@pytest.mark.parametrize("name", CONTROLLERS)
class TestMargins:
    def test_are_those_of_the_frequency_response(self, name: str):
        loop = loop_at(usual(name), 30, CORNERS["payload, soft" if name != "paper" else "stiff"])
        actual, turns = margins(loop), np.geomspace(1e-4, 0.9999 * math.pi, 8000)
        law, plant = (np.asarray(as_control(each)(np.exp(1j * turns))) for each in loop)
        values = -law * plant
        assert actual.modulus == pytest.approx(np.abs(1 + values).min(), rel=2e-3)
        crossed = np.flatnonzero(np.diff(np.sign(np.abs(values) - 1)))
        lag, at = np.unwrap(np.angle(-values)), turns
        share = (np.abs(values) - 1)[crossed] / -np.diff(np.abs(values))[crossed]
        lag, at = (part[crossed] + share * np.diff(part)[crossed] for part in (lag, at))
        phase = np.degrees(np.abs((lag + math.pi) % (2 * math.pi) - math.pi).min())
        assert actual.phase == pytest.approx(phase, rel=2e-3)
        assert actual.delay == pytest.approx((lag % (2 * math.pi) / at).min(), rel=2e-3)

    @pytest.mark.parametrize("k", [0, 27, 45])
    def test_poles_cross_the_unit_circle_at_the_margins(self, name: str, k: int):
        loop = loop_at(usual(name), k)
        actual = margins(loop)
        (up,), (down,) = actual.gain_up, actual.gain_down
        inside = np.geomspace(max(down * 1.001, 1e-3), min(up * 0.999, 1e3), 12)
        assert actual.stable and all(np.abs(closed_poles(loop, float(gain))).max() < 1 for gain in inside)
        assert up > 1e3 or np.abs(closed_poles(loop, up * 1.001)).max() >= 1
        assert down < 1e-3 or np.abs(closed_poles(loop, down * 0.999)).max() >= 1


def test_margins_that_are_known_in_closed_form():
    def first_order(pole: float, gain: float) -> Margins:
        return margins_from_poles(np.array([[complex(pole)]]), np.array([[complex(pole - gain)]]))

    # L = g / (z - 1): |L| = 1 at w with 2 sin(w / 2) = g, phase -90 degrees - w / 2; at Nyquist L = -g / 2.
    w, integrator = 2 * math.asin(0.4 / 2), first_order(1.0, 0.4)
    assert integrator.gain_up == pytest.approx(2 / 0.4, rel=1e-9) and integrator.gain_down == 0
    assert np.ravel(integrator[3:5]) == pytest.approx([90 - math.degrees(w / 2), (math.pi / 2 - w / 2) / w], rel=1e-9)
    # z - 1.2 + g: stable for 0.2 < g < 2.2; |1 + L| = |z - 0.7| / |z - 1.2| is monotonic between z = 1 and -1.
    unstable_alone, unstable = first_order(1.2, 0.5), first_order(1.2, 0.1)
    assert not unstable.stable and np.isnan([*unstable[1:]]).all()
    assert np.ravel(unstable_alone[1:3]) == pytest.approx([2.2 / 0.5, 0.2 / 0.5], rel=1e-6)
    assert unstable_alone.modulus == pytest.approx(1.7 / 2.2, rel=1e-6)
    assert not first_order(1.0, 2.1).stable
    # A pair +-i that is halved, |1 + L| = |z^2 + 1/4| / |z^2 + 1|: infinite at +-i, least at +-1.
    pair: Any = np.exp([[0.5j * math.pi, -0.5j * math.pi]])
    assert margins_from_poles(pair, 0.5 * pair).modulus == pytest.approx(0.625, rel=1e-9)


def delayed(system: System, samples: int) -> System:
    """A system whose input arrives a number of whole samples late."""
    if samples == 0:
        return system
    size, c = len(system.a), np.pad(system.c, (0, samples))
    a, b = np.zeros((size + samples, size + samples)), np.zeros(size + samples)
    a[:size, :size], a[size + 1 :, size:-1] = system.a, np.eye(samples)[1:, 1:]
    a[:size, -1], c[-1], b[size] = system.b, system.d, 1.0
    return System(a, b, c, 0.0)


def late_arm(params: ArmParams, theta_1: float, samples: float) -> System:
    """The arm at a joint angle [rad] with its command later by any number of samples, exactly sampled."""
    total = params.command_latency / CONTROL_PERIOD + samples
    part = replace(params, command_latency=(total - math.floor(total)) * CONTROL_PERIOD)
    return delayed(sampled_arm(part, theta_1), math.floor(total))


@pytest.mark.parametrize(("arm", "k"), [("design model", 0), ("stiff", 20), ("payload, soft", 45)])
@pytest.mark.parametrize("name", TUNABLE)
def test_a_loop_bears_its_delay_margin_and_no_more(name: str, arm: str, k: int):
    actual, law = margins(loop_at(untuned(name), k, CORNERS[arm])), law_system(law_of(untuned(name), k))
    assert actual.stable
    for share in (0.0, 0.3, 0.6, 0.95, 1.05):
        late = late_arm(CORNERS[arm], float(ANGLES[k]), share * actual.delay[0])
        assert (np.abs(closed_poles(Loop(law, late))).max() < 1) == (share < 1)


def test_many_loops_at_once_have_the_margins_of_each():
    loops = [loop_at(untuned(name), k, CORNERS[arm]) for name in ("ei", "lqg") for k in (0, 45) for arm in CORNERS]
    alone = np.hstack([np.array(margins(loop), float) for loop in loops])
    np.testing.assert_allclose(np.array(margins(*loops), float), alone, rtol=1e-6)


class TestCorners:
    def test_no_other_constant_of_the_ranges_touches_the_loop(self):
        for field in set(TRAIN_RANGES) - set(LOOP_FIELDS):
            other = replace(design_model(), **{field: TRAIN_RANGES[field][1]})
            assert all(map(np.array_equal, *(sampled_state_space(arm, 0.7) for arm in (design_model(), other)))), field

    @pytest.mark.slow
    @pytest.mark.parametrize("name", ["ei", "disturbance", "preview"])
    def test_they_hold_nearly_the_worst_of_all_2048_corners(self, name: str):
        angles, chosen = (0, 12, 24, 36, 45), itertools.product((0, 1), repeat=len(LOOP_FIELDS))
        every = [corner(*itertools.compress(LOOP_FIELDS, high)) for high in chosen]
        laws, least = {k: law_system(law_of(untuned(name), k)) for k in angles}, []
        for arms in (CORNERS.values(), every):
            loops = [Loop(laws[k], sampled_arm(arm, float(ANGLES[k]))) for arm in arms for k in angles]
            actual = margins(*loops)
            least.append((actual.modulus.min(), actual.delay.min()))
            assert actual.stable.all()
        assert least[1][0] <= least[0][0] < least[1][0] + 0.08
        assert least[1][1] <= least[0][1] < 1.2 * least[1][1]

    def test_an_arm_that_is_identified_is_believed_in(self):
        controller = AdaptiveController()
        assert controller.params == design_model()
        for arm in CORNERS.values():
            believed = replace(believing(controller, arm).params, belt_damping_ratio=arm.belt_damping_ratio)
            moved = [sampled_arm(each, 0.3) for each in (arm, believed)]  # by the torque that is commanded
            angles = [[each.c @ np.linalg.matrix_power(each.a, k) @ each.b for k in range(60)] for each in moved]
            np.testing.assert_allclose(angles[1], angles[0], rtol=1e-4)


class TestCondition:
    @pytest.mark.parametrize("name", TUNABLE)
    def test_untuned_and_tuned_gains_meet_it(self, name: str):
        assert all(MarginCondition().shortfall(made(name)) == 0 for made in (untuned, usual))

    def test_what_is_asked_for_is_what_is_met(self):
        controller = untuned("ei")
        least = least_margins(controller)
        assert MarginCondition(modulus=least.modulus * 0.999, delay=0.1).shortfall(controller) == 0
        assert MarginCondition(modulus=least.modulus * 1.01, delay=0.1).shortfall(controller) > 0
        assert MarginCondition(modulus=0.1, delay=least.delay * 1.01).shortfall(controller) > 0
