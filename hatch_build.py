"""Hook of hatchling: a wheel holds the kernels of one platform, compiled.

`BELTARM_TARGET` names the platform, such as `macosx_11_0_arm64` (see `beltarm_env/engine/prebuild.py`). Without it the
wheel is for this machine, or for all without compiled kernels where ziglang, NumPy or Gymnasium are not installed.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

NEEDED = ("ziglang", "numpy", "gymnasium")
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
THIS = {
    ("Linux", "x86_64"): "manylinux_2_17_x86_64",
    ("Linux", "aarch64"): "manylinux_2_17_aarch64",
    ("Darwin", "aarch64"): "macosx_11_0_arm64",
    ("Darwin", "x86_64"): "macosx_11_0_x86_64",
    ("Windows", "x86_64"): "win_amd64",
}
"""Platform of a wheel, by system and processor."""


class Kernels(BuildHookInterface):
    """Hook that adds compiled kernels to a wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build kernels and name the platform; a checkout that is installed builds its own when it is set up."""
        target = None if version == "editable" else os.environ.get("BELTARM_TARGET") or self._of_this_machine()
        if target is None:
            return
        self._scratch = tempfile.TemporaryDirectory()
        built = os.path.join(self._scratch.name, "built")
        command = [sys.executable, "-B", __file__, target, built]
        kept = {name: value for name, value in os.environ.items() if name not in ("BELTARM_ENGINE", "BELTARM_CC")}
        subprocess.run(command, cwd=self.root, env={**kept, "PYTHONPATH": self.root}, check=True)
        build_data["force_include"][built] = "beltarm_env/engine/built"
        build_data["pure_python"] = False
        build_data["tag"] = f"cp311-abi3-{target}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was built: the wheel has it."""
        if "tag" in build_data:
            self._scratch.cleanup()

    def _of_this_machine(self) -> str | None:
        missing = [name for name in NEEDED if find_spec(name) is None]
        if missing:
            self.app.display_warning(f"no kernels are compiled, for {', '.join(missing)} is not installed")
            return None
        machine = platform.machine().lower()
        return THIS.get((platform.system(), MACHINES.get(machine, machine)))


RANGES = {"payload_mass": (0.1, 0.2)}, {"belt_stiffening": (0.1, 0.2)}
"""Of a user's own, as a mapping: of an ideal drive and of a real one."""
CHOICES = ("lumped", "lagrangian"), ("off", "train", *RANGES), ("encoder", "tip", "full", "accelerometer")
"""Of model, randomization and sensors."""


def use_everything() -> None:
    """Do what users of the package do, with every choice that decides about types."""
    import gymnasium as gym
    import numpy as np

    from beltarm_env import (
        EPISODE_STEPS,
        ArmParams,
        BeltArmVectorEnv,
        sampled_state_space,
        state_derivative,
        state_space,
    )
    from beltarm_env.arm import plant_of
    from beltarm_env.physics.drive import belt_motions, real_drive_of
    from beltarm_env.rollout import rollout
    from beltarm_env.simulation import ArmSimulation

    moves = {"move": {"start": 0.2, "goal": 0.8, "duration": 0.5, "ramp_time": 0.1}}
    rest = {"state": np.zeros(4)}
    for model, randomization, sensors in product(*CHOICES):
        settings: dict[str, Any] = {"model": model, "randomization": randomization, "sensors": sensors}
        env = gym.make("beltarm_env:BeltArm-v0", **settings, moves=2, disable_env_checker=True)
        for options in (None, moves, rest):
            env.reset(seed=0, options=options)
            env.step(np.zeros(1, np.float32))
        arms: Any = BeltArmVectorEnv(3, **settings, moves=2)
        arms.reset(seed=0)
        for _ in range(EPISODE_STEPS):  # into the second move
            env.step(np.zeros(1, np.float32))
            arms.step(np.zeros((3, 1), np.float32))
        arm: Any = env.unwrapped
        arm.reference(arm.time)
        for mode in ("NextStep", "SameStep"):
            arms = BeltArmVectorEnv(3, **settings, autoreset_mode=mode, max_episode_steps=1)
            for options in (None, moves, rest):
                arms.reset(seed=0, options=options)
                for dtype in (np.float32, np.float32, np.float64):
                    arms.step(np.zeros((3, 1), dtype))
    for randomization in CHOICES[1]:
        rollout(_Still(), 2, seed=0, randomization=randomization).metrics()
    for model, params in product(CHOICES[0], (ArmParams(), ArmParams(kinematic_error=0.001))):
        state_derivative(np.zeros(4), 0.1, params, model)
        state_space(params, 0.5, model=model)
        sampled_state_space(params, 0.5, model)
        for states in (np.zeros((2, 4)), np.zeros((2, 2, 4))[:, 0]):  # of one arm, and of one among several
            belt_motions(states, plant_of(params.row()), real_drive_of(params.row()))
        arms = ArmSimulation(params, 2, model)
        states = arms.advance(arms.at_rest(np.zeros(2)), np.zeros(2))
        arms.ahead(states, np.zeros(2), np.ones(2))


class _Still:
    """Controller that leaves the motor alone."""

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
        """See `Controller`."""
        return 0 * observation[:, :1], state


if __name__ == "__main__":
    from beltarm_env.engine.prebuild import PLATFORMS, prebuild

    prebuild(PLATFORMS[sys.argv[1]], use_everything, Path(sys.argv[2]))
