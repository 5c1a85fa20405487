import copy
import math
import subprocess
import sys
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

from beltarm_env import ArmParams
from beltarm_env.rendering.renderer import Renderer

pygame = pytest.importorskip("pygame")

PARAMS = ArmParams()
GREEN, VERMILION, ORANGE = (0, 158, 115), (213, 94, 0), (230, 159, 0)
ARM_COLORS = (0, 114, 178), (86, 180, 233), VERMILION, ORANGE
ARM_ROWS = slice(240, 440)  # between the magnifier and the legend
MAGNIFIER = slice(36, 230), slice(430, 624)


def state(joint_angle: float, torsion: float = 0.0) -> NDArray[np.float64]:
    return np.array([PARAMS.gear_ratio * joint_angle, 0.0, torsion, 0.0])


def frame(
    joint_angle: float, torsion: float = 0.0, reference: float = 0.0, params: ArmParams = PARAMS
) -> NDArray[np.uint8]:
    picture = Renderer("rgb_array", 50).draw(params, state(joint_angle, torsion), reference, 0.0)
    assert picture is not None
    return picture


def near(picture: NDArray[np.uint8], color: tuple[int, int, int], tolerance: int = 8) -> NDArray[np.bool_]:
    return np.abs(picture.astype(int) - color).max(axis=2) <= tolerance


def middle(picture: NDArray[np.uint8], color: tuple[int, int, int]) -> NDArray[np.float64]:
    """Middle (column, row) of what has a color, below the magnifier and above the legend."""
    rows, columns = np.nonzero(near(picture[ARM_ROWS], color))
    assert rows.size, f"nothing has the color {color}"
    return np.array([(columns.min() + columns.max()) / 2, ARM_ROWS.start + (rows.min() + rows.max()) / 2])


def ring(reference: float) -> NDArray[np.float64]:
    """Middle of the ring at the reference tip, which is the rightmost green thing there."""
    green = near(frame(1.4, reference=reference)[ARM_ROWS], GREEN)
    right = np.nonzero(green.any(axis=0))[0].max()
    rows = np.nonzero(green[:, right - 12 : right - 6].any(axis=1))[0]
    radius = (rows.max() - rows.min()) / 2
    return np.array([right - radius, ARM_ROWS.start + rows.min() + radius])


def test_frame_is_a_fresh_contiguous_writable_image():
    renderer = Renderer("rgb_array", 50)
    first = renderer.draw(PARAMS, state(0.5), 0.5, 0.0)
    second = renderer.draw(PARAMS, state(0.5), 0.5, 0.0)
    assert first is not None and second is not None
    assert first.shape == (480, 640, 3) and first.dtype == np.uint8
    assert first.flags.c_contiguous and first.flags.writeable
    assert not np.shares_memory(first, second)
    np.testing.assert_array_equal(first, second)


def test_renderers_side_by_side_do_not_touch_each_other():
    np.testing.assert_array_equal(frame(0.7, 0.03, 0.6), frame(0.7, 0.03, 0.6))
    one, other = Renderer("rgb_array", 50), Renderer("rgb_array", 50)
    for renderer, angle in ((one, 0.2), (other, 1.2)):
        renderer.draw(PARAMS, state(angle), angle + 0.02, 0.0)
    one.close()
    np.testing.assert_array_equal(
        other.draw(PARAMS, state(1.2), 1.22, 0.0), frame(1.2, reference=1.22), "trace of another arm"
    )


@pytest.mark.parametrize("change", [{"joint_angle": 0.52}, {"torsion": 0.01}, {"reference": 0.52}])
def test_frame_shows_every_part_of_the_posture(change: dict[str, Any]):
    before: dict[str, Any] = {"joint_angle": 0.5, "torsion": 0.0, "reference": 0.5}
    assert (frame(**before)[ARM_ROWS] != frame(**{**before, **change})[ARM_ROWS]).any()


def test_reference_ring_and_tip_are_where_geometry_says():
    # Reference tips 0.6 m and 0.35 m along the x axis fix scale and origin.
    far, near_by = ring(0.0), ring(math.pi / 3)
    scale = (far[0] - near_by[0]) / 0.25
    origin = far - [0.6 * scale, 0.0]
    assert scale > 600, "the arm should fill the frame"
    for angle in (0.3, math.pi / 4, math.pi / 2):
        expected = origin[0] + scale * (0.5 * math.cos(angle) + 0.1), origin[1]
        np.testing.assert_allclose(ring(angle), expected, atol=1.0, err_msg=f"reference tip at {angle} rad")
    for angle, torsion in ((0.0, 0.08), (0.0, -0.1), (0.8, 0.08), (1.5, -0.08)):
        phi = angle - torsion
        reach = 0.5 * math.cos(phi) + 0.1
        expected = origin + scale * np.array([reach * math.cos(torsion), -reach * math.sin(torsion)])
        drawn = middle(frame(angle, torsion, reference=0.5), VERMILION)
        np.testing.assert_allclose(drawn, expected, atol=1.5, err_msg=f"tip at {angle} rad, torsion {torsion} rad")


def test_hand_keeps_its_length_under_torsion():
    picture = frame(0.8, 0.1, reference=1.5, params=ArmParams(payload_mass=0.2))
    scale = (ring(0.0)[0] - ring(math.pi / 3)[0]) / 0.25
    hand = middle(picture, ORANGE) - middle(picture, VERMILION)
    assert np.hypot(*hand) == pytest.approx(0.1 * scale, abs=2.0)


def test_payload_is_drawn_only_if_there_is_one():
    assert not near(frame(0.8), ORANGE).any()
    assert near(frame(0.8, params=ArmParams(payload_mass=0.1)), ORANGE).any()


@pytest.mark.parametrize("params", [PARAMS, ArmParams(hand_length=0.0), ArmParams(link_length=0.4, hand_length=0.3)])
def test_arm_stays_in_the_frame_and_off_the_magnifier(params):
    for angle in np.linspace(-0.25, math.pi / 2 + 0.25, 7):
        for torsion in (-0.1, 0.0, 0.1):
            if not -0.25 <= angle - torsion <= math.pi / 2 + 0.25:
                continue
            picture = frame(angle, torsion, reference=min(max(angle, 0.0), math.pi / 2), params=params)
            border = np.ones((480, 640), dtype=bool)
            border[4:-4, 4:-4] = False
            assert (picture[border] == picture[0, 0]).all(), (angle, torsion)
            around = np.zeros((480, 640), dtype=bool)
            around[30:236, 424:630] = True
            around[MAGNIFIER] = False
            for color in ARM_COLORS:
                assert not near(picture, color)[around].any(), (angle, torsion, color)
            upper = picture[30:120, :424]
            assert (upper == upper[0, 0]).all(), "the arm should stay below the text"


def test_magnifier_shows_millimetres_and_clamps_the_tip():
    def marker(torsion: float) -> NDArray[np.float64]:
        rows, columns = np.nonzero(near(frame(0.0, torsion)[MAGNIFIER], VERMILION))
        return np.array([columns.mean(), rows.mean()])

    per_mm = 194 / 60
    lift = marker(0.0) - marker(0.02)
    # At 0.02 rad the tip is 0.6 m * sin(0.02 rad) = 12 mm above the reference tip.
    assert lift[1] == pytest.approx(12.0 * per_mm, abs=1.0)
    assert marker(0.09)[1] == pytest.approx(6, abs=1.5), "beyond 30 mm the tip stays at the edge"


def test_trace_grows_fades_and_is_forgotten():
    renderer = Renderer("rgb_array", 50)

    def draw(torsion: float, time: float) -> NDArray[np.uint8]:
        picture = renderer.draw(PARAMS, state(0.0, torsion), 0.0, time)
        assert picture is not None
        return picture

    def traced(picture: NDArray[np.uint8]) -> bool:
        plain = Renderer("rgb_array", 50).draw(PARAMS, state(0.0), 0.0, time)
        return bool((picture[MAGNIFIER] != np.asarray(plain)[MAGNIFIER]).any())

    draw(0.03, 0.1)
    draw(-0.03, 0.2)
    time = 0.3
    assert traced(draw(0.0, time))
    renderer.clear()
    assert not traced(draw(0.0, time))
    draw(0.03, 0.35)
    time = 0.8
    assert not traced(draw(0.0, time)), "0.45 s are too long ago"
    time = 0.01
    assert not traced(draw(0.0, time)), "time went back: a new episode"


@pytest.mark.parametrize(
    "x", [[1e300, 0, 0, 0], [0, 0, 1e6, 0], [math.nan, 0, 0, 0], [0, 0, math.inf, 0], [0, 0, math.pi, 0]]
)
def test_absurd_states_do_not_crash(x):
    assert Renderer("rgb_array", 50).draw(PARAMS, np.array(x, dtype=float), 0.5, 0.0) is not None


def test_renderer_can_be_copied_with_its_trace():
    renderer = Renderer("rgb_array", 50)
    renderer.draw(PARAMS, state(0.5, 0.02), 0.5, 0.0)
    twin = copy.deepcopy(renderer)
    one, other = (np.asarray(each.draw(PARAMS, state(0.5), 0.5, 0.1)) for each in (renderer, twin))
    np.testing.assert_array_equal(one, other)


def test_missing_pygame_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(gym.error.DependencyNotInstalled, match=r'pip install "beltarm-env\[render\]"'):
        Renderer("rgb_array", 50)


def test_arrays_need_no_display_and_close_twice():
    pygame.display.quit()
    renderer = Renderer("rgb_array", 50)
    renderer.draw(PARAMS, state(0.5), 0.5, 0.0)
    assert not pygame.display.get_init()
    renderer.close()
    renderer.close()


class TestWindow:
    @pytest.fixture(autouse=True)
    def _headless(self, monkeypatch):
        monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
        yield
        pygame.display.quit()

    def test_shows_what_rgb_array_returns(self):
        renderer = Renderer("human", 50)
        assert renderer.draw(PARAMS, state(0.5, 0.01), 0.5, 0.0) is None
        shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
        np.testing.assert_array_equal(shown, frame(0.5, 0.01, 0.5))
        renderer.close()
        renderer.close()
        assert not pygame.display.get_init()

    def test_updates_once_per_frame_of_arm_time(self, monkeypatch):
        renderer = Renderer("human", 50)
        flips = []
        monkeypatch.setattr(pygame.display, "flip", lambda: flips.append(1))
        for step in range(50):
            renderer.draw(PARAMS, state(0.5), 0.5, 0.0015 * step)
        assert len(flips) == 4  # frames begin at 0, 20, 40 and 60 of 73.5 ms
        renderer.clear()
        renderer.draw(PARAMS, state(0.5), 0.5, 0.0)
        assert len(flips) == 5
        renderer.close()

    def test_closing_the_window_does_not_stop_the_arm(self):
        renderer = Renderer("human", 50)
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        for time in (0.0, 0.1, 0.2):
            assert renderer.draw(PARAMS, state(0.5), 0.5, time) is None
        assert not pygame.display.get_init()
        renderer.close()

    def test_two_windows_survive_each_other(self):
        one, other = Renderer("human", 50), Renderer("human", 50)
        one.close()
        other.draw(PARAMS, state(0.5), 0.5, 0.0)
        other.close()

    def test_episode_runs_in_real_time(self):
        env = gym.make("BeltArm-v0", render_mode="human")
        env.reset(seed=1)
        for _ in range(50):
            env.step(env.action_space.sample())
        env.reset()
        env.close()
        env.close()

    def test_env_checker_finds_nothing(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            check_env(gym.make("BeltArm-v0", render_mode="human").unwrapped)


def test_recording_an_episode():
    env = gym.make("BeltArm-v0", render_mode="rgb_array")
    assert env.metadata["render_fps"] > 0
    env.reset(seed=3)
    frames = []
    for step in range(60):
        env.step(np.array([0.8], dtype=np.float32))
        if step % 13 == 0:
            frames.append(env.render())
    env.close()
    assert all((before != after).any() for before, after in pairwise(frames))


RECORDING = """
import beltarm_env, gymnasium
from gymnasium.wrappers import RecordVideo
env = RecordVideo(gymnasium.make("BeltArm-v0", render_mode="rgb_array"), "films")
env.reset(seed=0)
over = False
while not over:
    _, _, terminated, truncated, _ = env.step(0 * env.action_space.sample())
    over = terminated or truncated
env.close()
"""


def test_gymnasium_films_an_episode_in_real_time(tmp_path: Path):
    pytest.importorskip("moviepy")
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    result = subprocess.run([sys.executable, "-c", RECORDING], cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    (film,) = (tmp_path / "films").glob("*.mp4")
    about = next(ffmpeg.read_frames(str(film)))
    assert about["size"] == (640, 480)
    assert about["duration"] == pytest.approx(1.8, abs=0.05)


def test_frame_does_not_depend_on_earlier_episodes():
    env = gym.make("BeltArm-v0", render_mode="rgb_array")
    firsts = []
    for _ in range(2):
        env.reset(seed=5)
        firsts.append(env.render())
        env.step(np.array([1.0], dtype=np.float32))
        env.render()
    env.close()
    np.testing.assert_array_equal(*firsts)


def test_env_checker_finds_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make("BeltArm-v0", render_mode="rgb_array").unwrapped)
