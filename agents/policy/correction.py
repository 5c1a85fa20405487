"""A learned residual as a kernel for one arm: what `ResidualController` adds to its base, without its batches.

    every `hold` samples:   o = [observation, extra entries],  r = policy(o[columns])
    every sample:           action = combined(base's action, r, limit)

The base's own law, and the filter whose belief the agent observes, are kernels beside this one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.policy.network import Network, NetworkPolicy, evaluate
from agents.residual.controller import ResidualController
from agents.residual.knowledge import RECENT, ExtraEntries, offered, push_unexplained, write_belief, write_torque
from baselines.estimation.identification import ArmIdentifier, Belief
from baselines.reading import Sample
from beltarm_env.arrays import Floats, Singles
from beltarm_env.engine import compiled


class Correction(NamedTuple):
    """Constants of `correct`."""

    network: Network
    entries: ExtraEntries
    columns: NDArray[np.int64]  # place of each of the policy's inputs in what the agent observes
    hold: int  # samples per residual
    limit: float  # of `combined`: largest residual, as a share of the torque limit


class CorrectionMemory(NamedTuple):
    """Memory of `correct`; the last three hold nothing from one sample to the next."""

    recurrent: Singles  # the policy's, shape (1, numbers that it remembers)
    residual: Singles  # held, shape (1, 1)
    age: NDArray[np.int64]  # samples since the base began, shape (1,)
    unexplained: Floats  # angles of the last samples [rad], shape (RECENT,)
    seen: Singles  # what the agent observes, shape (size + entries,)
    inputs: Singles  # of the policy, shape (1, inputs)
    layers: Singles  # work of `evaluate`


class CorrectionKernel(NamedTuple):
    """What one arm needs beside the base's own law."""

    design: Correction  # for `correct` and `combined`
    memory: CorrectionMemory  # a template; nothing in it counts where an episode begins
    identifier: ArmIdentifier | None  # that runs beside the base; None if it has one, or none is observed


class Seen(NamedTuple):
    """What an agent may know at a sample."""

    observation: Singles  # of the environment, shape (size,)
    now: Sample  # what is measured
    belief: Belief | None  # None if the agent observes none


@compiled
def correct(
    design: Correction,
    seen: Seen,
    action: float,
    begins: bool,
    anew: bool,
    memory: CorrectionMemory,
) -> float:
    """Residual of one sample, from -1 to 1; with `combined` the action.

    Args:
        design: Constants.
        seen: What is known at this sample.
        action: Of the base: its torque over the limit, cut and in single precision.
        begins: Whether base and belief begin anew: with each move, if the base remembers nothing.
        anew: Whether an episode begins, and so the policy's memory.
        memory: Written.
    """
    observation, now, belief = seen
    if begins:
        memory.age[0] = 0
    if anew:
        memory.recurrent[:] = 0.0
    if belief is not None:
        push_unexplained(belief, 0, begins, memory.unexplained)
    if memory.age[0] % design.hold == 0:
        size = len(observation)
        for k in range(size):
            memory.seen[k] = observation[k]
        extra = memory.seen[size:]
        write_torque(design.entries, action, extra)
        if belief is not None:
            write_belief(design.entries, now, belief, 0, memory.unexplained, extra)
        for k in range(len(design.columns)):
            memory.inputs[0, k] = memory.seen[design.columns[k]]
        evaluate(design.network, memory.inputs, memory.recurrent, memory.layers, memory.residual)
    memory.age[0] += 1
    return memory.residual[0, 0]


def correction(controller: ResidualController, sensors: str = "encoder") -> CorrectionKernel:
    """Constants and memory with which `correct` gives the residuals of a controller on an arm with these sensors.

    Raises:
        TypeError: If the policy is no `NetworkPolicy` of one network.
        ValueError: If it was trained with other sensors.
    """
    policy, settings, informed = controller.policy, controller.settings, controller.informed
    size = len(offered(settings.knowledge, sensors))
    if not isinstance(policy, NetworkPolicy) or len(policy.networks) != 1:
        raise TypeError(f"a policy that is a kernel is a NetworkPolicy of one network, got {type(policy).__name__}")
    if size != policy.observed:
        raise ValueError(f"the policy observes {policy.observed} entries, with sensors={sensors!r} there are {size}")
    memory = CorrectionMemory(
        recurrent=np.zeros((1, max(1, int(np.prod(policy.memory)))), np.float32),  # C has no empty arrays
        residual=np.zeros((1, 1), np.float32),
        age=np.zeros(1, np.int64),
        unexplained=np.zeros(RECENT),
        seen=np.zeros(size, np.float32),
        inputs=np.zeros((1, policy.shape.inputs), np.float32),
        layers=np.zeros((2, 1, policy.widest), np.float32),
    )
    design = Correction(policy.networks[0], informed.entries, policy.columns, settings.hold, settings.limit)
    return CorrectionKernel(design, memory, informed.identifier)
