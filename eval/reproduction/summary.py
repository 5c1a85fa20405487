"""The paper's conclusion in words and tables, every statement from the numbers: `summary.md`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from baselines.tools.provenance import command_line, commit
from beltarm_env import CONTROL_PERIOD, __version__
from eval.reproduction.effects import CLEAR, without_and_with
from eval.reproduction.loop import PAPER_ARM, ServoGains, best_gain, closed_loop, dominant_damping, poles
from eval.reproduction.pole_tables import pole_remarks, pole_table
from eval.reproduction.runs import END_WINDOW, PHASES
from eval.reproduction.sensitivity import answer, how_judged, taken_table, thresholds, tried_table, what_changes_it
from eval.reproduction.study import (
    AS_ANALYSED,
    BOTH_ARMS,
    FULL,
    FULL_ANALYSED,
    RANDOM_MOVES,
    RANDOM_SEED,
    REAL,
    STANDARD,
    TO_0,
    Scene,
    Study,
    nominal_m2,
)
from eval.reproduction.words import LEFT, degrees, number, percent
from eval.style.markdown_table import markdown_table

_LAST = round(END_WINDOW / CONTROL_PERIOD)
_CAPTIONS = {
    "responses_standard.png": "Figs. 4(b) and 8(b): the standard move, with Table 1's Coulomb friction.",
    "responses_standard_as_analysed.png": "The same as the paper analyses it: no Coulomb friction, no belt damping.",
    "responses_to_0.png": "A move that ends at 0°, where r alone does not show the vibration: it is lateral.",
    "root_locus_90.png": "Fig. 6 at 90°.",
    "root_locus_0.png": "The same at 0°.",
    "damping_map.png": "Smallest damping ratio of any pole over K4 and M2. It is −Re/|pole|: 1 where all are real "
    "and stable, negative where the loop is unstable.",
    "assumptions.png": "By how much K4 changes the ringing of the standard move, one assumption changed at a time. "
    "Dotted: the bounds of the answers. A value without a mark leaves nothing to compare.",
    "moves.png": "Left: ringing after the stop over the ramp time; dotted: the period of the mode with K4 = 0. Right: "
    "the random moves, by how much K4 changes their ringing; left of 1 it is less. Thick pale lines: as analysed.",
}


def markdown(study: Study, pictures: list[Path], seconds: float) -> str:
    """The content of `summary.md`."""
    shown = {path.name: f"![{path.stem}]({path.name})\n\n*{_CAPTIONS[path.name]}*" for path in pictures}
    responses = ("responses_standard.png", "responses_standard_as_analysed.png", "responses_to_0.png")
    parts = [
        "# Is this the paper?",
        *verdict(study),
        "## Before and after",
        _how_measured(study),
        ringing_table(study),
        *(shown[name] for name in responses),
        "## Poles",
        pole_table(study.gains),
        *pole_remarks(study),
        *(shown[name] for name in ("root_locus_90.png", "root_locus_0.png", "damping_map.png")),
        "## What the paper leaves open",
        taken_table(study),
        how_judged(study),
        tried_table(study),
        shown["assumptions.png"],
        "## Other moves",
        share_table(study),
        shown["moves.png"],
        "## Where this comes from",
        f"`{command_line()}`, beltarm {__version__} ({commit()}), {seconds:.0f} s.",
    ]
    return "\n\n".join(parts) + "\n"


def verdict(study: Study) -> list[str]:
    """The conclusion, generated from the numbers: a headline, and what stands behind it."""
    headline = (
        f"Does K4 = {study.gains.k4:g} remove the tip's ringing? **As the paper analyses it, without Coulomb friction "
        f"and belt damping: {answer(study, AS_ANALYSED)}. With the friction of its own Table 1: {answer(study, REAL)}."
        f"** Against K4 = 0, in the last {END_WINDOW:g} s of the standard move the ringing is "
        f"{study.standard(AS_ANALYSED).fate('end')} as analysed, and {study.standard(REAL).fate('end')} with friction."
    )
    return [headline, "\n".join(f"- {line}" for line in _findings(study))]


def _findings(study: Study) -> list[str]:
    analysed, real = study.scenes[STANDARD, AS_ANALYSED], study.scenes[STANDARD, REAL]
    k4 = f"K4 = {study.gains.k4:g}"
    stuck, stuck_less = (percent(run.stuck_share) for run in (real.without, real.suppressed))
    return [
        thresholds(study),
        what_changes_it(study, AS_ANALYSED),
        what_changes_it(study, REAL),
        _other_moves(study),
        _full_arm(study),
        _linear(study.gains),
        f"Fig. 4(b), K4 = 0: the motor's error is {_tracking(real, False)}; the tip rings with "
        f"{_of(real, 'cruise')} during the cruise and {_of(real, 'stop')} after the stop.",
        f"Fig. 8(b), {k4}: ringing is {real.compared.fate('cruise')} during the cruise and "
        f"{real.compared.fate('stop')} after the stop; the motor's error is {_tracking(real, True)}.",
        f"Friction: after the stop the motor sticks for {stuck} of the time with K4 = 0 and {stuck_less} with {k4}; "
        "while it sticks, only the belt's own damping acts on the arm. As analysed, ringing after the stop is "
        f"{analysed.compared.fate('stop')}.",
    ]


def _other_moves(study: Study) -> str:
    (removed, reduced, increased), (removed_too, reduced_too, increased_too) = (
        [percent(share(view, "end")) for share in (study.share_removed, study.share_reduced, study.share_increased)]
        for view in (AS_ANALYSED, REAL)
    )
    return (
        f"Other moves: of {RANDOM_MOVES} random ones, in the last {END_WINDOW:g} s, as analysed, the answer is *yes* "
        f"on {removed}; ringing is reduced on {reduced} and increased on {increased}. With friction these are "
        f"{removed_too}, {reduced_too} and {increased_too}."
    )


def _full_arm(study: Study) -> str:
    to_90, to_0 = (study.scenes[place, FULL].compared.fate("stop") for place in (STANDARD, TO_0))
    analysed, analysed_0 = (study.scenes[place, FULL_ANALYSED].compared.fate("stop") for place in (STANDARD, TO_0))
    median, median_analysed = (_median(study, view, "stop") for view in (FULL, FULL_ANALYSED))
    return (
        "Full arm: on the two links' true Lagrangian, with friction, ringing after the stop is "
        f"{to_90} on the standard move and {to_0} on the one to 0°; the median ratio over the random moves is "
        f"{median}. As analysed they are {analysed}, {analysed_0} and {median_analysed}."
    )


def _linear(gains: ServoGains) -> str:
    before, after = (dominant_damping(poles(closed_loop(PAPER_ARM, np.pi / 2, g))) for g in without_and_with(gains))
    best, most = best_gain(gains, nominal_m2(np.pi / 2))
    unstable = ", unstable" if after < 0 else ""
    largest = f"largest, {number(most, 3)}, at K4 = {round(best, 2):g}" if best > 0 else "largest with K4 = 0"
    return (
        f"Linear loop at 90°: K4 = {gains.k4:g} takes the dominant damping ratio from {number(before, 3)} to "
        f"{number(after, 3)}{unstable}; it is {largest}."
    )


def _tracking(scene: Scene, suppressed: bool) -> str:
    run = scene.suppressed if suppressed else scene.without
    if np.isnan(run.motor_speed_error):
        return f"not known ({LEFT})"
    cruise = np.abs(run.motor_speed_reference).max()
    share = number(100 * run.motor_speed_error / cruise, 1)
    return f"{number(run.motor_speed_error, 1)} rad/s RMS ({share} % of its cruising speed)"


def _of(scene: Scene, phase: str) -> str:
    value = getattr(scene.compared.without, phase)[0]
    return f"{number(value, 1)} m/s²" if np.isfinite(value) else "an unmeasured amount"


def _how_measured(study: Study) -> str:
    start, goal = study.move[:2]
    return (
        "Ringing is the RMS distance (m/s²) of the tip's acceleration from that of a rigid arm on the reference, in "
        f"two dimensions. The standard move leads from {degrees(start)} to {degrees(goal)} in {study.move.duration:g} "
        f"s with ramps of {study.move.ramp_time:g} s; the move to 0° is as long. K4 = 0 is the same servo, eq. (11), "
        f"without its last term. *Reduced* is a ratio below {CLEAR:g}, *increased* one above {1 / CLEAR:g}. Velocities "
        f"are peak to peak over the last {END_WINDOW:g} s; the motor's error is that while its reference moves. *As "
        "analysed*: no Coulomb friction in arm and controller, no belt damping; *torsion measured*: the true torsional "
        "velocity in place of the simulated; *full arm*: the two links' Lagrangian in place of (5), the controller's "
        "simulation as before."
    )


def ringing_table(study: Study) -> str:
    """Ringing, velocities and tracking of the moves at both ends, before and after."""
    after = f"{study.gains.k4:g}"
    titles = [
        *("move to", "assumptions", "K4", "cruise (m/s²)", "after the stop (m/s²)", f"last {END_WINDOW:g} s (m/s²)"),
        *("ṙ p-p (m/s)", "ẏ p-p (m/s)", "motor error RMS (rad/s)", "stuck after the stop (%)"),
    ]
    rows = []
    for (place, view), scene in study.scenes.items():
        if place == TO_0 and scene.move == study.move:
            continue
        for k4, run, rung in (
            ("0", scene.without, scene.compared.without),
            (after, scene.suppressed, scene.compared.suppressed),
        ):
            cells = [number(getattr(rung, phase)[0], 2) for phase in PHASES]
            cells += [number(np.ptp(speed[-_LAST:]), 3) for speed in (run.radial_speed, run.lateral_speed)]
            cells += [number(run.motor_speed_error, 1), number(100 * run.stuck_share, 0)]
            left = f" ({LEFT})" if np.isinf(rung.stop[0]) else ""
            rows.append([degrees(scene.move.goal), f"{view}{left}", k4, *cells])
    return markdown_table(titles, rows, "ll" + "r" * (len(titles) - 2))


def share_table(study: Study) -> str:
    """Share of random moves on which K4 removes, reduces and increases ringing."""
    drawn = f"{RANDOM_MOVES} moves drawn as the environment draws them (seed {RANDOM_SEED}), on the nominal arm."
    titles = ["assumptions", "phase", "removed (%)", "reduced (%)", "increased (%)", "median ratio"]
    rows = []
    for view in BOTH_ARMS:
        for phase, words in PHASES.items():
            shares = (study.share_removed, study.share_reduced, study.share_increased)
            cells = [number(100 * share(view, phase), 0) for share in shares]
            rows.append([view, words, *cells, _median(study, view, phase)])
    return f"{drawn}{_leaving(study)}\n\n{markdown_table(titles, rows, 'llrrrr')}"


def _median(study: Study, view: str, phase: str) -> str:
    median = study.median_ratio(view, phase)
    return LEFT if np.isinf(median) else number(median, 2)


def _leaving(study: Study) -> str:
    """On how many random moves the arm leaves its workspace, and how these are counted."""
    counts = {view: study.count_left(view) for view in BOTH_ARMS}
    listed = [
        f"{view}: {without} with K4 = 0, {suppressed} with {study.gains.k4:g}"
        for view, (without, suppressed) in counts.items()
        if without or suppressed
    ]
    if not listed:
        return ""
    return (
        f" On some of them {LEFT} ({'; '.join(listed)}). Where it does with K4 = 0 there is nothing to compare; where "
        "it does with feedback only, the move counts as increased."
    )
