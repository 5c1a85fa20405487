"""Training algorithms by name: the options of their scripts, and the learners that these make."""

from __future__ import annotations

from typing import NamedTuple

from agents.learners import ppo, recurrent_ppo, rma, sac, student
from agents.runs.monitor import Maker
from agents.runs.settings import RunConfig


class Algorithm(NamedTuple):
    """An algorithm of `train/`."""

    config: type[RunConfig]
    make_learner: Maker


ALGORITHMS = {
    "ppo": Algorithm(ppo.PpoConfig, ppo.make_learner),
    "recurrent_ppo": Algorithm(recurrent_ppo.RecurrentPpoConfig, recurrent_ppo.make_learner),
    "sac": Algorithm(sac.SacConfig, sac.make_learner),
    "rma": Algorithm(rma.RmaConfig, rma.make_learner),
    "student": Algorithm(student.StudentConfig, student.make_learner),
}
