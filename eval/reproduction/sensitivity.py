"""Whether the answer depends on what the paper leaves open: tables and sentences, all from the numbers."""

from __future__ import annotations

import numpy as np

from eval.reproduction.cases import Variant
from eval.reproduction.effects import CLEAR, GONE, Compared
from eval.reproduction.runs import PHASES
from eval.reproduction.study import AS_ANALYSED, MAIN, REAL, STANDARD, Study
from eval.reproduction.words import among, number, percent
from eval.style.markdown_table import markdown_table

_ANSWERS = ("yes", "in part", "no", "not comparable")


def answer(study: Study, view: str) -> str:
    """The answer on the standard move, and whether it is that of the other values tried; such as `yes on ...`."""
    usual, tried = study.standard(view).answer, study.tried(view)
    counts = []
    for other in _ANSWERS:
        count = sum(study.found[view][v.label].answer == other for v in tried)
        counts += [f"{other} with {count}"] if other != usual and count else []
    if not counts:
        return f"{usual}, on the standard move and with all {len(tried)} other values tried"
    return f"{usual} on the standard move, {' and '.join(counts)} of {len(tried)} other values tried"


def what_changes_it(study: Study, view: str) -> str:
    """Which values change the answer, and what is left with them."""
    usual, tried = study.standard(view), study.tried(view)
    by_answer = {word: [v for v in tried if study.found[view][v.label].answer == word] for word in _ANSWERS}
    told = []
    for word, variants in by_answer.items():
        if word == usual.answer or not variants:
            continue
        others = [v for v in tried if v not in variants]
        names = ([f"{v.label} ({_left(study.found[view][v.label])})" for v in some] for some in (variants, others))
        told.append(f"*{word}* with {among(*names, where=_where(study, variants, tried))}")
    if not told:
        return f"Assumptions, {view}: none of the values tried changes the answer, *{usual.answer}*."
    return f"Assumptions, {view}: *{usual.answer}* ({_left(usual)}) becomes {'; '.join(told)}."


def _where(study: Study, some: list[Variant], tried: list[Variant]) -> str:
    """How many of the values tried for each open question are among some of them."""
    counts = [
        (q.name, sum(v in some for v in q.variants), sum(v in tried for v in q.variants)) for q in study.questions
    ]
    return "; ".join(f"{name} {count} of {total}" for name, count, total in counts if count)


def _left(compared: Compared) -> str:
    return compared.left or percent(compared.ratio("end"))


def thresholds(study: Study) -> str:
    """That the bounds between the answers are a choice, and how close to one the standard move is."""
    usual = study.standard(AS_ANALYSED)
    close = (
        "close to the first: another choice would change the answer" if usual.answer_is_near else "far from the first"
    )
    left = usual.ratio("end")
    kept = f" As analysed the standard move keeps {number(100 * left, 1)} %, {close}." if np.isfinite(left) else ""
    return (
        f"*Yes* means that less than {percent(GONE)} of the ringing is left in {PHASES['end'].removeprefix('in ')}, "
        f"*in part* less than {percent(CLEAR)}. Both bounds are our choice; the paper names none.{kept}"
    )


def taken_table(study: Study) -> str:
    """What the paper prints, what is taken, and why."""
    rows = [[question.name, question.printed, question.taken, question.why] for question in study.questions]
    return markdown_table(["open", "the paper", "taken", "why"], rows, "llll")


def tried_table(study: Study) -> str:
    """Ratios and answer for every value tried, around the standard move with friction and as analysed."""
    ratios = "after the stop / last"
    titles = ["open", "tried", f"{REAL}: {ratios}", "answer", f"{AS_ANALYSED}: {ratios}", "answer"]
    rows = [["–", "standard move", *(cell for view in MAIN for cell in _cells(study.standard(view), ""))]]
    for question in study.questions:
        for k, variant in enumerate(question.variants):
            cells = []
            for view in MAIN:
                found, usual = study.found[view][variant.label], study.standard(view).answer
                cells += _cells(found, usual) if study.differs(view, variant.label) else ["same", usual]
            rows.append(["" if k else question.name, variant.label, *cells])
    return markdown_table(titles, rows, "llllll")


def _cells(found: Compared, usual: str) -> list[str]:
    ratios = found.left or f"{found.shown('stop')} / {found.shown('end')}"
    return [ratios, f"**{found.answer}**" if usual and found.answer != usual else found.answer]


def how_judged(study: Study) -> str:
    """What the table means."""
    scenes = (study.scenes[STANDARD, REAL], study.scenes[STANDARD, AS_ANALYSED])
    peak, peak_analysed = (number(max(s.without.peak_torque, s.suppressed.peak_torque), 3) for s in scenes)
    return (
        "Each assumption is changed alone, around the standard move with Table 1's friction and around the same as "
        f"analysed. Ratios are ringing with K4 = {study.gains.k4:g} over that with 0, after the stop and in "
        f"{PHASES['end'].removeprefix('in ')}; the latter gives the answer, in bold where it is not that of the "
        "standard move. *Same*: the value changes nothing, by construction or because it is not reached, and is not "
        f"counted. The standard move's torque peaks at {peak} N m with friction and {peak_analysed} N m as analysed: "
        "higher limits are never reached. Moves that are not feasible are left out. The controller knows the arm, "
        "except where a value is *taken for* another, and on the full arm."
    )
