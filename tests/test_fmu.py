"""The arm as an FMU: the environment's motion, bit for bit, and what it refuses."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driven_arms import UPPER_ENDS, drawn_arms, push

from beltarm_env import CONTROL_PERIOD, ArmParams, BeltArmEnv
from beltarm_env.simulation import ArmSimulation
from beltarm_env.timing import EPISODE_STEPS
from eval.deploy.building import here
from eval.deploy.fmu import fmu_texts, variables, write_fmu

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed: pip install -e '.[fmu]'")
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE  # noqa: E402
from fmpy.validation import validate_fmu  # noqa: E402

STATES = ("motor_angle", "motor_speed", "torsion", "torsion_speed")
REFERENCES = {variable.name: variable.reference for variable in variables(ArmParams())}
DRIVEN = [ArmParams(**arm) for arm in drawn_arms(4, seed=5)]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    try:
        here()
    except ValueError as error:
        pytest.skip(str(error))
    path = tmp_path_factory.mktemp("fmu") / "arm.fmu"
    assert write_fmu(path, ArmParams())
    return path


@pytest.fixture(scope="module")
def unpacked(path: Path) -> tuple[Path, Any]:
    return Path(fmpy.extract(str(path), str(path.parent / "unpacked"))), fmpy.read_model_description(str(path))


class Slave:
    """Instance that steps by one control period."""

    def __init__(self, unpacked: tuple[Path, Any]) -> None:
        folder, description = unpacked
        self.said: list[str] = []
        self.callbacks = fmi2CallbackFunctions()
        self.callbacks.logger = fmi2CallbackLoggerTYPE(self.log)
        self.fmu = FMU2Slave(
            guid=description.guid, unzipDirectory=str(folder), modelIdentifier="beltarm", instanceName="arm"
        )
        self.fmu.instantiate(callbacks=self.callbacks)

    def log(self, environment: Any, instance: bytes, status: int, category: bytes, message: bytes, *rest: Any) -> None:
        self.said.append(message.decode())

    def begin(self, params: ArmParams, joint_angle: float = 0.0) -> None:
        constants = {**asdict(params), "initial_joint_angle": joint_angle}
        self.fmu.setupExperiment(startTime=0.0)
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
    slave = Slave(unpacked)
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


@pytest.mark.parametrize("params", [ArmParams(), ArmParams(belt_stiffness=3e4), ArmParams(**UPPER_ENDS), *DRIVEN])
def test_it_moves_as_the_environment_does(unpacked: tuple[Path, Any], params: ArmParams):
    env = BeltArmEnv(randomization="off")
    env.reset(seed=0, options={"params": asdict(params), "move": {"start": 0.5, "goal": 1.0}})
    batch = env._batch
    with running(unpacked) as slave:
        slave.begin(params, 0.5)
        stuck, state = 0, [0.0]
        for k in range(400):
            torque = push(k)
            env.step(np.array([torque / params.torque_limit]))
            state = slave.step(k * CONTROL_PERIOD, torque)
            assert state == batch.states[0].tolist(), f"step {k}"
            stuck += state[1] == 0.0
        tip, reference = slave.read("tip_x", "tip_y"), env._batch.tip_errors()[0, 1]
        assert tip[1] == reference
        assert slave.read("motor_torque") == batch.motor_torques.tolist()
        resolution = 2 * math.pi / 4000
        assert slave.fmu.getInteger([1]) == [round(state[0] / resolution)]
    assert stuck > 5 or params.belt_stiffness > 100


def test_it_moves_as_the_simulation_does_from_the_first_to_the_last_sample(unpacked: tuple[Path, Any]):
    params = replace(DRIVEN[0], friction_drift=0.0)
    simulation = ArmSimulation(params)
    with running(unpacked) as slave:
        slave.begin(params, 0.7)
        states = simulation.at_rest(np.array([0.7 * params.gear_ratio]))
        assert slave.read(*STATES) == states[0, :4].tolist()
        for k in range(EPISODE_STEPS):
            torque = push(k)
            states = simulation.advance(states, np.array([torque]))
            assert slave.step(k * CONTROL_PERIOD, torque) == states[0, :4].tolist(), f"step {k}"


def test_a_master_that_knows_nothing_of_it_gets_the_same_motion(path: Path):
    time = np.arange(201) * CONTROL_PERIOD
    torques = np.array([push(k) for k in range(201)])
    given = np.array(list(zip(time, torques, strict=True)), dtype=[("time", float), ("torque", float)])
    result = fmpy.simulate_fmu(
        str(path), stop_time=time[-1], input=given, output=STATES, start_values={"initial_joint_angle": 0.5}
    )
    simulation = ArmSimulation(ArmParams())
    states = simulation.at_rest(np.array([0.5 * 88.0]))
    for k in range(200):
        states = simulation.advance(states, torques[k : k + 1])
        for name, value in zip(STATES, states[0], strict=True):
            assert result[name][k + 1] == pytest.approx(value, rel=1e-9, abs=1e-9)


def test_a_step_of_several_periods_holds_the_torque(unpacked: tuple[Path, Any]):
    with running(unpacked) as slave, running(unpacked) as other:
        slave.begin(DRIVEN[1])
        other.begin(DRIVEN[1])
        states = [other.step(k * CONTROL_PERIOD, 0.1) for k in range(3)]
        assert slave.step(0.0, 0.1, 3 * CONTROL_PERIOD) == states[-1]


def test_a_state_that_was_kept_can_be_gone_back_to(unpacked: tuple[Path, Any]):
    with running(unpacked) as slave:
        slave.begin(DRIVEN[2])
        for k in range(20):
            slave.step(k * CONTROL_PERIOD, 0.12)
        kept = slave.fmu.getFMUState()
        read = slave.fmu.serializeFMUState(kept)
        after = slave.step(20 * CONTROL_PERIOD, -0.1)
        slave.fmu.setFMUState(kept)
        assert slave.step(20 * CONTROL_PERIOD, -0.1) == after
        again = slave.fmu.deSerializeFMUstate(read)
        slave.fmu.setFMUState(again)
        assert slave.step(20 * CONTROL_PERIOD, -0.1) == after
        slave.fmu.freeFMUState(kept)
        slave.fmu.freeFMUState(again)
        slave.fmu.reset()
        slave.begin(ArmParams())
        assert slave.read(*STATES) == [0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("length", [0.001, 0.0, -CONTROL_PERIOD, 1.5 * CONTROL_PERIOD, math.nan])
def test_a_step_that_is_no_multiple_of_the_period_is_refused(unpacked: tuple[Path, Any], length: float):
    with running(unpacked) as slave:
        slave.begin(ArmParams())
        with pytest.raises(Exception, match="fmi2DoStep failed"):
            slave.step(0.0, 0.1, length)
        assert slave.said[-1].startswith("communicationStepSize must be a multiple of the control period, 0.0015 s")


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("motor_inertia", 0.0, "motor_inertia must be finite, above 0 and at most 1e+09"),
        ("payload_mass", -1.0, "payload_mass must be finite, at least 0"),
        ("arm_inertia", math.nan, "arm_inertia must be finite"),
        (
            "torque_ripple_order",
            2.5,
            "torque_ripple_order must be finite, at least 1 and at most 100, and a whole",
        ),
        ("friction_drift", 0.6, "friction_drift must be finite, at least -0.5 and at most 0.5"),
        ("initial_joint_angle", 2.0, "initial_joint_angle must lie within -0.25 and 1.821 rad"),
        ("belt_stiffness", 1e9, "the arm is too fast to be integrated: lower belt_stiffness"),
        ("kinematic_error", 0.01, "the arm is too fast to be integrated: lower kinematic_error"),
    ],
)
def test_an_arm_that_is_none_is_refused_by_name(unpacked: tuple[Path, Any], name: str, value: float, said: str):
    with running(unpacked) as slave:
        slave.fmu.setupExperiment(startTime=0.0)
        slave.fmu.setReal([REFERENCES[name]], [value])
        slave.fmu.enterInitializationMode()
        with pytest.raises(Exception, match="ExitInitializationMode"):
            slave.fmu.exitInitializationMode()
        assert slave.said[-1].startswith(said)


def test_parameters_stay_once_it_moves(unpacked: tuple[Path, Any]):
    with running(unpacked) as slave:
        slave.begin(ArmParams())
        with pytest.raises(Exception, match="SetReal"):
            slave.fmu.setReal([0], [50.0])
        assert slave.said == ["fmi2SetReal of a parameter is not allowed while the FMU is stepping"]


def test_an_arm_that_leaves_its_workspace_ends_the_simulation(path: Path):
    given = np.array([(0.0, 0.3), (2.0, 0.3)], dtype=[("time", float), ("torque", float)])
    result = fmpy.simulate_fmu(str(path), stop_time=1.8, input=given, output=STATES, logger=lambda *_: None)
    assert 0.05 < result["time"][-1] < 1.0
    assert result["motor_angle"][-1] / 88 > math.pi / 2 + 0.2


def test_its_texts_are_the_same_each_time_and_hold_the_arm():
    params = ArmParams(payload_mass=0.5)
    texts = fmu_texts(params)
    assert texts == fmu_texts(params) and "0.5, /* payload_mass */" in texts["sources/fmu.c"]
    assert fmu_texts(ArmParams())["modelDescription.xml"] != texts["modelDescription.xml"]
