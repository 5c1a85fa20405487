"""Train a residual PPO policy on a base controller: `python train/ppo.py`.

Everything a run writes goes to one folder: `best/` (the policy bundle with the lowest validation cost), `last/`,
`checkpoint.zip` and `progress.json` (to go on with `--resume`), `config.json`, `validation.csv`, and the training log
as CSV and for TensorBoard.
"""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import torch
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger, make_output_format

from agents.bundle import ACTIVATIONS, BundleSpec, annotate, save_bundle
from agents.residual import ResidualSettings
from agents.residual_env import ResidualVecEnv
from agents.training import Checkpoint, TrainingMonitor, interruptible
from baselines import CONTROLLERS
from baselines.files import require_writable, write_text
from beltarm_env import BeltArmVectorEnv, __version__


@dataclass(frozen=True)
class Config:
    """Train a residual PPO policy."""

    out: Path = Path("runs/ppo")
    """Folder of the run."""
    seed: int = 0
    """Seed of everything: arms, moves, weights, exploration. At most 6 999 999; validation and test lie above."""
    base: Literal["paper", "rigid"] = "paper"
    """Controller that the residual corrects."""
    total_steps: int = 4_000_000
    """Agent steps, each of `hold` samples."""
    arms: int = 512
    """Arms simulated side by side."""
    rollout_steps: int = 32
    """Agent steps per arm between two updates."""
    batch_size: int = 4096
    """Samples per gradient step."""
    epochs: int = 5
    """Passes over each rollout."""
    learning_rate: float = 5e-4
    """Initial learning rate, falling linearly to zero."""
    gamma: float = 0.97
    """Discount per agent step."""
    gae_lambda: float = 0.95
    """Bias against variance of the advantage estimate."""
    clip_range: float = 0.2
    """PPO's clipping range."""
    entropy: float = 0.001
    """Weight of the entropy bonus, which keeps exploration from dying early."""
    initial_log_std: float = -1.0
    """Logarithm of the initial exploration noise; the residual's range is -1 to 1."""
    hidden: tuple[int, ...] = (64, 64)
    """Hidden layers of policy and value network."""
    activation: Literal["relu", "tanh", "elu"] = "relu"
    """Activation function; tanh takes twice as long."""
    residual_limit: float = 1.0
    """Largest residual, as a share of the torque limit."""
    hold: int = 12
    """Samples for which a residual is held: 18 ms, a slow enough exploration to move the arm."""
    reward_scale: float = 0.08
    """Factor on the mean reward over a hold, so that values are of order 1."""
    validation_every: int = 500_000
    """Agent steps between validations."""
    validation_arms: int = 128
    """Arms per validation."""
    threads: int = 1
    """Threads of PyTorch; more than one slows networks of this size down."""
    device: str = "cpu"
    """Where the networks live."""
    resume: bool = False
    """Go on with the run in `out`, on fresh arms; PPO's own settings stay those that it began with."""

    def check(self) -> None:
        """Check what PPO itself does not.

        Raises:
            ValueError: Naming the option.
        """
        for name in ("total_steps", "arms", "rollout_steps", "batch_size", "epochs", "validation_every", "threads"):
            if getattr(self, name) < 1:
                raise ValueError(f"--{name.replace('_', '-')} must be at least 1, got {getattr(self, name)}")
        if not 0 <= self.seed < 7_000_000:
            raise ValueError(f"--seed must lie within 0 and 6999999, got {self.seed}")
        if self.arms * self.rollout_steps < 2:
            raise ValueError("--arms times --rollout-steps must be at least 2")


def make_model(config: Config, checkpoint: Checkpoint) -> PPO:
    """A new PPO model, or the checkpoint's."""
    settings = ResidualSettings(config.residual_limit, config.hold)
    arms = BeltArmVectorEnv(config.arms, randomization="train", autoreset_mode="SameStep")
    env = ResidualVecEnv(arms, CONTROLLERS[config.base](), settings, reward_scale=config.reward_scale / config.hold)
    if config.resume:
        model = PPO.load(checkpoint.model, env=env, device=config.device)
        env.seed(config.seed + model.num_timesteps % 1_000_003)  # other arms than the run began with
        return model
    return PPO(
        "MlpPolicy",
        env,
        learning_rate=lambda remaining: config.learning_rate * remaining,
        n_steps=config.rollout_steps,
        batch_size=config.batch_size,
        n_epochs=config.epochs,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        clip_range=config.clip_range,
        ent_coef=config.entropy,
        policy_kwargs={
            "net_arch": list(config.hidden),
            "activation_fn": ACTIVATIONS[config.activation],
            "log_std_init": config.initial_log_std,
        },
        seed=config.seed,
        device=config.device,
    )


def train(config: Config) -> None:
    """Run the training, from the beginning or from the checkpoint."""
    config.check()
    torch.set_num_threads(config.threads)
    checkpoint = Checkpoint(config.out)
    progress = checkpoint.load_progress() if config.resume else None
    require_writable(config.out)
    model = make_model(config, checkpoint)
    write_text(config.out / "config.json", json.dumps(asdict(config), indent=2, default=str) + "\n")
    suffix = f"_from_{model.num_timesteps}" if config.resume else ""
    formats = [make_output_format(kind, str(config.out), suffix) for kind in ("csv", "tensorboard")]
    model.set_logger(Logger(str(config.out), formats))
    spec = BundleSpec(
        "ppo",
        config.base,
        ResidualSettings(config.residual_limit, config.hold),
        config.hidden,
        config.activation,
        provenance={
            "command": shlex.join(["python", "train/ppo.py", *sys.argv[1:]]),
            "version": __version__,
            "config": json.loads(json.dumps(asdict(config), default=str)),
        },
    )
    monitor = TrainingMonitor(
        checkpoint,
        spec,
        total_steps=config.total_steps,
        every=config.validation_every,
        arms=config.validation_arms,
        progress=progress,
    )
    with interruptible():
        try:
            remaining = config.total_steps - model.num_timesteps
            if remaining > 0:
                model.learn(remaining, callback=monitor, log_interval=10, reset_num_timesteps=not config.resume)
        except KeyboardInterrupt:
            monitor.stop()
            command = shlex.join(["python", "train/ppo.py", *(a for a in sys.argv[1:] if a != "--resume"), "--resume"])
            print(f"interrupted at {model.num_timesteps} steps, saved in {config.out}; to go on:\n  {command}")
            sys.exit(130)
    run = {"steps": model.num_timesteps, "seconds": round(monitor.seconds, 1)}
    save_bundle(config.out / "last", replace(spec, provenance={**spec.provenance, "run": run}), model.policy)
    annotate(checkpoint.best, run=run)
    print(f"{model.num_timesteps} steps in {monitor.seconds:.0f} s; best policy: {config.out / 'best'}")
    print(f"compare it: python eval/compare.py --policy {config.out / 'best'}")


def main() -> None:
    """Command line."""
    config = tyro.cli(Config, description=__doc__)
    try:
        train(config)
    except (OSError, ValueError) as error:
        print(f"train/ppo.py: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
