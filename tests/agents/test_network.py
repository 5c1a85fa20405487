"""A policy's network as it acts: PyTorch's numbers, and the same ones alone and in any batch, bit for bit."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from agents.policy import network
from agents.policy.actor import Actor
from agents.policy.bundle import POLICIES, load_controller
from agents.policy.network import NetworkPolicy
from agents.policy.weights import ActorShape
from beltarm_env.arrays import Singles

ROOT = Path(__file__).resolve().parents[2]
SHAPES = {
    "student": ActorShape(63, (96,), "relu", gru=96, standardised=True),
    "ppo": ActorShape(63, (256, 256), "relu"),
    "sac": ActorShape(30, (64, 64), "relu", squashed=True),
    "recurrent": ActorShape(27, (), "relu", lstm=33),
    "tanh": ActorShape(9, (17, 5), "tanh"),
    "elu": ActorShape(9, (17, 5), "elu", gru=3),
}


def lively(shape: ActorShape, seed: int = 0) -> Actor:
    torch.manual_seed(seed)
    actor = Actor(shape)
    for parameter in actor.parameters():
        parameter.data *= 1.5
    if shape.standardised:
        actor.mean, actor.deviation = torch.randn(shape.inputs), 0.2 + torch.rand(shape.inputs)
    return actor.requires_grad_(False)


def episodes(shape: ActorShape, count: int, steps: int = 12, seed: int = 0) -> Singles:
    return np.random.default_rng(seed).normal(0, 2, (steps, count, shape.inputs)).astype(np.float32)


def answers(policy: NetworkPolicy, seen: Singles) -> Singles:
    """Residuals through whole episodes, shape (steps, count)."""
    memory, residuals = None, []
    for observation in seen:
        residual, memory = policy.predict(observation, memory)
        residuals.append(residual[:, 0])
    return np.stack(residuals)


def by_torch(actor: Actor, seen: Singles) -> Singles:
    shape, inputs = actor.shape, torch.from_numpy(seen)
    outputs = actor.layers(actor.lstm(inputs)[0]) if actor.lstm is not None else actor(inputs)
    bounded = torch.tanh(outputs) if shape.squashed else outputs.clamp(-1, 1)
    return bounded[..., 0].numpy()


@pytest.mark.parametrize("name", SHAPES)
def test_residuals_are_those_of_the_library(name: str):
    actor = lively(SHAPES[name])
    seen = episodes(SHAPES[name], 50)
    expected = by_torch(actor, seen)
    np.testing.assert_allclose(answers(NetworkPolicy(actor.weights()), seen), expected, atol=3e-6)
    assert 0.05 < expected.std()


@given(st.sampled_from(sorted(SHAPES)), st.integers(1, 40), st.integers(0, 1000))
def test_a_row_is_the_same_alone_and_in_any_batch(name: str, count: int, seed: int):
    """Rows turned round, and cut where the kernel's tiles do not end."""
    policy, seen = NetworkPolicy(lively(SHAPES[name]).weights()), episodes(SHAPES[name], count, 3, seed)
    whole = answers(policy, seen)
    np.testing.assert_array_equal(answers(policy, seen[:, ::-1])[:, ::-1], whole)
    np.testing.assert_array_equal(answers(policy, seen[:, : 1 + count // 3]), whole[:, : 1 + count // 3])
    np.testing.assert_array_equal(answers(policy, seen[:, -1:]), whole[:, -1:])


def test_a_memory_begins_anew_where_an_episode_does():
    shape = SHAPES["student"]
    policy, seen = NetworkPolicy(lively(shape).weights()), 0.1 * episodes(shape, 3, 4)
    _, memory = policy.predict(seen[0])
    residual, following = policy.predict(seen[1], memory, np.array([False, True, False]))
    fresh, _ = policy.predict(seen[1])
    on, _ = policy.predict(seen[1], memory)
    assert residual[1] == fresh[1] != on[1] and residual[0] == on[0] != fresh[0]
    assert following is not None and following.shape == (3, shape.gru)


def test_weights_are_copied():
    """Training goes on with an actor that a policy was made of."""
    actor = lively(SHAPES["student"])
    policy, seen = NetworkPolicy(actor.weights()), episodes(SHAPES["student"], 2)
    before = answers(policy, seen)
    for tensor in actor.state_dict().values():
        tensor.add_(1.0)
    np.testing.assert_array_equal(answers(policy, seen), before)


@given(st.floats(-30, 30))
def test_functions_of_one_number(x: float):
    assert network._tanh(x) == pytest.approx(math.tanh(x), abs=3e-7, rel=3e-6)
    assert network._tanh(-x) == -network._tanh(x)
    assert network._sigmoid(x) == pytest.approx(1 / (1 + math.exp(-x)), abs=3e-7)
    assert network._activated(x, network._ELU) == pytest.approx(x if x > 0 else math.expm1(x), abs=3e-6)
    assert network._activated(x, network._RELU) == max(x, 0.0)


PLAIN = """
import sys; sys.path.insert(0, "tests/agents")
import numpy as np
from test_network import SHAPES, answers, episodes, lively, NetworkPolicy
found = {name: answers(NetworkPolicy(lively(SHAPES[name]).weights()), episodes(SHAPES[name], 9, 3)) for name in NAMES}
"""


@pytest.mark.slow
def test_without_compiler_the_very_same_numbers(tmp_path: Path):
    names = ("elu", "tanh", "recurrent")
    code = f"NAMES = {names!r}\n{PLAIN}\nnp.savez({str(tmp_path / 'plain.npz')!r}, **found)"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, check=True)
    with np.load(tmp_path / "plain.npz") as plain:
        for name in names:
            expected = answers(NetworkPolicy(lively(SHAPES[name]).weights()), episodes(SHAPES[name], 9, 3))
            assert plain[name].tobytes() == expected.tobytes(), name


WITHOUT = """
import sys
import numpy as np
import eval.compare
from agents.policy.bundle import POLICIES, load_controller
controller = load_controller(POLICIES / "ppo" / "seed0")
print(controller.predict(np.full((2, 25), 0.1, np.float32))[0].tobytes().hex())
assert "torch" not in sys.modules
"""


@pytest.mark.slow
def test_shipped_policies_act_and_are_compared_without_pytorch():
    done = subprocess.run([sys.executable, "-c", WITHOUT], cwd=ROOT, capture_output=True, text=True, check=True)
    controller = load_controller(POLICIES / "ppo" / "seed0")
    assert done.stdout.strip() == controller.predict(np.full((2, 25), 0.1, np.float32))[0].tobytes().hex()
