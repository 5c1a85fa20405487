"""What limits a shipped student: how it was trained, or what it cannot see.

Shipped students make shifts, and the teacher says by how much each of their torques should still change
(`agents.learners.teaching`). Networks like theirs are fitted to these changes d on most of the arms. Of the others they
predict the share 1 - sum w (d - d')^2 / sum w d^2. What cannot be predicted from what a student observes, no training
on the same advice can teach it.
"""

from functools import partial
from typing import Any

import numpy as np
import torch

from agents.learners.student import Student, StudentConfig
from agents.learners.teaching import Advice, Recorder, advise
from agents.policy.bundle import load_controller
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.seeds import ABLATIONS
from eval.comparison.methods import shipped_policies
from eval.comparison.rollouts import calls_side_by_side, side_by_side

TOLD = {
    "what the student observes": slice(0, 0),
    "that, and the true motion of motor and belt": slice(0, 3),
    "that, and the true constants of arm and drive": slice(3, None),
    "all of these": slice(0, None),
}
"""What networks are told, and the columns of the truth (`_truth`) in it."""
_FIRST = ABLATIONS.first + 5_000
_FIT = StudentConfig(rounds=1, epochs=6, learning_rate=2e-3)


def measure(arms: int, jobs: int | None) -> dict[str, Any]:
    """Measure the shares, with so many arms for each of the shipped students."""
    policies = [str(path) for path in shipped_policies(method="student")]
    found = side_by_side("advice", outstanding, [(path, k, arms) for k, path in enumerate(policies)], jobs)
    parts, truths = zip(*found.values(), strict=True)
    advice = Advice(*(torch.cat(part, dim=1) for part in zip(*parts, strict=True)))
    truth = np.concatenate(truths, axis=1)
    scaled = torch.from_numpy((truth - truth.mean(axis=(0, 1))) / np.maximum(truth.std(axis=(0, 1)), 1e-12)).half()
    seen = {told: torch.cat([advice.inputs, scaled[..., columns]], dim=2) for told, columns in TOLD.items()}
    calls = {told: partial(share_predicted, advice._replace(inputs=inputs)) for told, inputs in seen.items()}
    shares = calls_side_by_side("networks", calls, jobs)
    return {"arms": arms * len(policies), "policies": len(policies), "shares": shares}


def outstanding(policy: str, k: int, arms: int) -> tuple[Advice, Floats]:
    """By how much residuals of a policy should still change, as advice, and the truth about the arms that stayed."""
    controller, moves = load_controller(policy), _FIT.moves
    controller.policy = recorder = Recorder(controller.policy)
    run = rollout(controller, arms, seed=_FIRST + k * arms, randomization="train", moves=moves)
    advice, stayed = advise(run, recorder, controller.settings, _FIT.residual_price), run.stayed
    hold = controller.settings.hold
    now = torch.from_numpy(recorder.held(int(np.argmax(stayed)), hold)[1][:, stayed].astype(np.float32))
    return advice._replace(labels=advice.labels - now), _truth(run, hold)[:, stayed]


def _truth(run: Recording, hold: int) -> Floats:
    """Motor speed, torsion and its rate as each hold begins, and the arms' constants, shape (holds, arms, all)."""
    states = np.concatenate([np.zeros((1, run.num_arms, 4)), run.in_turn(run.state)])
    begins = np.arange(len(states) - 1).reshape(run.num_moves, -1)[:, ::hold].ravel()
    motion, moves = states[begins, :, 1:], map(run.of_move, range(run.num_moves))
    constants = np.repeat([move.params for move in moves], len(motion) // run.num_moves, axis=0)
    return np.concatenate([motion, constants], axis=2)


def share_predicted(advice: Advice) -> float:
    """Share of the advice on every fifth arm that a network predicts which is fitted to that on all others."""
    held_out = torch.arange(advice.labels.shape[1]) % 5 == 0
    student = Student(_FIT, advice.inputs.shape[2])
    student.advice = [Advice(*(part[:, ~held_out] for part in advice))]
    student.fit()
    unseen = Advice(*(part[:, held_out] for part in advice))
    with torch.no_grad():
        predicted = student.actor()(unseen.inputs.float())[..., 0]
    left = unseen.weights * (unseen.labels - predicted).square()
    return 1 - float(left.sum() / (unseen.weights * unseen.labels.square()).sum())
