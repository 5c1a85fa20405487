"""The MuJoCo model of the full arm against the derived equations, and `BeltArmMuJoCo-v0` beside the other engines."""

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import gymnasium as gym
import numpy as np
import pytest
from commands import ROOT, python
from driven_arms import GEAR, GIVES, UPPER_ENDS, apply, arm_env, at_rest, full_arm_at, push, random_params
from episodes import assert_as_alone
from gymnasium.utils.env_checker import check_env
from refusals import refused

from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import DRIVE_EFFECTS
from beltarm_env.arrays import Floats
from beltarm_env.task.ranges import DRIVE_RANGES
from eval.reference.event_located import EventLocatedArm, tip

mujoco: Any = pytest.importorskip("mujoco")

from beltarm_env.mujoco import renderer  # noqa: E402
from beltarm_env.mujoco.drive import EXPRESSIBLE  # noqa: E402
from beltarm_env.mujoco.model import load_model, read_state, write_state  # noqa: E402

NO_COULOMB = {"coulomb_friction": 0.0}


def mujoco_mass_matrix(model: Any, theta_1: float, phi: float) -> Floats:
    """Of (theta_1, phi), from that of MuJoCo's joints (theta_1, -2 phi)."""
    data = mujoco.MjData(model)
    data.qpos[:] = theta_1, -2 * phi
    mujoco.mj_forward(model, data)
    columns = np.zeros((2, 2))
    for column, unit in zip(columns, np.eye(2), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    jacobian = np.diag([1.0, -2.0])
    return jacobian @ columns @ jacobian


class TestModel:
    def test_mass_matrix_and_forces_are_the_derived_ones(self):
        rng = np.random.default_rng(0)
        for _ in range(30):  # with a hand beside link 2, or a pulley
            params = replace(random_params(rng), coulomb_friction=0.0)
            model, (theta_1, phi) = load_model(params), rng.uniform(-math.pi, math.pi, 2)
            derived = full_arm_at(params, theta_1, phi).mass_matrix()
            assert np.abs(mujoco_mass_matrix(model, theta_1, phi) - derived).max() < 1e-10 * np.abs(derived).max()
            # Same accelerations, so the same Coriolis, belt, friction and motor torques.
            state = np.array([params.gear_ratio * 0.5, 40.0, 0.05, 3.0]) * rng.uniform(-1, 1, 4)
            data, arm = mujoco.MjData(model), EventLocatedArm(params, state, "lagrangian")
            write_state(data, params, state)
            data.ctrl[0] = 0.2
            mujoco.mj_forward(model, data)
            assert data.qacc * [1, -0.5] == pytest.approx(arm.rates(0.2, 0.0)[0][2:], rel=1e-9)

    def test_state_energy_and_torque(self):
        params, state = ArmParams(arm_inertia_swing=0.09, payload_mass=0.1), np.array([61.0, -3.0, 0.04, 1.5])
        model = load_model(params)
        model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        data = mujoco.MjData(model)
        write_state(data, params, state)
        assert read_state(data, params) == pytest.approx(state, rel=1e-14)
        mujoco.mj_forward(model, data)
        assert data.ten_length == pytest.approx(0.04) and data.ten_velocity == pytest.approx(1.5)
        energy = EventLocatedArm(params, state, "lagrangian").energy
        assert data.energy.sum() == pytest.approx(energy, rel=1e-12)
        for error, limit in ((0.0, 0.2), (0.1, 0.22)):
            data = mujoco.MjData(load_model(ArmParams(torque_limit=0.2, torque_constant_error=error)))
            data.ctrl[0] = 5.0
            mujoco.mj_forward(data.model, data)
            assert data.qfrc_actuator[0] == pytest.approx(GEAR * limit)


def distance_of_engines(params: dict[str, float]) -> float:
    """Largest distance of the tips in the two engines [m], given the same commands."""
    engine, kernel = (arm_env(params, at_rest(math.pi / 4, 0.02), model) for model in ("mujoco", "lagrangian"))
    worst = 0.0
    for k in range(800):
        for env in (engine, kernel):
            apply(env, push(k))
        worst = max(worst, float(np.linalg.norm(tip(engine.params, engine.state) - tip(kernel.params, kernel.state))))
    return worst


DRIVES = [
    {name: UPPER_ENDS[name] for name in EXPRESSIBLE},
    {name: DRIVE_RANGES[name][0] for name in EXPRESSIBLE},
    {"command_latency": 3 * CONTROL_PERIOD},
    {"current_loop_time_constant": 0.01},
]


class TestEnvironment:
    def test_spaces_and_starts_are_those_of_the_other_models(self):
        env, other = gym.make("BeltArmMuJoCo-v0", randomization="ideal"), gym.make("BeltArm-v0", randomization="ideal")
        assert env.observation_space == other.observation_space and env.action_space == other.action_space
        for seed in (1, 2):
            np.testing.assert_array_equal(env.reset(seed=seed)[0], other.reset(seed=seed)[0])
        check_env(gym.make("BeltArmMuJoCo-v0").unwrapped, skip_render_check=True)

    @pytest.mark.parametrize("drive", DRIVES)
    def test_two_engines_agree_about_a_drive(self, drive: dict[str, float]):
        # Coulomb friction is soft in MuJoCo. Without it, what is left is the mean torque that stands for a lag.
        assert distance_of_engines({**NO_COULOMB, **drive}) < 2e-6
        assert distance_of_engines(drive) < 3e-4

    def test_arms_are_as_alone_and_drives_begin_anew_with_each_episode(self):
        settings: Any = {"randomization": {name: (0.5 * UPPER_ENDS[name], UPPER_ENDS[name]) for name in EXPRESSIBLE}}
        batch = gym.make_vec("BeltArmMuJoCo-v0", num_envs=2, autoreset_mode="SameStep", **settings).unwrapped
        assert isinstance(batch, BeltArmVectorEnv)
        singles: list[Any] = [gym.make("BeltArmMuJoCo-v0", **settings).unwrapped for _ in range(2)]
        actions = np.random.default_rng(0).uniform(0.2, 1.5, (300, 2, 1)).astype(np.float32)
        assert assert_as_alone(batch, singles, actions, 5) >= 2
        assert assert_as_alone(batch, [singles[1], singles[0]], actions[:60], 5) == 0, "after other episodes"

    def test_a_further_move_goes_on_with_the_motion_and_the_commands_on_their_way(self):
        """Beside the other engine: the motor turns at 20 rad/s there, and the arm puts its part down."""
        ranges = {name: (0.5 * UPPER_ENDS[name], UPPER_ENDS[name]) for name in EXPRESSIBLE}
        ranges |= {"coulomb_friction": (0.0, 0.0), "payload_mass": (0.3, 0.4)}
        arms = [BeltArmEnv(model=model, moves=2, randomization=ranges) for model in ("mujoco", "lagrangian")]
        for arm in arms:
            arm.reset(seed=3)
        for k in range(EPISODE_STEPS + 300):
            for arm in arms:
                arm.step(np.array([0.15 * math.sin(2 * math.pi * k / 150)], np.float32))
            assert np.abs(arms[0].state - arms[1].state)[[0, 2]].max() < 5e-5
            assert arms[0].motor_torque == pytest.approx(arms[1].motor_torque, abs=1e-6)
            assert k != EPISODE_STEPS - 1 or abs(arms[0].state[1]) > 20
        assert [(arm.move_number, arm.params.payload_mass) for arm in arms] == [(1, 0.0)] * 2

    def test_what_mujoco_cannot_express_is_refused(self):
        refused(ValueError, ("mujoco", "of its own"), lambda: BeltArmEnv(model="mujoco").set_integration_steps(4))
        for name in set(DRIVE_EFFECTS) - {*EXPRESSIBLE}:
            value = (UPPER_ENDS | GIVES)[name]
            ranges, words = {name: (0.0, value)}, ("mujoco", f" {name}={value:g}: ", '"ideal"', 'model="lagrangian"')
            refused(ValueError, words, lambda ranges=ranges: BeltArmEnv(model="mujoco", randomization=ranges))
            refused(ValueError, words[1:2], lambda given={name: value}: load_model(ArmParams(**given)))
        env = BeltArmVectorEnv(2, model="mujoco")
        env.reset(seed=1)
        before = env.state
        with pytest.raises(ValueError, match=r"mujoco.* torque_ripple=0\.006"):
            env.reset(seed=2, options={"params": {"torque_ripple": np.array([0.0, 0.006])}})
        np.testing.assert_array_equal(env.state, before)


def test_without_opengl_it_is_asked_for_once_and_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch):
    """MuJoCo aborts the process when it is asked a second time."""
    broken = Mock(side_effect=RuntimeError("no display"))
    monkeypatch.setattr(mujoco, "Renderer", broken)
    monkeypatch.setattr(renderer, "_no_opengl", [])
    for _ in range(2):
        env = gym.make("BeltArmMuJoCo-v0", render_mode="rgb_array")
        env.reset(seed=0)
        with pytest.raises(gym.error.DependencyNotInstalled, match=r"MUJOCO_GL=egl.*lagrangian"):
            env.render()
        env.close()
    assert broken.call_count == 1


PICTURES = """
import gymnasium, numpy as np, beltarm_env
env = gymnasium.make("BeltArmMuJoCo-v0", render_mode="rgb_array")
heights = []
for joint in (0.0, 0.8, 1.57):
    env.reset(seed=0, options={"state": [88 * joint, 0, 0, 0]})
    try:
        pixels = env.render()
    except gymnasium.error.DependencyNotInstalled as error:
        print("no GL:", error)
        raise SystemExit
    red, blue = pixels[..., 0].astype(int), pixels[..., 2].astype(int)
    print(pixels.shape, pixels.dtype, (blue > red + 60).sum() > 1000, (red > blue + 80).sum() > 30)
    heights.append(np.nonzero(blue > red + 60)[0].min())
print(heights[0] > heights[1] + 40)
"""
WITHOUT_MUJOCO = """
import sys
sys.modules["mujoco"] = None
import importlib.util
find_spec = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == "mujoco" else find_spec(name, *rest)
import gymnasium, beltarm_env
print("BeltArmMuJoCo-v0" in gymnasium.registry, "BeltArm-v0" in gymnasium.registry)
try:
    gymnasium.make("BeltArm-v0", model="mujoco")
except ModuleNotFoundError as error:
    print("beltarm-env[mujoco]" in str(error))
"""


def test_pictures_show_the_arm_where_it_is(tmp_path: Path):
    """In a process of its own: which OpenGL MuJoCo uses is settled when it is imported."""
    output = python("-c", PICTURES, cwd=tmp_path, path=(ROOT,), MUJOCO_GL=os.environ.get("MUJOCO_GL", "egl"))
    if output.startswith("no GL:"):
        pytest.skip(f"MuJoCo cannot draw here: {output}")
    assert output.splitlines() == [*["(480, 640, 3) uint8 True True"] * 3, "True"], "blue links, an orange tip"


def test_without_mujoco_it_is_not_registered_and_the_extra_is_named(tmp_path: Path):
    assert python("-c", WITHOUT_MUJOCO, cwd=tmp_path, path=(ROOT,)) == "False True\nTrue\n"
