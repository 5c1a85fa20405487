"""Margins of loops behind the drive as it is built, and the condition that tuned gains have to meet."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from delays import late_arm

from baselines import CONTROLLERS, TUNABLE, PaperController
from baselines.engines.parallel import Channel
from baselines.gains import Gains, Tunable, tunable
from baselines.loops.condition import MarginCondition, believing, least_margins
from baselines.loops.laws import law_of
from baselines.loops.margins import Margins, margins
from baselines.loops.models import Loop, System, arms_at_angles, is_stable, law_system, loop_at, sampled_arm, stacked
from baselines.models.corners import CORNERS, LOOP_FIELDS, corner
from baselines.models.linear import ANGLES
from baselines.optimal.adaptive import AdaptiveController
from baselines.servo.pid import PidGains
from baselines.servo.retuned import RetunedController, RetunedGains
from baselines.servo.smooth import SmoothController
from baselines.tuning.race import MIN_BUDGET
from baselines.tuning.search import SearchProgress, search
from beltarm_env import ArmParams, sampled_state_space
from beltarm_env.task.ranges import TRAIN_RANGES, design_model

DESIGN = CORNERS["design model"]


def untuned(name: str) -> Any:
    """A controller with the gains that its tuning begins with."""
    kind = TUNABLE[name]
    return kind.controller(kind.gains())


def bears(controller: Any, k: int, params: ArmParams, samples: float) -> bool:
    """Whether the loop at `ANGLES[k]` is stable with that much more latency."""
    law = law_system(law_of(controller, k))
    return is_stable(Loop(law, late_arm(params, float(ANGLES[k]), samples)))


class TestAgainstLatency:
    """Poles of the loop with more latency, exactly sampled, against the delay margin, for any part of a sample."""

    @pytest.mark.parametrize("k", [0, 20, 45])
    @pytest.mark.parametrize("arm", ["design model", "stiff", "payload, soft"])
    @pytest.mark.parametrize("name", TUNABLE)
    def test_a_loop_bears_its_delay_margin_and_no_more(self, name: str, arm: str, k: int):
        found = margins(loop_at(untuned(name), k, CORNERS[arm]))
        assert found.stable
        for share in (0.0, 0.3, 0.6, 0.95):
            assert bears(untuned(name), k, CORNERS[arm], share * float(found.delay))
        assert not bears(untuned(name), k, CORNERS[arm], 1.05 * float(found.delay))

    @pytest.mark.parametrize("name", CONTROLLERS)
    def test_of_shipped_controllers_where_they_are_stable(self, name: str):
        controller = CONTROLLERS[name]()
        for params, k in itertools.product((ArmParams(), DESIGN), range(0, 46, 9)):
            found = margins(loop_at(controller, k, params))
            if found.stable:
                assert bears(controller, k, params, 0.95 * float(found.delay))
                assert not bears(controller, k, params, 1.05 * float(found.delay))


class TestAgainstTheResponse:
    """Margins from poles against the frequency response of law and arm, on a grid a hundred times as fine."""

    @pytest.mark.parametrize("arm", CORNERS)
    @pytest.mark.parametrize("name", ["retuned", "ei", "disturbance", "preview", "mpc", "adaptive"])
    def test_modulus_phase_and_delay(self, name: str, arm: str):
        loop = loop_at(untuned(name), 30, CORNERS[arm])
        found = margins(loop)
        turns = np.geomspace(1e-4, math.pi, 60_000)
        values = -self.response(loop.law, turns) * self.response(loop.arm, turns)
        assert found.modulus == pytest.approx(np.abs(1 + values).min(), rel=2e-3)
        excess, phases = np.abs(values) - 1, np.unwrap(np.angle(-values))
        crossed = np.flatnonzero(np.diff(np.sign(excess)))
        share = excess[crossed] / (excess[crossed] - excess[crossed + 1])
        lag, at = (part[crossed] + share * np.diff(part)[crossed] for part in (phases, turns))
        assert found.phase == pytest.approx(
            np.degrees(np.abs((lag + math.pi) % (2 * math.pi) - math.pi).min()), rel=2e-3
        )
        assert found.delay == pytest.approx((lag % (2 * math.pi) / at).min(), rel=2e-3)

    @staticmethod
    def response(system: System, turns: np.ndarray) -> np.ndarray:
        """The response at w T = turns [rad]: c (z - A)^-1 b + d, by the eigenvectors of A, which is made simple."""
        values, vectors = np.linalg.eig(system.a + 1e-9 * np.diag(np.arange(len(system.a))))
        parts = (system.c @ vectors) * np.linalg.solve(vectors, system.b.astype(complex))
        return (parts / (np.exp(1j * turns)[:, None] - values)).sum(axis=1) + system.d


def test_the_arm_of_a_loop_is_the_sampled_one_behind_its_drive():
    a, b, c = sampled_state_space(DESIGN, 0.6)
    arm = sampled_arm(DESIGN, 0.6)
    np.testing.assert_array_equal(arm.a, a)
    np.testing.assert_array_equal(arm.b, b[:, 0])
    np.testing.assert_array_equal(arm.c, c[0])


def test_many_loops_at_once_have_the_margins_of_each():
    controller, names = untuned("ei"), ("design model", "stiff", "payload, soft")
    laws = stacked([law_system(law_of(controller, k)) for k in range(46)])
    found = margins(Loop(laws, arms_at_angles([CORNERS[name] for name in names])))
    for (i, name), k in itertools.product(enumerate(names), (0, 17, 45)):
        alone = margins(loop_at(controller, k, CORNERS[name]))
        of_many = Margins(*(part[i, k] for part in found))
        np.testing.assert_allclose(np.array(alone, float), np.array(of_many, float), rtol=1e-6)


class TestCorners:
    def test_they_are_ends_of_the_training_ranges(self):
        assert CORNERS["design model"] == design_model()
        for name, arm in CORNERS.items():
            if name != "design model":
                assert all(getattr(arm, field) in TRAIN_RANGES[field] for field in LOOP_FIELDS)

    def test_no_other_constant_of_the_ranges_touches_the_loop(self):
        reference = sampled_state_space(DESIGN, 0.7)
        for field in set(TRAIN_RANGES) - set(LOOP_FIELDS):
            other = sampled_state_space(replace(DESIGN, **{field: TRAIN_RANGES[field][1]}), 0.7)
            for mine, theirs in zip(reference, other, strict=True):
                np.testing.assert_array_equal(mine, theirs)

    @pytest.mark.slow
    @pytest.mark.parametrize("name", ["ei", "disturbance", "preview"])
    def test_they_hold_nearly_the_worst_of_all_2048_corners(self, name: str):
        angles = (0, 12, 24, 36, 45)
        every = [
            corner(*itertools.compress(LOOP_FIELDS, high))
            for high in itertools.product((0, 1), repeat=len(LOOP_FIELDS))
        ]
        controller = untuned(name)
        laws = stacked([law_system(law_of(controller, k)) for k in angles])
        least = []
        for arms in (list(CORNERS.values()), every):
            plants = stacked([stacked([sampled_arm(arm, float(ANGLES[k])) for k in angles]) for arm in arms])
            found = margins(Loop(laws, plants))
            least.append((found.modulus.min(), found.delay.min()))
            assert found.stable.all()
        assert least[1][0] <= least[0][0] < least[1][0] + 0.08
        assert least[1][1] <= least[0][1] < 1.2 * least[1][1]

    def test_an_arm_that_is_identified_is_believed_in(self):
        controller = AdaptiveController()
        assert controller.params == design_model()
        for arm in CORNERS.values():
            believed = believing(controller, arm).params
            assert believed.motor_inertia == arm.motor_inertia
            assert believed.command_latency == arm.command_latency
            assert believed.current_loop_time_constant == arm.current_loop_time_constant
            mine, theirs = believed.plant(), arm.plant()
            swing = theirs.inertia_swing - mine.inertia_swing
            assert abs(swing) < 1e-12, "payload and swing are one"
            assert mine.stiffness == theirs.stiffness


class TestCondition:
    @pytest.mark.parametrize("name", TUNABLE)
    def test_untuned_gains_meet_it(self, name: str):
        assert MarginCondition().shortfall(untuned(name)) == 0

    @pytest.mark.parametrize("name", TUNABLE)
    def test_tuned_gains_meet_it(self, name: str):
        assert MarginCondition().shortfall(CONTROLLERS[name]()) == 0

    def test_the_noise_that_a_slow_motor_adds_to_a_filter_does_not_take_its_margins(self):
        gains, arm = CONTROLLERS["adaptive"]().gains, design_model()
        most = gains.torque_noise + arm.static_friction_excess * arm.coulomb_friction / math.sqrt(3)
        assert MarginCondition().shortfall(AdaptiveController(replace(gains, torque_noise=most))) == 0

    @pytest.mark.parametrize("name", ["preview", "lqg", "mpc"])
    def test_cheap_torque_and_a_fast_filter_do_not(self, name: str):
        gains = replace(TUNABLE[name].gains(), torque_weight=0.1, change_weight=0.01, acceleration_noise=100.0)
        assert MarginCondition().shortfall(TUNABLE[name].controller(gains)) > 0.5

    def test_a_tame_pid_does_and_a_wild_one_does_not(self):
        condition = MarginCondition()
        tame = TUNABLE["smooth"].controller(replace(TUNABLE["smooth"].gains(), angle=300.0, speed=80.0))
        assert condition.shortfall(tame) == 0
        assert least_margins(tame).modulus > 0.5
        wild = [replace(TUNABLE["smooth"].gains(), angle=angle, speed=250.0) for angle in (10_000.0, 40_000.0)]
        shortfalls = [condition.shortfall(TUNABLE["smooth"].controller(gains)) for gains in wild]
        assert 0.5 < shortfalls[0] < shortfalls[1] < 2

    def test_shortfall_grows_steadily_into_instability(self):
        stiffer = [replace(PidGains(), speed=speed) for speed in np.geomspace(150, 600, 12)]
        found = [MarginCondition().shortfall(Steady(gains)) for gains in stiffer]
        assert found[0] < 0.3 and found[-1] > 1
        assert all(0 <= step < 0.5 for step in np.diff(found))

    def test_what_is_asked_for_is_what_is_met(self):
        least = least_margins(untuned("ei"))
        assert MarginCondition(modulus=least.modulus * 0.999, delay=0.1).shortfall(untuned("ei")) == 0
        assert MarginCondition(modulus=least.modulus * 1.01, delay=0.1).shortfall(untuned("ei")) > 0
        assert MarginCondition(modulus=0.1, delay=least.delay * 1.01).shortfall(untuned("ei")) > 0

    def test_the_worst_place_is_named(self):
        controller = untuned("disturbance")
        least = least_margins(controller)
        name, degrees = least.modulus_at.rsplit(", ", 1)
        k = round(int(degrees.rstrip("°")) / 2)
        assert margins(loop_at(controller, k, CORNERS[name])).modulus == pytest.approx(least.modulus, rel=1e-6)


class Steady(SmoothController):
    """A PID with gains of any size."""

    def __init__(self, gains: Any) -> None:
        super().__init__()
        self.gains = self._gains = gains


@dataclass(frozen=True)
class TwoGains(Gains):
    angle: float = tunable(60.0, 10.0, 10_000.0, log=True)
    torsion_speed: float = tunable(0.001, 1e-4, 0.2, log=True)


class Watched(RetunedController):
    """The retuned controller with two gains free, keeping the margins of all that is simulated."""

    simulated: list[float] = []  # noqa: RUF012

    def __init__(self, gains: TwoGains) -> None:
        super().__init__(RetunedGains(angle=gains.angle, torsion_speed=gains.torsion_speed, speed=30.0))

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        if state is None:
            Watched.simulated.append(MarginCondition().shortfall(self))
        return super().predict(observation, state, episode_start, deterministic)


class TestTuner:
    @pytest.mark.slow
    def test_nothing_that_falls_short_is_simulated(self, tmp_path: Path):
        Watched.simulated.clear()
        told: list[SearchProgress] = []
        kind, condition = Tunable(Watched, TwoGains), MarginCondition()
        found = search(kind, 3 * MIN_BUDGET, 0, tmp_path / "journal", Channel(told.append), condition)
        assert found.refused > 0
        assert set(Watched.simulated) == {0.0}
        assert condition.shortfall(Watched(TwoGains(**found.gains))) == 0
        assert told[-1].trials == found.trials and told[-1].steps == found.steps
        assert any(before.steps == after.steps for before, after in itertools.pairwise(told))  # a refusal costs none

    def test_an_interrupted_search_goes_on(self, tmp_path: Path):
        class Enough(Exception):  # noqa: N818
            pass

        def interrupt(_: SearchProgress) -> None:
            nonlocal calls
            calls += 1
            if calls == 12:
                raise Enough

        calls, condition, kind = 0, MarginCondition(), Tunable(Watched, TwoGains)
        journal = tmp_path / "journal"
        with pytest.raises(Enough):
            search(kind, 2 * MIN_BUDGET, 0, journal, Channel(interrupt), condition)
        found = search(kind, 2 * MIN_BUDGET, 0, journal, condition=condition)
        assert found.refused > 0 and found.steps <= 2 * MIN_BUDGET
        assert condition.shortfall(Watched(TwoGains(**found.gains))) == 0
        assert search(kind, 2 * MIN_BUDGET, 0, journal, condition=condition) == found
        for other in (None, MarginCondition(modulus=0.3)):
            with pytest.raises(ValueError, match="started with another seed, other margins or other ranges"):
                search(kind, 2 * MIN_BUDGET, 0, journal, condition=other)

    def test_the_number_of_refusals_is_bounded(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr("baselines.tuning.search.MAX_REFUSED", 3)
        found = search(Tunable(Watched, TwoGains), 4 * MIN_BUDGET, 0, tmp_path / "j", condition=MarginCondition())
        assert found.refused == 3 and found.trials < 20

    def test_without_the_condition_nothing_is_refused(self, tmp_path: Path):
        found = search(Tunable(Watched, TwoGains), MIN_BUDGET, 0, tmp_path / "journal")
        assert found.refused == 0

    def test_untuned_gains_that_fall_short_are_an_error(self, tmp_path: Path):
        @dataclass(frozen=True)
        class Wild(TwoGains):
            torsion_speed: float = tunable(0.1, 1e-4, 0.2, log=True)

        with pytest.raises(ValueError, match=r"untuned gains fall short .*modulus=0.0.* change the defaults of Wild"):
            search(Tunable(Watched, Wild), MIN_BUDGET, 0, tmp_path / "journal", condition=MarginCondition())

    def test_a_controller_without_a_law_is_an_error_that_names_both_ways_out(self, tmp_path: Path):
        class Unknown:
            def __init__(self, gains: TwoGains) -> None:
                self.predict = PaperController().predict

        kind: Any = Tunable(Unknown, TwoGains)  # pyright: ignore[reportArgumentType]
        with pytest.raises(ValueError, match=r"no linear law for Unknown: add one to LAWS .*--no-margins"):
            search(kind, MIN_BUDGET, 0, tmp_path / "journal", condition=MarginCondition())
