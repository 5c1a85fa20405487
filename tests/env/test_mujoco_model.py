"""The MuJoCo model of the full arm against the equations derived by SymPy and their event-located solution."""

import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from full_arms import full_arm, full_arm_at, some_params
from numpy.typing import NDArray

from beltarm_env import CONTROL_PERIOD, ArmParams
from eval.reference.event_located import tip

mujoco: Any = pytest.importorskip("mujoco")

from beltarm_env.mujoco.drive import Actuator  # noqa: E402
from beltarm_env.mujoco.model import load_model, place_hand, read_state, write_state  # noqa: E402

Floats = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
GEAR = 88.0
STEPS = 1200
NO_COULOMB = {"coulomb_friction": 0.0}
LOSSLESS = {"coulomb_friction": 0.0, "motor_viscous_friction": 0.0, "belt_damping_ratio": 0.0}


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


def wave(amplitude: float, frequency: float, offset: float = 0.0) -> Callable[[float], float]:
    return lambda time: offset + amplitude * math.sin(2 * math.pi * frequency * time)


def run_both(
    params: ArmParams, state: Floats, torque: Callable[[float], float], substeps: int = 2, **settings: Any
) -> tuple[float, list[tuple[str, str]]]:
    """Worst distance [m] of the two tips over an episode, and the friction modes passed."""
    model = load_model(params, CONTROL_PERIOD / substeps, **settings)
    data, arm, worst = mujoco.MjData(model), full_arm(params, state), 0.0
    write_state(data, params, state)
    for k in range(STEPS):
        data.ctrl[0] = torque(k * CONTROL_PERIOD)
        mujoco.mj_step(model, data, substeps)
        arm.advance(torque(k * CONTROL_PERIOD), CONTROL_PERIOD)
        worst = max(worst, float(np.linalg.norm(tip(params, read_state(data, params)) - tip(params, arm.state))))
    return worst, arm.mode_changes


# The model


def test_mass_matrix_is_the_derived_one():
    rng = np.random.default_rng(0)
    hands = pulleys = 0
    for _ in range(40):
        params = some_params(rng)
        hands += params.arm_inertia_swing > 6 * params.arm_inertia
        pulleys += params.arm_inertia_swing < 6 * params.arm_inertia
        model, (theta_1, phi) = load_model(params), rng.uniform(-math.pi, math.pi, 2)
        derived = full_arm_at(params, theta_1, phi).mass_matrix()
        assert np.abs(mujoco_mass_matrix(model, theta_1, phi) - derived).max() < 1e-10 * np.abs(derived).max()
    assert hands >= 10 and pulleys >= 10


@pytest.mark.parametrize(
    "extreme",
    [
        {"arm_inertia_swing": 0.0},
        {"arm_inertia_swing": 0.0, "payload_mass": 0.1},
        {"arm_inertia": 1e-6},
        {"motor_inertia": 1e-9},
        {"link_length": 1e-3},
        {"gear_ratio": 0.1},
        {"hand_length": 0.0, "coulomb_friction": 0.0},
    ],
)
def test_arms_far_from_the_nominal_one(extreme: dict[str, float]):
    params = ArmParams(**extreme)
    derived = full_arm_at(params, 0.3, 0.2).mass_matrix()
    assert mujoco_mass_matrix(load_model(params), 0.3, 0.2) == pytest.approx(derived, rel=1e-5)


def test_forces_are_the_derived_ones():
    # Same accelerations, so the same Coriolis, belt, friction and motor torques.
    rng = np.random.default_rng(1)
    for _ in range(20):
        params = replace(some_params(rng), coulomb_friction=0.0)
        state = np.array([params.gear_ratio * 0.5, 40.0, 0.05, 3.0]) * rng.uniform(-1, 1, 4)
        model = load_model(params)
        data, arm = mujoco.MjData(model), full_arm(params, state)
        write_state(data, params, state)
        data.ctrl[0] = 0.2
        mujoco.mj_forward(model, data)
        assert data.qacc * [1, -0.5] == pytest.approx(arm.rates(0.2, 0.0)[0][2:], rel=1e-9)


def test_energy_is_the_derived_one():
    params = ArmParams(arm_inertia_swing=0.09, payload_mass=0.1)
    model = load_model(params)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data, state = mujoco.MjData(model), np.array([50.0, 30.0, 0.05, -2.0])
    write_state(data, params, state)
    mujoco.mj_forward(model, data)
    assert data.energy.sum() == pytest.approx(full_arm(params, state).energy, rel=1e-12)


def test_the_file_alone_is_the_nominal_arm():
    file = mujoco.MjModel.from_xml_path(str(ROOT / "beltarm_env/mujoco/belt_arm.xml"))
    loaded = load_model(ArmParams())
    for field in (
        *("body_mass", "body_inertia", "body_pos", "body_ipos", "dof_armature", "dof_damping", "dof_frictionloss"),
        *("dof_solref", "dof_solimp", "tendon_stiffness", "tendon_damping", "actuator_gear", "actuator_ctrlrange"),
        *("geom_size", "geom_pos", "geom_quat", "geom_group", "site_pos"),
    ):
        assert getattr(file, field) == pytest.approx(getattr(loaded, field), rel=1e-9, abs=1e-9), field
    assert (file.opt.timestep, file.opt.integrator) == (loaded.opt.timestep, loaded.opt.integrator)


def test_state_goes_there_and_back():
    params, state = ArmParams(), np.array([61.0, -3.0, 0.04, 1.5])
    data = mujoco.MjData(load_model(params))
    write_state(data, params, state)
    assert read_state(data, params) == pytest.approx(state, rel=1e-14)
    mujoco.mj_forward(data.model, data)
    assert data.ten_length == pytest.approx(0.04) and data.ten_velocity == pytest.approx(1.5)


def test_torque_is_limited():
    data = mujoco.MjData(load_model(ArmParams(torque_limit=0.2)))
    data.ctrl[0] = 5.0
    mujoco.mj_forward(data.model, data)
    assert data.qfrc_actuator[0] == pytest.approx(GEAR * 0.2)
    stronger = mujoco.MjData(load_model(ArmParams(torque_limit=0.2, torque_constant_error=0.1)))
    stronger.ctrl[0] = 5.0
    mujoco.mj_forward(stronger.model, stronger)
    assert stronger.qfrc_actuator[0] == pytest.approx(GEAR * 0.22)


def test_steps_of_the_actuator():
    # Latency of 1.5 samples: each command acts from the middle of the next sample on. Means against fine integration.
    drive = {"current_loop_time_constant": 0.001, "torque_constant_error": 0.1}
    params = ArmParams(command_latency=1.5 * CONTROL_PERIOD, **drive)
    actuator, torque, fine = Actuator(params), 0.0, 20_000
    commands = [0.0, 0.0, 0.2, -0.1, 0.3]
    for before, now, command in zip(commands, commands[1:], commands[2:], strict=False):
        steps = list(actuator.means(command, CONTROL_PERIOD / 3))
        assert [dt for dt, _, _ in steps] == pytest.approx([CONTROL_PERIOD / 4] * 4, rel=1e-12)
        for k, (dt, count, mean) in enumerate(steps):
            target, total = 1.1 * (before if k < 2 else now), 0.0
            for _ in range(fine):
                middle = torque + 0.5 * dt / fine * (target - torque) / 0.001
                torque += dt / fine * (target - middle) / 0.001
                total += middle / fine
            assert count == 1 and mean == pytest.approx(total, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"timestep": 0.0}, "timestep must be finite and positive, got 0.0"),
        ({"timestep": math.nan}, "timestep must be finite and positive, got nan"),
        ({"friction_rate": -1.0}, "friction_rate must be finite and positive, got -1.0"),
        ({"friction_impedance": 1.0}, "friction_impedance must lie within 0.0001 and 0.9999, got 1.0"),
        ({"integrator": "rk5"}, "integrator must be one of euler, implicitfast, rk4, got 'rk5'"),
    ],
)
def test_settings_out_of_range(settings: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=message):
        load_model(ArmParams(), **settings)


def test_a_model_without_what_it_cannot_express_is_refused():
    with pytest.raises(ValueError, match=r"cannot express kinematic_error=0\.0003"):
        load_model(ArmParams(kinematic_error=0.0003))


# Its motion


@pytest.mark.parametrize(
    ("params", "torque"),
    [
        pytest.param(NO_COULOMB, wave(0.06, 3), id="no Coulomb friction"),
        pytest.param(LOSSLESS, wave(0.06, 3), id="no losses"),
        pytest.param({"payload_mass": 0.4}, wave(0.015, 4, offset=0.0536), id="the motor never stops"),
    ],
)
def test_smooth_motion(params: dict[str, float], torque: Callable[[float], float]):
    start = np.array([0.1 * GEAR, 0.6 * GEAR, 0.02, 0.0])
    worst, changes = run_both(ArmParams(**params), start, torque)
    assert "stuck" not in [mode for _, mode in changes]
    assert worst < 1e-8


def test_euler_is_of_first_order_and_rk4_of_fourth():
    start, params = np.array([0.7 * GEAR, 0.0, 0.03, 0.0]), ArmParams(**NO_COULOMB)
    for integrator, order in (("euler", 1), ("implicitfast", 1), ("rk4", 4)):
        coarse, fine = (run_both(params, start, wave(0.06, 3), n, integrator=integrator)[0] for n in (1, 2))
        assert math.log2(coarse / fine) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize(
    ("params", "torque"),
    [
        pytest.param({}, wave(0.06, 4), id="nominal"),
        pytest.param({}, wave(0.045, 4), id="barely breaking away"),
        pytest.param({"payload_mass": 0.5}, wave(0.058, 4), id="payload 0.5 kg"),
        pytest.param({"coulomb_friction": 0.1}, wave(0.15, 3), id="friction 3x"),
    ],
)
def test_stick_slip_motion(params: dict[str, float], torque: Callable[[float], float]):
    start = np.array([0.785 * GEAR, 0.0, 0.0, 0.0])
    worst, changes = run_both(ArmParams(**params), start, torque)
    assert sum(mode == "stuck" for _, mode in changes) >= 8
    assert worst < 3e-6
    # With the friction that MuJoCo has by default, the tip is two orders of magnitude further off.
    assert run_both(ArmParams(**params), start, torque, friction_impedance=0.9, friction_rate=95.0)[0] > 1e-4


@pytest.mark.parametrize(("impedance", "rate"), [(0.9, 100.0), (0.99, 100.0), (0.9999, 2000.0)])
def test_a_stuck_motor_creeps_as_documented(impedance: float, rate: float):
    params, torque = ArmParams(), 0.02
    model = load_model(params, friction_impedance=impedance, friction_rate=rate)
    data = mujoco.MjData(model)
    data.ctrl[0] = torque
    mujoco.mj_step(model, data, 2400)
    before = data.qpos[0]
    mujoco.mj_step(model, data, 2400)
    inverse_inertia = np.linalg.inv(full_arm_at(params, 0.0, 0.0).mass_matrix())[0, 0]
    creep = (1 - impedance) / rate * inverse_inertia * GEAR * torque
    assert (data.qpos[0] - before) / (2400 * model.opt.timestep) == pytest.approx(creep, rel=0.02)


# Pictures, and what comes without MuJoCo


def test_hand_and_reference_are_where_the_tips_are():
    params = ArmParams(link_length=0.3, hand_length=0.2)
    data = mujoco.MjData(load_model(params))
    write_state(data, params, np.array([0.8 * GEAR, 0.0, 0.05, 0.0]))
    place_hand(data, params, 0.5)
    assert data.site("tip").xpos[:2] == pytest.approx(tip(params, read_state(data, params)), abs=1e-12)
    assert data.site("joint_3").xpos[:2] == pytest.approx(data.body("hand").xpos[:2], abs=1e-12)
    assert data.body("reference").xpos == pytest.approx([0.6 * math.cos(0.5) + 0.2, 0, 0])


def test_pictures(tmp_path: Path):
    # In a process of its own: which GL MuJoCo uses is settled when it is imported.
    code = """
try:
    import mujoco
    mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8).close()
except Exception as error:
    print("no GL:", error)
    raise SystemExit
import numpy as np
from beltarm_env import ArmParams
from beltarm_env.mujoco.drive import Actuator  # noqa: E402
from beltarm_env.mujoco.model import load_model, place_hand, write_state
params = ArmParams()
data = mujoco.MjData(load_model(params))
renderer = mujoco.Renderer(data.model, 600, 800)
for joint in (0.0, 0.8, 1.57):
    write_state(data, params, np.array([88 * joint, 0, 0.02, 0]))
    place_hand(data, params, joint)
    mujoco.mj_forward(data.model, data)
    for camera in ("top", "slanted"):
        renderer.update_scene(data, camera=camera)
        pixels = renderer.render().astype(int)
        red, green, blue = pixels[..., 0], pixels[..., 1], pixels[..., 2]
        edge = np.concatenate([pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]])
        print((blue > red + 60).sum() > 1000, (red > blue + 80).sum() > 30, np.ptp(edge, axis=1).max() < 30)
renderer.close()
"""
    environment = {"MUJOCO_GL": "egl", **os.environ, "PYTHONPATH": str(ROOT)}
    result = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True)
    if result.stdout.startswith("no GL:"):
        pytest.skip(f"MuJoCo cannot draw here: {result.stdout}")
    assert result.returncode == 0, result.stderr
    assert result.stdout == "True True True\n" * 6, "blue links, an orange tip, and nothing of the arm cut off"


def test_a_warning_of_mujoco_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    data = mujoco.MjData(model := load_model(ArmParams()))
    data.qvel[0] = np.nan
    mujoco.mj_step(model, data)
    assert list(tmp_path.iterdir()) == []
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("MuJoCo: Nan, Inf or huge value in QVEL")


def test_missing_mujoco_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.delitem(sys.modules, "beltarm_env.mujoco.model")
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'beltarm-env\[mujoco\]'"):
        import beltarm_env.mujoco.model  # noqa: F401
