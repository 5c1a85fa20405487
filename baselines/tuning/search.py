"""Search for a controller's gains: one optimiser, one set of arms, one objective and one budget for all of them.

**Objective.** The mean episode cost (`beltarm_env.task.cost`) over arms of the training ranges with random moves. An
arm that leaves its workspace is charged as everywhere; a controller that fails counts as the highest cost there is.
No motor is to be hammered: an arm whose torque reverses more than ten times a second, by over 10 % of its limit, is
charged its cost in proportion (`race.charged`).

**Search.** A tree-structured Parzen estimator [1] proposes gains, the untuned ones first. Every trial meets the same
arms in the same order, so that trials are compared arm by arm. On n arms, with differences d_i in cost to the best,

    estimated cost = mean cost of the best trial on all its arms + mean(d)

is what the estimator learns from, and a trial is pruned (it has lost the race [2]) where

    mean(d) > MARGIN std(d) / sqrt(n),

which is looked at after each of `RUNGS` arms.

**Choice.** The best of a search is partly lucky with its arms. So a fifth of the budget is kept to run the best few,
and the untuned gains, on other arms; the best of these is the result, and its cost there is what is reported.

**Margins.** Gains whose loop falls short of a `MarginCondition` are refused before anything is simulated. How far they
fall short is noted as a constraint, by which the estimator ranks them, and behind all that were not refused. A search
ends after `MAX_REFUSED` of them. The untuned gains have to pass.

The budget counts simulated control periods of single arms, those of pruned and failed trials too. It is never exceeded.

[1] Bergstra, Bardenet, Bengio, Kégl: Algorithms for Hyper-Parameter Optimization, NeurIPS 2011.
[2] Maron, Moore: Hoeffding Races: Accelerating Model Selection Search, NeurIPS 1993.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import optuna
from optuna.trial import FrozenTrial, TrialState

from baselines.engines.parallel import Channel, Interrupted
from baselines.gains import Tunable
from baselines.loops.condition import MarginCondition, least_margins
from baselines.tools.files import errors_about
from baselines.tuning.race import FINALISTS, RUNGS, charged, estimate, hopeless, split_budget
from baselines.tuning.study import open_study, own, rounded, space
from beltarm_env import EPISODE_STEPS
from beltarm_env.arrays import Floats
from beltarm_env.rollout import rollout
from beltarm_env.task.cost import MAX_COST
from beltarm_env.task.seeds import GAIN_CHOICE, GAIN_SEARCH

MAX_REFUSED = 2000
"""Proposals that fall short of the margins, after which a search ends."""
WORST = MAX_COST * EPISODE_STEPS
"""Bound of an episode's cost, and the cost of a controller that fails."""
_WITHOUT_LOOP = 2.0
"""Shortfall of gains that make no controller or no loop: beyond that of any loop."""


class SearchProgress(NamedTuple):
    """Progress of a search."""

    steps: int  # simulated
    trials: int
    best: float  # mean cost of the best trial, infinite before the first


@dataclass(frozen=True, slots=True)
class SearchResult:
    """Result of a search, and its effort."""

    gains: dict[str, float]
    cost: float  # mean episode cost over the arms of the choice
    cost_untuned: float  # of the untuned gains on the same arms
    arms: int  # of the choice
    steps: int  # simulated, of all trials and the choice
    trials: int
    pruned: int
    failed: int  # trials in which the controller raised an error or returned NaN
    refused: int  # proposals that fell short of the margins; not among the trials
    seconds: float  # of trials and choice


def search(
    tunable: Tunable,
    budget: int,
    seed: int,
    journal: Path,
    channel: Channel | None = None,
    condition: MarginCondition | None = None,
) -> SearchResult:
    """Search for gains, resuming from the journal.

    Args:
        tunable: Controller and gains to tune.
        budget: Simulated steps, those in the journal included.
        seed: Of the optimiser.
        journal: File in which every trial is noted as it runs.
        channel: Gets a `SearchProgress` after every batch of arms.
        condition: Margins that the loop has to keep; None for none.

    Raises:
        ValueError: If the budget is too small, the controller fails or falls short of the margins with its untuned
            gains or has no linear law, the journal belongs to another search, or another process searches with it.
        OSError: If the journal cannot be written.
        Interrupted: If asked to stop; the journal is in order.
    """
    parts = split_budget(budget)
    with own(journal), errors_about(journal):
        study = open_study(tunable.gains, seed, journal, condition)
        if study.user_attrs.get("budget") == budget:
            return SearchResult(**study.user_attrs["found"])
        run = _Search(tunable, study, channel or Channel(), condition)
        if run.steps > parts.search:
            raise ValueError(f"{journal} holds more steps than --budget {budget} allows: raise it, or tune anew")
        while run.steps + RUNGS[0] * EPISODE_STEPS <= parts.search and run.refused < MAX_REFUSED:
            run.trial(parts.search)
        found = run.choose(parts.arms)
        study.set_user_attr("found", asdict(found))
        study.set_user_attr("budget", budget)
    return found


class _FailureError(Exception):
    """Raised where a controller fails or returns no finite torque."""


class _Search:
    """Trials of one search, and the choice among them.

    Args:
        tunable: Controller and gains to tune.
        study: Where trials are kept; a complete one has the `costs` of its arms, a failed one its `failure`.
        channel: Gets a `SearchProgress` after every batch of arms.
        condition: Margins that the loop has to keep; None for none.

    Raises:
        ValueError: If the untuned gains fall short of the margins, or there is no linear law.
    """

    def __init__(
        self, tunable: Tunable, study: optuna.Study, channel: Channel, condition: MarginCondition | None
    ) -> None:
        self._tunable = tunable
        self._untuned = asdict(tunable.gains())
        self._study = study
        self._channel = channel
        self._space = space(tunable.gains)
        self._condition = condition
        self.steps = EPISODE_STEPS * sum(trial.last_step or 0 for trial in self._trials())
        self.refused = sum(trial.state is TrialState.PRUNED for trial in self._trials())
        if condition is not None:
            untuned = tunable.controller(tunable.gains())
            if condition.shortfall(untuned) > 0:
                raise ValueError(
                    f"the untuned gains fall short of the margins asked for, {least_margins(untuned, condition.arms)}: "
                    f"change the defaults of {tunable.gains.__name__}"
                )

    def trial(self, limit: int) -> None:
        """Run one trial until it is complete, pruned, or at the limit of steps; none of a proposal that is refused."""
        complete = self._complete()
        best = np.array(complete[0].user_attrs["costs"] if complete else [])
        trial = self._study.ask(self._space)
        if self._refuses(trial):
            return
        costs, value = np.empty(0), WORST
        for arms in RUNGS:
            if self.steps + (arms - len(costs)) * EPISODE_STEPS > limit:
                break
            try:
                batch = self._costs(trial.params, GAIN_SEARCH.first + len(costs), arms - len(costs))
                costs = np.concatenate([costs, batch])
                value = estimate(costs, best)
            except _FailureError as failure:
                trial.set_user_attr("failure", str(failure))
                value = WORST
            trial.report(value, arms)
            if value == WORST or hopeless(costs, best):
                break
        if len(costs) == RUNGS[-1]:
            trial.set_user_attr("costs", costs.tolist())
        self._study.tell(trial, value)

    def _refuses(self, trial: optuna.Trial) -> bool:
        """Whether a proposal falls short of the margins; by how much is noted with the trial, which then ends."""
        if self._condition is None:
            return False
        try:
            gains = rounded(trial.params, self._tunable.gains)
            shortfall = self._condition.shortfall(self._tunable.controller(gains))
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
        began = time.perf_counter()
        candidates = [self._untuned, *(trial.params for trial in self._complete()[:FINALISTS])]
        costs = [self._mean_cost(params, arms) for params in candidates]
        best = int(np.argmin(costs))
        trials = [trial for trial in self._trials() if trial.state is TrialState.COMPLETE]
        failed = sum("failure" in trial.user_attrs for trial in trials)
        return SearchResult(
            gains=asdict(rounded(candidates[best], self._tunable.gains)),
            cost=costs[best],
            cost_untuned=costs[0],
            arms=arms,
            steps=self.steps,
            trials=len(trials),
            pruned=len(trials) - len(self._complete()) - failed,
            failed=failed,
            refused=self.refused,
            seconds=sum(_seconds(trial) for trial in trials) + time.perf_counter() - began,
        )

    def _mean_cost(self, params: dict[str, float], arms: int) -> float:
        """Mean cost on the arms of the choice."""
        try:
            return float(self._costs(params, GAIN_CHOICE.first, arms).mean())
        except _FailureError:
            return WORST

    def _costs(self, params: dict[str, float], seed: int, arms: int) -> Floats:
        """Episode costs of arms with consecutive seeds."""
        self.steps += arms * EPISODE_STEPS
        try:
            controller = self._tunable.controller(rounded(params, self._tunable.gains))
            with np.errstate(all="ignore"):  # what comes of an overflow is judged by its cost
                run = rollout(controller, arms, seed=seed, randomization="train")
            costs = np.minimum(charged(run.cost, run.metrics()["torque_reversals_hz"]), WORST)
        except Exception as error:  # whatever it is, these gains are no good
            if params == self._untuned:
                raise ValueError(f"the controller fails with its untuned gains: {error}") from error
            raise _FailureError(f"{type(error).__name__}: {error}") from error
        self._report()
        return costs

    def _report(self) -> None:
        """Tell how far the search is, and end if asked to."""
        complete = self._complete()
        best = (complete[0].value if complete else None) or np.inf
        self._channel.report(SearchProgress(self.steps, len(self._trials()) - self.refused, best))
        if self._channel.stop.made:
            raise Interrupted("interrupted")

    def _trials(self) -> list[FrozenTrial]:
        return self._study.get_trials(deepcopy=False)

    def _complete(self) -> list[FrozenTrial]:
        """Trials that ran on all arms, the best first."""
        complete = [trial for trial in self._trials() if "costs" in trial.user_attrs and trial.value is not None]
        return sorted(complete, key=lambda trial: trial.value or 0.0)


def _seconds(trial: FrozenTrial) -> float:
    return trial.duration.total_seconds() if trial.duration else 0.0
