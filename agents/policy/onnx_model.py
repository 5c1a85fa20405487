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
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import DependencyNotInstalled

from agents.policy.bundle import read_weights
from agents.policy.weights import FARTHEST, Weights
from baselines.tools.files import write_atomically
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
    weights, spec, content = read_weights(folder)
    told = {name: content[name] for name in ("base", "edition", "sensors", "entries")}
    told |= {"hold": spec.residual.hold, "limit": spec.residual.limit, "description": content}
    texts = {name: value if isinstance(value, str) else json.dumps(value) for name, value in told.items()}
    return model_of(weights, texts)


def write_onnx(folder: Path | str, path: Path) -> None:
    """Write the ONNX model of a policy to a file; raises the errors of `onnx_model`, and OSError."""
    data = onnx_model(folder).SerializeToString()
    write_atomically(path, lambda file: file.write_bytes(data))


def model_of(weights: Weights, metadata: Mapping[str, str]) -> onnx.ModelProto:
    """Make the ONNX model of a network; raises DependencyNotInstalled if the package onnx is not installed."""
    try:
        from onnx import TensorProto, checker, helper
    except ImportError:
        raise DependencyNotInstalled("an ONNX model needs the package onnx: pip install -e '.[onnx]'") from None
    shape, graph = weights.shape, _Graph()
    _write_network(graph, weights)

    def described(name: str, *sizes: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", *sizes])

    inputs, outputs = [described("observation", shape.inputs)], [described("residual", 1)]
    if shape.recurrent:
        inputs, outputs = (
            [*inputs, described("state", *shape.memory)],
            [*outputs, described("next_state", *shape.memory)],
        )
    model = helper.make_model(
        helper.make_graph(graph.nodes, "residual_policy", inputs, outputs, graph.constants),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=_IR,
        producer_name="beltarm",
    )
    helper.set_model_props(model, dict(metadata))
    checker.check_model(model, full_check=True)
    return model


class _Graph:
    """Nodes and constants of a graph that is being written."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def add(self, kind: str, *inputs: str, outputs: Sequence[str] = (), **attributes: Any) -> str:
        """Add a node, with one output of its own if none are named. Return the name of the first."""
        from onnx import helper

        name = f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, outputs := outputs or (name,), name, **attributes))
        return outputs[0]

    def constant(self, name: str, value: object) -> str:
        """Add a constant. Return its name."""
        from onnx import numpy_helper

        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name


def _write_network(graph: _Graph, weights: Weights) -> None:
    """Write the nodes from the observation, and the state, to the residual, and the next state."""
    shape, features = weights.shape, "observation"
    if shape.standardised:
        centred = graph.add("Sub", features, graph.constant("mean", weights.arrays["mean"]))
        ratio = graph.add("Div", centred, graph.constant("deviation", weights.arrays["deviation"]))
        features = _cut(graph, ratio, "farthest", FARTHEST)
    if shape.gru:
        features = graph.add("Concat", features, _remembered(graph, weights, features), axis=1)
    elif shape.lstm:
        features = _remembered(graph, weights, features)
    for k, (matrix, offset) in enumerate(weights.layers()):
        weight, bias = graph.constant(f"weight_{k}", matrix), graph.constant(f"bias_{k}", offset)
        features = graph.add("Gemm", features, weight, bias, transB=1)
        if k < len(shape.hidden):
            features = graph.add(_ACTIVATIONS[shape.activation], features)
    if shape.squashed:
        graph.add("Tanh", features, outputs=["residual"])
    else:
        _cut(graph, features, "limit", 1.0, outputs=["residual"])


def _cut(graph: _Graph, features: str, name: str, most: float, outputs: Sequence[str] = ()) -> str:
    bounds = [graph.constant(f"{side}_{name}", np.float32(bound)) for side, bound in (("minus", -most), ("plus", most))]
    return graph.add("Clip", features, *bounds, outputs=outputs)


def _remembered(graph: _Graph, weights: Weights, features: str) -> str:
    """Write the GRU or LSTM, for one step. Return its hidden state, shape (n, width).

    ONNX has the gates of a GRU in the order z, r, n and those of an LSTM in the order i, o, f, g, and one axis for the
    steps before, and one for the directions beside the rows.
    """
    shape = weights.shape
    order, width = (1, 0, 2) if shape.gru else (0, 3, 1, 2), shape.remembered
    (weight_in, bias_in), (weight_hidden, bias_hidden) = weights.recurrent()

    def gates(rows: Singles) -> Singles:
        return np.concatenate([rows[gate * width : (gate + 1) * width] for gate in order])[None]

    first = graph.constant("first", np.array([0]))
    steps = graph.add("Unsqueeze", features, first)
    constants = [
        graph.constant("recurrent_weight", gates(weight_in)),
        graph.constant("hidden_weight", gates(weight_hidden)),
        graph.constant("recurrent_bias", np.concatenate([gates(bias_in), gates(bias_hidden)], axis=1)),
    ]
    if shape.gru:
        before = graph.add("Unsqueeze", "state", first)
        hidden = ["", "hidden"]
        graph.add("GRU", steps, *constants, "", before, outputs=hidden, hidden_size=width, linear_before_reset=1)
        return graph.add("Squeeze", "hidden", first, outputs=["next_state"])
    parts, states = ["hidden_before", "cell_before"], ["hidden", "cell"]
    graph.add("Split", graph.add("Transpose", "state", perm=[1, 0, 2]), outputs=parts, axis=0)
    graph.add("LSTM", steps, *constants, "", *parts, outputs=["", *states], hidden_size=width)
    graph.add("Transpose", graph.add("Concat", *states, axis=0), outputs=["next_state"], perm=[1, 0, 2])
    return graph.add("Squeeze", "hidden", first)
