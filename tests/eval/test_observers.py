"""The study of observers: scores, and the shipped observers beside the filter."""

from __future__ import annotations

import numpy as np
import pytest

from agents.observer.files import SHIPPED, load_observer
from agents.observer.network import Estimate, Observer, inputs_of
from agents.observer.quantities import NAMES
from agents.residual.bases import make_base
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import VALIDATION
from eval.comparison.splits import Split
from eval.studies.observers import FilterAlone, Score, score, scores_of, watchers


def test_scores_of_errors_that_are_known():
    true = np.zeros((1, 4, len(NAMES)))
    mean = np.repeat(np.array([[0.5], [-0.5], [1.5], [-3.0]]), len(NAMES), axis=1)
    stated = score([Estimate(mean, np.ones_like(mean))], true)
    assert np.allclose(stated.rms, np.sqrt((0.25 + 0.25 + 2.25 + 9) / 4))
    assert np.all(stated.within_one == 0.5) and np.all(stated.within_two == 0.75)
    unstated = score([Estimate(mean, np.full_like(mean, np.nan))], true)
    assert np.isnan(unstated.within_one).all() and np.isnan(unstated.within_two).all()


@pytest.fixture(scope="module")
def scores() -> dict[str, Score]:
    """Scores on arms that no observer was fitted to."""
    run = rollout(make_base("adaptive"), 32, seed=VALIDATION.first, randomization="train")
    split = Split("fresh", "validation", VALIDATION.first, {}, run.params, run.moves, np.zeros(32), "")
    return scores_of("adaptive", watchers(), split, 32)


def test_shipped_observers_fit_a_motors_processor():
    assert {path.name for path in SHIPPED.iterdir()} == {"belief.safetensors", "none.safetensors"}
    for path in SHIPPED.iterdir():
        observer, _ = load_observer(path)
        assert 4 * sum(value.numel() for value in observer.parameters()) <= 50_000


def test_corrections_of_the_filter_are_right(scores: dict[str, Score]):
    ratio = dict(zip(NAMES, scores["learned on the filter"].rms / scores["filter"].rms, strict=True))
    assert max(ratio.values()) < 1.03
    assert ratio["belt_stiffness"] < 1


def test_stated_deviations_are_those_of_the_errors(scores: dict[str, Score]):
    """On average over the quantities; 32 arms are too few for their constants to tell much more."""
    within = scores["learned on the filter"].within_one
    assert np.all(within > 0.45) and np.all(within < 0.9) and 0.62 < within.mean() < 0.76


def test_the_encoder_alone_shows_less(scores: dict[str, Score]):
    torsion = NAMES.index("torsion")
    assert scores["learned alone"].rms[torsion] > scores["filter"].rms[torsion]


def test_watchers_have_the_inputs_that_the_page_names():
    known = watchers()
    assert isinstance(known["filter"], FilterAlone)
    alone = known["learned alone"]
    assert isinstance(alone, Observer) and not [name for name in inputs_of(alone.knowledge) if "believed" in name]
