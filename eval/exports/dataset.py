"""Datasets for offline learning, in Minari's format. Needs the extra minari; docs/guide/dataset.md tells their use.

Controllers take turns, on arms of their own. An episode is left as it is, or smooth *noise* is added to its torque, or
in some *stretches* the controller is not asked, and noise is the torque. Everything is drawn from the episode's own
seed, and so the same in any batch.
"""

import os
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple
from unittest.mock import patch

import gymnasium
import numpy as np
import pandas as pd
import tyro
from gymnasium.error import DependencyNotInstalled
from gymnasium.vector import AutoresetMode
from rich.console import Console
from scipy.signal import lfilter

from agents.policy.bundle import POLICIES, load_controller
from baselines.tools.command import require_bounds
from baselines.tools.files import replace_folder, require_writable
from baselines.tools.progress import progress_count
from baselines.tools.provenance import commit, software
from beltarm_env import BeltArmVectorEnv, __version__
from beltarm_env.arm import FIELDS
from beltarm_env.arrays import Flags, Singles
from beltarm_env.observation import LAYOUT, Sensors
from beltarm_env.rollout import Controller, check_data_sheet, check_profile, check_sensors, nominal_params, rollout
from beltarm_env.task.moves import MOVE_FIELDS
from beltarm_env.task.ranges import EDITION
from beltarm_env.task.seeds import DATASET_SCORES, DATASET_SPACING, MAX_DATASET_SEED, dataset_arms
from beltarm_env.task.shift import MOST_MOVES
from beltarm_env.timing import EPISODE_STEPS
from eval.comparison.methods import methods_side_by_side
from eval.exports.source import TEMPLATES

if TYPE_CHECKING:
    from minari.data_collector import EpisodeBuffer

PIECE = 384
"""Moves that are simulated and written together: 70 MB."""
SCORED = 100
"""Arms of each reference score."""
EXPERT = POLICIES / "student" / "seed0"
"""Folder of the policy whose score is 1."""
KINDS = ("none", "noise", "stretches")
MEMORY = 0.97
"""Share of the noise that is left a sample later: 50 ms."""
LARGEST = {"none": 0.0, "noise": 0.2, "stretches": 0.5}
"""Largest standard deviation of the noise, over the torque limit, by kind; uniform from zero for each episode."""
GAP, STRETCH = 250, (30, 120)
"""Mean gap before a stretch, and its shortest and longest length, in samples: 375 ms; 45 to 180 ms."""
NOISE = {"memory": MEMORY, "largest_size": LARGEST, "mean_gap": GAP, "stretch": STRETCH}
"""The same as the dataset's metadata tell it."""
_STREAM = 1  # another one than that which the arm is drawn from


@dataclass(frozen=True)
class Options:
    """Write a dataset for offline learning."""

    id: str = ""
    """Name of the dataset. Default: beltarm/randomized/mixed-v0, of several moves beltarm/shift/mixed-v0, and so on."""
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
    moves: int = 1
    """Moves of an episode, 1 to 1000. With several it is a working shift."""
    sensors: Sensors = "encoder"
    """What the observations hold."""
    overwrite: bool = False
    """Replace a dataset of this name."""

    @property
    def path(self) -> Path:
        """Folder of the dataset."""
        return self.out / self.name

    @property
    def name(self) -> str:
        """Name of the dataset."""
        arms = {"train": "randomized", "ideal": "ideal", "off": "nominal"}[self.randomization]
        words = ["shift"] * (self.moves > 1) + [arms] * (self.moves == 1 or self.randomization != "train")
        return self.id or f"beltarm/{'-'.join(words + [self.sensors] * (self.sensors != 'encoder'))}/mixed-v0"


def export(options: Options) -> None:
    """Run the controllers and write the dataset."""
    require_bounds(options, episodes=(1, DATASET_SPACING), moves=(1, MOST_MOVES))
    require_bounds(options, seed=(0, MAX_DATASET_SEED), disturbed=(0, 1))
    try:
        import h5py  # noqa: F401  # which Minari imports as it writes
        from minari.dataset.minari_dataset import parse_dataset_id
    except ImportError:
        raise DependencyNotInstalled("datasets need Minari: pip install 'beltarm-env[minari]'") from None
    path = options.path
    try:
        parse_dataset_id(options.name)
    except (TypeError, ValueError):  # TypeError where there is no version
        raise ValueError(f"--id must be like beltarm/randomized/mixed-v0, got {options.name!r}") from None
    if path.exists() and not (path / "data" / "metadata.json").is_file():
        raise ValueError(f"{path} is there and is no dataset: choose another --id or --out")
    if path.exists() and not options.overwrite:
        raise ValueError(f"{path} holds a dataset: choose another --id or --out, or replace it by --overwrite")
    require_writable(options.out)
    with progress_count("episodes", Console()) as done:
        metadata = write_dataset(options, done)
    megabytes = sum(file.stat().st_size for file in path.rglob("*")) / 1e6
    costs = pd.DataFrame(metadata).pivot_table("cost", "controller", "disturbance")
    print("mean cost of an episode, the sum of its moves", costs.round().to_string(na_rep="–"), sep="\n")
    print(f"written to {path}, {megabytes:.0f} MB; in Python, with MINARI_DATASETS_PATH={options.out}:")
    print(f'  dataset = minari.load_dataset("{options.name}")')


def write_dataset(options: Options, done: Callable[[int, int], object]) -> list[dict[str, Any]]:
    """Write a dataset under a temporary name, then rename it: where that fails, an older one stays as it was.

    `done` is called with the number of episodes that have been written, and that of all. Returns metadata of each.
    """
    from minari.namespace import create_namespace, list_local_namespaces

    folder = options.out.resolve()  # Minari does not find the size of a dataset with a relative path
    namespace = options.name.rpartition("/")[0]
    with tempfile.TemporaryDirectory(dir=folder, prefix=".dataset-") as made:
        with patch.dict(os.environ, MINARI_DATASETS_PATH=made):
            metadata = _fill(options, done)
        with patch.dict(os.environ, MINARI_DATASETS_PATH=str(folder)):
            if namespace and namespace not in list_local_namespaces():
                create_namespace(namespace)
        replace_folder(options.path, Path(made) / options.name)
    return metadata


def _fill(options: Options, done: Callable[[int, int], object]) -> list[dict[str, Any]]:
    """Create the dataset, piece by piece: no more episodes than one piece are held in memory."""
    import minari

    settings: dict[str, Any] = {name: getattr(options, name) for name in ("randomization", "moves", "sensors")}
    usual = not options.controller and not options.policy
    sources = (("paper", "adaptive"), (EXPERT,)) if usual else (options.controller, options.policy)
    methods = dict(methods_side_by_side(*sources))
    controllers = {name: method.controller(0) for name, method in methods.items()}
    names, share = ", ".join(methods), f"{100 * options.disturbed:g} %"
    low, high = reference_scores(options.randomization, options.moves)
    spec = gymnasium.make("BeltArm-v0", **settings).spec
    about: dict[str, Any] = {
        "algorithm_name": f"{names}; {share} of the episodes disturbed by random torques",
        "author": "The beltarm developers",
        "code_permalink": f"beltarm-env {__version__}, commit {commit()}, eval/export.py dataset",
        "ref_min_score": low,
        "ref_max_score": high,
        "num_episodes_average_score": SCORED,
        "description": TEMPLATES.get_template("dataset.txt.j2").render(names=names, share=share, **settings),
        "requirements": [f"beltarm-env=={__version__}"],
    }
    more = {
        "edition": EDITION,
        "layout": LAYOUT,
        "seed": options.seed,
        "controllers": {name: method.identity for name, method in methods.items()},
        "disturbed": options.disturbed,
        "noise": NOISE,
        "software": software("gymnasium", "h5py", "minari", "ziglang", "numpy", "torch"),
    }
    dataset: minari.MinariDataset | None = None
    written: list[dict[str, Any]] = []
    for buffers, metadata in pieces(controllers, options, settings):
        if dataset is None:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="`author_email` is set to None")  # there is none
                dataset = minari.create_dataset_from_buffers(
                    options.name, buffers, env=spec, eval_env=spec, data_format="hdf5", **about
                )
            dataset.storage.update_metadata({"beltarm": more})
        else:
            dataset.update_dataset_from_buffer(buffers)
        dataset.storage.update_episode_metadata(metadata, range(len(written), len(written) + len(metadata)))
        written += metadata
        done(len(written), options.episodes)
    return written


def pieces(
    controllers: Mapping[str, Controller], options: Options, settings: Mapping[str, Any]
) -> Iterator[tuple[list["EpisodeBuffer"], list[dict[str, Any]]]]:
    """Run controllers in turn on the arms of a dataset, and return episodes with the metadata of each."""
    first, piece = dataset_arms(options.seed).first, max(PIECE // options.moves, 1)
    for begin in range(first, first + options.episodes, piece):
        seeds = range(begin, min(begin + piece, first + options.episodes))
        by_seed = {}
        for k, (name, controller) in enumerate(controllers.items()):
            if own := [seed for seed in seeds if (seed - first) % len(controllers) == k]:
                by_seed |= run_episodes(name, controller, own, options.disturbed, settings)
        buffers, metadata = zip(*(by_seed[seed] for seed in seeds), strict=True)
        yield list(buffers), list(metadata)


def reference_scores(randomization: str, moves: int) -> tuple[float, float]:
    """Mean returns of uniform random torques and of the expert, sums of rewards that are not discounted."""
    rng = np.random.default_rng(DATASET_SCORES.first)

    class RandomTorques:
        def predict(self, observation: Singles, *_: Any, **__: Any) -> tuple[Singles, None]:
            return rng.uniform(-1, 1, (len(observation), 1)).astype(np.float32), None

    task: dict[str, Any] = {"seed": DATASET_SCORES.first, "randomization": randomization, "moves": moves}
    low, high = (rollout(each, SCORED, **task).cost for each in (RandomTorques(), load_controller(EXPERT)))
    return -moves * float(np.mean(low)), -moves * float(np.mean(high))


class Disturbance(NamedTuple):
    """Disturbance of one episode."""

    kind: str  # among `KINDS`
    size: float  # standard deviation of the noise, over the torque limit
    noise: Singles  # over the torque limit; zero where it does not act    (T,)
    alone: Flags  # where it is the torque by itself    (T,)


def draw_disturbance(seed: int, share: float, samples: int) -> Disturbance:
    """Draw the disturbance of an episode; a share of all episodes is disturbed, half of them in either way."""
    random = np.random.default_rng((seed, _STREAM))
    disturbed, way = random.random() < share, KINDS[1 + random.integers(2)]
    kind = way if disturbed else "none"
    size = LARGEST[kind] * random.random()
    fresh, before = random.standard_normal(samples), random.standard_normal()
    noise, _ = lfilter([np.sqrt(1 - MEMORY**2)], [1, -MEMORY], fresh, zi=[MEMORY * before])
    alone = np.zeros(samples, np.bool_)
    begin = random.exponential(GAP)
    while kind == "stretches" and begin < samples:
        end = begin + random.integers(*STRETCH, endpoint=True)
        alone[int(begin) : int(end)] = True
        begin = end + random.exponential(GAP)
    acts = alone | (kind == "noise")
    return Disturbance(kind, size, np.where(acts, size * noise, 0.0).astype(np.float32), alone)


def run_episodes(
    name: str, controller: Controller, seeds: Sequence[int], share: float, settings: Mapping[str, Any]
) -> dict[int, tuple["EpisodeBuffer", dict[str, Any]]]:
    """Run a controller on the arms of some seeds, side by side; each episode is that of a single environment.

    For `share` see `draw_disturbance`; `settings` are arguments of `BeltArmVectorEnv`. Returns each episode with its
    metadata, by seed.

    Raises:
        ValueError: If the controller does not suit the arms.
    """
    from minari.data_collector import EpisodeBuffer

    disturbances = [draw_disturbance(seed, share, EPISODE_STEPS * settings["moves"]) for seed in seeds]
    noise, alone = (np.stack([getattr(each, name) for each in disturbances], axis=1) for name in ("noise", "alone"))
    env = BeltArmVectorEnv(len(seeds), autoreset_mode=AutoresetMode.DISABLED, **settings)
    seen, _ = env.reset(seed=seeds)
    check_data_sheet(nominal_params(controller), env.params_table, name)
    check_profile(controller, env.profile)
    check_sensors(controller, env.sensors)
    params, moves, memory, start = env.params_table, env.moves, None, np.ones(len(seeds), np.bool_)
    samples, steps = [(seen, env.state, np.hypot(*env.tip_errors()[:, :2].T))], []
    for k in range(len(noise)):
        action, memory = controller.predict(seen, memory, start, deterministic=True)
        own = np.clip(action[:, 0], -1, 1)
        torques = np.clip(~alone[k] * own + noise[k], -1, 1)[:, None]
        seen, reward, start, truncated, info = env.step(torques)
        samples.append((seen, env.state, info["tip_error"]))
        steps.append((own, torques, reward, start, truncated))
        if start.any() and not truncated.any():  # keeps the batch going; what is over is cut off below
            seen, _ = env.reset(options={"reset_mask": start})
    observations, states, errors = map(np.stack, zip(*samples, strict=True))
    wanted, actions, rewards, terminated, truncated = map(np.stack, zip(*steps, strict=True))
    episodes = {}
    for k, (seed, disturbance) in enumerate(zip(seeds, disturbances, strict=True)):
        end = int(np.argmax(terminated[:, k] | truncated[:, k])) + 1
        hidden = {"state": states[: end + 1, k], "tip_error": errors[: end + 1, k]}
        behaviour = {"controller_action": wanted[:, k], "noise": disturbance.noise, "alone": disturbance.alone}
        infos = {
            "not_observed": {key: values.astype(np.float32) for key, values in hidden.items()},
            "behaviour": {key: np.insert(values[:end], 0, 0) for key, values in behaviour.items()},  # 0: the reset
        }
        reset = {
            "params": dict(zip(FIELDS, params[k].tolist(), strict=True)),
            "move": dict(zip(MOVE_FIELDS, moves[k].tolist(), strict=True)),
        }
        arrays: dict[str, Any] = {
            "observations": observations[: end + 1, k],
            "actions": actions[:end, k],
            "rewards": rewards[:end, k],
            "terminations": terminated[:end, k],
            "truncations": truncated[:end, k],
        }
        buffer = EpisodeBuffer(seed=seed, options=reset, infos=infos, **arrays)
        metadata = {
            "controller": name,
            "disturbance": disturbance.kind,
            "noise_size": disturbance.size,
            "cost": -float(np.sum(rewards[:end, k])),
            "finished": not terminated[end - 1, k],
        }
        episodes[seed] = buffer, metadata
    return episodes
