"""Arms side by side, in a window or as a film: pictures, and below them the tip error and the torque over time.

Films are GIF, or MP4 where imageio-ffmpeg is installed.
"""

import importlib.util
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import imageio.v2 as imageio
import numpy as np
from PIL import Image

from baselines.tools.files import write_atomically
from baselines.tools.progress import progress_over
from beltarm_env.arm import COLUMN, ArmParams
from beltarm_env.rendering.renderer import HEIGHT, WIDTH, Renderer
from beltarm_env.rendering.window import Window, import_pygame
from beltarm_env.rollout import Recording
from eval.comparison.methods import Method
from eval.comparison.rollouts import Failure, run_controller
from eval.comparison.splits import Split
from eval.report.recordings import loaded, play, reference_angles

_COLUMN = 480  # pixels across of one arm
_PICTURE = _COLUMN * HEIGHT // WIDTH
_TITLE, _STRIP, _LABEL = 30, 72, 22
_SIZE = _TITLE + _PICTURE + 2 * (_LABEL + _STRIP) + 10
AT_MOST = 4
"""Arms that fit side by side."""
_PAPER, _INK, _PALE, _SHADE = (246, 246, 244), (35, 35, 35), (200, 200, 198), (228, 228, 226)
_BLUE, _VERMILION = (0, 114, 178), (213, 94, 0)
_FPS = 30
FPS = {".gif": 20, ".mp4": _FPS}
"""Pictures per second of a film, by its name's ending."""
_REST_S = 1.0  # time that the last picture stays [s]
_GIF_COLOURS = 64
_UNSEEN = ("dummy", "offscreen")  # drivers of pygame that show nothing


@dataclass(frozen=True)
class Track:
    """Arm to show."""

    name: str
    motion: Recording
    renderer: Renderer = field(default_factory=partial(Renderer, "rgb_array", _FPS))

    @cached_property
    def reference(self) -> np.ndarray:
        """Reference of the joint [rad], shape (T,)."""
        return reference_angles(self.motion)

    @cached_property
    def error(self) -> np.ndarray:
        """Size of the tip's error [mm], shape (T,)."""
        return 1000 * np.linalg.norm(self.motion.tip_error[:, 0], axis=1)


def motion_of(name: str, method: Method, split: Split, scenario: int) -> Recording:
    """Run the first controller of a method, shown under a name, on one scenario; of a shift its last loaded move.

    Raises:
        ValueError: If it fails.
    """
    motion = run_controller(method, split.name, partial(play, method, split.part(slice(scenario, scenario + 1)), 1))
    if isinstance(motion, Failure):
        raise ValueError(f"{name} failed on scenario {scenario} of {split.name}: {motion.message}")
    return motion.of_move(loaded(motion.num_moves))


def require_writer(path: Path) -> None:
    """Check that a film of this name can be written.

    Raises:
        ValueError: If its ending is unknown, or nothing is installed that writes it.
    """
    if path.suffix not in FPS:
        raise ValueError(f"--out must end in {' or '.join(FPS)}, got {path}")
    if path.suffix == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        raise ValueError(f"{path} needs imageio-ffmpeg: pip install 'beltarm-env[video]'; a .gif does not")


def write(tracks: list[Track], speed: float, path: Path) -> None:
    """Write a film of all arms, with `speed` seconds of the arm's time per second; its name's ending says which kind.

    Raises:
        OSError: If it cannot be written.
    """
    samples = _samples(tracks, speed, FPS[path.suffix])
    write_atomically(path, partial(_write_gif if path.suffix == ".gif" else _write_mp4, tracks, samples))


def _write_gif(tracks: list[Track], samples: list[int], path: Path) -> None:
    """Write pictures in the colours of the middle one: half the size, and no flicker."""
    palette = Image.fromarray(next(_frames(tracks, [samples[len(samples) // 2]]))).quantize(_GIF_COLOURS)
    for track in tracks:
        track.renderer.clear()
    few = (
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in _frames(tracks, progress_over("pictures", samples))
    )
    durations = [1000 // FPS[".gif"]] * (len(samples) - 1) + [round(1000 * _REST_S)]
    next(few).save(path, "GIF", save_all=True, append_images=few, duration=durations, loop=0)


def _write_mp4(tracks: list[Track], samples: list[int], path: Path) -> None:
    times = [1] * (len(samples) - 1) + [1 + round(_REST_S * FPS[".mp4"])]
    film: Any = imageio.get_writer(path, format="FFMPEG", mode="I", fps=FPS[".mp4"], macro_block_size=2)
    with film:
        for frame, count in zip(_frames(tracks, progress_over("pictures", samples)), times, strict=True):
            for _ in range(count):
                film.append_data(frame)


def show(tracks: list[Track], speed: float, window: Window) -> None:
    """Play all arms in a window, again and again, until it is closed."""
    samples = _samples(tracks, speed, _FPS)
    samples += samples[-1:] * round(_REST_S * _FPS)
    shown = 0
    while True:
        for frame in _frames(tracks, samples):
            shown += 1
            if not window.begin_frame(shown / _FPS):
                return
            window.show(frame)
        for track in tracks:
            track.renderer.clear()


def _samples(tracks: list[Track], speed: float, fps: int) -> list[int]:
    """Samples that are shown, one per frame."""
    time = tracks[0].motion.time
    return [int(k) for k in np.searchsorted(time, np.arange(time[0], time[-1] + 1e-9, speed / fps) - 1e-9)]


def _frames(tracks: list[Track], samples: Iterable[int]) -> Iterator[np.ndarray]:
    """Pictures of all arms, each of shape (height, width, 3)."""
    pygame = import_pygame()
    pygame.font.init()
    font = pygame.font.Font(None, 23)
    limits = [float(track.motion.params[0, COLUMN.torque_limit]) for track in tracks]
    largest = float(np.median([track.error.max() for track in tracks])), max(limits)
    for k in samples:
        surface = pygame.Surface((_COLUMN * len(tracks), _SIZE))
        surface.fill(_PAPER)
        for column, track in enumerate(tracks):
            _draw(pygame, surface.subsurface((column * _COLUMN, 0, _COLUMN, _SIZE)), font, track, k, largest)
        yield np.frombuffer(pygame.image.tobytes(surface, "RGB"), np.uint8).reshape(_SIZE, _COLUMN * len(tracks), 3)


def _draw(pygame: Any, surface: Any, font: Any, track: Track, k: int, largest: tuple[float, float]) -> None:
    state, time = track.motion.state[k, 0], float(track.motion.time[k])
    picture = track.renderer.draw(ArmParams.from_row(track.motion.params[0]), state, float(track.reference[k]), time)
    assert picture is not None
    arm = pygame.image.frombuffer(picture.tobytes(), (WIDTH, HEIGHT), "RGB")
    surface.blit(pygame.transform.smoothscale(arm, (_COLUMN, _PICTURE)), (0, _TITLE))
    surface.blit(font.render(track.name, True, _INK), (12, 8))
    move = float(track.motion.moves[0, 2] / track.motion.time[-1])
    top = _TITLE + _PICTURE
    strips = (
        (f"tip error, cut at {largest[0]:.0f} mm", track.error / largest[0], _VERMILION),
        (f"torque, ±{largest[1]:g} N m", 0.5 + 0.5 * track.motion.torque[:, 0] / largest[1], _BLUE),
    )
    for label, heights, colour in strips:
        surface.blit(font.render(label, True, _INK), (12, top + 3))
        _strip(surface, top + _LABEL, heights[: k + 1], len(track.motion.time), move, colour)
        top += _LABEL + _STRIP


def _strip(surface: Any, top: int, heights: np.ndarray, count: int, move: float, colour: Any) -> None:
    """Draw a quantity from 0 to 1 over time, the move shaded."""
    pygame = import_pygame()
    width = _COLUMN - 24
    pygame.draw.rect(surface, _SHADE, (12, top, move * width, _STRIP))
    pygame.draw.rect(surface, _PALE, (12, top, width, _STRIP), 1)
    x = 12 + width * np.arange(1, len(heights) + 1) / count
    y = top + (_STRIP - 2) * (1 - np.clip(heights, 0, 1)) + 1
    if len(heights) > 1:
        pygame.draw.lines(surface, colour, False, np.column_stack([x, y]).tolist(), 2)


def open_window(count: int) -> Window:
    """Open a window for some arms.

    Raises:
        ValueError: If there is no display, unless pygame was told to do without.
    """
    pygame = import_pygame()
    remedy = "write a picture with --out motion.gif"
    try:
        window = Window("arms side by side", (_COLUMN * count, _SIZE), _FPS)
    except pygame.error as error:
        raise ValueError(f"no window can be opened here ({error}): {remedy}") from None
    if pygame.display.get_driver() in _UNSEEN and "SDL_VIDEODRIVER" not in os.environ:
        raise ValueError(f"there is no display to open a window on: {remedy}")
    return window
