"""Metrics of episodes on signals whose values are known, and recordings as users look at them."""

import json
import math
import os
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import beltarm_env.recording
from baselines import CONTROLLERS
from beltarm_env import CONTROL_PERIOD, EPISODE_STEPS, ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.metrics import METRICS, SETTLING_BAND, SHOWN, TORQUES, Episodes, episode_metrics
from beltarm_env.rollout import Recording, rollout
from beltarm_env.task.moves import SHORTEST, WORKSPACE

DURATION = 0.9  # of the move [s]: the last row of it is 599
TIME: Floats = np.arange(1.0, EPISODE_STEPS + 1) * np.float64(CONTROL_PERIOD)
BEFORE = TIME < DURATION - 1e-9
NEVER = EPISODE_STEPS * CONTROL_PERIOD
ROWS = np.arange(EPISODE_STEPS)
RADIAL, LATERAL = "residual_radial_pp_mm", "residual_lateral_pp_mm"
JUMP = 0.2 / CONTROL_PERIOD / math.sqrt(1200)


def evaluate(**signals: Any) -> dict[str, float]:
    """Metrics of one episode with the given signals, all others zero; those of shape (T,) are radial."""
    given_signals: dict[str, Any] = {
        **{"tip_error": np.zeros((EPISODE_STEPS, 2)), "tip_velocity_error": np.zeros((EPISODE_STEPS, 2))},
        **{"torque": np.zeros(EPISODE_STEPS), "torque_limit": 0.3, "move_duration": DURATION},
        **{"cost": 0.0, "finished": True},
        **signals,
    }
    columns = [np.asarray(value, np.float64) for value in given_signals.values()]
    columns[:2] = [np.column_stack([c, np.zeros(EPISODE_STEPS)]) if c.ndim == 1 else c for c in columns[:2]]
    arms: Any = [column[:, None] for column in columns[:3]] + [column[None] for column in columns[3:]]
    metrics = episode_metrics(Episodes(*arms[:-1], arms[-1].astype(np.bool_)))  # pyright: ignore[reportCallIssue]
    assert list(metrics) == list(METRICS)
    assert all(value.shape == (1,) for value in metrics.values())
    return {name: float(value[0]) for name, value in metrics.items()}


def ringing(amplitude: float) -> Floats:
    """A cosine after the move that its straight-line trend leaves as it is, since it is even about the middle."""
    return np.where(BEFORE, 0.0, amplitude * np.cos(2 * np.pi * (ROWS - 899) / 40))


def both(radial: Floats, lateral: Floats) -> Floats:
    return np.column_stack([radial, lateral])


def held(value: float) -> Floats:
    return np.full(EPISODE_STEPS, value)


CURVED = 0.004 * np.clip((TIME - DURATION) / (TIME[-1] - DURATION), 0, None) ** 2
LEFT = np.where(ROWS == 1199, 0.0011, 0.0)
SINE = 0.2 * np.sin(20 * np.pi / 1199 * ROWS)
PULSE = np.where(ROWS[:, None] < 300, [0.0, 0.008], 0.0)
CORNERS = np.where(ROWS[:, None] == 10, [0.006, 0.0], np.where(ROWS[:, None] == 20, [0.005, 0.005], 0.0))
LIMITED = np.select([ROWS < 60, ROWS < 120, ROWS < 150], [0.3, -0.3, 0.3 * np.float32(0.99999994)], 0.999 * 0.3)


@pytest.mark.parametrize(
    ("signals", "expected"),
    [
        ({}, {name: CONTROL_PERIOD if name == "settling_s" else 0.0 for name in METRICS}),
        ({"tip_error": both(held(0.003), held(-0.004))}, {"tip_rms_mm": 5, "tip_max_mm": 5, "residual_pp_mm": 0}),
        ({"tip_error": PULSE}, {"tip_rms_mm": 4, "tip_max_mm": 8}),  # for a quarter of the time
        ({"tip_error": CORNERS}, {"tip_max_mm": 5 * math.sqrt(2)}),  # the distance, not a coordinate
        # An arm arrives if the mean of its error after the move, in each axis, is within a bound.
        ({"tip_error": both(held(0.0105), held(-0.0105))}, {"not_arrived_share": 0}),
        ({"tip_error": both(held(0.0107), held(-0.0107))}, {"not_arrived_share": 1}),
        ({"tip_error": ringing(0.03)}, {"not_arrived_share": 0}),
        ({"tip_error": np.where(BEFORE, 0.2, 0.0)}, {"not_arrived_share": 0, "residual_pp_mm": 0}),
        ({"finished": False}, {"not_arrived_share": 1, "settling_s": NEVER, "failure_share": 1}),
        ({"tip_error": both(ringing(0.003), ringing(-0.004))}, {RADIAL: 6, LATERAL: 8, "residual_pp_mm": 10}),
        ({"tip_error": both(ringing(0.002) + 0.02 - 0.01 * TIME, 0.005 * TIME)}, {RADIAL: 4, LATERAL: 0}),
        # Of s^2 over 0 <= s <= 1 the line s - 1/6 is taken away; s^2 - s + 1/6 runs from -1/12 to 1/6.
        ({"tip_error": CURVED}, {"residual_pp_mm": 1}),
        *(({"tip_error": np.where(row == ROWS, 0.001, 0.0)}, {"residual_pp_mm": 1}) for row in (600, 601, 1199)),
        ({"tip_error": np.where(ROWS == 700, -0.002, 0.0)}, {"settling_s": 702 * CONTROL_PERIOD}),
        ({"tip_error": both(held(0.001), held(-0.001))}, {"settling_s": CONTROL_PERIOD}),  # not their distance
        ({"tip_error": both(held(0.0), LEFT)}, {"settling_s": NEVER, "failure_share": 1}),
        ({"tip_error": np.where(ROWS == 1000, 0.0006, 0.0)}, {"still_s": 1002 * CONTROL_PERIOD - DURATION}),
        ({"tip_error": both(held(0.0004), held(0.0004))}, {"still_s": NEVER - DURATION}),  # their distance
        ({"tip_error": both(held(0.0), LEFT)}, {"still_s": NEVER - DURATION}),
        ({"tip_error": np.where(BEFORE, 0.2, held(0.0003))}, {"still_s": 0}),
        ({"torque": np.where(ROWS < 900, 0.0, 0.1 * (-1.0) ** ROWS)}, {"torque_rms": 0.05}),
        ({"torque": 0.15 * TIME}, {"torque_rate_rms": 0.15}),
        # One change of 0.2 N m among 1200; the motor is without torque before the episode.
        *(({"torque": np.where(row <= ROWS, 0.2, 0.0)}, {"torque_rate_rms": JUMP}) for row in (0, 500)),
        ({"torque": LIMITED}, {"saturated_share": 0.125}),  # the largest float32 below 1 is at the limit
        ({"torque": held(0.2), "torque_limit": 0.25}, {"saturated_share": 0}),
        ({"torque": held(0.2), "torque_limit": 0.2}, {"saturated_share": 1}),
        # v = V sin(w t), ten whole periods in 1199 differences: the acceleration's RMS is V w / sqrt(2).
        ({"tip_velocity_error": SINE}, {"tip_acc_rms": 0.2 * 20 * np.pi / 1199 / CONTROL_PERIOD / math.sqrt(2)}),
        ({"tip_velocity_error": both(0.3 * TIME, 1.0 - 0.4 * TIME)}, {"tip_acc_rms": 0.5}),
        ({"tip_velocity_error": held(0.5), "cost": 123.5}, {"tip_acc_rms": 0, "cost": 123.5}),
    ],
)
def test_of_signals_whose_values_are_known(signals: dict[str, Any], expected: dict[str, float]):
    metrics = evaluate(**signals)
    assert {name: metrics[name] for name in expected} == pytest.approx(expected, rel=0.01, abs=1e-9)


def test_the_band_is_a_millimetre_and_metrics_of_torques_are_shown():
    assert SETTLING_BAND == 0.001 and set(TORQUES) <= set(SHOWN)


@pytest.mark.parametrize(
    ("torque", "count"),
    [
        ([0.0, 0.2, 0.3, 0.2, 0.0], 0),  # never on the other side
        ([0.2, -0.2], 1),
        ([0.2, 0.0, 0.0, -0.2], 1),  # through zero at any speed
        ([0.2, -0.05, -0.2, -0.05, -0.2], 1),  # a swing counts once
        ([0.02, -0.02] * 50, 50 * 2 - 1),  # 0.04 is more than a tenth of 0.3
        ([0.014, -0.014] * 50, 0),  # 0.028 is not
        ([0.025, -0.004] * 50, 0),
        ([0.025, -0.006] * 50, 50 * 2 - 1),  # one side may be small if the other is large
        ([0.2, -0.001, 0.001, -0.001, 0.001], 1),  # chatter after a large torque: one sign change is large
        ([0.01, -0.01, 0.01, -0.25, 0.01, -0.01, 0.25], 2),
        ([0.014, -0.014, 0.02, -0.014], 2),
        ([0.002, -0.014, 0.02], 1),  # from the extremes, wherever it began
        ([-0.1, 0.01, -0.01, 0.01, -0.1, 0.2], 3),  # the small swings between do not count
    ],
)
def test_reversals_of_the_torque(torque: list[float], count: int):
    for sign, scale in ((1, 1), (-1, 1), (1, 10)):  # they are relative to the arm's own limit
        signal = np.zeros(EPISODE_STEPS)
        signal[10 : 10 + len(torque)] = sign * scale * np.array(torque)
        assert evaluate(torque=signal, torque_limit=scale * 0.3)["torque_reversals_hz"] == pytest.approx(count / 1.8)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return rollout(CONTROLLERS["paper"](), 3, seed=5, randomization="train")


class TestRecording:
    def test_no_arm_arrives_that_stays_where_it_is(self):
        still = Mock(predict=lambda observation, *_, **__: (np.zeros((len(observation), 1), np.float32), None))
        for move in ({"start": 0.0, "goal": SHORTEST}, {"start": WORKSPACE, "goal": WORKSPACE - SHORTEST}):
            run = rollout(still, 1, options={"move": move})
            assert run.finished and run.metrics()["not_arrived_share"] == 1

    def test_one_of_the_arms(self, recording: Recording):
        last = recording.arm(2)
        alone = rollout(CONTROLLERS["paper"](), 1, seed=7, randomization="train")
        assert last.state.tobytes() == alone.state.tobytes() and last.cost.tolist() == alone.cost.tolist()
        for name, values in recording.metrics().items():
            assert values[2] == pytest.approx(last.metrics()[name][0]), name
        assert last.moves.shape == (1, 4) and last.tip_error.shape == (EPISODE_STEPS, 1, 2)
        for k in (-1, 3):
            with pytest.raises(IndexError, match=f"0 to 2, got {k}"):
                recording.arm(k)

    def test_a_parquet_file_is_the_table_with_units_and_constants(self, recording: Recording, tmp_path: Path):
        pandas, parquet = pytest.importorskip("pandas"), pytest.importorskip("pyarrow.parquet")
        table, path = recording.to_pandas(), tmp_path / "new" / "run.parquet"
        assert len(table) == 3 * EPISODE_STEPS
        second = table[table.arm == 1]
        np.testing.assert_array_equal(second.time, recording.time)
        np.testing.assert_array_equal(second.torsion, recording.state[:, 1, 2])
        np.testing.assert_array_equal(second.tip_error_lateral, recording.tip_error[:, 1, 1])
        recording.to_parquet(path)
        pandas.testing.assert_frame_equal(pandas.read_parquet(path), table, check_exact=True)
        schema = parquet.read_schema(path)
        units = {field.name: field.metadata[b"unit"].decode() for field in schema}
        assert list(units) == list(table.columns)
        assert (units["torsion_speed"], units["torque"], units["tip_error_radial"]) == ("rad/s", "N m", "m")
        constants = json.loads(schema.metadata[b"beltarm"])
        arm = ArmParams(**{name: values[2] for name, values in constants["params"].items()})
        assert arm == ArmParams.from_row(recording.params[2])
        assert constants["moves"]["goal"] == recording.moves[:, 1].tolist()
        assert constants["cost"] == recording.cost.tolist() and constants["finished"] == [True] * 3

    def test_a_parquet_file_that_cannot_be_written_stays_as_it_was(
        self, recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        parquet, path = pytest.importorskip("pyarrow.parquet"), tmp_path / "run.parquet"
        path.write_text("old")

        def full(_: object, where: Path) -> None:
            where.write_text("half")
            raise OSError("no space left")

        monkeypatch.setattr(parquet, "write_table", full)
        with pytest.raises(OSError, match="no space left"):
            recording.to_parquet(path)
        assert path.read_text() == "old" and os.listdir(tmp_path) == [path.name]

    def test_a_picture(self, recording: Recording, tmp_path: Path):
        figure = recording.plot()
        error, torque, phase = figure.axes
        assert [len(axis.lines) for axis in (error, torque, phase)] == [3, 3, 3]
        distance = np.asarray(error.lines[1].get_ydata(), float)
        np.testing.assert_allclose(distance, 1e3 * np.hypot(*recording.tip_error[:, 1].T))
        np.testing.assert_array_equal(torque.lines[2].get_ydata(), recording.torque[:, 2])
        assert "mm" in error.get_ylabel() and "N m" in torque.get_ylabel() and "mrad" in phase.get_xlabel()
        figure.savefig(tmp_path / "episode.png")

    def test_a_missing_package_is_named(self, recording: Recording, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr(beltarm_env.recording, "import_module", Mock(side_effect=ModuleNotFoundError(name="x")))
        with pytest.raises(ImportError, match=r"plot .*matplotlib.*beltarm-env\[plot\]"):
            recording.plot()
        with pytest.raises(ImportError, match=r"to_parquet .*pyarrow.*beltarm-env\[parquet\]"):
            recording.to_parquet("run.parquet")
