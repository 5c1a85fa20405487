"""Linear analysis of the paper's position servo, eqs. (6) to (11): poles, root loci and damping.

Coulomb friction is left out, as in the paper. With the feedforward of (8) taken as exact, the loop is

    x' = (A - b K) x,    K = [M_a1 K_p, M_a1 K_v - V_a1, 0, K_4],    K_p = omega_n^2,    K_v = 2 xi omega_n
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.loops.laws import torsion_feedback
from baselines.loops.models import Loop, closed_poles, continuous, law_system, sampled_arm, slowest_first
from baselines.servo.paper import PaperGains
from beltarm_env import ArmParams, state_space
from beltarm_env.arrays import Floats
from beltarm_env.physics.lumped import inverse_inertia

Poles = NDArray[np.complex128]
PAPER_ARM = ArmParams(belt_damping_ratio=0.0)
"""The nominal arm with the paper's undamped belt."""
LARGEST_K4 = 1.0
"""Largest K_4 [N m s/rad] that is looked at."""
_FREQUENCIES = (2.5, 5.0, 10.0, 15.0)  # omega_n [rad/s] at which the damping is shown


@dataclass(frozen=True, slots=True)
class ServoGains:
    """Gains as the paper states them; the defaults are Table 2."""

    k4: float = 0.15  # K_4      [N m s/rad]  of the torsional velocity; 0 switches vibration suppression off
    natural_frequency: float = 5.0  # omega_n  [rad/s]      of the position loop (10)
    damping: float = 2.0  # xi       [-]

    @property
    def feedback(self) -> PaperGains:
        """K_4, K_p and K_v of these gains."""
        return PaperGains(self.k4, self.natural_frequency**2, 2 * self.damping * self.natural_frequency)

    @property
    def without_and_with(self) -> tuple[ServoGains, ServoGains]:
        """The gains with K_4 = 0, and as they are."""
        return replace(self, k4=0.0), self


TABLE_2 = ServoGains()


def feedback_row(arm: ArmParams, gains: ServoGains) -> Floats:
    """K of u = -K x, shape (1, 4)."""
    k, inertia = gains.feedback, arm.motor_inertia
    return np.array([[inertia * k.angle, inertia * k.speed - arm.motor_viscous_friction, 0.0, k.torsion_speed]])


def closed_loop(
    arm: ArmParams, theta_1: float, gains: ServoGains, *, as_printed: bool = False, model: str = "lumped"
) -> Floats:
    """A - b K of the loop at joint angle `theta_1` [rad], shape (4, 4).

    Args:
        arm: The arm, known exactly to the controller.
        theta_1: Joint angle [rad], 0 to pi/2.
        gains: Feedback gains.
        as_printed: Take the last entry of b with the sign printed in (6e), which is wrong.
        model: Whose equations of motion the arm has.
    """
    a, b, _ = state_space(arm, theta_1, model)
    if as_printed:
        b[3] *= -1
    return a - b @ feedback_row(arm, gains)


def poles(a: Floats) -> Poles:
    """Eigenvalues [1/s], slowest first."""
    return slowest_first(np.linalg.eigvals(a).astype(np.complex128))


def locus(theta_1: float, gains: ServoGains, name: str, values: Floats) -> Poles:
    """Poles [1/s] of the paper's loop over one gain with the others kept, Fig. 6; shape (len(values), 4)."""
    varied = [replace(gains, **{name: value}) for value in values.tolist()]
    return np.array([poles(closed_loop(PAPER_ARM, theta_1, each)) for each in varied])


def dominant_damping(values: Poles) -> Floats:
    """Smallest damping ratio -Re/|pole| over the last axis: 1 if all poles are real and stable, 0 for one at 0."""
    size = np.abs(values)
    return np.divide(-values.real, size, out=np.zeros(values.shape), where=size > 0).min(axis=-1)


def damping_map(gains: ServoGains, k4: Floats, m2: Floats) -> Floats:
    """Dominant damping ratio of the paper's loop over K_4 [N m s/rad] and M2 [kg m^2], shape (len(m2), len(k4))."""
    rows = []
    for inertia in m2.tolist():
        arm = replace(PAPER_ARM, arm_inertia=inertia, arm_inertia_swing=0.0)
        loops = np.tile(closed_loop(arm, 0.0, replace(gains, k4=0.0)), (len(k4), 1, 1))
        loops[:, :, 3] -= k4[:, None] * state_space(arm, 0.0)[1][:, 0]
        rows.append(dominant_damping(np.linalg.eigvals(loops).astype(np.complex128)))
    return np.array(rows)


def best_gain(gains: ServoGains, m2: float) -> tuple[float, float]:
    """K_4 [N m s/rad] of the largest dominant damping at M2 [kg m^2], within its range, and that damping ratio."""
    k4 = np.linspace(0, LARGEST_K4, 1001)
    damping = damping_map(gains, k4, np.array([m2]))[0]
    return float(k4[damping.argmax()]), float(damping.max())


def sampled_poles(arm: ArmParams, theta_1: float, gains: ServoGains) -> Poles:
    """Poles [1/s] of the loop with torque held over the control period and all states measured: ln(z) / period."""
    sampled = sampled_arm(arm, theta_1)
    closed = sampled.a[:4, :4] - sampled.b[:4, None] @ feedback_row(arm, gains)
    return continuous(np.linalg.eigvals(closed).astype(np.complex128))


def digital_poles(arm: ArmParams, theta_1: float, gains: ServoGains, *, model: str = "lumped") -> Poles:
    """Poles [1/s] of the loop as a drive runs it: torque held, speed by differencing, torsion simulated from it.

    Encoder resolution is left out. The simulation is that of the lumped arm, whatever `model` the arm itself has.
    """
    law = law_system(torsion_feedback(arm, theta_1, arm.motor_inertia, gains.feedback))
    return continuous(closed_poles(Loop(law, sampled_arm(arm, theta_1, model))))


def nominal_m2(angle: float, payload: float = 0.0) -> float:
    """M2 [kg m^2] of the nominal arm at an angle [rad], with a payload [kg]."""
    return 1 / inverse_inertia(math.cos(angle), ArmParams(payload_mass=payload).plant())[2]


MARKED_ARMS = {"0°": nominal_m2(0.0), "90°": nominal_m2(np.pi / 2), "90°, payload 0.2 kg": nominal_m2(np.pi / 2, 0.2)}
"""M2 [kg m^2] for which the best K_4 is shown."""


def linear_numbers(gains: ServoGains) -> dict[str, Any]:
    """Poles of the loop and of its variants, dampings on the full arm, best K_4, and damping over omega_n."""
    (off, _), ends, full = gains.without_and_with, np.radians([0, 90]), []
    for angle in np.radians([0, 45, 90]):
        measured = [poles(closed_loop(PAPER_ARM, angle, each, model="lagrangian")) for each in (off, gains)]
        simulated = digital_poles(PAPER_ARM, angle, gains, model="lagrangian")
        dampings = [dominant_damping(values) for values in (*measured, simulated)]
        full.append({"angle": angle, "dampings": dampings, "pairs": parts(simulated[np.abs(simulated.imag) > 1e-6])})
    best = [(name, m2, *best_gain(gains, m2)) for name, m2 in MARKED_ARMS.items()]
    over_frequency = dominant_damping(locus(np.pi / 2, gains, "natural_frequency", np.array(_FREQUENCIES)))
    variants = {
        "off": [poles(closed_loop(PAPER_ARM, angle, off)) for angle in ends],
        "on": [poles(closed_loop(PAPER_ARM, angle, gains)) for angle in ends],
        "printed": [poles(closed_loop(PAPER_ARM, angle, gains, as_printed=True)) for angle in ends],
        "damped": [poles(closed_loop(ArmParams(), angle, gains)) for angle in ends],
        "held": [sampled_poles(PAPER_ARM, angle, gains) for angle in ends],
        "drive": [digital_poles(PAPER_ARM, angle, gains) for angle in ends],
    }
    return {
        "poles": {name: [parts(values) for values in both] for name, both in variants.items()},
        "damping": {name: [dominant_damping(values) for values in both] for name, both in variants.items()},
        "drive_damping": [_servo_damping(*pair) for pair in zip(variants["drive"], ends, strict=True)],
        "full": full,
        "best": [dict(zip(("arm", "m2", "k4", "damping"), row, strict=True)) for row in best],
        "over_frequency": list(zip(_FREQUENCIES, over_frequency, strict=True)),
        "arm_over_motor": [nominal_m2(angle) / (PAPER_ARM.gear_ratio**2 * PAPER_ARM.motor_inertia) for angle in ends],
        "belt_damping": ArmParams().belt_damping_ratio,
    }


def _servo_damping(values: Poles, angle: float) -> float:
    """Damping of the pairs as the drive runs the loop, without that of the simulated belt itself."""
    own = math.sqrt(PAPER_ARM.belt_stiffness / nominal_m2(angle))
    others = values[(values.imag > 1e-6) & (np.abs(np.abs(values) - own) > 1e-6)]
    return float(dominant_damping(others))


def parts(values: Poles) -> list[list[float]]:
    """Real and imaginary parts."""
    return np.stack([values.real, values.imag], axis=-1).tolist()
