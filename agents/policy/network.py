"""A policy's network as it acts: an actor's numbers, computed row by row in one fixed order.

A library multiplies matrices in an order that depends on how many rows there are. The last digits of a residual are
then not the same in a batch and for one arm, and a torque that differs by 1e-9 N m can decide whether the motor sticks:
another episode follows. Here every sum is taken in the order of its terms,

    y_j = (...((b_j + w_1j x_1) + w_2j x_2) + ...)

in single precision without fused steps, and tanh is a quotient of polynomials in double precision. So a residual is the
same alone and in any batch, bit for bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from agents.policy.actor import ACTIVATIONS, FARTHEST, Actor, begun
from beltarm_env.arrays import Flags, Singles
from beltarm_env.jit import compiled, inlined

_TILE = 8  # rows that share the weights once they are loaded
_FEEDFORWARD, _GRU, _LSTM = range(3)
_TANH, _RELU, _ELU = (list(ACTIVATIONS).index(name) for name in ("tanh", "relu", "elu"))
_MOST = 7.90531110763549805  # from here on tanh is 1 in single precision


class NetworkPolicy:
    """Policy by the network of an actor; `predict` is that of a Stable-Baselines3 policy, deterministic.

    Args:
        actor: Whose weights are copied.
    """

    def __init__(self, actor: Actor) -> None:
        self.shape = actor.shape
        self._weights, self._widths = _packed(actor)
        self._activation = list(ACTIVATIONS).index(self.shape.activation)
        self._kind = _LSTM if self.shape.lstm else _GRU if self.shape.gru else _FEEDFORWARD
        self._memory = (2, self.shape.lstm) if self.shape.lstm else (self.shape.gru,)  # shape per row
        self._scales: tuple[Singles, Singles] | None = None
        if actor.shape.standardised:
            self._scales = _array(actor.mean), _array(actor.deviation)

    def predict(
        self,
        observation: Singles,
        state: Singles | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, Singles | None]:
        """Return residuals, shape (n, 1), and the memory: of an LSTM hidden and cell state, shape (n, 2, width).

        That of a GRU has shape (n, width), and a network without either has None.

        Raises:
            ValueError: If the observations are not of shape (n, inputs).
        """
        shape, count = self.shape, len(observation)
        if observation.ndim != 2 or observation.shape[1] != shape.inputs:
            raise ValueError(
                f"the policy observes {shape.inputs} entries, got shape {observation.shape}: run it with the "
                "--sensors that it was trained with"
            )
        inputs = np.ascontiguousarray(observation, np.float32)
        if self._scales is not None:
            mean, deviation = self._scales
            inputs = np.clip((inputs - mean) / deviation, -FARTHEST, FARTHEST)
        memory = np.ascontiguousarray(begun(state, episode_start, (count, *self._memory)), np.float32)
        residuals, following = _evaluate(
            inputs, memory.reshape(count, -1), self._weights, self._widths, self._kind, self._activation, shape.squashed
        )
        return residuals, following.reshape(count, *self._memory) if self._kind != _FEEDFORWARD else None


def _array(tensor: torch.Tensor) -> Singles:
    return tensor.detach().cpu().numpy().astype(np.float32, order="C")


def _packed(actor: Actor) -> tuple[Singles, NDArray[np.int64]]:
    """All weights, matrices by input and each before its bias, and the widths from the first layer's input on."""
    blocks: list[tuple[Any, Any]] = []
    recurrent = actor.lstm or actor.gru
    if recurrent is not None:
        of = dict(recurrent.named_parameters())
        blocks += [(of[f"weight_{kind}_l0"], of[f"bias_{kind}_l0"]) for kind in ("ih", "hh")]
    linear = [layer for layer in actor.layers if isinstance(layer, torch.nn.Linear)]
    blocks += [(layer.weight, layer.bias) for layer in linear]
    flat = [part for weight, bias in blocks for part in (_array(weight).T.ravel(), _array(bias))]
    widths = [linear[0].in_features, *(layer.out_features for layer in linear)]
    return np.concatenate(flat), np.array(widths)


@inlined
def _tanh(x: float) -> float:
    """Hyperbolic tangent, within 2e-7: an odd polynomial of degree 13 over an even one of degree 6.

    A library's may differ between its scalar and its vector variant. Coefficients: Eigen 3.4, `ptanh_float`.
    """
    x = min(max(x, -_MOST), _MOST)
    z = x * x
    odd = -2.76076847742355e-16
    odd = odd * z + 2.00018790482477e-13
    odd = odd * z - 8.60467152213735e-11
    odd = odd * z + 5.12229709037114e-08
    odd = odd * z + 1.48572235717979e-05
    odd = odd * z + 6.37261928875436e-04
    odd = odd * z + 4.89352455891786e-03
    even = 1.19825839466702e-06
    even = even * z + 1.18534705686654e-04
    even = even * z + 2.26843463243900e-03
    even = even * z + 4.89352518554385e-03
    return x * odd / even


@inlined
def _sigmoid(x: float) -> float:
    """Logistic function 1 / (1 + exp(-x))."""
    return 0.5 + 0.5 * _tanh(0.5 * x)


@inlined
def _activated(x: float, activation: int) -> float:
    """Activation of a hidden layer: tanh(x), max(x, 0), or exp(x) - 1 where x < 0."""
    if activation == _TANH:
        return _tanh(x)
    if activation == _RELU or x > 0:
        return max(x, 0.0)
    half = _tanh(0.5 * x)
    return 2 * half / (1 - half)


@compiled
def _affine(inputs: Singles, weights: Singles, start: int, outputs: Singles) -> int:
    """Write b + x W into rows of outputs; weights W, then b, begin at `start`. Return where the next ones begin."""
    size, width = inputs.shape[1], outputs.shape[1]
    bias = start + size * width
    outputs[:] = weights[bias : bias + width]
    for k in range(size):
        row = weights[start + k * width : start + (k + 1) * width]
        for r in range(len(inputs)):
            factor = inputs[r, k]
            for j in range(width):
                outputs[r, j] += row[j] * factor
    return bias + width


@compiled
def _gru(inputs: Singles, memory: Singles, weights: Singles, following: Singles) -> int:
    """Gated recurrent unit, as PyTorch has it: gates r, z and n side by side."""
    rows, width = memory.shape
    seen, remembered = np.empty((rows, 3 * width), np.float32), np.empty((rows, 3 * width), np.float32)
    start = _affine(inputs, weights, 0, seen)
    start = _affine(memory, weights, start, remembered)
    for r in range(rows):
        for j in range(width):
            reset = _sigmoid(np.float64(seen[r, j]) + np.float64(remembered[r, j]))
            update = _sigmoid(np.float64(seen[r, width + j]) + np.float64(remembered[r, width + j]))
            new = _tanh(np.float64(seen[r, 2 * width + j]) + reset * np.float64(remembered[r, 2 * width + j]))
            following[r, j] = (1 - update) * new + update * np.float64(memory[r, j])
    return start


@compiled
def _lstm(inputs: Singles, memory: Singles, weights: Singles, following: Singles) -> int:
    """Long short-term memory, as PyTorch has it: gates i, f, g and o side by side; hidden state, then cell state."""
    rows, width = len(memory), memory.shape[1] // 2
    seen, remembered = np.empty((rows, 4 * width), np.float32), np.empty((rows, 4 * width), np.float32)
    start = _affine(inputs, weights, 0, seen)
    start = _affine(memory[:, :width], weights, start, remembered)
    for r in range(rows):
        for j in range(width):
            taken = _sigmoid(np.float64(seen[r, j]) + np.float64(remembered[r, j]))
            kept = _sigmoid(np.float64(seen[r, width + j]) + np.float64(remembered[r, width + j]))
            new = _tanh(np.float64(seen[r, 2 * width + j]) + np.float64(remembered[r, 2 * width + j]))
            shown = _sigmoid(np.float64(seen[r, 3 * width + j]) + np.float64(remembered[r, 3 * width + j]))
            cell = kept * np.float64(memory[r, width + j]) + taken * new
            following[r, width + j] = cell
            following[r, j] = shown * _tanh(cell)
    return start


@compiled
def _evaluate(
    inputs: Singles,
    memory: Singles,
    weights: Singles,
    widths: NDArray[np.int64],
    kind: int,
    activation: int,
    squashed: bool,
) -> tuple[Singles, Singles]:
    """Residuals, shape (n, 1), and the memories after them."""
    count = len(inputs)
    residuals, following = np.empty((count, 1), np.float32), np.empty_like(memory)
    for first in range(0, count, _TILE):
        tile = slice(first, min(first + _TILE, count))
        seen, start = inputs[tile], 0
        now = np.empty((len(seen), widths[0]), np.float32)
        if kind == _GRU:
            start = _gru(seen, memory[tile], weights, following[tile])
            now[:, : seen.shape[1]] = seen
            now[:, seen.shape[1] :] = following[tile]
        elif kind == _LSTM:
            start = _lstm(seen, memory[tile], weights, following[tile])
            now[:] = following[tile][:, : widths[0]]
        else:
            now[:] = seen
        last = len(widths) - 1
        for layer in range(1, last + 1):
            outputs = np.empty((len(seen), widths[layer]), np.float32)
            start = _affine(now, weights, start, outputs)
            if layer < last:
                for r in range(len(outputs)):
                    for j in range(outputs.shape[1]):
                        outputs[r, j] = _activated(np.float64(outputs[r, j]), activation)
            now = outputs
        for r in range(len(now)):
            output = np.float64(now[r, 0])
            residuals[first + r, 0] = _tanh(output) if squashed else min(max(output, -1.0), 1.0)
    return residuals, following
