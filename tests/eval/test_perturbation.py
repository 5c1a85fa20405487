"""Sensitive episodes: a first torque that differs by a hair, and what becomes of the cost."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines import PaperController
from beltarm_env.observation import size
from beltarm_env.rollout import rollout
from eval.comparison.cache import SENSITIVE, Part, keep, measure, read_kept
from eval.comparison.methods import classical_methods
from eval.comparison.perturbation import PERTURBATION, Perturbed, sensitive
from eval.comparison.sets import development_set


class Gives:
    """The torque that it is made with, times the number of the sample."""

    def __init__(self, torque: float) -> None:
        self.torque = torque

    def predict(self, observation, state=0, episode_start=None, deterministic=True):
        state = (state or 0) + 1
        return np.full((len(observation), 1), self.torque * state, np.float32), state


@pytest.mark.parametrize(("torque", "sign"), [(1.0, -1), (0.5, -1), (0.0, 1), (-0.5, 1), (-1.0, 1)])
def test_only_the_first_torque_differs_and_stays_within_the_limits(torque: float, sign: int):
    controller = Perturbed(Gives(torque))
    first, memory = controller.predict(np.zeros((2, size()), np.float32))
    assert (0.3 * (first - torque)).ravel() == pytest.approx(sign * PERTURBATION, rel=1e-6)
    second, _ = controller.predict(np.zeros((2, size()), np.float32), memory)
    assert second.ravel().tolist() == [2 * torque, 2 * torque]


def test_it_reaches_the_motor():
    run, own = rollout(Perturbed(PaperController()), 2, seed=1), rollout(PaperController(), 2, seed=1)
    assert np.abs(run.torque[0] - own.torque[0]) == pytest.approx(PERTURBATION, rel=1e-6)


def test_an_episode_is_sensitive_from_a_hundredth_of_its_cost_on():
    costs = np.array([100.0, 100.0, 100.0, 300.0])
    assert sensitive(costs, np.array([100.9, 101.1, 98.9, 300.0])).tolist() == [0, 1, 1, 0]


def test_a_part_that_was_kept_without_it_is_run_again(tmp_path: Path):
    (paper,) = (method for method in classical_methods() if method.name == "paper")
    part = Part(paper, development_set().splits["nominal"], 4)
    plain, perturbed = measure(part), replace(part, perturbed=True)
    keep(part, tmp_path, plain)
    assert read_kept(perturbed, tmp_path) is None
    more = measure(perturbed)
    assert more.pop(SENSITIVE).tolist() == [[0.0] * 4]
    assert all(np.array_equal(more[name], plain[name]) for name in plain)
