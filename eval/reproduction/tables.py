"""The study as tables, `tables.md`; docs/science/paper.md says how to read them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from baselines.tools.provenance import command_line, commit
from beltarm_env import CONTROL_PERIOD, __version__
from beltarm_env.task.seeds import PAPER_MOVES
from eval.report.text import degrees, markdown_table, number
from eval.reproduction.pole_tables import best_gain_table, frequency_table, full_arm_table, pole_table
from eval.reproduction.responses import Response
from eval.reproduction.ringing import ANSWERS, END_WINDOW, PHASES, Suppression
from eval.reproduction.study import AS_ANALYSED, BOTH_ARMS, FRICTION, MAIN, TO_0, PaperStudy

LEFT = "the arm left its workspace"
_LAST = round(END_WINDOW / CONTROL_PERIOD)


def markdown(study: PaperStudy, pictures: Sequence[Path], seconds: float) -> str:
    """The content of `tables.md`."""
    shown = {path.stem: f"![{path.stem}]({path.name})" for path in pictures}
    start, goal, duration, ramp_time = study.move
    parts = [
        "# The paper, regenerated",
        "`docs/science/paper.md` says how to read these tables, and what follows with the gains of Table 2.",
        f"K4 = {study.gains.k4:g} N m s/rad, ω_n = {study.gains.natural_frequency:g} rad/s, ξ = "
        f"{study.gains.damping:g}; standard move: {degrees(start)} to {degrees(goal)} in {duration:g} s with ramps of "
        f"{ramp_time:g} s.",
        f"## Does K4 = {study.gains.k4:g} remove the ringing?",
        answer_table(study),
        "## Before and after",
        ringing_table(study),
        *(shown[name] for name in ("responses_standard", "responses_standard_as_analysed", "responses_to_0")),
        "## Poles",
        pole_table(study.gains),
        "On the full arm:",
        full_arm_table(study.gains),
        best_gain_table(study.gains),
        frequency_table(study.gains),
        *(shown[name] for name in ("root_locus_90", "root_locus_0", "damping_map")),
        "## Assumptions",
        assumption_table(study),
        shown["assumptions"],
        "## Other moves",
        f"{PAPER_MOVES.size} moves drawn as the environment draws them (seeds {PAPER_MOVES.first} to "
        f"{PAPER_MOVES.first + PAPER_MOVES.size - 1}), on the nominal arm.",
        random_table(study),
        shown["moves"],
        f"`{command_line()}`, beltarm {__version__} ({commit()}), {seconds:.0f} s.",
    ]
    return "\n\n".join(parts) + "\n"


def answer_table(study: PaperStudy) -> str:
    """Whether the standard move's ringing is removed, how much of it is left, and the answers of the alternatives."""
    rows = []
    for view in (AS_ANALYSED, FRICTION):
        usual, answers = study.standard(view), study.answers(view)
        left = [number(100 * usual.ratio(phase), 1) for phase in PHASES]
        rows.append([view, usual.answer, *left, *(str(answers[answer]) for answer in ANSWERS)])
    titles = [
        *("conditions", "removed?", "left in the cruise (%)", "after it (%)", f"last {END_WINDOW:g} s (%)"),
        *(f"alternatives: {ANSWERS[0]}", *ANSWERS[1:]),
    ]
    return markdown_table(titles, rows, "ll" + "r" * (len(titles) - 2))


def ringing_table(study: PaperStudy) -> str:
    """Ringing with its ratio to that without K4, velocities, tracking and torque of the moves at both ends."""
    titles = [
        *("move to", "conditions", "K4", "cruise (m/s²)", "after the stop (m/s²)", f"last {END_WINDOW:g} s (m/s²)"),
        *("ṙ p-p (m/s)", "ẏ p-p (m/s)", "motor error RMS (rad/s)", "of its cruising speed (%)"),
        *("peak torque (N m)", "stuck after the stop (%)"),
    ]
    rows = []
    for (place, view), scene in study.scenes.items():
        if place == TO_0 and scene.move == study.move:
            continue
        to, (without, suppressed) = degrees(scene.move.goal), scene.ringing
        plain = [number(getattr(without, phase)[0], 2) for phase in PHASES]
        shown = [f"{number(getattr(suppressed, p)[0], 2)} ({number(scene.ringing.ratio(p), 2)})" for p in PHASES]
        for k4, run, cells, stop in (
            ("0", scene.without, plain, without.stop[0]),
            (f"{study.gains.k4:g}", scene.suppressed, shown, suppressed.stop[0]),
        ):
            left = f" ({LEFT})" if np.isinf(stop) else ""
            rows.append([to, f"{view}{left}", k4, *cells, *_motion(run)])
    return markdown_table(titles, rows, "ll" + "r" * (len(titles) - 2))


def _motion(run: Response) -> list[str]:
    return [
        *(number(np.ptp(speed[-_LAST:]), 3) for speed in (run.radial_speed, run.lateral_speed)),
        number(run.motor_speed_error, 1),
        number(100 * run.motor_speed_error / run.cruising_speed, 1),
        number(run.peak_torque, 3),
        number(100 * run.stuck_share, 0),
    ]


def assumption_table(study: PaperStudy) -> str:
    """Ratios and answer for every alternative, around the standard move with friction and as analysed."""
    titles = ["assumption", "alternative"]
    for view in MAIN:
        titles += [f"{view}: ratio after the stop / last {END_WINDOW:g} s", "removed?"]
    rows = [["–", "standard move", *(cell for view in MAIN for cell in _cells(study.standard(view), ""))]]
    for assumption in study.assumptions:
        name = f"{assumption.name}: {assumption.chosen}"
        for alternative in assumption.alternatives:
            cells = []
            for view in MAIN:
                found, usual = study.found[view][alternative.label], study.standard(view).answer
                cells += _cells(found, usual) if study.differs(view, alternative.label) else ["same", usual]
            rows.append([name, alternative.label, *cells])
            name = ""
    return markdown_table(titles, rows, "llllll")


def _cells(found: Suppression, usual: str) -> list[str]:
    ratios = _left(found) or f"{number(found.ratio('stop'), 2)} / {number(found.ratio('end'), 2)}"
    return [ratios, f"**{found.answer}**" if usual and found.answer != usual else found.answer]


def _left(found: Suppression) -> str:
    """Whether the arm left its workspace, and whether it needs no vibration feedback for it."""
    if np.isinf(found.without.stop[0]):
        return f"{LEFT} with K4 = 0"
    return LEFT if np.isinf(found.suppressed.stop[0]) else ""


def random_table(study: PaperStudy) -> str:
    """Shares of the random moves on which K4 removes, reduces and increases ringing."""
    titles = ["conditions", "phase", "removed (%)", "reduced (%)", "increased (%)", "median ratio"]
    titles += [f"left the workspace, K4 = {k4:g}" for k4 in (0, study.gains.k4)]
    rows = []
    for view in BOTH_ARMS:
        left = [str(count) for count in study.count_left(view)]
        for phase, words in PHASES.items():
            found = study.shares(view, phase)
            cells = [number(100 * share, 0) for share in (found.removed, found.reduced, found.increased)]
            rows.append([view, words, *cells, LEFT if np.isinf(found.median) else number(found.median, 2), *left])
    return markdown_table(titles, rows, "ll" + "r" * (len(titles) - 2))
