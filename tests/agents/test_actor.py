"""The acting part of a policy: sizes that are allowed, its outputs by NumPy, and weights taken from a library's."""

import re
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from agents.policy.actor import Actor, actor_of, standardised
from agents.policy.weights import ActorShape, Weights

INPUTS = 3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"hidden": (0,)}, "hidden layers must have a whole width from 1 to 1024, got 0"),
        ({"hidden": (4, 1025)}, "hidden layers must have a whole width from 1 to 1024, got 1025"),
        ({"hidden": (4, True)}, "got True"),
        ({"hidden": (4.0,)}, "got 4.0"),
        ({"hidden": (4,) * 9}, "at most 8 hidden layers, got 9"),
        ({"lstm": -1}, "the LSTM must have a whole width from 0 to 1024, got -1"),
        ({"gru": -1}, "the GRU must have a whole width from 0 to 1024, got -1"),
        ({"gru": 1025}, "got 1025"),
        ({"lstm": False}, "got False"),
        ({"lstm": 4, "gru": 5}, "an LSTM or a GRU, got both, of 4 and 5"),
        ({"activation": "gelu"}, "activation must be one of tanh, relu, elu, got 'gelu'"),
    ],
)
def test_sizes_that_are_not_allowed(change: dict[str, Any], words: str):
    with pytest.raises(ValueError, match=words):
        ActorShape(INPUTS, **{"hidden": (4,), **change})


@pytest.mark.parametrize(
    "change",
    [{"hidden": ()}, {"hidden": (1,) * 8}, {"hidden": (1024,)}, {"lstm": 1024}, {"gru": 1024}, {"activation": "elu"}],
)
def test_sizes_that_are(change: dict[str, Any]):
    ActorShape(INPUTS, **{"hidden": (4,), **change})


@pytest.mark.parametrize(("recurrent", "shape"), [({}, (0,)), ({"gru": 7}, (7,)), ({"lstm": 7}, (2, 7))])
def test_what_is_remembered_of_an_arm(recurrent: dict[str, Any], shape: tuple[int, ...]):
    assert ActorShape(INPUTS, (4,), **recurrent).memory == shape


def test_inputs_are_standardised_and_cut_at_five_deviations():
    inputs = torch.tensor([[1.0, -1.0, 40.0], [3.0, 0.0, -40.0]])
    found = standardised(inputs, torch.tensor([1.0, 1.0, 0.0]), torch.tensor([0.5, 4.0, 2.0]))
    assert found.tolist() == [[0.0, -0.5, 5.0], [4.0, -0.25, -5.0]]


@pytest.mark.parametrize("gru", [0, 2])
@pytest.mark.parametrize("hidden", [(), (4, 2)])
def test_outputs_are_those_of_the_layers_one_after_the_other(hidden: tuple[int, ...], gru: int):
    torch.manual_seed(0)
    actor = Actor(ActorShape(INPUTS, hidden, "relu", gru=gru, standardised=True)).requires_grad_(False)
    actor.mean[:], actor.deviation[:] = torch.tensor([1.0, 0.0, -1.0]), torch.tensor([0.5, 2.0, 1.0])
    seen = torch.randn(6, 2, INPUTS)  # samples, episodes, inputs
    z = np.clip((seen.numpy() - [1.0, 0.0, -1.0]) / [0.5, 2.0, 1.0], -5, 5)
    if actor.gru is not None:
        memories, _ = actor.gru(torch.tensor(z, dtype=torch.float32))
        z = np.concatenate([z, memories.numpy()], axis=-1)
    weights = [value.numpy() for value in actor.layers.state_dict().values()]
    for k, (weight, bias) in enumerate(zip(weights[::2], weights[1::2], strict=True)):
        z = z @ weight.T + bias
        z = z if k == len(hidden) else np.maximum(z, 0)
    assert z.shape == (6, 2, 1)
    np.testing.assert_allclose(actor(seen).numpy(), z, atol=1e-5)


def of_ppo(*widths: int) -> Any:
    """Policy of a library, as far as its actor goes."""
    layers = [part for pair in pairwise(widths) for part in (nn.Linear(*pair), nn.Tanh())]
    extractor = SimpleNamespace(policy_net=nn.Sequential(*layers))
    return SimpleNamespace(mlp_extractor=extractor, action_net=nn.Linear(widths[-1], 1))


def of_sac(*widths: int) -> Any:
    policy = of_ppo(*widths)
    return SimpleNamespace(actor=SimpleNamespace(latent_pi=policy.mlp_extractor.policy_net, mu=policy.action_net))


@pytest.mark.parametrize("of", [of_ppo, of_sac])
def test_weights_are_the_librarys(of: Any):
    policy = of(INPUTS, 4, 2)
    layers = (
        [*policy.mlp_extractor.policy_net, policy.action_net]
        if of is of_ppo
        else [*policy.actor.latent_pi, policy.actor.mu]
    )
    found = [layer for layer in actor_of(policy, ActorShape(INPUTS, (4, 2))).layers if isinstance(layer, nn.Linear)]
    for ours, theirs in zip(found, [layer for layer in layers if isinstance(layer, nn.Linear)], strict=True):
        assert torch.equal(ours.weight, theirs.weight) and torch.equal(ours.bias, theirs.bias)
        assert ours.weight.data_ptr() != theirs.weight.data_ptr() and not ours.weight.requires_grad


def test_weights_of_an_lstm_are_the_librarys():
    policy = of_ppo(5, 4)
    policy.lstm_actor = nn.LSTM(INPUTS, 5)
    actor = actor_of(policy, ActorShape(INPUTS, (4,), lstm=5))
    assert actor.lstm is not None
    for name, value in policy.lstm_actor.state_dict().items():
        assert torch.equal(actor.lstm.state_dict()[name], value)
    with pytest.raises(ValueError, match="does not have the layers"):
        actor_of(policy, ActorShape(5, (4,)))


@pytest.mark.parametrize(
    "shape",
    [
        ActorShape(INPUTS, (4,)),
        ActorShape(INPUTS, (4, 2, 2)),
        ActorShape(INPUTS, (2, 4)),
        ActorShape(INPUTS + 1, (4, 2)),
        ActorShape(INPUTS, (4, 2), lstm=INPUTS),
    ],
)
def test_layers_that_the_policy_does_not_have(shape: ActorShape):
    with pytest.raises(ValueError, match="does not have the layers"):
        actor_of(of_ppo(INPUTS, 4, 2), shape)


def test_weights_are_the_arrays_of_the_layers_and_no_others():
    shape = ActorShape(INPUTS, (4,), gru=2)
    arrays = Actor(shape).weights().arrays
    assert {name: array.shape for name, array in arrays.items()} == shape.arrays()
    for wrong, words in (
        ({name: array for name, array in arrays.items() if name != "gru.bias_hh_l0"}, "no array 'gru.bias_hh_l0'"),
        (arrays | {"layers.4.weight": np.zeros((1, 1), np.float32)}, "an array 'layers.4.weight', of no layer"),
        (arrays | {"layers.2.bias": np.zeros(1)}, "layers.2.bias is float64 of shape (1,)"),
        (arrays | {"layers.2.bias": np.zeros((1, 1), np.float32)}, "must be float32 of shape (1,)"),
    ):
        with pytest.raises(ValueError, match=re.escape(words)):
            Weights(shape, wrong)
