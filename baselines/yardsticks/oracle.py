"""Scenarios of the clairvoyant optimum: planned with the true arm and its drive, replayed in the environment, stored.

The difference to a controller's cost is the most that better control, estimation or learning could gain, as far as a
search can tell that finds local minima. The cost that is stored is that of the torques replayed in the environment, as
float32 actions. `oracle.json` holds arm, move, metrics and actions of each scenario; `baselines/oracle.py` writes it.
"""

from __future__ import annotations

import base64
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baselines.reading import read
from baselines.tools.files import require_writable, write_text
from baselines.tools.provenance import command_line
from baselines.yardsticks.clairvoyant import optimum
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import EPISODE_STEPS, ArmParams, __version__
from beltarm_env.arm import params_columns, params_table
from beltarm_env.arrays import Flags, Singles
from beltarm_env.rollout import Controller, Recording, rollout
from beltarm_env.task.reference import MoveShape

FILE = Path(__file__).parent.with_name("oracle.json")
METRICS = ("cost", "tip_rms_mm", "residual_pp_mm", "saturated_share")
KINDS = ("nominal", "ideal", "train")
"""Of scenarios; the arm of the last two is drawn from the training ranges."""


@dataclass(frozen=True)
class Scenario:
    """One arm and one move."""

    kind: str
    seed: int
    params: ArmParams
    move: MoveShape

    @classmethod
    def parse(cls, text: str) -> Scenario:
        """The scenario KIND:SEED, drawn by the environment.

        Raises:
            ValueError: If it is not of that form.
        """
        kind, _, seed = text.partition(":")
        if kind not in KINDS or not seed.isdecimal():
            raise ValueError(f"--scenario must be nominal:SEED, ideal:SEED or train:SEED, got {text!r}")
        drawn: Any = "off" if kind == "nominal" else kind
        run = rollout(Replay(np.zeros((1, EPISODE_STEPS), np.float32)), 1, seed=int(seed), randomization=drawn)
        return cls(kind, int(seed), ArmParams.from_row(run.params[0]), MoveShape(*map(float, run.moves[0])))


class Replay:
    """Controller that plays recorded actions of shape (n, T), whatever it observes."""

    def __init__(self, actions: Singles) -> None:
        self._actions = actions

    def predict(
        self, observation: Singles, state: object = None, episode_start: Flags | None = None, deterministic: bool = True
    ) -> tuple[Singles, None]:
        """Actions of the current step; see `Controller`."""
        step = read(observation, ArmParams()).step
        return self._actions[np.arange(len(step)), step, None], None


def run(controller: Controller, scenarios: list[Scenario], **settings: Any) -> Recording:
    """Run a controller in scenarios, with settings of the environment."""
    params = params_columns(params_table([scenario.params for scenario in scenarios]))
    move = dict(zip(MoveShape._fields, np.array([scenario.move for scenario in scenarios]).T, strict=True))
    return rollout(controller, len(scenarios), seed=0, options={"params": params, "move": move}, **settings)


def replay(scenarios: list[Scenario], actions: Singles) -> Recording:
    """Run actions of shape (n, T) in the environment, each row in its scenario."""
    return run(Replay(actions), scenarios)


def read_file(path: Path = FILE) -> tuple[dict[str, Any], list[Scenario], Singles]:
    """Contents of a file: everything as written, and from it the scenarios and their actions of shape (n, T).

    Raises:
        ValueError: If the file is damaged.
    """
    stored = json.loads(path.read_text(encoding="utf-8"))
    rows = stored["scenarios"]
    actions = np.stack([np.frombuffer(base64.b64decode(row["actions"]), "<f4") for row in rows])
    if actions.shape[1] != EPISODE_STEPS:
        raise ValueError(f"{path} must have {EPISODE_STEPS} actions per scenario, got {actions.shape[1]}: make it anew")
    scenarios = [Scenario(r["kind"], r["seed"], ArmParams(**r["params"]), MoveShape(**r["move"])) for r in rows]
    return stored, scenarios, actions.astype(np.float32)


def solve(scenario: Scenario) -> dict[str, Any]:
    """Plan one scenario, beginning with the torques of `privileged`, replay the plan, and return the row to store."""
    began = time.perf_counter()
    guess = run(PrivilegedController([scenario.params]), [scenario], sensors="full")
    found = optimum(scenario.params, scenario.move, guess.torque[:, 0] / scenario.params.torque_limit)
    seconds = time.perf_counter() - began
    replayed = replay([scenario], found.actions[None])
    metrics = replayed.metrics()
    return {
        "kind": scenario.kind,
        "seed": scenario.seed,
        **{name: round(float(metrics[name][0]), 4) for name in METRICS},
        "optimiser_cost": round(found.cost, 4),
        "privileged_cost": round(float(guess.cost[0]), 4),
        "iterations": found.iterations,
        "seconds": round(seconds, 1),
        "stops_at": int(np.flatnonzero(replayed.state[:, 0, 1])[-1] + 1),
        "params": asdict(scenario.params),
        "move": scenario.move._asdict(),
        "actions": base64.b64encode(found.actions.astype("<f4").tobytes()).decode(),
    }


def write_file(scenarios: list[Scenario], path: Path) -> None:
    """Solve the scenarios, print what comes out, and write the file.

    Raises:
        OSError: If the file cannot be written; found out before anything is solved.
    """
    require_writable(path.parent)
    rows = []
    for scenario in scenarios:
        rows.append(row := solve(scenario))
        print(
            f"{row['kind']}:{row['seed']}  cost {row['cost']:.1f}  tip RMS {row['tip_rms_mm']:.2f} mm  residual p-p "
            f"{row['residual_pp_mm']:.2f} mm  privileged {row['privileged_cost']:.1f}  {row['iterations']} iterations, "
            f"{row['seconds']:.0f} s",
            flush=True,
        )
    versions = {"beltarm_env": __version__, "numpy": np.__version__}
    stored = {"command": command_line(), "versions": versions, "scenarios": rows}
    write_text(path, json.dumps(stored, indent=1) + "\n")
