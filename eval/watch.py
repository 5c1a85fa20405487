"""Watch arms side by side: `python eval/watch.py --controller paper --controller adaptive --policy runs/ppo/best`.

All of them run the same scenario of the comparison. Each has its picture, and below it the size of the tip's error and
the torque over time. Shows a window until it is closed, or writes a film: `--out motion.gif`, or `--out motion.mp4`,
which needs the extra `video`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import numpy as np
import torch
import tyro
from gymnasium.error import DependencyNotInstalled
from rich.console import Console

from baselines.tools.command import one_line_errors
from baselines.tools.files import require_writable
from beltarm_env.arm import FIELDS, ArmParams
from beltarm_env.rendering.renderer import HEIGHT, WIDTH, Renderer
from beltarm_env.rendering.window import Window, import_pygame
from beltarm_env.rollout import Controller, Recording
from eval.comparison.methods import Method, added_method, chosen, classical_methods, learned_methods, shipped_policies
from eval.comparison.splits import EPISODES, Split, load
from eval.views.film import FPS, REST_S, require_writer, write_film
from eval.views.report.animation import reference_angles

_COLUMN = 480  # pixels across of one arm
_PICTURE = _COLUMN * HEIGHT // WIDTH
_TITLE, _STRIP, _LABEL = 30, 72, 22
_SIZE = _TITLE + _PICTURE + 2 * (_LABEL + _STRIP) + 10
_AT_MOST = 4
_PAPER, _INK, _PALE, _SHADE = (246, 246, 244), (35, 35, 35), (200, 200, 198), (228, 228, 226)
_BLUE, _VERMILION = (0, 114, 178), (213, 94, 0)
_FPS = 30
_UNSEEN = ("dummy", "offscreen")  # drivers of pygame that show nothing


@dataclass(frozen=True)
class Config:
    """Watch arms side by side."""

    controller: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """A classical controller by name, or one of your own as path/to/file.py:Class; repeat it for several."""
    policy: Annotated[tuple[Path, ...], tyro.conf.UseAppendAction] = ()
    """Folder of a policy bundle, such as runs/ppo/best; repeat it for several. With neither: paper, adaptive and the
    first shipped policy."""
    split: str = "randomized"
    """Split of the scenario."""
    scenario: int = 0
    """Number of the scenario in its split."""
    speed: float = 0.25
    """Seconds of the arm's time per second."""
    out: Path | None = None
    """Write this film, .gif or .mp4, instead of showing a window."""

    def check(self) -> None:
        """Check the values.

        Raises:
            ValueError: If one is not allowed.
        """
        if not 0 <= self.scenario < EPISODES:
            raise ValueError(f"--scenario must lie within 0 and {EPISODES - 1}, got {self.scenario}")
        if not 0.01 <= self.speed <= 10:
            raise ValueError(f"--speed must lie within 0.01 and 10, got {self.speed:g}")
        if self.out is not None:
            require_writer(self.out)
        if len(self.controller) + len(self.policy) > _AT_MOST:
            raise ValueError(f"at most {_AT_MOST} arms fit side by side, got {len(self.controller) + len(self.policy)}")


@dataclass(frozen=True, slots=True)
class Track:
    """One arm: what it is called, how it moved, how it is drawn."""

    name: str
    motion: Recording
    reference: np.ndarray  # of the joint [rad]     (T,)
    renderer: Renderer

    @property
    def params(self) -> ArmParams:
        """Constants of this arm."""
        return ArmParams(**dict(zip(FIELDS, map(float, self.motion.params[0]), strict=True)))

    @property
    def error(self) -> np.ndarray:
        """Size of the tip's error [mm], shape (T,)."""
        return 1000 * np.linalg.norm(self.motion.tip_error[:, 0], axis=1)


def watch(config: Config, console: Console) -> None:
    """Run the arms, then show or write what they did."""
    config.check()
    splits = load()
    split = splits[chosen("split", (config.split,), splits)[0]]
    controllers = {name: method.controller(0, []) for name, method in _methods(config)}
    if config.out is not None:
        require_writable(config.out.parent)
    window = _window(len(controllers)) if config.out is None else None
    tracks = [_track(name, controller, split, config.scenario) for name, controller in controllers.items()]
    for track in tracks:
        console.print(f"{track.name}: tip error at most {track.error.max():.1f} mm, cost {track.motion.cost[0]:.0f}")
    if window is not None:
        _show(tracks, config.speed, window)
    elif config.out is not None:
        write_film(_frames(tracks, _samples(tracks, config.speed, FPS[config.out.suffix])), config.out)
        console.print(f"written to {config.out}")


def _methods(config: Config) -> list[tuple[str, Method]]:
    """What is shown, by name; a policy by that of its folder where there are several."""
    names, folders = config.controller, config.policy
    if not names and not folders:
        names, folders = ("paper", "adaptive"), tuple(shipped_policies()[:1])
    known = {method.name: method for method in classical_methods()}
    found = []
    for name in names:
        method = added_method(name) if ":" in name else known[chosen("controller", (name,), known)[0]]
        found.append((method.name, method))
    for folder in folders:
        (method,) = learned_methods([folder])
        found.append((method.name if len(folders) == 1 else f"{method.name} ({folder})", method))
    return found


def _track(name: str, controller: Controller, split: Split, scenario: int) -> Track:
    motion = split.run(controller, scenario)
    return Track(name, motion, reference_angles(motion), Renderer("rgb_array", _FPS))


def _samples(tracks: list[Track], speed: float, fps: int) -> list[int]:
    """Samples that are shown, one per frame."""
    time = tracks[0].motion.time
    return [int(k) for k in np.searchsorted(time, np.arange(time[0], time[-1] + 1e-9, speed / fps) - 1e-9)]


def _frames(tracks: list[Track], samples: list[int]) -> Iterator[np.ndarray]:
    """Pictures of all arms, each of shape (height, width, 3)."""
    pygame = import_pygame()
    pygame.font.init()
    font = pygame.font.Font(None, 23)
    largest = float(np.median([track.error.max() for track in tracks])), max(_torque_limit(track) for track in tracks)
    for k in samples:
        surface = pygame.Surface((_COLUMN * len(tracks), _SIZE))
        surface.fill(_PAPER)
        for column, track in enumerate(tracks):
            _draw(pygame, surface.subsurface((column * _COLUMN, 0, _COLUMN, _SIZE)), font, track, k, largest)
        pixels = pygame.image.tobytes(surface, "RGB")
        yield np.frombuffer(pixels, np.uint8).reshape(_SIZE, _COLUMN * len(tracks), 3)


def _torque_limit(track: Track) -> float:
    return float(track.motion.params[0, FIELDS.index("torque_limit")])


def _draw(pygame: Any, surface: Any, font: Any, track: Track, k: int, largest: tuple[float, float]) -> None:
    state, time = track.motion.state[k, 0], float(track.motion.time[k])
    picture = track.renderer.draw(track.params, state, float(track.reference[k]), time)
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
        _strip(pygame, surface, top + _LABEL, heights[: k + 1], len(track.motion.time), move, colour)
        top += _LABEL + _STRIP


def _strip(pygame: Any, surface: Any, top: int, heights: np.ndarray, count: int, move: float, colour: Any) -> None:
    """A quantity from 0 to 1 over time, the move shaded."""
    width = _COLUMN - 24
    pygame.draw.rect(surface, _SHADE, (12, top, move * width, _STRIP))
    pygame.draw.rect(surface, _PALE, (12, top, width, _STRIP), 1)
    x = 12 + width * np.arange(1, len(heights) + 1) / count
    y = top + (_STRIP - 2) * (1 - np.clip(heights, 0, 1)) + 1
    if len(heights) > 1:
        pygame.draw.lines(surface, colour, False, np.column_stack([x, y]).tolist(), 2)


def _window(count: int) -> Window:
    """A window for some arms.

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


def _show(tracks: list[Track], speed: float, window: Window) -> None:
    samples = _samples(tracks, speed, _FPS)
    samples += samples[-1:] * round(REST_S * _FPS)
    shown = 0
    while True:
        for frame in _frames(tracks, samples):
            shown += 1
            if not window.begin_frame(shown / _FPS):
                return
            window.show(frame)
        for track in tracks:
            track.renderer.clear()


def main() -> None:
    """Command line."""
    config = tyro.cli(Config, description=__doc__)
    with one_line_errors("eval/watch.py"):
        torch.set_num_threads(1)
        try:
            watch(config, Console())
        except DependencyNotInstalled as error:
            raise ValueError(str(error)) from None


if __name__ == "__main__":
    main()
