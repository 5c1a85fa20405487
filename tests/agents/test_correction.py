"""A learned residual as a kernel for one arm: the controller's numbers, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from agents.policy.actor import Actor
from agents.policy.bundle import POLICIES, BundleSpec, load_controller, read_spec
from agents.policy.correction import correct, correction
from agents.policy.inputs import SelectedInputs
from agents.policy.network import NetworkPolicy
from agents.residual.bases import make_base
from agents.residual.controller import ResidualController, ResidualSettings, combined
from agents.residual.knowledge import filters_of
from baselines.estimation.identification import ArmIdentifier
from baselines.reading import Sample, sample_of
from beltarm_env import BeltArmVectorEnv
from beltarm_env.observation import size

SETTINGS = ResidualSettings()
NOTHING = Sample._make([*[0.0] * 11, 0, 0.0])  # measured
SPECS = {
    "gru": BundleSpec("student", "adaptive", replace(SETTINGS, hold=3), (8,), "relu", gru=10, standardised=True),
    "lstm": BundleSpec("recurrent_ppo", "paper", SETTINGS, (), "tanh", lstm=5),
    "told nothing": BundleSpec("ppo", "paper", ResidualSettings(0.8, 5, "none"), (8, 6), "elu"),
    "squashed": BundleSpec("sac", "rigid", SETTINGS, (8,), "relu", "accelerometer"),
    "by name": BundleSpec(
        *("ppo", "paper", SETTINGS, (16,)), inputs=("base_torque", "motor_speed", "believed_torsion", "start")
    ),
}


def lively(spec: BundleSpec) -> ResidualController:
    torch.manual_seed(0)
    policy: Any = NetworkPolicy(Actor(spec.shape()).weights())
    if spec.inputs is not None:
        policy = SelectedInputs(policy, spec.inputs, spec.offered())
    return ResidualController(make_base(spec.base, spec.sensors), policy, spec.residual)


def assert_same(controller: ResidualController, sensors: Any, steps: int = 40) -> None:
    """Two episodes of one arm, the second cut in where the first one's residual is held."""
    kernel = correction(controller, sensors)
    for array in kernel.memory:  # whose content does not count
        array.fill(7)
    env, memory, residuals = BeltArmVectorEnv(1, sensors=sensors, randomization="train", profile="scurve"), None, []
    seen, _ = env.reset(seed=3)
    for step in range(steps):
        begins = step in (0, 17)
        if step == 17:
            seen, _ = env.reset(seed=4)
        action, memory = controller.predict(seen, memory, np.array([begins]))
        assert memory.informed is not None
        base, reading = memory.informed.action[0, 0], memory.informed.reading
        now = NOTHING if reading is None else sample_of(reading, 0)
        filters = None if memory.informed.belief is None else filters_of(memory.informed.belief)
        residual = correct(kernel.design, seen[0], base, now, filters, begins, kernel.memory)
        assert residual == memory.residual[0, 0]
        assert combined(base, residual, kernel.design.limit) == action[0, 0]
        residuals.append(residual)
        seen = env.step(action)[0]
    assert np.std(residuals) > 1e-4


@pytest.mark.parametrize("name", SPECS)
def test_residuals_of_one_arm_are_the_controllers(name: str):
    assert_same(lively(SPECS[name]), SPECS[name].sensors)


@pytest.mark.parametrize("name", ["ppo", "student"])
def test_so_they_are_for_shipped_policies(name: str):
    controller = load_controller(POLICIES / name / "seed0")
    spec, _ = read_spec(POLICIES / name / "seed0")
    assert_same(controller, spec.sensors, 200)


def test_a_filter_runs_beside_a_base_that_has_none():
    assert correction(lively(SPECS["gru"])).identifier is None
    assert correction(lively(SPECS["told nothing"])).identifier is None
    assert isinstance(correction(lively(SPECS["lstm"])).identifier, ArmIdentifier)


def test_what_is_no_kernel_is_refused():
    class Silent:
        def predict(self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True):
            return np.zeros((len(observation), 1), np.float32), state

    with pytest.raises(TypeError, match="NetworkPolicy, got Silent"):
        correction(ResidualController(make_base("paper"), Silent(), SETTINGS))
    entries = size() + 1
    with pytest.raises(ValueError, match=rf"observes {entries} entries, with sensors='full' there are {entries + 2}"):
        correction(lively(SPECS["told nothing"]), "full")
