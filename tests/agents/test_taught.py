"""PPO that goes on from a teacher's advice: what it begins with, what waits, a run that is stopped, its options."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from trainings import StopAfter, run, same_policies, tiny

from agents.learners.ppo import TAUGHT, PpoConfig
from agents.learners.taught import TaughtLearner
from agents.policy.bundle import load_controller, read_spec
from agents.policy.network import NetworkPolicy
from agents.runs.command_line import begun_options
from agents.runs.settings import task_of
from agents.runs.training import validate
from baselines.engines.parallel import Interrupted
from baselines.tools.options import parse


def taught(out: Path, **options: Any) -> PpoConfig:
    """Two rounds of a teacher for four arms, and four rollouts of PPO, in the first of which the actor waits."""
    own = {"teacher_rounds": 2, "teacher_arms": 4, "critic_steps": 64, "knowledge": "none", "moves": 1}
    return tiny("ppo", out, **{**own, **options})


def test_ppo_begins_with_what_the_teacher_taught(tmp_path: Path):
    """Its policy is the student's, its critic learns first, and then the actor does."""
    learner = run(taught(tmp_path / "waits", total_steps=64)).learner
    assert isinstance(learner, TaughtLearner)
    student, actor = learner.student.actor(), learner.actor()
    ours, theirs = (each.weights().arrays for each in (actor, student))
    assert np.abs(theirs["layers.2.weight"]).max() > 0 and np.abs(theirs["mean"]).max() > 0
    assert ours.keys() == theirs.keys() and all(np.array_equal(ours[name], theirs[name]) for name in ours)
    seen = learner.env.reset()
    expected, _ = learner.model.predict(seen, deterministic=True)
    np.testing.assert_allclose(NetworkPolicy(actor.weights()).predict(seen)[0], expected, atol=1e-6)
    learned = run(taught(tmp_path / "learns", total_steps=192)).learner.actor().weights().arrays
    assert np.array_equal(learned["mean"], theirs["mean"])
    assert not np.array_equal(learned["layers.0.weight"], theirs["layers.0.weight"])


def test_a_run_that_is_stopped_in_either_part_goes_on_as_if_it_had_not_been(tmp_path: Path):
    """And its policies are those of PPO."""
    config, stops = taught(tmp_path / "parts"), 0
    whole = run(replace(config, out=tmp_path / "whole"))
    spec, _ = read_spec(tmp_path / "whole/last")
    assert (spec.algorithm, spec.standardised, spec.gru) == ("ppo", True, 0)
    rounds = [0, 4 * 30, 2 * 4 * 30]  # of 4 arms with 30 holds
    assert [steps for steps, _, _ in whole.curve] == [*rounds, rounds[-1] + 128, rounds[-1] + 256]
    assert spec.provenance["run"]["steps"] == whole.learner.steps == whole.config.length
    assert validate(load_controller(tmp_path / "whole/last"), 4, task_of(1)) == spec.provenance["reached"]["validation"]
    for looks in (5, 30, 70, 72):
        try:
            run(replace(config, resume=stops > 0), StopAfter(looks))
        except Interrupted:
            stops += 1
        np.random.seed(5)  # noqa: NPY002
        torch.manual_seed(9)
    assert stops > 1
    run(replace(config, resume=True))
    assert same_policies(tmp_path / "whole", tmp_path / "parts")


def test_options_that_are_not_given_are_those_for_a_good_base():
    def read(*told: str) -> PpoConfig:
        return parse(PpoConfig, arguments=told, begun=begun_options)

    assert read() == PpoConfig() and read("--base", "adaptive") == PpoConfig(base="adaptive")
    config = read("--teacher-rounds", "3", "--gamma", "0.9")
    expected = {**TAUGHT, "hidden": tuple(TAUGHT["hidden"]), "teacher_rounds": 3, "gamma": 0.9}
    assert config == PpoConfig(**expected)
    student = config.student()
    assert (student.rounds, student.arms, student.gru_width) == (3, config.teacher_arms, 0)
    assert (student.hidden, student.residual_limit, student.torque_price) == ((128, 128), 0.5, 5.0)
