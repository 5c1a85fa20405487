"""The paper's servo on the drive as it is built as a page, `drive.md`."""

from __future__ import annotations

import numpy as np

from baselines.tools.provenance import command_line, commit
from beltarm_env import __version__
from beltarm_env.arrays import Floats
from beltarm_env.task.seeds import PAPER_DRIVES
from eval.comparison.effects import ALL, IDEAL, heading
from eval.report.text import degrees, markdown_table, number
from eval.reproduction.drives import DRIVES, Damped, DrivesStudy
from eval.reproduction.ringing import ANSWERS, END_WINDOW, REDUCED, REMOVED, Answer
from eval.reproduction.study import AS_ANALYSED, FRICTION, MAIN, STANDARD

PICTURES = ("drive.png", "drive_ratios.png")
_SHOWN_ANSWERS = ANSWERS[:3]


def drive_markdown(study: DrivesStudy) -> str:
    """The content of `drive.md`."""
    last = PAPER_DRIVES.first + study.draws - 1
    parts = [
        "# The paper's conclusion on a drive that is not ideal",
        f"The paper's servo with K4 = 0 and with K4 = {study.gains.k4:g} N m s/rad on the paper's arm, whose drive has "
        "each effect of [the drive as it is built](../physics.md) alone, and all of them, at the upper ends of the "
        "training ranges. The servo goes on taking the drive for ideal. Phases, orders, Stribeck speeds and the signs "
        f"of the torque constant's error and of the drift are drawn: {study.draws} drives of each kind (seeds "
        f"{PAPER_DRIVES.first} to {last}).",
        "## Does the conclusion survive?",
        verdict(study),
        "\n".join(f"- {summary(study, place, view)}" for place in study.moves for view in MAIN),
        f"![Velocity of the tip on the ideal drive and with all effects, K4 off and on]({PICTURES[0]})",
        f"*Standard move, with friction. Every line is one of the {study.draws} drives.*",
        f"![Ringing with K4 over that without, by effect]({PICTURES[1]})",
        "*Standard move: every mark is a drive; dotted: the bounds of the answers.*",
    ]
    for place in study.moves:
        for view in MAIN:
            parts += [f"## {_name(study, place)}, {view}", drives_table(study, place, view)]
    parts += [
        "Medians over the drives, in brackets the smallest and the largest ratio. *Ringing* is the RMS error of "
        f"the tip's acceleration; the answers are those of the ringing in the last {END_WINDOW:g} s, as in "
        f"[tables.md](tables.md): yes below {REMOVED:g}, in part below {REDUCED:g}. *Peak-to-peak* is the motion of "
        "the tip after the stop, less its straight-line trend: it has the position loop's slow return in it as well, "
        "which is no vibration. As analysed there is no Coulomb friction, and so nothing that breakaway and friction "
        "over the turn could change.",
        f"`{command_line()}`, beltarm {__version__} ({commit()}).",
    ]
    return "\n\n".join(parts) + "\n"


def verdict(study: DrivesStudy) -> str:
    """Whether K4 still suppresses the vibration of the standard move with all effects, and by how much."""
    sentences = []
    for view in (FRICTION, AS_ANALYSED):
        ideal, driven = (study.found[STANDARD, view, drive] for drive in (IDEAL, ALL))
        (answer, _), reduced = ideal.answers.most_common(1)[0], driven.answers["yes"] + driven.answers["in part"]
        counts = ", ".join(f"*{one}* on {driven.answers[one]}" for one in _SHOWN_ANSWERS)
        sentences.append(
            f"**{view[0].upper()}{view[1:]}, {_words(driven, answer, study.draws)}.** The answer whether K4 removes "
            f"the ringing of the standard move is *{answer}* on the ideal drive; with all effects together it is "
            f"{counts} of {study.draws} drives, so that K4 reduces the ringing on {reduced}. In the last "
            f"{END_WINDOW:g} s {_percent(driven)} % of it are left in the median, against {_percent(ideal)} % on the "
            "ideal drive."
        )
    return "\n\n".join(sentences)


def _words(driven: Damped, ideal: Answer, draws: int) -> str:
    if ideal == "no":
        return "there is no conclusion that could survive"
    better = sum(driven.answers[one] for one in _SHOWN_ANSWERS[: _SHOWN_ANSWERS.index(ideal) + 1])
    if 2 * better > draws:
        return "the conclusion survives" if better == draws else "the conclusion survives on most drives"
    reduced = driven.answers["yes"] + driven.answers["in part"]
    return "the conclusion survives in part only" if 2 * reduced > draws else "the conclusion does not survive"


def summary(study: DrivesStudy, place: str, view: str) -> str:
    """The effects that leave the least and the most of the ringing in the last 0.3 s, for one move."""
    single = [drive for drive in DRIVES if drive not in (IDEAL, ALL)]
    left = {drive: float(np.nanmedian(study.found[place, view, drive].ringing.ratios("end"))) for drive in DRIVES}
    worst, best = max(single, key=lambda drive: left[drive]), min(single, key=lambda drive: left[drive])
    return (
        f"{_name(study, place)}, {view}: {100 * left[IDEAL]:.0f} % of the ringing are left on the ideal drive, "
        f"{100 * left[ALL]:.0f} % with all effects. By itself, {heading(worst)} leaves the most, "
        f"{100 * left[worst]:.0f} %, and {heading(best)} the least, {100 * left[best]:.0f} %."
    )


def drives_table(study: DrivesStudy, place: str, view: str) -> str:
    """Peak-to-peak motion and ringing without and with K4, ratios and answers, for every drive."""
    titles = [
        *("drive", "p-p, K4 = 0 (mm)", f"K4 = {study.gains.k4:g}", "ratio"),
        *(
            "ringing after the stop, K4 = 0 (m/s²)",
            f"K4 = {study.gains.k4:g}",
            "ratio",
            f"ratio, last {END_WINDOW:g} s",
        ),
        *(f"removed? {answer}" for answer in _SHOWN_ANSWERS),
    ]
    rows = []
    for drive in DRIVES:
        found = study.found[place, view, drive]
        rows.append(
            [
                *(heading(drive), _median(found.without, 1), _median(found.suppressed, 1), _spread(found.ratios)),
                *(_median(found.ringing.without.stop, 2), _median(found.ringing.suppressed.stop, 2)),
                *(_spread(found.ringing.ratios(phase)) for phase in ("stop", "end")),
                *(str(found.answers[answer]) for answer in _SHOWN_ANSWERS),
            ]
        )
    return markdown_table(titles, rows)


def _name(study: DrivesStudy, place: str) -> str:
    start, goal = study.moves[place][:2]
    return f"{'Standard move' if place == STANDARD else 'Move'}, {degrees(start)} to {degrees(goal)}"


def _percent(found: Damped) -> str:
    return number(100 * np.nanmedian(found.ringing.ratios("end")), 0)


def _median(values: Floats, digits: int) -> str:
    return number(np.median(values), digits)


def _spread(ratios: Floats) -> str:
    """Median, with the smallest and the largest where they differ; without drives that have nothing to compare."""
    ratios = ratios[~np.isnan(ratios)]
    if not len(ratios):
        return "–"
    middle, low, high = (number(value, 2) for value in (np.median(ratios), ratios.min(), ratios.max()))
    return middle if low == high else f"{middle} [{low}, {high}]"
