"""The arm as an FMU: the environment's motion, bit for bit, and what it refuses."""

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import mistake, stopped
from driven_arms import drawn_arms, push
from scipy.integrate import solve_ivp

from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmEnv, state_derivative
from beltarm_env.simulation import ArmSimulation
from beltarm_env.timing import EPISODE_STEPS
from eval import export
from eval.exports import fmu
from eval.exports.compilers import Toolchain
from eval.exports.fmu import fmu_texts, variables

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed: pip install -e '.[fmu]'")
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE  # noqa: E402
from fmpy.validation import validate_fmu  # noqa: E402

STATES = ("motor_angle", "motor_speed", "torsion", "torsion_speed")
REFERENCES = {variable.name: variable.reference for variable in variables(ArmParams())}
REAL_DRIVE = [ArmParams(**arm, presliding_deflection=0.003 * k) for k, arm in enumerate(drawn_arms(2, seed=5))]


@pytest.fixture(scope="module")
def path(compiler: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU that the command writes, for this machine alone: zig builds the libraries of others for half a minute."""
    folder = tmp_path_factory.mktemp("fmu")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fmu, "find_spec", lambda _: None)
        assert stopped(export.main, ("fmu", "--out", "made"), folder) == (0, "")
    assert {path.name for path in (folder / "made").iterdir()} == {"beltarm.fmu", "manifest.json"}
    (folder / "mine").write_text("")
    assert "--out" in mistake(export.main, ("fmu", "--out", str(folder)), folder)
    return folder / "made" / "beltarm.fmu"


@pytest.fixture(scope="module")
def unpacked(path: Path) -> tuple[Path, Any]:
    return Path(fmpy.extract(str(path), str(path.parent / "unpacked"))), fmpy.read_model_description(str(path))


class Slave:
    stop: float | None = None

    def __init__(self, unpacked: tuple[Path, Any], said: list[str]) -> None:
        folder, description = unpacked
        self.said, self.callbacks = said, fmi2CallbackFunctions()
        # Environment, instance, status and category come before the message.
        self.callbacks.logger = fmi2CallbackLoggerTYPE(lambda *given: said.append(given[4].decode()))
        names = {"modelIdentifier": "beltarm", "instanceName": "arm", "guid": description.guid}
        self.fmu = FMU2Slave(unzipDirectory=str(folder), **names)
        self.fmu.instantiate(callbacks=self.callbacks)

    def begin(self, params: ArmParams, joint_angle: float = 0.0, **others: float) -> None:
        constants = {**asdict(params), "initial_joint_angle": joint_angle, **others}
        self.fmu.setupExperiment(startTime=0.0, stopTime=self.stop)
        self.fmu.setReal([REFERENCES[name] for name in constants], list(constants.values()))
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def step(self, time: float, torque: float, length: float = CONTROL_PERIOD) -> list[float]:
        self.fmu.setReal([REFERENCES["torque"]], [torque])
        self.fmu.doStep(time, length)
        return self.read(*STATES)

    def read(self, *names: str) -> list[float]:
        return self.fmu.getReal([REFERENCES[name] for name in names])


@contextmanager
def running(unpacked: tuple[Path, Any]) -> Iterator[Slave]:
    slave = Slave(unpacked, [])
    try:
        yield slave
    finally:
        slave.fmu.freeInstance()


def test_its_description_is_as_the_standard_has_it(path: Path):
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path), validate=True)
    assert [variable.name for variable in description.modelVariables if variable.causality == "input"] == ["torque"]
    units = {variable.name: variable.unit for variable in description.modelVariables}
    assert units["belt_stiffness"] == "N m/rad" and units["tip_x"] == "m" and units["gear_ratio"] is None
    tested = {"canHandleVariableCommunicationStepSize", "canNotUseMemoryManagementFunctions"}
    tested |= {"canGetAndSetFMUstate", "canSerializeFMUstate"}
    able = description.coSimulation
    assert {name for name in dir(able) if getattr(able, name) is True} == tested
    texts = fmu_texts(ArmParams(payload_mass=0.5))
    assert texts == fmu_texts(ArmParams(payload_mass=0.5)) and "0.5, /* payload_mass */" in texts["sources/fmu.c"]


@pytest.mark.parametrize("params", [ArmParams(), ArmParams(belt_stiffness=3e4), *REAL_DRIVE])
def test_it_moves_as_the_environment_does(unpacked: tuple[Path, Any], params: ArmParams):
    env = BeltArmEnv(randomization="off")
    env.reset(seed=0, options={"params": asdict(params), "move": {"start": 0.5, "goal": 1.0}})
    batch, stuck, state = env._batch, 0, [0.0]
    with running(unpacked) as slave:
        slave.begin(params, 0.5)
        for k in range(EPISODE_STEPS):
            torque = push(k)
            env.step(np.array([torque / params.torque_limit]))
            state = slave.step(k * CONTROL_PERIOD, torque)
            assert state == batch.states[0].tolist(), f"step {k}"
            stuck += state[1] == 0.0
        assert slave.read("tip_y", "motor_torque") == [batch.tip_errors()[0, 1], *batch.motor_torques.tolist()]
        assert slave.fmu.getInteger([1]) == [round(state[0] / (2 * math.pi / 4000))]
    assert stuck > 5 or params.belt_stiffness > 100 or params.presliding_deflection > 0


TICK = 2.0**-12
"""Length of which times are sums without rounding [s]; a period is no multiple of it."""


@pytest.mark.parametrize("params", [ArmParams(), *REAL_DRIVE])
def test_motion_does_not_depend_on_how_time_is_divided(unpacked: tuple[Path, Any], params: ArmParams):
    """Capability canHandleVariableCommunicationStepSize: the torque is held, so all ends are the same, to the bit."""
    ends, torque = [], 0.9 * params.torque_limit
    late = math.ceil(200 * TICK / CONTROL_PERIOD) * CONTROL_PERIOD
    for ticks in ([200], [1] * 200, [7] * 28 + [4], [199, 1], [3, 60, 1, 136]):
        with running(unpacked) as slave:
            slave.begin(params)
            for at, length in zip(accumulate([0, *ticks]), ticks, strict=False):
                slave.step(at * TICK, torque, length * TICK)
            seen, counts = slave.read(*STATES, "motor_torque", "tip_x", "tip_y"), slave.fmu.getInteger([1])
            ends.append((seen, counts, slave.step(200 * TICK, 0.0, late - 200 * TICK)))
    with running(unpacked) as slave:
        slave.begin(params)
        ended = slave.step(0.0, torque, late)
    assert ends[0][0][0] > 0 and all(end == ends[0] for end in ends) and ended == ends[0][2]


@pytest.mark.parametrize("params", [ArmParams(), *REAL_DRIVE])
def test_a_torque_is_sampled_where_periods_begin(unpacked: tuple[Path, Any], params: ArmParams):
    """A torque that is set within a period waits for the next; one that is gone by then does nothing."""
    simulation, period = ArmSimulation(replace(params, friction_drift=0.0)), CONTROL_PERIOD
    states = simulation.at_rest(np.array([0.0]))
    with running(unpacked) as slave:
        slave.begin(replace(params, friction_drift=0.0))
        for k in range(60):
            torque, at = push(k), k * period
            slave.step(at, torque, 0.3 * period)
            slave.step(at + 0.3 * period, -torque, 0.4 * period)
            slave.step(at + 0.7 * period, 0.2, (k + 1) * period - (at + 0.7 * period))
            states = simulation.advance(states, np.array([torque]))
            assert slave.read(*STATES) == states[0, :4].tolist(), f"step {k}"


def test_states_within_a_period_are_those_of_the_equations(unpacked: tuple[Path, Any]):
    params, before = ArmParams(), [0.0]
    for span in CONTROL_PERIOD * np.array([1e-3, 0.1, 0.37, 0.8, 0.999]):
        with running(unpacked) as slave:
            slave.begin(params)
            for k in range(20):
                before = slave.step(k * CONTROL_PERIOD, 0.25)
            assert before[1] > 10  # it slides: its motion has no corner
            ended = slave.step(20 * CONTROL_PERIOD, 0.2, span)
        true = solve_ivp(lambda _, y: state_derivative(y, 0.2, params), (0.0, span), before, rtol=1e-11, atol=1e-13)
        assert np.abs(ended - true.y[:, -1]).max() < 1e-7 and np.abs(np.array(ended) - before).max() > 1e-6


def test_a_state_within_a_period_can_be_kept_and_reset(unpacked: tuple[Path, Any]):
    """Capabilities canGetAndSetFMUstate and canSerializeFMUstate, and two instances that do not know each other."""
    with running(unpacked) as slave, running(unpacked) as other:
        slave.begin(REAL_DRIVE[1])
        slave.step(0.0, 0.2, 0.0202)
        kept = slave.fmu.serializeFMUState(slave.fmu.getFMUState())
        seen = slave.read(*STATES)
        after = [slave.step(0.0202, -0.1, 0.0005), slave.step(0.0207, -0.1, 0.003)]
        other.begin(ArmParams())
        other.step(0.0, 0.1, 0.004)
        for each in (slave, other):
            state = each.fmu.deSerializeFMUstate(kept)
            each.fmu.setFMUState(state)
            assert each.read(*STATES) == seen
            assert [each.step(0.0202, -0.1, 0.0005), each.step(0.0207, -0.1, 0.003)] == after
            each.fmu.freeFMUState(state)
            each.fmu.reset()
            each.begin(ArmParams())
            assert each.read(*STATES) == [0.0, 0.0, 0.0, 0.0]


def test_clang_compiles_the_sources_for_other_machines(tmp_path: Path):
    """Without a warning, which would be an error: clang warns of what gcc does not."""
    pytest.importorskip("ziglang")
    for name, text in fmu_texts(ArmParams()).items():
        (tmp_path / Path(name).name).write_text(text)
    foreign = [each for *_, each in fmu._toolchains() if each.compiler[0] == sys.executable]
    linux = next(each for each in foreign if "linux" in each.compiler[-1])
    linux.build([tmp_path / "fmu.c"], tmp_path / "fmu.o", "-c")


def test_builds_that_differ_or_fail(compiler: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    rounding = Toolchain((*compiler, "-freciprocal-math", "-U__RECIPROCAL_MATH__"))
    broken = Toolchain((sys.executable, "-c", "raise SystemExit('no such target')"))
    chains = [("linux64", ".so", rounding), ("win64", ".dll", broken)]
    monkeypatch.setattr(fmu, "_toolchains", lambda _: chains)
    content, made, failed = fmu.packed(ArmParams())
    assert made == ["linux64"] and list(failed) == ["win64"] and "no such target" in failed["win64"]
    (tmp_path / "arm.fmu").write_bytes(content)
    unpacked = Path(fmpy.extract(str(tmp_path / "arm.fmu"), str(tmp_path / "unpacked")))
    said: list[str] = []
    with pytest.raises(Exception, match="instantiate"):
        Slave((unpacked, fmpy.read_model_description(unpacked)), said)
    assert len(said) == 1 and "-freciprocal-math" in said[0]


def test_an_arm_that_is_none_is_refused_by_name(unpacked: tuple[Path, Any]):
    for name, value, said in (
        ("motor_inertia", 0.0, "1e+09"),
        ("payload_mass", -1.0, "at least 0"),
        ("arm_inertia", math.nan, "finite"),
        ("torque_ripple_order", 2.5, "whole"),
        ("friction_drift", 0.6, "at most 0.5"),
        ("initial_joint_angle", 2.0, "1.821 rad"),
        ("kinematic_error", 0.01, "too fast"),
    ):
        with running(unpacked) as slave:
            with pytest.raises(Exception, match="ExitInitializationMode"):
                slave.begin(ArmParams(), **{name: value})
            assert name in slave.said[-1] and said in slave.said[-1]


def test_calls_that_make_no_sense_are_refused(unpacked: tuple[Path, Any]):
    with running(unpacked) as slave:
        slave.stop = 0.02
        slave.begin(ArmParams())
        slave.step(0.0, 0.1, 0.002)
        for at, length, named in (
            *((0.002, length, "communicationStepSize") for length in (0.0, -CONTROL_PERIOD, math.nan, math.inf)),
            (0.001, 0.001, "currentCommunicationPoint"),
            (0.002, 0.019, "stop time"),
        ):
            with pytest.raises(Exception, match="fmi2DoStep failed"):
                slave.step(at, 0.1, length)
            assert named in slave.said[-1]
        with pytest.raises(Exception, match="SetReal"):
            slave.fmu.setReal([0], [50.0])
        slave.step(0.002, 0.1, 0.001)


def test_a_master_that_knows_nothing_of_it(path: Path):
    """Gets the same motion, may stop and look when it likes, and is stopped where the arm leaves its workspace."""

    def simulated(torque: float, stop: float, interval: float | None = None) -> Any:
        start: dict[str, Any] = {"torque": torque, "initial_joint_angle": 0.5}
        options: dict[str, Any] = {"output_interval": interval, "output": STATES, "logger": lambda *_: None}
        return fmpy.simulate_fmu(str(path), stop_time=stop, start_values=start, **options)

    simulation = ArmSimulation(ArmParams())
    for stop, interval in ((0.3, CONTROL_PERIOD), (0.1234, 0.002), (0.5, None)):
        result, whole = simulated(0.06, stop, interval), int(stop / CONTROL_PERIOD + 1e-6)
        assert result["time"][-1] == pytest.approx(stop)
        states, late = simulation.at_rest(np.array([0.5 * 88.0])), stop - whole * CONTROL_PERIOD
        for _ in range(whole):
            states = simulation.advance(states, np.array([0.06]))
        expected = states[0, 0] + late * states[0, 1]
        assert result["motor_angle"][-1] == pytest.approx(expected, rel=0, abs=0.01 if late > 1e-9 else 1e-9)
    left = simulated(0.3, 1.8)
    assert 0.05 < left["time"][-1] < 1.0 and left["motor_angle"][-1] / 88 > math.pi / 2 + 0.2
