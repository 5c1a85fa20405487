"""A controller or policy as C for a drive's processor.

The C99 is translated from the kernels that comparisons run, and checked against them on development scenarios, bit for
bit. docs/guide/export.md tells how to use it.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import tyro

from agents.policy.bundle import POLICY_FILE, load_controller, read_spec
from agents.policy.correction import correction
from agents.residual.controller import behind_guard
from baselines import CONTROLLERS
from baselines.controller import LawKernel
from baselines.estimation.believed_arm import SIZE
from baselines.estimation.filter_design import empty_inputs, room_for
from baselines.estimation.identification import empty_belief
from baselines.guard.controller import servo_for
from baselines.guard.guard import GUARD_SIZE
from baselines.guard.settings import GuardSettings
from baselines.optimal.adaptive import AdaptiveController
from baselines.tools.command import require_bounds, require_known
from beltarm_env import ArmParams
from beltarm_env.arm import params_table
from beltarm_env.rollout import check_data_sheet, check_profile
from eval.comparison import custom
from eval.comparison.sets import development_set
from eval.exports.compilers import FLAGS, footprint, native, processors_for
from eval.exports.folder import require_free, write_export
from eval.exports.in_the_loop import InTheLoop, compare
from eval.exports.kernels import Filtering, Guarded, GuardMemory, Learned, classical, learned, step_of
from eval.exports.source import TEMPLATES, Loop, sources


@dataclass(frozen=True)
class Options:
    """Write a controller or policy as C."""

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CONTROLLER|POLICY")]
    """Name of a classical controller, folder of a policy, or a controller of your own, `path/to/file.py:Class`."""
    out: Path
    """Folder to write: a new or empty one, or one of an earlier export."""
    name: str = ""
    """Name of functions and files, instead of the controller's: for several exports in one program."""
    guard: bool = True
    """Leave out the guard between controller and motor."""
    plan_samples: int = 1
    """Samples over which a plan is spread that `adaptive` makes anew while the arm moves, 1 to 19. For processors on
    which it takes longer than a sample. 1 is what was compared; more is another controller, if only a little."""
    check: bool = True
    """Write the sources alone, without compiling them and comparing them with Python."""
    episodes: int = 4
    """Development scenarios that they are compared on, 1 to 200: single moves, and shifts of two moves."""


def export(options: Options) -> None:
    """Check the program, which has to be the controller, and write the folder; an earlier one stays where it is not."""
    require_bounds(options, episodes=(1, 200), plan_samples=(1, 19))
    require_free(options.out)
    if options.check:
        native()  # before the work, not after it
    loop = loop_of(options.source, options.guard, options.plan_samples)
    loop = replace(loop, name=options.name) if options.name else loop
    if options.check:
        with TemporaryDirectory(prefix="beltarm-") as temporary:
            _check(options, loop, Path(temporary) / "export")
    write_program(options.out, loop)
    print(f"written to {options.out}: {loop.name}.h, {loop.name}.c and what goes with them")


def _check(options: Options, loop: Loop, folder: Path) -> None:
    """Write a program into a folder, compile it and compare it with its controller."""
    own, usual = ((arm.gear_ratio, arm.torque_limit) for arm in (loop.params, ArmParams()))
    if own != usual:
        raise ValueError(f"the check has arms of gear ratio and torque limit {usual}, not {own}: give --no-check")
    write_program(folder, loop)
    splits, controller = development_set().splits, controller_of(options.source, options.guard)
    differing = samples = 0
    for split in (splits["randomized"], splits["shift"].shortened(2)):  # with a move that begins where one ended
        agreement = compare(folder, loop, controller, split, options.episodes)
        differing, samples = differing + agreement.samples - agreement.equal, samples + agreement.samples
        print(f"{split.name}: {agreement.words()}")
    for core in processors_for(loop.identifies):
        if taken := footprint(folder, loop.name, core):
            print(f"{core}: {', '.join(f'{size / 1024:.0f} kB of {kind}' for kind, size in taken._asdict().items())}")
    if differing and options.plan_samples == 1:
        raise ValueError(f"it differs from Python in {differing} of {samples} samples: see BELTARM_ENGINE=checked")


def write_program(folder: Path, loop: Loop) -> None:
    """Write the sources of a loop, a page on how to use them and a manifest into a folder: all of them, or nothing.

    Raises:
        TranslationError: If a kernel cannot be translated.
        ValueError: If the folder is in use for something else.
        OSError: If it cannot be written.
    """
    texts = sources(loop)
    texts["README.md"] = TEMPLATES.get_template("README.md.j2").render(loop=loop, flags=" ".join(FLAGS))
    write_export(folder, loop.name, loop.title, loop.params, {name: text.encode() for name, text in texts.items()})


def exportable() -> list[str]:
    """Names of the classical controllers whose law is a kernel for one arm."""
    return [name for name, make in CONTROLLERS.items() if hasattr(make(), "kernel")]


def loop_of(source: str, guard: bool = True, plan_samples: int = 1) -> Loop:
    """Make the loop of a controller.

    Args:
        source: Name of a classical controller, folder of a policy, or `path/to/file.py:Class`.
        guard: Whether the guard stands between it and the motor.
        plan_samples: Over how many samples a plan that is made anew is spread, where `adaptive` plans.

    Raises:
        ValueError: If there is no such controller, no program does what it does, or the policy is missing or damaged.
    """
    if _is_classical(source):
        name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", source.rpartition(":")[2]).lower()  # `MyServo` becomes `my_servo`
        residual, base = 0.0, _classical(source)
        title = f"Controller {name!r} of beltarm" if source in CONTROLLERS else f"Controller {name!r}"
        kernel, identifies = _kernel(base, source, plan_samples), isinstance(base, AdaptiveController)
        params = base.params
        propose, design, memory = classical(kernel.law, identifies), kernel.design, kernel.memory
    else:
        if not (Path(source) / POLICY_FILE).is_file():
            require_known((source,), CONTROLLERS, "{} is neither a classical controller nor the folder of a policy")
        controller, (spec, content) = load_controller(source), read_spec(source)
        name, residual, base = spec.algorithm, spec.residual.limit, controller.informed.base
        title = f"Policy {name} on {spec.base!r} of beltarm, SHA-256 {content['sha256']}"
        params, kernel = controller.params or ArmParams(), _kernel(base, spec.base, plan_samples)
        corrected, identifies = correction(controller), spec.residual.knowledge != "none"
        own = corrected.identifier  # beside the base; none where the base's own is shared
        filtering = Filtering(empty_belief(1, SIZE), empty_inputs(), room_for(1)) if identifies and own else None
        propose = learned(kernel.law, identifies, own is None)
        design = Learned(kernel.design, own.design if own else None, corrected.design)
        memory = Learned(kernel.memory, filtering, corrected.memory)
    check_data_sheet(params, params_table([params]), name)  # its motor turns no further than what is measured shows
    check_profile(base, InTheLoop.profile)
    remembers = bool(getattr(base, "remembers", False))
    step, design, memory = step_of(propose, remembers=remembers), Guarded(design), Guarded(memory)
    if guard:
        servo: Any = servo_for(base)
        law, fixed, kept = servo.kernel() if servo is not None else (None, None, None)
        title, step = f"{title}, behind the guard", step_of(propose, True, law, remembers)
        design = design._replace(servo=fixed, guard=GuardSettings().design(params, residual))
        guards = GuardMemory(np.zeros(GUARD_SIZE), np.zeros(1, np.intp))
        memory = memory._replace(servo=kept, guard=guards)
    return Loop(name, title, params, step, design, memory, identifies, isinstance(base, AdaptiveController))


def _is_classical(source: str) -> bool:
    """Tell whether a source is a controller of the project or of a file, not a policy."""
    return source in CONTROLLERS or (":" in source and not (Path(source) / POLICY_FILE).is_file())


def _classical(source: str) -> Any:
    return CONTROLLERS[source]() if source in CONTROLLERS else custom.make(source)


def _kernel(controller: Any, name: str, plan_samples: int) -> LawKernel:
    """Law of a controller for one arm; raises ValueError if it has none."""
    if not hasattr(controller, "kernel"):
        able = ", ".join(exportable())
        remedy = f"give it one, as docs/examples/my_servo.py does; these can: {able}"
        raise ValueError(f"{name!r} has no `kernel()`, a law for one arm, and cannot be exported: {remedy}")
    if plan_samples != 1 and not isinstance(controller, AdaptiveController):
        raise ValueError(f"{name!r} makes no plan while the arm moves: leave out --plan-samples {plan_samples}")
    try:
        return controller.kernel() if plan_samples == 1 else controller.kernel(plan_samples)
    except TypeError as error:  # with an accelerometer
        raise ValueError(f"{name!r} cannot be exported: {error}") from None


def controller_of(source: str, guard: bool = True) -> Any:
    """Make the controller in Python whose loop `loop_of` makes."""
    controller: Any = _classical(source) if _is_classical(source) else load_controller(source)
    return behind_guard(controller) if guard else controller
