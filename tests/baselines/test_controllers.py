"""Every classical controller by name: one arm as in any batch, separate episodes, memory in `state`, data sheets."""

import math
import re
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from commands import ROOT, python
from episodes import assert_same_in_batches, next_move
from refusals import refused

import baselines
from agents.policy.bundle import POLICIES, load_controller
from agents.residual.controller import behind_guard
from baselines import CONTROLLERS, TUNABLE, PaperController
from baselines.reading import read, sample_of
from baselines.registry import WITH_ACCELEROMETER
from beltarm_env import ArmParams, BeltArmVectorEnv, observation
from beltarm_env.rollout import rollout
from beltarm_env.task.seeds import VALIDATION
from eval.comparison import check

SEED = 5_000_000
BATCH: dict[str, Any] = {"randomization": "train"}
FELT_ARMS: dict[str, Any] = {**BATCH, "sensors": "accelerometer"}
CASES: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    **{name: (make, BATCH) for name, make in CONTROLLERS.items()},
    **{f"{name}, accelerometer": (make, FELT_ARMS) for name, make in WITH_ACCELEROMETER.items()},
    "adaptive, late coarse encoder": (CONTROLLERS["adaptive"], {**BATCH, "delay": 2, "encoder_counts": 1000}),
}
STEPS = 160
KERNELS = [name for name, make in CONTROLLERS.items() if hasattr(make(), "kernel") and name != "adaptive"]
"""That of `adaptive` takes a minute to compile: `tests/eval/exports/test_program.py` looks at it, as a program."""
MOVES = np.radians([(0, 90), (90, 0), (10, 30), (30, 10), (45, 90), (90, 60), (0, 45), (20, 80)])


def test_public_names_are_imported_on_first_use():
    code = (
        "import sys, baselines.tools.command\n"
        "print([name for name in ('control', 'matplotlib', 'baselines.registry') if name in sys.modules])\n"
        "from baselines import *\nprint(sorted(CONTROLLERS)[0], sorted(set(baselines.__all__) - set(globals())))\n"
    )
    assert python("-c", code, cwd=ROOT) == "[]\nadaptive []\n"
    refused(AttributeError, ("'baselines'", "'Paper'"), lambda: baselines.Paper)
    refused(ValueError, ("'paper'",), lambda: baselines.tuned_controller("paper"))
    refused(TypeError, ("FlatGains", "PaperGains"), lambda: CONTROLLERS["flat"](gains=PaperController().gains))


@pytest.mark.parametrize("name", CASES)
def test_every_controller_drives_an_arm_the_same_way_alone_and_in_batches(name: str):
    make, options = CASES[name]
    assert_same_in_batches(make, SEED, **options)


@pytest.mark.parametrize("name", WITH_ACCELEROMETER)
def test_with_an_accelerometer_memory_is_in_what_is_returned_and_begins_with_an_episode(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    """By the checks of a user's controller, as for the encoder alone in `tests/eval/test_check_controller.py`."""
    monkeypatch.setattr(check, "drive", partial(check.drive, sensors="accelerometer"))
    monkeypatch.setattr(check, "_STEPS", STEPS)
    known = check.record(WITH_ACCELEROMETER[name]())
    for holds in (check._afresh, check._in_the_state):
        assert holds(WITH_ACCELEROMETER[name], known) == "bit for bit"


@pytest.mark.parametrize("guarded", [False, True])
@pytest.mark.parametrize("name", [*CONTROLLERS, "student"])
def test_one_arm_is_driven_too_and_what_does_not_fit_is_refused(name: str, guarded: bool):
    """Before it gets to kernels, which would read and write beside their arrays."""
    made = CONTROLLERS[name]() if name in CONTROLLERS else load_controller(POLICIES / name / "seed0")
    predict = (behind_guard(made) if guarded else made).predict
    seen, _ = BeltArmVectorEnv(3, **BATCH).reset(seed=SEED)
    action, memory = predict(seen)
    assert np.array_equal(predict(seen[1].tolist(), None, True)[0], action[1])
    late, wrong = seen + np.float32(0.1), seen.copy()
    wrong[2, observation.index("elapsed_time")] = np.nan
    with pytest.warns(UserWarning, match="state"):
        predict(late)
    for words, arguments in (
        (("(3,", "state=None"), (np.repeat(seen, 3, axis=0), memory)),
        (("(3,", "state=None"), (seen[:1], memory)),
        (("begin with",), (seen, [1.0])),
        (("episode_start", "(3,)", "(3, 1)"), (seen, memory, np.ones((3, 1), np.bool_))),
        (("elapsed_time nan for arm 2",), (wrong,)),
        (("duration 0 for arm 0",), (np.zeros_like(seen),)),
        (("(n, 26)", "(3, 25)"), (seen[:, :25],)),
    ):
        refused(ValueError, words, partial(predict, *arguments))


def spoilt(memory: Any) -> Any:
    """Memory in which nothing is of any use."""
    if isinstance(memory, tuple):
        for part in memory:
            spoilt(part)
    else:
        memory[...] = np.nan if memory.dtype.kind == "f" else 1
    return memory


@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_is_the_law_of_one_arm(name: str):
    """The middle one of a batch of three, which sets out from rest, and again while it moves, with another payload."""
    controller = CONTROLLERS[name]()
    law, design, memory = controller.kernel()
    spoilt(memory)
    env = BeltArmVectorEnv(3, randomization="train", autoreset_mode="Disabled")
    seen, batch = env.reset(seed=VALIDATION.first)[0], None
    for _ in range(2):
        for k in range(STEPS):
            reading = read(seen, controller.params)
            expected, batch = controller.law(reading, np.full(3, k == 0), batch)
            assert law(design, sample_of(reading, 1), k == 0, memory) == expected[1], k
            action = np.clip(expected / controller.params.torque_limit, -1, 1)
            seen, *_ = env.step(action.astype(np.float32)[:, None])
        seen = next_move(env, 0.4)


class TestDriving:
    @pytest.mark.parametrize("name", TUNABLE)
    def test_stabilises_the_nominal_arm_over_the_whole_range(self, name: str):
        start, goal = MOVES.T
        duration = 0.6 + 0.3 * np.abs(goal - start)
        move = {"start": start, "goal": goal, "duration": duration, "ramp_time": 0.3 * duration}
        run = rollout(CONTROLLERS[name](), len(MOVES), seed=SEED, options={"move": move})
        assert run.finished.all() and np.isfinite(run.state).all()
        assert np.linalg.norm(run.tip_error[-200:], axis=2).mean(axis=0).max() < 5e-3  # m
        assert np.abs(run.state[-200:, :, 2]).max() < 0.06  # and the belt rings no more than stiction hides

    def test_a_torque_that_is_cut_much_does_not_go_on_ringing(self):
        """On this arm the optimal plan alone ends in a limit cycle between both limits, at a cost above 4000."""
        assert rollout(CONTROLLERS["adaptive"](), 1, seed=5_700_796, randomization="ideal").cost[0] < 1000


GEARED = {"gear_ratio": 100.0, "torque_limit": 0.2}
EASY = {"start": 0.3, "goal": 0.9, "duration": 1.0, "ramp_time": 0.3}


class TestDataSheet:
    """Gear ratio and torque limit, which observations and actions are relative to."""

    @pytest.mark.parametrize(
        "name", [pytest.param(name, marks=pytest.mark.slow) if name == "robust" else name for name in CONTROLLERS]
    )
    def test_controller_made_for_an_arm_drives_it_as_the_nominal_one_its_own(self, name: str):
        known = CONTROLLERS[name]().params
        runs = {}
        for kind, arm in {"own": known, "geared": replace(known, **GEARED)}.items():
            options = {"move": EASY, "params": arm}
            runs[kind] = rollout(CONTROLLERS[name](params=arm), 1, seed=0, options=options).metrics()
        for metric in ("tip_rms_mm", "cost"):
            np.testing.assert_allclose(runs["geared"][metric], runs["own"][metric], rtol=0.15)

    @pytest.mark.parametrize(("field", "value"), GEARED.items())
    def test_other_arms_are_refused(self, field: str, value: float):
        own = getattr(ArmParams(), field)
        options, words = {"params": {field: [own, value]}}, (f"arm 1 has {field} {value}", "PaperController", str(own))
        refused(ValueError, words, lambda: rollout(PaperController(), 2, seed=0, options=options))

    def test_what_a_law_cannot_use_is_refused(self):
        vibrating = {*CONTROLLERS} - {"disturbance", "preview", "mpc", "adaptive"}
        for name, field, value, words in (
            *(("adaptive", field, 0.0, "a guess") for field in ("motor_viscous_friction", "arm_inertia_swing")),
            ("adaptive", "current_loop_time_constant", 0.0031, "at most 0.003 s"),
            ("adaptive", "belt_stiffening", 0.61, "at most 0.6 "),
            ("adaptive", "payload_mass", 0.36, "at most 0.3503 kg "),
            *((name, "belt_damping_ratio", 0.379, "0.378 where") for name in vibrating),
            ("robust", "belt_stiffness", 5.0, "a corner"),
        ):
            refused(ValueError, (field, words), partial(CONTROLLERS[name], params=ArmParams(**{field: value})))


@pytest.mark.parametrize("name", TUNABLE)
def test_gains_lie_within_their_range(name: str):
    kind = TUNABLE[name].gains_type
    for gain in fields(kind):
        assert gain.metadata["low"] < gain.default < gain.metadata["high"], gain.name
        for value in (gain.metadata["low"] - 1, gain.metadata["high"] + 1, math.nan, math.inf):
            refused(ValueError, (f"{kind.__name__}.{gain.name}", "got"), partial(kind, **{gain.name: value}))
        refused(TypeError, (gain.name,), partial(kind, **{gain.name: "1"}))


COSTS = """
import sys
from baselines import CONTROLLERS
from beltarm_env.rollout import rollout
for name in CONTROLLERS:
    if name not in sys.argv[1:]:
        print(name, rollout(CONTROLLERS[name](), 8, seed=7_000_000, randomization="train").cost.tolist())
"""


@pytest.mark.slow
def test_only_designs_that_are_said_to_depend_on_the_kernels_of_linear_algebra():
    page = (ROOT / "docs" / "benchmark" / "protocol.md").read_text(encoding="utf-8")
    (named,) = re.findall(r"The designs of ([^.]*) do not", page)
    words = "-c", COSTS, *re.findall(r"`(\w+)`", named)
    usual, older = python(*words, path=(ROOT,)), python(*words, path=(ROOT,), OPENBLAS_CORETYPE="Nehalem")
    assert usual == older and "adaptive" in usual
