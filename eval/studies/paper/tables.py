"""Tables of the study, and numbers for the sentences of its page, from the data alone."""

from __future__ import annotations

from collections import Counter
from math import nan
from typing import Any

import numpy as np

from eval.report.text import degrees, markdown_table, poles_text
from eval.studies._effects import ALL, IDEAL, heading
from eval.studies._frame import percent, shown
from eval.studies.paper.runs import ANSWERS, AS_ANALYSED, BOTH_ARMS, FRICTION, MAIN, PHASES, STANDARD

Data = dict[str, Any]
LEFT = "the arm left its workspace"
_ANSWERED = ANSWERS[:3]


def tables(data: Data) -> Data:
    """Tables, and what the sentences need by conditions and place."""
    scenes: dict[str, Data] = {}
    for scene in data["scenes"]:
        scenes.setdefault(scene["view"], {})[scene["place"]] = scene
    standard = {row["view"]: row for row in data["drives"] if row["place"] == STANDARD}
    return {
        "answers": _answers(data, scenes),
        "counts": {view: counts(data, view) for view in MAIN},
        "scene": scenes,
        "tried": {row["label"]: row["views"] for row in data["alternatives"]},
        "chosen": {row["assumption"]: row["chosen"] for row in data["alternatives"]},
        "ringing": _ringing(data),
        "pole_pairs": pole_pairs,
        "assumptions": _assumptions(data, scenes),
        "random": _random(data),
        "drives": {_title(row): _drives(data, row) for row in data["drives"]},
        "verdicts": [_verdict(standard[view]) for view in (AS_ANALYSED, FRICTION)],
    }


def pole_pairs(pairs: list[list[float]]) -> str:
    """Poles of the data as text."""
    return poles_text(np.array([complex(*pair) for pair in pairs]), 2)


def counts(data: Data, view: str) -> Counter[str]:
    """Number of alternatives with each answer, of those that change anything."""
    views = [row["views"][view] for row in data["alternatives"]]
    return Counter(row["answer"] for row in views if not row["same"])


def _window(data: Data) -> str:
    return f"last {data['bounds']['window']:g} s"


def _answers(data: Data, scenes: Data) -> str:
    """Whether the standard move's ringing is removed, how much of it is left, and the answers of the alternatives."""
    rows = []
    for view in (AS_ANALYSED, FRICTION):
        usual, others = scenes[view][STANDARD], counts(data, view)
        left = [percent(ratio, 1) for ratio in usual["ratios"].values()]
        rows.append([view, usual["answer"], *left, *(str(others[answer]) for answer in ANSWERS)])
    titles = ["conditions", "removed?", "left in the cruise (%)", "after it (%)", f"{_window(data)} (%)"]
    titles += [f"alternatives: {ANSWERS[0]}", *ANSWERS[1:]]
    return markdown_table(titles, rows, "ll" + "r" * (len(titles) - 2))


def _ringing(data: Data) -> str:
    """Ringing with its ratio to that without K4, tracking and torque of the moves at both ends."""
    titles = ["move to", "conditions", "K4", "cruise (m/s²)", "after the stop (m/s²)", f"{_window(data)} (m/s²)"]
    titles += ["motor error RMS (rad/s)", "of its cruising speed (%)", "peak torque (N m)", "stuck after the stop (%)"]
    rows = []
    for scene in data["scenes"]:
        for k, (k4, phases) in enumerate(zip((0, data["gains"]["k4"]), scene["phases"], strict=True)):
            ratios = {phase: f" ({shown(scene['ratios'][phase], 2)})" if k else "" for phase in PHASES}
            view = f"{scene['view']} ({LEFT})" if scene["left"][k] else scene["view"]
            cells = [f"{shown(phases[phase], 2)}{ratios[phase]}" for phase in PHASES]
            rows.append([degrees(scene["move"]["goal"]), view, f"{k4:g}", *cells, *_motion(scene["motions"][k])])
    return markdown_table(titles, rows, "ll" + "r" * (len(titles) - 2))


def _motion(run: Data) -> list[str]:
    error = run["motor_speed_error"]
    tracking = [shown(error, 1), percent(error and error / run["cruising_speed"], 1)]
    return [*tracking, shown(run["peak_torque"], 3), percent(run["stuck_share"])]


def _assumptions(data: Data, scenes: Data) -> str:
    """Ratios and answer for every alternative, around the standard move with friction and as analysed."""
    titles = ["assumption", "alternative"]
    for view in MAIN:
        titles += [f"{view}: ratio after the stop / {_window(data)}", "removed?"]
    usual = {view: scenes[view][STANDARD] for view in MAIN}
    rows = [["–", "standard move", *(cell for view in MAIN for cell in _tried(usual[view], ""))]]
    before = ""
    for row in data["alternatives"]:
        name = f"{row['assumption']}: {row['chosen']}"
        cells = [cell for view in MAIN for cell in _tried(row["views"][view], usual[view]["answer"])]
        rows.append(["" if name == before else name, row["label"], *cells])
        before = name
    return markdown_table(titles, rows, "llllll")


def _tried(row: Data, usual: str) -> list[str]:
    """Ratios and answer, in bold where it is not the usual one."""
    if row.get("same"):
        return ["same", usual]
    ratios = " / ".join(shown(row["ratios"][phase], 2) for phase in ("stop", "end"))
    if any(row["left"]):
        ratios = f"{LEFT} with K4 = 0" if row["left"][0] else LEFT
    return [ratios, f"**{row['answer']}**" if usual and row["answer"] != usual else row["answer"]]


def _random(data: Data) -> str:
    """Shares of the random moves on which K4 removes, reduces and increases ringing."""
    titles = ["conditions", "phase", "removed (%)", "reduced (%)", "increased (%)", "median ratio"]
    titles += [f"left the workspace, K4 = {k4:g}" for k4 in (0, data["gains"]["k4"])]
    rows = []
    for view in BOTH_ARMS:
        row = data["random"][view]
        for phase, words in PHASES.items():
            own = row["phases"][phase]
            median = LEFT if own["median_left"] else shown(own["median"], 2)
            shares = [percent(own[key]) for key in ("removed", "reduced", "increased")]
            rows.append([view, words, *shares, median, *map(str, row["left"])])
    return markdown_table(titles, rows, "ll" + "r" * (len(titles) - 2))


def _title(row: Data) -> str:
    place = "Standard move" if row["place"] == STANDARD else "Move"
    return f"{place}, {degrees(row['move']['start'])} to {degrees(row['move']['goal'])}, {row['view']}"


def _drives(data: Data, row: Data) -> str:
    """Ringing without and with K4, ratios and answers, for every drive."""
    titles = ["drive", "ringing after the stop, K4 = 0 (m/s²)", f"K4 = {data['gains']['k4']:g}", "ratio"]
    titles += [f"ratio, {_window(data)}", *(f"removed? {answer}" for answer in _ANSWERED)]
    rows = []
    for drive in row["drives"]:
        ringing = [*(shown(value, 2) for value in drive["ringing"]), _spread(drive["stop"]), _spread(drive["end"])]
        answers = [str(drive["answers"].get(answer, 0)) for answer in _ANSWERED]
        rows.append([heading(drive["drive"]), *ringing, *answers])
    return markdown_table(titles, rows)


def _spread(ratios: list[float | None]) -> str:
    """Median, with the smallest and the largest where they differ."""
    if not ratios:
        return "–"
    middle, low, high = (shown(value, 2) for value in ratios)
    return middle if low == high else f"{middle} [{low}, {high}]"


def _left(drive: Data) -> float:
    """Share of the ringing that is left at the end, in the median [%]."""
    return nan if not drive["end"] or drive["end"][0] is None else 100 * drive["end"][0]


def _verdict(row: Data) -> Data:
    """Whether K4 still suppresses the vibration of the standard move with all effects, and by how much."""
    by_name = {drive["drive"]: drive for drive in row["drives"]}
    ideal, driven = by_name[IDEAL], by_name[ALL]
    answers = {answer: driven["answers"].get(answer, 0) for answer in _ANSWERED}
    draws, usual = sum(ideal["answers"].values()), max(ideal["answers"], key=ideal["answers"].get)
    reduced = answers["yes"] + answers["in part"]
    as_good = {"yes": answers["yes"], "in part": reduced}.get(usual)
    if as_good is None:
        survives = "nothing"
    elif 2 * as_good > draws:
        survives = "yes" if as_good == draws else "mostly"
    else:
        survives = "in part" if 2 * reduced > draws else "no"
    left = {"left": _left(driven), "left_ideal": _left(ideal)}
    return {"view": row["view"], "usual": usual, "answers": answers, "reduced": reduced, "survives": survives, **left}
