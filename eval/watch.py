"""Watch arms side by side: `python eval/watch.py --controller paper --controller adaptive --policy runs/ppo/best`.

All arms run one scenario (of a shift, the last move with a part), from the set that the comparison uses by default,
or from a fresh one. Below each picture are the tip's error and the torque over time. Shows a window until it is closed,
or writes a film: `--out motion.gif`, or `--out motion.mp4`, which needs the extra `video`.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import require_bounds, run_command, stop_without

try:
    import tyro
    from rich.console import Console

    from baselines.tools.files import require_writable
    from baselines.tools.progress import progress_over
    from eval.comparison.methods import chosen, methods_side_by_side
    from eval.comparison.sets import MOST, choose_set, fresh_scenarios
    from eval.comparison.splits import EPISODES, SPLITS
    from eval.report import side_by_side
except ModuleNotFoundError as error:
    stop_without("eval/watch.py", error)


@dataclass(frozen=True)
class Config:
    """Watch arms side by side."""

    controller: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A classical controller by name, or one of your own as path/to/file.py:Class. Repeat the option for more."""
    policy: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Folder of a policy, such as runs/ppo/best. Repeat the option for more. Without --controller and --policy: paper,
    adaptive and the first shipped policy."""
    split: str = "randomized"
    """Split that the scenario is taken from."""
    scenario: int = 0
    """Number of the scenario in its split."""
    scenario_seed: int | None = None
    """Take the scenario from the fresh set that `eval/compare.py --scenario-seed` draws, where there are up to
    3000000."""
    speed: float = 0.25
    """Seconds of the arm's time per second of film."""
    out: Path | None = None
    """Film to write, .gif or .mp4. Default: show a window."""


def watch(config: Config) -> None:
    """Run the arms, then show or write their motions."""
    console = Console()
    require_bounds(config, scenario=(0, (EPISODES if config.scenario_seed is None else MOST) - 1))
    if not 0.01 <= config.speed <= 10:
        raise ValueError(f"--speed must lie within 0.01 and 10, got {config.speed:g}")
    if config.out is not None:
        side_by_side.require_writer(config.out)
        require_writable(config.out.parent)
    if (count := len(config.controller) + len(config.policy)) > side_by_side.AT_MOST:
        raise ValueError(f"at most {side_by_side.AT_MOST} arms fit side by side, got {count}")
    (name,) = chosen("split", (config.split,), SPLITS)
    if config.scenario_seed is None:
        split, scenario = choose_set().splits[name], config.scenario
    else:
        split, scenario = fresh_scenarios(config.scenario_seed, name, [config.scenario]), 0
    methods = methods_side_by_side(config.controller, config.policy)
    window = side_by_side.open_window(len(methods)) if config.out is None else None
    tracks = [
        side_by_side.Track(name, side_by_side.motion_of(name, method, split, scenario))
        for name, method in progress_over("arms", methods)
    ]
    for track in tracks:
        console.print(f"{track.name}: tip error at most {track.error.max():.1f} mm, cost {track.motion.cost[0]:.0f}")
    if window is not None:
        side_by_side.show(tracks, config.speed, window)
    elif config.out is not None:
        side_by_side.write(tracks, config.speed, config.out)
        console.print(f"written to {config.out}")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, watch, __doc__)


if __name__ == "__main__":
    main()
