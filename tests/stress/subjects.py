"""Runs that write files and can be begun again: small trainings, a search for gains, a comparison."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from rich.console import Console

from agents.learners.ppo import PpoConfig
from agents.learners.registry import ALGORITHMS
from agents.learners.student import StudentConfig
from agents.policy.bundle import read_weights
from agents.runs.settings import RunConfig
from agents.runs.training import train
from baselines.engines.options import WithStorage
from baselines.gains import read_file
from baselines.tuning.race import MIN_BUDGET
from baselines.tuning.run import tune
from eval.comparison.run import choose_methods, compare
from eval.comparison.schema import read_results, write_results
from eval.comparison.sets import development_set


class Subject(NamedTuple):
    """A run that writes files, and can be begun again."""

    begin: Callable[[Path], object]
    go_on: Callable[[Path], object]  # which first checks that what is there can be read
    meaning: Callable[[Path], dict[str, Any]]  # of the finished files, without what may differ
    given: dict[str, str] = {}  # text of files that are there before  # noqa: RUF012


def assert_same(reached: dict[str, Any], wanted: dict[str, Any]) -> None:
    """Assert that files mean what those of a run without trouble do."""
    differ = sorted(name for name in {*wanted, *reached} if wanted.get(name) != reached.get(name))
    assert not differ, f"other files than without trouble: {', '.join(differ)}"


def _train(config: RunConfig, folder: Path, resume: bool) -> None:
    for kind in ("best", "last"):
        if resume and (folder / kind / "policy.json").exists():
            read_weights(folder / kind)
    train(_options(config, folder, resume), ALGORITHMS[config.algorithm].make_learner)


def _options(config: RunConfig, folder: Path, resume: bool) -> RunConfig:
    """Options of the same training in another folder."""
    return replace(config, out=folder, resume=resume and (folder / "config.json").exists())


def meaning_of_training(folder: Path) -> dict[str, Any]:
    """Files of a finished training, without times and what depends on how often it was begun."""
    curve = pd.read_csv(folder / "validation.csv").drop(columns="seconds")
    meaning: dict[str, Any] = {"validation.csv": curve.to_csv()}
    meaning["config.json"] = json.loads((folder / "config.json").read_text())["identity"]
    for kind in ("best", "last"):
        _, _, content = read_weights(folder / kind)
        origin = content.pop("provenance")
        content.pop("content_hash")
        origin.pop("commit")  # of a checkout that is worked in
        origin.pop("command")  # which has --resume where it was resumed
        for part in (origin["run"], origin["reached"], origin["config"]):
            part.pop("seconds", None)
            part.pop("resume", None)
        origin["curve"] = [[steps, cost] for steps, _, cost in origin["curve"]]
        meaning[f"{kind}/policy.json"] = [content, origin]
    written = (*folder.glob("*"), *folder.glob("*/*"))
    names = {str(path.relative_to(folder)) for path in written if not path.name.startswith((".", "progress", "events"))}
    return meaning | dict.fromkeys(names - {*meaning})


def _compare(folder: Path) -> None:
    if (folder / "results.json").exists():
        read_results(folder / "results.json")
    comparison = compare(choose_methods(("paper", "rigid")), development_set().only(["nominal"]), 4, folder, 1)
    write_results(comparison, folder)


def _comparison(folder: Path) -> dict[str, Any]:
    results = read_results(folder / "results.json")
    for name in ("seconds", "pairs_kept_before", "commit"):
        results["provenance"].pop(name)
    for row in results["rows"]:
        row.pop("action_us")
    kept = {path.name: path.read_bytes() for path in (*folder.glob("parts/*.npz"), folder / "episodes.csv")}
    return {"results.json": results, **kept}


@dataclass(frozen=True)
class _Tuning:
    resume: bool

    def __call__(self, folder: Path) -> None:
        resume = self.resume and (folder / "zv.journal").exists()
        read_file(folder / "gains.json")
        where: dict[str, Any] = {"out": folder / "gains.json", "journals": folder, "options": WithStorage(jobs=1)}
        quiet = Console(file=io.StringIO())
        tune(["zv"], budget=MIN_BUDGET, seed=0, resume=resume, condition=None, console=quiet, **where)


def _tuning(folder: Path) -> dict[str, Any]:
    gains = read_file(folder / "gains.json")
    origin = gains["zv"]["provenance"]
    for name in ("date", "commit", "seconds", "trials", "pruned", "failed", "refused"):  # a trial that is killed counts
        origin.pop(name)
    origin["steps"] = origin["steps"] <= MIN_BUDGET
    return gains


_FEW: dict[str, Any] = {"arms": 4, "validation_arms": 2, "hold": 40, "hidden": (4,)}
_PPO = PpoConfig(total_steps=64, validation_every=32, rollout_steps=8, batch_size=32, **_FEW)
_STUDENT = StudentConfig(rounds=1, gru_width=4, batch_size=4, **_FEW)


def _trained(config: RunConfig) -> Subject:
    return Subject(partial(_train, config, resume=False), partial(_train, config, resume=True), meaning_of_training)


SUBJECTS: dict[str, Subject] = {
    "training": _trained(_PPO),
    "search": Subject(_Tuning(False), _Tuning(True), _tuning, {"gains.json": '{"zvd": {"gains": {}}}'}),
    "student": _trained(_STUDENT),
    "comparison": Subject(_compare, _compare, _comparison),
}
