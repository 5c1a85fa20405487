"""PPO that goes on from what a teacher taught its actor.

On a good controller useful residuals are small, and PPO from scratch loses more to its exploration than it finds. So
the actor of a Stable-Baselines3 policy is fitted to a teacher's advice first, as a student without a memory is
(`agents.learners.student`), and PPO goes on from there in three ways that keep what is there:

- exploration is so small that it costs almost nothing (`--initial-log-std`), and no bonus makes it grow;
- the critic learns first, and the actor waits for it (`--critic-steps`): advantages by an untrained critic are noise;
- inputs are standardised by what the student saw. A part of the policy that Stable-Baselines3 calls its features
  extractor does it, and the learning has no part in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from agents.learners.reinforcement import ModelLearner
from agents.learners.student import Student
from agents.policy.actor import Actor, Standardised, pairs_of
from agents.runs.training import TrainingMonitor

if TYPE_CHECKING:
    from agents.learners.ppo import PpoConfig


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

    config: PpoConfig

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
