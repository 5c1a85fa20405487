"""Pictures of the arm that MuJoCo draws, for `model="mujoco"`."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from beltarm_env.arm import ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.mujoco.model import load_model, mujoco, place_hand, write_state
from beltarm_env.rendering.window import Window

WIDTH, HEIGHT = 640, 480
CAMERA = "slanted"

_no_opengl: list[Exception] = []
"""Why there is no OpenGL: MuJoCo aborts the process when it is asked for it a second time."""


class MuJoCoRenderer:
    """Draws one arm, into a window or into arrays; used like `rendering.Renderer`."""

    def __init__(self, render_mode: Literal["human", "rgb_array"], fps: int) -> None:
        """Set up drawing; "human" opens the window.

        Args:
            render_mode: "human" or "rgb_array".
            fps: Frames per second of arm time that the window shows [1/s].

        Raises:
            DependencyNotInstalled: If a window is asked for and pygame is missing.
        """
        self._window = Window("BeltArmMuJoCo-v0", (WIDTH, HEIGHT), fps) if render_mode == "human" else None
        self._params: ArmParams | None = None
        self._data: Any = None
        self._renderer: Any = None

    def draw(self, params: ArmParams, state: Floats, reference_angle: float, time: float) -> NDArray[np.uint8] | None:
        """Draw the arm; in a window only when the next 1/fps s of arm time has begun.

        Args:
            params: Constants of the arm.
            state: x = [theta_a, omega_a, theta_s, omega_s] (rad, rad/s).
            reference_angle: Reference joint angle [rad].
            time: Time since the move's start [s].

        Returns:
            A new frame of shape (480, 640, 3) for "rgb_array", None for "human".

        Raises:
            DependencyNotInstalled: If there is no OpenGL to draw with.
        """
        if self._window is not None and not self._window.begin_frame(time):
            return None
        if params != self._params:
            self._load(params)
        # An integration that ran away has no posture: the stretched arm stands for it.
        write_state(self._data, params, state if np.isfinite(state).all() else np.zeros(4))
        place_hand(self._data, params, reference_angle)
        self._renderer.update_scene(self._data, CAMERA)
        frame = self._renderer.render()
        return frame if self._window is None else self._window.show(frame)

    def _load(self, params: ArmParams) -> None:
        self._free()
        model = load_model(params)
        if not _no_opengl:
            try:
                self._renderer = mujoco.Renderer(model, HEIGHT, WIDTH)
            except Exception as error:  # what it raises depends on the platform's OpenGL
                _no_opengl.append(error)
        if _no_opengl:
            raise DependencyNotInstalled(
                "MuJoCo finds no OpenGL to draw with: on a machine without a display set MUJOCO_GL=egl (or osmesa) "
                'before Python starts, and install its library; or use model="lagrangian", which pygame draws'
            ) from _no_opengl[0]
        self._params, self._data = params, mujoco.MjData(model)

    def _free(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = self._params = self._data = None

    def clear(self) -> None:
        """Begin a new move."""
        if self._window is not None:
            self._window.restart()

    def close(self) -> None:
        """Close the window, if there is one, and free the graphics memory."""
        self._free()
        if self._window is not None:
            self._window.close()
