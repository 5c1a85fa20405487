"""Adapter of classical controllers: a law in physical units, called with observations as a policy is."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Generic, Literal, NamedTuple, TypeVar

import numpy as np

from baselines.gains import AnyGains
from baselines.reading import Reading, beginning, copied_memory, one_or_many, read, sample_of, warn_if_amid_a_move
from beltarm_env import ArmParams
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.engine import compiled
from beltarm_env.task.ranges import design_model
from beltarm_env.task.reference import Profile

Memory = TypeVar("Memory")


class ClassicalController(ABC, Generic[Memory]):
    """Base of controllers on observations of `sensors`; a subclass writes `law`.

    Args:
        params: The design model: all that the controller knows of the plant before it moves. By default it is the
            middle of the training ranges, drive included (`beltarm_env.task.ranges.design_model`), for every tuned
            controller alike; the paper's two know the paper's arm. Its gear ratio and torque limit, which observations
            and actions are scaled by, must be those of the arms that it drives. No law compensates an error k of its
            torque constant: tell inertias, payload, stiffness, viscous and Coulomb friction over 1 + k, and k = 0. To
            the same commands such an arm moves the same.
    """

    sensors: ClassVar[Literal["encoder", "full", "accelerometer"]] = "encoder"
    remembers: ClassVar[bool] = False
    """Whether what it knows lasts from move to move of an episode."""
    profile: ClassVar[Profile | None] = "trapezoid"
    """Shape of the reference that its law rebuilds from the move; None for a law that follows what it observes."""
    needs_servo: ClassVar[bool] = False
    """Whether it feeds back an estimate of the whole arm, so that the guard gives it a servo to fall back to."""
    needs_vibration: ClassVar[bool] = False
    """Whether it reckons with the belt's vibration, so that it takes no arm whose belt does not vibrate."""

    _gains: Any = None

    def __init__(self, params: ArmParams | None) -> None:
        self.params = params or design_model()
        if self.needs_vibration:
            _require_vibration(self.params)

    @property
    def gains(self) -> Any:
        """The gains, None if it has none; other ones take another controller, since the law follows from them."""
        return self._gains

    @abstractmethod
    def law(self, reading: Reading, begins: Flags, memory: Memory | None) -> tuple[Floats, Memory]:
        """Motor torque of one sample, before it is cut at its limit.

        Args:
            reading: Measurements and reference of n arms.
            begins: Which arms begin a move, shape (n,), and nothing is known of them before; of a controller that
                remembers, an episode.
            memory: What the last call returned; None at the beginning, where all arms begin. Never changed.

        Returns:
            Torque [N m], shape (n,), and the memory for the next call.
        """

    @one_or_many
    def predict(
        self,
        observation: Singles,
        state: Memory | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, Memory]:
        """Torque over its limit, shape (n, 1), for observations of shape (n, size); see `Controller`.

        Raises:
            ValueError: If observations, state or `episode_start` have another shape, or a number is not finite.
        """
        reading = read(observation, self.params, self.sensors)
        torque, memory = self.law(reading, beginning(state, episode_start, observation, self.remembers), state)
        if state is None and memory is not None and episode_start is None:
            warn_if_amid_a_move(observation)
        action = np.minimum(np.maximum(torque / self.params.torque_limit, -1), 1)  # `np.clip` takes four times as long
        return action.astype(np.float32)[:, None], memory


def _require_vibration(params: ArmParams) -> None:
    """Refuse, by ValueError, an arm whose belt does not vibrate at all joint angles (`baselines.models.linear`).

    At 0 degrees M2 is least, and so zeta is most.
    """
    most = math.sqrt(params.arm_inertia / (params.arm_inertia + params.arm_inertia_swing))
    if not params.belt_damping_ratio < most:
        raise ValueError(
            f"belt_damping_ratio must be less than {most:.3g} where a controller reckons with the belt's vibration, "
            f"got {params.belt_damping_ratio!r}: this belt has none at 0 degrees, take a controller such as disturbance"
        )


class LawKernel(NamedTuple):
    """A controller for one arm as one kernel: what runs batches, and is exported for a drive's processor."""

    law: Callable[..., float]
    """`law(design, now, begins, memory)`: motor torque [N m] of one sample, before it is cut at its limit, from what
    is constant, a `Sample`, and whether a move begins, when nothing in the memory counts (an episode, if the controller
    remembers). Writes the memory."""
    design: Any  # named tuple of numbers and arrays, which the kernel never writes
    memory: Any  # an array, or a named tuple of arrays, of the shapes that the kernel needs for one arm


@compiled
def run_law(
    law: Callable[..., float], design: Any, reading: Reading, begins: Flags, memory: Floats, torques: Floats
) -> None:
    """Write the torques [N m] of n arms, and their memory, shape (n, size)."""
    for i in range(len(begins)):
        torques[i] = law(design, sample_of(reading, i), begins[i], memory[i])


class ScalarController(ClassicalController[Floats]):
    """Base of controllers whose law is a kernel for one arm with a row of numbers for its memory.

    A subclass names its `arm_law` and sets `_design`, or writes `kernel`.
    """

    memory_size: ClassVar[int]
    arm_law: ClassVar[Callable[..., float]]  # see `LawKernel.law`
    _design: Any

    def kernel(self) -> LawKernel:
        """The law for one arm, with a memory of shape (memory_size,)."""
        return LawKernel(type(self).arm_law, self._design, np.zeros(self.memory_size))

    def law(self, reading: Reading, begins: Flags, memory: Floats | None) -> tuple[Floats, Floats]:
        """Torque [N m] of one sample, see `ClassicalController`."""
        count, (law, design, own) = len(begins), self.kernel()
        if memory is None and (np.shape(own) != (self.memory_size,) or np.any(own)):
            raise ValueError(
                f"the memory of kernel() must be zeros of shape ({self.memory_size},), by memory_size, got {own}"
            )
        following, torques = copied_memory(memory, count, self.memory_size), np.empty(count)
        run_law(law, design, reading, begins, following, torques)
        return torques, following


def own_gains(gains: Any, kind: type[AnyGains]) -> AnyGains:
    """Return the gains of a controller: as given, or those before tuning.

    Raises:
        TypeError: If they are of another kind.
    """
    if gains is not None and not isinstance(gains, kind):
        raise TypeError(f"gains must be {kind.__name__}, got {type(gains).__name__}")
    return kind() if gains is None else gains


class TunedController(ClassicalController[Memory]):
    """Base of controllers with gains; a subclass names its `gains_type`, and writes `_known`.

    Args:
        gains: Of this type; those before tuning if not given.
        params: The design model.

    Raises:
        TypeError: If the gains are those of another controller.
    """

    gains_type: ClassVar[type[Any]]

    def __init__(self, gains: Any = None, params: ArmParams | None = None) -> None:
        super().__init__(params)
        self._gains = own_gains(gains, self.gains_type)
        self._design = self._known()

    @abstractmethod
    def _known(self) -> Any:
        """What the law knows: a named tuple of numbers and arrays."""
