"""Recordings as users look at them: one line, a table, a picture, one arm."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

import beltarm_env.recording
from baselines import CONTROLLERS
from beltarm_env import EPISODE_STEPS, ArmParams
from beltarm_env.rollout import Recording, rollout


@pytest.fixture(scope="module")
def recording() -> Recording:
    return rollout(CONTROLLERS["paper"](), 3, seed=5, randomization="train")


def test_one_line(recording: Recording):
    cost, rms = np.median(recording.cost), np.median(recording.metrics()["tip_rms_mm"])
    assert repr(recording) == f"Recording(3 arms, 1200 samples: median cost {cost:.0f}, tip RMS {rms:.1f} mm)"
    assert repr(recording.arm(0)).startswith("Recording(1 arm, 1200 samples: median cost")


def test_arms_that_left_are_counted(recording: Recording):
    left = replace(recording, finished=np.array([True, False, False]))
    assert repr(left).endswith("; 2 left the workspace)")


def test_one_of_the_arms(recording: Recording):
    one = recording.arm(2)
    alone = rollout(CONTROLLERS["paper"](), 1, seed=7, randomization="train")
    assert one.state.tobytes() == alone.state.tobytes() and one.cost.tolist() == alone.cost.tolist()
    assert one.moves.shape == (1, 4) and one.tip_error.shape == (EPISODE_STEPS, 1, 2)
    for k in (-1, 3):
        with pytest.raises(IndexError, match=f"there are arms 0 to 2, got {k}"):
            recording.arm(k)


def test_a_table_of_all_samples(recording: Recording):
    table = recording.to_pandas()
    assert len(table) == 3 * EPISODE_STEPS
    of_one = table[table.arm == 1]
    np.testing.assert_array_equal(of_one.time, recording.time)
    np.testing.assert_array_equal(of_one.torsion, recording.state[:, 1, 2])
    np.testing.assert_array_equal(of_one.torque, recording.torque[:, 1])
    np.testing.assert_array_equal(of_one.tip_error_lateral, recording.tip_error[:, 1, 1])


def test_a_parquet_file_is_the_table_with_units_and_constants(recording: Recording, tmp_path: Path):
    pandas, parquet = pytest.importorskip("pandas"), pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "new" / "run.parquet"
    recording.to_parquet(path)
    pandas.testing.assert_frame_equal(pandas.read_parquet(path), recording.to_pandas(), check_exact=True)
    schema = parquet.read_schema(path)
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    assert list(units) == list(recording.to_pandas().columns)
    assert (units["torsion_speed"], units["torque"], units["tip_error_radial"]) == ("rad/s", "N m", "m")
    told = json.loads(schema.metadata[b"beltarm"])
    arm = ArmParams(**{name: values[2] for name, values in told["params"].items()})
    assert arm == ArmParams.from_row(recording.params[2])
    assert told["moves"]["goal"] == recording.moves[:, 1].tolist() and told["cost"] == recording.cost.tolist()
    assert told["finished"] == [True] * 3


def test_a_parquet_file_that_cannot_be_written_stays_as_it_was(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
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


def test_a_picture(recording: Recording, tmp_path: Path):
    figure = recording.plot()
    error, torque, phase = figure.axes
    assert [len(axis.lines) for axis in (error, torque, phase)] == [3, 3, 3]
    np.testing.assert_allclose(
        np.asarray(error.lines[1].get_ydata(), float), 1e3 * np.hypot(*recording.tip_error[:, 1].T)
    )
    np.testing.assert_array_equal(torque.lines[2].get_ydata(), recording.torque[:, 2])
    assert "mm" in error.get_ylabel() and "N m" in torque.get_ylabel() and "mrad" in phase.get_xlabel()
    figure.savefig(tmp_path / "episode.png")
    assert matplotlib.image.imread(tmp_path / "episode.png").std() > 0.01


@pytest.mark.parametrize(
    ("method", "package", "extra", "arguments"),
    [
        ("plot", "matplotlib", "plot", ()),
        ("to_pandas", "pandas", "plot", ()),
        ("to_parquet", "pyarrow", "parquet", ("run.parquet",)),
    ],
)
def test_what_is_not_installed_is_named(
    method: str,
    package: str,
    extra: str,
    arguments: tuple[str, ...],
    recording: Recording,
    monkeypatch: pytest.MonkeyPatch,
):
    def missing(name: str) -> None:
        raise ModuleNotFoundError(name=name)

    monkeypatch.setattr(beltarm_env.recording, "import_module", missing)
    with pytest.raises(ImportError, match=rf"{method} needs {package}: pip install 'beltarm-env\[{extra}\]'"):
        getattr(recording, method)(*arguments)
