"""Run a study: `python eval/study.py steps`; `--list` names all of them, `NAME --help` shows the options of one.

Writes data.json, with everything that was measured, page.md and pictures into results/NAME.
"""

import os
import sys
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # a process per core; read as numpy is imported, in all of them
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

from baselines.tools.command import one_line_errors, stop_without

try:
    from baselines.tools.options import parse
    from eval.studies._frame import load, names, quick_ones, run
except ModuleNotFoundError as error:
    stop_without("eval/study.py", error)


def main() -> None:
    """Command line."""
    words = sys.argv[1:]
    try:
        with one_line_errors("eval/study.py"):
            if not words or words[0] in ("-h", "--help", "--list"):
                print("usage: eval/study.py NAME [OPTIONS]\n")
                for name in names():
                    print(f"  {name:11} {(load(name).__doc__ or '').splitlines()[0]}")
                return
            study = load(words[0])
            options = parse(study.Options, study.__doc__, words[1:], partial(quick_ones, study))
            print(f"written to {run(study, options)}")
    except ModuleNotFoundError as error:
        stop_without("eval/study.py", error)


if __name__ == "__main__":
    main()
