"""Films of pictures in a row: GIF, or MP4 where imageio-ffmpeg is installed."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterable
from itertools import chain, repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from baselines.tools.files import write_atomically

Pictures = Iterable[NDArray[np.uint8]]
FPS = {".gif": 20, ".mp4": 30}
"""Pictures per second, by the name's ending."""
REST_S = 1.0
"""How long the last picture stays [s]."""


def require_writer(path: Path) -> None:
    """Check that a film of this name can be written.

    Raises:
        ValueError: If its ending is unknown, or nothing is installed that writes it.
    """
    if path.suffix not in FPS:
        raise ValueError(f"--out must end in {' or '.join(FPS)}, got {path}")
    if path.suffix == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise ValueError(f"{path} needs imageio-ffmpeg: pip install 'beltarm-env[video]', or let --out end in .gif")


def write_film(pictures: Pictures, path: Path) -> None:
    """Write a film; its name's ending says which kind.

    Args:
        pictures: Each of shape (height, width, 3), both sides even.
        path: Where to.

    Raises:
        OSError: If it cannot be written.
    """
    (_write_gif if path.suffix == ".gif" else _write_mp4)(list(pictures), path)


def _write_gif(pictures: list[NDArray[np.uint8]], path: Path) -> None:
    images = [Image.fromarray(picture) for picture in pictures]
    palette = images[len(images) // 2].quantize(64)
    first, *others = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images)
    durations = [1000 // FPS[".gif"]] * len(others) + [round(1000 * REST_S)]
    options = {"save_all": True, "append_images": others, "duration": durations, "loop": 0}
    write_atomically(path, lambda temporary: first.save(temporary, "GIF", **options))


def _write_mp4(pictures: list[NDArray[np.uint8]], path: Path) -> None:
    ffmpeg = importlib.import_module("imageio_ffmpeg")
    fps = FPS[".mp4"]
    height, width, _ = pictures[0].shape
    rest = repeat(pictures[-1], round(REST_S * fps))

    def write(temporary: Path) -> None:
        options = {"fps": fps, "macro_block_size": 2, "output_params": ["-f", "mp4", "-loglevel", "error"]}
        film = ffmpeg.write_frames(str(temporary), (width, height), **options)
        film.send(None)
        for picture in chain(pictures, rest):
            film.send(np.ascontiguousarray(picture))
        film.close()

    write_atomically(path, write)
