"""Policies that act together do what each does by itself, bit for bit."""

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from agents.policy.actor import Actor
from agents.policy.bundle import POLICIES, BundleSpec, load_controller, read_spec, save_bundle
from agents.policy.together import are_alike, load_together
from agents.residual.controller import ResidualSettings
from beltarm_env.rollout import rollout
from eval.comparison.cache import Part, measure
from eval.comparison.methods import Method, learned_methods
from eval.comparison.sets import development_set

SHARE = 2  # rows of each policy


def folders(name: str, seeds: int) -> list[Path]:
    return [POLICIES / name / f"seed{k}" for k in range(seeds)]


def method(name: str, seeds: int) -> Method:
    (found,) = learned_methods(folders(name, seeds))
    return found


@pytest.mark.parametrize("name", ["ppo", "student"])
def test_each_has_its_own_rows_and_memory(name: str):
    """Also where some rows begin an episode and others go on."""
    several = load_together(folders(name, 3))[0].policy
    alone = [load_controller(folder).policy for folder in folders(name, 3)]
    rng = np.random.default_rng(0)
    inputs = len(read_spec(folders(name, 1)[0])[0].offered())
    memory, memories = None, [None] * 3
    residuals = np.empty((0, 1), np.float32)
    for _ in range(6):
        seen = rng.uniform(-1, 1, (3 * SHARE, inputs)).astype(np.float32)
        begins = rng.random(3 * SHARE) < 0.3
        residuals, memory = several.predict(seen, memory, begins)
        for k, policy in enumerate(alone):
            own = slice(SHARE * k, SHARE * (k + 1))
            expected, memories[k] = policy.predict(seen[own], memories[k], begins[own])
            assert residuals[own].tobytes() == expected.tobytes()
    assert len({residual.tobytes() for residual in residuals}) == 3 * SHARE


def test_rows_that_cannot_be_shared_are_refused():
    several = load_together(folders("ppo", 2))[0].policy
    refused(
        ValueError, ("2 policies", "got 3", "multiple of 2"), lambda: several.predict(np.zeros((3, 25), np.float32))
    )


def bundle(folder: Path, hidden: tuple[int, ...]) -> Path:
    spec = BundleSpec("ppo", "paper", ResidualSettings(), hidden, provenance={"run": {"of": folder.name}})
    save_bundle(folder, spec, Actor(spec.shape()).weights())
    return folder


def test_only_those_of_one_build_act_together(tmp_path: Path):
    small, other, wide = bundle(tmp_path / "a", (4,)), bundle(tmp_path / "b", (4,)), bundle(tmp_path / "c", (5,))
    assert are_alike([small]) and are_alike([small, other]) and not are_alike([small, other, wide])
    assert load_together([small, other])[1].hidden == (4,)
    refused(ValueError, (str(wide), str(small), "each by itself"), lambda: load_together([small, wide]))
    (unlike,) = learned_methods([small, wide])
    assert unlike.batches(10) == [range(1), range(1, 2)]


def test_batches_stay_small():
    five = method("ppo", 5)
    assert five.batches(50) == [range(5)]
    assert five.batches(200) == [range(2), range(2, 4), range(4, 5)]
    assert five.batches(501) == [range(k, k + 1) for k in range(5)]


@pytest.mark.parametrize("guarded", [False, True])
def test_a_comparison_runs_training_seeds_together(guarded: bool):
    """On a split where delays and encoders are not the usual ones."""
    split, episodes = development_set().splits["sensing"], 3
    several = method("student", 2).with_guard() if guarded else method("student", 2)
    found = measure(Part(several, split, episodes))
    assert found["cost"].shape == (2, episodes)
    for seed in range(2):
        alone = rollout(several.controller(seed, []), episodes, **split.arguments(slice(episodes)))
        for name, values in alone.metrics().items():
            assert found[name][seed].tobytes() == values.tobytes(), name
