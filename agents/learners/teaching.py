"""Labels for imitation: the torques of a practised teacher beside its student."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch

from agents.residual.controller import ResidualController, ResidualMemory
from baselines.iterative.controller import IterativeController
from baselines.iterative.lesson import Lesson, Notes
from beltarm_env.arrays import Flags, Singles
from beltarm_env.rollout import Controller, Recording

Trial = Callable[[Controller], Recording]
"""Runs a controller for an episode: every time on the same arms, with the same moves."""


class Pairs(NamedTuple):
    """Observations of a student, and the residuals that its teacher would choose."""

    inputs: torch.Tensor  # shape (pairs, inputs)
    labels: torch.Tensor  # shape (pairs, 1)


def practise(trial: Trial, repetitions: int) -> tuple[Lesson, Recording]:
    """Let a teacher practise, at least once; returns what it has learnt and the last trial."""
    lesson, recording = None, None
    for _ in range(repetitions):
        teacher = IterativeController(lesson)
        notes = Notes(teacher)
        recording = trial(notes)
        lesson = teacher.learned(notes)
    assert lesson is not None and recording is not None, "a lesson takes a repetition"
    return lesson, recording


def ask(trial: Trial, student: ResidualController, lesson: Lesson) -> tuple[Pairs, Recording]:
    """Run a student on the moves of a lesson, and label every state with the teacher's torque.

    Returns:
        The pairs, of arms that have not left their workspace, and the student's trial.
    """
    advised = Advised(student, lesson)
    recording = trial(advised)
    return advised.pairs(), recording


class Advised:
    """Student with its teacher beside it for one trial; as a `Controller`, the student.

    Args:
        student: Whose torques are applied.
        lesson: Of the teacher, about the student's arms and moves.
    """

    def __init__(self, student: ResidualController, lesson: Lesson) -> None:
        self.student = student
        assert lesson.law is not None, "a teacher that learns the torque"
        self._teacher = IterativeController(lesson)
        self._holds = lesson.law.holds
        self._left = np.zeros(len(lesson.moves), np.bool_)
        self._inputs: list[Singles] = []
        self._running: list[Flags] = []
        self._advice: list[Singles] = []

    def predict(
        self,
        observation: Singles,
        state: tuple[ResidualMemory, Any] | None = None,
        episode_start: Flags | None = None,
        deterministic: bool = True,
    ) -> tuple[Singles, tuple[ResidualMemory, Any]]:
        """Call the student's `predict`, and note the teacher's torque."""
        before, taught = state or (None, None)
        action, own = self.student.predict(observation, before, episode_start, deterministic)
        advice, taught = self._teacher.predict(observation, taught, episode_start)
        assert own.informed is not None
        step = len(self._advice)
        if step > 0 and episode_start is not None:
            self._left |= episode_start
        if step % self.student.settings.hold == 0:
            self._inputs.append(self.student.informed.seen(observation, own.informed))
        self._running.append(~self._left)
        self._advice.append((advice - own.informed.action) * self._holds[:, step, None])
        return action, (own, taught)

    def pairs(self) -> Pairs:
        """Inputs and labels of the trial, in order of time."""
        hold, limit = self.student.settings.hold, self.student.settings.limit
        spans = [slice(k, k + hold) for k in range(0, len(self._advice), hold)]
        running = np.concatenate([np.all(self._running[span], axis=0) for span in spans])
        advice = np.concatenate([np.mean(self._advice[span], axis=0) for span in spans])
        labels = (advice / limit).clip(-1, 1).astype(np.float32)
        return Pairs(torch.from_numpy(np.concatenate(self._inputs)[running]), torch.from_numpy(labels[running]))
