from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import baselines
from baselines import CONTROLLERS, PaperController, PaperGains, rigid_controller
from baselines.servo.paper import TORSION, TORSION_RATE, next_torsion
from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmVectorEnv
from beltarm_env.observation import decode
from beltarm_env.rollout import rollout

ROOT = Path(__file__).parents[2]


def test_public_names_are_imported_on_first_use():
    """Commands import the package before they can say that a package is not installed."""
    code = (
        "import sys, baselines.tools.command\n"
        "print([name for name in ('control', 'matplotlib', 'baselines.registry') if name in sys.modules])\n"
        "from baselines import *\nprint(sorted(CONTROLLERS)[0], sorted(set(baselines.__all__) - set(globals())))\n"
    )
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (result.stdout, result.stderr) == ("[]\nadaptive []\n", "")
    with pytest.raises(AttributeError, match=r"'baselines'.*'Paper'"):
        _ = baselines.Paper


def observations(count: int = 6, steps: int = 300) -> np.ndarray:
    """What a few arms observe under random torques, shape (steps, count, size)."""
    env = BeltArmVectorEnv(count, randomization="ideal")
    seen = [env.reset(seed=5)[0]]
    torques = np.random.default_rng(0).uniform(-0.4, 0.4, (steps, count, 1)).repeat(10, axis=0)[:steps]
    seen += [env.step(torque)[0] for torque in torques]
    return np.stack(seen)


def test_first_torque_is_equation_11_with_table_2():
    seen = observations(steps=1)[0]
    action, memory = PaperController().predict(seen)
    told = decode(seen)
    u_1 = 88 * told["reference_acceleration"] + 20 * told["motor_speed_error"] + 25 * told["motor_angle_error"]
    torque = 6.3e-5 * u_1 + 3.5e-4 * told["motor_speed"] + 0.032 * np.sign(told["reference_speed"])
    np.testing.assert_allclose(action[:, 0], torque / 0.3, atol=1e-7)
    assert (memory[:, TORSION] == 0).all()


def test_vibration_feedback_is_k4_times_the_simulated_rate():
    paper, rigid = PaperController(), rigid_controller()
    of_paper = of_rigid = None
    for seen in observations():
        with_feedback, of_paper = paper.predict(seen, of_paper)
        without, of_rigid = rigid.predict(seen, of_rigid)
        free = (np.abs(with_feedback) < 1) & (np.abs(without) < 1)
        expected = without[:, 0] - 0.15 * of_paper[:, TORSION_RATE] / 0.3
        np.testing.assert_allclose(with_feedback[free[:, 0], 0], expected[free[:, 0]], atol=1e-6)
    assert of_paper is not None and np.abs(of_paper[:, TORSION_RATE]).max() > 0.01


def test_torsion_simulation_solves_the_arm_behind_the_belt():
    # Joint speed constant within each sample, as the simulation assumes; M2 at the joint angle, its slope left out.
    params = ArmParams(belt_damping_ratio=0.05)
    damping = 2 * 0.05 * np.sqrt(33 * 0.07)
    speeds = np.random.default_rng(1).uniform(-2, 2, 40)
    joint, last, torsion, rate, exact = 0.8, 0.0, 0.0, 0.0, np.zeros(2)
    for speed in speeds:
        joint += speed * CONTROL_PERIOD
        torsion, rate = next_torsion(torsion, rate, speed - last, joint, params.plant())
        m2 = 0.01 + 0.06 * np.sin(joint) ** 2
        exact[1] += speed - last
        motion = solve_ivp(
            lambda _, y, m2=m2: [y[1], -(33 * y[0] + damping * y[1]) / m2],
            (0, CONTROL_PERIOD),
            exact,
            rtol=1e-11,
            atol=1e-13,
        )
        exact, last = motion.y[:, -1], speed
    np.testing.assert_allclose([torsion, rate], exact, rtol=1e-8)


def test_simulated_torsion_follows_the_true_one_on_the_nominal_arm():
    env = BeltArmVectorEnv(8, autoreset_mode="Disabled")
    seen, _ = env.reset(seed=3)
    controller, memory = PaperController(), None
    true, simulated = [], []
    for _ in range(300):
        action, memory = controller.predict(seen, memory)
        true.append(env.state[:, 2])
        simulated.append(memory[:, TORSION])
        seen, *_ = env.step(action)
    error = np.std(np.array(true) - np.array(simulated))
    assert error < 0.3 * np.std(true)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_batch_is_so_many_single_controllers(name: str):
    seen = observations()
    controller = CONTROLLERS[name]()
    batch = None
    single = [None] * seen.shape[1]
    for step in seen:
        actions, batch = controller.predict(step, batch)
        for arm in range(len(step)):
            action, single[arm] = controller.predict(step[arm : arm + 1], single[arm])
            np.testing.assert_array_equal(action[0], actions[arm])


@pytest.mark.parametrize("name", CONTROLLERS)
def test_nothing_is_remembered_beyond_an_episode(name: str):
    first, second = observations(steps=50), observations(steps=50)[::-1]
    controller = CONTROLLERS[name]()
    memory = None
    for step in first:
        _, memory = controller.predict(step, memory)
    fresh = None
    for k, step in enumerate(second):
        start = np.full(len(step), k == 0)
        used, memory = controller.predict(step, memory, start)
        new, fresh = controller.predict(step, fresh, start)
        np.testing.assert_array_equal(used, new)


def test_gains_must_be_finite():
    with pytest.raises(ValueError, match=r"PaperGains.angle must be finite, got nan"):
        PaperGains(angle=float("nan"))


@pytest.mark.slow
def test_vibration_feedback_damps_the_nominal_arm_during_the_move():
    ringing = {
        name: rollout(make(), 64, seed=42, randomization="off").metrics()["tip_acc_rms"].mean()
        for name, make in CONTROLLERS.items()
    }
    assert ringing["paper"] < 0.8 * ringing["rigid"]


class Full:
    """Full torque, which drives the arm out of its workspace."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.ones((len(observation), 1), np.float32), state


def test_an_arm_that_leaves_its_workspace_stays_there_and_fails():
    run = rollout(Full(), 4, seed=0)
    metrics = run.metrics()
    assert not run.finished.any()
    assert (metrics["failure_share"] == 1).all() and (metrics["settling_s"] == 1.8).all()
    np.testing.assert_array_equal(run.state[-1], run.state[-2])
    assert (run.cost > 10_000).all()
    assert np.isfinite(run.tip_error).all()


GEARED = {"gear_ratio": 100.0, "torque_limit": 0.2}
"""Constants of another data sheet."""
EASY = {"start": 0.3, "goal": 0.9, "duration": 1.0, "ramp_time": 0.3}


class TestDataSheet:
    """Gear ratio and torque limit, which observations and actions are relative to."""

    @pytest.mark.parametrize("name", CONTROLLERS)
    def test_controller_made_for_an_arm_drives_it_as_the_nominal_one_its_own(self, name: str):
        known = CONTROLLERS[name]().params
        runs = {}
        for kind, arm in {"own": known, "geared": replace(known, **GEARED)}.items():
            options = {"move": EASY, "params": asdict(arm)}
            runs[kind] = rollout(CONTROLLERS[name](params=arm), 1, seed=0, options=options).metrics()
        for metric in ("tip_rms_mm", "cost"):
            np.testing.assert_allclose(runs["geared"][metric], runs["own"][metric], rtol=0.15)

    @pytest.mark.parametrize(("field", "value"), GEARED.items())
    def test_other_arms_are_refused(self, field: str, value: float):
        message = rf"arm 1 has {field} {value}, but PaperController is made for {getattr(ArmParams(), field)} .*"
        options = {"params": {field: [getattr(ArmParams(), field), value]}}
        with pytest.raises(ValueError, match=message + rf"params=ArmParams\({field}={value}\)"):
            rollout(PaperController(), 2, seed=0, options=options)

    def test_controller_that_is_made_for_no_arm_in_particular_takes_any(self):
        class Idle:
            def predict(self, observation, state=None, episode_start=None, deterministic=True):
                return np.zeros((len(observation), 1), np.float32), None

        assert rollout(Idle(), 1, seed=0, options={"params": GEARED}).params[0, 0] == 100.0


COSTS = """
import sys
from baselines import CONTROLLERS
from beltarm_env.rollout import rollout
for name in CONTROLLERS:
    if name not in sys.argv[1:]:
        print(name, rollout(CONTROLLERS[name](), 8, seed=7_000_000, randomization="train").cost.tolist())
"""


@pytest.mark.slow
def test_only_designs_that_are_said_to_depend_on_the_kernels_of_linear_algebra():
    """By kernels of this processor, and by those that all of its kind can run."""
    page = (ROOT / "docs" / "benchmark" / "protocol.md").read_text(encoding="utf-8")
    (named,) = re.findall(r"The designs of ([^.]*) do not", page)
    command = [sys.executable, "-c", COSTS, *re.findall(r"`(\w+)`", named)]
    found = {
        subprocess.run(
            command,
            env={**os.environ, "PYTHONPATH": str(ROOT), **kernels},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for kernels in ({}, {"OPENBLAS_CORETYPE": "Nehalem"})
    }
    assert len(found) == 1 and "adaptive" in found.pop()
