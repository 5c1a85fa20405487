"""The paper's conclusion in words and tables, every statement from the numbers: `summary.md`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from beltarm_env import CONTROL_PERIOD, __version__
from eval.provenance import command_line, commit
from eval.reproduction.cases import CLEAR, Compared, Open, effect
from eval.reproduction.loop import PAPER_ARM, ServoGains, best_gain, closed_loop, dominant_damping, poles
from eval.reproduction.pole_tables import pole_remarks, pole_table
from eval.reproduction.runs import END_WINDOW, PHASES
from eval.reproduction.study import RANDOM_MOVES, RANDOM_SEED, Scene, Study, nominal_m2

_LAST = round(END_WINDOW / CONTROL_PERIOD)
GONE = 0.1
"""Ringing is called gone below this ratio to that without vibration feedback."""
_CAPTIONS = {
    "responses_90.png": "Figs. 4(b) and 8(b): the standard move, with Table 1's Coulomb friction.",
    "responses_90_as_analysed.png": "The same as the paper analyses it: no Coulomb friction, no belt damping.",
    "responses_0.png": "A move that ends at 0°, where r alone does not show the vibration: it is lateral.",
    "root_locus_90.png": "Fig. 6 at 90°.",
    "root_locus_0.png": "The same at 0°.",
    "damping_map.png": "Smallest damping ratio of any pole over K4 and M2. It is −Re/|pole|: 1 where all are real "
    "and stable, negative where the loop is unstable.",
    "assumptions.png": "Ringing of the standard move, one assumption changed at a time.",
    "moves.png": "Left: ringing after the stop over the ramp time; dotted: the period of the mode with K4 = 0. Right: "
    "the random moves, by how much K4 changes their ringing; left of 1 it is less. Thick pale lines: no Coulomb "
    "friction in arm and controller.",
}


def markdown(study: Study, pictures: list[Path], seconds: float) -> str:
    """The content of `summary.md`."""
    shown = {path.name: f"![{path.stem}]({path.name})\n\n*{_CAPTIONS[path.name]}*" for path in pictures}
    parts = [
        "# Is this the paper?",
        *verdict(study),
        "## Before and after",
        _how_measured(study),
        ringing_table(study),
        *(shown[name] for name in ("responses_90.png", "responses_90_as_analysed.png", "responses_0.png")),
        "## Poles",
        pole_table(study.gains),
        *pole_remarks(study),
        *(shown[name] for name in ("root_locus_90.png", "root_locus_0.png", "damping_map.png")),
        "## What the paper leaves open",
        _how_judged(study),
        assumption_table(study),
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
    analysed, real = (study.scenes["90°", view] for view in ("as analysed", "with friction"))
    headline = (
        f"Does K4 = {study.gains.k4:g} remove the tip's ringing? **As the paper analyses it, without Coulomb friction: "
        f"{_answer(analysed.compared)}. With the friction of its own Table 1: {_answer(real.compared)}.** In the last "
        f"{END_WINDOW:g} s of the standard move the ringing is {_fate(analysed.compared, 'end')} without friction, and "
        f"{_fate(real.compared, 'end')} with it, of what it is with K4 = 0."
    )
    return [headline, "\n".join(f"- {line}" for line in _findings(study, analysed, real))]


def _answer(compared: Compared) -> str:
    ratio = compared.ratio("end")
    return "yes" if ratio < GONE else "in part" if ratio < CLEAR else "no"


def _fate(compared: Compared, phase: str) -> str:
    """What became of the ringing, such as `reduced to 36 %`."""
    ratio = compared.ratio(phase)
    if np.isnan(ratio):
        return "not to be compared"
    return f"{effect(ratio)} {'at' if effect(ratio) == 'unchanged' else 'to'} {100 * ratio:.0f} %"


def _findings(study: Study, analysed: Scene, real: Scene) -> list[str]:
    k4 = f"K4 = {study.gains.k4:g}"
    stuck, stuck_less = (f"{100 * run.stuck_share:.0f} %" for run in (real.without, real.suppressed))
    reduced, reduced_analysed = (_percent(study.share_reduced(friction, "stop")) for friction in (True, False))
    increased, increased_analysed = (_percent(study.share_increased(friction, "stop")) for friction in (True, False))
    return [
        _linear(study.gains),
        f"Fig. 4(b), K4 = 0: the motor follows its trapezoid within {_tracking(real, False)} RMS; the tip rings with "
        f"{_of(real, 'without', 'cruise')} during the cruise and {_of(real, 'without', 'stop')} after the stop.",
        f"Fig. 8(b), {k4}: ringing is {_fate(real.compared, 'cruise')} during the cruise and "
        f"{_fate(real.compared, 'stop')} after the stop; the motor's error is {_tracking(real, True)} RMS.",
        f"Friction: after the stop the motor sticks for {stuck} of the time with K4 = 0 and {stuck_less} with {k4}; "
        "while it sticks, only the belt's own damping acts on the arm. Without friction, ringing after the stop is "
        f"{_fate(analysed.compared, 'stop')}.",
        f"Other moves: of {RANDOM_MOVES} random ones, {k4} reduces the ringing after the stop on {reduced} with "
        f"friction and on {reduced_analysed} without, and increases it on {increased} and {increased_analysed}.",
        _what_changes_it(study),
    ]


def _linear(gains: ServoGains) -> str:
    before, after = (
        dominant_damping(poles(closed_loop(PAPER_ARM, np.pi / 2, g))) for g in (replace(gains, k4=0.0), gains)
    )
    best, most = best_gain(gains, nominal_m2(np.pi / 2))
    return (
        f"Linear loop at 90°: K4 = {gains.k4:g} takes the dominant damping ratio from {before:.3f} to {after:.3f}; "
        f"it is largest, {most:.3f}, at K4 = {best:.2f}."
    )


def _what_changes_it(study: Study) -> str:
    changing = []
    for question in study.questions:
        found = zip(question.variants, study.found[question.name], strict=True)
        changing += [f"{v.label} ({100 * c.ratio('stop'):.0f} %)" for v, c in found if not c.ratio("stop") < CLEAR]
    if not changing:
        return "Assumptions: none of the values tried changes whether K4 reduces the ringing after the stop."
    if len(changing) == sum(len(question.variants) for question in study.questions):
        return "Assumptions: with none of the values tried does K4 reduce the ringing after the stop."
    return (
        "Assumptions: on the standard move K4 does not reduce the ringing after the stop with "
        f"{'; '.join(changing)}. With all other values tried, it does."
    )


def _tracking(scene: Scene, suppressed: bool) -> str:
    run = scene.suppressed if suppressed else scene.without
    cruise = np.abs(run.motor_speed_reference).max()
    return f"{run.motor_speed_error:.1f} rad/s ({100 * run.motor_speed_error / cruise:.1f} % of its cruising speed)"


def _of(scene: Scene, which: str, phase: str) -> str:
    value = getattr(getattr(scene.compared, which), phase)[0]
    return "an unmeasured amount" if np.isnan(value) else f"{value:.1f} m/s²"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _how_measured(study: Study) -> str:
    start, goal = np.degrees(study.move[:2])
    return (
        "Ringing is the RMS distance (m/s²) of the tip's acceleration from that of a rigid arm on the reference, in "
        f"two dimensions. The standard move leads from {start:.0f}° to {goal:.0f}° in {study.move.duration:g} s with "
        f"ramps of {study.move.ramp_time:g} s; the move to 0° is as long. K4 = 0 is the same servo, eq. (11), without "
        f"its last term. *Yes* in the verdict means that less than {100 * GONE:.0f} % is left, *in part* less than "
        f"{100 * CLEAR:.0f} %. Velocities are peak to peak over the last {END_WINDOW:g} s; the motor's error is "
        "that while its reference moves. *As analysed*: no Coulomb friction in arm and controller, no belt damping; "
        "*torsion measured*: the true torsional velocity in place of the simulated."
    )


def ringing_table(study: Study) -> str:
    """Ringing, velocities and tracking of the moves at both ends, before and after."""
    after = f"{study.gains.k4:g}"
    lines = [
        "| move to | assumptions | K4 | cruise (m/s²) | after the stop (m/s²) | last 0.3 s (m/s²) | ṙ p-p (m/s) "
        "| ẏ p-p (m/s) | motor error RMS (rad/s) | stuck after the stop (%) |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for (place, view), scene in study.scenes.items():
        for k4, run, rung in (
            ("0", scene.without, scene.compared.without),
            (after, scene.suppressed, scene.compared.suppressed),
        ):
            radial, lateral = (np.ptp(speed[-_LAST:]) for speed in (run.radial_speed, run.lateral_speed))
            cells = [_number(getattr(rung, phase)[0]) for phase in PHASES]
            cells += [f"{radial:.3f}", f"{lateral:.3f}", f"{run.motor_speed_error:.1f}", f"{100 * run.stuck_share:.0f}"]
            end = f"{np.degrees(scene.move.goal):.0f}°" if place == "90°" else place
            lines.append(f"| {end} | {view} | {k4} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _number(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.2f}"


def _how_judged(study: Study) -> str:
    return (
        "Each assumption is changed alone, around the standard move with Table 1's friction; ratios are ringing with "
        f"K4 = {study.gains.k4:g} over that with 0. *Reduced* is a ratio below {CLEAR:g}, *increased* one above "
        f"{1 / CLEAR:g}; the conclusion changes where the word does. Values that make the move infeasible are left "
        "out. The controller knows the arm, except where a value is *taken for* another."
    )


def assumption_table(study: Study) -> str:
    """What the paper prints, what is taken, why, what was tried, and whether the conclusion changes."""
    standard = study.scenes["90°", "with friction"].compared
    lines = [
        "| open | the paper | taken | why | tried: ratio cruise / after the stop | conclusion changes |",
        "|---|---|---|---|---|---|",
    ]
    for question in study.questions:
        tried = [
            f"{variant.label}: {found.ratio('cruise'):.2f} / {found.ratio('stop'):.2f}"
            for variant, found in zip(question.variants, study.found[question.name], strict=True)
        ]
        lines.append(
            f"| {question.name} | {question.printed} | {question.taken} | {question.why} | {'<br>'.join(tried)} "
            f"| {_changes(question, study.found[question.name], standard)} |"
        )
    ratios = f"{standard.ratio('cruise'):.2f} / {standard.ratio('stop'):.2f}"
    return f"The standard move has {ratios}.\n\n" + "\n".join(lines)


def _changes(question: Open, found: list[Compared], standard: Compared) -> str:
    changed = []
    for variant, one in zip(question.variants, found, strict=True):
        for phase in ("cruise", "stop"):
            word = effect(one.ratio(phase))
            if word != effect(standard.ratio(phase)):
                changed.append(f"{variant.label}: {word} {PHASES[phase]}")
    return "<br>".join(changed) if changed else "no"


def share_table(study: Study) -> str:
    """Share of random moves on which K4 reduces and increases ringing, with and without Coulomb friction."""
    lines = [
        f"{RANDOM_MOVES} moves drawn as the environment draws them (seed {RANDOM_SEED}), on the nominal arm.",
        "",
        "| Coulomb friction | phase | reduced (%) | increased (%) | median ratio |",
        "|---|---|---:|---:|---:|",
    ]
    for friction, name in ((True, "Table 1"), (False, "none")):
        for phase, words in PHASES.items():
            reduced, increased = study.share_reduced(friction, phase), study.share_increased(friction, phase)
            median = np.median(study.random[friction].ratios(phase))
            lines.append(f"| {name} | {words} | {100 * reduced:.0f} | {100 * increased:.0f} | {median:.2f} |")
    return "\n".join(lines)
