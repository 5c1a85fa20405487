"""The recipe of CONTRIBUTING.md takes no more files than it says."""

from pathlib import Path

import pytest
from recipes import follow, run

CODE = """
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


@pytest.mark.slow
def test_a_controller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    follow("Add a controller", tmp_path)
    assert run(tmp_path, "-c", CODE, compiled=False).split() == ["True"] * 5
