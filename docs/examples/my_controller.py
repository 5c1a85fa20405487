"""A controller of one's own, for `eval/compare.py --add docs/examples/my_controller.py:MyController`.

While you work on it, add `--scenarios development`.

Feedforward of the nominal arm's torque along the reference, Coulomb friction included, and feedback of the motor. There
is nothing in it about the belt: it is a place to begin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltarm_env import ArmParams
from beltarm_env.observation import decode

ARM = ArmParams()  # the nominal arm: all that a controller is told of the plant
ANGLE_GAIN, SPEED_GAIN = 0.02, 0.0015  # [N m/rad], [N m s/rad] at the motor
SMOOTHING = 0.6  # of the speed, which is differenced encoder counts


@dataclass(frozen=True)
class Memory:
    """What is remembered from sample to sample: never in the controller itself, which drives many arms at once."""

    speed_error: NDArray[np.float64]  # smoothed [rad/s], one per arm


class MyController:
    """Made without arguments; called with the observations of n arms."""

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory]:
        """Torque over its limit, shape (n, 1), and the memory for the next sample."""
        now = decode(observation)  # physical units, an array of shape (n,) per entry
        remembered = np.zeros(len(observation)) if state is None else state.speed_error
        if episode_start is not None:
            remembered = np.where(episode_start, 0.0, remembered)
        speed_error = SMOOTHING * remembered + (1 - SMOOTHING) * now["motor_speed_error"]

        arm_inertia = ARM.arm_inertia + ARM.arm_inertia_swing * np.sin(now["reference_angle"]) ** 2
        inertia = ARM.motor_inertia * ARM.gear_ratio + arm_inertia / ARM.gear_ratio
        torque = inertia * now["reference_acceleration"]
        torque += ARM.motor_viscous_friction * ARM.gear_ratio * now["reference_speed"]
        torque += ARM.coulomb_friction * np.sign(now["reference_speed"])
        torque += ANGLE_GAIN * now["motor_angle_error"] + SPEED_GAIN * speed_error
        return (torque / ARM.torque_limit)[:, None].astype(np.float32), Memory(speed_error)
