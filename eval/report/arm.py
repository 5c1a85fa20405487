"""Labelled drawing of the arm, for the report and the README: `arm.svg` beside this file, filled with the geometry."""

from __future__ import annotations

import math

from beltarm_env.arm import ArmParams
from beltarm_env.rendering.renderer import Point, posture
from eval.report.templates import template

_WIDTH, _HEIGHT = 640, 430
_SHOULDER = (140.0, 236.0)
_SCALE = 980.0  # pixels per metre
_ANGLE = math.radians(52.0)  # of joint 1
_SWING = 0.07  # torsion of the belt in the dotted postures [rad]
_PULLEYS = (24.0, 12.0)  # radii at joints 1 and 2: two to one, so that link 2 turns back by twice the angle
_ALT = (
    "Labelled drawing of the arm. Under the shoulder, on one shaft: encoder, motor, harmonic drive. Link 1 leads up to "
    "the elbow; the belt runs around it; link 2 leads back down to the payload on the line through the shoulder, and "
    "the hand goes on along that line to the arm's end, which swings across it."
)


def arm_drawing() -> str:
    """Draw the arm as an SVG that is light or dark with the page or the viewer that shows it."""
    arm = ArmParams()
    shoulder, elbow, wrist, tip = map(_place, posture(arm, _ANGLE, 0.0))
    swinging = [[_place(point) for point in posture(arm, _ANGLE, torsion)] for torsion in (_SWING, -_SWING)]
    one, two = _middle(shoulder, elbow), _middle(elbow, wrist)
    return template("arm.svg", at=_text).render(
        width=_WIDTH,
        height=_HEIGHT,
        alt=_ALT,
        shoulder=shoulder,
        elbow=elbow,
        wrist=wrist,
        tip=tip,
        swinging=swinging,
        belt=_belt(shoulder, elbow),
        swing=_double_arrow(swinging[0][3], swinging[1][3]),
        drive=[
            (f"harmonic drive, {arm.gear_ratio:g} : 1", 50, 26, 32),
            ("motor", 88, 46, 26),
            ("encoder: the only sensor", 146, 24, 18),
        ],
        labels=[
            (_beside(one, -66, -6), "end", "belt, elastic"),
            (_beside(elbow, -70, 6), "end", "link 1"),
            (_beside(two, 50, -6), "start", "link 2"),
            (_beside(wrist, -10, 40), "middle", "payload"),
            (_beside(wrist, 66, 27), "middle", "hand"),
            ((_WIDTH - 12, swinging[0][3][1] - 40), "end", "the arm's end"),
            ((_WIDTH - 12, swinging[0][3][1] - 14), "end", "vibrates"),
        ],
        leaders=[
            (_beside(one, -60, -11), _beside(one, -14, -11)),
            (_beside(elbow, -64, 0), _beside(elbow, -6, 8)),
            (_beside(two, 44, -12), _beside(two, 0, -8)),
        ],
    )


def _place(point: Point) -> Point:
    """Place on the drawing of a point of the arm [m], to a tenth of a pixel."""
    return round(_SHOULDER[0] + _SCALE * point[0], 1), round(_SHOULDER[1] - _SCALE * point[1], 1)


def _middle(one: Point, other: Point) -> Point:
    return (one[0] + other[0]) / 2, (one[1] + other[1]) / 2


def _beside(point: Point, right: float, down: float) -> Point:
    return point[0] + right, point[1] + down


def _text(point: Point) -> str:
    return f"{point[0]:g} {point[1]:g}"


def _belt(start: Point, end: Point) -> str:
    """Outline of a belt around two pulleys: two straight runs that touch both, and an arc about each."""
    x, y = end[0] - start[0], end[1] - start[1]
    large, small = _PULLEYS
    along, lean = math.atan2(y, x), math.acos((large - small) / math.hypot(x, y))
    touching = [
        (centre[0] + radius * math.cos(along + side * lean), centre[1] + radius * math.sin(along + side * lean))
        for centre, radius, side in ((start, large, -1), (end, small, -1), (end, small, 1), (start, large, 1))
    ]
    one, two, three, four = (f"{px:.1f} {py:.1f}" for px, py in touching)
    return f"M{one}L{two}A{small:g} {small:g} 0 0 1 {three}L{four}A{large:g} {large:g} 0 1 1 {one}Z"


def _double_arrow(upper: Point, lower: Point) -> str:
    """Double arrow between the ends of two swung arms, beside them."""
    x = max(upper[0], lower[0]) + 14
    top, bottom = upper[1], lower[1]
    heads = f"M{x - 5:g} {top + 8:g}L{x:g} {top:g}l5 8M{x - 5:g} {bottom - 8:g}L{x:g} {bottom:g}l5 -8"
    return f"M{x:g} {top:g}V{bottom:g}{heads}"
