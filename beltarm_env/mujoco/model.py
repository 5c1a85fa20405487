"""The full arm in MuJoCo: `belt_arm.xml` with the constants of one arm, and the state x in its coordinates.

MuJoCo's joints are q = (theta_1, -2 phi): the motor-side angle, and the angle by which the belt folds link 2 against
link 1. The belt is a tendon of length theta_1 - phi = theta_s.
"""

from __future__ import annotations

import math
import sys
from importlib.resources import as_file, files
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from beltarm_env.arm import ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.mujoco.drive import check_expressible
from beltarm_env.timing import CONTROL_PERIOD

try:
    import mujoco as compiled_mujoco
except ModuleNotFoundError as error:
    if error.name != "mujoco":
        raise
    raise ModuleNotFoundError("the MuJoCo arm needs mujoco: pip install 'beltarm-env[mujoco]'", name="mujoco") from None

if TYPE_CHECKING:
    MjData = MjModel = MjSpec = Any

mujoco: Any = compiled_mujoco  # its compiled modules have no type stubs


def _tell(warning: str) -> None:
    """Print a warning of MuJoCo's, which would else go into MUJOCO_LOG.TXT in the working folder too."""
    print(f"MuJoCo: {' '.join(warning.split())}", file=sys.stderr)


if mujoco.get_mju_user_warning() is None:
    mujoco.set_mju_user_warning(_tell)

# MuJoCo's integrators, and the rate of friction times the time step: a good part of what each is stable with.
_INTEGRATORS = {
    "euler": (mujoco.mjtIntegrator.mjINT_EULER, 1.0),
    "implicitfast": (mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 1.0),
    "rk4": (mujoco.mjtIntegrator.mjINT_RK4, 2.0),  # unstable from 2.79 on, the others from 2
}
_LEAST_IMPEDANCE, _LARGEST_IMPEDANCE = 0.0001, 0.9999  # MuJoCo cuts at these
_LEAST_ROD = 1e-6  # of the mass that M2(0) would allow: MuJoCo's joints need something to move


def load_model(
    params: ArmParams,
    timestep: float = CONTROL_PERIOD / 2,
    *,
    integrator: Literal["euler", "implicitfast", "rk4"] = "rk4",
    friction_impedance: float = _LARGEST_IMPEDANCE,
    friction_rate: float | None = None,
) -> MjModel:
    """Make the MuJoCo model of one full arm. Its only control is the motor torque [N m], at the motor's shaft.

    What comes before that torque, and the drift of friction, is the caller's: `engine.MuJoCoArm` has it.

    | of the arm | in MuJoCo |
    |---|---|
    | M_a1 | link 1, a rod of link 2's mass or what M_a1 allows; `armature` of joint 1: G^2 M_a1 less that rod |
    | M2(0), S | `link_2`, a uniform rod of mass m_2 = min(S / 2, 3 M2(0)) / l^2 |
    | what m_2 leaves of M2(0) | inertia M2(0) - S / 6 of the body `pulley`, which turns with link 2 |
    | what m_2 leaves of S; m_p | point masses (S - 6 M2(0)) / (4 l^2) and m_p in the body `load`, at joint 3 |
    | V_a1, tau_c | `damping` G^2 V_a1 and `frictionloss` G tau_c of joint 1 |
    | K_s, D_s | `stiffness` and `damping` of the tendon `belt` |
    | G, torque limit times 1 + k | `gear` and `ctrlrange` of the actuator `motor` |
    | l, l_3 | `pos` of `link_2` and `load`; the geoms |

    MuJoCo's dry friction is regularised. With impedance d and rate b, a motor that should stick creeps at

        theta_1' = (1 - d) a / b,

    a being the acceleration [rad/s^2] of theta_1 that the pull on a stretched arm would cause without friction. Near
    standstill friction grows with speed, so that stopping takes a time of 1 / b. The defaults leave as little of both
    as MuJoCo allows. What remains is of first order in the time step, from steps in which the motor reverses without
    sticking: friction jumps within them.

    Args:
        params: Constants of the arm.
        timestep: Integration step [s].
        integrator: MuJoCo's "euler" or "implicitfast", of first order, or "rk4", of fourth.
        friction_impedance: d, 0.0001 to 0.9999; MuJoCo's own default is 0.9.
        friction_rate: b [1/s]; by default 2 / timestep for "rk4", which is unstable from 2.79 on, and 1 / timestep
            for the others. MuJoCo's own default is about 100, a time constant of 0.02 s.

    Raises:
        ValueError: If a setting is out of range, or the arm has an effect of the drive that MuJoCo cannot express.
    """
    check_expressible(params.row()[None])
    if integrator not in _INTEGRATORS:
        raise ValueError(f"integrator must be one of {', '.join(_INTEGRATORS)}, got {integrator!r}")
    method, share = _INTEGRATORS[integrator]
    _check_positive("timestep", timestep)
    rate = share / timestep if friction_rate is None else friction_rate
    _check_positive("friction_rate", rate)
    if not _LEAST_IMPEDANCE <= friction_impedance <= _LARGEST_IMPEDANCE:
        allowed = f"within {_LEAST_IMPEDANCE} and {_LARGEST_IMPEDANCE}"
        raise ValueError(f"friction_impedance must lie {allowed}, got {friction_impedance!r}")
    with as_file(files("beltarm_env.mujoco") / "belt_arm.xml") as path:
        spec = mujoco.MjSpec.from_file(str(path))
    spec.option.timestep = timestep
    spec.option.integrator = method
    joint = spec.joint("joint_1")
    joint.solref_friction = [0.0, -rate]  # negative: a rate, not a time constant
    joint.solimp_friction[:2] = friction_impedance  # at any distance
    _set_motor(spec, params)
    _distribute_masses(spec, params)
    _stretch(spec, params)
    model = spec.compile()
    _set_damping_and_stiffness(model, params)
    return model


def _check_positive(name: str, value: float) -> None:
    if not 0 < value <= sys.float_info.max:
        raise ValueError(f"{name} must be finite and positive, got {value!r}")


def _set_motor(spec: MjSpec, params: ArmParams) -> None:
    spec.joint("joint_1").frictionloss = params.gear_ratio * params.coulomb_friction
    motor = spec.actuator("motor")
    motor.gear[0] = params.gear_ratio
    largest = (1 + params.torque_constant_error) * params.torque_limit
    motor.ctrlrange = [-largest, largest]


def _set_damping_and_stiffness(model: MjModel, params: ArmParams) -> None:
    # In the model, because their type in MjSpec differs from one MuJoCo to the next.
    model.dof_damping[0] = params.gear_ratio**2 * params.motor_viscous_friction
    model.tendon_stiffness[0] = params.belt_stiffness
    model.tendon_damping[0] = params.plant().damping


def _distribute_masses(spec: MjSpec, params: ArmParams) -> None:
    """Give the bodies the inertia that with a rigid belt is G^2 M_a1 + M2(0) + (S + 4 l^2 m_p) sin^2(phi)."""
    l2, m0, s = params.link_length**2, params.arm_inertia, params.arm_inertia_swing
    motor = params.gear_ratio**2 * params.motor_inertia
    rod = max(params.plant().link_inertia, _LEAST_ROD * m0) / l2
    _make_rod(spec, "link_2", rod, params.link_length)
    spec.body("pulley").inertia = np.array([0.5, 0.5, 1]) * max(m0 - rod * l2 / 3, 0.0)
    spec.body("load").mass = max(s / (4 * l2) - rod / 2, 0.0) + params.payload_mass
    link_1 = min(rod, 3 * motor / l2)
    _make_rod(spec, "link_1", link_1, params.link_length)
    spec.joint("joint_1").armature = max(motor - link_1 * l2 / 3, 0.0)


def _make_rod(spec: MjSpec, name: str, mass: float, length: float) -> None:
    body, across = spec.body(name), mass * length**2 / 12
    body.mass = mass
    body.ipos = [length / 2, 0, 0]
    body.inertia = [4e-4 * across, across, across]


def _stretch(spec: MjSpec, params: ArmParams) -> None:
    """Put joints and geoms where the arm's lengths have them."""
    length, hand = params.link_length, max(params.hand_length, 1e-6)  # MuJoCo draws no capsule without length
    spec.body("link_2").pos = spec.body("load").pos = [length, 0, 0]
    lengths = {"bar_1": length, "belt_left": length, "belt_right": length, "bar_2": length, "hand": hand}
    for name, end in lengths.items():
        geom = spec.geom(name)
        geom.fromto = [*geom.fromto[:3], end, *geom.fromto[4:]]
    for part in spec.geom("tip"), spec.site("tip"):
        part.pos = [params.hand_length, 0, part.pos[2]]
    if params.payload_mass > 0:
        spec.geom("payload").group = 0


def read_state(data: MjData, params: ArmParams) -> Floats:
    """Read the state x = [theta_a, omega_a, theta_s, omega_s] (rad, rad/s) off MuJoCo's positions and speeds."""
    (theta_1, fold), (omega_1, folding) = data.qpos.tolist(), data.qvel.tolist()
    gear = params.gear_ratio
    return np.array([gear * theta_1, gear * omega_1, theta_1 + 0.5 * fold, omega_1 + 0.5 * folding])


def write_state(data: MjData, params: ArmParams, state: Floats) -> None:
    """Set MuJoCo's positions and speeds from x = [theta_a, omega_a, theta_s, omega_s] (rad, rad/s)."""
    theta_1, omega_1 = state[0] / params.gear_ratio, state[1] / params.gear_ratio
    data.qpos[:] = theta_1, 2 * (state[2] - theta_1)
    data.qvel[:] = omega_1, 2 * (state[3] - omega_1)


def place_hand(data: MjData, params: ArmParams, reference_angle: float) -> None:
    """Put the hand at joint 3, and the mark of the reference at its tip, before a picture is taken.

    The hand has no mass and keeps the direction theta_s whatever link 2 does, so it is no part of the chain.

    Args:
        data: Where the arm is.
        params: Constants of the arm.
        reference_angle: Reference joint angle [rad].
    """
    mujoco.mj_kinematics(data.model, data)
    hand, mark = data.model.body("hand").mocapid[0], data.model.body("reference").mocapid[0]
    torsion = data.qpos[0] + 0.5 * data.qpos[1]
    data.mocap_pos[hand] = data.body("load").xpos
    data.mocap_quat[hand] = math.cos(0.5 * torsion), 0, 0, math.sin(0.5 * torsion)
    data.mocap_pos[mark] = 2 * params.link_length * math.cos(reference_angle) + params.hand_length, 0, 0
    mujoco.mj_kinematics(data.model, data)
    mujoco.mj_camlight(data.model, data)
