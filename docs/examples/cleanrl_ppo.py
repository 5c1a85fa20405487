"""PPO in one file, in the style of CleanRL: `python docs/examples/cleanrl_ppo.py`.

It learns what `train/ppo.py --base paper` learns, with the same settings: a torque on top of the paper's controller,
which acts at every sample, while the learned part is held for four. Nothing of the algorithm is hidden in a library.
Interruption, checkpoints and choice of the best policy are left out.

An episode ends in one of two ways, and the estimate of advantages has to tell them apart. An arm that leaves its
workspace is terminated: nothing follows. An episode that is over after 1.8 s is truncated: the motion would go on, and
what it would still bring is the critic's value of the *last* observation. With Gymnasium's same-step autoreset, `step`
returns the first observation of the next episode instead, and the last one in the info. (With next-step autoreset, the
default, one step per episode ignores its action, and would have to be left out of the batch.)

S. Huang et al.: CleanRL: High-quality Single-file Implementations of Deep Reinforcement Learning Algorithms, 2022.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
import tyro
from torch import nn
from torch.distributions.normal import Normal
from torch.utils.tensorboard import SummaryWriter

import beltarm_env  # noqa: F401  registers BeltArm-v0
from agents.policy.actor import Actor
from agents.policy.bundle import BundleSpec, save_bundle
from agents.policy.network import NetworkPolicy
from agents.residual.bases import make_base
from agents.residual.controller import ResidualController, ResidualSettings
from agents.residual.env import ResidualVecEnv
from agents.runs.command_line import compare_command
from agents.runs.training import validate
from baselines.tools.provenance import command_line, software
from beltarm_env.task.cost import MAX_COST
from beltarm_env.task.seeds import MAX_TRAINING_SEED, training_arms


@dataclass
class Args:
    """Options; the defaults are those of `train/ppo.py --base paper`."""

    out: Path = Path("runs/cleanrl_ppo")
    """Folder of the run: the policy, and a log for TensorBoard."""
    seed: int = 0
    """Random seed, 0 to 99. It determines arms, moves, weights and exploration."""
    base: str = "paper"
    """Controller that the agent corrects."""
    total_timesteps: int = 6_000_000
    """Agent steps of the whole run, each of `hold` samples."""
    num_envs: int = 512
    """Arms simulated at the same time."""
    num_steps: int = 64
    """Agent steps per arm between two updates."""
    learning_rate: float = 3.5e-4
    """Learning rate at the start. It falls linearly to zero."""
    gamma: float = 0.988
    """Discount per agent step."""
    gae_lambda: float = 0.962
    """Lambda of the advantage estimate."""
    minibatch_size: int = 2048
    """Agent steps in each gradient step."""
    update_epochs: int = 3
    """Passes over each rollout."""
    clip_coef: float = 0.2
    """Clipping range of the probability ratio."""
    ent_coef: float = 0.008
    """Weight of the entropy bonus."""
    vf_coef: float = 0.5
    """Weight of the value loss, the mean squared error."""
    max_grad_norm: float = 0.5
    """Largest norm of the gradient."""
    initial_log_std: float = -0.66
    """Logarithm of the exploration noise at the start. Residuals lie between -1 and 1."""
    hidden: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of actor and critic."""
    hold: int = 4
    """Samples for which a residual is held. 4 samples are 6 ms."""
    reward_scale: float = 0.036
    """Factor on the mean reward of a hold. It brings values to order 1, and no less than -3 times its bound."""
    torque_price: float = 25.0
    """Price of a torque change in training, as a multiple of the task's price."""
    validation_arms: int = 128
    """Arms on which the policy is compared with its base in the end, at the task's own price."""


def layer_init(layer: nn.Linear, std: float = 2**0.5) -> nn.Linear:
    """Orthogonal weights, no bias."""
    nn.init.orthogonal_(layer.weight, std)
    nn.init.zeros_(layer.bias)
    return layer


def network(inputs: int, hidden: tuple[int, ...], last_std: float) -> nn.Sequential:
    """Layers with ReLUs between them, and one output."""
    layers: list[nn.Module] = []
    for width in hidden:
        layers += [layer_init(nn.Linear(inputs, width)), nn.ReLU()]
        inputs = width
    return nn.Sequential(*layers, layer_init(nn.Linear(inputs, 1), last_std))


class Agent(nn.Module):
    """Actor and critic. Observations need no normalisation: each entry is of order 1 and bounded."""

    def __init__(self, inputs: int, args: Args) -> None:
        super().__init__()
        self.critic = network(inputs, args.hidden, 1.0)
        self.actor_mean = network(inputs, args.hidden, 0.01)  # the first policy is nearly the base alone
        self.actor_logstd = nn.Parameter(torch.full((1,), args.initial_log_std))

    def get_value(self, x: torch.Tensor) -> torch.Tensor:
        """Value of observations, shape (n,)."""
        return self.critic(x).squeeze(-1)

    def get_action_and_value(
        self, x: torch.Tensor, action: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Residual, its log probability, entropy and value, shape (n,) each."""
        probs = Normal(self.actor_mean(x).squeeze(-1), self.actor_logstd.exp())
        if action is None:
            action = probs.sample()
        return action, probs.log_prob(action), probs.entropy(), self.get_value(x)


if __name__ == "__main__":
    args = tyro.cli(Args, description=__doc__)
    if not 0 <= args.seed <= MAX_TRAINING_SEED:
        raise SystemExit(f"--seed must lie within 0 and {MAX_TRAINING_SEED}, got {args.seed}")
    batch_size = args.num_envs * args.num_steps
    num_iterations = -(-args.total_timesteps // batch_size)
    writer = SummaryWriter(args.out)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)  # more make networks of this size slower

    # The arms, and on top of them the base: what is learned, and observed, is the rest
    settings = ResidualSettings(limit=1.0, hold=args.hold)
    envs = ResidualVecEnv(
        gym.make_vec("BeltArm-v0", args.num_envs, randomization="train", autoreset_mode="SameStep"),
        make_base(args.base),
        settings,
        reward_scale=args.reward_scale / args.hold,
        torque_price=args.torque_price,
        worst_reward=3 * MAX_COST * args.reward_scale,  # an arm that leaves is charged for all its samples at once
    )
    envs.seed(training_arms(args.seed).first)
    inputs = envs.observation_space.shape[0]
    agent = Agent(inputs, args)
    optimizer = torch.optim.Adam(agent.parameters(), lr=args.learning_rate, eps=1e-5)

    obs = torch.zeros(args.num_steps, args.num_envs, inputs)
    actions, logprobs, rewards, values, dones, final_values = torch.zeros(6, args.num_steps, args.num_envs)
    global_step, start_time = 0, time.time()
    next_obs = torch.from_numpy(envs.reset())

    for iteration in range(1, num_iterations + 1):
        optimizer.param_groups[0]["lr"] = (1 - (iteration - 1) / num_iterations) * args.learning_rate
        returns_of_episodes = []

        for step in range(args.num_steps):
            global_step += args.num_envs
            obs[step] = next_obs
            with torch.no_grad():
                actions[step], logprobs[step], _, values[step] = agent.get_action_and_value(next_obs)
            seen, reward, done, infos = envs.step(actions[step].clamp(-1, 1)[:, None].numpy())
            next_obs, rewards[step], dones[step] = map(torch.from_numpy, (seen, reward, done))

            final_values[step] = 0.0
            truncated = [k for k in np.flatnonzero(done) if infos[k]["TimeLimit.truncated"]]
            if truncated:
                final_obs = np.stack([infos[k]["terminal_observation"] for k in truncated])
                with torch.no_grad():
                    final_values[step, truncated] = agent.get_value(torch.from_numpy(final_obs))
            returns_of_episodes += [infos[k]["episode"]["r"] for k in np.flatnonzero(done)]

        # Generalised advantage estimate
        advantages = torch.zeros_like(rewards)
        with torch.no_grad():
            next_values, advantage = agent.get_value(next_obs), torch.zeros(args.num_envs)
        for t in reversed(range(args.num_steps)):
            going_on = 1 - dones[t]
            following = going_on * next_values + final_values[t]
            advantage = rewards[t] + args.gamma * (following + args.gae_lambda * going_on * advantage) - values[t]
            advantages[t], next_values = advantage, values[t]
        returns = advantages + values

        # Update, in minibatches
        b_obs = obs.flatten(0, 1)
        b_actions, b_logprobs, b_advantages, b_returns = map(torch.flatten, (actions, logprobs, advantages, returns))
        for _ in range(args.update_epochs):
            for mb in torch.randperm(batch_size).split(args.minibatch_size):
                _, newlogprob, entropy, newvalue = agent.get_action_and_value(b_obs[mb], b_actions[mb])
                logratio = newlogprob - b_logprobs[mb]
                ratio = logratio.exp()
                adv = (b_advantages[mb] - b_advantages[mb].mean()) / (b_advantages[mb].std() + 1e-8)

                pg_loss = -torch.min(adv * ratio, adv * ratio.clamp(1 - args.clip_coef, 1 + args.clip_coef)).mean()
                v_loss = (newvalue - b_returns[mb]).square().mean()
                loss = pg_loss - args.ent_coef * entropy.mean() + args.vf_coef * v_loss

                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), args.max_grad_norm)
                optimizer.step()

        episodic_return = float(np.mean(returns_of_episodes)) if returns_of_episodes else float("nan")
        approx_kl = ((ratio - 1) - logratio).mean().item()
        writer.add_scalar("charts/episodic_return", episodic_return, global_step)
        writer.add_scalar("charts/learning_rate", optimizer.param_groups[0]["lr"], global_step)
        writer.add_scalar("losses/policy_loss", pg_loss.item(), global_step)
        writer.add_scalar("losses/value_loss", v_loss.item(), global_step)
        writer.add_scalar("losses/entropy", entropy.mean().item(), global_step)
        writer.add_scalar("losses/approx_kl", approx_kl, global_step)
        explained = 1 - ((returns - values).var() / returns.var()).item()
        writer.add_scalar("losses/explained_variance", explained, global_step)
        if iteration % 10 == 0 or iteration == num_iterations:
            speed = global_step / (time.time() - start_time)
            print(f"global_step={global_step}, episodic_return={episodic_return:.0f}, SPS={speed:.0f}", flush=True)

    run = {"steps": global_step, "seconds": round(time.time() - start_time, 1)}

    # The actor as a policy that the comparison takes, and its cost on arms that it has not met
    spec = BundleSpec("ppo", args.base, settings, args.hidden, "relu")
    actor = Actor(spec.shape())
    actor.layers.load_state_dict(agent.actor_mean.state_dict())
    policy = NetworkPolicy(actor.weights())
    of_base = validate(make_base(args.base), args.validation_arms)
    scores = validate(ResidualController(make_base(args.base), policy, settings), args.validation_arms)
    provenance = {
        "command": command_line(),
        **software("gymnasium", "torch"),
        "config": {**asdict(args), "out": str(args.out)},
        "run": run,
        "reached": {**run, "validation": scores},
        "validation_of_base": of_base,
    }
    save_bundle(args.out / "policy", replace(spec, provenance=provenance), actor.weights())
    costs = f"{of_base['cost']:.1f} of {args.base} alone, {scores['cost']:.1f} with the residual"
    print(f"cost on {args.validation_arms} validation arms: {costs}")
    print(f"compare it: {compare_command([args.out / 'policy'])}")
    writer.close()
    envs.close()
