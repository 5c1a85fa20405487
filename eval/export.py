"""Write something of this project for other programs: `python eval/export.py c adaptive --out results/my-drive`.

    c CONTROLLER|POLICY     C for a drive's processor
    onnx POLICY             the network of a policy as an ONNX model
    fmu                     the arm as an FMU, for other simulators
    hub POLICY              the folder of a policy for the Hugging Face Hub
    dataset                 episodes for offline learning, in Minari's format

`python eval/export.py c --help` shows the options of the first, and so on.
"""

import sys
from importlib import import_module
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from baselines.tools.command import one_line_errors, require_known, stop_without

MODULES = {"c": "program", "onnx": "onnx", "fmu": "fmu", "hub": "hub", "dataset": "dataset"}
"""Module of each export: its `Options`, and its `export`, which writes what they ask for and prints where it is.

`export` raises ValueError for options that are not allowed, DependencyNotInstalled for a missing package, and OSError
for files that cannot be written.
"""


def main() -> None:
    """Command line."""
    script, words = "eval/export.py", sys.argv[1:]
    if not words or words[0] in ("-h", "--help"):
        print(__doc__)
        return
    with one_line_errors(script):
        require_known(words[:1], MODULES, "no export is called {}")
        try:
            from baselines.tools.options import parse

            module = import_module(f"eval.exports.{MODULES[words[0]]}")
        except ModuleNotFoundError as error:
            stop_without(script, error)
        module.export(parse(module.Options, module.__doc__, words[1:]))


if __name__ == "__main__":
    main()
