"""A servo law of one's own, which can be compared and exported to a drive's processor.

    python eval/compare.py --add docs/examples/my_servo.py:MyServo --scenarios development --out results/my-servo-scores
    python eval/export.py c docs/examples/my_servo.py:MyServo --out results/my-servo

Feedforward of the arm's torque along the reference, and feedback of the motor's angle and filtered speed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from baselines.controller import LawKernel, ScalarController
from baselines.reading import Sample
from beltarm_env.arm import Plant
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled
from beltarm_env.physics.trigonometry import sine_cosine

SPEED_ERROR = 0
"""Entry of the memory: the filtered error of the motor's speed [rad/s]."""


class Design(NamedTuple):
    """What the law knows: the arm of the data sheet and the gains."""

    plant: Plant
    angle: float  # [N m/rad] at the motor
    speed: float  # [N m s/rad]
    smoothing: float  # of the speed, which is differenced encoder counts


@compiled
def my_law(design: Design, now: Sample, begins: bool, memory: Floats) -> float:
    """Motor torque [N m] of one sample; it is cut at the limit later."""
    last = 0.0 if begins else memory[SPEED_ERROR]
    memory[SPEED_ERROR] = design.smoothing * last + (1.0 - design.smoothing) * now.speed_error
    plant = design.plant
    sine, _ = sine_cosine(now.reference_angle)
    load = plant.inertia + plant.inertia_swing * sine * sine
    inertia = plant.gear / plant.inverse_motor_inertia + load / plant.gear
    torque = inertia * now.reference_acceleration
    torque += plant.viscous_friction * plant.gear * now.reference_speed
    torque += plant.coulomb_friction * np.sign(now.reference_speed)
    return torque + design.angle * now.angle_error + design.speed * memory[SPEED_ERROR]


class MyServo(ScalarController):
    """The law as a controller; made without arguments."""

    profile = None  # the law follows the reference that it observes, of any shape
    memory_size = 1

    def __init__(self) -> None:
        super().__init__(None)  # the middle of the training ranges
        self.design = Design(self.params.plant(), 0.02, 0.0015, 0.6)

    def kernel(self) -> LawKernel:
        """The law, what it knows, and its memory for one arm."""
        return LawKernel(my_law, self.design, np.zeros(self.memory_size))
