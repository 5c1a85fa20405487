"""Rapid motor adaptation: a policy that is told the arm, and a memory that guesses what it was told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from trainings import StopAfter, weights

from agents.learners.rma import InformedActor, Memory, Rma, RmaConfig, Told, merged, told_constants
from agents.policy.bundle import load_controller, read_spec
from agents.policy.network import NetworkPolicy
from agents.policy.weights import ActorShape
from agents.residual.controller import ResidualController
from agents.runs.monitor import validate
from agents.runs.training import train
from baselines import CONTROLLERS
from baselines.engines.parallel import Channel, Interrupted, StopRequest
from beltarm_env import BeltArmVectorEnv
from beltarm_env.arm import COLUMN, FIELDS
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import TRAIN_RANGES

SEED = 5_710_000
SHAPE = ActorShape(inputs=5, hidden=(7, 6), gru=4, standardised=True)
LATENT, CONSTANTS = 3, 9
OPTIONS: dict[str, Any] = {
    **{"arms": 4, "rounds": 3, "told": 0.6, "remembered": 2, "epochs": 2, "batch_size": 2, "gru_width": 6},
    **{"hold": 40, "hidden": (8,), "validation_arms": 2, "base": "paper", "knowledge": "none", "latent": 3},
}


def tiny(out: Path, **options: Any) -> RmaConfig:
    return RmaConfig(**{"out": out, **OPTIONS, **options})


def run(config: RmaConfig, stop: StopRequest | None = None) -> None:
    train(config, Rma, Channel(stop=stop or StopRequest()))


def shaken(network: Any) -> Any:
    """Network with weights and scales drawn anew."""
    generator = torch.Generator().manual_seed(3)
    for parameter in network.parameters():
        parameter.data = 0.4 * torch.randn(parameter.shape, generator=generator)
    network.mean = torch.randn(network.mean.shape, generator=generator)
    network.deviation = 0.5 + torch.rand(network.deviation.shape, generator=generator)
    return network.requires_grad_(False)


# What is told of an arm


def table(arms: int = 400) -> np.ndarray[Any, Any]:
    env = BeltArmVectorEnv(arms, randomization="train")
    env.reset(seed=SEED)
    return env.params_table


def test_what_is_told_fills_its_range():
    told = told_constants(table())
    assert told.min() >= -1 and told.max() <= 1
    assert (told.min(axis=0) < -0.95).all() and (told.max(axis=0) > 0.95).all()
    assert np.abs(np.corrcoef(told.T) - np.eye(told.shape[1])).max() < 0.25, "nothing is told twice"


def test_all_that_varies_is_told():
    """Every constant of the training ranges, and none of the others, changes what is told; a full turn does not."""
    rows = table(1)
    for name in FIELDS:
        other = rows.copy()
        column = getattr(COLUMN, name)
        other[:, column] = 0.9 * other[:, column] + 0.01
        assert (told_constants(other) != told_constants(rows)).any() == (name in TRAIN_RANGES), name
        if name.endswith("_phase"):
            other[:, column] = rows[:, column] + 2 * np.pi
            np.testing.assert_allclose(told_constants(other), told_constants(rows), atol=1e-6)


def test_a_round_is_told_the_very_arms_that_are_moved(tmp_path: Path):
    learner = Rma(tiny(tmp_path))
    found: list[Any] = []
    told = learner._ask

    def noted(policy: Any, pause: Any) -> Any:
        advice, own = told(policy, pause)
        found.extend((policy._constants, told_constants(own.params)))
        return advice, own

    learner._ask = noted
    learner._asked(lambda _: None)  # pyright: ignore[reportArgumentType]
    np.testing.assert_array_equal(*found)


# Networks


def test_the_merged_actor_does_what_the_policy_does_with_the_guess():
    informed = shaken(InformedActor(SHAPE, CONSTANTS, LATENT))
    memory = shaken(Memory(SHAPE, LATENT))
    memory.mean, memory.deviation = informed.mean[:5], informed.deviation[:5]
    actor = merged(informed, memory, SHAPE)
    inputs = 2 * torch.randn(40, 6, 5, generator=torch.Generator().manual_seed(1))
    guess = memory(inputs)
    observed = ((inputs - memory.mean) / memory.deviation).clamp(-5, 5)
    expected = informed.policy(torch.cat([observed, guess], dim=-1))
    assert expected.std() > 0.1 and guess.std() > 0.1
    np.testing.assert_allclose(actor(inputs).numpy(), expected.numpy(), atol=2e-5)
    policy, state, residuals = NetworkPolicy(actor.weights()), None, []
    for seen in inputs.numpy():
        residual, state = policy.predict(seen, state)
        residuals.append(residual)
    np.testing.assert_allclose(residuals, expected.clamp(-1, 1).numpy(), atol=2e-5)


def test_a_policy_is_told_the_arm_of_its_row():
    informed = shaken(InformedActor(SHAPE, CONSTANTS, LATENT))
    constants = np.random.default_rng(1).uniform(-1, 1, (6, CONSTANTS)).astype(np.float32)
    residual, _ = Told(informed, constants).predict(np.zeros((6, 5), np.float32))
    alone, _ = Told(informed, constants[4:5]).predict(np.zeros((1, 5), np.float32))
    assert len(np.unique(residual)) == 6 and np.abs(residual).max() <= 1
    np.testing.assert_allclose(residual[4:5], alone, atol=1e-6)


def test_the_untrained_policy_is_its_base(tmp_path: Path):
    base = rollout(CONTROLLERS["adaptive"](), 3, seed=SEED, randomization="train")
    config = RmaConfig(out=tmp_path)
    policy = NetworkPolicy(Rma(config).actor().weights())
    untrained = ResidualController(CONTROLLERS["adaptive"](), policy, config.residual)
    np.testing.assert_array_equal(rollout(untrained, 3, seed=SEED, randomization="train").state, base.state)


@pytest.mark.slow
def test_a_memory_learns_what_it_can_see(tmp_path: Path):
    """Of two numbers, one is in the first hold of an episode; the other cannot be known, and is guessed as its mean."""
    learner = Rma(tiny(tmp_path, rounds=3, epochs=150, batch_size=32, latent=2, learning_rate=0.02, gru_width=8))
    random = torch.Generator().manual_seed(4)
    z = 2 * torch.rand(256, 2, generator=random) - 1
    inputs = torch.zeros(8, 256, learner.config.spec().shape().inputs)
    inputs[0, :, 2] = z[:, 0]
    learner.rounds, learner._moves = 2, [(inputs.half(), z)]
    learner._fit_memory(learner._regression.averaged(), lambda _: None)
    late = learner._memory.averaged()(inputs)[-1]
    assert (late[:, 0] - z[:, 0]).square().mean() < 0.01
    assert late[:, 1].std() < 0.15 and abs(float(late[:, 1].mean())) < 0.15


# Runs


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "run"
    run(tiny(folder))
    return folder


@pytest.mark.slow
def test_interrupted_and_resumed_is_uninterrupted(whole: Path, tmp_path: Path):
    """Bit for bit, in both phases."""
    config = tiny(tmp_path)
    for number, looks in enumerate((700, 1800, 1208)):
        with pytest.raises(Interrupted, match=r"interrupted at \d+ steps, saved in"):
            run(replace(config, resume=number > 0), StopAfter(looks))
        torch.manual_seed(9)
    run(replace(config, resume=True))
    for kind in ("best", "last"):
        assert weights(tmp_path / kind) == weights(whole / kind)


def test_what_is_left_is_a_policy_of_a_students_shape(whole: Path):
    trained = load_controller(whole / "last")
    spec, _ = read_spec(whole / "last")
    assert (spec.algorithm, spec.base, spec.gru) == ("rma", "paper", 6)
    assert validate(trained, 2) == spec.provenance["reached"]["validation"] != spec.provenance["validation_of_base"]


def test_the_memory_moves_the_torque_once_it_is_fitted(whole: Path):
    """Its weights into the first layer are zero as long as it is not."""
    trained = load_controller(whole / "last")
    policy: Any = trained.policy
    seen = np.zeros((2, policy.shape.inputs), np.float32)
    memories = np.zeros((2, 6), np.float32)
    memories[1] = 0.5
    residuals, _ = policy.predict(seen, memories)
    assert residuals[0, 0] != residuals[1, 0]
    untrained, _ = NetworkPolicy(Rma(tiny(whole)).actor().weights()).predict(seen, memories)
    assert untrained[0, 0] == untrained[1, 0]


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "never told": ({"told": 0.0}, "--told must lie between 0 and 1, got 0.0"),
    "always told": ({"told": 1.0}, "--told must lie between 0 and 1, got 1.0"),
    "no rounds left": ({"told": 0.9}, "--rounds must leave one for the memory, with --rounds 3 and --told 0.9"),
    "no latent": ({"latent": 0}, "--latent must be at least 1, got 0"),
    "no memory": ({"gru_width": 0}, "--gru-width must be at least 1, got 0"),
    "diverging": ({"learning_rate": 1e30}, "diverged at 0 steps: start again with a smaller --learning-rate"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_options(case: str, tmp_path: Path):
    options, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        run(tiny(tmp_path, **options))
