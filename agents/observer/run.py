"""Run that fits an observer: options, simulation in blocks that are kept, fit, and the file.

Simulated episodes are kept beside the file until it is written: an interrupted run goes on with those that it has.
"""

from __future__ import annotations

import shutil
import time
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from rich.console import Console

import agents
import baselines
import beltarm_env
from agents.observer.episodes import Episodes, simulate_block
from agents.observer.files import save_observer
from agents.observer.fitting import fit, standardise
from agents.observer.network import Observer
from agents.residual.knowledge import Knowledge
from agents.runs.checkpoint import written_by
from baselines.tools.command import require_bounds
from baselines.tools.files import require_writable, write_atomically
from baselines.tools.parallel import Channel, Failure, run_side_by_side
from baselines.tools.progress import progress_rows
from baselines.tools.provenance import command_line
from beltarm_env.jit import sources_digest
from beltarm_env.task.seeds import OBSERVER

_BLOCK = 512  # episodes that are simulated side by side, and kept in one file


@dataclass(frozen=True)
class ObserverConfig:
    """Fit a learned observer."""

    out: Path = Path("runs/observer/belief.safetensors")
    """The file to write."""
    knowledge: Knowledge = "belief"
    """Correct the belief of the filter, or see the measurements alone: "none"."""
    hold: int = 4
    """Samples from one estimate to the next."""
    width: int = 32
    """Width of the GRU."""
    episodes: int = 12_288
    """Episodes to simulate, each on an arm of its own."""
    epochs: int = 4
    """Passes over them."""
    learning_rate: float = 3e-3
    """Learning rate at first; it falls to zero."""
    batch_size: int = 32
    """Episodes per gradient step."""
    seed: int = 0
    """Seed of weights and of the order of episodes; arms are the same for all."""
    jobs: int = 2
    """Processes that simulate."""

    def check(self) -> Observer:
        """Check the options, and make an untrained observer.

        Raises:
            ValueError: Naming the option, its value and the bound.
        """
        require_bounds(self, episodes=(6, OBSERVER.size), epochs=(1, 1000), batch_size=(1, None), jobs=(1, 256))
        if not 0 < self.learning_rate <= 1:
            raise ValueError(f"--learning-rate must be above 0 and at most 1, got {self.learning_rate}")
        torch.manual_seed(self.seed)
        return Observer(self.knowledge, self.width, self.hold)


def _simulated(config: ObserverConfig, observer: Observer) -> Episodes:
    """Simulate all episodes, but for those that an interrupted run left."""
    count = min(_BLOCK, config.episodes)
    blocks = -(-config.episodes // count)
    folder = _folder(config)
    code = sources_digest(*(Path(package.__path__[0]) for package in (beltarm_env, baselines, agents)))[:12]
    stem = f"{config.knowledge}-{config.hold}-{count}-{code}"
    files = {f"{k}": folder / f"{stem}-{k}.npz" for k in range(blocks)}
    left = {name: file for name, file in files.items() if not file.exists()}
    tasks = {name: partial(_simulate, observer, int(name), count, file) for name, file in left.items()}
    with (
        closing(run_side_by_side(tasks, config.jobs)) as outcomes,
        progress_rows(["episodes"], blocks, Console(stderr=True)) as rows,
    ):
        for k, (_, outcome) in enumerate(outcomes, blocks - len(left) + 1):
            if isinstance(outcome, Failure):
                raise outcome.error
            rows.show("episodes", k)
    return Episodes.joined([_read(file) for file in files.values()])


def _simulate(observer: Observer, block: int, count: int, file: Path, _: Channel) -> None:
    inputs, truth = simulate_block(observer, block, count)
    write_atomically(file, lambda path: np.savez(path, allow_pickle=False, inputs=inputs.numpy(), truth=truth.numpy()))


def _read(file: Path) -> Episodes:
    with np.load(file, allow_pickle=False) as stored:
        return Episodes(torch.from_numpy(stored["inputs"]), torch.from_numpy(stored["truth"]))


def _folder(config: ObserverConfig) -> Path:
    return config.out.parent / f".{config.out.stem}-episodes"


def run(config: ObserverConfig) -> None:
    """Simulate, fit and write.

    Raises:
        ValueError: If an option is not allowed, or the fit diverges.
        OSError: If files cannot be written.
        KeyboardInterrupt: If interrupted; simulated episodes are kept.
    """
    observer = config.check()
    require_writable(config.out.parent)
    try:
        _fit_and_save(config, observer)
    except KeyboardInterrupt:
        kept = "interrupted; simulated episodes are kept, the same command goes on with them"
        raise KeyboardInterrupt(kept) from None


def _fit_and_save(config: ObserverConfig, observer: Observer) -> None:
    began = time.perf_counter()
    provenance = {"command": command_line(), **written_by(), "config": asdict(config) | {"out": str(config.out)}}
    episodes = _simulated(config, observer)
    torch.set_num_threads(1)
    standardise(observer, episodes)
    with progress_rows(["fit"], 1.0, Console(stderr=True)) as rows:
        for share, loss in fit(observer, episodes, config.epochs, config.learning_rate, config.batch_size):
            rows.show("fit", share, f"loss {loss:.3f}")
    seconds = time.perf_counter() - began
    done = {"episodes": episodes.truth.shape[1], "seconds": round(seconds, 1)}
    save_observer(config.out, observer, {**provenance, "run": done})
    shutil.rmtree(_folder(config))
    print(f"{done['episodes']} episodes in {seconds:.0f} s: {config.out}, {config.out.stat().st_size / 1000:.0f} kB")
