"""Run that fits an observer: options, episodes, fit, and the file.

The episodes are working shifts, of arms of the training ranges under the torques of many controllers: an observer that
has seen one controller's torques alone would take that controller's habits for the arm's. Some of the torques are
disturbed besides, by noise of first order of a size that differs from arm to arm. They are simulated in blocks, kept
beside the file until it is written: an interrupted run goes on with those that it has.

The fit is the least negative log-likelihood of the truth, by Adam; what acts is the running average of the weights.
"""

from __future__ import annotations

import hashlib
import shutil
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from safetensors.torch import load, save

import agents
import baselines
import beltarm_env
from agents.observer.network import Observer, save_observer
from agents.observer.quantities import truth
from agents.policy.actor import Regression
from agents.policy.bundle import POLICIES, load_controller, read_spec
from agents.residual.bases import make_base
from agents.residual.knowledge import InformedBase, Knowledge
from agents.runs.checkpoint import written_by
from baselines.engines.parallel import Channel, Failure, SideBySide, run_side_by_side
from baselines.gains import FILE as GAINS
from baselines.tools.command import require_bounds
from baselines.tools.files import require_writable, write_atomically
from baselines.tools.options import Groups
from baselines.tools.progress import progress_rows
from baselines.tools.provenance import command_line
from beltarm_env.arrays import Flags, Singles
from beltarm_env.rollout import Controller, rollout
from beltarm_env.sources import sources_digest
from beltarm_env.task.ranges import RANGES, Randomization
from beltarm_env.task.seeds import OBSERVER

STUDENT = POLICIES / "student" / "seed0"
"""Policy that acts where a source is the student."""
_MEMORY = 0.97  # of the noise from sample to sample: 50 ms
_FARTHEST = 20.0  # errors e that count: those of an arm that is about to leave would drown the others'
_BLOCK = 128  # episodes that are simulated side by side, and kept in one file
_MOVES = 4
_SEGMENT = 600  # samples through which gradients go back; the memory goes on to the next segment


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
    width: int = 64
    """Width of the GRU."""
    episodes: int = 3_072
    """Episodes to simulate, each a working shift of four moves with an arm of its own."""
    epochs: int = 4
    """Passes over all episodes."""
    learning_rate: float = 2e-3
    """Learning rate at the start. It falls to zero."""
    batch_size: int = 16
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


# Episodes


class Source(NamedTuple):
    """Controller whose torques an observer is fitted to."""

    name: str  # of a classical controller, or "student"
    noise: float = 0.0  # largest standard deviation of what is added to its torque, over the torque limit

    def controller(self) -> Controller:
        """Make the controller."""
        return load_controller(STUDENT) if self.name == "student" else make_base(self.name)


SOURCES = (
    Source("adaptive"),
    Source("adaptive", 0.05),
    Source("student"),
    Source("student", 0.05),
    Source("preview", 0.05),
    Source("paper"),
)


class Episodes(NamedTuple):
    """What an observer sees in n episodes, and what there was to be seen."""

    inputs: torch.Tensor  # (T, n, inputs), half precision
    truth: torch.Tensor  # (T, n, quantities)

    @staticmethod
    def joined(parts: list[Episodes]) -> Episodes:
        """Join parts, episode after episode."""
        return Episodes(*(torch.cat(tensors, dim=1) for tensors in zip(*parts, strict=True)))


class Disturbed:
    """Controller whose torque is disturbed, and that notes what an observer sees; for one rollout."""

    def __init__(self, source: Source, observer: Observer, seed: int, count: int) -> None:
        self.informed = InformedBase(source.controller(), observer.knowledge)
        self.params, self.profile = self.informed.params, self.informed.profile
        self.inputs: list[NDArray[np.float16]] = []
        self._observer = observer
        self._random = np.random.default_rng(seed)
        self._step = 0
        self._size = source.noise * self._random.random((count, 1))
        self._disturbance = np.zeros((count, 1))

    def predict(
        self, observation: Singles, state: Any = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Call the controller's `predict`, and disturb what it returns."""
        informed = self.informed.advance(observation, state, episode_start)
        if self._step % self._observer.hold == 0:
            seen = self.informed.seen(observation, informed)
            self.inputs.append(seen[:, self._observer.columns].astype(np.float16))
        self._step += 1
        fresh = self._random.standard_normal((len(observation), 1))
        self._disturbance = _MEMORY * self._disturbance + np.sqrt(1 - _MEMORY**2) * self._size * fresh
        return (informed.action + self._disturbance.astype(np.float32)).clip(-1, 1), informed


def simulate(
    source: Source, observer: Observer, first: int, count: int, randomization: Randomization = "train"
) -> Episodes:
    """Run a source on shifts of arms seeded from `first` on, and leave out those that leave their workspace."""
    disturbed = Disturbed(source, observer, first, count)
    recording = rollout(disturbed, count, seed=first, randomization=randomization, moves=_MOVES)
    stayed = np.flatnonzero(recording.stayed)
    true = truth(recording, observer.hold)[:, stayed]
    inputs = np.stack(disturbed.inputs)[:, stayed]
    return Episodes(torch.from_numpy(inputs), torch.from_numpy(true.astype(np.float32)))


def _simulated(config: ObserverConfig, observer: Observer) -> Episodes:
    """Simulate all episodes, but for those that an interrupted run left.

    In every other block parts are as light as those of a single move, and motors do not give, as for a student.
    """
    stem = f"{config.knowledge}-{config.hold}-{_depends_on()}"
    blocks = [(first, min(_BLOCK, config.episodes - first)) for first in range(0, config.episodes, _BLOCK)]
    files = {block: config.folder / f"{stem}-{block[0]}-{block[1]}.safetensors" for block in blocks}
    missing = {block: file for block, file in files.items() if not file.exists()}
    tasks = {
        file.name: partial(_simulate, observer, *block, RANGES["train"] if block[0] // _BLOCK % 2 else "train", file)
        for block, file in missing.items()
    }
    with (
        closing(run_side_by_side(tasks, SideBySide(jobs=config.jobs))) as outcomes,
        progress_rows(["episodes"], len(blocks), Console(stderr=True)) as show,
    ):
        show("episodes", len(blocks) - len(missing), "")
        for done, (_, outcome) in enumerate(outcomes, len(blocks) - len(missing) + 1):
            if isinstance(outcome, Failure):
                raise outcome.error
            show("episodes", done, "")
    return Episodes.joined([Episodes(**load(file.read_bytes())) for file in files.values()])


def _depends_on() -> str:
    """Hash of everything that simulated episodes depend on."""
    code = sources_digest(*(Path(package.__path__[0]) for package in (beltarm_env, baselines, agents)))
    student = read_spec(STUDENT)[1]["sha256"]
    return hashlib.sha256(GAINS.read_bytes() + f"{code} {student}".encode()).hexdigest()[:12]


def _simulate(
    observer: Observer, offset: int, count: int, randomization: Randomization, file: Path, _: Channel
) -> None:
    """Run all sources in turn on `count` of the observer's arms, from the one at `offset` on."""
    ends = np.linspace(0, count, len(SOURCES) + 1).round().astype(int)
    spans = zip(SOURCES, OBSERVER.first + offset + ends[:-1], np.diff(ends), strict=True)
    parts = [simulate(source, observer, int(first), int(size), randomization) for source, first, size in spans if size]
    write_atomically(file, lambda path: path.write_bytes(save(Episodes.joined(parts)._asdict())))


# Fit


def negative_log_likelihood(
    observer: Observer, episodes: Episodes, memory: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean of (d - g)^2 / 2 exp(2 s) + s over samples and quantities, with d = (truth - b) / e, cut at `_FARTHEST`.

    It is that of a segment which begins with a memory; the second value is the memory after it.
    """
    inputs = episodes.inputs.float()
    g, s, following = observer(inputs, memory)
    d = ((episodes.truth - observer.believed(inputs)) / observer.error).clamp(-_FARTHEST, _FARTHEST)
    return (0.5 * ((d - g) / s.exp()).square() + s).mean(), following


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
    regression = Regression(observer)
    count = episodes.truth.shape[1]
    batches = [rows for _ in range(config.epochs) for rows in torch.randperm(count).split(config.batch_size)]
    for k, rows in enumerate(batches):
        memory = None
        for segment in zip(*(part[:, rows].split(max(_SEGMENT // observer.hold, 1)) for part in episodes), strict=True):
            loss, memory = negative_log_likelihood(observer, Episodes(*segment), memory)
            memory = memory.detach()
            if not np.isfinite(loss.item()):
                raise ValueError("the observer diverged: fit it with a smaller --learning-rate")
            regression.step(loss, config.learning_rate * (1 - k / len(batches)))
            yield (k + 1) / len(batches), loss.item()
    observer.load_state_dict(regression.averaged().state_dict())


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
