"""The window of render mode "human", paced by the arm's own time."""

from __future__ import annotations

import math
import warnings
from types import ModuleType

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray


def import_pygame() -> ModuleType:
    """Import pygame.

    Raises:
        DependencyNotInstalled: If it is missing.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pygame imports pkg_resources, which warns
            import pygame
    except ImportError as error:
        raise DependencyNotInstalled('rendering needs pygame: pip install "beltarm-env[render]"') from error
    return pygame


class Window:
    """A window that shows frames until it is closed.

    Args:
        title: Of the window.
        size: Width and height in pixels.
        fps: Frames shown per second of arm time, and at most per second [1/s].
    """

    def __init__(self, title: str, size: tuple[int, int], fps: int) -> None:
        self._pygame = pygame = import_pygame()
        self._fps = fps
        self._size = size
        self._shown: int | None = None
        self._open = True
        pygame.display.init()
        pygame.display.set_mode(size)
        pygame.display.set_caption(title)
        self._clock = pygame.time.Clock()

    def begin_frame(self, time: float) -> bool:
        """Tell whether to draw: the window is open and, since the last call, a new 1/fps s of arm time has begun."""
        previous, self._shown = self._shown, math.floor(time * self._fps + 1e-6)
        return self._open and self._shown != previous

    def show(self, frame: NDArray[np.uint8]) -> None:
        """Show a frame of shape (height, width, 3)."""
        display, event = self._pygame.display, self._pygame.event
        if display.get_surface() is None or event.get(self._pygame.QUIT):
            return self.close()
        event.clear()  # else the queue fills up
        display.get_surface().blit(self._pygame.image.frombuffer(frame.tobytes(), self._size, "RGB"), (0, 0))
        display.flip()
        self._clock.tick(self._fps)

    def restart(self) -> None:
        """Show the next frame whatever its time."""
        self._shown = None

    def close(self) -> None:
        """Close the window."""
        if self._open:
            self._open = False
            self._pygame.display.quit()
