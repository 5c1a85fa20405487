"""PPO with an LSTM as learner: its options, defaults and model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from sb3_contrib import RecurrentPPO

from agents.learners.on_policy import OnPolicyConfig
from agents.learners.reinforcement import ModelLearner
from agents.residual.env import ResidualVecEnv
from agents.residual.knowledge import Knowledge


@dataclass(frozen=True)
class RecurrentPpoConfig(OnPolicyConfig):
    """Options of `train/recurrent_ppo.py`."""

    algorithm: ClassVar[str] = "recurrent_ppo"

    out: Path = Path("runs/recurrent_ppo")
    """Folder of the run. With --seeds, each run has its own folder there: seed0, seed1, ..."""
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
    """Agent steps in each gradient step."""
    epochs: int = 4
    """Passes over each rollout."""
    entropy: float = 0.001
    """Weight of the entropy bonus, which keeps exploration from dying early."""

    @property
    def layers(self) -> dict[str, Any]:
        """The actor's LSTM."""
        return {"lstm": self.lstm_width}

    def check(self) -> None:
        """Check the options, see `RunConfig.check`."""
        self.at_least(1, "lstm_width")
        super().check()


def make_model(config: RecurrentPpoConfig, env: ResidualVecEnv) -> RecurrentPPO:
    """Make an untrained model, whose learning rate will fall linearly to zero."""
    return RecurrentPPO("MlpLstmPolicy", env, **config.arguments(lstm_hidden_size=config.lstm_width))


def make_learner(config: RecurrentPpoConfig) -> ModelLearner:
    """Make an untrained learner."""
    return ModelLearner(config, make_model)
