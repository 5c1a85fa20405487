"""Input that is refused: each with a specific exception that names the value and what is allowed."""

import errno
import hashlib
import json
import math
import os
import pickle
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from safetensors.torch import load_file
from safetensors.torch import save as save_tensors

import agents.bundle
from agents.actor import MAX_LAYERS, MAX_WIDTH, Actor
from agents.bases import settings_hash
from agents.bundle import (
    FORMAT,
    MANIFEST,
    MAX_BYTES,
    VERSION,
    BundleError,
    BundleSpec,
    load_controller,
    read_spec,
    save_bundle,
)
from agents.residual import ResidualController, ResidualSettings
from agents.residual_env import ResidualEnv, ResidualVecEnv
from baselines import CONTROLLERS
from baselines.files import require_writable, write_atomically, write_text
from beltarm_env import EPISODE_STEPS, ArmParams, BeltArmEnv, BeltArmVectorEnv, observation, state_space
from beltarm_env.rollout import rollout

NAN, INF = math.nan, math.inf
Refusal = tuple[dict[str, Any], type[Exception], tuple[str, ...]]


def refused(expected: type[Exception] | tuple[type[Exception], ...], words: tuple[str, ...], call: Callable[[], Any]):
    """Assert that a call raises exactly this kind of exception, with all the words in its message."""
    with pytest.raises(expected) as caught:
        call()
    kinds = expected if isinstance(expected, tuple) else (expected,)
    assert type(caught.value) in kinds
    missing = [word for word in words if word not in str(caught.value)]
    assert not missing, f"{missing} not in {str(caught.value)!r}"


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
    ({"delay": 3}, ValueError, ("delay", "3", "from 0 to 2")),
    ({"delay": 1.0}, ValueError, ("delay", "1.0", "whole")),
    ({"delay": True}, ValueError, ("delay", "True", "whole")),
    ({"delay": NAN}, ValueError, ("delay", "nan", "whole")),
    ({"render_mode": "ansi"}, ValueError, ("render_mode", "'ansi'", "rgb_array")),
]


@pytest.mark.parametrize("make", [BeltArmEnv, BeltArmVectorEnv])
@pytest.mark.parametrize(("arguments", "error", "words"), SETTINGS, ids=str)
def test_arguments(make: Callable[..., Any], arguments: dict[str, Any], error: type[Exception], words: tuple[str, ...]):
    refused(error, words, lambda: make(**arguments))


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
}


@pytest.mark.parametrize("value", [NAN, INF, -INF, -1e-9, np.float32("nan"), -3])
@pytest.mark.parametrize("name", FIELD_NAMES)
def test_parameters_that_make_no_arm(name: str, value: float):
    allowed = "not negative" if name in MAY_BE_ZERO else "positive"
    refused(ValueError, (name, repr(value), "finite", allowed), lambda: ArmParams(**{name: value}))


@pytest.mark.parametrize("name", FIELD_NAMES)
def test_zero_is_refused_where_it_makes_no_arm(name: str):
    if name in MAY_BE_ZERO:
        assert getattr(ArmParams(**{name: 0}), name) == 0
    else:
        refused(ValueError, (name, "0", "positive"), lambda: ArmParams(**{name: 0}))


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


# Residuals


@pytest.mark.parametrize("value", [0, -0.1, 2.1, NAN, INF, "0.5", None, True], ids=repr)
def test_residual_limit(value: Any):
    words = ("limit", repr(value), "(0, 2]")
    refused((ValueError, TypeError), words, lambda: ResidualSettings(limit=value))


@pytest.mark.parametrize("value", [0, -1, 101, 4.0, "4", None, True], ids=repr)
def test_residual_hold(value: Any):
    words = ("hold", repr(value), "whole", "1 to 100")
    refused((ValueError, TypeError), words, lambda: ResidualSettings(hold=value))


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_residual_batch_needs_same_step_reset(mode: str):
    envs = BeltArmVectorEnv(2, autoreset_mode=mode)
    words = (repr(mode), "SameStep")
    refused(ValueError, words, lambda: ResidualVecEnv(envs, CONTROLLERS["paper"](), ResidualSettings()))


def test_residual_of_another_environment():
    with pytest.raises((TypeError, ValueError), match="BeltArm"):
        ResidualEnv(gym.make("CartPole-v1"), CONTROLLERS["paper"](), ResidualSettings())


@pytest.mark.parametrize("residual", [[NAN], [INF], [0.1, 0.2], "0.5", []], ids=repr)
def test_bad_residuals(residual: Any):
    env = ResidualEnv(BeltArmEnv(), CONTROLLERS["paper"](), ResidualSettings())
    refused(ResetNeeded, ("reset()",), lambda: env.step(np.zeros(1, np.float32)))
    env.reset(seed=0)
    with pytest.raises(ValueError):
        env.step(residual)


@pytest.mark.parametrize("shape", [(3,), (1, 1), (2, 1), (3, 2), ()], ids=str)
def test_residuals_of_another_shape(shape: tuple[int, ...]):
    envs = ResidualVecEnv(
        BeltArmVectorEnv(3, autoreset_mode="SameStep"), CONTROLLERS["paper"](), ResidualSettings(), stagger=False
    )
    envs.reset()
    refused(ValueError, (str(shape), "(3, 1)"), lambda: envs.step(np.zeros(shape, np.float32)))


def test_residuals_that_are_not_finite():
    envs = ResidualVecEnv(
        BeltArmVectorEnv(2, autoreset_mode="SameStep"), CONTROLLERS["paper"](), ResidualSettings(), stagger=False
    )
    envs.reset()
    refused(ValueError, ("nan", "finite"), lambda: envs.step(np.array([[0.0], [NAN]], np.float32)))


# Policy bundles


SPEC = BundleSpec("ppo", "paper", ResidualSettings(), (4, 3), provenance={"seed": 1})


def new_actor(spec: BundleSpec = SPEC) -> Actor:
    return Actor(spec.shape()).requires_grad_(False)


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    folder = tmp_path / "policy"
    save_bundle(folder, SPEC, new_actor())
    load_controller(folder)
    return folder


def weights(bundle: Path) -> Path:
    (path,) = bundle.glob("*.safetensors")
    return path


def edit(bundle: Path, *, rehash: bool, **changes: Any) -> None:
    """Change the manifest, with a fitting content hash (a foreign program's) or without (a hand's)."""
    content = json.loads((bundle / MANIFEST).read_text())
    content.update(changes)
    if rehash:
        content["content_hash"] = agents.bundle._content_hash(content)
    (bundle / MANIFEST).write_text(json.dumps(content))


def drop(bundle: Path, key: str) -> None:
    content = json.loads((bundle / MANIFEST).read_text())
    del content[key]
    content["content_hash"] = agents.bundle._content_hash(content)
    (bundle / MANIFEST).write_text(json.dumps(content))


def flip_a_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


def foreign_weights(bundle: Path) -> None:
    """Weights of another network, with fitting hashes."""
    other, spec = bundle.parent / "other", BundleSpec("ppo", "paper", ResidualSettings(), (5,))
    save_bundle(other, spec, new_actor(spec))
    manifest = json.loads((other / MANIFEST).read_text())
    shutil.copy(weights(other), bundle)
    edit(bundle, rehash=True, weights=manifest["weights"])


def not_weights(bundle: Path, data: bytes) -> None:
    (bundle / "weights-x.safetensors").write_bytes(data)
    edit(bundle, rehash=True, weights={"file": "weights-x.safetensors", "sha256": hashlib.sha256(data).hexdigest()})


def name_weights(bundle: Path, name: object) -> None:
    manifest = json.loads((bundle / MANIFEST).read_text())
    edit(bundle, rehash=True, weights={**manifest["weights"], "file": name})


class Exploit:
    """Its pickle, loaded, creates a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> Any:
        return (Path.touch, (self.target,))


def nan_weights(bundle: Path) -> None:
    """Weights with a NaN, and fitting hashes."""
    tensors = load_file(weights(bundle))
    next(iter(tensors.values())).view(-1)[0] = NAN
    not_weights(bundle, save_tensors(tensors))


def other_gains(bundle: Path) -> None:
    settings = json.loads((bundle / MANIFEST).read_text())["base_settings"]
    settings["gains"]["angle"] += 1
    edit(bundle, rehash=True, base_settings=settings, base_hash=settings_hash(settings))


def other_doubts(bundle: Path) -> None:
    settings = json.loads((bundle / MANIFEST).read_text())["base_settings"]
    settings["doubts"]["swing"] = 0.5
    edit(bundle, rehash=True, base_settings=settings, base_hash=settings_hash(settings))


def rescaled(bundle: Path) -> None:
    entries = json.loads((bundle / MANIFEST).read_text())["entries"]
    entries[0][2] *= 2
    edit(bundle, rehash=True, entries=entries)


DAMAGES: dict[str, tuple[Callable[[Path], Any], tuple[str, ...]]] = {
    "no folder": (shutil.rmtree, ("no policy bundle", MANIFEST)),
    "no manifest": (lambda b: (b / MANIFEST).unlink(), ("no policy bundle", MANIFEST)),
    "manifest is a folder": (
        lambda b: ((b / MANIFEST).unlink(), (b / MANIFEST).mkdir()),
        (MANIFEST, "cannot be read"),
    ),
    "empty manifest": (lambda b: (b / MANIFEST).write_text(""), (MANIFEST, "cannot be read")),
    "truncated manifest": (
        lambda b: (b / MANIFEST).write_text((b / MANIFEST).read_text()[:200]),
        (MANIFEST, "cannot be read"),
    ),
    "binary manifest": (lambda b: (b / MANIFEST).write_bytes(b"\xff\xfe\x00"), (MANIFEST, "cannot be read")),
    "a list": (lambda b: (b / MANIFEST).write_text("[1, 2]"), (MANIFEST, FORMAT)),
    "another program's file": (lambda b: (b / MANIFEST).write_text('{"format": "onnx"}'), (MANIFEST, FORMAT)),
    "newer version": (lambda b: edit(b, rehash=True, version=99), ("99", str(VERSION), "version")),
    "no version": (lambda b: drop(b, "version"), ("None", str(VERSION), "version")),
    "edited by hand": (lambda b: edit(b, rehash=False, base="rigid"), (MANIFEST, "changed", "hash")),
    "provenance edited": (lambda b: edit(b, rehash=False, provenance={}), (MANIFEST, "changed", "hash")),
    "weights named otherwise": (
        lambda b: edit(b, rehash=False, weights={"file": "x", "sha256": ""}),
        (MANIFEST, "changed", "hash"),
    ),
    "another algorithm": (lambda b: edit(b, rehash=True, algorithm="dqn"), (MANIFEST, "does not fit")),
    "another base": (lambda b: edit(b, rehash=True, base="lqr"), (MANIFEST, "does not fit")),
    "base of a wrong type": (lambda b: edit(b, rehash=True, base=["paper"]), (MANIFEST, "does not fit")),
    "another activation": (lambda b: edit(b, rehash=True, activation="gelu"), (MANIFEST, "does not fit")),
    "other sensors": (lambda b: edit(b, rehash=True, sensors="tip"), (MANIFEST, "does not fit")),
    "unknown sensors": (lambda b: edit(b, rehash=True, sensors="sonar"), (MANIFEST, "does not fit", "sonar")),
    "another layout": (lambda b: edit(b, rehash=True, entries=["speed"]), (MANIFEST, "does not fit")),
    "another layout version": (lambda b: edit(b, rehash=True, layout=99), (MANIFEST, "does not fit", "layout")),
    "inputs of another scale": (rescaled, (MANIFEST, "does not fit", "layout")),
    "gains of the base": (other_gains, (MANIFEST, "'paper'", "gains.angle", "train it again")),
    "doubts of the identification": (other_doubts, (MANIFEST, "doubts.swing was 0.5", "train it again")),
    "no settings of the base": (lambda b: edit(b, rehash=True, base_settings=3, base_hash=""), ("unknown gains",)),
    "provenance of a wrong type": (lambda b: edit(b, rehash=True, provenance=[]), (MANIFEST, "does not fit")),
    "huge layers": (
        lambda b: edit(b, rehash=True, hidden=[10**9, 10**9]),
        (MANIFEST, "does not fit", str(MAX_WIDTH), str(10**9)),
    ),
    "very many layers": (
        lambda b: edit(b, rehash=True, hidden=[1] * 10**5),
        (MANIFEST, "does not fit", str(MAX_LAYERS), str(10**5)),
    ),
    "huge LSTM": (lambda b: edit(b, rehash=True, lstm=10**9), (MANIFEST, "does not fit", "LSTM", str(10**9))),
    "an LSTM that is not in the weights": (lambda b: edit(b, rehash=True, lstm=4), ("weights-", "does not hold")),
    "weights of NaN": (nan_weights, ("weights-x", "not finite")),
    "weights elsewhere": (lambda b: name_weights(b, "../elsewhere.safetensors"), ("../elsewhere", "beside it")),
    "weights at an absolute path": (lambda b: name_weights(b, "/etc/passwd"), ("/etc/passwd", "beside it")),
    "weights named by a number": (lambda b: name_weights(b, 7), ("7", "beside it")),
    "weights with a NUL in their name": (lambda b: name_weights(b, "weights-\0.safetensors"), ("beside it",)),
    "huge manifest": (
        lambda b: (b / MANIFEST).write_text(" " * (MAX_BYTES + 1)),
        (MANIFEST, "cannot be read", str(MAX_BYTES)),
    ),
    "huge weights": (lambda b: os.truncate(weights(b), MAX_BYTES + 1), ("weights-", "cannot be read", str(MAX_BYTES))),
    "deeply nested manifest": (lambda b: (b / MANIFEST).write_text("[" * 10**5), (MANIFEST, "cannot be read")),
    "limit out of range": (
        lambda b: edit(b, rehash=True, residual={"limit": 5.0, "hold": 4}),
        (MANIFEST, "does not fit", "5.0", "(0, 2]"),
    ),
    "unknown residual setting": (
        lambda b: edit(b, rehash=True, residual={"gain": 1.0}),
        (MANIFEST, "does not fit", "gain"),
    ),
    "no residual": (lambda b: drop(b, "residual"), (MANIFEST, "does not fit", "residual")),
    "no weights in the manifest": (lambda b: drop(b, "weights"), (MANIFEST, "weights")),
    "layers that are words": (lambda b: edit(b, rehash=True, hidden=["wide"]), (MANIFEST, "does not fit", "wide")),
    "layers that are one number": (lambda b: edit(b, rehash=True, hidden=64), (MANIFEST, "does not fit")),
    "negative layers": (lambda b: edit(b, rehash=True, hidden=[-4]), (MANIFEST, "does not fit", "-4")),
    "other layers": (lambda b: edit(b, rehash=True, hidden=[8, 8]), ("weights-", MANIFEST)),
    "no weights": (lambda b: weights(b).unlink(), ("weights-", "cannot be read")),
    "truncated weights": (lambda b: os.truncate(weights(b), 100), ("weights-", "damaged", "SHA-256")),
    "one bit of the weights": (lambda b: flip_a_bit(weights(b)), ("weights-", "damaged", "SHA-256")),
    "weights that are none": (lambda b: not_weights(b, b"\x80\x04pickled"), ("weights-x", "does not hold")),
    "empty weights": (lambda b: not_weights(b, b""), ("weights-x", "does not hold")),
    "weights of another network": (foreign_weights, ("weights-", "does not hold")),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_bundles(bundle: Path, damage: str):
    break_it, words = DAMAGES[damage]
    break_it(bundle)
    refused(BundleError, words, lambda: load_controller(bundle))


def test_a_file_is_no_bundle(tmp_path: Path):
    (tmp_path / "policy.zip").write_bytes(b"PK")
    with pytest.raises(BundleError, match=r"policy\.zip"):
        load_controller(tmp_path / "policy.zip")


def test_loading_executes_nothing(bundle: Path):
    """Pickles in place of the weights and of the manifest are refused and not run."""
    target = bundle.parent / "executed"
    not_weights(bundle, pickle.dumps(Exploit(target)))
    refused(BundleError, ("weights-x", "does not hold"), lambda: load_controller(bundle))
    (bundle / MANIFEST).write_bytes(pickle.dumps(Exploit(target)))
    refused(BundleError, (MANIFEST, "cannot be read"), lambda: load_controller(bundle))
    assert not target.exists()
    pickle.loads(pickle.dumps(Exploit(target)))
    assert target.exists(), "the exploit should work where a pickle is loaded"


def test_policies_that_are_not_saved(bundle: Path):
    before = read_spec(bundle)
    actor = new_actor()
    next(actor.parameters())[:] = NAN
    refused(BundleError, ("not finite", "layers.0.weight"), lambda: save_bundle(bundle, SPEC, actor))
    wide = BundleSpec("ppo", "paper", ResidualSettings(), (600, 600))
    refused(ValueError, (str(MAX_BYTES), "smaller layers"), lambda: save_bundle(bundle, wide, new_actor(wide)))
    refused(ValueError, ("(600, 600)", "(4, 3)"), lambda: save_bundle(bundle, wide, new_actor()))
    assert read_spec(bundle) == before


# Writing


def fail(code: int) -> Callable[..., Any]:
    def call(*_: Any, **__: Any) -> None:
        raise OSError(code, os.strerror(code))

    return call


@pytest.mark.parametrize(
    ("module", "function", "code"),
    [(tempfile, "mkstemp", errno.EACCES), (os, "replace", errno.EROFS), (os, "chmod", errno.EPERM)],
    ids=["create", "rename", "permissions"],
)
def test_a_file_that_cannot_be_written_stays_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: Any, function: str, code: int
):
    path = tmp_path / "results.json"
    path.write_text("old")
    monkeypatch.setattr(module, function, fail(code))
    with pytest.raises(OSError) as caught:
        write_text(path, "new")
    assert caught.value.errno == code
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["results.json"]


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()], ids=repr)
def test_half_written_files_are_taken_away(tmp_path: Path, error: BaseException):
    path = tmp_path / "results.json"
    path.write_text("old")

    def write(temporary: Path) -> None:
        temporary.write_text("half of")
        raise error

    with pytest.raises(type(error)):
        write_atomically(path, write)
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["results.json"]


def test_a_new_file_that_cannot_be_written_does_not_appear(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(os, "replace", fail(errno.ENOSPC))
    with pytest.raises(OSError):
        write_text(tmp_path / "new" / "results.json", "new")
    assert os.listdir(tmp_path / "new") == []


def test_written_files_are_whole_and_readable(tmp_path: Path):
    path = tmp_path / "a" / "b" / "results.json"
    write_text(path, "first")
    write_text(path, "gain ×2")
    assert path.read_text(encoding="utf-8") == "gain ×2"
    assert os.listdir(path.parent) == ["results.json"]
    assert path.stat().st_mode & 0o777 == 0o644


@pytest.mark.parametrize("code", [errno.EACCES, errno.EROFS, errno.ENOSPC], ids=errno.errorcode.get)
def test_unwritable_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int):
    monkeypatch.setattr(tempfile, "mkstemp", fail(code))
    words = (str(tmp_path), os.strerror(code), "choose another")
    with pytest.raises(OSError) as caught:
        require_writable(tmp_path)
    assert [word for word in words if word not in str(caught.value)] == []
    assert os.listdir(tmp_path) == []


def test_folder_that_is_a_file(tmp_path: Path):
    path = tmp_path / "results"
    path.write_text("mine")
    with pytest.raises(OSError, match=r"results.*choose another"):
        require_writable(path)
    assert path.read_text() == "mine"


def test_writable_folder_is_left_empty(tmp_path: Path):
    require_writable(tmp_path / "results")
    assert os.listdir(tmp_path / "results") == []


@pytest.mark.parametrize("files_written", [0, 1])
def test_a_bundle_that_cannot_be_replaced_stays_valid(
    bundle: Path, monkeypatch: pytest.MonkeyPatch, files_written: int
):
    """The disk fills up at the weights, or between the weights and the manifest."""
    old, _ = load_controller(bundle)
    seen = np.ones((2, observation.size()), np.float32)
    expected = old.predict(seen)[0]
    replace, calls = os.replace, []

    def replace_then_fail(*arguments: Any) -> None:
        calls.append(arguments)
        if len(calls) > files_written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(*arguments)

    monkeypatch.setattr(os, "replace", replace_then_fail)
    with pytest.raises(OSError, match="No space"):
        save_bundle(bundle, SPEC, new_actor())
    monkeypatch.undo()
    again, _ = load_controller(bundle)
    assert isinstance(again, ResidualController)
    assert np.array_equal(again.predict(seen)[0], expected)
    assert not [name for name in os.listdir(bundle) if name.startswith(".")]
    save_bundle(bundle, SPEC, new_actor())
    assert len(os.listdir(bundle)) == 3
