"""Networks of policies: their sizes, PyTorch's numbers, the same bits alone and in any batch, and as ONNX models."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from bundles import new_weights
from commands import ROOT, python
from episodes import assert_same_in_batches
from gymnasium.error import DependencyNotInstalled
from hypothesis import given
from hypothesis import strategies as st
from networks import SHAPES, episodes, lively
from refusals import refused

from agents.policy.actor import Actor
from agents.policy.bundle import ACCELEROMETER_POLICIES, POLICIES, load_controller, read_spec
from agents.policy.network import NetworkPolicy
from agents.policy.onnx_model import OPSET, model_of, write_onnx
from agents.policy.weights import ActorShape
from beltarm_env.arrays import Singles
from beltarm_env.task.seeds import VALIDATION


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
    policy, seen = NetworkPolicy(lively(SHAPES[name]).weights()), episodes(SHAPES[name], count, 3, seed)
    whole = answers(policy, seen)
    for rows in (slice(None, None, -1), slice(1 + count // 3), slice(-1, None)):
        np.testing.assert_array_equal(answers(policy, seen[:, rows]), whole[:, rows])


WITHOUT = """
import sys
import numpy as np
import eval.compare
from agents.policy.bundle import POLICIES, load_controller
controller = load_controller(POLICIES / "ppo" / "seed0")
print(controller.predict(np.full((2, 26), 0.1, np.float32))[0].tobytes().hex())
assert "torch" not in sys.modules
"""


@pytest.mark.slow
def test_shipped_policies_act_and_are_compared_without_pytorch():
    controller = load_controller(POLICIES / "ppo" / "seed0")
    expected = controller.predict(np.full((2, 26), 0.1, np.float32))[0].tobytes().hex()
    assert python("-c", WITHOUT, cwd=ROOT).strip() == expected


@pytest.mark.parametrize(
    "folder",
    sorted(path for root in (POLICIES, ACCELEROMETER_POLICIES) for path in root.glob("*/seed0")),
    ids=lambda p: p.parts[-3] + p.parts[-2],
)
def test_shipped_policies_drive_an_arm_the_same_way_alone_and_in_batches(folder: Path):
    settings: dict[str, Any] = {"randomization": "train", "sensors": read_spec(folder)[0].sensors}
    assert_same_in_batches(lambda: load_controller(folder), VALIDATION.first, **settings)


MORE = {
    "standardised": ActorShape(7, (5,), "tanh", standardised=True),
    "squashed lstm": ActorShape(6, (8, 8), "elu", squashed=True, lstm=9),
    "no hidden layer": ActorShape(4, ()),
}


@pytest.mark.parametrize("name", [*SHAPES, *MORE])
def test_residuals_and_states_of_a_model_are_the_policys(name: str):
    shape = {**SHAPES, **MORE}[name]
    actor = lively(shape)
    policy, memory, expected = NetworkPolicy(actor.weights()), None, []
    session = pytest.importorskip("onnx.reference").ReferenceEvaluator(model_of(actor.weights(), {}))
    state = np.zeros((7, *policy.memory), np.float32)
    for observation in 0.5 * episodes(shape, 7, 5):
        residual, memory = policy.predict(observation, memory)
        fed = {"observation": observation, "state": state} if state.size else {"observation": observation}
        actual, *following = session.run(None, fed)
        np.testing.assert_allclose(actual, residual, rtol=0, atol=2e-6)
        expected.append(residual)
        if memory is not None:
            (state,) = following
            assert state.shape == memory.shape
            np.testing.assert_allclose(state, memory, rtol=0, atol=2e-6)
    assert 0.05 < np.std(expected)


@pytest.mark.parametrize("method", ["ppo", "student"])
def test_a_shipped_policy_as_a_model(method: str, tmp_path: Path):
    onnx, folder = pytest.importorskip("onnx"), POLICIES / method / "seed0"
    write_onnx(folder, tmp_path / "policy.onnx")
    model, (spec, content) = onnx.load(tmp_path / "policy.onnx"), read_spec(folder)
    onnx.checker.check_model(model, full_check=True)
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", OPSET)]
    reported = {entry.key: entry.value for entry in model.metadata_props}
    assert (reported.pop("base"), reported.pop("sensors")) == (spec.base, "encoder")
    wanted = {"description": content, "entries": spec.entries(), "edition": content["edition"]}
    wanted |= {"hold": spec.residual.hold, "limit": spec.residual.limit}
    assert {name: json.loads(reported[name]) for name in wanted} == wanted
    shapes = {
        value.name: [axis.dim_param or axis.dim_value for axis in value.type.tensor_type.shape.dim]
        for value in (*model.graph.input, *model.graph.output)
    }
    state = {"state": ["n", spec.gru], "next_state": ["n", spec.gru]} if spec.gru else {}
    assert shapes == {"observation": ["n", len(spec.entries())], "residual": ["n", 1], **state}


def test_without_the_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    refused(DependencyNotInstalled, ("[onnx]",), lambda: model_of(new_weights(), {}))
