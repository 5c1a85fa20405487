"""The numbers of all controllers as a page in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from baselines import TUNABLE
from baselines.loops.condition import CORNERS, MarginCondition
from beltarm_env.task.seeds import LOOPS
from eval.loops import tables
from eval.loops.costs import PRIVILEGED
from eval.loops.identification import IDENTIFYING, WORSE
from eval.loops.study import LoopStudy

_ASKED = MarginCondition()
_LOOPS = (
    "The arm is at rest at a joint angle, behind its drive: current loop, latency and torque constant. Coulomb "
    "friction and its compensation, the encoder's resolution and the torque limit are left out. There is one "
    "measurement, the motor's angle, so the loop may be cut at the torque or at the encoder alike. *Gain up* and "
    "*gain down* are the factors at which the loop becomes unstable, *delay* is what it bears beyond the drive's own "
    "latency, in samples of 1.5 ms, *modulus* is 1 / max|S|. `preview` and `adaptive` have the gain of the plan long "
    f"before its end, `{IDENTIFYING}` believes in the arm that it is on, `mpc` has the first torque of its horizon "
    "within the limit."
)
_CORNERS = (
    f"The same on the design model and {len(CORNERS) - 1} corners of the training ranges. Gains are tuned under the "
    f"condition that modulus and delay are at least {_ASKED.modulus:g} and {_ASKED.delay:g} sample on all of them "
    "(`baselines/loops/condition.py`); `paper` and `rigid` are not tuned."
)


def markdown(study: LoopStudy, pictures: Sequence[Path], origin: str) -> str:
    """The content of `summary.md`."""
    shown = {path.stem: f"![{path.stem}]({path.name})" for path in pictures}
    arms, moves = study.sizes.arms, study.sizes.moves
    parts = [
        "# The classical controllers in numbers",
        "Laws and what limits them are in [../baselines.md](../baselines.md). Everything on this page is written by "
        f"`make loops`. Arms *as they are built* are {arms} arms and drives of the training ranges, seeds "
        f"{LOOPS.first} to {LOOPS.first + arms - 1}, on which nothing was tuned, trained or tested. *{PRIVILEGED}* "
        "knows the true constants and the true state, and is not ranked.",
        "Contents: [loops](#linear-loops), [costs](#costs), [where each breaks](#where-each-breaks), [price of the "
        "margins](#price-of-the-margins), [identification](#what-identification-is-worth), [time](#time), "
        "[optimum](#gap-to-the-clairvoyant-optimum), [each "
        "controller](#each-controller).",
        "## At a glance",
        "*Cost*: interquartile mean on arms as they are built; *worst 5 %*: their mean cost over it; then the cost "
        "with half a sample of latency beyond the training range, and with torque constants beyond theirs, over it; "
        "least margins over ten arms and all angles; reversals of the torque by more than 10 % of its limit; and "
        "the 99th percentile of the time per action of one arm.",
        tables.glance_table(study),
        "## Linear loops",
        _LOOPS,
        "### On the design model",
        "The worst over 46 angles from 0° to 90°, and where; *stable*: every pole lies inside the unit circle at "
        "all of them.",
        tables.margins_table(study),
        "### At the ten arms of the condition",
        _CORNERS,
        tables.corners_table(study),
        "Least modulus margin on each arm; what an arm's name does not say is at the lower end of its range:",
        tables.arms_table(study),
        shown["margins"],
        "Blue: on the design model. Vermilion: the worst of the ten arms at each angle. Dashed: 6 dB, 30°, and the one "
        f"sample and {_ASKED.modulus:g} of the condition.",
        shown["poles"],
        "Poles s = ln z / 1.5 ms on the design model, upper half plane; faster ones lie outside. Dashed: damping "
        "ratios 0.1 and 0.3.",
        "## Costs",
        "Interquartile means on arms as they are built, with bootstrap 95 % intervals; beside them the cost on the "
        f"design model ({moves} moves), the mean, the mean of the worst 5 % and how many arms left the workspace.",
        tables.costs_table(study),
        "## Where each breaks",
        f"Mean cost over the mean cost on the design model, same {moves} moves, one thing changed at a time; effects "
        "of the drive are half as large again as the most in training; *left*: episodes in which the arm left the "
        f"workspace. A ratio near 1 does not make a controller good: read it with the costs above. *{PRIVILEGED}* is "
        "told the constants that are changed, but neither of the encoder nor of the full arm. Over the size of each "
        "effect of the drive, and with learned controllers: [../drive/summary.md](../drive/summary.md).",
        shown["breaks"],
        tables.changes_table(study),
        "### Beyond the training ranges",
        "Cost of arms as they are built with one constant moved beyond its training range, over their cost without.",
        tables.limits_table(study),
        "## Price of the margins",
        "Interquartile mean and mean of the cost on arms as they are built, with gains tuned under the condition, and "
        "with gains of the same search, seed and budget without it (`baselines/gains_without_margins.json`), whose "
        "margins are beside. A search is a matter of luck: below ×1 it found better gains under the condition."
        + _unpriced(study),
        tables.prices_table(study) if study.prices else "No gains without margins.",
        "## What identification is worth",
        f"Cost of `{IDENTIFYING}` beside two that believe in the design model, on the same {arms} arms as they are "
        "built: the same law with nothing identified, and the best of the others. *Worse* are arms on which it costs "
        f"over {WORSE:g} times as much.",
        tables.worth_table(study) if study.worth else f"`{IDENTIFYING}` was not asked about.",
        "## Time",
        "Wall-clock on the machine below, the controller's period being 1500 µs. One arm of the training ranges: "
        "the first action of an episode, before which nothing moves, apart; plans that are made later are among the "
        "others. The last column has the environment in it.",
        tables.times_table(study),
        "## Gap to the clairvoyant optimum",
        "Cost over that of `baselines/oracle.json`, which knows arm, state and move; a local optimum. The seeds are "
        "among those that tuning may draw arms from.",
        tables.gap_table(study),
        "## Each controller",
        *(tables.controller_section(study, name) for name in study.scans),
        "## Where this comes from",
        origin,
    ]
    return "\n\n".join(parts) + "\n"


def _unpriced(study: LoopStudy) -> str:
    missing = [f"`{name}`" for name in study.scans if name in TUNABLE and name not in study.prices]
    return f" Not tuned without margins, or not alike: {', '.join(missing)}." if missing else ""
