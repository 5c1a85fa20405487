"""Faults, injected between arm and controller in the middle of a move: what the controller sees, or what the arm is.

Each arm has an onset of its own, at a share of its move that is uniform from 0.2 to 0.7; the fault lasts to the end of
the episode. Faults of the encoder change its counts, and all that an observation holds of them: angle, speed by
differencing, both errors, sine and cosine of twice the angle.
"""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from beltarm_env import CONTROL_PERIOD, BeltArmVectorEnv, observation
from beltarm_env.arm import COLUMN, Plant, plant_of
from beltarm_env.arrays import Flags, Floats, Singles
from beltarm_env.kernels import layout as at
from beltarm_env.rollout import Controller
from beltarm_env.task.moves import WORKSPACE
from beltarm_env.timing import EPISODE_TIME

LOST = 0.2
"""Share of samples that are lost; the last one counts again in their place."""
LATE = 3
"""Samples by which the encoder is late."""
JUMP = 0.1
"""By how much the reference jumps at the joint [rad], towards the middle of the workspace."""
WEAK = 0.5
"""Share of the commanded torque that is left."""
EARLIEST, LATEST = 0.2, 0.7
"""Share of the move at which a fault begins."""

FAULTS = {
    "none": "nothing breaks",
    "stuck encoder": "the encoder's counts stay what they are",
    "sign error": "the encoder counts the other way round",
    "lost samples": f"in place of {100 * LOST:.0f} % of the samples the last one counts again",
    "late encoder": f"the encoder is {LATE} samples late",
    "payload": "the payload is doubled",
    "weak motor": "the torque is half of what is commanded",
    "reference jump": f"start and goal of the move jump by {JUMP} rad, towards the middle of the workspace",
    "NaN weights": "the policy's weights, and so its outputs, are not numbers",
}
"""By name."""
_ENCODER = ("motor_angle_error", "motor_speed_error", "motor_speed", "motor_angle")
_COLUMNS = {
    name: observation.index(name) for name in (*_ENCODER, "sin_2_motor_angle", "cos_2_motor_angle", "last_command")
}
_SCALES, _BOUNDS = observation.scales(), observation.bounds()


class FaultyArms(BeltArmVectorEnv):
    """Arms of which something breaks in mid-move.

    Attributes:
        fault: Which one of `FAULTS`.
        onset: Samples since the move's start at which it begins, shape (num_envs,).
        samples: Since the episodes began.
    """

    def __init__(self, num_envs: int, fault: str, **settings: Any) -> None:
        super().__init__(num_envs, autoreset_mode=AutoresetMode.DISABLED, **settings)
        if fault not in FAULTS:
            raise ValueError(f"no fault {fault!r}; there are {', '.join(FAULTS)}")
        self.fault = fault
        self._seen = np.zeros((num_envs, len(_SCALES)), np.float32)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Singles, dict[str, Any]]:
        """Begin episodes, see `BeltArmVectorEnv.reset`; where arms are restarted alone, their fault goes on."""
        mask = (options or {}).get("reset_mask")
        seen, info = super().reset(seed=seed, options=options)
        if mask is not None:  # the others see what they saw
            return np.where(mask[:, None], seen, self._seen), info
        self._random = np.random.default_rng(seed)
        share = self._random.uniform(EARLIEST, LATEST, self.num_envs)
        self.onset = np.rint(share * self.moves[:, 2] / CONTROL_PERIOD).astype(np.intp)
        self.samples = 0
        self._running, self._lasted = np.ones(self.num_envs, np.bool_), np.zeros(self.num_envs)
        self._squares = np.zeros(self.num_envs)  # sum of the squared torques, over their limit, until an arm left
        self._shown = self._counts(seen)
        self._true = np.repeat(self._shown[None], LATE + 1, axis=0)  # counts, latest first
        return seen, info

    def step(self, actions: Singles) -> tuple[Singles, Floats, Flags, Flags, dict[str, Any]]:
        """Hold a torque for one control period; a command that is no number is none."""
        beginning, broken = self.onset == self.samples, self.broken
        if self.fault == "payload":
            self._load(beginning)
        elif self.fault == "reference jump":
            self._shift(beginning)
        commanded = np.nan_to_num(np.clip(actions, -1, 1))
        share = np.where(broken, WEAK, 1.0) if self.fault == "weak motor" else np.ones(self.num_envs)
        applied = (commanded * share[:, None]).astype(np.float32)
        self._squares += self._running * applied[:, 0].astype(np.float64) ** 2
        self._lasted += self._running
        seen, reward, terminated, truncated, info = super().step(applied)
        self._running &= ~terminated
        self.samples += 1
        seen[:, _COLUMNS["last_command"]] = commanded[:, 0]
        self._seen = self._faulty(seen, self.broken)
        return self._seen, reward, terminated, truncated, info

    @property
    def broken(self) -> Flags:
        """Of which arms something is broken now, shape (num_envs,)."""
        return self.onset <= self.samples

    def energies(self) -> Floats:
        """Integral of the squared torque over the episode [N^2 m^2 s], shape (num_envs,).

        Of an arm that left the workspace it is what the episode would have come to at the rate until then.
        """
        mean = self._squares / self._lasted
        return mean * self.params_table[:, COLUMN.torque_limit] ** 2 * EPISODE_TIME

    def _load(self, which: Flags) -> None:
        """Double the payload of some arms, which keep their speeds."""
        self._batch.table[which, COLUMN.payload_mass] *= 2
        plants = at.rows(self._batch.blocks, at.PLANT, len(Plant._fields), self._batch.num_arms)
        for arm in np.flatnonzero(which):
            plants[arm] = plant_of(self._batch.table[arm])
        at.put_rows(self._batch.blocks, at.PLANT, plants)

    def _shift(self, which: Flags) -> None:
        """Shift the moves of some arms: the task's own reference jumps."""
        moves = self.moves
        jump = np.where(moves[:, :2].mean(axis=1) < WORKSPACE / 2, JUMP, -JUMP)
        moves[which, :2] += jump[which, None]
        at.put_rows(self._batch.blocks, at.MOVE, moves)

    def _counts(self, seen: Singles) -> Floats:
        column = _COLUMNS["motor_angle"]
        return np.rint(seen[:, column].astype(np.float64) * _SCALES[column] / self._batch.resolution)

    def _faulty(self, seen: Singles, broken: Flags) -> Singles:
        """Observations with the encoder that they would be made from, shape (n, size)."""
        self._true = np.concatenate([self._counts(seen)[None], self._true[:-1]])
        true, before = self._true[0], self._shown
        if self.fault == "stuck encoder":
            shown = np.where(broken, before, true)
        elif self.fault == "sign error":
            shown = np.where(broken, before - (true - self._true[1]), true)
        elif self.fault == "lost samples":
            shown = np.where(broken & (self._random.random(self.num_envs) < LOST), before, true)
        elif self.fault == "late encoder":
            shown = np.where(broken, self._true[LATE], true)
        else:
            return seen
        self._shown = shown
        return np.where(broken[:, None], self._rewritten(seen, true, shown, before), seen)

    def _rewritten(self, seen: Singles, true: Floats, shown: Floats, before: Floats) -> Singles:
        """Observations with other counts."""
        result = seen.astype(np.float64) * _SCALES
        angle = shown * self._batch.resolution
        speed = (shown - before) * self._batch.resolution / CONTROL_PERIOD
        reference_speed = result[:, _COLUMNS["motor_speed_error"]] + result[:, _COLUMNS["motor_speed"]]
        result[:, _COLUMNS["motor_angle"]] = angle
        result[:, _COLUMNS["motor_speed"]] = speed
        result[:, _COLUMNS["motor_angle_error"]] += (true - shown) * self._batch.resolution
        result[:, _COLUMNS["motor_speed_error"]] = reference_speed - speed
        result[:, _COLUMNS["sin_2_motor_angle"]] = np.sin(2 * angle)
        result[:, _COLUMNS["cos_2_motor_angle"]] = np.cos(2 * angle)
        return np.clip(result / _SCALES, -_BOUNDS, _BOUNDS).astype(np.float32)


class BrokenPolicy:
    """Policy of a residual agent whose weights are no numbers from the onsets of some arms on."""

    def __init__(self, policy: Controller, arms: FaultyArms) -> None:
        self._policy, self._arms = policy, arms

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Residuals of shape (n, 1), see `Controller`."""
        residual, following = self._policy.predict(observation, state, episode_start, deterministic)
        return np.where(self._arms.broken[:, None], np.float32(np.nan), residual), following
