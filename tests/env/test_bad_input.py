"""Bad input of the environments: refused by an exception that names the value and its option."""

import math
from collections.abc import Callable
from itertools import product
from typing import Any, cast
from unittest.mock import Mock

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from refusals import refused

from baselines import CONTROLLERS
from beltarm_env import ArmParams, BeltArmEnv, BeltArmVectorEnv, observation
from beltarm_env.arm import bounds_of
from beltarm_env.rollout import record, rollout
from beltarm_env.simulation import ArmSimulation
from beltarm_env.task.moves import MOVE_FIELDS

NAN, INF, HUGE = math.nan, math.inf, 10**400
Refusal = tuple[dict[str, Any], type[Exception], tuple[str, ...]]


def three(**arguments: Any) -> BeltArmVectorEnv:
    return BeltArmVectorEnv(3, **arguments)


MAKERS = {"one": BeltArmEnv, "three": three}
EITHER = pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)


def each(common: list[Refusal], of_a_batch: list[Refusal]) -> Any:
    """Parametrise with what one arm and a batch refuse, and with what only a batch is told."""
    cases = [(make, *row) for make in MAKERS.values() for row in common] + [(three, *row) for row in of_a_batch]
    named = [f"{make.__name__}-{given}" for make, given, *_ in cases]
    return pytest.mark.parametrize(("make", "given", "error", "words"), cases, ids=named)


SETTINGS: list[Refusal] = [
    ({"sensors": "sonar"}, ValueError, ("sensors", "'sonar'", "'encoder'", "'tip'", "'full'")),
    ({"profile": "sine"}, ValueError, ("profile", "'sine'", "'trapezoid'", "'scurve'", "'quintic'")),
    ({"model": "rigid"}, ValueError, ("model", "'rigid'", "'lumped'")),
    ({"randomization": "test"}, ValueError, ("randomization", "'test'", "'off'", "'train'")),
    ({"randomization": [("payload_mass", 1)]}, TypeError, ("randomization", "payload_mass", "mapping")),
    ({"randomization": {"mass": (0, 1)}}, ValueError, ("randomization", "'mass'", "payload_mass")),
    ({"randomization": {"payload_mass": (0.2, 0.1)}}, ValueError, ("payload_mass", "0.2", "0.1", "low", "high")),
    ({"randomization": {"payload_mass": (-0.1, 0.1)}}, ValueError, ("payload_mass", "-0.1", "not negative")),
    ({"randomization": {"payload_mass": (0.1,)}}, TypeError, ("payload_mass", "(0.1,)", "pair")),
    ({"randomization": {"payload_mass": ("a", "b")}}, TypeError, ("payload_mass", "'a'", "number")),
    ({"randomization": {"belt_stiffness": (30, 1e9)}}, ValueError, ("rad/s", "belt_stiffness", "at most")),
    *(({"encoder_counts": n}, ValueError, ("encoder_counts", repr(n))) for n in (0, 1000.5, True, "4000", 10**12)),
    *(({"moves": n}, ValueError, ("moves", repr(n), "1 to 1000")) for n in (0, 1001, 2.5, True, "3")),
    *(({"delay": value}, ValueError, ("delay", repr(value), "from 0 to 2")) for value in (-1e-9, 2.5, NAN)),
    *(({"delay": value}, ValueError, ("delay", repr(value), "number")) for value in (True, "one", None)),
    ({"delay": [[1.0]]}, ValueError, ("delay", "(1, 1)")),
    ({"delay": [1.0, [2.0]]}, ValueError, ("delay", "number")),
    ({"render_mode": "ansi"}, ValueError, ("render_mode", "'ansi'", "rgb_array")),
]
BATCH_SETTINGS: list[Refusal] = [
    ({"delay": [0.0, 1.0]}, ValueError, ("delay", "(3,)", "(2,)")),
    ({"delay": [0.0, 1.0, 2.1]}, ValueError, ("delay", "2.1", "arm 2")),
    ({"autoreset_mode": "sometimes"}, ValueError, ("sometimes",)),
    *(({"num_threads": value}, ValueError, ("num_threads", repr(value), "1 to 256")) for value in (0, 257, True, "2")),
    *(({"max_episode_steps": n}, ValueError, ("max_episode_steps", repr(n))) for n in (0, 1201, 2.5, True, "100")),
    ({"moves": 3, "max_episode_steps": 3601}, ValueError, ("3600", "3601")),
]


@each(SETTINGS, BATCH_SETTINGS)
def test_arguments(make: Callable[..., Any], given: dict[str, Any], error: type[Exception], words: tuple[str, ...]):
    refused(error, words, lambda: make(**given))


def test_arguments_through_make():
    refused(ValueError, ("'sonar'", "'tip'"), lambda: gym.make("BeltArm-v0", sensors="sonar"))
    refused(TypeError, ("sensor",), lambda: gym.make("BeltArm-v0", sensor="tip"))
    wrong: list[Any] = [0, -3, True, 2.0, "4", None]
    for n in wrong:
        refused(ValueError, ("num_envs", repr(n)), lambda n=n: gym.make_vec("BeltArm-v0", num_envs=n))
    for n in (*wrong[:4], 401):
        refused(ValueError, ("steps", "1 to 400", repr(n)), lambda n=n: BeltArmEnv().set_integration_steps(n))
    refused(ResetNeeded, ("reset()",), lambda: BeltArmEnv().set_integration_steps(4))


def test_parameters_that_make_no_arm():
    for name in ArmParams.__slots__:
        low, high, above, _ = bounds_of(name)
        wrong: Any = (NAN, INF, -INF, np.float32("nan"), low - 1e-9, 2 * high + 1, low if above else NAN)
        for value in wrong:
            words = (name, repr(value), "finite")
            refused(ValueError, words, lambda name=name, value=value: ArmParams(**{name: value}))
        assert above or getattr(ArmParams(**{name: low}), name) == low
    wrong = ["1", None, True, 1j, [1.0], np.ones(1)]
    for value in wrong:
        refused(TypeError, ("gear_ratio", "number", repr(value)), lambda value=value: ArmParams(gear_ratio=value))
    with pytest.raises(TypeError, match="mass"):
        ArmParams(mass=1.0)  # pyright: ignore[reportCallIssue]
    refused(ValueError, ("belt_stiffness", "finite"), lambda: ArmParams(belt_stiffness=-(10**5000)))


GAINS_ENERGY = {"static_friction_excess": 1.2, "friction_variation": 0.9, "presliding_deflection": 0.1}
FAST_STRIBECK = {"static_friction_excess": 1.0, "stribeck_speed": 0.1, "motor_inertia": 1e-6}
DRIVES = [
    ({"kinematic_error": 0.0055}, ("kinematic_error", "0.0055", "0.00517")),
    (FAST_STRIBECK, ("stribeck_speed", "0.1", "5000", "raise")),
    ({"belt_stiffening": 0.9, "belt_stiffness": 1.5e8}, ("fastest rate", "belt_stiffness")),
    ({"motor_viscous_friction": 1.5, "presliding_deflection": 1e-6}, ("gives by presliding_deflection 1e-06", "raise")),
    ({"torque_ripple": 0.1, "torque_limit": 1e6}, ("ripple", "torque_limit 1e+06", "lower")),
    ({**GAINS_ENERGY, "friction_drift": -0.2}, ("1.05 times the energy", "lower presliding_deflection")),
]


@pytest.mark.parametrize(("params", "words"), DRIVES)
def test_drives_that_cannot_be_integrated(params: dict[str, float], words: tuple[str, ...]):
    refused(ValueError, words, lambda: BeltArmEnv().reset(options={"params": params}))
    ranges = {name: (value, value) for name, value in params.items()}
    refused(ValueError, words, lambda: BeltArmEnv(model="lagrangian", randomization=ranges))


SUDDEN = {"start": 0, "duration": 0.5, "ramp_time": 0.1}
NO_MASKS = ([True, False, True], np.ones(2, np.bool_), np.ones(3))
OPTIONS: list[Refusal] = [
    *(({"payload": 0.1}, ValueError, ("'payload'", "params", "move", "state")), ({"params": 0.1}, TypeError, ("0.1",))),
    ({"params": {"mass": 0.1}}, ValueError, ("params", "'mass'", "payload_mass")),
    ({"params": {"payload_mass": -0.1}}, ValueError, ("payload_mass", "-0.1", "not negative")),
    ({"params": {"belt_stiffness": 1e9}}, ValueError, ("rad/s", "belt_stiffness", "at most")),
    ({"params": {"torque_ripple_order": 5.5}}, ValueError, ("torque_ripple_order", "5.5", "whole")),
    *(({"params": {"payload_mass": x}}, TypeError, ("payload_mass", repr(x))) for x in ("0.1", True, None)),
    ({"params": {"payload_mass": [0.1] * 7}}, ValueError, ("payload_mass", "(7,)", "one number")),
    ({"move": {"speed": 1.0}}, ValueError, ("move", "'speed'", "start", "goal", "duration", "ramp_time")),
    ({"move": [0.1, 1.0]}, TypeError, ("move", "[0.1, 1.0]", "mapping")),
    ({"move": {"start": "0.1"}}, TypeError, ("start", "'0.1'", "number")),
    ({"move": {"start": -0.1}}, ValueError, ("start", "-0.1", "0 and pi/2")),
    ({"move": {"start": 0, "goal": 90}}, ValueError, ("goal", "90", "0 and pi/2 rad")),
    ({"move": {"start": 0.5, "goal": 0.6}}, ValueError, ("start=0.5", "goal=0.6", "0.26", "15 degrees")),
    ({"move": {**SUDDEN, "goal": 1.5}}, ValueError, ("infeasible", "goal=1.5", "duration=0.5", "0.240 N m", "allow")),
    *(({"move": {"duration": value}}, ValueError, (f"duration={value}", "1.5 s")) for value in (0, -1, 1.6)),
    *(({"move": {"ramp_time": value}}, ValueError, (f"ramp_time={value}", "positive")) for value in (0, -0.1)),
    ({"move": {"duration": 1.0, "ramp_time": 0.6}}, ValueError, ("ramp_time=0.6", "half the duration")),
    *(({"move": {name: x}}, ValueError, (name, str(x), "finite")) for name in MOVE_FIELDS for x in (NAN, INF, -INF)),
    ({"state": [1.0, 2.0, 3.0]}, ValueError, ("state", "(3,)", "(4,)")),
    ({"state": [60.0, NAN, 0.0, 0.0]}, ValueError, ("state", "nan", "finite")),
    ({"state": ["1", "2", "3", "4"]}, TypeError, ("state", "'1'", "number")),
    ({"state": {"motor_angle": 1.0}}, TypeError, ("state", "motor_angle", "number")),
]
BATCH_OPTIONS: list[Refusal] = [
    ({"params": {"payload_mass": [0.1, -0.2, 0.1]}}, ValueError, ("payload_mass", "-0.2")),
    ({"params": {"torque_ripple_order": [4.0, 5.5, 8.0]}}, ValueError, ("torque_ripple_order", "5.5")),
    ({"params": {"payload_mass": [0.1, 0.2]}}, ValueError, ("(2,)", "(3,)")),
    ({"move": {"start": 0.0, "goal": [1.0, 1.7, 1.5]}}, ValueError, ("goal=1.7",)),
    ({"params": {"belt_stiffness": HUGE}}, ValueError, ("belt_stiffness", "finite")),
    ({"move": {"goal": [1.0, HUGE, 1.0]}}, ValueError, ("goal", "finite")),
    ({"state": [0, 0, HUGE, 0]}, ValueError, ("state", "finite")),
    *(({"reset_mask": mask}, ValueError, ("reset_mask", "bool", "(3,)", repr(mask))) for mask in NO_MASKS),
    ({"reset_mask": np.zeros(3, np.bool_)}, ValueError, ("reset_mask", "at least one")),
]


@each(OPTIONS, BATCH_OPTIONS)
def test_options(make: Callable[[], Any], given: dict[str, Any], error: type[Exception], words: tuple[str, ...]):
    env = make()
    env.reset(seed=0)
    refused(error, words, lambda: env.reset(seed=0, options=given))


def test_what_is_no_options_or_seeds_for_other_arms():
    for make, options in product(MAKERS.values(), (["params"], 3)):
        words = ("options", "mapping", repr(options))
        refused(TypeError, words, lambda make=make, options=options: make().reset(options=options))
    refused(ValueError, ("seed", "3", "2"), lambda: three().reset(seed=[1, 2]))


BAD_RESET = [
    {"params": {"payload_mass": 0.1}, "move": {"goal": 90}},
    {"move": {"goal": 1.0}, "params": {"payload_mass": -1}},
    {"params": {"payload_mass": 0.2}, "state": [NAN] * 4},
]


def ones(env: Any) -> Any:
    return np.ones(env.action_space.shape, np.float32)


@EITHER
@pytest.mark.parametrize("options", BAD_RESET, ids=str)
def test_a_refused_reset_leaves_the_episode_and_random_numbers_as_they_were(make: Callable[[], Any], options: Any):
    env, other = make(), make()
    for each in (env, other):
        with pytest.raises(ValueError):
            each.reset(seed=0, options=options)
        refused(ResetNeeded, ("reset()",), lambda each=each: each.step(ones(each)))
        each.reset(seed=0)
        each.step(ones(each))
    for seed in (None, 7):
        with pytest.raises(ValueError):
            env.reset(seed=seed, options=options)
    assert env.state.tobytes() == other.state.tobytes() and env.params == other.params
    assert env.step(ones(env))[0].tobytes() == other.step(ones(env))[0].tobytes()
    assert env.np_random_seed == other.np_random_seed and env.reset()[0].tobytes() == other.reset()[0].tobytes()


def test_some_arms_cannot_be_reset_before_all_were():
    mask = {"reset_mask": np.array([True, False, False])}
    refused(ResetNeeded, ("reset()",), lambda: three().reset(options=mask))


@pytest.mark.parametrize("action", [0.0, 1.0], ids=["truncated", "terminated"])
def test_steps_after_the_end(action: float):
    env = BeltArmEnv()
    env.reset(seed=0)
    while not any(env.step(np.array([action]))[2:4]):
        pass
    refused(ResetNeeded, ("reset()",), lambda: env.step(np.zeros(1, np.float32)))
    env.reset()
    env.step(np.zeros(1, np.float32))


@EITHER
def test_actions_that_are_not_finite_or_of_another_shape_or_type_leave_the_arms_as_they_were(make: Callable[[], Any]):
    env = make()
    env.reset(seed=0)
    before = env.state
    for value in (np.float32(NAN), INF, -INF):
        actions = ones(env).astype(type(value))
        actions[-1] = value
        words = ("action", "finite", str(value)) + (("arm 2",) if len(actions) > 1 else ())
        refused(ValueError, words, lambda actions=actions: env.step(actions))
    shape = env.action_space.shape
    wrong: list[Any] = [None, 0.5, "0.5", b"5", [1j], [], np.zeros((2, 1)), np.full(shape, "0.5"), np.full(shape, None)]
    for actions in [*wrong, np.zeros((*shape, 1)), np.zeros(shape, np.complex128), np.zeros(shape[:-1])]:
        refused(ValueError, ("action", str(shape)), lambda actions=actions: env.step(actions))
    assert np.array_equal(before, env.state)


def test_actions_of_one_number_are_read_from_any_array_or_list():
    def after(action: Any) -> bytes:
        env = BeltArmEnv()
        env.reset(seed=0)
        return env.step(action)[0].tobytes() + env.step(action)[0].tobytes()

    half = np.array([0.5])
    unaligned = np.frombuffer(b"0" + half.tobytes(), np.uint8)[1:].view(np.float64)
    same = [half.astype(kind) for kind in (np.float32, np.float16, ">f4", ">f8", np.longdouble)]
    same += [[0.5], (0.5,), unaligned, np.array([0.5, 0.0])[::2], half.view(np.ma.MaskedArray)]
    assert {after(action) for action in same} == {after(half)} != {after([1])} == {after(np.array([True]).astype(int))}


@pytest.mark.parametrize("error", [TypeError, ValueError])
def test_an_error_behind_an_action_that_fits_is_raised_and_no_step_is_tried_again(error: type, monkeypatch: Any):
    env, calls = BeltArmEnv(), []
    env.reset(seed=0)

    def broken(action: Any) -> None:
        calls.append(action)
        raise error("broken")

    for action in list[Any]((np.zeros(1), np.zeros(1, np.float32))):
        monkeypatch.setattr(env, "_step_arm", broken)
        refused(error, ("broken",), lambda action=action: env.step(action))
    assert len(calls) == 2


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_bad_actions_are_refused_even_for_an_arm_about_to_restart(mode: str):
    envs = BeltArmVectorEnv(2, autoreset_mode=mode)
    envs.reset(seed=0)
    while not envs.step(np.array([[0.0], [1.0]]))[2].any():
        pass
    refused(ValueError, ("nan", "arm 1"), lambda: envs.step(np.array([[0.0], [NAN]])))


def test_observations_of_another_size():
    words = ("'tip'", str(observation.size("tip")), "(3, 5)")
    refused(ValueError, words, lambda: observation.decode(np.zeros((3, 5), np.float32), "tip"))
    refused(ValueError, ("'torsion'", "'encoder'", "motor_speed"), lambda: observation.index("torsion"))


def test_rollouts():
    for words, action in ((("nan", "finite"), np.full((2, 1), NAN)), (("(2, 2)", "(2, 1)"), np.zeros((2, 2)))):
        controller = Mock(predict=lambda *_, action=action, **__: (action.astype(np.float32), None))
        refused(ValueError, words, lambda controller=controller: rollout(controller, 2, seed=0))
    paper, many = CONTROLLERS["paper"](), tuple(range(1000))
    wrong: list[tuple[Any, ...]] = [("paper", "CONTROLLERS['paper']()"), (type(paper), "()"), (None, "None")]
    for each, *words in (*wrong, (many, "(0, 1, 2,", "...")):
        refused(TypeError, ("predict", *words), lambda each=each: rollout(cast("Any", each), 5))
    refused(ValueError, ("max_episode_steps=100",), lambda: rollout(paper, 2, max_episode_steps=100))
    env, geared = BeltArmVectorEnv(2, autoreset_mode="SameStep"), CONTROLLERS["paper"](params=ArmParams(gear_ratio=160))
    refused(ValueError, ("Disabled",), lambda: record(paper, env))
    refused(ValueError, ("160", "109"), lambda: rollout(geared, 2, options={"params": {"gear_ratio": 160}}))
    simulation = ArmSimulation(ArmParams(), 5)
    refused(ValueError, ("samples", "(5,)"), lambda: simulation.ahead(np.zeros((5, 4)), np.zeros(5), cast("Any", 1.4)))
