"""Wall-clock of a training until it halves the figures of the controller that it corrects."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from eval.speed.timing import ROOT, Row


def training_rows() -> list[Row]:
    """Time of `train/ppo.py` until cost, tip RMS and residual vibration are all halved, and of the whole run."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(ROOT / "train" / "ppo.py"), "--out", folder]
        subprocess.run([*command, "--validation-every", "100000"], check=True, stdout=subprocess.DEVNULL)
        with (Path(folder) / "validation.csv").open(newline="", encoding="utf-8") as file:
            rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
        provenance = json.loads((Path(folder) / "best" / "policy.json").read_text())["provenance"]
    base = provenance["validation_of_base"]
    halved = min((row["seconds"] for row in rows if all(row[name] <= 0.5 * base[name] for name in base)), default=None)
    reached = provenance["reached"]["validation"]
    ratios = ", ".join(f"{name} {reached[name] / base[name]:.2f}x" for name in base)
    until = "never" if halved is None else f"{halved:.0f} s"
    peer = "the paper's controller"
    return [
        Row("training until cost, tip RMS and residual are halved", until, peer, "0.50x"),
        Row("training, whole run", f"{rows[-1]['seconds']:.0f} s", peer, ratios),
    ]
