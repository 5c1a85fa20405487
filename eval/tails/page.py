"""Tails of all methods as a page in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from beltarm_env.metrics import ARRIVAL_BOUND, TORQUE_QUALITY, heading
from beltarm_env.metrics import METRICS as KNOWN
from eval.comparison.methods import Method
from eval.comparison.splits import EPISODES, SPLITS
from eval.report.text import degrees, markdown_table, number, rounded
from eval.tails.estimates import OF_DIFFERENCE, SHARES, WORST, Interval, Tail, tail_size
from eval.tails.study import CASES, Outcome, Study

_DISTRIBUTIONS = ("cost", "tip_rms_mm", "tip_max_mm", "residual_pp_mm", "settling_s")
_ROOT = Path(__file__).resolve().parents[2]
_MOST_TOLD = 3  # quantities by which a tail is told from all
_WORST = f"worst {100 * WORST:g} %"


def page(study: Study) -> str:
    """The content of tails.md."""
    parts = [
        "# Tail risk",
        f"**{study.note}** {study.episodes} scenarios per split, the same for all methods; the first {EPISODES} are "
        f"those of `--scenario-seed {study.number}` with up to {EPISODES}.",
        "A few hundred scenarios tell an average, but not what happens once in a thousand moves. Here are the tails: "
        "the values that 10 %, 1 % and 0.1 % of all scenarios exceed, and the worst one.",
        "## How to read the tables",
        "\n".join(
            [
                "- **Mean** with its standard error. **IQM**: mean of the middle half.",
                "- **Percentiles**: the 99 % percentile is the smallest value that 99 % of all scenarios do not "
                "exceed. In brackets its 95 % interval, from two other values in the order of all. It assumes nothing "
                "about their distribution. A dash: too few scenarios show that end.",
                f"- **{_WORST.capitalize()}**: mean of the worst thousandth (expected shortfall). **Worst**: the "
                "largest value of all; more scenarios have a larger one.",
                "- A **learned method** has several policies, one per training seed. Each scenario is played by one of "
                "them, in turn. So its distribution is that of all its policies together, and its scenarios are "
                "independent of one another, as the intervals need them to be.",
                "- **Vibration, settling and torques** are of the scenarios in which the arm arrives: the mean error "
                f"of its end after the move is {1000 * ARRIVAL_BOUND:g} mm or less.",
            ]
        ),
    ]
    for split, outcomes in study.outcomes.items():
        if outcomes:
            parts += [f"## {split}", f"{SPLITS[split].description.capitalize()}.", *_of_split(study, split, outcomes)]
    for failure in study.failures:
        parts.append(f"**{failure.method}** failed on {failure.split}: {failure.message}")
    taken = study.provenance
    parts.append(f"`{taken['command']}`, beltarm {taken['beltarm']} ({taken['commit']}).")
    return "\n\n".join(parts) + "\n"


def picture_of(study: Study, split: str) -> str:
    """Name of the picture of a split: tails.png where there is one split, and for others with the split's name."""
    return "tails.png" if len(study.outcomes) == 1 else f"tails_{split}.png"


def _of_split(study: Study, split: str, outcomes: list[Outcome]) -> list[str]:
    parts = [
        *_answer(outcomes),
        f"![Share of scenarios that reach a cost, and a tip error]({picture_of(study, split)})",
        f"*In what share of all scenarios a method reaches or exceeds a value; the dot is its worst. Below the dashed "
        f"line is what {EPISODES} scenarios do not show.*",
        *(f"### {_titled(name)}\n\n{distribution(outcomes, name)}" for name in _DISTRIBUTIONS),
        f"### What {EPISODES} scenarios tell\n\nThe cost of the first {EPISODES} scenarios, and of all "
        f"{study.episodes}.\n\n{_few(outcomes)}",
        f"### Failures\n\nShare of all scenarios, with its exact 95 % interval (Clopper and Pearson).\n\n"
        f"{_failures(outcomes)}",
    ]
    against = [outcome for outcome in outcomes if outcome.against]
    if against:
        (best,) = [one for one in outcomes if one.method.kind == "classical" and not one.against]
        parts.append(_against(against, best))
    several = [outcome for outcome in outcomes if outcome.policies]
    if several:
        parts.append(_policies(several))
    parts += [_torques(outcomes), _arms(study, outcomes), _cases(study, split, outcomes), _times(study, outcomes)]
    return parts


def _answer(outcomes: Sequence[Outcome]) -> list[str]:
    """What the tails of the best classical method and of its best rival are, in words; nothing without both."""
    best = next((one for one in outcomes if one.method.kind == "classical" and not one.against), None)
    rivals = [one for one in outcomes if one.method.kind in ("learned", "added")]
    rival = min(rivals, key=lambda one: one.tails["cost"].iqm, default=None)
    if best is None or rival is None or rival.against is None:
        return []
    rare = [one.tails["cost"].percentiles[SHARES[-1]] for one in (rival, best)]
    apart = rare[0].high < rare[1].low or rare[1].high < rare[0].low
    said = [
        f"In {_share(rival.against.dearer)} % of the scenarios {_name(rival)} costs more than {_name(best)}.",
        f"In one of a thousand it costs more than {_interval('cost', rare[0])}, and {_name(best)} more than "
        f"{_interval('cost', rare[1])}: {'the intervals are apart' if apart else 'the intervals overlap'}.",
        f"The worst cost {rounded('cost', rival.tails['cost'].worst)} and {rounded('cost', best.tails['cost'].worst)}.",
    ]
    return [" ".join(said)]


def _titled(name: str) -> str:
    """Title of a metric with its unit, as a heading."""
    text = heading(name)
    return text[0].upper() + text[1:]


def _interval(name: str, found: Interval) -> str:
    point, low, high = (rounded(name, end) for end in found)
    return f"{point} [{low}, {high}]"


def _name(outcome: Outcome) -> str:
    return f"`{outcome.method.name}`"


def distribution(outcomes: Sequence[Outcome], metric: str) -> str:
    """Table of one metric's distribution, a row for each method."""
    digits = KNOWN[metric].digits
    rows = []
    for outcome in outcomes:
        tail = outcome.tails[metric]
        rows.append(
            [
                _name(outcome),
                f"{number(tail.mean, digits + 1)} ± {number(tail.error, digits + 2)}",
                number(tail.iqm, digits + 1),
                *(_interval(metric, tail.percentiles[share]) for share in SHARES),
                rounded(metric, tail.worst_mean),
                rounded(metric, tail.worst),
            ]
        )
    percentiles = ["median", *(f"{100 * share:g} %" for share in SHARES[1:])]
    return markdown_table(["method", "mean", "IQM", *percentiles, _WORST, "worst"], rows)


def _few(outcomes: Sequence[Outcome]) -> str:
    def cells(tail: Tail) -> list[str]:
        return [*(_interval("cost", tail.percentiles[share]) for share in SHARES[-2:]), rounded("cost", tail.worst)]

    rows = [[_name(one), *cells(one.few), *cells(one.tails["cost"])] for one in outcomes]
    titles = [f"{100 * share:g} %" for share in SHARES[-2:]] + ["worst"]
    few = [f"{title}, first {EPISODES}" for title in titles]
    return markdown_table(["method", *few, *(f"{title}, all" for title in titles)], rows)


def _share(found: Interval) -> str:
    point, low, high = (f"{100 * end:.3g}" for end in found)
    return f"{point} [{low}, {high}]"


def _failures(outcomes: Sequence[Outcome]) -> str:
    rows = [[_name(one), *map(_share, (one.left, one.not_arrived, one.not_settled))] for one in outcomes]
    return markdown_table(["method", "left the workspace (%)", "did not arrive (%)", "never settled (%)"], rows)


def _against(outcomes: Sequence[Outcome], best: Outcome) -> str:
    rows = []
    for outcome in outcomes:
        found = outcome.against
        assert found is not None
        rows.append(
            [
                _name(outcome),
                _share(found.dearer),
                f"{number(found.mean, 1)} ± {number(found.error, 2)}",
                *(_interval("cost", found.percentiles[share]) for share in OF_DIFFERENCE),
                rounded("cost", found.most),
            ]
        )
    shares = [f"{100 * share:g} %" for share in OF_DIFFERENCE]
    return (
        f"### Against {_name(best)}, scenario by scenario\n\nHow often a method costs more than {_name(best)}, the "
        "classical method of the lowest IQM, on the same scenario; and the distribution of the difference of the "
        "costs. Negative: the method costs less.\n\n"
    ) + markdown_table(["method", "costs more (%)", "mean difference", *shares, "most"], rows)


def _policies(outcomes: Sequence[Outcome]) -> str:
    rows = [
        [
            f"{_name(one)}, {policy}",
            f"{number(tail.mean, 1)} ± {number(tail.error, 2)}",
            *(_interval("cost", tail.percentiles[share]) for share in SHARES[1:]),
            rounded("cost", tail.worst),
        ]
        for one in outcomes
        for policy, tail in enumerate(one.policies)
    ]
    titles = ["method, training seed", "mean cost", *(f"{100 * share:g} %" for share in SHARES[1:]), "worst"]
    return f"### By training seed\n\nEach on its own part of the scenarios.\n\n{markdown_table(titles, rows)}"


def _torques(outcomes: Sequence[Outcome]) -> str:
    rows = []
    for one in outcomes:
        cells = []
        for name in TORQUE_QUALITY:
            tail = one.tails[name]
            cells += [rounded(name, tail.mean), rounded(name, tail.percentiles[SHARES[-1]].value)]
        rows.append([_name(one), *cells])
    titles = [f"{heading(name)}, {what}" for name in TORQUE_QUALITY for what in ("mean", f"{100 * SHARES[-1]:g} %")]
    return f"### Torques\n\n{markdown_table(['method', *titles], rows)}"


def _arms(study: Study, outcomes: Sequence[Outcome]) -> str:
    rows = []
    for one in outcomes:
        for of in one.unlike[:_MOST_TOLD]:
            name = f"`{of.name}`" if "_" in of.name else of.name
            rows.append([_name(one), name, f"{of.median:.3g}", f"{of.usual:.3g}", f"{of.distance:.2f}"])
    none = [_name(one) for one in outcomes if not one.unlike]
    text = (
        f"### Which arms and moves are in the tail\n\nThe {tail_size(study.episodes)} scenarios of the highest cost "
        "(0.1 %) of each method against all: the constants of the arm and of the move whose distribution differs most "
        f"(at most {_MOST_TOLD}), by the distance of Kolmogorov and Smirnov, which lies between 0 and 1. Only what is "
        "shown to differ, with Holm's correction for all constants. SI units.\n\n"
    )
    titles = ["method", "constant", "median in the tail", "median of all", "distance"]
    table = markdown_table(titles, rows, "llrrr")
    return text + table + (f"\n\nNothing is shown of {', '.join(none)}." if none else "")


def _cases(study: Study, split: str, outcomes: Sequence[Outcome]) -> str:
    rows = [
        [
            _name(one),
            str(case.scenario),
            str(case.policy) if one.policies else "",
            rounded("cost", case.cost),
            rounded("tip_max_mm", case.tip_max_mm),
            f"{degrees(case.start)} to {degrees(case.goal)}",
        ]
        for one in outcomes
        for case in one.worst
    ]
    titles = ["method", "scenario", "training seed", "cost", heading("tip_max_mm"), "move"]
    commands = [
        f"python eval/watch.py --scenario-seed {study.number} --split {split} --scenario {one.worst[0].scenario} {who}"
        for one in outcomes
        if (who := _watched(one.method, one.worst[0].policy))
    ]
    shown = "\n".join(commands)
    return (
        f"### The {CASES} worst\n\n{markdown_table(titles, rows, 'lrrrrl')}\n\nTo watch the worst scenario of each "
        f"method (`--out motion.gif` writes a film):\n\n```sh\n{shown}\n```"
    )


def _watched(method: Method, policy: int) -> str:
    """Option of `eval/watch.py` that shows a method, or one of its policies; empty if it has none."""
    if method.guarded or method.kind == "privileged":
        return ""
    source = method.sources[policy]
    own = Path(source).is_relative_to(_ROOT)
    shown = Path(source).relative_to(_ROOT).as_posix() if own else source
    return f"--policy {shown}" if method.kind == "learned" else f"--controller {shown}"


def _times(study: Study, outcomes: Sequence[Outcome]) -> str:
    rows = [[_name(one), number(one.seconds, 0), number(1000 * one.seconds / study.episodes, 1)] for one in outcomes]
    table = markdown_table(["method", "processor time (s)", "of a scenario (ms)"], rows)
    return f"### Processor time\n\nOf drawing, running and measuring, and of compiling kernels once.\n\n{table}"
