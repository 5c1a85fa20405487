"""Search for a controller's gains: one optimiser, one set of arms, one objective and one budget for all of them.

**Objective.** The mean cost of a move (`beltarm_env.task.cost`) over arms of the training ranges, with one random move
each or several in a row: what agents learn for and the comparison ranks by. A controller that fails counts as the
highest cost there is.

**Search.** First run the untuned gains, then each gain alone, an eighth of its range lower and higher: among ten gains
an estimator that began at random found none as good as the untuned ones. From there on a tree-structured Parzen
estimator [1] proposes gains. Every trial meets the same arms in the same order, so that trials are compared arm by arm.
On n arms, with differences d_i in cost to the best,

    estimated cost = mean cost of the best trial on all its arms + mean(d)

is what the estimator learns from. After each of `RUNGS` arms a trial is pruned if Wilcoxon's signed-rank test says
that it is worse than the best one, unless its estimated cost is lower: the test looks at ranks, but costs have long
tails. The test is that of Optuna's `WilcoxonPruner`. It reads the cost of each arm from the journal, which takes 0.3 ms
where an arm of four moves takes 3 ms or more, and prunes no trial, either, whose mean on the arms so far is below the
best one's on all of them.

**Choice.** The best of a search is partly lucky with its arms. So a fifth of the budget is kept to run the best few,
and the untuned gains, on other arms. The best on all arms that it has met is the result; its cost on the others is what
is reported.

**Margins.** Gains whose loop falls short of a `MarginCondition` are refused before anything is simulated. How far they
fall short is noted as a constraint: the estimator ranks them by it, behind all others. A search ends after
`MAX_REFUSED` of them. The untuned gains have to pass.

The budget counts simulated control periods of single arms, those of pruned, failed and interrupted trials too. It is
never exceeded, but for what an interruption breaks off, a batch of arms or the choice, which is simulated again.

[1] Bergstra, Bardenet, Bengio, Kégl: Algorithms for Hyper-Parameter Optimization, NeurIPS 2011.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple
from warnings import catch_warnings

import numpy as np
import optuna
from optuna.distributions import FloatDistribution
from optuna.trial import FrozenTrial, TrialState

from baselines.engines.parallel import Channel, Interrupted
from baselines.gains import Gains
from baselines.loops.condition import MarginCondition, least_margins
from baselines.models.corners import CORNERS
from baselines.registry import TUNABLE
from baselines.tools.files import errors_about
from baselines.tuning.study import ask, open_study, own, repeat_interrupted
from beltarm_env import EPISODE_STEPS
from beltarm_env.arrays import Floats
from beltarm_env.rollout import Controller, rollout
from beltarm_env.task.cost import MAX_COST
from beltarm_env.task.seeds import GAIN_CHOICE, GAIN_SEARCH

RUNGS = (32, 64, 128)
"""Arms, or shifts, that a trial has run on when it is compared with the best; after the last it is complete."""
SIGNIFICANCE = 0.1
"""Level p of the test by which a trial is pruned, each time it is made."""
FINALISTS = 7
MAX_CHOICE_ARMS = 1000
MAX_REFUSED = 2000
"""Proposals that fall short of the margins, after which a search ends."""
WORST = MAX_COST * EPISODE_STEPS
"""Bound of an episode's cost, and the cost of a controller that fails."""
_WITHOUT_LOOP = 2.0  # shortfall of gains that make no controller or no loop: beyond that of any loop
_FAILURE = "failure"  # attribute of a trial in which the controller failed
_CHOSEN = "chosen"  # attribute of a study: steps of the choices so far


class Terms(NamedTuple):
    """What a search is to keep to."""

    budget: int  # simulated steps, those in the journal included
    seed: int = 0  # of the optimiser
    moves: int = 1  # of each arm, in a row
    condition: MarginCondition | None = None  # margins that the loop has to keep; None for none

    @property
    def margins(self) -> dict[str, Any] | None:
        """Margins that are asked for, and the arms on which, as JSON has them."""
        return None if self.condition is None else {**asdict(self.condition), "arms": list(CORNERS)}


class SearchProgress(NamedTuple):
    """Progress of a search."""

    steps: int  # simulated
    trials: int
    best: float  # mean cost of the best trial, infinite before the first


@dataclass(frozen=True, slots=True)
class SearchResult:
    """Result of a search, and its effort."""

    gains: dict[str, float]
    arms: int  # of the choice
    steps: int  # simulated, of all trials and the choice
    trials: int
    pruned: int
    failed: int  # trials in which the controller raised an error or returned NaN
    refused: int  # proposals that fell short of the margins; not among the trials
    cost: float  # mean cost of a move over the arms of the choice
    cost_untuned: float  # of the untuned gains on the same arms
    seconds: float  # of trials and choice


def split_budget(budget: int, moves: int) -> tuple[int, int]:
    """Divide a budget: steps of the search, and arms on which each finalist and the untuned gains run in the choice.

    Raises:
        ValueError: If the budget is too small.
    """
    least = RUNGS[-1] * moves * EPISODE_STEPS * 5 // 4
    if budget < least:
        raise ValueError(f"--budget must be at least {least} steps, enough for one trial, got {budget}")
    each = (FINALISTS + 1) * moves * EPISODE_STEPS
    arms = min(MAX_CHOICE_ARMS, budget // 5 // each)
    return budget - arms * each, arms


def estimate(costs: Floats, best: Floats) -> float:
    """Estimate a trial's mean cost on all arms from those that it has run on, and the best trial so far.

    Args:
        costs: Of the trial, shape (n,).
        best: Of the best trial, shape (at least n,); empty if there is none.
    """
    if len(costs) == RUNGS[-1] or not len(best):
        return float(costs.mean())
    return float(best.mean() + (costs - best[: len(costs)]).mean())


def costs_of(trial: FrozenTrial) -> Floats:
    """Costs of the arms that a trial has run on."""
    return np.array([trial.intermediate_values[arm] for arm in sorted(trial.intermediate_values)])


def space(kind: type[Gains]) -> dict[str, FloatDistribution]:
    """Distributions of all gains."""
    return {gain.name: FloatDistribution(**gain.metadata) for gain in fields(kind)}


def rounded(params: dict[str, float], kind: type[Gains]) -> Gains:
    """Gains rounded to six significant digits, as they are written to the file, and within their ranges."""
    near = {name: float(f"{value:.6g}") for name, value in params.items()}
    return kind(**{name: min(max(near[name], of.low), of.high) for name, of in space(kind).items()})


def beginnings(kind: type[Gains]) -> list[dict[str, float]]:
    """Untuned gains, and those with one of them an eighth of its range lower or higher; a range may be logarithmic."""
    found = [asdict(kind())]
    for gain in fields(kind):
        low, high, log = (gain.metadata[key] for key in ("low", "high", "log"))
        for step in (-0.125, 0.125):
            moved = gain.default * (high / low) ** step if log else gain.default + step * (high - low)
            found.append({**asdict(kind()), gain.name: min(max(moved, low), high)})
    return found


def search(kind: type[Any], terms: Terms, journal: Path, channel: Channel | None = None) -> SearchResult:
    """Search for gains of a controller, resuming from the journal, in which every trial is noted as it runs.

    `kind` is the controller's, with its `gains_type`. The channel gets a `SearchProgress` after every batch of arms.

    Raises:
        ValueError: If the budget is too small, the controller fails or falls short of the margins with its untuned
            gains or has no linear law, the journal is damaged or was begun with another seed, other code, gains,
            margins or moves, or another process searches with it.
        OSError: If the journal cannot be written.
        Interrupted: If asked to stop; the journal is in order.
    """
    steps, arms = split_budget(terms.budget, terms.moves)
    begun = {
        "seed": terms.seed,
        "moves": terms.moves,
        "gains": {gain.name: [gain.default, *gain.metadata.values()] for gain in fields(kind.gains_type)},
        "margins": terms.margins,
    }
    with catch_warnings(action="ignore", category=optuna.exceptions.ExperimentalWarning):
        pruner = optuna.pruners.WilcoxonPruner(p_threshold=SIGNIFICANCE, n_startup_steps=RUNGS[0])
    packages, remedy = ("beltarm_env", "baselines"), "tune anew, without --resume"
    with own(journal), errors_about(journal):
        study = open_study(journal, begun, pruner, packages=packages, remedy=remedy)
        repeat_interrupted(study)
        if study.user_attrs.get("budget") == terms.budget:
            return SearchResult(**study.user_attrs["found"])
        run = _Search(kind, terms, study, channel or Channel())
        if run.steps - run.chosen > steps:
            raise ValueError(f"{journal} holds more steps than --budget {terms.budget} allows: raise it, or tune anew")
        while run.steps + RUNGS[-1] * terms.moves * EPISODE_STEPS <= steps and run.refused < MAX_REFUSED:
            run.trial()
        found = run.choose(arms)
        study.set_user_attr("found", asdict(found))
        study.set_user_attr("budget", terms.budget)
    return found


def search_in(name: str, terms: Terms, folder: Path, channel: Channel) -> SearchResult:
    """Search for a controller's gains with the journal in a folder, as a task."""
    return search(TUNABLE[name], terms, folder / f"{name}.journal", channel)


class _Search:
    """Trials of one search, and the choice among them.

    Raises:
        ValueError: If the untuned gains fall short of the margins, or there is no linear law.
    """

    def __init__(self, kind: type[Any], terms: Terms, study: optuna.Study, channel: Channel) -> None:
        self._kind, self._terms, self._study, self._channel = kind, terms, study, channel
        self._first, self._space = beginnings(kind.gains_type), space(kind.gains_type)
        self._untuned = self._first[0]
        self.chosen = study.user_attrs.get(_CHOSEN, 0)
        arms = sum(len(trial.intermediate_values) for trial in self._trials())
        self.steps = arms * terms.moves * EPISODE_STEPS + self.chosen
        self.refused = len(self._trials(TrialState.PRUNED))
        condition = terms.condition
        if condition is not None and condition.shortfall(untuned := kind()) > 0:
            least, remedy = least_margins(untuned), f"change the defaults of {kind.gains_type.__name__}"
            raise ValueError(f"the untuned gains fall short of the margins asked for, {least}: {remedy}")

    def trial(self) -> None:
        """Run one trial until it is complete or pruned; none of a proposal that is refused."""
        complete = self._complete()
        best = costs_of(complete[0]) if complete else np.empty(0)
        trial = ask(self._study, self._space, self._terms.seed, first=self._first)
        if self._refuses(trial):
            return
        costs, value = np.empty(0), WORST
        for first, end in pairwise((0, *RUNGS)):
            batch, failure = self._costs(trial.params, GAIN_SEARCH.first + first, end - first)
            costs = np.append(costs, batch)
            value = WORST if failure else estimate(costs, best)
            if failure:
                trial.set_user_attr(_FAILURE, failure)
            for arm in range(first, end):
                trial.report(costs[arm], arm)
            if failure or (trial.should_prune() and value > best.mean()):
                break
        self._study.tell(trial, value)

    def _refuses(self, trial: optuna.Trial) -> bool:
        """Whether a proposal falls short of the margins; by how much is noted with the trial, which then ends."""
        if self._terms.condition is None:
            return False
        try:
            shortfall = self._terms.condition.shortfall(self._controller(trial.params))
        except Exception:  # whatever it is, these gains are no good
            shortfall = _WITHOUT_LOOP
        trial.set_constraint("margins", shortfall)
        if shortfall > 0:
            self._study.tell(trial, state=TrialState.PRUNED)
            self.refused += 1
            self._report()
        return shortfall > 0

    def choose(self, arms: int) -> SearchResult:
        """Run the finalists and the untuned gains on other arms, and choose the best."""
        began, before = time.perf_counter(), self.steps
        complete = self._complete()
        candidates = sorted(complete, key=lambda trial: trial.params != self._untuned)[: FINALISTS + 1]
        costs = [self._costs(trial.params, GAIN_CHOICE.first, arms)[0] for trial in candidates]
        self._study.set_user_attr(_CHOSEN, self.chosen + self.steps - before)
        every = [np.append(costs_of(trial), own) for trial, own in zip(candidates, costs, strict=True)]
        best = int(np.argmin([both.mean() for both in every]))
        trials = self._trials(TrialState.COMPLETE)
        failed = sum(_FAILURE in trial.user_attrs for trial in trials)
        seconds = sum(trial.duration.total_seconds() for trial in trials if trial.duration)
        return SearchResult(
            gains=asdict(rounded(candidates[best].params, self._kind.gains_type)),
            arms=arms,
            steps=self.steps,
            trials=len(trials),
            pruned=len(trials) - len(self._complete()) - failed,
            failed=failed,
            refused=self.refused,
            cost=round(float(costs[best].mean()), 2),
            cost_untuned=round(float(costs[0].mean()), 2),
            seconds=round(seconds + time.perf_counter() - began, 1),
        )

    def _costs(self, params: dict[str, float], seed: int, arms: int) -> tuple[Floats, str]:
        """Costs of arms with consecutive seeds, averages over their moves; and why, where the controller fails."""
        moves = self._terms.moves
        self.steps += arms * moves * EPISODE_STEPS
        try:
            with np.errstate(all="ignore"):  # what comes of an overflow is judged by its cost
                run = rollout(self._controller(params), arms, seed=seed, randomization="train", moves=moves)
            costs = np.minimum(run.over_moves(run.cost), WORST)
        except Exception as error:  # whatever it is, these gains are no good
            if params == self._untuned:
                raise ValueError(f"the controller fails with its untuned gains: {error}") from error
            return np.full(arms, WORST), f"{type(error).__name__}: {error}"
        self._report()
        return costs, ""

    def _controller(self, params: dict[str, float]) -> Controller:
        return self._kind(rounded(params, self._kind.gains_type))

    def _report(self) -> None:
        """Tell how far the search is, and end if asked to."""
        best = next((trial.value for trial in self._complete() if trial.value is not None), np.inf)
        trials = len(self._trials(TrialState.COMPLETE, TrialState.RUNNING))
        self._channel.report(SearchProgress(self.steps, trials, best))
        if self._channel.stop.made:
            raise Interrupted("interrupted")

    def _trials(self, *states: TrialState) -> list[FrozenTrial]:
        return self._study.get_trials(deepcopy=False, states=states or None)

    def _complete(self) -> list[FrozenTrial]:
        """Trials that ran on all arms, the best first."""
        all_arms = [each for each in self._trials(TrialState.COMPLETE) if len(each.intermediate_values) == RUNGS[-1]]
        return sorted((each for each in all_arms if _FAILURE not in each.user_attrs), key=lambda each: each.value or 0)
