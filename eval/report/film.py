"""Films: GIF, or MP4 where imageio-ffmpeg is installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from baselines.tools.files import write_atomically

Pictures = Iterable[NDArray[np.uint8]]
FPS = {".gif": 20, ".mp4": 30}
"""Pictures per second, by the name's ending."""
REST_S = 1.0
"""Time that the last picture stays [s]."""
_GIF_COLOURS = 64


def require_writer(path: Path) -> None:
    """Check that a film of this name can be written.

    Raises:
        ValueError: If its ending is unknown, or nothing is installed that writes it.
    """
    if path.suffix not in FPS:
        raise ValueError(f"--out must end in {' or '.join(FPS)}, got {path}")
    if path.suffix == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise ValueError(f"{path} needs imageio-ffmpeg: pip install 'beltarm-env[video]'; a .gif does not")


def write_film(pictures: Pictures, path: Path) -> None:
    """Write a film of pictures of shape (height, width, 3), both sides even; its name's ending says which kind.

    Raises:
        OSError: If it cannot be written.
    """
    shown, fps = list(pictures), FPS[path.suffix]
    options: dict[str, Any]
    if path.suffix == ".gif":
        durations = [1000 // fps] * (len(shown) - 1) + [round(1000 * REST_S)]
        shown = _with_few_colours(shown)
        options = {"plugin": "pillow", "duration": durations, "loop": 0}
    else:
        shown += shown[-1:] * round(REST_S * fps)
        options = {"plugin": "FFMPEG", "fps": fps, "macro_block_size": 2}
    write_atomically(path, lambda temporary: imageio.imwrite(temporary, np.stack(shown), **options))


def _with_few_colours(pictures: list[NDArray[np.uint8]]) -> list[NDArray[np.uint8]]:
    """Reduce all pictures to the colours of the middle one: half the size, and no flicker."""
    palette = Image.fromarray(pictures[len(pictures) // 2]).quantize(_GIF_COLOURS)
    few = (Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures)
    return [np.asarray(picture.convert("RGB")) for picture in few]
