"""`BeltArmMuJoCo-v0`: the environment with MuJoCo as its engine."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("mujoco")

from driven_arms import UPPER_ENDS, push
from gymnasium.utils.env_checker import check_env

from baselines import PaperController
from beltarm_env import CONTROL_PERIOD, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import DRIVE_EFFECTS
from beltarm_env.mujoco.drive import EXPRESSIBLE
from beltarm_env.physics.drive import DRIVE_COLUMNS
from beltarm_env.rollout import rollout
from beltarm_env.task.ranges import DRIVE_RANGES
from eval.reference.event_located import tip

ROOT = Path(__file__).parents[2]
OPENGL = {"MUJOCO_GL": "egl", **os.environ, "PYTHONPATH": str(ROOT)}


def run(code: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """In a process of its own: which OpenGL MuJoCo uses is settled when it is imported."""
    return subprocess.run([sys.executable, "-c", code], cwd=cwd, env=OPENGL, capture_output=True, text=True)


def test_spaces_and_starts_are_those_of_the_other_models():
    env, other = gym.make("BeltArmMuJoCo-v0", randomization="ideal"), gym.make("BeltArm-v0", randomization="ideal")
    assert env.observation_space == other.observation_space and env.action_space == other.action_space
    for seed in (1, 2):
        np.testing.assert_array_equal(env.reset(seed=seed)[0], other.reset(seed=seed)[0])


def test_env_checker_finds_nothing():
    check_env(gym.make("BeltArmMuJoCo-v0").unwrapped, skip_render_check=True)


def test_two_engines_agree_under_the_papers_controller():
    settings: dict[str, Any] = {"seed": 3, "randomization": "ideal"}
    engine = rollout(PaperController(), 6, model="mujoco", **settings)
    kernel = rollout(PaperController(), 6, model="lagrangian", **settings)
    lumped = rollout(PaperController(), 6, model="lumped", **settings)
    np.testing.assert_array_equal(engine.moves, kernel.moves)
    # In closed loop an encoder count that falls the other way changes the torque: hence not nanometres.
    assert np.abs(engine.tip_error - kernel.tip_error).max() < 2e-4
    assert np.abs(engine.tip_error - lumped.tip_error).max() > 2e-3
    np.testing.assert_allclose(engine.metrics()["cost"], kernel.metrics()["cost"], rtol=0.01)


def test_batch_is_bit_for_bit_as_many_single_arms():
    batch = gym.make_vec("BeltArmMuJoCo-v0", num_envs=3, randomization="ideal")
    assert isinstance(batch.unwrapped, BeltArmVectorEnv)
    singles = [gym.make("BeltArmMuJoCo-v0", randomization="ideal") for _ in range(3)]
    batch.reset(seed=5)
    for arm, env in enumerate(singles):
        env.reset(seed=5 + arm)
    rng = np.random.default_rng(0)
    for _ in range(60):
        action = rng.uniform(-1.5, 1.5, (3, 1)).astype(np.float32)
        observations, rewards, *_ = batch.step(action)
        for arm, env in enumerate(singles):
            observation, reward, *_ = env.step(action[arm])
            np.testing.assert_array_equal(observation, observations[arm])
            assert reward == rewards[arm]


def test_episode_can_be_repeated_and_restarted():
    env = BeltArmEnv(model="mujoco", randomization="ideal")
    runs = []
    for seed in (4, 9, 4):
        env.reset(seed=seed)
        runs.append([env.step(np.array([0.4], np.float32))[1] for _ in range(50)])
    assert runs[0] == runs[2] != runs[1]


def test_state_and_parameters_can_be_set():
    env = BeltArmEnv(model="mujoco")
    state = np.array([60.0, 0.0, 0.05, 0.0])
    env.reset(options={"state": state, "params": {"belt_stiffness": 20.0}})
    np.testing.assert_allclose(env.state, state)
    env.step(np.zeros(1, np.float32))
    assert env.params.belt_stiffness == 20.0 and env.state[2] != state[2]


def test_frames_show_the_arm_where_it_is(tmp_path: Path):
    code = """
import gymnasium, numpy as np, beltarm_env
env = gymnasium.make("BeltArmMuJoCo-v0", render_mode="rgb_array")
frames = []
for joint in (0.1, 0.8):
    env.reset(seed=0, options={"state": [88 * joint, 0, 0, 0]})
    try:
        frames.append(env.render())
    except gymnasium.error.DependencyNotInstalled as error:
        print("no GL:", error)
        raise SystemExit
blue = [frame[..., 2].astype(int) > frame[..., 0].astype(int) + 60 for frame in frames]
heights = [np.nonzero(mask)[0].min() for mask in blue]
print(frames[0].shape, frames[0].dtype, all(mask.sum() > 1000 for mask in blue), heights[0] > heights[1] + 40)
env.close()
vector = gymnasium.make_vec("BeltArmMuJoCo-v0", num_envs=2, render_mode="rgb_array")
vector.reset(seed=0)
print(len(vector.render()))
vector.close()
"""
    result = run(code, tmp_path)
    if result.stdout.startswith("no GL:"):
        pytest.skip(f"MuJoCo cannot draw here: {result.stdout}")
    assert result.returncode == 0, result.stderr
    assert result.stdout == "(480, 640, 3) uint8 True True\n2\n"


def test_without_opengl_the_way_out_is_named(tmp_path: Path):
    code = """
import mujoco
attempts = []
def broken(*_):
    attempts.append(1)
    raise RuntimeError("no display")
mujoco.Renderer = broken
import gymnasium, beltarm_env
for _ in range(2):
    env = gymnasium.make("BeltArmMuJoCo-v0", render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(2):
        try:
            env.render()
        except gymnasium.error.DependencyNotInstalled as error:
            print(error)
    env.close()
print(len(attempts))
"""
    result = run(code, tmp_path)
    *messages, attempts = result.stdout.splitlines()
    assert len(messages) == 4 and attempts == "1", "MuJoCo aborts the process when asked a second time"
    assert all("MUJOCO_GL=egl" in message and "lagrangian" in message for message in messages), result.stderr


def test_without_a_display_nothing_aborts(tmp_path: Path):
    code = """
import gymnasium, beltarm_env
for _ in range(2):
    env = gymnasium.make("BeltArmMuJoCo-v0", render_mode="rgb_array")
    env.reset(seed=0)
    try:
        print(env.render().shape)
    except gymnasium.error.DependencyNotInstalled as error:
        print(error)
"""
    environment = {name: value for name, value in OPENGL.items() if name not in ("MUJOCO_GL", "DISPLAY")}
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert len(result.stdout.splitlines()) == 2


# The drive as it is built


def distance_of_engines(params: dict[str, float]) -> float:
    """Largest distance of the tips in the two engines [m], given the same commands over 1.8 s."""
    engine, kernel = BeltArmEnv(model="mujoco"), BeltArmEnv(model="lagrangian")
    options = {"params": params, "state": np.array([88 * np.pi / 4, 0.0, 0.02, 0.0])}
    engine.reset(seed=0, options=options)
    kernel.reset(seed=0, options=options)
    worst = 0.0
    for k in range(1200):
        action = np.array([push(k) / 0.3])
        assert not engine.step(action)[2] and not kernel.step(action)[2]
        worst = max(worst, float(np.linalg.norm(tip(engine.params, engine.state) - tip(kernel.params, kernel.state))))
    return worst


@pytest.mark.parametrize(
    "drive",
    [
        *({name: UPPER_ENDS[name]} for name in EXPRESSIBLE),
        *({"command_latency": samples * CONTROL_PERIOD} for samples in (0.3, 1.0, 2.7, 3.0)),
        *({"current_loop_time_constant": lag} for lag in (1e-4, 0.01)),
        {name: UPPER_ENDS[name] for name in EXPRESSIBLE},
        {name: DRIVE_RANGES[name][0] for name in EXPRESSIBLE},
    ],
)
def test_two_engines_agree_about_a_drive(drive: dict[str, float]):
    # Coulomb friction is soft in MuJoCo. Without it, what is left is the mean torque that stands for a lag.
    assert distance_of_engines({"coulomb_friction": 0.0, **drive}) < 2e-6
    assert distance_of_engines(drive) < 3e-4


def test_a_drive_begins_anew_with_each_episode():
    env = BeltArmEnv(model="mujoco", randomization={name: (UPPER_ENDS[name], UPPER_ENDS[name]) for name in EXPRESSIBLE})
    runs = []
    for _ in range(2):
        env.reset(seed=4)
        runs.append([env.step(np.array([0.4]))[1] for _ in range(50)])
    assert runs[0] == runs[1]


@pytest.mark.parametrize("name", [name for name in DRIVE_EFFECTS if name not in EXPRESSIBLE])
def test_what_mujoco_cannot_express_is_refused(name: str):
    value = UPPER_ENDS[name]
    message = rf'^model="mujoco" cannot express {name}={value:g}: .*randomization="ideal".*model="lagrangian"$'
    with pytest.raises(ValueError, match=message):
        BeltArmEnv(model="mujoco", randomization={name: (0.0, value)})
    env = BeltArmVectorEnv(2, model="mujoco")
    env.reset(seed=1)
    before = env.state
    with pytest.raises(ValueError, match=message):
        env.reset(seed=2, options={"params": {name: np.array([0.0, value])}})
    np.testing.assert_array_equal(env.state, before)
    assert not env.params_table[:, DRIVE_COLUMNS].any()


def test_training_ranges_are_refused_by_name():
    with pytest.raises(ValueError) as refusal:
        gym.make("BeltArmMuJoCo-v0", randomization="train")
    assert str(refusal.value) == (
        'model="mujoco" cannot express static_friction_excess=0.5, friction_variation=0.25, torque_ripple=0.006, '
        "kinematic_error=0.0003, belt_stiffening=0.25: set to 0 what it cannot, for example by "
        'randomization="ideal", or take model="lagrangian"'
    )


def test_mujoco_chooses_its_own_steps():
    env = BeltArmEnv(model="mujoco")
    env.reset(seed=0)
    with pytest.raises(ValueError, match='model="mujoco" takes steps of its own'):
        env.set_integration_steps(4)


def test_without_mujoco_it_is_not_registered_and_the_extra_is_named(tmp_path: Path):
    code = """
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
    print(error)
"""
    result = run(code, tmp_path)
    assert result.stdout.splitlines()[0] == "False True", result.stderr
    assert "pip install 'beltarm-env[mujoco]'" in result.stdout


def test_importing_the_package_does_not_import_mujoco(tmp_path: Path):
    code = """
import sys, gymnasium, beltarm_env
gymnasium.make("BeltArm-v0", model="lagrangian").reset()
print("mujoco" in sys.modules)
"""
    assert run(code, tmp_path).stdout == "False\n"
