"""Frames of the arm: where geometry says, independent of each other, on arrays and in a window."""

import copy
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo
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


def frame(joint_angle: float, torsion: float = 0.0, reference: float = 0.0, params: ArmParams = PARAMS) -> Any:
    return Renderer("rgb_array", 50).draw(params, state(joint_angle, torsion), reference, 0.0)


def near(picture: NDArray[np.uint8], color: tuple[int, int, int]) -> NDArray[np.bool_]:
    return np.abs(picture.astype(int) - color).max(axis=2) <= 8


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


class TestFrame:
    def test_is_a_fresh_writable_image_of_its_own_renderer(self):
        pygame.display.quit()
        first, second = Renderer("rgb_array", 50), Renderer("rgb_array", 50)
        shown, again = (np.asarray(first.draw(PARAMS, state(0.2), 0.22, 0.0)) for _ in range(2))
        assert shown.shape == (480, 640, 3) and shown.dtype == np.uint8
        assert shown.flags.c_contiguous and shown.flags.writeable and not np.shares_memory(shown, again)
        np.testing.assert_array_equal(shown, again)
        assert not pygame.display.get_init(), "arrays need no display"
        drawn = second.draw(PARAMS, state(1.2), 1.22, 0.0)
        first.close()
        first.close()
        np.testing.assert_array_equal(drawn, frame(1.2, reference=1.22), "trace of another arm")
        twin = copy.deepcopy(second)
        frames = [each.draw(PARAMS, state(0.5), 0.5, 0.1) for each in (second, twin)]
        np.testing.assert_array_equal(frames[0], frames[1], "a copy has the trace")

    def test_reference_ring_tip_and_hand_are_where_geometry_says(self):
        # Reference tips 0.6 m and 0.35 m along the x axis fix scale and origin.
        far, near_by = ring(0.0), ring(math.pi / 3)
        scale = (far[0] - near_by[0]) / 0.25
        origin = far - [0.6 * scale, 0.0]
        assert scale > 600, "the arm should fill the frame"
        for angle in (0.3, math.pi / 2):
            expected = origin[0] + scale * (0.5 * math.cos(angle) + 0.1), origin[1]
            np.testing.assert_allclose(ring(angle), expected, atol=1.0, err_msg=f"reference tip at {angle} rad")
        for angle, torsion in ((0.0, 0.08), (0.0, -0.1), (0.8, 0.08), (1.5, -0.08)):
            reach = 0.5 * math.cos(angle - torsion) + 0.1
            expected = origin + scale * np.array([reach * math.cos(torsion), -reach * math.sin(torsion)])
            picture = frame(angle, torsion, 0.5 if angle < 1 else 0.0, ArmParams(payload_mass=0.2))
            np.testing.assert_allclose(middle(picture, VERMILION), expected, atol=1.5, err_msg=f"tip at {angle} rad")
        picture = frame(0.8, 0.1, reference=1.5, params=ArmParams(payload_mass=0.2))
        hand = middle(picture, ORANGE) - middle(picture, VERMILION)
        assert np.hypot(*hand) == pytest.approx(0.1 * scale, abs=2.0), "the hand keeps its length under torsion"
        assert not near(frame(0.8), ORANGE).any(), "no payload"

    @pytest.mark.parametrize("params", [ArmParams(hand_length=0.0), ArmParams(link_length=0.4, hand_length=0.3)])
    def test_arm_stays_in_the_frame_and_off_the_magnifier(self, params: ArmParams):
        around = np.zeros((480, 640), dtype=bool)
        around[30:236, 424:630] = True
        around[MAGNIFIER] = False
        for angle, torsion in ((-0.25, 0.0), (0.4, -0.1), (0.8, 0.1), (1.3, -0.1), (math.pi / 2 + 0.25, 0.1)):
            picture = frame(angle, torsion, reference=min(max(angle, 0.0), math.pi / 2), params=params)
            edge = np.concatenate([picture[:4].reshape(-1, 3), picture[-4:].reshape(-1, 3), picture[30:120, 0]])
            assert (edge == picture[0, 0]).all(), (angle, torsion)
            assert not any(near(picture, color)[around].any() for color in ARM_COLORS), (angle, torsion)
            assert (picture[30:120, :424] == picture[30, 0]).all(), "the arm should stay below the text"

    def test_magnifier_shows_millimetres_and_clamps_the_tip(self):
        turns = (0.0, 0.02, 0.09)
        rows = [np.nonzero(near(frame(0.0, torsion)[MAGNIFIER], VERMILION))[0].mean() for torsion in turns]
        # At 0.02 rad the tip is 0.6 m * sin(0.02 rad) = 12 mm above the reference tip; 194 pixels are 60 mm.
        assert rows[0] - rows[1] == pytest.approx(12.0 * 194 / 60, abs=1.0)
        assert rows[2] == pytest.approx(6, abs=1.5), "beyond 30 mm the tip stays at the edge"
        picture = frame(0.0, 0.015, params=ArmParams(kinematic_error=0.005, kinematic_error_phase=math.pi / 2))
        assert np.nonzero(near(picture[MAGNIFIER], VERMILION))[0].mean() == pytest.approx(rows[1], abs=0.5)

    def test_absurd_states_do_not_crash(self):
        for x in ([1e300, 0, 0, 0], [0, 0, 1e6, 0], [math.nan, 0, 0, 0], [0, 0, math.inf, 0], [0, 0, math.pi, 0]):
            assert Renderer("rgb_array", 50).draw(PARAMS, np.array(x, dtype=float), 0.5, 0.0) is not None

    def test_missing_pygame_is_named(self, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setitem(sys.modules, "pygame", None)
        with pytest.raises(gym.error.DependencyNotInstalled, match=r"beltarm-env\[render\]"):
            Renderer("rgb_array", 50)


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


@pytest.mark.usefixtures("window")
class TestWindow:
    def test_shows_the_array_and_two_survive_each_other(self):
        renderer = Renderer("human", 50)
        assert renderer.draw(PARAMS, state(0.5, 0.01), 0.5, 0.0) is None
        shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
        np.testing.assert_array_equal(shown, frame(0.5, 0.01, 0.5))
        Renderer("human", 50).close()  # which closes the one window that pygame has
        assert renderer.draw(PARAMS, state(0.5, 0.01), 0.5, 0.1) is None
        renderer.close()
        renderer.close()
        assert not pygame.display.get_init()


class TestThroughTheEnvironment:
    @pytest.mark.parametrize("mode", ["rgb_array", "human"])
    def test_env_checker_is_content(self, mode: str, window: None):
        check_env(gym.make("BeltArm-v0", render_mode=mode).unwrapped)

    def test_gymnasium_films_each_episode_anew_in_real_time(self, tmp_path: Path):
        pytest.importorskip("moviepy")
        ffmpeg = pytest.importorskip("imageio_ffmpeg")
        env = gym.make("BeltArm-v0", render_mode="rgb_array", max_episode_steps=100)
        env, frames = RecordVideo(env, str(tmp_path / "films"), lambda episode: episode == 0), []
        for _ in range(3):
            env.reset(seed=5)
            while not any(env.step(np.full(1, 0.3, np.float32))[2:4]):
                pass
            frames.append(np.asarray(env.render()))
        env.close()
        np.testing.assert_array_equal(frames[1], frames[2], "as after an episode of which each step was drawn")
        about = next(ffmpeg.read_frames(str(*tmp_path.glob("films/*-0.mp4"))))
        assert about["size"] == (640, 480)
        assert about["duration"] == pytest.approx(0.15, abs=0.03)

    def test_traces_begin_with_the_move_alone_and_in_a_batch(self):
        def last(env: Any, steps: int, drawn: int = -1) -> NDArray[np.uint8]:
            env.reset(seed=5)
            for k in range(steps):
                env.step(np.full(env.action_space.shape, 0.01, np.float32))
                if k == drawn:
                    env.render()
            return np.asarray(env.render()).reshape(480, 640, 3)

        settings: Any = {"id": "BeltArm-v0", "render_mode": "rgb_array", "moves": 2}
        single: Any = gym.make(**settings)
        batch: Any = gym.make_vec(**settings, num_envs=1, max_episode_steps=1300, autoreset_mode="SameStep")
        next_move = [last(env, 1260, drawn) for env in (single, batch) for drawn in (-1, 20)]
        after_reset = [last(env, 80) for env in (single, batch)]
        restarted = [last(batch, 1360, drawn) for drawn in (-1, 20)]
        for first, *others in (next_move, after_reset, restarted):
            assert all(np.array_equal(first, other) for other in others)
