"""Show the classical controllers in numbers: `python eval/baselines.py`.

Writes summary.md and its pictures: poles and margins of the closed loop over joint angle and arms; cost, metrics and
computing time; cost with one thing changed; the price of the margins; budgets beside those of learned methods; gains.
"""

from __future__ import annotations

import platform
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import require_bounds, require_known, run_command, stop_without

try:
    import tyro

    from baselines import CONTROLLERS
    from baselines.tools.files import require_writable, write_text
    from baselines.tools.provenance import command_line, commit
    from beltarm_env import __version__
    from beltarm_env.task.seeds import LOOPS
    from eval.loops.page import markdown
    from eval.loops.pictures import save_pictures
    from eval.loops.study import Sizes, run_study
    from eval.loops.tables import glance_table
except ModuleNotFoundError as error:
    stop_without("eval/baselines.py", error)


@dataclass(frozen=True)
class Config:
    """Show the classical controllers in numbers."""

    names: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME ...]")] = ()
    """Controllers to show. Default: all."""
    out: Path = Path("results/baselines")
    """Folder for summary.md and the pictures."""
    arms: int | None = None
    """Arms for each cost, 8 to 10000. Default: 256. Where one thing is changed, a quarter of them."""
    batch: int | None = None
    """Arms of the batch that is timed. Default: 256."""
    quick: bool = False
    """Take a first look, with 16 arms and a batch of 64."""

    def chosen(self) -> list[str]:
        """Names of the controllers to show.

        Raises:
            ValueError: If there is no such controller, naming it.
        """
        require_known(self.names, CONTROLLERS, "no controller {} to show")
        return list(dict.fromkeys(self.names)) or list(CONTROLLERS)

    @property
    def sizes(self) -> Sizes:
        """Numbers of arms.

        Raises:
            ValueError: If one is out of range, naming it.
        """
        require_bounds(self, arms=(8, 10_000), batch=(1, LOOPS.size))
        arms = (16 if self.quick else 256) if self.arms is None else self.arms
        batch = (64 if self.quick else 256) if self.batch is None else self.batch
        return Sizes(arms, arms // 4, batch)


def report(config: Config) -> None:
    """Compute everything and write it to the folder.

    Raises:
        ValueError: If a name or an option is not allowed, or a file of gains or of the oracle is damaged.
        OSError: If the folder cannot be written to.
    """
    began, at = time.perf_counter(), commit()
    names, sizes = config.chosen(), config.sizes
    require_writable(config.out)
    study = run_study(names, sizes, lambda line: print(line, file=sys.stderr, flush=True))
    pictures = save_pictures(study, config.out)
    origin = (
        f"`{command_line()}`, beltarm {__version__} ({at}), Python {platform.python_version()} on "
        f"{platform.machine()}, {time.perf_counter() - began:.0f} s."
    )
    write_text(config.out / "summary.md", markdown(study, pictures, origin))
    print(glance_table(study))
    print(f"written to {config.out}: summary.md, {len(pictures)} pictures", flush=True)


def main() -> None:
    """Command line."""
    run_command(__file__, Config, report, __doc__)


if __name__ == "__main__":
    main()
