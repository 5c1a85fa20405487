"""Whatever the arm, the move and the torque: numbers within their bounds."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from properties import examples

from beltarm_env import EPISODE_STEPS, BeltArmEnv, BeltArmVectorEnv
from beltarm_env.arm import FIELDS, bounds_of
from beltarm_env.observation import bounds
from beltarm_env.task.cost import MAX_COST

MOVE = {"start": 0.3, "goal": 1.2, "duration": 1.0, "ramp_time": 0.3}
SPREAD = {
    **{"gear_ratio": (1, 1000), "link_length": (0.01, 2), "hand_length": (0.01, 2), "motor_inertia": (1e-7, 1e-2)},
    **{"motor_viscous_friction": (1e-6, 1e-1), "coulomb_friction": (1e-5, 1), "arm_inertia": (1e-4, 10)},
    **{"arm_inertia_swing": (1e-4, 10), "payload_mass": (1e-3, 20), "belt_stiffness": (0.1, 1e6)},
    **{"belt_damping_ratio": (1e-4, 2), "torque_limit": (1e-3, 10), "stribeck_speed": (0.11, 900)},
    **{"torque_ripple": (1e-4, 1), "kinematic_error": (1e-6, 9e-3), "belt_stiffening_torsion": (2e-4, 0.9)},
}


def values_of(name: str) -> st.SearchStrategy[float]:
    """Values of a parameter; nothing, too, where it may be nothing."""
    bound = bounds_of(name)
    if name == "torque_ripple_order":
        return st.integers(1, 100).map(float)
    values = st.floats(bound.low, bound.high)
    if name in SPREAD:
        values = st.floats(*map(math.log, SPREAD[name])).map(math.exp)
    return values if bound.low > 0 or (bound.low == 0 and bound.above) else st.just(0.0) | values


@examples(60, shrink=False)
@given(
    arms=st.lists(st.fixed_dictionaries({name: values_of(name) for name in FIELDS}), min_size=1, max_size=3),
    motion=st.none() | st.tuples(st.floats(0, 1.5), st.floats(-2000, 2000), st.floats(-1, 1), st.floats(-100, 100)),
    move=st.just({})
    | st.fixed_dictionaries(
        {"start": st.floats(0, 0.7), "goal": st.floats(1, math.pi / 2), "duration": st.floats(1, 1.5)}
    ),
    levels=st.lists(st.floats(-3, 3), min_size=1, max_size=8),
    sensors=st.sampled_from(["encoder", "tip", "full", "accelerometer"]),
    delay=st.floats(0, 2),
    profile=st.sampled_from(["trapezoid", "scurve", "quintic"]),
    seed=st.integers(0, 2**31),
)
def test_never_a_nan_and_always_within_bounds(
    arms: list[dict[str, float]],
    motion: tuple[float, ...] | None,
    move: dict[str, float],
    levels: list[float],
    sensors: Any,
    delay: float,
    profile: Any,
    seed: int,
):
    envs = BeltArmVectorEnv(len(arms), sensors=sensors, delay=delay, profile=profile)
    options: dict[str, Any] = {"params": {name: [arm[name] for arm in arms] for name in FIELDS}, "move": move}
    if motion is not None:
        joint, *rest = motion
        options["state"] = [[joint * arm["gear_ratio"], *rest] for arm in arms]
    try:
        returned: list[tuple[Any, ...]] = [envs.reset(seed=seed, options=options)]
    except ValueError as error:
        assume("integrat" not in str(error) and "joint and arm angle within" not in str(error))
        raise
    returned += [envs.step(np.full((len(arms), 1), level)) for level in levels for _ in range(10)]
    assert (np.abs([result[0] for result in returned]) <= bounds(sensors)).all(), "beyond the bounds, or not a number"
    rewards = np.stack([result[1] for result in returned[1:]])
    assert ((rewards <= 0) & (rewards >= -MAX_COST * EPISODE_STEPS)).all()
    assert all(np.isfinite(array.astype(np.float64)).all() for result in returned for array in result[-1].values())
    assert np.isfinite(envs.state).all()


HEAVY_SWING = {
    **{"gear_ratio": 598.0, "link_length": 1.38, "motor_inertia": 4.68e-7, "motor_viscous_friction": 5.52e-6},
    **{"coulomb_friction": 0.0, "arm_inertia": 1.48e-4, "arm_inertia_swing": 1.64, "belt_stiffness": 31900.0},
    **{"belt_damping_ratio": 0.0, "torque_limit": 4.41},
}
WILD: dict[str, dict[str, Any]] = {
    "heavy swing, from rest": {"params": HEAVY_SWING, "move": {"start": 0.8, "goal": 1.4}},
    "torn apart": {"params": {"torque_limit": 1e6, "belt_stiffness": 40.0}, "move": MOVE},
    "fast torsion": {"state": [60.0, 0.0, 0.0, 1e5]},
    "fast motor": {"state": [60.0, 1e9, 0.0, 0.0]},
}


@pytest.mark.filterwarnings("ignore:.* encountered in:RuntimeWarning")  # of NumPy, where kernels are plain Python
@pytest.mark.parametrize("options", WILD.values(), ids=WILD)
def test_motion_too_wild_to_integrate_is_refused_or_ends_without_a_nan(options: dict[str, Any]):
    env, over = BeltArmEnv(sensors="full"), False
    try:
        observation, _ = env.reset(seed=0, options=options)
    except ValueError as error:
        assert "state" in str(error)
        return
    while not over:
        observation, reward, terminated, truncated, info = env.step(-np.ones(1, np.float32))
        over = terminated or truncated
        assert observation in env.observation_space
        assert -MAX_COST * EPISODE_STEPS <= reward <= 0
        assert np.isfinite([*info.values(), *env.state]).all()
