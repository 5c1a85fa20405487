"""Policies that act together, and a residual as a kernel for one arm: what each does by itself, bit for bit."""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from bundles import new_weights
from refusals import refused

from agents.policy.bundle import POLICIES, BundleSpec, load_controller, save_bundle
from agents.policy.correction import Seen, correct, correction
from agents.policy.network import NetworkPolicy
from agents.residual.bases import make_base
from agents.residual.controller import ResidualController, ResidualSettings, combined
from baselines import CONTROLLERS
from baselines.reading import Sample, sample_of
from beltarm_env import BeltArmVectorEnv
from beltarm_env.observation import index, size
from beltarm_env.rollout import rollout
from eval.comparison import check
from eval.comparison.cache import Part, measure
from eval.comparison.methods import learned_methods
from eval.comparison.sets import development_set

SETTINGS = ResidualSettings()
NOTHING = Sample._make([*[0.0] * 11, 0, 0.0, 0.0])  # measured
SPECS = {
    "gru": BundleSpec("student", "adaptive", replace(SETTINGS, hold=3), (8,), "relu", gru=10, standardised=True),
    "standardised": BundleSpec("ppo", "adaptive", SETTINGS, (8, 6), "relu", standardised=True),
    "lstm": BundleSpec("recurrent_ppo", "paper", SETTINGS, (), "tanh", lstm=5),
    "told nothing": BundleSpec("ppo", "paper", ResidualSettings(0.8, 5, "none"), (8, 6), "elu"),
    "squashed": BundleSpec("sac", "rigid", SETTINGS, (8,), "relu", "accelerometer"),
    "by name": BundleSpec(
        *("ppo", "paper", SETTINGS, (16,)), inputs=("base_torque", "motor_speed", "believed_torsion", "holds_part")
    ),
}
SHARE = 2  # rows of each policy


def folders(name: str, seeds: int) -> list[Path]:
    return [POLICIES / name / f"seed{k}" for k in range(seeds)]


@pytest.mark.parametrize("name", ["ppo", "student"])
def test_each_has_its_own_rows_and_memory(name: str):
    several = load_controller(*folders(name, 2)).policy
    alone = [load_controller(folder).policy for folder in folders(name, 2)]
    rng, known = np.random.default_rng(0), cast(NetworkPolicy, several).networks[0]
    inputs = len(known.mean)
    memory, memories, residuals = None, [None] * 2, np.empty((0, 1), np.float32)
    for _ in range(6):
        seen = (known.mean + known.deviation * rng.uniform(-1, 1, (2 * SHARE, inputs))).astype(np.float32)
        begins = rng.random(2 * SHARE) < 0.3
        residuals, memory = several.predict(seen, memory, begins)
        for k, policy in enumerate(alone):
            own = slice(SHARE * k, SHARE * (k + 1))
            expected, memories[k] = policy.predict(seen[own], memories[k], begins[own])
            assert residuals[own].tobytes() == expected.tobytes()
    assert len({residual.tobytes() for residual in residuals}) == 2 * SHARE
    refused(ValueError, ("2 policies", "got 3"), lambda: several.predict(np.zeros((3, inputs), np.float32)))


def test_only_those_of_one_build_act_together(tmp_path: Path):
    small, other, wide = (tmp_path / name for name in "abc")
    for folder, hidden in ((small, 4), (other, 4), (wide, 5)):
        spec = BundleSpec("ppo", "paper", SETTINGS, (hidden,), provenance={"config": {"seed": 0, "out": folder.name}})
        save_bundle(folder, spec, new_weights(spec))
    load_controller(small, other)
    refused(ValueError, (str(wide), str(small), "each by itself"), lambda: load_controller(small, wide))
    for another, words in ((wide, "hidden (4,) and (5,)"), (other, "seed 0 and 0")):
        refused(ValueError, (str(another), words, "NAME=FOLDER"), lambda one=another: learned_methods([small, one]))


def test_a_comparison_runs_training_seeds_together():
    split, episodes = development_set().splits["sensing"].shortened(2), 3
    several = learned_methods(folders("student", 2))[0].with_guard()
    actual = measure(Part(several, split, episodes))
    assert actual["cost"].shape == (2, episodes)
    for seed in range(2):
        alone = rollout(several.controller(seed), episodes, **split.arguments(slice(episodes)))
        for name, values in alone.metrics().items():
            assert actual[name][seed].tobytes() == alone.over_moves(values).tobytes(), name


def lively(name: str) -> ResidualController:
    spec = SPECS[name]
    policy = NetworkPolicy(new_weights(spec, 0), columns=spec.columns(), observed=len(spec.offered()))
    return ResidualController(make_base(spec.base, spec.sensors), policy, spec.residual)


@pytest.mark.parametrize("name", SPECS)
def test_residuals_of_one_arm_are_the_controllers(name: str):
    """Two episodes of one arm, the second cut in where the first one's residual is held."""
    controller, sensors = lively(name), cast("Any", SPECS[name].sensors)
    kernel = correction(controller, sensors)
    for array in kernel.memory:  # whose content does not count
        array.fill(7)
    env, memory, residuals = BeltArmVectorEnv(1, sensors=sensors, randomization="train", profile="scurve"), None, []
    seen, _ = env.reset(seed=3)
    for step in range(40):
        begins = step in (0, 17)
        if step == 17:
            seen, _ = env.reset(seed=4)
        action, memory = controller.predict(seen, memory, np.array([begins]))
        assert memory.informed is not None
        base, reading = memory.informed.action[0, 0], memory.informed.reading
        now = NOTHING if reading is None else sample_of(reading, 0)
        residual = correct(
            kernel.design, Seen(seen[0], now, memory.informed.belief), base, begins, begins, kernel.memory
        )
        assert residual == memory.residual[0, 0]
        assert combined(base, residual, kernel.design.limit) == action[0, 0]
        residuals.append(residual)
        seen = env.step(action)[0]
    assert np.std(residuals) > 1e-4


@pytest.mark.parametrize("name", ["gru", "lstm", "told nothing"])
def test_its_memory_is_in_what_is_returned_and_begins_with_an_episode(name: str, monkeypatch: pytest.MonkeyPatch):
    """By the checks of a user's controller; with a move what a base forgets begins anew: amid the others' hold."""
    middle = 101
    monkeypatch.setattr(check, "_STEPS", 2 * middle)
    known = check.record(lively(name))
    for holds in (check._afresh, check._in_the_state):
        assert holds(lambda: lively(name), known) == "bit for bit"
    seen, starts = known.observations.copy(), known.starts.copy()
    seen[middle, 1, index("elapsed_time")], starts[middle, 1] = 0.0, True
    moved, begun = (check.replayed(lively(name), seen, each) for each in (known.starts, starts))
    assert np.array_equal(moved, begun) == (name == "told nothing")


def test_what_is_no_kernel_is_refused():
    other = ResidualController(make_base("paper"), CONTROLLERS["paper"](), SETTINGS)
    refused(TypeError, ("NetworkPolicy", "PaperController"), lambda: correction(other))
    words = (str(size() + 1), "'full'", str(size() + 3))
    refused(ValueError, words, lambda: correction(lively("told nothing"), "full"))
