"""Bad input of the environments: refused by an exception that names the value and what is allowed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from refusals import refused

from baselines.servo.flat import FlatGains
from baselines.servo.paper import PaperGains
from baselines.tools.schema import NUMBER, check, object_of
from beltarm_env import EPISODE_STEPS, ArmParams, BeltArmEnv, BeltArmVectorEnv, observation, state_space
from beltarm_env.rollout import rollout

NAN, INF = math.nan, math.inf
Refusal = tuple[dict[str, Any], type[Exception], tuple[str, ...]]


# Arguments of the environments


SETTINGS: list[Refusal] = [
    ({"sensors": "sonar"}, ValueError, ("sensors", "'sonar'", "'encoder'", "'tip'", "'full'")),
    ({"sensors": None}, ValueError, ("sensors", "None", "'encoder'")),
    ({"sensors": ["tip"]}, ValueError, ("sensors", "['tip']", "'encoder'")),
    ({"profile": "sine"}, ValueError, ("profile", "'sine'", "'trapezoid'", "'scurve'", "'quintic'")),
    ({"model": "rigid"}, ValueError, ("model", "'rigid'", "'lumped'")),
    ({"randomization": "test"}, ValueError, ("randomization", "'test'", "'off'", "'train'")),
    ({"randomization": None}, TypeError, ("randomization", "None", "mapping")),
    ({"randomization": [("payload_mass", 1)]}, TypeError, ("randomization", "payload_mass", "mapping")),
    ({"randomization": {"mass": (0, 1)}}, ValueError, ("randomization", "'mass'", "payload_mass")),
    ({"randomization": {"payload_mass": (0.2, 0.1)}}, ValueError, ("payload_mass", "0.2", "0.1", "low", "high")),
    ({"randomization": {"payload_mass": (0.0, NAN)}}, ValueError, ("payload_mass", "nan", "finite")),
    ({"randomization": {"payload_mass": (0.0, INF)}}, ValueError, ("payload_mass", "inf", "finite")),
    ({"randomization": {"payload_mass": (-0.1, 0.1)}}, ValueError, ("payload_mass", "-0.1", "not negative")),
    ({"randomization": {"belt_stiffness": (0, 30)}}, ValueError, ("belt_stiffness", "0", "positive")),
    ({"randomization": {"payload_mass": 0.1}}, TypeError, ("payload_mass", "0.1", "pair")),
    ({"randomization": {"payload_mass": (0.1,)}}, TypeError, ("payload_mass", "(0.1,)", "pair")),
    ({"randomization": {"payload_mass": ("a", "b")}}, TypeError, ("payload_mass", "'a'", "number")),
    ({"randomization": {"belt_stiffness": (30, 1e9)}}, ValueError, ("rad/s", "belt_stiffness", "at most")),
    ({"encoder_counts": 0}, ValueError, ("encoder_counts", "0", "from 1")),
    ({"encoder_counts": -4000}, ValueError, ("encoder_counts", "-4000", "from 1")),
    ({"encoder_counts": 1000.5}, ValueError, ("encoder_counts", "1000.5", "whole")),
    ({"encoder_counts": True}, ValueError, ("encoder_counts", "True", "whole")),
    ({"encoder_counts": "4000"}, ValueError, ("encoder_counts", "'4000'", "whole")),
    ({"encoder_counts": 10**12}, ValueError, ("encoder_counts", "1000000000000", "to 10000000")),
    ({"delay": -1}, ValueError, ("delay", "-1", "from 0 to 2")),
    ({"delay": -1e-9}, ValueError, ("delay", "-1e-09", "from 0 to 2")),
    ({"delay": 2.5}, ValueError, ("delay", "2.5", "from 0 to 2")),
    ({"delay": True}, ValueError, ("delay", "True", "number")),
    ({"delay": NAN}, ValueError, ("delay", "nan", "from 0 to 2")),
    ({"delay": "one"}, ValueError, ("delay", "'one'", "number")),
    ({"delay": None}, ValueError, ("delay", "None", "number")),
    ({"delay": [[1.0]]}, ValueError, ("delay", "(1,)", "(1, 1)")),
    ({"delay": [1.0, [2.0]]}, ValueError, ("delay", "number")),
    ({"render_mode": "ansi"}, ValueError, ("render_mode", "'ansi'", "rgb_array")),
]


@pytest.mark.parametrize("make", [BeltArmEnv, BeltArmVectorEnv])
@pytest.mark.parametrize(("arguments", "error", "words"), SETTINGS, ids=str)
def test_arguments(make: Callable[..., Any], arguments: dict[str, Any], error: type[Exception], words: tuple[str, ...]):
    refused(error, words, lambda: make(**arguments))


@pytest.mark.parametrize(
    ("delay", "words"),
    [
        ([0.0, 1.0], ("one number", "(3,)", "(2,)")),
        ([0.0, 1.0, 2.1], ("from 0 to 2", "2.1", "arm 2")),
        ([0.0, NAN, 2.0], ("from 0 to 2", "nan", "arm 1")),
        (np.zeros((3, 1)), ("one number", "(3,)", "(3, 1)")),
    ],
    ids=str,
)
def test_delays_of_a_batch(delay: Any, words: tuple[str, ...]):
    refused(ValueError, ("delay", *words), lambda: BeltArmVectorEnv(3, delay=delay))


def test_arguments_through_make():
    refused(ValueError, ("'sonar'", "'tip'"), lambda: gym.make("BeltArm-v0", sensors="sonar"))
    refused(ValueError, ("'sonar'", "'tip'"), lambda: gym.make_vec("BeltArm-v0", num_envs=2, sensors="sonar"))
    with pytest.raises(TypeError, match="sensor"):
        gym.make("BeltArm-v0", sensor="tip")


@pytest.mark.parametrize("num_envs", [0, -3, True, 2.0, "4", None])
def test_number_of_arms(num_envs: Any):
    words = ("num_envs", repr(num_envs), "at least 1")
    refused(ValueError, words, lambda: BeltArmVectorEnv(num_envs))
    refused(ValueError, words, lambda: gym.make_vec("BeltArm-v0", num_envs=num_envs))


def test_autoreset_mode():
    refused(ValueError, ("sometimes",), lambda: BeltArmVectorEnv(2, autoreset_mode="sometimes"))


# Parameters


FIELD_NAMES = [field.name for field in fields(ArmParams)]
MAY_BE_ZERO = {
    "motor_viscous_friction",
    "coulomb_friction",
    "hand_length",
    "arm_inertia_swing",
    "payload_mass",
    "belt_damping_ratio",
    "torque_ripple",
}
BOUNDED = {
    "current_loop_time_constant": (0.0, 0.01),
    "command_latency": (0.0, 0.0045),
    "torque_constant_error": (-0.5, 0.5),
    "static_friction_excess": (0.0, 5.0),
    "stribeck_speed": (0.1, 1000.0),
    "friction_variation": (0.0, 0.9),
    "friction_variation_phase": (0.0, 2 * math.pi),
    "torque_ripple_order": (1.0, 100.0),
    "torque_ripple_phase": (0.0, 2 * math.pi),
    "kinematic_error": (0.0, 0.01),
    "kinematic_error_phase": (0.0, 2 * math.pi),
    "belt_stiffening": (0.0, 0.9),
    "belt_stiffening_torsion": (1e-4, 1.0),
    "friction_drift": (-0.5, 0.5),
}


@pytest.mark.parametrize("value", [NAN, INF, -INF, -1e-9, np.float32("nan"), -3])
@pytest.mark.parametrize("name", FIELD_NAMES)
def test_parameters_that_make_no_arm(name: str, value: float):
    if name in BOUNDED:
        low, high = BOUNDED[name]
        value = value if not low <= value <= high else high + 1
        refused(ValueError, (name, repr(value), "finite", f"{low:g}", f"{high:g}"), lambda: ArmParams(**{name: value}))
        return
    allowed = "not negative" if name in MAY_BE_ZERO else "positive"
    refused(ValueError, (name, repr(value), "finite", allowed), lambda: ArmParams(**{name: value}))


@pytest.mark.parametrize("value", [10**400, -(10**400), -(10**5000)], ids=["huge", "hugely negative", "beyond print"])
def test_whole_numbers_that_no_float_can_hold(value: int):
    refused(ValueError, ("ArmParams.belt_stiffness", "finite"), lambda: ArmParams(belt_stiffness=value))
    stiff, there = {"params": {"belt_stiffness": value}}, {"move": {"goal": [1.0, value]}}
    refused(ValueError, ("belt_stiffness", "finite"), lambda: BeltArmEnv().reset(options=stiff))
    refused(ValueError, ("goal", "finite"), lambda: BeltArmVectorEnv(2).reset(options=there))
    refused(ValueError, ("state", "finite"), lambda: BeltArmEnv().reset(options={"state": [0, 0, value, 0]}))
    if abs(value) > 10**4000:  # which Python does not print
        return
    refused(ValueError, ("FlatGains.rest_width", "must lie within"), lambda: FlatGains(rest_width=value))
    refused(ValueError, ("PaperGains.angle", "must be finite"), lambda: PaperGains(angle=value))
    refused(
        ValueError, ("entry must be a finite number",), lambda: check({"entry": value}, "", object_of(entry=NUMBER))
    )


def test_a_ripple_has_whole_periods_per_turn():
    refused(ValueError, ("torque_ripple_order", "2.5", "whole"), lambda: ArmParams(torque_ripple_order=2.5))


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"kinematic_error": 0.0055}, ("kinematic_error", "0.0055", "0.00517")),
        (
            {"static_friction_excess": 1.0, "stribeck_speed": 0.1, "motor_inertia": 1e-6},
            ("stribeck_speed", "0.1", "5000", "raise"),
        ),
        ({"belt_stiffening": 0.9, "belt_stiffness": 1.5e8}, ("fastest rate", "belt_stiffness")),
    ],
)
def test_drives_that_cannot_be_integrated(params: dict[str, float], words: tuple[str, ...]):
    refused(ValueError, words, lambda: BeltArmEnv().reset(options={"params": params}))
    ranges = {name: (value, value) for name, value in params.items()}
    refused(ValueError, words, lambda: BeltArmEnv(randomization=ranges))


@pytest.mark.parametrize("name", FIELD_NAMES)
def test_zero_is_refused_where_it_makes_no_arm(name: str):
    if name in MAY_BE_ZERO or (name in BOUNDED and BOUNDED[name][0] <= 0):
        assert getattr(ArmParams(**{name: 0}), name) == 0
    else:
        refused(ValueError, (name, "0", "within" if name in BOUNDED else "positive"), lambda: ArmParams(**{name: 0}))


@pytest.mark.parametrize("value", ["1", None, True, 1j, [1.0], np.ones(1)], ids=repr)
@pytest.mark.parametrize("name", ["gear_ratio", "payload_mass"])
def test_parameters_of_a_wrong_type(name: str, value: Any):
    refused(TypeError, (name, "number", repr(value)), lambda: ArmParams(**{name: value}))


def test_unknown_parameter():
    with pytest.raises(TypeError, match="mass"):
        ArmParams(mass=1.0)  # pyright: ignore[reportCallIssue]


@pytest.mark.parametrize("angle", [-0.1, 1.6, NAN])
def test_joint_angle_of_the_linear_model(angle: float):
    refused(ValueError, ("theta_1", repr(angle), "pi/2"), lambda: state_space(ArmParams(), angle))


# Options of reset


OPTIONS: list[Refusal] = [
    ({"payload": 0.1}, ValueError, ("'payload'", "params", "move", "state")),
    ({"params": {"mass": 0.1}}, ValueError, ("params", "'mass'", "payload_mass")),
    ({"params": 0.1}, TypeError, ("params", "0.1", "mapping")),
    ({"params": {"payload_mass": -0.1}}, ValueError, ("payload_mass", "-0.1", "not negative")),
    ({"params": {"payload_mass": NAN}}, ValueError, ("payload_mass", "nan", "finite")),
    ({"params": {"belt_stiffness": 0}}, ValueError, ("belt_stiffness", "0", "positive")),
    ({"params": {"belt_stiffness": 1e9}}, ValueError, ("rad/s", "belt_stiffness", "at most")),
    ({"params": {"payload_mass": "heavy"}}, TypeError, ("payload_mass", "'heavy'", "number")),
    ({"params": {"payload_mass": "0.1"}}, TypeError, ("payload_mass", "'0.1'", "number")),
    ({"params": {"payload_mass": True}}, TypeError, ("payload_mass", "True", "number")),
    ({"params": {"payload_mass": None}}, TypeError, ("payload_mass", "None", "number")),
    ({"params": {"payload_mass": [0.1] * 7}}, ValueError, ("payload_mass", "(7,)", "one number")),
    ({"params": {"payload_mass": [[0.1]]}}, ValueError, ("payload_mass", "(1, 1)", "one number")),
    ({"move": {"speed": 1.0}}, ValueError, ("move", "'speed'", "start", "goal", "duration", "ramp_time")),
    ({"move": [0.1, 1.0]}, TypeError, ("move", "[0.1, 1.0]", "mapping")),
    ({"move": {"start": "0.1"}}, TypeError, ("start", "'0.1'", "number")),
    ({"move": {"start": None}}, TypeError, ("start", "None", "number")),
    ({"move": {"start": -0.1}}, ValueError, ("start", "-0.1", "0 and pi/2")),
    ({"move": {"start": 0.2, "goal": 1.6}}, ValueError, ("goal", "1.6", "0 and pi/2")),
    ({"move": {"start": 0, "goal": 90}}, ValueError, ("goal", "90", "0 and pi/2 rad")),
    ({"move": {"start": 0.5, "goal": 0.6}}, ValueError, ("start=0.5", "goal=0.6", "at least 0.26", "15 degrees")),
    ({"move": {"start": 0.5, "goal": 0.5}}, ValueError, ("start=0.5", "goal=0.5", "at least 0.26")),
    (
        {"move": {"start": 0, "goal": 1.5, "duration": 0.5, "ramp_time": 0.1}},
        ValueError,
        ("infeasible", "goal=1.5", "duration=0.5", "N m", "80%", "0.240 N m", "allow"),
    ),
    (
        {"move": {"start": 0, "goal": 1.5, "duration": 1.2, "ramp_time": 0.001}},
        ValueError,
        ("infeasible", "ramp_time=0.001", "N m", "80%"),
    ),
    ({"move": {"duration": 0}}, ValueError, ("duration", "duration=0,", "positive", "1.5 s")),
    ({"move": {"duration": -1.0}}, ValueError, ("duration=-1", "positive", "1.5 s")),
    ({"move": {"duration": 1.6}}, ValueError, ("duration=1.6", "at most 1.5 s")),
    ({"move": {"ramp_time": 0}}, ValueError, ("ramp_time=0", "positive", "half the duration")),
    ({"move": {"ramp_time": -0.1}}, ValueError, ("ramp_time=-0.1", "positive")),
    ({"move": {"duration": 1.0, "ramp_time": 0.6}}, ValueError, ("ramp_time=0.6", "half the duration")),
    *(
        ({"move": {name: value}}, ValueError, (name, str(value), "finite"))
        for name in ("start", "goal", "duration", "ramp_time")
        for value in (NAN, INF, -INF)
    ),
    ({"state": [1.0, 2.0, 3.0]}, ValueError, ("state", "(3,)", "(4,)")),
    ({"state": 1.0}, ValueError, ("state", "()", "(4,)")),
    ({"state": [60.0, NAN, 0.0, 0.0]}, ValueError, ("state", "nan", "finite")),
    ({"state": [60.0, 0.0, INF, 0.0]}, ValueError, ("state", "inf", "finite")),
    ({"state": "at rest"}, TypeError, ("state", "'at rest'", "number")),
    ({"state": ["1", "2", "3", "4"]}, TypeError, ("state", "'1'", "number")),
    ({"state": {"motor_angle": 1.0}}, TypeError, ("state", "motor_angle", "number")),
]


@pytest.mark.parametrize("make", [BeltArmEnv, lambda: BeltArmVectorEnv(3)], ids=["one", "three"])
@pytest.mark.parametrize(("options", "error", "words"), OPTIONS, ids=str)
def test_options(make: Callable[[], Any], options: dict[str, Any], error: type[Exception], words: tuple[str, ...]):
    env = make()
    refused(error, words, lambda: env.reset(seed=0, options=options))


@pytest.mark.parametrize("options", ["params", ["params"], 3])
@pytest.mark.parametrize("make", [BeltArmEnv, lambda: BeltArmVectorEnv(3)], ids=["one", "three"])
def test_options_that_are_no_mapping(make: Callable[[], Any], options: Any):
    env = make()
    refused(TypeError, ("options", "mapping", repr(options)), lambda: env.reset(options=options))


def test_one_bad_value_among_many_arms():
    envs = BeltArmVectorEnv(3)
    options = {"params": {"payload_mass": [0.1, -0.2, 0.1]}}
    refused(ValueError, ("payload_mass", "-0.2"), lambda: envs.reset(options=options))
    refused(ValueError, ("goal=1.7",), lambda: envs.reset(options={"move": {"start": 0.0, "goal": [1.0, 1.7, 1.5]}}))
    refused(ValueError, ("(2,)", "(3,)"), lambda: envs.reset(options={"params": {"payload_mass": [0.1, 0.2]}}))


BAD_RESET = [
    {"params": {"payload_mass": 0.1}, "move": {"goal": 90}},
    {"move": {"goal": 1.0}, "params": {"payload_mass": -1}},
    {"params": {"payload_mass": 0.2}, "state": [NAN] * 4},
]


@pytest.mark.parametrize("options", BAD_RESET, ids=str)
def test_a_refused_reset_leaves_a_running_episode_as_it_was(options: dict[str, Any]):
    env, envs = BeltArmEnv(), BeltArmVectorEnv(2)
    env.reset(seed=0)
    envs.reset(seed=0)
    env.step(np.ones(1, np.float32))
    envs.step(np.ones((2, 1), np.float32))
    before = env.state.tolist(), env.params, env.move, env.time, envs.state.tolist(), envs.params, envs.moves.tolist()
    for reset in (env.reset, envs.reset):
        with pytest.raises(ValueError):
            reset(options=options)
    after = env.state.tolist(), env.params, env.move, env.time, envs.state.tolist(), envs.params, envs.moves.tolist()
    assert after == before
    env.step(np.ones(1, np.float32))
    envs.step(np.ones((2, 1), np.float32))


@pytest.mark.parametrize("options", BAD_RESET, ids=str)
def test_a_refused_reset_leaves_random_streams_as_they_were(options: dict[str, Any]):
    envs, others = BeltArmVectorEnv(2), BeltArmVectorEnv(2)
    for each in (envs, others):
        each.reset(seed=0)
    for seed in (None, 7, [8, None]):
        with pytest.raises(ValueError):
            envs.reset(seed=seed, options=options)
    assert envs.reset()[0].tobytes() == others.reset()[0].tobytes()
    assert envs.params == others.params


@pytest.mark.parametrize("mask", [[True, False, True], np.ones(2, np.bool_), np.ones(3), True, None], ids=repr)
def test_reset_mask(mask: Any):
    envs = BeltArmVectorEnv(3)
    envs.reset(seed=0)
    words = ("reset_mask", "bool", "(3,)", repr(mask))
    refused((ValueError, TypeError), words, lambda: envs.reset(options={"reset_mask": mask}))


def test_reset_mask_that_chooses_none():
    envs = BeltArmVectorEnv(3)
    envs.reset(seed=0)
    mask = np.zeros(3, np.bool_)
    refused(ValueError, ("reset_mask", "at least one"), lambda: envs.reset(options={"reset_mask": mask}))


def test_number_of_seeds():
    refused(ValueError, ("seed", "3", "2"), lambda: BeltArmVectorEnv(3).reset(seed=[1, 2]))


# Steps


@pytest.mark.parametrize("options", [None, *BAD_RESET], ids=str)
def test_steps_before_a_reset_that_worked(options: dict[str, Any] | None):
    env, envs = BeltArmEnv(), BeltArmVectorEnv(2)
    if options is not None:
        with pytest.raises(ValueError):
            env.reset(seed=0, options=options)
        with pytest.raises(ValueError):
            envs.reset(seed=0, options=options)
    refused(ResetNeeded, ("reset()",), lambda: env.step(np.zeros(1, np.float32)))
    refused(ResetNeeded, ("reset()",), lambda: envs.step(np.zeros((2, 1), np.float32)))
    mask = {"reset_mask": np.array([True, False])}
    refused(ResetNeeded, ("reset()",), lambda: envs.reset(options=mask))


def test_steps_after_the_end():
    env = BeltArmEnv()
    env.reset(seed=0)
    for _ in range(EPISODE_STEPS):
        env.step(np.zeros(1, np.float32))
    refused(ResetNeeded, ("reset()",), lambda: env.step(np.zeros(1, np.float32)))


@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_actions_that_are_not_finite(kind: Any, value: float):
    env = BeltArmEnv()
    env.reset(seed=0)
    refused(ValueError, ("action", "finite", str(value)), lambda: env.step(np.array([value], kind)))
    envs = BeltArmVectorEnv(3)
    envs.reset(seed=0)
    actions = np.array([[0.0], [0.0], [value]], kind)
    refused(ValueError, ("actions", "finite", str(value), "arm 2"), lambda: envs.step(actions))


ODD_ACTIONS: list[Any] = [
    None,
    0.5,
    "0.5",
    "5",
    b"5",
    ["0.5"],
    np.array(["0.5"]),
    [1j],
    [],
    [0.1, 0.2],
    np.zeros((1, 1), np.float32),
    np.float32(0.5),
    np.array(0.5),
]


@pytest.mark.parametrize("action", ODD_ACTIONS, ids=repr)
def test_actions_of_another_shape_or_type(action: Any):
    env = BeltArmEnv()
    env.reset(seed=0)
    refused(ValueError, ("action", "(1,)", repr(action)), lambda: env.step(action))


ODD_BATCHES: list[Any] = [
    None,
    "0.5",
    0.5,
    np.zeros(3),
    np.zeros((2, 1)),
    np.zeros((4, 1)),
    np.zeros((3, 2)),
    np.zeros((3, 1, 1)),
    np.full((3, 1), "0.5"),
    np.full((3, 1), None),
    np.zeros((3, 1), np.complex128),
]


@pytest.mark.parametrize("actions", ODD_BATCHES, ids=repr)
def test_batches_of_actions_of_another_shape_or_type(actions: Any):
    envs = BeltArmVectorEnv(3)
    envs.reset(seed=0)
    array = np.asarray(actions)
    refused(ValueError, ("actions", "(3, 1)", str(array.shape), str(array.dtype)), lambda: envs.step(actions))


def test_a_refused_action_leaves_the_arms_as_they_were():
    env, envs = BeltArmEnv(), BeltArmVectorEnv(2)
    env.reset(seed=0)
    envs.reset(seed=0)
    before = env.state, envs.state
    with pytest.raises(ValueError):
        env.step(np.array([NAN]))
    with pytest.raises(ValueError):
        envs.step(np.array([[1.0], [NAN]]))
    assert env.time == 0
    assert np.array_equal(before[0], env.state) and np.array_equal(before[1], envs.state)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_bad_actions_are_refused_even_for_an_arm_about_to_restart(mode: str):
    envs = BeltArmVectorEnv(2, autoreset_mode=mode)
    envs.reset(seed=0)
    over = np.zeros(2, np.bool_)
    while not over.any():
        over = envs.step(np.array([[0.0], [1.0]]))[2]
    refused(ValueError, ("nan", "arm 1"), lambda: envs.step(np.array([[0.0], [NAN]])))


# Observations and rollouts


def test_observations_of_another_size():
    words = ("'tip'", str(observation.size("tip")), "(3, 5)")
    refused(ValueError, words, lambda: observation.decode(np.zeros((3, 5), np.float32), "tip"))
    refused(ValueError, ("'torsion'", "'encoder'", "motor_speed"), lambda: observation.index("torsion"))


class Constant:
    """A controller that always returns the same, whatever that is."""

    def __init__(self, action: Any) -> None:
        self.action = action

    def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True):
        return self.action, None


@pytest.mark.parametrize(
    ("action", "words"),
    [(np.full((2, 1), NAN, np.float32), ("nan", "finite")), (np.zeros((2, 2), np.float32), ("(2, 2)", "(2, 1)"))],
    ids=["NaN", "shape"],
)
def test_controllers_that_return_something_else(action: Any, words: tuple[str, ...]):
    refused(ValueError, words, lambda: rollout(Constant(action), 2, seed=0))


@pytest.mark.parametrize(
    ("controller", "got"),
    [
        ("paper", "the name 'paper': baselines.CONTROLLERS['paper']() makes a classical one of that name"),
        (Constant, "the class Constant: Constant() makes one"),
        (None, "None"),
        (tuple(range(1000)), "(0, 1, 2, 3, 4, 5, ...)"),
    ],
    ids=["name", "class", "None", "long"],
)
def test_a_rollout_wants_a_controller(controller: Any, got: str):
    wanted = "a controller is an object with a method predict (see beltarm_env.rollout.Controller), got "
    with pytest.raises(TypeError) as caught:
        rollout(controller, 5)
    assert str(caught.value) == wanted + got
