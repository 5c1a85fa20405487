"""What tests of training runs share: a stop at a chosen moment, and the weights that a run leaves."""

from __future__ import annotations

from pathlib import Path

from baselines.engines.parallel import StopRequest


class StopAfter(StopRequest):
    """Made once it has been looked at so often."""

    def __init__(self, looks: int) -> None:
        self.looks = looks

    @property
    def made(self) -> bool:
        self.looks -= 1
        return self.looks < 0

    @made.setter
    def made(self, value: bool) -> None:
        pass


def weights(folder: Path) -> bytes:
    """File of the weights in a bundle."""
    (path,) = folder.glob("*.safetensors")
    return path.read_bytes()
