"""What generated controllers take, as a page in Markdown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from baselines import CONTROLLERS
from beltarm_env import CONTROL_PERIOD
from eval.comparison.sets import SetLabel
from eval.deploy.controllers import exportable
from eval.deploy.study import SPREAD, Exported
from eval.report.text import markdown_table

_AGREES, _COSTS = 1e-3, 0.01  # of the torque limit, and of the cost, by which single precision may be off


def holds(found: Exported) -> bool:
    """Tell whether single precision does for a controller."""
    off = float(np.quantile(found.single.off, 0.999))
    return off <= _AGREES and abs(found.single.cost) <= _COSTS


def times_table(results: list[Exported]) -> str:
    """Equality and time."""
    rows = [
        [
            f"`{found.name}`",
            f"{found.equal:,} of {found.samples:,}".replace(",", " "),
            *(f"{time:.2g}" if time < 100 else f"{time:.0f}" for time in found.times[1:]),
        ]
        for found in results
    ]
    head = ["equal to the last bit", "sample, median (µs)", "99 %", "longest", "reset"]
    return markdown_table(["controller", *head], rows)


def spread_table(results: list[Exported]) -> str:
    """Plans spread over samples."""
    rows = [
        [
            f"`{found.name}`",
            *(f"{times.median:.2g} / {times.longest:.0f}" for times in (found.times, found.spread.times)),
            f"{100 * found.spread.cost:+.2f} %",
        ]
        for found in results
        if found.spread is not None
    ]
    return markdown_table(["sample, median / longest (µs)", "at once", "spread", "mean cost"], rows)


def sizes_table(results: list[Exported]) -> str:
    """Flash, memory and stack."""
    rows = []
    for found in results:
        cells = []
        for taken in found.footprints.values():
            cells += ["–"] * 3 if taken is None else [f"{size / 1024:.1f}" for size in taken]
        rows.append([f"`{found.name}`", *cells])
    heads = [f"{core}: {what}" for core in results[0].footprints for what in ("flash", "memory", "stack")]
    return markdown_table(["controller (kB)", *heads], rows)


def single_table(results: list[Exported]) -> str:
    """Single precision."""
    rows = []
    for found in results:
        off = [f"{1000 * np.quantile(found.single.off, share):.2g}" for share in (0.5, 0.999, 1.0)]
        rows.append([f"`{found.name}`", *off, f"{100 * found.single.cost:+.2f} %", "yes" if holds(found) else "no"])
    head = ["torque off, median (‰ of limit)", "99.9 %", "largest", "mean cost", "holds"]
    return markdown_table(["controller", *head], rows)


def coverage(shown: Sequence[str]) -> str:
    """Say which controllers of the project are not on the page, and why."""
    able = exportable()
    unable = [f"`{name}`" for name in CONTROLLERS if name not in able]
    left_out = [f"`{name}`" for name in able if name not in shown]
    found = [f"Exported as well, but not measured here: {', '.join(left_out)}."] if left_out else []
    return " ".join([*found, f"Not exported: {', '.join(unable)}, and controllers of your own."])


def markdown(results: list[Exported], label: SetLabel, origin: str) -> str:
    """Write the page."""
    single = [found.name for found in results if holds(found)]
    without = [found.name for found in results if found.identifies]
    return f"""# Controllers as programs

**{label.note}**

C99, written by `python eval/export.py CONTROLLER --out DIR` from the kernels that the comparison runs, compiled by this
machine's compiler with `-O2 -ffp-contract=off` and run in the loop with simulated arms. The guard is in all of them.
{coverage([found.name for found in results])}

## The same torques, and how long they take

{times_table(results)}

Times are of one arm on this machine, a processor of a server, without what else it did meanwhile; the period is
{1e6 * CONTROL_PERIOD:.0f} µs. The longest sample of `adaptive`, and of what builds on it, holds a plan that is made
anew while the arm moves. `reset` makes the first plan, before the move.

Where such a plan takes longer than a sample, `--plan-samples {SPREAD}` spreads it over {SPREAD} samples. Its later
samples are planned first, and until the new plan has come down to now, the arm follows the old one:

{spread_table(results)}

## What they take on a small processor

{sizes_table(results)}

Cortex-M4 in single precision, Cortex-M7 in double. Flash is code and constants, memory the controller's struct, stack a
bound from the compiler's own figures along the deepest calls. No time is given: nobody here has measured on a board.

## Single precision

{single_table(results)}

Torques are compared for the same encoder counts, sample by sample; the cost is that of the closed loop. It holds where
99.9 % of the torques are within 1 ‰ of the limit and the mean cost is within 1 %:
{", ".join(f"`{n}`" for n in single)}.
Of the others without a filter that identifies, the direction in which friction is overcome changes a sample earlier or
later now and then, which the closed loop hardly notices.
Those that identify the arm ({", ".join(f"`{n}`" for n in without)}) find slopes by small differences of simulations,
which single precision does not have; their sources refuse to be compiled in it. On a processor without doubles, use one
of the others.

{origin}
"""
