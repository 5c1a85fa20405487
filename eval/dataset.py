"""Write a dataset for offline learning, with Minari: `python eval/dataset.py`.

Controllers take turns, on arms of their own; random torques disturb some of the episodes. docs/guide/dataset.md tells
what is in a dataset, and how to use it. Needs the extra minari.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import tyro
from rich.console import Console

from baselines.tools.command import require_bounds, run_command
from baselines.tools.progress import progress_count
from beltarm_env.observation import Sensors
from beltarm_env.task.seeds import DATASET_SPACING, MAX_DATASET_SEED, dataset_arms
from eval.offline.contents import Mixture, table
from eval.offline.writing import Place, write_dataset


@dataclass(frozen=True)
class Config:
    """Write a dataset for offline learning."""

    id: str = "beltarm/randomized/mixed-v0"
    """Name of the dataset."""
    out: Path = Path("results/datasets")
    """Folder that datasets are in: MINARI_DATASETS_PATH, where Minari is to find it."""
    controller: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A classical controller by name, or one of your own as path/to/file.py:Class. Repeat the option for more."""
    policy: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Folder of a policy, such as runs/ppo/best. Repeat the option for more. Without --controller and --policy: paper,
    adaptive and the shipped student."""
    disturbed: float = 0.5
    """Share of episodes that random torques disturb, 0 to 1."""
    episodes: int = 600
    """Number of episodes; controllers take turns."""
    seed: int = 0
    """Datasets of different seeds have different arms and moves."""
    randomization: Literal["off", "ideal", "train"] = "train"
    """Ranges that arms are drawn from."""
    sensors: Sensors = "encoder"
    """What the observations hold."""
    overwrite: bool = False
    """Replace a dataset of this name."""


def run(config: Config) -> None:
    """Run the controllers, and write the dataset.

    Raises:
        DependencyNotInstalled: If Minari is not installed.
        ValueError: If an option is not allowed.
        OSError: If the folder cannot be written to.
    """
    require_bounds(config, episodes=(1, DATASET_SPACING), seed=(0, MAX_DATASET_SEED))
    place = Place(config.out, config.id)
    place.check(config.overwrite)
    settings = {"randomization": config.randomization, "sensors": config.sensors}
    mixture = Mixture.of(config.controller, config.policy, config.disturbed, settings)
    with progress_count("episodes", Console()) as done:
        pieces = mixture.episodes(dataset_arms(config.seed).first, config.episodes, done)
        write_dataset(place, pieces, mixture.about(config.seed))
    print(table(place))
    print(f"written to {place.path}, {place.megabytes:.0f} MB; in Python, with MINARI_DATASETS_PATH={config.out}:")
    print(f'  dataset = minari.load_dataset("{config.id}")')


def main() -> None:
    """Command line."""
    run_command(__file__, Config, run, __doc__)


if __name__ == "__main__":
    main()
