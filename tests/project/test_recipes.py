"""The recipes of CONTRIBUTING.md take no more files than they say."""

from pathlib import Path

import pytest
from recipes import ROOT, follow, recipe, run


def test_every_recipe_is_followed_here():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    titles = [line.removeprefix("### ") for line in text.splitlines() if line.startswith("### ")]
    assert titles == ["Add a controller", "Add a sensor", "Add a split", "Add an algorithm"]
    assert all(recipe(title) for title in titles)


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_a_controller(tmp_path: Path):
    follow("Add a controller", tmp_path)
    code = """
import numpy as np
from baselines import CONTROLLERS, TUNABLE
from beltarm_env.rollout import rollout
from eval.comparison.methods import classical_methods
from baselines.loops.models import loop_at
new, shaped = (rollout(CONTROLLERS[name](), 2, seed=0).metrics() for name in ("trapezoid", "zv"))
print(new["cost"].mean() < 3000, new["residual_pp_mm"].mean() > shaped["residual_pp_mm"].mean())
print("trapezoid" in TUNABLE, "trapezoid" in [method.name for method in classical_methods()])
print(loop_at(CONTROLLERS["trapezoid"](), 20).law.a.shape == (3, 3))
"""
    assert run(tmp_path, "-c", code, compiled=False).split() == ["True"] * 5


def test_a_sensor(tmp_path: Path):
    follow("Add a sensor", tmp_path)
    code = """
import gymnasium, numpy as np, beltarm_env
from beltarm_env.observation import decode
env = gymnasium.make("BeltArm-v0", sensors="gyro", delay=1)
observation, _ = env.reset(seed=0)
speeds, seen = [0.0], [decode(observation, "gyro")["arm_speed"]]
for _ in range(20):
    observation, *_ = env.step(np.ones(1, np.float32))
    arm = env.unwrapped
    speeds.append(arm.state[1] / arm.params.gear_ratio - arm.state[3])
    seen.append(decode(observation, "gyro")["arm_speed"])
print(np.allclose(seen[1:], speeds[:-1], atol=1e-6), speeds[-1] > 0.01, observation in env.observation_space)
"""
    assert run(tmp_path, "-c", code, compiled=False).split() == ["True"] * 3


def test_a_split(tmp_path: Path):
    follow("Add a split", tmp_path)
    code = """
import json
from beltarm_env.arm import COLUMN, NOMINAL
from eval.comparison.scenarios import RECORD
from eval.comparison.sets import development_set
from eval.comparison.splits import SPLITS
kept = {name: entry["sha256"] for name, entry in json.loads(RECORD.read_text())["splits"].items()}
splits = development_set().splits
split = splits["heavy-motor"]
ratio = split.table[:, COLUMN.motor_inertia] / NOMINAL.motor_inertia
print(1.2 <= ratio.min() < 1.21, 1.49 < ratio.max() <= 1.5, list(SPLITS)[-1] == "heavy-motor")
print(kept == {name: one.digest for name, one in splits.items() if name != "heavy-motor"})
"""
    assert run(tmp_path, "-c", code, compiled=False).split() == ["True"] * 4


@pytest.mark.slow
def test_an_algorithm(tmp_path: Path):
    follow("Add an algorithm", tmp_path)
    code = """
import runpy, sys
from pathlib import Path
sys.argv[1:] = "--total-steps 64 --arms 8 --validation-arms 1 --base paper --knowledge none --hidden 8 --hold 4".split()
runpy.run_path("train/a2c.py", run_name="__main__")
from agents.policy.bundle import load_controller, read_spec
controller = load_controller(Path("runs/a2c/best"))
spec, _ = read_spec(Path("runs/a2c/best"))
print("loaded", spec.algorithm)
"""
    out = run(tmp_path, "-c", code, compiled=False)
    assert "64 steps" in out and out.endswith("loaded a2c\n")
