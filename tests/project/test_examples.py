"""The examples as a user runs them, with small budgets; `my_controller.py` is in `test_check_controller.py`."""

import re
from importlib.util import find_spec
from pathlib import Path

import pytest
from commands import ROOT, python

from agents.policy.bundle import read_spec

EXAMPLES = ROOT / "docs" / "examples"
NO_RLLIB = "RLlib has an environment of its own, see docs/examples/index.md"


def costs_in(output: str, pattern: str) -> list[float]:
    (found,) = re.findall(pattern, output)
    return [float(cost) for cost in found]


VALIDATED = r"validation arms: ([\d.]+) of paper alone, ([\d.]+) with the residual"


@pytest.mark.slow
def test_ppo_in_one_file_learns_and_saves_a_policy(tmp_path: Path):
    small = ("--num-envs", "32", "--num-steps", "32", "--minibatch-size", "128", "--total-timesteps", "20000")
    output = python(EXAMPLES / "cleanrl_ppo.py", *small, "--validation-arms", "16", cwd=tmp_path)
    before, after = costs_in(output, VALIDATED)
    assert after < 0.8 * before
    spec, _ = read_spec(tmp_path / "runs/cleanrl_ppo/policy")
    assert (spec.algorithm, spec.base, spec.residual.hold) == ("ppo", "paper", 4)
    assert spec.provenance["run"]["steps"] == 20480  # which the comparison shows beside other methods' samples
    assert spec.provenance["reached"]["validation"]["cost"] == pytest.approx(after, abs=0.1)


@pytest.mark.slow
def test_a_loop_of_python_control_beats_the_paper_by_half(tmp_path: Path):
    output = python(EXAMPLES / "control_loop.py", cwd=tmp_path)
    loop, paper = costs_in(output, r"this loop: cost (\d+).*\npaper: cost (\d+)")
    assert loop < 0.5 * paper
    delays = [float(delay) for delay in re.findall(r"delay margin ([\d.]+) samples", output)]
    assert len(delays) == 3 and min(delays) > 1


@pytest.mark.skipif(find_spec("ray") is None or find_spec("tree") is None, reason=NO_RLLIB)
def test_rllib_learns(tmp_path: Path):
    small = ("--iterations", "3", "--train-batch-size", "10240", "--validation-arms", "16")
    output = python(EXAMPLES / "rllib_ppo.py", *small, cwd=tmp_path)
    returns = [float(value) for value in re.findall(r"mean return (-[\d.]+)", output)]
    assert len(returns) == 3 and returns[-1] > returns[0]
    before, after = costs_in(output, VALIDATED)
    assert after < before
