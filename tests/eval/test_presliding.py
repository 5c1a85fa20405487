"""The study of presliding: its own engine agrees with the plant, and an order that turns is found."""

from __future__ import annotations

import numpy as np

from eval.studies import _frame, presliding
from eval.studies.presliding import LOCATED, check, metrics_of, verdicts


def test_the_located_friction_is_the_limit_of_a_stiff_bristle_in_closed_loop():
    soft, stiff = check(3.0, 2), check(0.1, 2)
    assert stiff["tip"] < 0.5 * soft["tip"]
    assert all(stiff["costs"][name] < 0.6 * soft["costs"][name] for name in soft["costs"])


def test_the_perturbation_changes_little_where_nothing_is_amplified():
    located, perturbed = (metrics_of("paper", None, size, 2)["cost"] for size in (0.0, presliding.PERTURBATION))
    assert (located != perturbed).all()
    np.testing.assert_allclose(perturbed, located, rtol=1e-2)


def test_an_order_that_turns_is_told_by_the_verdicts():
    rng = np.random.default_rng(0)
    values = {("a", LOCATED): rng.uniform(1, 2, (1, 30)), ("b", LOCATED): rng.uniform(3, 4, (1, 30))}
    values |= {("a", "1 mrad"): values["b", LOCATED], ("b", "1 mrad"): values["a", LOCATED]}
    assert verdicts(values, ("a", "b"), LOCATED) == {("a", "b"): "better"}
    assert verdicts(values, ("a", "b"), "1 mrad") == {("a", "b"): "worse"}


def test_the_answer_follows_the_reversals():
    data = _frame.read_data(_frame.RESULTS / "presliding")
    bristles, pages = data["frictions"][2:], set()
    for arms, turned in ((48, [["paper", "student"]]), (48, []), (4, [])):
        changed = data | {"arms": arms, "pairs": [pair | {"reversed": turned} for pair in data["pairs"]]}
        facts = presliding.tables(changed)
        assert facts["reversals"] == len(presliding.JUDGED) * len(bristles) * len(turned)
        assert facts["where"] == (bristles if turned else [])
        pages.add(_frame.page("presliding", presliding, changed))
    assert len(pages) == 3, "reversed, not reversed, too few arms"
