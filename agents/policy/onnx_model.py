"""A policy's network as an ONNX model: standard operators, for runtimes that know nothing of this project.

    observation   the policy's own entries, scaled as in `beltarm_env.observation`, float32, shape (n, entries)
    state         what it remembers: of a GRU shape (n, width), of an LSTM hidden and cell state, (n, 2, width); zero
                  where an episode begins; without either there is none
    residual      from -1 to 1, shape (n, 1): a share of `limit`, held for `hold` samples
    next_state    for the next call, `hold` samples later

Standardisation is inside; base controller and identification are not. Metadata says what they are: the policy's whole
"description" (JSON), and from it "base", "hold", "limit", "edition", "sensors" and "entries" (JSON: name, unit, scale
and bound of each). tanh and the logistic function are the runtime's, those of `agents.policy.network` quotients of
polynomials: residuals agree within 1e-6 or so, not bit for bit.

`torch.onnx.export` is not used: it needs onnxscript and PyTorch, without which policies act here, and what exports
without onnxscript is deprecated.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import DependencyNotInstalled

from agents.policy.bundle import read_bundle
from agents.policy.weights import FARTHEST, ActorShape, Weights
from baselines.tools.files import write_bytes
from beltarm_env.arrays import Singles

if TYPE_CHECKING:
    import onnx

OPSET = 17
"""Version of ONNX's operators."""
_IR = 8  # version of the file's format that goes with it
_ACTIVATIONS = {"tanh": "Tanh", "relu": "Relu", "elu": "Elu"}


def onnx_model(folder: Path | str) -> onnx.ModelProto:
    """Make the ONNX model of a policy.

    Raises:
        BundleError: If the policy is missing, damaged, or foreign.
        DependencyNotInstalled: If the package onnx is not installed.
    """
    weights, spec, content, _ = read_bundle(folder)
    metadata = {name: content[name] for name in ("base", "edition", "sensors", "entries")}
    metadata |= {"hold": spec.residual.hold, "limit": spec.residual.limit, "description": content}
    texts = {name: value if isinstance(value, str) else json.dumps(value) for name, value in metadata.items()}
    return model_of(weights, texts)


def write_onnx(folder: Path | str, path: Path) -> None:
    """Write the ONNX model of a policy to a file; raises the errors of `onnx_model`, and OSError."""
    write_bytes(path, onnx_model(folder).SerializeToString())


def model_of(weights: Weights, metadata: Mapping[str, str]) -> onnx.ModelProto:
    """Make the ONNX model of a network; raises DependencyNotInstalled if the package onnx is not installed."""
    try:
        from onnx import checker, helper, numpy_helper, parser
    except ImportError:
        raise DependencyNotInstalled("an ONNX model needs the package onnx: pip install -e '.[onnx]'") from None
    shape = weights.shape
    nodes, constants = _network(weights)
    memory = "float[n, {}]".format(", ".join(map(str, shape.memory)))
    state, following = (f", {memory} state", f", {memory} next_state") if shape.recurrent else ("", "")
    model = parser.parse_model(
        f'<ir_version: {_IR}, opset_import: ["" : {OPSET}], producer_name: "beltarm">\n'
        f"residual_policy (float[n, {shape.inputs}] observation{state}) => (float[n, 1] residual{following}) "
        "{\n" + "\n".join(nodes) + "\n}"
    )
    arrays = {name: np.ascontiguousarray(value) for name, value in constants.items()}
    model.graph.initializer.extend(numpy_helper.from_array(value, name) for name, value in arrays.items())
    helper.set_model_props(model, dict(metadata))
    checker.check_model(model, full_check=True)
    return model


def _network(weights: Weights) -> tuple[list[str], dict[str, Any]]:
    """Nodes from the observation, and the state, to the residual, and the next state; and their constants."""
    shape, features = weights.shape, "observation"
    nodes, constants = list[str](), dict[str, Any]()
    if shape.standardised:
        constants |= {name: weights.arrays[name] for name in ("mean", "deviation")}
        constants |= {"low": np.float32(-FARTHEST), "high": np.float32(FARTHEST)}
        nodes += ["centred = Sub (observation, mean)", "ratio = Div (centred, deviation)"]
        nodes += ["standardised = Clip (ratio, low, high)"]
        features = "standardised"
    if shape.recurrent:
        nodes += [f"steps = Unsqueeze ({features}, first)", *_step(shape)]
        nodes += [f"seen = Concat <axis = 1> ({features}, memory)" if shape.gru else "seen = Identity (memory)"]
        constants |= _recurrent_constants(weights)
        features = "seen"
    layers = weights.layers()
    for k, (matrix, offset) in enumerate(layers):
        constants |= {f"weight_{k}": matrix, f"bias_{k}": offset}
        nodes.append(f"layer_{k} = Gemm <transB = 1> ({features}, weight_{k}, bias_{k})")
        features = f"layer_{k}"
        if k < len(layers) - 1:
            nodes.append(f"active_{k} = {_ACTIVATIONS[shape.activation]} (layer_{k})")
            features = f"active_{k}"
    if shape.squashed:
        return [*nodes, f"residual = Tanh ({features})"], constants
    constants |= {"minus_one": np.float32(-1.0), "one": np.float32(1.0)}
    return [*nodes, f"residual = Clip ({features}, minus_one, one)"], constants


def _step(shape: ActorShape) -> list[str]:
    """Nodes of a GRU or LSTM, for one step."""
    width, weights = shape.memory_width, "input_weight, hidden_weight, recurrent_bias"
    if shape.gru:
        return [
            "before = Unsqueeze (state, first)",
            f", hidden = GRU <hidden_size = {width}, linear_before_reset = 1> (steps, {weights}, , before)",
            "next_state = Squeeze (hidden, first)",
            "memory = Identity (next_state)",
        ]
    return [
        "parts = Transpose <perm = [1, 0, 2]> (state)",
        "hidden_before, cell_before = Split <axis = 0> (parts)",
        f", hidden, cell = LSTM <hidden_size = {width}> (steps, {weights}, , hidden_before, cell_before)",
        "parts_after = Concat <axis = 0> (hidden, cell)",
        "next_state = Transpose <perm = [1, 0, 2]> (parts_after)",
        "memory = Squeeze (hidden, first)",
    ]


def _recurrent_constants(weights: Weights) -> dict[str, Any]:
    """Weights with the gates in ONNX's order: z, r, n of a GRU, i, o, f, g of an LSTM; one direction comes first."""
    width, order = weights.shape.memory_width, (1, 0, 2) if weights.shape.gru else (0, 3, 1, 2)
    (input_weight, input_bias), (hidden_weight, hidden_bias) = weights.recurrent()

    def gates(rows: Singles) -> Singles:
        return np.concatenate([rows[gate * width : (gate + 1) * width] for gate in order])[None]

    return {
        "first": np.array([0]),
        "input_weight": gates(input_weight),
        "hidden_weight": gates(hidden_weight),
        "recurrent_bias": np.concatenate([gates(input_bias), gates(hidden_bias)], axis=1),
    }
