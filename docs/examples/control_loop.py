"""A loop designed with python-control, and run on the arm: `python docs/examples/control_loop.py`.

The plant is the arm of the data sheet behind its drive: belt, current loop and latency, exact from one sample to the
next. A constant torque is added as a further state, for friction that is not as expected. The loop is an LQR on the
tip's error with a Kalman filter that sees the encoder alone, at 19 joint angles, because the inertia behind the belt
grows sevenfold from a stretched arm to a bent one. Feed-forward knows the rigid arm, Coulomb friction and the torsion
that the move needs.
"""

from __future__ import annotations

import control
import numpy as np

from baselines import CONTROLLERS
from beltarm_env import CONTROL_PERIOD, design_model, sampled_state_space
from beltarm_env.observation import decode
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import VALIDATION

ARM = design_model()
G = ARM.gear_ratio
ANGLES = np.linspace(0, np.pi / 2, 19)  # of joint 1, at which the arm is linearised [rad]
ARMS = 100

# Weights, by a random search on arms of the gains' tuner with a modulus margin of 0.45 or more, then rounded
TIP_ERROR, TIP_SPEED, TORQUE = 0.02, 0.15, 0.1  # what counts as much as each other [rad], [rad/s], [N m]
NOISE = 0.0004  # of the encoder, at the motor [rad]
TORQUE_NOISE, DRIFT = 0.03, 0.005  # of unknown torques, from sample to sample: white, and added up [N m]


def inertia(angle):
    """Of links 2 and 3 about joint 1 [kg m^2]."""
    return ARM.arm_inertia + ARM.arm_inertia_swing * np.sin(angle) ** 2


def design(angle):
    """Plant, gains of controller and observer, and the two as one system from encoder to torque, at a joint angle."""
    a, b, c = sampled_state_space(ARM, angle)
    size, c = len(a), c[:1]  # the speed that drives report is a difference of encoder counts: nothing new
    tip = np.zeros((2, size))  # of phi = theta_a / G - theta_s, and its rate
    tip[:, :4] = [[1 / G, 0, -1, 0], [0, 1 / G, 0, -1]]
    feedback, _, _ = control.dlqr(a, b, tip.T @ np.diag([TIP_ERROR**-2, TIP_SPEED**-2]) @ tip, [[TORQUE**-2]])
    feedback = np.hstack([feedback, [[1.0]]])  # the unknown torque is taken off

    a, b, c = np.block([[a, b], [np.zeros(size), 1]]), np.vstack([b, [[0.0]]]), np.hstack([c, [[0.0]]])
    disturbed = np.zeros((size + 1, 2))
    disturbed[1, 0], disturbed[size, 1] = CONTROL_PERIOD / ARM.motor_inertia, 1  # torques at the motor
    correction, _, _ = control.dlqe(a, disturbed, c, np.diag([TORQUE_NOISE**2, DRIFT**2]), [[NOISE**2]])
    law = control.ss(a - b @ feedback - correction @ c, correction, feedback, 0, CONTROL_PERIOD)
    plant = control.ss(*(part[:size, :size] for part in (a, b, c)), 0, CONTROL_PERIOD)
    return plant, law, (a, b[:, 0], c[0], feedback[0], correction[:, 0])


class Loop:
    """The loop at the angle of the grid that is next to the reference's."""

    def __init__(self):
        designs = [design(angle)[2] for angle in ANGLES]
        self.a, self.b, self.c, self.feedback, self.correction = map(np.array, zip(*designs, strict=True))

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        """Torque over its limit, shape (n, 1), and the predicted states, shape (n, states)."""
        now = decode(observation)
        at = np.rint(now["reference_angle"] / ANGLES[1]).astype(int).clip(0, len(ANGLES) - 1)
        measured = G * now["reference_angle"] - now["motor_angle_error"]
        start = np.zeros((len(at), self.a.shape[1]))
        start[:, 0] = measured
        begins = np.zeros(len(at), bool) if episode_start is None else episode_start
        state = start if state is None else np.where(begins[:, None], start, state)

        speed, acceleration = G * now["reference_speed"], now["reference_acceleration"]
        torsion = inertia(now["reference_angle"]) * acceleration / ARM.belt_stiffness
        smooth = (ARM.motor_inertia * G + inertia(now["reference_angle"]) / G) * acceleration
        smooth += ARM.motor_viscous_friction * speed
        friction = ARM.coulomb_friction * np.sign(speed)
        wanted = np.zeros_like(state)
        wanted[:, :4] = np.transpose([measured + now["motor_angle_error"] + G * torsion, speed, torsion, 0 * speed])
        wanted[:, 4:-1] = smooth[:, None]  # of the drive's torque and of commands that are under way
        torque = smooth + np.sum(self.feedback[at] * (wanted - state), axis=1)
        command = ((torque + friction) / ARM.torque_limit).clip(-1, 1)

        surprise = measured - np.sum(self.c[at] * state, axis=1)
        torque = command * ARM.torque_limit - friction  # what the linear arm gets of it
        state = np.einsum("nij,nj->ni", self.a[at], state) + self.b[at] * torque[:, None]
        return command[:, None].astype(np.float32), state + self.correction[at] * surprise[:, None]


if __name__ == "__main__":
    frequencies = np.geomspace(1, np.pi / CONTROL_PERIOD, 5000)[:-1]
    for angle in ANGLES[[0, 9, 18]]:
        plant, law, _ = design(angle)
        loop = control.frd(plant * law, frequencies)
        _, phases, modulus, _, crossings, _ = control.stability_margins(loop, returnall=True)
        delay = np.min(np.radians(phases % 360) / crossings) / CONTROL_PERIOD
        print(
            f"{np.degrees(angle):2.0f} degrees: phase margin {np.min(np.abs(phases)):.0f} degrees, "
            f"delay margin {delay:.1f} samples, modulus margin {np.min(modulus):.2f}"
        )
    for name, controller in {"this loop": Loop(), "paper": CONTROLLERS["paper"](), "lqg": CONTROLLERS["lqg"]()}.items():
        metrics = rollout(controller, ARMS, seed=VALIDATION.first, randomization="train").metrics()
        cost, tip, ringing = (np.mean(metrics[key]) for key in ("cost", "tip_rms_mm", "residual_pp_mm"))
        print(f"{name}: cost {cost:.0f}, tip {tip:.1f} mm RMS, ringing {ringing:.1f} mm peak to peak")
