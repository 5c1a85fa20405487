"""Policies as ONNX models: what they compute, what they say of themselves, what is refused."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bundles import SPEC, new_weights
from gymnasium.error import DependencyNotInstalled
from networks import SHAPES, episodes, lively

from agents.policy.bundle import MANIFEST, POLICIES, BundleError, read_spec, save_bundle
from agents.policy.network import NetworkPolicy
from agents.policy.onnx_model import OPSET, model_of, onnx_model, write_onnx
from agents.policy.weights import ActorShape
from beltarm_env.arrays import Singles

onnx = pytest.importorskip("onnx")
reference = pytest.importorskip("onnx.reference")

MORE = {
    "standardised": ActorShape(7, (5,), "tanh", standardised=True),
    "squashed lstm": ActorShape(6, (8, 8), "elu", squashed=True, lstm=9),
    "no hidden layer": ActorShape(4, ()),
}


def answers(model: Any, seen: Singles, memory: tuple[int, ...]) -> tuple[Singles, Singles]:
    """Residuals through whole episodes, shape (steps, count), and the last state."""
    session, state, residuals = reference.ReferenceEvaluator(model), np.zeros((seen.shape[1], *memory), np.float32), []
    for observation in seen:
        fed = {"observation": observation, "state": state} if state.size else {"observation": observation}
        residual, *following = session.run(None, fed)
        state = following[0] if following else state
        residuals.append(residual[:, 0])
    return np.stack(residuals), state


@pytest.mark.parametrize("name", [*SHAPES, *MORE])
def test_residuals_and_states_are_the_policys(name: str):
    shape = {**SHAPES, **MORE}[name]
    actor = lively(shape)
    policy, seen, memory, expected = NetworkPolicy(actor.weights()), 0.5 * episodes(shape, 7, 5), None, []
    for observation in seen:
        residual, memory = policy.predict(observation, memory)
        expected.append(residual[:, 0])
    residuals, state = answers(model_of(actor.weights(), {}), seen, policy.memory)
    np.testing.assert_allclose(residuals, np.stack(expected), rtol=0, atol=2e-6)
    assert 0.05 < np.std(expected)
    if memory is not None:
        assert state.shape == memory.shape
        np.testing.assert_allclose(state, memory, rtol=0, atol=2e-6)


@pytest.mark.parametrize("method", ["ppo", "student"])
def test_a_shipped_policy(method: str, tmp_path: Path):
    folder = POLICIES / method / "seed0"
    write_onnx(folder, tmp_path / "policy.onnx")
    model, (spec, content) = onnx.load(tmp_path / "policy.onnx"), read_spec(folder)
    onnx.checker.check_model(model, full_check=True)
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", OPSET)]
    reported = {entry.key: entry.value for entry in model.metadata_props}
    assert json.loads(reported[MANIFEST]) == content
    assert json.loads(reported["entries"]) == spec.entries()
    assert (reported["base"], reported["sensors"]) == (spec.base, "encoder")
    assert (json.loads(reported["hold"]), json.loads(reported["limit"])) == (spec.residual.hold, spec.residual.limit)
    assert json.loads(reported["edition"]) == content["edition"]
    shapes = {
        value.name: [axis.dim_param or axis.dim_value for axis in value.type.tensor_type.shape.dim]
        for value in (*model.graph.input, *model.graph.output)
    }
    state = {"state": ["n", spec.gru], "next_state": ["n", spec.gru]} if spec.gru else {}
    assert shapes == {"observation": ["n", len(spec.entries())], "residual": ["n", 1], **state}


def test_a_damaged_bundle_makes_no_model(tmp_path: Path):
    save_bundle(tmp_path, SPEC, new_weights())
    (weights,) = tmp_path.glob("*.safetensors")
    weights.write_bytes(weights.read_bytes()[:-4] + np.float32(np.nan).tobytes())
    with pytest.raises(BundleError, match="damaged"):
        onnx_model(tmp_path)


def test_without_the_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(DependencyNotInstalled, match=r"'\.\[onnx\]'"):
        model_of(lively(MORE["no hidden layer"]).weights(), {})
