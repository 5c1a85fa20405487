"""Controllers that can become programs: how each one's loop is made of its kernels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.policy.bundle import MANIFEST, load_controller, read_spec
from agents.policy.correction import correction
from agents.residual.guarded import GuardedResidualController
from baselines import CONTROLLERS
from baselines.controller import LawKernel
from baselines.estimation.believed_arm import SIZE
from baselines.estimation.filter_design import inputs_of
from baselines.estimation.identification import IdentifyingController
from baselines.estimation.identify import empty_notes, workspace_for
from baselines.guard.controller import guarded, servo_for
from baselines.guard.guard import GUARD_SIZE
from baselines.guard.settings import GuardSettings
from baselines.optimal.adaptive import AdaptiveController
from baselines.tools.command import nearest
from beltarm_env import ArmParams
from eval.deploy.source import Loop
from eval.deploy.tiers import (
    Filtering,
    Guarded,
    GuardMemory,
    Kernel,
    Learned,
    classical,
    guarded_step,
    identifying,
    learned,
    step_of,
)


def exportable() -> list[str]:
    """Names of the classical controllers that are kernels for one arm."""
    return [name for name, make in CONTROLLERS.items() if hasattr(make(), "kernel")]


def loop_of(source: str, guard: bool = True, plan_samples: int = 1) -> Loop:
    """Make the loop of a controller.

    Args:
        source: Name of a classical controller, or folder of a policy.
        guard: Whether the guard stands between it and the motor.
        plan_samples: Over how many samples a plan that is made anew is spread, where `adaptive` plans.

    Raises:
        ValueError: If there is no such controller, it is no kernel for one arm, or the policy is missing or damaged.
    """
    if source in CONTROLLERS:
        controller: Any = CONTROLLERS[source]()
        kernel = _kernel(controller, source, plan_samples)
        identifies, params = isinstance(controller, IdentifyingController), controller.params
        propose = identifying(kernel.law) if identifies else classical(kernel.law)
        title = f"Controller {source!r} of beltarm"
        loop = Loop(source, title, params, step_of(propose), kernel.design, kernel.memory, identifies, identifies)
        return _behind_guard(loop, propose, source, 0.0) if guard else loop
    if not (Path(source) / MANIFEST).is_file():
        near = nearest(source, CONTROLLERS)
        hint = f"did you mean {near!r}?" if near else f"there are {', '.join(CONTROLLERS)}"
        raise ValueError(f"{source!r} is neither a classical controller nor the folder of a policy; {hint}")
    controller, (spec, content) = load_controller(source), read_spec(source)
    base: Any = controller.informed.base
    kernel, corrected = _kernel(base, spec.base, plan_samples), correction(controller)
    told, shared = spec.residual.knowledge != "none", corrected.identifier is None
    filtering = _filtering() if told and not shared else None
    design = Learned(kernel.design, corrected.identifier.design if corrected.identifier else None, corrected.design)
    memory = Learned(kernel.memory, filtering, corrected.memory)
    title = f"Policy {spec.algorithm} on {spec.base!r} of beltarm, content hash {content['content_hash']}"
    propose = learned(kernel.law, told, shared)
    params, plans = controller.params or ArmParams(), isinstance(base, AdaptiveController)
    loop = Loop(spec.algorithm, title, params, step_of(propose), design, memory, told, plans)
    return _behind_guard(loop, propose, spec.base, spec.residual.limit) if guard else loop


def _behind_guard(loop: Loop, propose: Kernel, base: str, residual: float) -> Loop:
    """Loop with the guard behind a controller.

    Args:
        loop: Of the controller alone.
        propose: Of the controller.
        base: Name of the controller, or of what it corrects.
        residual: Largest residual, over the torque limit.
    """
    servo: Any = servo_for(base)
    law, fixed, memory = servo.kernel() if servo is not None else (None, None, None)
    return replace(
        loop,
        title=f"{loop.title}, behind the guard",
        step=guarded_step(propose, law),
        design=Guarded(loop.design, fixed, GuardSettings().design(loop.params, residual)),
        memory=Guarded(loop.memory, memory, GuardMemory(np.zeros(GUARD_SIZE), np.zeros(1, np.intp))),
    )


def _kernel(controller: Any, name: str, plan_samples: int) -> LawKernel:
    """Law of a controller for one arm.

    Raises:
        ValueError: If it has none.
    """
    if not hasattr(controller, "kernel"):
        able = ", ".join(exportable())
        raise ValueError(f"{name!r} is no kernel for one arm and cannot be exported; these can: {able}")
    if plan_samples == 1:
        try:
            return controller.kernel()
        except TypeError as error:  # with an accelerometer
            raise ValueError(f"{name!r} cannot be exported: {error}") from None
    if not isinstance(controller, AdaptiveController):
        raise ValueError(f"{name!r} makes no plan while the arm moves: leave out --plan-samples {plan_samples}")
    return controller.spread_kernel(plan_samples)


def _filtering() -> Filtering:
    inputs = inputs_of(np.zeros(1), np.zeros(1), np.zeros(1, np.bool_))
    return Filtering(empty_notes(1, SIZE), inputs, workspace_for(1))


def controller_of(source: str, guard: bool = True) -> Any:
    """Make the controller in Python whose loop `loop_of` makes."""
    if source in CONTROLLERS:
        return guarded(source) if guard else CONTROLLERS[source]()
    controller = load_controller(Path(source))
    return GuardedResidualController(controller, servo_for(read_spec(Path(source))[0].base)) if guard else controller
