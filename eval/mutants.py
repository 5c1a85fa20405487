"""Put faults into the code, and see which the tests find: `python eval/mutants.py`, or `make mutants`.

Takes an hour, and goes on where it was interrupted.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import require_bounds, require_known, run_command, stop_without

try:
    from baselines.tools.files import require_writable, write_text
    from baselines.tools.provenance import command_line, commit
    from beltarm_env import __version__
    from eval.mutation.page import judgements, markdown
    from eval.mutation.study import tried
    from eval.mutation.subjects import SUBJECTS
except ModuleNotFoundError as error:
    stop_without("eval/mutants.py", error)


@dataclass(frozen=True)
class Config:
    """Put faults into the code, and see which the tests find."""

    modules: tuple[str, ...] = ()
    """Modules to mutate, as paths from the root. Default: all."""
    count: int = 20
    """Mutants of each module, at most."""
    kept: Path = Path("results/mutation")
    """Folder where outcomes are kept. Without them all begins anew."""
    out: Path = Path("results/mutation")
    """Folder for mutation.md."""


def mutate(config: Config) -> None:
    """Try mutants of all modules and write the page.

    Raises:
        ValueError: If an option is not allowed, or tests fail without a fault.
        OSError: If a folder cannot be written to.
    """
    require_bounds(config, count=(1, None))
    require_known(config.modules, SUBJECTS, "there is no module {} to mutate")
    for folder in (config.kept, config.out):
        require_writable(folder)
    parts = []
    for module in config.modules or SUBJECTS:
        part = tried(module, SUBJECTS[module], config.count, config.kept / f"{module.replace('/', '.')}.json")
        parts.append(part)
        print(f"{module}: {len(part.mutants)} mutants, {len(part.survivors)} survived", flush=True)
        for mutant in part.survivors:
            print(f"  {mutant.name}", flush=True)
    origin = f"`{command_line()}`, beltarm {__version__} ({commit()})."
    write_text(config.out / "mutation.md", markdown(parts, origin, judgements()))
    print(f"written to {config.out}: mutation.md")


def main() -> None:
    """Command line."""
    run_command(__file__, Config, mutate, __doc__)


if __name__ == "__main__":
    main()
