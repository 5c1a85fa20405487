"""What happened in a rollout: recorded episodes, their metrics, and a look at them."""

from __future__ import annotations

import json
import os
import tempfile
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from beltarm_env.arm import COLUMN, FIELDS, plant_of
from beltarm_env.arrays import Flags, Floats
from beltarm_env.metrics import Episodes, episode_metrics
from beltarm_env.physics.drive import belt_motions, real_drive_of
from beltarm_env.task.moves import MOVE_FIELDS
from beltarm_env.timing import CONTROL_PERIOD

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_STATES = {"motor_angle": "rad", "motor_speed": "rad/s", "torsion": "rad", "torsion_speed": "rad/s"}
_ERRORS = {"tip_error_radial": "m", "tip_error_lateral": "m"}
_UNITS = {"arm": "", "move": "", "time": "s", **_STATES, "torque": "N m", **_ERRORS}  # of the columns of a table
_PER_SAMPLE = ("state", "torque", "tip_error", "tip_velocity_error")
_MOST_DRAWN = 10  # moves in a picture: as many as Matplotlib has colours


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Recording:
    """n moves of T steps; row k is the sample after step k + 1. SI units.

    An episode of several moves has a column for each: column k * num_arms + i is move k of arm i.
    """

    state: Floats  # x [rad, rad/s]        (T, n, 4)
    torque: Floats  # commanded [N m]      (T, n)
    tip_error: Floats  # radial, lateral [m]     (T, n, 2)
    tip_velocity_error: Floats  # [m/s]     (T, n, 2)
    cost: Floats  # of the whole move       (n,)
    finished: Flags  # False from where the arm left the workspace on, and stayed where it was    (n,)
    params: Floats  # columns as `ArmParams`     (n, len(FIELDS))
    moves: Floats  # start, goal [rad], duration, ramp time [s]     (n, 4)
    num_moves: int = 1  # of an episode
    torque_before: Floats | float = 0.0  # commanded before the move [N m]     (n,)

    def __repr__(self) -> str:
        """Return size, median scores, and how many arms left the workspace, in one line."""
        count, metrics = self.num_arms, self.metrics()
        moves = f", {self.num_moves} moves" if self.num_moves > 1 else ""
        scores = f"cost {np.median(self.cost):.0f}, tip RMS {np.median(metrics['tip_rms_mm']):.1f} mm"
        away = np.sum(~self.stayed)
        left = f"; {away} left the workspace" if away else ""
        arms = f"{count} arm{'s' if count != 1 else ''}{moves}"
        return f"Recording({arms}, {len(self.state)} samples: median {scores}{left})"

    @property
    def stayed(self) -> Flags:
        """Whether an arm stayed in its workspace through all moves, shape (num_arms,)."""
        return self.finished[-self.num_arms :]

    @property
    def num_arms(self) -> int:
        """Number of arms."""
        return len(self.cost) // self.num_moves

    @property
    def time(self) -> Floats:
        """Time of each row [s], shape (T,)."""
        return np.arange(1, len(self.state) + 1, dtype=np.float64) * CONTROL_PERIOD

    def arm(self, k: int) -> Recording:
        """Recording of one of the arms, all its moves.

        Raises:
            IndexError: If there is no such arm.
        """
        if not 0 <= k < self.num_arms:
            raise IndexError(f"there are arms 0 to {self.num_arms - 1}, got {k}")
        return self._part(slice(k, None, self.num_arms), self.num_moves)

    def of_move(self, k: int) -> Recording:
        """Recording of one of the moves, of all arms.

        Raises:
            IndexError: If there is no such move.
        """
        if not 0 <= k < self.num_moves:
            raise IndexError(f"there are moves 0 to {self.num_moves - 1}, got {k}")
        return self._part(slice(k * self.num_arms, (k + 1) * self.num_arms), 1)

    def _part(self, columns: slice, num_moves: int) -> Recording:
        of_all = {f.name: getattr(self, f.name) for f in fields(self)}
        arrays = {name: of for name, of in of_all.items() if isinstance(of, np.ndarray)}
        parts = {name: of[:, columns] if name in _PER_SAMPLE else of[columns] for name, of in arrays.items()}
        return Recording(**{**of_all, **parts, "num_moves": num_moves})

    def metrics(self) -> dict[str, Floats]:
        """All metrics of `beltarm_env.metrics.METRICS`, each of shape (n,)."""
        limits, durations = self.params[:, COLUMN.torque_limit], self.moves[:, 2]
        commanded = self.tip_error, self.tip_velocity_error, self.torque, limits, durations
        return episode_metrics(Episodes(*commanded, self.cost, self.finished, self.torque_before))

    def over_moves(self, values: Floats) -> Floats:
        """Average a number per move, such as `cost` or one of the metrics, over the moves of each arm.

        Args:
            values: Shape (n,).

        Returns:
            Averages, shape (num_arms,); of each arm the same bits in any batch.
        """
        of_arms = np.ascontiguousarray(values.reshape(self.num_moves, -1).T)  # so that no sum depends on other arms
        return of_arms.mean(axis=1, dtype=np.float64)

    def in_turn(self, values: Floats) -> Floats:
        """Join the moves of each arm along time: values per sample, (T, n, ...), to (moves T, num_arms, ...)."""
        return np.concatenate(np.split(values, self.num_moves, axis=1))

    def to_pandas(self) -> pd.DataFrame:
        """Table of all samples: a row per arm, move and time; states, commanded torque, tip errors, in SI units.

        Raises:
            ImportError: If pandas is not installed.
        """
        return _needed("pandas", "to_pandas").DataFrame(self._columns())

    def to_parquet(self, path: Path | str) -> None:
        """Write the table of `to_pandas` as a Parquet file: all of it, or nothing.

        Each column names its unit in its metadata, "unit". The file's metadata "beltarm" is JSON: an array with a
        number per arm for each constant in "params" and in "moves", and for "cost" and "finished"; of several moves
        those of the first one of all arms, then of the second one, and so on.

        Args:
            path: The file to create or replace; its folder is created.

        Raises:
            ImportError: If pyarrow is not installed.
            OSError: If the file cannot be written.
        """
        arrow, parquet = (_needed(name, "to_parquet", "parquet") for name in ("pyarrow", "pyarrow.parquet"))
        of_arms = {
            "params": dict(zip(FIELDS, self.params.T.tolist(), strict=True)),
            "moves": dict(zip(MOVE_FIELDS, self.moves.T.tolist(), strict=True)),
            "cost": self.cost.tolist(),
            "finished": self.finished.tolist(),
        }
        columns = {name: arrow.array(values) for name, values in self._columns().items()}
        described = [arrow.field(name, of.type, metadata={"unit": _UNITS[name]}) for name, of in columns.items()]
        schema = arrow.schema(described, metadata={"beltarm": json.dumps(of_arms)})
        table = arrow.table(list(columns.values()), schema=schema)
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
        os.close(handle)
        temporary = Path(name)
        try:
            parquet.write_table(table, temporary)
            temporary.chmod(0o644)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)

    def _columns(self) -> dict[str, Any]:
        """Columns of a table of all samples, move after move and in it arm after arm."""
        steps, count = self.torque.shape
        move, arm = np.divmod(np.arange(count), self.num_arms)
        columns: dict[str, Any] = {"arm": np.repeat(arm, steps), "move": np.repeat(move, steps)}
        columns |= {"time": np.tile(self.time, count)}
        columns |= {name: self.state[:, :, k].T.ravel() for k, name in enumerate(_STATES)}
        columns |= {"torque": self.torque.T.ravel()}
        return columns | {name: self.tip_error[:, :, k].T.ravel() for k, name in enumerate(_ERRORS)}

    def plot(self) -> Figure:
        """Draw the tip's error, the torque, the belt's torsion and its rate, of ten moves at most, each in one colour.

        Returns:
            The figure: a notebook shows it, `savefig` writes it.

        Raises:
            ImportError: If matplotlib is not installed.
        """
        figure = _needed("matplotlib.pyplot", "plot").Figure(figsize=(10, 6.5), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(1.7, 1))
        error, torque, phase = (
            figure.add_subplot(grid[0, 0]),
            figure.add_subplot(grid[1, 0]),
            figure.add_subplot(grid[:, 1]),
        )
        count = min(len(self.cost), _MOST_DRAWN)
        for k in range(count):
            colour, (move, arm) = f"C{k}", divmod(k, self.num_arms)
            label = f"arm {arm}, move {move}" if self.num_moves > 1 else f"arm {arm}"
            error.plot(self.time, 1e3 * np.hypot(*self.tip_error[:, k].T), color=colour, lw=1, label=label)
            torque.plot(self.time, self.torque[:, k], color=colour, lw=0.8)
            row = self.params[k]
            torsion, rate = belt_motions(self.state[:, k], plant_of(row), real_drive_of(row)).T
            phase.plot(1e3 * torsion, rate, color=colour, lw=0.6)
        for axis in (error, torque):
            axis.axvspan(0, self.moves[:count, 2].max(), color="0.5", alpha=0.12, lw=0)
            axis.set_xlim(0, self.time[-1])
        part = f"; the first {count} of {len(self.cost)} moves" if count < len(self.cost) else ""
        error.set(ylabel="error of the arm's end (mm)", ylim=(0, None), title=f"the move is shaded{part}")
        torque.set(ylabel="commanded torque (N m)", xlabel="time (s)")
        phase.set(xlabel="torsion of the belt (mrad)", ylabel="its rate (rad/s)")
        for axis in (error, torque, phase):
            axis.grid(alpha=0.3)
        if count > 1:
            error.legend(fontsize=8, ncols=3)
        return figure


def _needed(module: str, method: str, extra: str = "plot") -> Any:
    """Import what only looking at recordings, or keeping them, needs.

    Raises:
        ImportError: If it is not installed, naming the extra.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError:
        name = module.partition(".")[0]
        raise ImportError(f"Recording.{method} needs {name}: pip install 'beltarm-env[{extra}]'") from None
