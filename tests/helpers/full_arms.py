"""Full arms for the tests, as the event-located reference has them."""

import numpy as np

from beltarm_env import ArmParams
from eval.reference.event_located import EventLocatedArm


def full_arm(params: ArmParams, state: np.ndarray) -> EventLocatedArm:
    return EventLocatedArm(params, state, "lagrangian")


def full_arm_at(params: ArmParams, theta_1: float, phi: float) -> EventLocatedArm:
    """At rest at some angles."""
    return full_arm(params, np.array([params.gear_ratio * theta_1, 0.0, theta_1 - phi, 0.0]))


def some_params(rng: np.random.Generator) -> ArmParams:
    """Any arm within a factor of three of the nominal one, with a payload."""
    nominal = ArmParams()
    fields = ("gear_ratio", "link_length", "motor_inertia", "arm_inertia", "arm_inertia_swing", "belt_stiffness")
    drawn = {name: getattr(nominal, name) * 3 ** rng.uniform(-1, 1) for name in fields}
    return ArmParams(**drawn, payload_mass=rng.uniform(0, 0.5))
