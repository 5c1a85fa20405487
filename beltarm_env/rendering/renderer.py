"""Picture of the arm: its posture true to scale, and a magnifier for the millimetres that the task is about.

Link 1 leads from the origin to l (cos(theta_1), sin(theta_1)), link 2 on to 2 l cos(phi) (cos(theta_s), sin(theta_s)),
and the hand goes on from there by l_3 in the direction theta_s. The reference is the same with theta_s = 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from beltarm_env.arm import ArmParams
from beltarm_env.arrays import Floats
from beltarm_env.rendering.window import Window, import_pygame

if TYPE_CHECKING:
    import pygame

Point = tuple[float, float]
Color = Sequence[int]

WIDTH, HEIGHT = 640, 480
TRACE_SECONDS = 0.4
MAGNIFIED_MM = 30.0  # from the magnifier's middle to its edge

# The palette of Okabe and Ito, which colour-blind people can tell apart, on a light ground.
_BLUE, _SKY, _GREEN, _VERMILION, _ORANGE = (0, 114, 178), (86, 180, 233), (0, 158, 115), (213, 94, 0), (230, 159, 0)
_PAPER, _WHITE, _PALE, _GREY, _INK = (246, 246, 244), (255, 255, 255), (212, 212, 210), (150, 150, 150), (35, 35, 35)
_GHOST, _BELT, _MOTOR = (214, 238, 229), (230, 230, 228), (180, 180, 178)

_FINER = 3  # pygame has no anti-aliased thick lines: draw larger, then scale down
_SHOULDER = (122.0, 342.0)
_LONGEST, _HIGHEST = 482.0, 201.0  # pixels for the stretched arm, and for link 1 upright
_INSET, _SIDE = (430.0, 36.0), 194.0  # where no posture within the workspace comes
_BARS = (7.0, 5.0, 3.5)  # half widths of link 1, link 2, hand
_PULLEY, _TAPER = 16.0, 6.5  # radius at joint 1, and how much less at joint 2
_MOUNT = 34.0  # side of the motor, which hangs below the shoulder
_LEFT, _READOUT_TOP, _LEGEND_TOP = 16.0, 14.0, 448.0


class Renderer:
    """Draws one arm, into a window or into arrays."""

    def __init__(self, render_mode: Literal["human", "rgb_array"], fps: int) -> None:
        """Set up drawing; "human" opens the window.

        Args:
            render_mode: "human" or "rgb_array".
            fps: Frames per second of arm time that the window shows [1/s].

        Raises:
            DependencyNotInstalled: If pygame is missing.
        """
        import_pygame()
        self._trace: list[tuple[float, Point]] = []
        self._window = Window("BeltArm-v0", (WIDTH, HEIGHT), fps) if render_mode == "human" else None

    def draw(self, params: ArmParams, state: Floats, reference_angle: float, time: float) -> NDArray[np.uint8] | None:
        """Draw the arm; in a window only when the next 1/fps s of arm time has begun.

        Args:
            params: Constants of the arm.
            state: x = [theta_a, omega_a, theta_s, omega_s] (rad, rad/s).
            reference_angle: Reference joint angle [rad].
            time: Time since the move's start [s]; the trace forgets what lies after it.

        Returns:
            A new frame of shape (480, 640, 3) for "rgb_array", None for "human".
        """
        motor, torsion = (float(state[k]) if math.isfinite(state[k]) else 0.0 for k in (0, 2))
        joint_angle = motor / params.gear_ratio
        deviation = params.kinematic_error * math.sin(2 * motor + params.kinematic_error_phase)
        arm, reference = posture(params, joint_angle, torsion, deviation), posture(params, reference_angle, 0.0)
        error = 1e3 * (arm[3][0] - reference[3][0]), 1e3 * (arm[3][1] - reference[3][1])
        self._trace = [past for past in self._trace if time - TRACE_SECONDS <= past[0] < time]
        self._trace.append((time, error))
        if self._window is not None and not self._window.begin_frame(time):
            return None
        canvas = _Canvas()
        _draw_arms(canvas, params, arm, reference)
        _draw_magnifier(canvas, [(time - then, at) for then, at in self._trace])
        canvas.text(f"time {time:.3f} s", (_LEFT, _READOUT_TOP))
        canvas.text(f"joint {math.degrees(joint_angle):z.1f}°", (130, _READOUT_TOP))
        canvas.text(f"tip error {math.hypot(*error):.2f} mm", (230, _READOUT_TOP))
        _draw_legend(canvas, params.payload_mass)
        pixels = bytearray(canvas.pygame.image.tobytes(canvas.finish(), "RGB"))
        frame = np.frombuffer(pixels, np.uint8).reshape(HEIGHT, WIDTH, 3)
        return frame if self._window is None else self._window.show(frame)

    def clear(self) -> None:
        """Forget the trace of the tip, for a new move."""
        self._trace.clear()
        if self._window is not None:
            self._window.restart()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()


class _Canvas:
    """Surface to draw on in pixels of the finished frame, finer than it."""

    def __init__(self) -> None:
        import pygame

        pygame.font.init()
        self.pygame = pygame
        self._font = pygame.font.Font(None, 19 * _FINER)
        self._surface = pygame.Surface((WIDTH * _FINER, HEIGHT * _FINER), 0, 32)
        self._surface.fill(_PAPER)

    def finish(self) -> pygame.Surface:
        return self.pygame.transform.smoothscale(self._surface, (WIDTH, HEIGHT))

    def disc(self, color: Color, center: Point, radius: float, rim: float = 0.0) -> None:
        """Draw a disc, or a ring of width `rim`."""
        self.pygame.draw.circle(self._surface, color, _fine(center), radius * _FINER, round(rim * _FINER))

    def bar(self, color: Color, start: Point, end: Point, half_width: float = 0.4, taper: float = 0.0) -> None:
        """Draw a bar with round ends, at its end `taper` slimmer on each side; by default a thin line."""
        (ax, ay), (bx, by) = _fine(start), _fine(end)
        factor = _FINER / (math.hypot(bx - ax, by - ay) or 1.0)
        x, y, w, v = (ay - by) * factor, (bx - ax) * factor, half_width, half_width - taper
        corners = (ax + w * x, ay + w * y), (bx + v * x, by + v * y), (bx - v * x, by - v * y), (ax - w * x, ay - w * y)
        self.pygame.draw.polygon(self._surface, color, corners)
        self.disc(color, start, half_width)
        self.disc(color, end, half_width - taper)

    def square(self, color: Color, corner: Point, side: float, rim: float = 0.0) -> None:
        rectangle = (*_fine(corner), side * _FINER, side * _FINER)
        self.pygame.draw.rect(self._surface, color, rectangle, round(rim * _FINER))

    def clip(self, corner: Point, side: float) -> None:
        self._surface.set_clip((*_fine(corner), side * _FINER, side * _FINER))

    def text(self, text: str, corner: Point) -> float:
        """Write from a top left corner on; returns where the text ends."""
        image = self._font.render(text, True, _INK)
        self._surface.blit(image, _fine(corner))
        return corner[0] + image.get_width() / _FINER


def _fine(point: Point) -> Point:
    # Cut well outside the frame: pygame overflows at far points.
    x, y = (min(max(value, -2e3), 2e3) * _FINER for value in point)
    return x, y


def posture(params: ArmParams, joint_angle: float, torsion: float, deviation: float = 0.0) -> list[Point]:
    """Return joints 1, 2, 3 and tip [m] at theta_a / G, theta_s and the joint's kinematic error [rad]."""
    length, along, across = params.link_length, math.cos(torsion + deviation), math.sin(torsion + deviation)
    joint_3 = 2 * length * math.cos(joint_angle - torsion)
    tip = joint_3 + params.hand_length
    elbow = length * math.cos(joint_angle + deviation), length * math.sin(joint_angle + deviation)
    return [(0.0, 0.0), elbow, (joint_3 * along, joint_3 * across), (tip * along, tip * across)]


def _draw_arms(canvas: _Canvas, params: ArmParams, arm: Sequence[Point], reference: Sequence[Point]) -> None:
    scale = min(_LONGEST / (2 * params.link_length + params.hand_length), _HIGHEST / params.link_length)
    arm, ghost = [[(_SHOULDER[0] + scale * x, _SHOULDER[1] - scale * y) for x, y in part] for part in (arm, reference)]
    half, (x, y) = scale * MAGNIFIED_MM / 1e3, ghost[3]
    canvas.square(_PALE, (x - half, y - half), 2 * half, 1)
    canvas.bar(_PALE, (x - half, y - half), (_INSET[0], _INSET[1] + _SIDE))
    canvas.bar(_PALE, (x + half, y - half), (_INSET[0] + _SIDE, _INSET[1] + _SIDE))
    canvas.bar(_GREY, (_LEFT, _SHOULDER[1]), (WIDTH - _LEFT, _SHOULDER[1]))
    canvas.square(_MOTOR, (arm[0][0] - _MOUNT / 2, arm[0][1]), _MOUNT)
    canvas.text("motor", (arm[0][0] - _MOUNT / 2 - 1, arm[0][1] + _MOUNT + 4))
    canvas.bar(_INK, arm[0], arm[1], _PULLEY + 0.7, _TAPER)
    canvas.bar(_BELT, arm[0], arm[1], _PULLEY - 0.7, _TAPER)
    for colors, points, rim in ([_GREEN] * 3, ghost, 1.0), ([_GHOST] * 3, ghost, 0.0), ([_BLUE, _SKY, _INK], arm, 0.0):
        for color, start, end, half_width in zip(colors, points[:3], points[1:], _BARS, strict=True):
            canvas.bar(color, start, end, half_width + rim)
    for joint in arm[:3]:
        canvas.disc(_INK, joint, 5)
        canvas.disc(_WHITE, joint, 2.5)
    if params.payload_mass > 0:
        canvas.disc(_ORANGE, arm[2], 8)
    canvas.disc(_GREEN, ghost[3], 9, 2.2)
    canvas.disc(_VERMILION, arm[3], 4)


def _draw_magnifier(canvas: _Canvas, trace: Sequence[tuple[float, Point]]) -> None:
    """Draw errors of the tip [mm] with their age [s], oldest first, around the reference tip."""
    half, (left, top) = _SIDE / 2, _INSET
    scale, x, y, right = half / MAGNIFIED_MM, left + half, top + half, left + _SIDE
    canvas.square(_WHITE, _INSET, _SIDE)
    for shift in (-20 * scale, -10 * scale, 10 * scale, 20 * scale, 0):
        color = _PALE if shift else _GREY
        canvas.bar(color, (x + shift, top), (x + shift, top + _SIDE))
        canvas.bar(color, (left, y + shift), (right, y + shift))
    canvas.disc(_GREEN, (x, y), 9, 2.2)
    canvas.clip(_INSET, _SIDE)
    points = [(x + scale * dx, y - scale * dy) for _, (dx, dy) in trace]
    for (age, _), start, end in zip(trace, points, points[1:], strict=False):
        fade = 0.85 * age / TRACE_SECONDS
        canvas.bar([round(part + fade * (255 - part)) for part in _VERMILION], start, end, 1.0)
    canvas.clip((0, 0), WIDTH)
    (tip_x, tip_y), room = points[-1], half - 6
    canvas.disc(_VERMILION, (min(max(tip_x, x - room), x + room), min(max(tip_y, y - room), y + room)), 5)
    canvas.square(_GREY, _INSET, _SIDE, 1)
    canvas.text("tip, magnified", (left, _READOUT_TOP))
    canvas.text("10 mm", (right - 42, _READOUT_TOP))
    canvas.bar(_INK, (right - 50 - 10 * scale, _READOUT_TOP + 7), (right - 50, _READOUT_TOP + 7), 1.0)


def _draw_legend(canvas: _Canvas, payload: float) -> None:
    y = _LEGEND_TOP + 7
    canvas.bar(_GREEN, (_LEFT + 7, y), (_LEFT + 27, y), 6)
    canvas.bar(_GHOST, (_LEFT + 7, y), (_LEFT + 27, y), 5)
    x = canvas.text("reference", (_LEFT + 40, _LEGEND_TOP)) + 28
    canvas.disc(_GREEN, (x, y), 9, 2.2)
    x = canvas.text("its tip", (x + 15, _LEGEND_TOP)) + 24
    canvas.disc(_VERMILION, (x, y), 5)
    x = canvas.text("tip", (x + 11, _LEGEND_TOP)) + 24
    canvas.bar(_INK, (x, y), (x + 20, y), 6.7, 2.0)
    canvas.bar(_BELT, (x, y), (x + 20, y), 5.3, 2.0)
    x = canvas.text("belt", (x + 32, _LEGEND_TOP)) + 27
    if payload > 0:
        canvas.disc(_ORANGE, (x, y), 8)
        canvas.text(f"payload {payload:.2f} kg", (x + 14, _LEGEND_TOP))
