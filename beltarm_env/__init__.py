"""Belt-driven flexible arm as a Gymnasium environment.

`import beltarm_env` registers `BeltArm-v0`; after that `gymnasium.make("BeltArm-v0")` and
`gymnasium.make_vec("BeltArm-v0", num_envs=64)` work. Worker processes use "beltarm_env:BeltArm-v0". With MuJoCo
installed it also registers `BeltArmMuJoCo-v0`: the full arm, moved and drawn by MuJoCo.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import gymnasium as gym

from beltarm_env.timing import CONTROL_PERIOD, EPISODE_STEPS

if TYPE_CHECKING:
    from beltarm_env.arm import ArmParams
    from beltarm_env.env import BeltArmEnv
    from beltarm_env.physics.derivative import state_derivative
    from beltarm_env.physics.linear import state_space
    from beltarm_env.physics.sampled import sampled_state_space
    from beltarm_env.task.ranges import IDEAL_RANGES, SHIFT_RANGES, TRAIN_RANGES, design_model
    from beltarm_env.vector_env import BeltArmVectorEnv

__version__ = "1.1.0.dev0"
__all__ = [
    "CONTROL_PERIOD",
    "EPISODE_STEPS",
    "IDEAL_RANGES",
    "SHIFT_RANGES",
    "TRAIN_RANGES",
    "ArmParams",
    "BeltArmEnv",
    "BeltArmVectorEnv",
    "design_model",
    "sampled_state_space",
    "state_derivative",
    "state_space",
]

_HOME = {
    "IDEAL_RANGES": "task.ranges",
    "SHIFT_RANGES": "task.ranges",
    "TRAIN_RANGES": "task.ranges",
    "ArmParams": "arm",
    "BeltArmEnv": "env",
    "BeltArmVectorEnv": "vector_env",
    "design_model": "task.ranges",
    "sampled_state_space": "physics.sampled",
    "state_derivative": "physics.derivative",
    "state_space": "physics.linear",
}


def __getattr__(name: str) -> Any:
    """Import public names when first used, so that registering the environment does not load the compiler."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


# The environments truncate, refuse to step before reset, and keep Gymnasium's rules (its checker is among the tests) by
# themselves: no wrapper has to see to it at every step. Nor is a number of steps registered, for it depends on `moves`:
# `max_episode_steps` of an environment that was made tells it.
_REGISTERED: dict[str, Any] = {
    "entry_point": "beltarm_env.env:BeltArmEnv",
    "vector_entry_point": "beltarm_env.vector_env:BeltArmVectorEnv",
    "order_enforce": False,
    "disable_env_checker": True,
}
gym.register(id="BeltArm-v0", **_REGISTERED)
if find_spec("mujoco") is not None:
    gym.register(id="BeltArmMuJoCo-v0", **_REGISTERED, kwargs={"model": "mujoco"})
