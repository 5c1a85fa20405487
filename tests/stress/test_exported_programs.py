"""Controllers in C, compiled with sanitizers, beside Python's: bit for bit, also on faulty encoder counts."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from translating import compiler

from agents.policy.bundle import POLICIES
from beltarm_env import BeltArmVectorEnv
from beltarm_env.arrays import Integers
from beltarm_env.observation import decode
from beltarm_env.task.reference import MoveShape
from beltarm_env.task.sensors import ENCODER_COUNTS
from eval.comparison.sets import development_set
from eval.comparison.splits import Split
from eval.exports.compilers import SANITISED, Toolchain
from eval.exports.in_the_loop import InTheLoop, counts_of
from eval.exports.kernels import begin, commanded, empty_device, observe
from eval.exports.program import controller_of, loop_of, write_program
from eval.exports.source import Loop
from tests.eval.exports.conftest import CachingToolchain

FAULTS = tuple("none stuck reversed late spike flipped ends anything".split())
MOST, LEAST = 2**31 - 1, -(2**31)
LATE = 4
ARMS, LENGTH = 56, 1200
SLEW_ROUNDING = 1e-6  # of single precision
CLASSICAL = ("paper", "ei", "smooth", "flat", "disturbance", "adrc", "lqg", "robust", "preview", "adaptive")


@pytest.mark.parametrize("guard", [False, True], ids=["alone", "guarded"])
@pytest.mark.parametrize("name", [*CLASSICAL, "ppo", "student"])
def test_a_program_commands_what_python_does(name: str, guard: bool, tmp_path: Path):
    toolchain = CachingToolchain(compiler().compiler)
    source = name if name in CLASSICAL else str(POLICIES / name / "seed0")
    splits, loop, controller = development_set().splits, loop_of(source, guard), controller_of(source, guard)
    write_program(tmp_path, loop)

    @settings(max_examples=2, phases=[Phase.generate])
    @given(st.sampled_from(sorted(splits)), st.integers(0, 2**31))
    def run(split: str, seed: int) -> None:
        compare(tmp_path, loop, controller, splits[split], np.random.default_rng(seed), toolchain)

    run()


def compare(
    folder: Path, loop: Loop, controller: Any, split: Split, rng: np.random.Generator, toolchain: Toolchain
) -> None:
    """Torques are equal and within the limit; behind the guard they change by no more than the slew limit."""
    settings = split.arguments(slice(ARMS))
    seed, options = settings.pop("seed"), settings.pop("options", None)
    env = BeltArmVectorEnv(ARMS, **settings)
    seen, _ = env.reset(seed=seed, options=options)
    per_turn = int(split.settings.get("encoder_counts", ENCODER_COUNTS))
    quantum, limit = 2 * np.pi / per_turn, loop.params.torque_limit
    guard = getattr(loop.design, "guard", None)
    slew = np.inf if guard is None else guard.slew
    encoders, devices = FaultyEncoders(counts_of(seen, quantum), rng), [empty_device() for _ in range(ARMS)]
    sanitising = replace(toolchain, flags=(*SANITISED, "-O1"))
    program = InTheLoop(folder, loop, split.moves[:ARMS], sanitising, per_turn)
    state, last = None, np.zeros(ARMS)
    with program:
        for sample in range(LENGTH):
            holding = decode(seen)["holds_part"] > 0
            begins, counts = np.full(ARMS, sample == 0), encoders.read(counts_of(seen, quantum))
            for device, move, part, count in zip(devices, split.moves, holding, counts, strict=False):
                if sample == 0:
                    begin(device, loop.params.plant(), quantum, MoveShape(*move), bool(part), int(count))
                observe(device, int(count))
            observations = np.concatenate([device.observation for device in devices])
            action, state = controller.predict(observations, state, begins)
            actions = zip(devices, action[:, 0].tolist(), strict=True)
            torques = np.array([commanded(device, each, limit) for device, each in actions])
            compiled = program.torques(counts, begins, holding)
            wrong = (compiled != torques) | ~(np.abs(compiled) <= limit)
            wrong |= ~(np.abs(compiled - last) <= slew + SLEW_ROUNDING * limit)
            assert not wrong.any(), (sample, encoders.faults[wrong], torques[wrong], compiled[wrong], last[wrong])
            last = torques
            seen = env.step(np.nan_to_num(np.clip(action, -1, 1)).astype(np.float32))[0]


class FaultyEncoders:
    """Encoders of arms, each with a fault of its own from some sample on; `counts` are those of the first one."""

    def __init__(self, counts: Integers, rng: np.random.Generator) -> None:
        self.faults = rng.choice(FAULTS, size=len(counts), p=[0.3, *np.full(len(FAULTS) - 1, 0.1)])
        self._onset, self._rng, self._sample = rng.integers(0, LENGTH, size=len(counts)), rng, 0
        self._true, self._given = np.repeat(counts[None], LATE + 1, axis=0), counts

    def read(self, counts: Integers) -> Integers:
        """Counts that are given in place of the true ones of a sample, shape (n,): 32 bits with a sign."""
        rng, n = self._rng, len(counts)
        self._true = np.concatenate([counts[None], self._true[:-1]])
        rare = rng.random(n) < 0.02
        anything = rng.integers(LEAST, MOST, size=n, endpoint=True)
        faulty = {
            "stuck": self._given,
            "reversed": self._given - (counts - self._true[1]),
            "late": self._true[LATE],
            "spike": np.where(rare, anything, counts),
            "flipped": np.where(rare, counts ^ (1 << rng.integers(0, 31, size=n)), counts),
            "ends": np.where(rng.random(n) < 0.5, MOST, LEAST),
            "anything": anything,
        }
        wrong = np.select([self.faults == name for name in faulty], list(faulty.values()), counts)
        self._given = np.clip(np.where(self._sample >= self._onset, wrong, counts), LEAST, MOST)
        self._sample += 1
        return self._given
