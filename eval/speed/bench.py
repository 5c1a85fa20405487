"""Speed of environments, controllers and training, each beside a peer in the same run.

Runs take turns; times and ratios are medians over the repetitions, start-ups the best of theirs. Between machines,
compare the ratios to the peer.

Over the size of the batch there are other vectorised environments on the same core. EnvPool (J. Weng et al.: EnvPool: A
Highly Parallel Reinforcement Learning Environment Execution Engine, NeurIPS 2022) steps carts in C++; gymnax (R. T.
Lange, 2022) in JAX, made for graphics processors. Both are in the extra `bench`.
"""

import importlib
import importlib.util
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from baselines.tools.progress import progress_over
from beltarm_env.arrays import Floats
from eval.report.style import BLUE, GREEN, ORANGE, PINK, SKY, VERMILION
from eval.report.text import markdown_table
from eval.speed import stepping
from eval.speed.stepping import batch_steps, times_in_turns
from eval.studies._frame import Bounds, Pictures, StudyOptions

Part = Literal["steps", "rollouts", "start", "training", "sizes"]
PARTS: tuple[Part, ...] = ("steps", "rollouts", "start", "training", "sizes")
QUICK: Mapping[str, Any] = {"parts": ("steps", "sizes"), "arms": 64, "repetitions": 1, "steps": 2, "largest": 20}
SIZES = (1, 4, 16, 64, 256, 1024, 4096, 16384, 100_000)
"""Arms or carts of a batch."""
Stepper = Callable[[int, int], Callable[[], object]]
"""Makes a batch of so many arms, and returns a function that takes so many steps of all."""
_TIME = 0.1  # of a repetition [s], about
_FEWEST, _MOST = 10, 2000  # steps of it
_LOOKS = ((VERMILION, "o-"), (ORANGE, "o--"), (BLUE, "s-"), (GREEN, "^-"), (PINK, "v-"), (SKY, "v--"))


@dataclass(frozen=True)
class Options(StudyOptions):
    """Options of the measurement."""

    bounds = Bounds(dict.fromkeys(("arms", "steps", "largest"), (1, 1_000_000)), repetitions=(1, 1000))

    parts: tuple[Part, ...] = PARTS
    """Parts to measure: steps of environments; rollouts with controllers; start-up and memory; PPO's training loop;
    steps over the size of the batch, beside all peers that are installed (extra `bench`)."""
    arms: int = 4096
    """Arms of the batch."""
    repetitions: int = 9
    """Repetitions of each measurement."""
    steps: int = 100
    """Steps per repetition of a batch. Single arms take a hundred times as many."""
    largest: int = 100_000
    """Largest batch beside the peers."""


def measure(options: Options) -> dict[str, Any]:
    """Measure the chosen parts."""
    arms, steps, repetitions, parts = options.arms, options.steps, options.repetitions, options.parts
    rows = []
    data: dict[str, Any] = {"repetitions": repetitions, "sizes": {}, "rates": {}}
    if "steps" in parts:
        rows += [*stepping.batch_rows(arms, steps, repetitions), *stepping.single_rows(steps, repetitions)]
    if "rollouts" in parts:
        rows += stepping.rollout_rows(repetitions)
    if "start" in parts:
        rows += [*stepping.start_up_rows(repetitions), *stepping.memory_rows()]
    if "training" in parts:
        rows += stepping.training_rows(repetitions)
    if "sizes" in parts:
        data["sizes"] = [size for size in SIZES if size <= options.largest]
        data["rates"] = _rates(data["sizes"], repetitions)
    return {**data, "rows": [row._asdict() for row in rows]}


def _rates(sizes: Sequence[int], repetitions: int) -> dict[str, Floats]:
    """Quartiles of the steps per second of all that is installed, each of shape (sizes, 3); on one core if possible."""
    steppers = {name: step for name, (package, step) in STEPPERS.items() if importlib.util.find_spec(package)}
    cores, measured = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else (), []
    try:
        if cores:
            os.sched_setaffinity(0, {max(cores)})
        for size in progress_over("sizes", sizes, Console()):
            trials = [times_in_turns([step(size, _FEWEST)], 3).min() / _FEWEST for step in steppers.values()]
            counts = [int(np.clip(_TIME / took, _FEWEST, _MOST)) for took in trials]
            runs = [step(size, count) for step, count in zip(steppers.values(), counts, strict=True)]
            measured.append(size * np.array(counts) / times_in_turns(runs, repetitions))
    finally:
        if cores:
            os.sched_setaffinity(0, cores)
    quartiles = np.quantile(measured, [0.25, 0.5, 0.75], axis=1)  # of (sizes, repetitions, steppers)
    return {name: quartiles[:, :, k].T for k, name in enumerate(steppers)}


def _pushes(carts: int, steps: int) -> list[Any]:
    """Random actions of carts for each step."""
    actions = np.random.default_rng(0).integers(0, 2, size=(16, carts), dtype=np.int32)
    return [actions[step % len(actions)] for step in range(steps)]


def _envpool(carts: int, steps: int) -> Callable[[], object]:
    """Step EnvPool's CartPole, in C++, with one thread."""
    envpool = importlib.import_module("envpool")
    env = envpool.make("CartPole-v1", env_type="gymnasium", num_envs=carts, num_threads=1, seed=0)
    env.reset()
    pushes = _pushes(carts, steps)
    return lambda: [env.step(push) for push in pushes]


def _gymnax_steps(carts: int, steps: int) -> Callable[[], object]:
    """Step gymnax's CartPole, one compiled call a step."""
    jax, step, beginning = _gymnax(carts)
    pushes, split = _pushes(carts, steps), jax.jit(lambda key: jax.random.split(key, carts))

    def run() -> None:
        states = beginning
        for k, push in enumerate(pushes):
            result = step(split(jax.random.key(k)), states, push)
            states = result[1]
            np.asarray(result[0])  # what an agent needs

    return run


def _gymnax_loop(carts: int, steps: int) -> Callable[[], object]:
    """Step gymnax's CartPole in a loop that is compiled too and draws the actions: no agent outside takes part."""
    jax, step, beginning = _gymnax(carts)

    def advance(states: Any, key: Any) -> Any:
        actions = jax.random.randint(key, (carts,), 0, 2)
        result = step(jax.random.split(key, carts), states, actions)
        return result[1], result[2].sum()

    loop = jax.jit(lambda states: jax.lax.scan(advance, states, jax.random.split(jax.random.key(0), steps)))
    return lambda: jax.block_until_ready(loop(beginning))


def _gymnax(carts: int) -> tuple[Any, Any, Any]:
    """JAX, the compiled step of keys, states and actions, and states to begin from."""
    jax, gymnax = importlib.import_module("jax"), importlib.import_module("gymnax")
    env, params = gymnax.make("CartPole-v1")
    keys = jax.random.split(jax.random.key(0), carts)
    _, beginning = jax.vmap(env.reset, in_axes=(0, None))(keys, params)
    return jax, jax.jit(jax.vmap(lambda key, state, action: env.step(key, state, action, params))), beginning


STEPPERS: dict[str, tuple[str, Stepper]] = {
    "BeltArm-v0, ideal drives": ("beltarm_env", partial(batch_steps, "BeltArm-v0", randomization="ideal")),
    "BeltArm-v0, all effects of the drive": ("beltarm_env", partial(batch_steps, "BeltArm-v0", randomization="train")),
    "CartPole-v1, Gymnasium": ("gymnasium", partial(batch_steps, "CartPole-v1")),
    "CartPole-v1, EnvPool": ("envpool", _envpool),
    "CartPole-v1, gymnax": ("gymnax", _gymnax_steps),
    "CartPole-v1, gymnax, loop compiled": ("gymnax", _gymnax_loop),
}
"""Package that each needs, and how it is stepped."""


def tables(data: dict[str, Any]) -> dict[str, Any]:
    """Tables of speeds, and of speeds over the size of the batch."""
    speeds = markdown_table(("what", "measured", "peer", "ratio", "middle half"), map(_cells, data["rows"]), "lrrrr")
    rates = {name: [_rounded(median) for _, median, _ in quartiles] for name, quartiles in data["rates"].items()}
    over_sizes = zip([f"{size:,}" for size in data["sizes"]], *rates.values(), strict=False)
    return {
        "speeds": speeds,
        "sizes": markdown_table(("arms or carts", *rates), over_sizes, "r" * (1 + len(rates))) if rates else "",
    }


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    measured, ratios = _quantity(row["measured"], row["unit"]), [f"{ratio:.2f}" for ratio in row["ratios"]]
    peer = f"{row['peer']}: {_quantity(row['of_peer'], row['unit'])}" if ratios else "–"
    ratio = f"{ratios[len(ratios) // 2]}x" if ratios else "–"
    return row["what"], measured, peer, ratio, f"{ratios[0]} to {ratios[2]}" if len(ratios) == 3 else "–"


def _quantity(value: float, unit: str) -> str:
    if unit == "steps/s":
        return f"{_rounded(value)} {unit}"
    return f"{value:.0f} {unit}" if value >= 100 else f"{value:.2g} {unit}"


def _rounded(rate: float) -> str:
    """Format steps per second with two digits or more."""
    for unit, name in ((1e6, " M"), (1e3, " k")):
        if rate >= unit:
            return f"{rate / unit:.1f}{name}" if rate < 100 * unit else f"{rate / unit:.0f}{name}"
    return f"{rate:.0f}"


def pictures(data: dict[str, Any]) -> Pictures:
    """Steps per second over the size of the batch."""
    return {"sizes.png": lambda: _draw(data["sizes"], data["rates"])} if data["rates"] else {}


def _draw(batch_sizes: list[int], rates: dict[str, Any]) -> Figure:
    """Draw medians, and the range between the quartiles."""
    figure, axes = plt.subplots(figsize=(9, 5))
    looks: dict[str, tuple[str, str]] = dict(zip(STEPPERS, _LOOKS, strict=True))
    for name, quartiles in rates.items():
        (colour, look), (low, median, high) = looks[name], np.array(quartiles).T
        axes.plot(batch_sizes, median, look, color=colour, markersize=5, label=name)
        axes.fill_between(batch_sizes, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.set(xscale="log", yscale="log", xlabel="arms or carts of the batch", ylabel="steps per second, one core")
    axes.grid(color="0.9", lw=0.6)
    axes.legend(frameon=False, fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    return figure
