"""Run that fits an observer: options, simulation in blocks that are kept, fit, and the file.

The fit is the least negative log-likelihood of the truth, by Adam; what acts is the running average of the weights.

Simulated episodes are kept beside the file until it is written: an interrupted run goes on with those that it has.
"""

from __future__ import annotations

import copy
import hashlib
import shutil
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from rich.console import Console
from safetensors.torch import load, save

import agents
import baselines
import beltarm_env
from agents.observer.episodes import STUDENT, Episodes, simulate_block
from agents.observer.network import Observer, save_observer
from agents.policy.actor import Regression
from agents.policy.bundle import read_spec
from agents.residual.knowledge import Knowledge
from agents.runs.checkpoint import written_by
from baselines.engines.parallel import Channel, Failure, run_side_by_side
from baselines.gains import FILE as GAINS
from baselines.tools.command import require_bounds
from baselines.tools.files import require_writable, write_atomically
from baselines.tools.options import Groups
from baselines.tools.progress import progress_rows
from baselines.tools.provenance import command_line
from beltarm_env.sources import sources_digest
from beltarm_env.task.seeds import OBSERVER

_MAX_GRADIENT = 1.0
_FARTHEST = 20.0  # errors e that count: those of an arm that is about to leave would drown the others'
_BLOCK = 512  # episodes that are simulated side by side, and kept in one file


@dataclass(frozen=True)
class ObserverConfig:
    """Fit a learned observer."""

    groups: ClassVar[Groups] = {"basic": ("out", "knowledge", "episodes", "seed", "jobs"), "algorithm": ()}

    out: Path | None = None
    """File to write. Default: runs/observer/KNOWLEDGE.safetensors."""
    knowledge: Knowledge = "belief"
    """What the observer starts from: the belief of the filter ("belief"), which it corrects, or the measurements alone
    ("none")."""
    hold: int = 4
    """Samples between two estimates."""
    width: int = 32
    """Width of the GRU."""
    episodes: int = 12_288
    """Episodes to simulate, each on its own arm."""
    epochs: int = 4
    """Passes over all episodes."""
    learning_rate: float = 3e-3
    """Learning rate at the start. It falls to zero."""
    batch_size: int = 32
    """Episodes in each gradient step."""
    seed: int = 0
    """Seed of the weights and of the order of episodes. The arms are always the same."""
    jobs: int = 2
    """Processes for the simulation."""

    def check(self) -> Observer:
        """Check the options, and make an untrained observer.

        Raises:
            ValueError: Naming what is out of range, its value and the bound.
        """
        require_bounds(self, episodes=(6, OBSERVER.size), epochs=(1, 1000), batch_size=(1, None), jobs=(1, 256))
        require_bounds(self, seed=(0, 2**32 - 1))
        if not 0 < self.learning_rate <= 1:
            raise ValueError(f"--learning-rate must be above 0 and at most 1, got {self.learning_rate}")
        torch.manual_seed(self.seed)
        return Observer(self.knowledge, self.width, self.hold)

    @property
    def file(self) -> Path:
        """The file to write."""
        return self.out or Path(f"runs/observer/{self.knowledge}.safetensors")

    @property
    def folder(self) -> Path:
        """Folder of the simulated episodes, until the file is written."""
        return self.file.parent / f".{self.file.stem}-episodes"


def negative_log_likelihood(observer: Observer, episodes: Episodes) -> torch.Tensor:
    """Mean of (d - g)^2 / 2 exp(2 s) + s over samples and quantities, with d = (truth - b) / e, cut at `_FARTHEST`."""
    inputs = episodes.inputs.float()
    g, s = observer(inputs)
    d = ((episodes.truth - observer.believed(inputs)) / observer.error).clamp(-_FARTHEST, _FARTHEST)
    return (0.5 * ((d - g) / s.exp()).square() + s).mean()


def fit(observer: Observer, episodes: Episodes, config: ObserverConfig) -> Iterator[tuple[float, float]]:
    """Fit an untrained observer in place, by the running average of the weights; its scales are those of the episodes.

    Yields:
        Share that is done, and the loss, after every gradient step.

    Raises:
        ValueError: If the loss is not finite.
    """
    observer.set_scales(episodes.inputs.float())
    errors = episodes.truth - observer.believed(episodes.inputs.float())
    observer.error = errors.flatten(0, 1).square().mean(dim=0).sqrt()
    del errors  # as large as all episodes
    network = copy.deepcopy(observer)
    regression = Regression(network, _MAX_GRADIENT)
    count = episodes.truth.shape[1]
    batches = [rows for _ in range(config.epochs) for rows in torch.randperm(count).split(config.batch_size)]
    for k, rows in enumerate(batches):
        loss = negative_log_likelihood(network, Episodes(*(part[:, rows] for part in episodes)))
        if not np.isfinite(loss.item()):
            raise ValueError("the observer diverged: fit it with a smaller --learning-rate")
        regression.step(loss, config.learning_rate * (1 - k / len(batches)))
        yield (k + 1) / len(batches), loss.item()
    observer.load_state_dict(regression.averaged().state_dict())


def _simulated(config: ObserverConfig, observer: Observer) -> Episodes:
    """Simulate all episodes, but for those that an interrupted run left."""
    stem = f"{config.knowledge}-{config.hold}-{_depends_on()}"
    blocks = [(first, min(_BLOCK, config.episodes - first)) for first in range(0, config.episodes, _BLOCK)]
    files = {block: config.folder / f"{stem}-{block[0]}-{block[1]}.safetensors" for block in blocks}
    missing = {block: file for block, file in files.items() if not file.exists()}
    tasks = {file.name: partial(_simulate, observer, *block, file) for block, file in missing.items()}
    with (
        closing(run_side_by_side(tasks, config.jobs)) as outcomes,
        progress_rows(["episodes"], len(blocks), Console(stderr=True)) as show,
    ):
        show("episodes", len(blocks) - len(missing))
        for done, (_, outcome) in enumerate(outcomes, len(blocks) - len(missing) + 1):
            if isinstance(outcome, Failure):
                raise outcome.error
            show("episodes", done)
    return Episodes.joined([Episodes(**load(file.read_bytes())) for file in files.values()])


def _depends_on() -> str:
    """Hash of everything that simulated episodes depend on."""
    code = sources_digest(*(Path(package.__path__[0]) for package in (beltarm_env, baselines, agents)))
    student = read_spec(STUDENT)[1]["sha256"]
    return hashlib.sha256(GAINS.read_bytes() + f"{code} {student}".encode()).hexdigest()[:12]


def _simulate(observer: Observer, first: int, count: int, file: Path, _: Channel) -> None:
    episodes = simulate_block(observer, first, count)
    write_atomically(file, lambda path: path.write_bytes(save(episodes._asdict())))


def run(config: ObserverConfig) -> None:
    """Simulate, fit and write.

    Raises:
        ValueError: If an option is not allowed, or the fit diverges.
        OSError: If files cannot be written.
        KeyboardInterrupt: If interrupted; simulated episodes are kept.
    """
    observer, began = config.check(), time.perf_counter()
    require_writable(config.file.parent)
    provenance = {"command": command_line(), **written_by(), "config": asdict(config) | {"out": str(config.file)}}
    try:
        episodes = _simulated(config, observer)
        torch.set_num_threads(1)
        torch.manual_seed(config.seed)  # simulating in this process draws from it too
        with progress_rows(["fit"], 1.0, Console(stderr=True)) as show:
            for share, loss in fit(observer, episodes, config):
                show("fit", share, f"loss {loss:.3f}")
    except KeyboardInterrupt:
        message = "interrupted; simulated episodes are kept, and the same command continues with them"
        raise KeyboardInterrupt(message) from None
    seconds = time.perf_counter() - began
    done = {"episodes": episodes.truth.shape[1], "seconds": round(seconds, 1)}
    save_observer(config.file, observer, {**provenance, "run": done})
    shutil.rmtree(config.folder)
    print(f"{done['episodes']} episodes in {seconds:.0f} s: {config.file}, {config.file.stat().st_size / 1000:.0f} kB")
