"""PPO, proximal policy optimisation, with and without an LSTM: options, defaults and models.

On `adaptive` the actor is first fitted to a teacher's advice, as a student without a memory is
(`agents.learners.student`). PPO goes on from there with little exploration and the student's standardised inputs, after
its critic has learned alone (`--critic-steps`): advantages by an untrained critic are noise.

On other bases PPO learns alone, as `python train/tune.py ppo --trials 24 --samples 12000000` found (`ALONE`), see
docs/science/training.md; the budget is twice a trial's.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar

import torch
from gymnasium import spaces
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from agents.learners.reinforcement import ModelLearner, ReinforcementConfig
from agents.learners.student import Student, StudentConfig
from agents.learners.teaching import TORQUE_PRICE
from agents.policy.actor import Actor, Standardised, pairs_of
from agents.residual.env import ResidualVecEnv
from agents.residual.knowledge import Knowledge
from agents.runs.settings import RunConfig
from agents.runs.training import TrainingMonitor
from baselines.tools.command import require_bounds
from beltarm_env.task.cost import MAX_COST


@dataclass(frozen=True)
class OnPolicyConfig(ReinforcementConfig):
    """Options of on-policy algorithms."""

    rollout_steps: int = 64
    """Agent steps per arm between two updates."""
    batch_size: int = 2048
    """Agent steps in each gradient step. The last one of a rollout takes what is left, and is not warned of."""
    epochs: int = 3
    """Passes over each rollout."""
    gae_lambda: float = 0.95
    """Lambda of the advantage estimate. A lower value has less variance and more bias."""
    clip_range: float = 0.2
    """Clipping range of PPO."""
    entropy: float = 0.008
    """Weight of the entropy bonus, which keeps exploration from dying early."""
    initial_log_std: float = -1.0
    """Logarithm of the exploration noise at the start. Residuals lie between -1 and 1."""

    @property
    def worst_reward(self) -> float:
        """Reward floor: the cost of three holds at its bound; more would drown the advantages of all other arms."""
        return 3 * MAX_COST * self.reward_scale

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        super().check()
        require_bounds(self, rollout_steps=(1, None), batch_size=(1, None), epochs=(1, None))
        require_bounds(self, entropy=(0, None), gae_lambda=(0, 1))
        self.positive("clip_range")
        if self.arms * self.rollout_steps < 2:
            raise ValueError("--arms times --rollout-steps must be at least 2")

    def arguments(self, **policy: Any) -> dict[str, Any]:
        """Arguments of the Stable-Baselines3 model, with further ones of its policy."""
        return {
            **super().arguments(log_std_init=self.initial_log_std, **policy),
            "learning_rate": self.learning_rate_left,
            "n_steps": self.rollout_steps,
            "batch_size": self.batch_size,
            "n_epochs": self.epochs,
            "gae_lambda": self.gae_lambda,
            "clip_range": self.clip_range,
            "ent_coef": self.entropy,
        }


_SHARED = ("moves", "arms", "validation_every", "validation_arms", "rollout_steps", "batch_size", "epochs", "entropy")
ALONE: dict[str, Any] = {
    **{name: getattr(OnPolicyConfig, name) for name in (*_SHARED, "torque_price", "residual_limit")},
    **{"total_steps": 6_000_000, "learning_rate": 3.5e-4, "initial_log_std": -0.66, "reward_scale": 0.036},
    "hidden": [256, 256],
}
"""Options of PPO without a teacher, where none are given: searched on `paper`, see docs/science/training.md."""


@dataclass(frozen=True)
class PpoConfig(OnPolicyConfig):
    """Options of `train/ppo.py`."""

    algorithm: ClassVar[str] = "ppo"

    out: Path = Path("runs/ppo")
    base: str = "adaptive"
    moves: int = 4
    arms: int = 256
    total_steps: int = 400_000
    validation_every: int = 100_000
    validation_arms: int = 32
    learning_rate: float = 2e-5
    gamma: float = 0.988
    """Discount per agent step. 0.988 looks about 0.5 s ahead."""
    reward_scale: float = 0.1
    torque_price: float = TORQUE_PRICE
    hidden: tuple[int, ...] = (128, 128)
    residual_limit: float = 0.5
    hold: int = 4
    """Samples for which a residual is held. 4 samples are 6 ms."""
    rollout_steps: int = 128
    batch_size: int = 8192
    epochs: int = 4
    gae_lambda: float = 0.962
    entropy: float = 0.0
    initial_log_std: float = -3.0
    teacher_rounds: int | None = None
    """Rounds in which the actor is first fitted to a teacher's advice, as that of `train/student.py`. Default: 10 on
    `adaptive`, none on other bases, where it begins as its base. With none, options that are not given are those for
    trial and error: single moves, much noise, large steps, 6 million agent steps."""
    teacher_arms: int = 128
    """Arms of such a round."""
    critic_steps: int | None = None
    """Agent steps, after those rounds, in which the critic learns alone. Default: 140000, or 35 % of --total-steps if
    that is less; none without rounds."""

    def __post_init__(self) -> None:
        """Fill in the rounds, and the critic's steps, that stand where none are given."""
        self.fill_in(teacher_rounds=10 if self.base == "adaptive" else 0)
        self.fill_in(critic_steps=min(140_000, self.total_steps * 7 // 20) if self.teacher_rounds else 0)

    def usual(self) -> dict[str, Any]:
        """Options that stand for those not given, see `RunConfig.usual`."""
        return {} if self.teacher_rounds else ALONE

    @property
    def length(self) -> int:
        """Agent steps of the whole run, those of the teacher's rounds included."""
        return self.total_steps + (self.student().length if self.teacher_rounds else 0)

    @property
    def layers(self) -> dict[str, Any]:
        """What the actor has besides hidden layers; inputs are standardised by those of the teacher's first round."""
        return {"standardised": True} if self.teacher_rounds else {}

    def student(self) -> StudentConfig:
        """Options of the student that the actor is in the teacher's rounds; those not named here are its own."""
        shared = {each.name: getattr(self, each.name) for each in fields(RunConfig) if each.name != "learning_rate"}
        own = {"rounds": self.teacher_rounds, "arms": self.teacher_arms, "gru_width": 0, "epochs": 3}
        return StudentConfig(**{**shared, **own})

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        super().check()
        require_bounds(self, teacher_rounds=(0, None), critic_steps=(0, self.total_steps - 1))
        if self.teacher_rounds:
            self.student().check()

    def make_learner(self) -> ModelLearner:
        """Make an untrained learner."""
        return TaughtLearner(self) if self.teacher_rounds else super().make_learner()

    def make_model(self, env: ResidualVecEnv) -> PPO:
        """Make an untrained model, whose learning rate will fall linearly to zero."""
        with warnings.catch_warnings():  # of a last batch that is smaller, as --batch-size says that it may be
            warnings.filterwarnings("ignore", "You have specified a mini-batch size", UserWarning)
            extractor = {"features_extractor_class": StandardisedInputs} if self.teacher_rounds else {}
            model: Any = PatientPPO("MlpPolicy", env, **self.arguments(**extractor))
        model.critic_steps = self.critic_steps
        return model


class StandardisedInputs(BaseFeaturesExtractor):
    """Inputs of actor and critic, standardised as the actor's that is exported."""

    def __init__(self, observation_space: spaces.Box) -> None:
        inputs = observation_space.shape[0]
        super().__init__(observation_space, inputs)
        self.scales = Standardised(inputs)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Standardise observations of shape (n, inputs)."""
        return self.scales.standardised(observations)


class PatientPPO(PPO):
    """PPO whose actor waits until its critic has learned for `critic_steps` agent steps."""

    critic_steps = 0

    def train(self) -> None:
        """Update critic and, after a while, actor with the last rollout."""
        policy: Any = self.policy
        for part in (policy.mlp_extractor.policy_net, policy.action_net, policy.log_std):
            part.requires_grad_(self.num_timesteps > self.critic_steps)
        super().train()


class TaughtLearner(ModelLearner):
    """A student, and then a model that begins with what the student learned, as `agents.runs.training.Learner`."""

    def __init__(self, config: PpoConfig) -> None:
        super().__init__(config)
        self.student = Student(config.student())

    @property
    def steps(self) -> int:
        """Agent steps so far, the student's included."""
        return self.student.steps + super().steps

    @property
    def _begun(self) -> bool:
        """Whether PPO has taken over."""
        return super().steps > 0

    def actor(self) -> Actor:
        """Copy of the current policy."""
        return super().actor() if self._begun else self.student.actor()

    def learn(self, monitor: TrainingMonitor) -> None:
        """Learn to the end of the run, see `agents.runs.training.Learner.learn`."""
        self.student.learn(monitor)
        if not self._begun:
            self.student.advice.clear()
            give(self.student.actor(), self.model.policy)
        super().learn(monitor)

    def snapshot(self) -> dict[str, Any]:
        """State that determines the next step; of the model only once it has begun."""
        model = super().snapshot() if self._begun else None
        return {"student": self.student.snapshot(), "model_and_arms": model}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a snapshot into a new learner of the same options."""
        self.student.restore(state["student"])
        if state["model_and_arms"] is not None:
            super().restore(state["model_and_arms"])


def give(actor: Actor, policy: Any) -> None:
    """Give a Stable-Baselines3 policy, with `StandardisedInputs`, the layers and scales of an actor."""
    policy.features_extractor.scales.load_state_dict({"mean": actor.mean, "deviation": actor.deviation})
    for own, theirs in pairs_of(actor, policy):
        theirs.load_state_dict(own.state_dict())


@dataclass(frozen=True)
class RecurrentPpoConfig(OnPolicyConfig):
    """Options of `train/recurrent_ppo.py`."""

    algorithm: ClassVar[str] = "recurrent_ppo"

    out: Path = Path("runs/recurrent_ppo")
    knowledge: Knowledge = "none"
    """What the agent sees besides the observation: nothing ("none"), because the LSTM is to identify the arm, or what
    the identification believes of the arm ("belief")."""
    hidden: tuple[int, ...] = (64,)
    """Widths of the hidden layers after the LSTM."""
    lstm_width: int = 64
    """Width of the LSTMs of policy and value."""
    rollout_steps: int = 50
    """Agent steps per arm between two updates. Gradients go back through all of them; 50 are half an episode."""
    batch_size: int = 5120
    epochs: int = 4
    entropy: float = 0.001

    @property
    def layers(self) -> dict[str, Any]:
        """The actor's LSTM."""
        return {"lstm": self.lstm_width}

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        require_bounds(self, lstm_width=(1, None))
        super().check()

    def make_model(self, env: ResidualVecEnv) -> RecurrentPPO:
        """Make an untrained model, whose learning rate will fall linearly to zero."""
        return RecurrentPPO("MlpLstmPolicy", env, **self.arguments(lstm_hidden_size=self.lstm_width))
