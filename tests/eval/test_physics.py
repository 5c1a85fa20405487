"""The study of physics: its motions, and the kernel and MuJoCo beside the solution that locates every event."""

import sys
from pathlib import Path

import numpy as np
import pytest
from commands import mistake

pytest.importorskip("mujoco")

from beltarm_env.mujoco.drive import EXPRESSIBLE
from beltarm_env.task.ranges import DRIVE_RANGES
from eval import study
from eval.reference.event_located import EventLocatedArm, tip
from eval.studies.physics import REGIMES, SETTINGS, distance, motions


@pytest.mark.parametrize("regime", REGIMES)
def test_motions_of_each_regime(regime: str):
    (motion,) = motions(regime, 1, 4_000_000)
    assert np.ptp(motion.tips[:, 0]) > 0.01, "moves"
    assert (motion.stops == 0) == (motion.params.coulomb_friction == 0) == (regime == "smooth")


def test_kernel_and_mujoco_agree_with_the_event_located_solution():
    (motion,) = motions("moves", 1, 4_000_003)
    arm = EventLocatedArm(motion.params, motion.start, "lagrangian")
    worst = 0.0
    for torque, there in zip(motion.torques.tolist(), motion.tips, strict=True):
        arm.sample(torque)
        worst = max(worst, float(np.linalg.norm(tip(arm.params, arm.state) - there)))
    assert worst < 1e-7 and distance(motion, 2, **SETTINGS["RK4"]) < 1e-4


def test_difference_shrinks_with_the_solver_settings():
    (motion,) = motions("stick-slip", 1, 4_000_000)
    own, no_creep, quick = (distance(motion, 2, **setting) for setting in list(SETTINGS.values())[3:])
    best = [distance(motion, steps, **SETTINGS["RK4"]) for steps in (1, 2, 4)]
    assert min(own, no_creep) > 2 * quick > 10 * best[0] and best[0] > 2 * best[1] > 4 * best[2]
    (motion,) = motions("drive", 1, 4_000_000)
    assert all(getattr(motion.params, name) == DRIVE_RANGES[name][1] for name in EXPRESSIBLE)
    distances = [distance(motion, steps, **SETTINGS["RK4"]) for steps in (2, 4, 8)]
    assert 2e-5 > distances[0] > 2 * distances[1] > 4 * distances[2]
    (motion,) = motions("smooth", 1, 4_000_000)
    assert distance(motion, 2, **SETTINGS["RK4"]) < 1e-7
    assert distance(motion, 16, **SETTINGS["implicitfast"]) < 1e-4


def test_a_missing_package_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in [name for name in sys.modules if name.startswith("beltarm_env.mujoco.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert "mujoco" in mistake(study.main, ("physics", "--quick"), tmp_path)
