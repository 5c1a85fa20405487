"""Networks of policies with random weights, and inputs for them."""

import numpy as np
import torch

from agents.policy.actor import Actor
from agents.policy.weights import ActorShape
from beltarm_env.arrays import Singles

SHAPES = {
    "student": ActorShape(63, (96,), "relu", gru=96, standardised=True),
    "ppo": ActorShape(63, (256, 256), "relu"),
    "taught": ActorShape(63, (128, 128), "relu", standardised=True),
    "sac": ActorShape(30, (64, 64), "relu", squashed=True),
    "recurrent": ActorShape(27, (), "relu", lstm=33),
    "tanh": ActorShape(9, (17, 5), "tanh"),
    "elu": ActorShape(9, (17, 5), "elu", gru=3),
}


def lively(shape: ActorShape, seed: int = 0) -> Actor:
    """Actor with random weights, larger than those that training begins with."""
    torch.manual_seed(seed)
    actor = Actor(shape)
    for parameter in actor.parameters():
        parameter.data *= 1.5
    if shape.standardised:
        actor.mean, actor.deviation = torch.randn(shape.inputs), 0.2 + torch.rand(shape.inputs)
    return actor.requires_grad_(False)


def episodes(shape: ActorShape, count: int, steps: int = 12, seed: int = 0) -> Singles:
    return np.random.default_rng(seed).normal(0, 2, (steps, count, shape.inputs)).astype(np.float32)
