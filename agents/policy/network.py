"""A policy's network as it acts: its weights, computed row by row in one fixed order.

A library multiplies matrices in an order that depends on how many rows there are. The last digits of a residual are
then not the same in a batch and for one arm, and a torque that differs by 1e-9 N m can decide whether the motor sticks:
another episode follows. Here every sum is taken in the order of its terms,

    y_j = (...((b_j + w_1j x_1) + w_2j x_2) + ...)

in single precision without fused steps, and tanh is a quotient of polynomials in double precision. So a residual is the
same alone and in any batch, bit for bit. The kernel `evaluate` takes one row or several, which then share the weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.policy.weights import ACTIVATIONS, FARTHEST, Weights
from agents.residual.knowledge import cut
from baselines.reading import chosen, one_or_many
from beltarm_env.arrays import Flags, Singles
from beltarm_env.engine import compiled, in_threads, inlined
from beltarm_env.engine.blocks import none_taken, take_block, usual_threads

_TILE = 8  # rows that share the weights once they are loaded
_LEAST = 32  # rows for which it pays to wake a thread
_TERMS = 4  # of a sum at once
_LANES = 16  # numbers that a processor takes at once at most: rows begin at multiples of them, to be read faster
_FEEDFORWARD, _GRU, _LSTM = range(3)
_TANH, _RELU, _ELU = (ACTIVATIONS.index(name) for name in ("tanh", "relu", "elu"))
_MOST = 7.90531110763549805  # from here on tanh is 1 in single precision


class Network(NamedTuple):
    """Weights, as kernels read them."""

    weights: Singles  # matrices by input, each before its bias, the recurrent ones first
    widths: NDArray[np.int64]  # from the first layer's input on
    kind: int  # feedforward, GRU or LSTM
    memory_width: int  # of the GRU or LSTM
    activation: int  # place in `ACTIVATIONS`
    squashed: bool  # tanh at the end instead of a cut
    standardised: bool  # whether inputs are, by the following
    mean: Singles  # of the inputs, shape (k,)
    deviation: Singles  # likewise


class NetworkPolicy:
    """Policy by a network; `predict` is that of a Stable-Baselines3 policy, deterministic.

    Args:
        *weights: They are copied. Several of one shape each act on an equal share of the rows, in order.
        columns: Place of each of its inputs in the observation, which may have more entries; None for all in order.
        observed: Entries of the observation; by default as many as there are inputs.
    """

    def __init__(self, *weights: Weights, columns: Sequence[int] | None = None, observed: int | None = None) -> None:
        self.shape = shape = weights[0].shape
        self.observed = shape.inputs if observed is None else observed
        self.columns = np.arange(self.observed) if columns is None else np.array(columns)
        """Place of each input in the observation."""
        self.networks = tuple(map(_network, weights))
        self.memory = shape.memory
        """Shape of a row's memory."""
        self.widest = max(shape.gates, *shape.widths)
        """Width of the widest layer, gates side by side."""

    @one_or_many
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
            ValueError: If observations are not of shape (n, entries), or n is no multiple of the number of networks.
        """
        count, shares = len(observation), len(self.networks)
        if observation.ndim != 2 or observation.shape[1] != self.observed:
            raise ValueError(
                f"the policy observes {self.observed} entries, got shape {observation.shape}: run it with the "
                "--sensors that it was trained with"
            )
        if count % shares:
            raise ValueError(f"{shares} policies share rows equally, got {count}: give a multiple of {shares}")
        inputs = np.ascontiguousarray(observation.take(self.columns, axis=1), np.float32)
        memory = np.array(begun(state, episode_start, (count, *self.memory)), np.float32, order="C")
        residuals = np.empty((count, 1), np.float32)
        parts = (np.split(array, shares) for array in (inputs, memory.reshape(count, -1), residuals))
        for network, *rows in zip(self.networks, *parts, strict=True):
            taken = none_taken(usual_threads(count // shares // _LEAST))
            in_threads(_evaluate_tiles, len(taken), network, tuple(rows), self.widest, taken)
        return residuals, memory if self.shape.recurrent else None


def begun(state: Singles | None, start: Flags | None, shape: tuple[int, ...]) -> Singles:
    """Memory of a shape, rows first, which is zero where an episode begins: everywhere if there is none yet."""
    memory = np.zeros(shape, np.float32)
    if state is not None:
        if np.shape(state) != shape:
            raise ValueError(f"state must have shape {shape}, got {np.shape(state)}: begin with state=None")
        memory = state if start is None else chosen(start, memory, state)
    return memory


def _network(weights: Weights) -> Network:
    shape, blocks = weights.shape, [*weights.recurrent(), *weights.layers()]
    none = {"mean": np.zeros(shape.inputs, np.float32), "deviation": np.ones(shape.inputs, np.float32)}
    scales = weights.arrays if shape.standardised else none
    return Network(
        weights=np.concatenate([part for weight, bias in blocks for part in (weight.T.ravel(), bias)]),
        widths=np.array(shape.widths),
        kind=_LSTM if shape.lstm else _GRU if shape.gru else _FEEDFORWARD,
        memory_width=shape.memory_width,
        activation=ACTIVATIONS.index(shape.activation),
        squashed=shape.squashed,
        standardised=shape.standardised,
        mean=scales["mean"].copy(),
        deviation=scales["deviation"].copy(),
    )


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


class Layer(NamedTuple):
    """An affine layer of a network."""

    weights: Singles  # of all layers
    start: int  # where W begins in them, which b follows
    size: int  # entries of an input that count
    width: int  # and of an output


@compiled
def _affine(layer: Layer, inputs: Singles, outputs: Singles, rows: int) -> int:
    """Write b + x W into the first rows of outputs. Return where the next layer's weights begin."""
    weights, start, size, width = layer
    end = start + size * width
    bias = weights[end : end + width]
    for r in range(rows):
        for j in range(width):
            outputs[r, j] = bias[j]
    whole = size - size % _TERMS
    for k in range(0, whole, _TERMS):  # several terms at once, since a sum is read and written for each
        first = start + k * width
        w0, w1 = weights[first : first + width], weights[first + width : first + 2 * width]
        w2, w3 = weights[first + 2 * width : first + 3 * width], weights[first + 3 * width : first + 4 * width]
        for r in range(rows):
            x0, x1, x2, x3 = inputs[r, k], inputs[r, k + 1], inputs[r, k + 2], inputs[r, k + 3]
            for j in range(width):
                outputs[r, j] = outputs[r, j] + w0[j] * x0 + w1[j] * x1 + w2[j] * x2 + w3[j] * x3
    for k in range(whole, size):
        row = weights[start + k * width : start + (k + 1) * width]
        for r in range(rows):
            factor = inputs[r, k]
            for j in range(width):
                outputs[r, j] += row[j] * factor
    return end + width


@compiled
def _gru(width: int, of_input: Singles, of_memory: Singles, memory: Singles) -> None:
    """Step of a gated recurrent unit, as PyTorch has it: gates r, z and n side by side."""
    for r in range(len(memory)):
        for j in range(width):
            reset = _sigmoid(np.float64(of_input[r, j]) + np.float64(of_memory[r, j]))
            update = _sigmoid(np.float64(of_input[r, width + j]) + np.float64(of_memory[r, width + j]))
            new = _tanh(np.float64(of_input[r, 2 * width + j]) + reset * np.float64(of_memory[r, 2 * width + j]))
            memory[r, j] = (1 - update) * new + update * np.float64(memory[r, j])


@compiled
def _lstm(width: int, of_input: Singles, of_memory: Singles, memory: Singles) -> None:
    """Step of a long short-term memory, as PyTorch has it: gates i, f, g and o; hidden state, then cell state."""
    for r in range(len(memory)):
        for j in range(width):
            input_gate = _sigmoid(np.float64(of_input[r, j]) + np.float64(of_memory[r, j]))
            forget_gate = _sigmoid(np.float64(of_input[r, width + j]) + np.float64(of_memory[r, width + j]))
            new = _tanh(np.float64(of_input[r, 2 * width + j]) + np.float64(of_memory[r, 2 * width + j]))
            output_gate = _sigmoid(np.float64(of_input[r, 3 * width + j]) + np.float64(of_memory[r, 3 * width + j]))
            cell = forget_gate * np.float64(memory[r, width + j]) + input_gate * new
            memory[r, width + j] = cell
            memory[r, j] = output_gate * _tanh(cell)


@compiled
def evaluate(net: Network, inputs: Singles, memory: Singles, work: Singles, residuals: Singles) -> None:
    """Write the residuals of some rows, and their memories after them.

    Args:
        net: The network.
        inputs: Shape (rows, k). They are standardised in place.
        memory: Written; of a GRU shape (rows, width), of an LSTM (rows, 2 width). Else nothing in it counts.
        work: Space for two layers, shape (2, rows or more, `NetworkPolicy.widest` or more).
        residuals: Written, shape (rows, 1).
    """
    rows, size = inputs.shape
    if net.standardised:
        for r in range(rows):
            for k in range(size):
                inputs[r, k] = cut(float((inputs[r, k] - net.mean[k]) / net.deviation[k]), FARTHEST)
    start, last = 0, len(net.widths) - 1
    if net.kind != _FEEDFORWARD:
        gates = (4 if net.kind == _LSTM else 3) * net.memory_width
        start = _affine(Layer(net.weights, 0, size, gates), inputs, work[0], rows)
        start = _affine(Layer(net.weights, start, net.memory_width, gates), memory, work[1], rows)
        if net.kind == _LSTM:
            _lstm(net.memory_width, work[0], work[1], memory)
        else:
            _gru(net.memory_width, work[0], work[1], memory)
    seen = 0 if net.kind == _LSTM else size  # entries of the first layer that are inputs; the memory follows
    for r in range(rows):
        for k in range(seen):
            work[0, r, k] = inputs[r, k]
        for k in range(net.widths[0] - seen):
            work[0, r, seen + k] = memory[r, k]
    for layer in range(1, last + 1):
        width, outputs = net.widths[layer], work[layer % 2]
        affine = Layer(net.weights, start, net.widths[layer - 1], width)
        start = _affine(affine, work[(layer - 1) % 2], outputs, rows)
        if layer < last:
            for r in range(rows):
                for j in range(width):
                    outputs[r, j] = _activated(np.float64(outputs[r, j]), net.activation)
    for r in range(rows):
        output = np.float64(work[last % 2, r, 0])
        residuals[r, 0] = _tanh(output) if net.squashed else cut(output, 1.0)


@compiled
def _evaluate_tiles(
    thread: int, net: Network, rows: tuple[Singles, Singles, Singles], widest: int, taken: NDArray[np.int64]
) -> None:
    """Evaluate any number of rows of inputs, memory and residuals, see `evaluate`; some at a time share the weights.

    In threads, see `take_block`.
    """
    inputs, memory, residuals = rows
    count = len(inputs)
    work = np.empty((2, min(count, _TILE), -(-widest // _LANES) * _LANES), np.float32)
    while True:
        first = take_block(taken, thread, -(-count // _TILE)) * _TILE
        if first < 0:
            break
        tile = slice(first, min(first + _TILE, count))
        evaluate(net, inputs[tile], memory[tile], work, residuals[tile])
