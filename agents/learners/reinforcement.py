"""Reinforcement learning: shared options, training arms, and a Stable-Baselines3 model as learner."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from io import BytesIO
from typing import Any, ClassVar

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.save_util import load_from_zip_file, recursive_setattr

from agents.policy.actor import MODULES, Actor, actor_of
from agents.residual.bases import make_base
from agents.residual.env import ResidualVecEnv
from agents.runs.settings import RunConfig
from agents.runs.training import TrainingMonitor
from baselines.tools.command import require_bounds
from beltarm_env import BeltArmVectorEnv
from beltarm_env.arrays import Singles
from beltarm_env.task.seeds import training_arms


@dataclass(frozen=True)
class ReinforcementConfig(RunConfig):
    """Options of all reinforcement learning algorithms."""

    log_interval: ClassVar[int] = 10  # iterations, or episodes off-policy, between rows of the training log

    total_steps: int = 4_000_000
    """Agent steps of the whole run, each of --hold samples, or some more: rollouts are made as a whole. A learning rate
    that falls reaches zero at the end."""
    gamma: float = 0.97
    """Discount per agent step."""
    reward_scale: float = 0.08
    """Factor on the mean reward of a hold. It brings values to order 1."""
    torque_price: float = 25.0
    """Price of a torque change in the reward, as a multiple of the task's price. Validation uses the task's price."""
    validation_every: int = 500_000
    """Least agent steps between validations, which follow a rollout. Each validation saves a checkpoint."""

    @property
    def length(self) -> int:
        """Agent steps of the whole run."""
        return self.total_steps

    @property
    def worst_reward(self) -> float:
        """Reward floor, as a positive number, see `agents.residual.env.ResidualVecEnv`."""
        raise NotImplementedError

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        require_bounds(self, total_steps=(1, None), validation_every=(1, None), gamma=(0, 1))
        self.positive("gamma", "reward_scale", "torque_price")
        super().check()

    def make_env(self) -> ResidualVecEnv:
        """Make the environment of training arms."""
        task: dict[str, Any] = {"randomization": self.randomization, "moves": self.moves, "sensors": self.sensors}
        return ResidualVecEnv(
            BeltArmVectorEnv(self.arms, autoreset_mode="SameStep", **task),
            make_base(self.base, self.sensors),
            self.residual,
            reward_scale=self.reward_scale / self.hold,
            torque_price=self.torque_price,
            worst_reward=self.worst_reward,
        )

    def arguments(self, **policy: Any) -> dict[str, Any]:
        """Arguments of the Stable-Baselines3 model, with further ones of its policy."""
        layers = {"net_arch": list(self.hidden), "activation_fn": MODULES[self.activation]}
        return {"gamma": self.gamma, "policy_kwargs": {**layers, **policy}, "seed": self.seed, "device": self.device}

    def make_model(self, env: ResidualVecEnv) -> BaseAlgorithm:
        """Make an untrained model of Stable-Baselines3."""
        raise NotImplementedError

    def make_learner(self) -> ModelLearner:
        """Make an untrained learner."""
        return ModelLearner(self)


class ModelLearner:
    """A Stable-Baselines3 model with its arms, as `agents.runs.training.Learner`.

    What the library saves of a model, with its replay buffer and arms beside it, is enough to go on bit for bit. Its
    `load` is not: it sets up the model anew at the end, and the states of an LSTM within episodes are lost. So what was
    saved is put into a new model of the same options, as `load` does it before.
    """

    def __init__(self, config: ReinforcementConfig) -> None:
        self.config = config
        self.env = config.make_env()
        self.model: Any = config.make_model(self.env)
        self.env.seed(training_arms(config.seed).first)

    @property
    def steps(self) -> int:
        """Agent steps so far."""
        return self.model.num_timesteps

    def actor(self) -> Actor:
        """Copy of the current policy."""
        return actor_of(self.model.policy, self.config.spec().shape())

    def learn(self, monitor: TrainingMonitor) -> None:
        """Learn to the end of the run, see `agents.runs.training.Learner.learn`."""
        config, model, pauses = self.config, self.model, _Pauses(monitor, self.config.validation_every)
        model.set_logger(monitor.logger)
        remaining = config.total_steps - model.num_timesteps
        try:
            model.learn(remaining, pauses, config.log_interval, reset_num_timesteps=False)  # a new one has none
        except ValueError:
            if _diverged(model, pauses.locals.get("new_obs")):
                message = f"diverged at {model.num_timesteps} steps: start again with a smaller --learning-rate"
                raise ValueError(message) from None
            raise

    def snapshot(self) -> dict[str, Any]:
        """State that determines the next step, between an update and the next rollout."""
        saved = BytesIO()
        states = [name for name, value in vars(self.model).items() if isinstance(value, tuple)]
        self.model.save(saved, include=states)  # of an LSTM, which the library would leave out
        replay = getattr(self.model, "replay_buffer", None)
        return {"model": saved.getvalue(), "replay": replay, "env": self.env.snapshot()}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a snapshot into a new model of the same options."""
        model = self.model
        with warnings.catch_warnings():
            warnings.filterwarnings("error", "Could not deserialize")  # and would be left out
            attributes, parameters, variables = load_from_zip_file(BytesIO(state["model"]), device=model.device)
        vars(model).update(attributes or {})
        model.set_parameters(parameters, exact_match=True, device=model.device)
        for name, value in (variables or {}).items():
            recursive_setattr(model, f"{name}.data", value.data)
        if state["replay"] is not None:
            model.replay_buffer = state["replay"]
            model.replay_buffer.device = model.device
        self.env.restore(state["env"])


def _diverged(model: BaseAlgorithm, seen: Singles | None) -> bool:
    """Whether weights of the policy, or its actions on observations, are not finite."""
    if not all(torch.isfinite(weights).all() for weights in model.policy.parameters()):
        return True
    if seen is None:
        return False
    try:
        actions, _ = model.policy.predict(seen)
    except ValueError:  # of a distribution that has no such parameters
        return True
    return not np.isfinite(actions).all()


class _Pauses(BaseCallback):
    """Callback that runs the monitor between update and rollout, where the state of the run is complete.

    The library's `EvalCallback` and `CheckpointCallback` act within a rollout, of which no part can be saved.
    """

    def __init__(self, monitor: TrainingMonitor, every: int) -> None:
        super().__init__()
        self.monitor = monitor
        self._every = every

    def _on_step(self) -> bool:
        return True

    def _on_training_start(self) -> None:
        self.monitor.begin()

    def _on_rollout_start(self) -> None:
        self.monitor.stop_if_asked()
        progress = self.monitor.progress
        if self.num_timesteps >= progress.setdefault("next", self._every):
            progress["next"] = self.num_timesteps + self._every
            self.monitor.evaluate()

    def _on_rollout_end(self) -> None:
        self.monitor.tell(self.monitor.learner.steps)

    def _on_training_end(self) -> None:
        self.monitor.evaluate()
