"""What the page of the study names and counts, from the data alone."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from eval.report.text import poles_text
from eval.studies._effects import ALL, IDEAL, heading
from eval.studies.paper.runs import ANSWERS, AS_ANALYSED, BOTH_ARMS, FRICTION, MAIN, PHASES, STANDARD

Data = dict[str, Any]


def tables(data: Data) -> Data:
    """Scenes by conditions and place, alternatives by their label, answers and their number."""
    scenes: dict[str, Data] = {}
    for scene in data["scenes"]:
        scenes.setdefault(scene["view"], {})[scene["place"]] = scene
    standard = {row["view"]: row for row in data["drives"] if row["place"] == STANDARD}
    return {
        "counts": {view: counts(data, view) for view in MAIN},
        "scene": scenes,
        "tried": {row["label"]: row["views"] for row in data["alternatives"]},
        "chosen": {row["assumption"]: row["chosen"] for row in data["alternatives"]},
        "answers": ANSWERS,
        "phases": PHASES,
        "main": tuple(MAIN),
        "both_arms": tuple(BOTH_ARMS),
        "effect": heading,
        "pole_pairs": pole_pairs,
        "verdicts": [_verdict(standard[view]) for view in (AS_ANALYSED, FRICTION)],
    }


def pole_pairs(pairs: list[list[float]]) -> str:
    """Poles of the data as text."""
    return poles_text(np.array([complex(*pair) for pair in pairs]), 2)


def counts(data: Data, view: str) -> Counter[str]:
    """Number of alternatives with each answer, of those that change anything."""
    views = [row["views"][view] for row in data["alternatives"]]
    return Counter(row["answer"] for row in views if not row["same"])


def _verdict(row: Data) -> Data:
    """Whether K4 still suppresses the vibration of the standard move with all effects together."""
    by_name = {drive["drive"]: drive for drive in row["drives"]}
    ideal, driven = by_name[IDEAL], by_name[ALL]
    answers = {answer: driven["answers"].get(answer, 0) for answer in ANSWERS[:3]}
    draws, usual = sum(ideal["answers"].values()), max(ideal["answers"], key=ideal["answers"].get)
    reduced = answers["yes"] + answers["in part"]
    as_good = {"yes": answers["yes"], "in part": reduced}.get(usual)
    if as_good is None:
        survives = "nothing"
    elif 2 * as_good > draws:
        survives = "yes" if as_good == draws else "mostly"
    else:
        survives = "in part" if 2 * reduced > draws else "no"
    found = {"usual": usual, "answers": answers, "reduced": reduced, "survives": survives}
    return {"view": row["view"], "ideal": ideal, "driven": driven, **found}
