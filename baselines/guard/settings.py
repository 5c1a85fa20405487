"""Settings of the guard, in units of their own, and as the numbers per sample that its kernels work with."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

from beltarm_env import CONTROL_PERIOD, ArmParams


class GuardDesign(NamedTuple):
    """All that is constant in the guard's kernels."""

    limit: float  # of the torque [N m]
    slew: float  # most that the command changes by in a sample [N m]
    fade: float  # most that a weight changes by in a sample
    stop: float  # the same, on the way to no torque
    wait: int  # samples of good behaviour before it returns
    longest_wait: int
    surprise: float
    calm: float
    residual: float  # largest residual that is allowed [N m]
    saturated: float  # residual that counts as saturated [N m]
    longest_saturation: int  # [samples]
    # Of the encoder:
    step: float  # change that may always be [rad]
    doubt: float  # change of the speed in a sample that no torque explains [rad/s]
    longest_loss: int  # samples
    push: float  # torque that moves any motor [N m]
    longest_rest: int  # samples
    against: float  # torque that has to show in the motor's acceleration [N m]
    # Of the motor:
    friction: float  # Coulomb's [N m]
    viscous: float  # [N m s/rad]
    per_torque: float  # change of the speed in a sample by a torque [rad/s per N m]


LARGEST = 1e6
"""Largest setting, so that samples can be counted."""


@dataclass(frozen=True)
class GuardSettings:
    """What the guard allows, and how long.

    Raises:
        ValueError: If a setting is not a positive number of at most `LARGEST`.
    """

    slew: float = 1.0  # most that the command changes by in a sample, of the torque limit
    fade: float = 0.05  # in which one torque takes another's place [s]
    stop: float = 0.01  # in which a torque that nothing can be built on ramps to zero [s]
    wait: float = 0.3  # of good behaviour before it returns; twice as long after each further fall [s]
    surprise: float = 6.5  # w of the observer from which it knows nothing of the arm [-]
    calm: float = 3.0  # w below which it does again [-]
    saturation: float = 0.1  # how long a residual may be at its limit [s]
    encoder_step: float = 0.025  # four counts of a coarse encoder: change of the angle that may always be [rad]
    doubtful_torque: float = 0.12  # that acts on the motor beside what the design model says [N m]
    loss: float = 0.012  # how long the encoder may show what no motor does [s]
    push: float = 0.5  # torque that breaks any motor away, of the torque limit
    rest: float = 0.015  # how long a motor may rest under it [s]
    against: float = 0.1  # mean torque beyond friction that must not turn the motor the wrong way [N m]

    def __post_init__(self) -> None:
        """Check the ranges."""
        for setting in fields(self):
            value = getattr(self, setting.name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= LARGEST:
                bounds = f"a positive number of at most {LARGEST:g}"
                raise ValueError(f"GuardSettings.{setting.name} must be {bounds}, got {value!r}")

    def design(self, params: ArmParams, residual: float = 0.0) -> GuardDesign:
        """Numbers for the kernels.

        Args:
            params: The design model.
            residual: Largest residual that is allowed, of the torque limit; 0 where there is none.
        """
        inertia = params.motor_inertia + (params.arm_inertia + 0.5 * params.arm_inertia_swing) / params.gear_ratio**2
        return GuardDesign(
            limit=params.torque_limit,
            slew=self.slew * params.torque_limit,
            fade=min(CONTROL_PERIOD / self.fade, 1.0),
            stop=min(CONTROL_PERIOD / self.stop, 1.0),
            wait=_samples(self.wait),
            longest_wait=_LONGEST * _samples(self.wait),
            surprise=self.surprise,
            calm=self.calm,
            residual=_ROOM * residual * params.torque_limit,
            saturated=_SATURATED * residual * params.torque_limit,
            longest_saturation=_samples(self.saturation),
            step=self.encoder_step,
            doubt=CONTROL_PERIOD / inertia * self.doubtful_torque,
            longest_loss=_samples(self.loss),
            push=self.push * params.torque_limit,
            longest_rest=_samples(self.rest),
            against=self.against,
            friction=params.coulomb_friction,
            viscous=params.motor_viscous_friction,
            per_torque=CONTROL_PERIOD / inertia,
        )


_LONGEST = 8  # the longest wait over the first
_ROOM = 1.001  # over the residual's limit: rounding
_SATURATED = 0.98  # of the residual's limit


def _samples(time: float) -> int:
    return max(round(time / CONTROL_PERIOD), 1)
