"""Motion over a sample of the arm that a filter believes in, `baselines.estimation.believed_arm`.

It is that of the environment's integrator, with stiction and all effects of the drive. Ripple is held over a sample at
its mean. Many arms, and copies of each, are simulated side by side (`baselines.estimation.simulation_lanes`).
"""

from __future__ import annotations

from baselines.estimation.accelerometer import mean_acceleration
from baselines.estimation.believed_arm import STEPS, write_ripple
from baselines.estimation.simulation_lanes import Simulation, load, load_commands, load_copy, load_torques
from beltarm_env.arrays import Floats
from beltarm_env.engine import compiled, inlined
from beltarm_env.kernels import layout as at
from beltarm_env.kernels.advance import advance_real_block
from beltarm_env.kernels.layout import LANES, load_drive, load_plant, load_state
from beltarm_env.physics.kinematics import TipMotion, tip_motion
from beltarm_env.physics.models import LUMPED


@compiled
def move_on(commands: Floats, held: int, room: Simulation) -> None:
    """Move loaded arms by one period, their last command having been held for some samples.

    Args:
        commands: Of the arms, latest first [N m], shape (arms, HISTORY).
        held: Samples.
        room: Changed; x of the arms is the first rows of `loaded`.
    """
    arms = len(commands)
    load_commands(room.loaded, commands, held)
    write_ripple(room.loaded, room.z, arms, room.shapes, room.ripple)
    load_torques(room.loaded, arms, room.z, room.ripple, room.actions)
    advance_real_block(room.loaded, room.work, room.actions, arms, LUMPED)


@inlined
def _put_acceleration(block: Floats, lane: int, velocities: Floats, result: Floats, arm: int, k: int) -> None:
    """Put what an accelerometer feels of a lane below its x, over a period that began with a velocity of the end."""
    before = TipMotion(0.0, 0.0, velocities[lane], velocities[LANES + lane])
    x, plant, drive = load_state(block, at.STATE, lane), load_plant(block, lane), load_drive(block, lane)
    result[arm, 4, k], result[arm, 5, k] = mean_acceleration(before, x, plant, drive)


@compiled
def simulate(
    beliefs: Floats, nominal: Floats, commands: Floats, deflections: Floats, room: Simulation, result: Floats
) -> None:
    """Simulate one period from z, and from copies with one of its first entries perturbed by its step in each.

    Args:
        beliefs: z of up to `ARMS` arms, shape (arms, SIZE or more).
        nominal: From `nominal_row`.
        commands: Of the past [N m], latest first, shape (arms, HISTORY).
        deflections: Of the motors, see `Belief`, shape (arms,); changed to those after the period.
        room: Changed; holds the shapes of the arms' ripple then.
        result: x after the period, written: that of z, and then those of the copies, shape (arms or more, 4,
            1 + DIFFERENCED). With an accelerometer, its readings over the period stand below x, and there are more
            columns: copies for the kinematic error, and the readings where each entry of x is perturbed after the
            period (elsewhere in these columns, nothing is written); shape (..., 4 + AXES, 1 + DIFFERENCED + 2 + 4).
    """
    arms, accelerometer, block = len(beliefs), result.shape[1] > 4, room.block
    simulations = result.shape[2] - 4 if accelerometer else result.shape[2]
    load(beliefs, nominal, deflections, room)
    load_commands(room.loaded, commands, 0)
    write_ripple(room.z, room.z, arms, room.shapes, room.ripple)
    at_once = max(LANES // arms, 1)
    for part in range((simulations + at_once - 1) // at_once):
        begin, end = part * at_once, min(part * at_once + at_once, simulations)
        for k in range(begin, end):
            first = (k - begin) * arms
            load_copy(k, block[first:], room.actions[first:], beliefs, nominal, commands, room)
        for lane in range((end - begin) * arms if accelerometer else 0):
            tip = tip_motion(load_state(block, at.STATE, lane), load_plant(block, lane), load_drive(block, lane))
            room.velocities[lane], room.velocities[LANES + lane] = tip.x_speed, tip.y_speed
        advance_real_block(block, room.work, room.actions, (end - begin) * arms, LUMPED)
        for k in range(begin, end):
            for arm in range(arms):
                lane = (k - begin) * arms + arm
                if k == 0:
                    deflections[arm] = block[at.DEFLECTION * LANES + lane]
                for i in range(4):
                    result[arm, i, k] = block[(at.STATE + i) * LANES + lane]
                if accelerometer:
                    _put_acceleration(block, lane, room.velocities, result, arm, k)
                    for i in range(4 if k == 0 else 0):
                        state = block[(at.STATE + i) * LANES + lane]
                        block[(at.STATE + i) * LANES + lane] = state + STEPS[i]
                        _put_acceleration(block, lane, room.velocities, result, arm, simulations + i)
                        block[(at.STATE + i) * LANES + lane] = state
