"""The shipped observers beside the filter, and `eval/observers.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from commands import mistake
from pages import MISTAKES, tables_of

from agents.observer.files import SHIPPED, load_observer
from agents.observer.network import Estimate, Observer, inputs_of
from agents.observer.quantities import NAMES
from agents.residual.bases import make_base
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import VALIDATION
from eval import observers
from eval.comparison.sets import development_set
from eval.comparison.splits import Split
from eval.observing.page import draw
from eval.observing.study import ACTING, FilterAlone, Seen, measure, score, watchers


def test_scores_of_errors_that_are_known():
    true = np.zeros((1, 4, len(NAMES)))
    mean = np.repeat(np.array([[0.5], [-0.5], [1.5], [-3.0]]), len(NAMES), axis=1)
    seen = score([Estimate(mean, np.ones_like(mean))], true)
    assert np.allclose(seen.rms, np.sqrt((0.25 + 0.25 + 2.25 + 9) / 4))
    assert np.all(seen.within_one == 0.5) and np.all(seen.within_two == 0.75)
    unstated = score([Estimate(mean, np.full_like(mean, np.nan))], true)
    assert np.isnan(unstated.within_one).all() and np.isnan(unstated.within_two).all()


@pytest.fixture(scope="module")
def seen() -> dict[str, Seen]:
    """Of arms that no observer was fitted to."""
    run = rollout(make_base("adaptive"), 32, seed=VALIDATION.first, randomization="train")
    split = Split("fresh", "validation", VALIDATION.first, {}, run.params, run.moves, np.zeros(32), "")
    return measure("adaptive", watchers(), split, 32)


class TestShipped:
    def test_fit_a_motors_processor(self):
        assert {path.name for path in SHIPPED.iterdir()} == {"belief.safetensors", "none.safetensors"}
        for path in SHIPPED.iterdir():
            observer, _ = load_observer(path)
            assert 4 * sum(value.numel() for value in observer.parameters()) <= 50_000

    def test_corrections_of_the_filter_are_right(self, seen: dict[str, Seen]):
        ratio = dict(zip(NAMES, seen["learned on the filter"].rms / seen["filter"].rms, strict=True))
        assert max(ratio.values()) < 1.03
        assert ratio["belt_stiffness"] < 1

    def test_stated_deviations_are_those_of_the_errors(self, seen: dict[str, Seen]):
        """Of each quantity on average; 32 arms are too few for their constants to tell much more."""
        within = seen["learned on the filter"].within_one
        assert np.all(within > 0.45) and np.all(within < 0.9) and 0.62 < within.mean() < 0.76

    def test_the_encoder_alone_shows_less(self, seen: dict[str, Seen]):
        torsion = NAMES.index("torsion")
        assert seen["learned alone"].rms[torsion] > seen["filter"].rms[torsion]


def test_what_is_compared_sees_what_it_says():
    known = watchers()
    assert list(known) == ["filter", "learned alone", "learned on the filter"]
    assert isinstance(known["filter"], FilterAlone)
    alone = known["learned alone"]
    assert isinstance(alone, Observer) and not [name for name in inputs_of(alone.knowledge) if "believed" in name]


@pytest.mark.parametrize("splits", [1, 9])
def test_names_are_beside_the_bars(splits: int):
    seen = Seen(np.full(len(NAMES), 1e-3), np.ones(len(NAMES)), np.ones(len(NAMES)), 4)
    names = list(development_set().splits)[:splits]
    figure = draw({(acting, split, watcher): seen for acting in ACTING for split in names for watcher in watchers()})
    figure.draw_without_rendering()
    (axis,), (legend,) = figure.axes, figure.legends
    assert len(legend.get_texts()) == len(watchers())
    assert not legend.get_window_extent().overlaps(axis.get_window_extent())
    plt.close(figure)


@pytest.mark.slow
def test_the_command_writes_the_page(tmp_path: Path):
    tables = tables_of(observers.main, ("nominal", "sensing"), "torsion.png", tmp_path)
    assert [len(table.splitlines()) for table in tables] == [2 + 2, 2 + len(NAMES), 2 + 2, 2 + 2]
    again = measure("adaptive", watchers(), development_set().splits["sensing"], 4)
    cells = [f"{1e3 * found.rms[0]:.2f}" for found in again.values()]
    assert tables[0].splitlines()[3].startswith(f"| sensing | {' | '.join(cells)} |")


@pytest.mark.parametrize(("arguments", "message"), MISTAKES)
def test_bad_options(arguments: tuple[str, ...], message: str, tmp_path: Path):
    line = mistake(observers.main, arguments, tmp_path)
    assert line.startswith("eval/observers.py: ") and message in line
