"""`eval/crosscheck.py` and `eval/convergence.py`, as a user runs them and in their parts."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import mistake, stopped

pytest.importorskip("mujoco")

from beltarm_env.mujoco.drive import EXPRESSIBLE
from beltarm_env.task.ranges import DRIVE_RANGES
from eval import convergence, crosscheck
from eval.verification.convergence import STEPS, Convergence, measure_convergence, table
from eval.verification.crosscheck import SETTINGS, distance, motions
from eval.verification.event_located import EventLocatedArm, tip

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("regime", ["smooth", "moves", "stick-slip", "drive"])
def test_motions_of_each_regime(regime: str):
    (motion,) = motions(regime, 1, 4_000_000)
    assert np.ptp(motion.tips[:, 0]) > 0.01, "moves"
    assert (motion.stops == 0) == (regime == "smooth")
    assert (motion.params.coulomb_friction == 0) == (regime == "smooth")


def test_kernel_and_mujoco_agree_with_the_event_located_solution():
    (motion,) = motions("moves", 1, 4_000_003)
    arm = EventLocatedArm(motion.params, motion.start, "lagrangian")
    worst = 0.0
    for torque, there in zip(motion.torques.tolist(), motion.tips, strict=True):
        arm.sample(torque)
        worst = max(worst, float(np.linalg.norm(tip(arm.params, arm.state) - there)))
    assert worst < 1e-7
    assert distance(motion, 2, **SETTINGS["RK4"]) < 1e-4


def test_difference_shrinks_with_the_solver_settings():
    (motion,) = motions("stick-slip", 1, 4_000_000)
    own, no_creep, quick = (distance(motion, 2, **setting) for setting in list(SETTINGS.values())[3:])
    best = [distance(motion, steps, **SETTINGS["RK4"]) for steps in (1, 2, 4)]
    assert min(own, no_creep) > 2 * quick > 10 * best[0]
    assert best[0] > 2 * best[1] > 4 * best[2]


def test_difference_shrinks_behind_a_drive_too():
    (motion,) = motions("drive", 1, 4_000_000)
    assert all(getattr(motion.params, name) == DRIVE_RANGES[name][1] for name in EXPRESSIBLE)
    distances = [distance(motion, steps, **SETTINGS["RK4"]) for steps in (2, 4, 8)]
    assert 2e-5 > distances[0] > 2 * distances[1] > 4 * distances[2]


def test_smooth_motion_stays_within_a_tenth_of_a_millimetre():
    for motion in motions("smooth", 3, 4_000_000):
        assert distance(motion, 2, **SETTINGS["RK4"]) < 1e-7
        assert distance(motion, 16, **SETTINGS["implicitfast"]) < 1e-4


@pytest.mark.slow
def test_report_of_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert stopped(crosscheck.main, ("--arms", "1", "--out", "cross"), tmp_path) == (0, "")
    text = (tmp_path / "cross/summary.md").read_text(encoding="utf-8")
    assert text.strip() == capsys.readouterr().out.strip()
    assert text.count("| RK4 |") == 4 and "0.9999" in text
    assert (tmp_path / "cross/distance.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["crosscheck", "--arms", "0"], "--arms must lie within 1 and 1000, got 0"),
        (["crosscheck", "--seed", "-1"], "--seed must be at least 0, got -1"),
        (["crosscheck", "--out", "/proc/nowhere"], "cannot write to /proc/nowhere"),
        (["convergence", "--samples", "0"], "--samples must lie within 1 and 1200, got 0"),
    ],
)
def test_mistakes_get_one_line(tmp_path: Path, arguments: list[str], message: str):
    script, *rest = arguments
    main = {"crosscheck": crosscheck.main, "convergence": convergence.main}[script]
    line = mistake(main, tuple(rest), tmp_path)
    assert message in line and f"eval/{script}.py" in line


def test_missing_mujoco_is_one_line(tmp_path: Path):
    script = ROOT / "eval/crosscheck.py"
    code = f"""
import runpy, sys
sys.modules["mujoco"] = None
sys.argv = [{str(script)!r}]
runpy.run_path({str(script)!r}, run_name="__main__")
"""
    result = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 2
    assert result.stderr == "eval/crosscheck.py: the MuJoCo arm needs mujoco: pip install 'beltarm-env[mujoco]'\n"


@pytest.mark.parametrize("regime", ["stick-slip", "drive"])
def test_committed_report_is_what_the_command_measures(regime: str):
    text = (ROOT / "docs/results/physics/summary.md").read_text(encoding="utf-8")
    section = text.split(f"## {regime.capitalize()}")[1].split("\n## ")[0]
    (row,) = [line for line in section.splitlines() if line.startswith("| RK4 |")]
    seeds = re.search(r"seeds (\d+) to (\d+)", text)
    assert seeds is not None
    first, last = map(int, seeds.groups())
    worst = max(distance(motion, 2, **SETTINGS["RK4"]) for motion in motions(regime, last - first + 1, first))
    assert 1e3 * worst == pytest.approx(float(row.split("|")[3]), rel=0.06)


def test_committed_order_is_what_the_command_measures():
    text = (ROOT / "docs/science/physics.md").read_text(encoding="utf-8")
    (row,) = [line for line in text.splitlines() if line.startswith("| lumped | 11 stops |")]
    cells = [float(cell) for cell in row.split("|")[3:8]]
    result = measure_convergence("lumped", "stick-slip")
    np.testing.assert_allclose(1e9 * result.errors, cells[:4], rtol=0.06)
    assert result.orders.mean() == pytest.approx(cells[4], abs=0.01) and result.stops == 11


@pytest.mark.slow
def test_convergence_prints_every_model_and_regime(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert stopped(convergence.main, ("--samples", "60"), tmp_path) == (0, "")
    printed = capsys.readouterr().out
    for name, rows in {"lumped": 3, "lagrangian": 3, "smooth": 2, "stick-slip": 2, "drive": 2}.items():
        assert printed.count(name) == rows


def test_order_is_that_of_the_errors():
    errors = 1e-6 * 0.5 ** (3.0 * np.arange(len(STEPS)))
    result = Convergence("lumped", "smooth", errors.astype(np.float64), 0)
    np.testing.assert_allclose(result.orders, 3.0)
    assert table([result]).row_count == 1
