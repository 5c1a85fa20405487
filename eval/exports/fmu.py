"""The arm as a Functional Mock-up Unit, FMI 2.0 for co-simulation, for other simulators.

For the same torques its states are the environment's, bit for bit. All constants of `ArmParams` are parameters.
docs/guide/export.md tells how to use it.
"""

import inspect
import math
import platform
import re
import sys
import tempfile
import uuid
import zipfile
from dataclasses import astuple, dataclass
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from baselines.tools.files import write_bytes
from baselines.tools.progress import progress_over
from baselines.tools.schema import in_a_line
from beltarm_env import CONTROL_PERIOD, ArmParams, __version__
from beltarm_env.arm import FIELDS, bounds_of
from beltarm_env.engine.translation.program import Program
from beltarm_env.engine.translation.types import BOOL, INT, REAL, Scalar
from beltarm_env.physics.kinematics import HIGHEST, LOWEST
from beltarm_env.task.sensors import ENCODER_COUNTS
from beltarm_env.timing import EPISODE_TIME
from eval.exports.compilers import Toolchain, native
from eval.exports.folder import require_free, write_export
from eval.exports.plant import OUTPUTS, REFUSALS, begin, empty_memory, look, refusal, step
from eval.exports.source import MOST_COUNTS, SINGLE_LANE, TAKEN, TEMPLATES, body, fields_of, members, parts_of

_UNITS = {
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "m": {"m": 1},
    "s": {"s": 1},
    "kg": {"kg": 1},
    "kg m^2": {"kg": 1, "m": 2},
    "N m": {"kg": 1, "m": 2, "s": -2},
    "N m/rad": {"kg": 1, "m": 2, "s": -2, "rad": -1},
    "N m s/rad": {"kg": 1, "m": 2, "s": -1, "rad": -1},
}
_COMMENT = re.compile(r"^ +(\w+): float = \S+ +# (.*?) *\[([^]]*)\][ ,]*(.*)$", re.MULTILINE)
_ASSUMED = re.compile(r" *\(a\)")
_PLATFORMS = {
    "linux64": ("Linux x86_64", "x86_64-linux-gnu", ".so"),
    "win64": ("Windows AMD64", "x86_64-windows-gnu", ".dll"),
    "darwin64": ("Darwin x86_64", "x86_64-macos", ".dylib"),
    "aarch64-linux": ("Linux aarch64", "aarch64-linux-gnu", ".so"),
    "aarch64-darwin": ("Darwin arm64", "aarch64-macos", ".dylib"),
}
"""Machines that a compiler of their own builds for, target of zig and suffix of files, by folder of binaries: FMI 2.0
names those of x86-64, FMI 3.0 those of ARM."""
_EPOCH = (1980, 1, 1, 0, 0, 0)  # time of all files in the archive, so that two exports are equal


@dataclass(frozen=True)
class Options:
    """Write the arm as an FMU."""

    out: Path
    """Folder to write beltarm.fmu into: a new or empty one, or one of an earlier export."""
    native: bool = False
    """Build for this kind of machine alone, in seconds; the first build for the others takes minutes."""


def export(options: Options) -> None:
    """Write the folder."""
    require_free(options.out)
    params = ArmParams()
    content, platforms, failed = packed(params, options.native)
    write_export(options.out, "arm", "The arm of beltarm as an FMU", params, {"beltarm.fmu": content})
    print(f"written to {options.out}: beltarm.fmu, for {', '.join(platforms)}")
    for platform_name, reason in failed.items():
        print(f"not for {platform_name}: {in_a_line(reason)}", file=sys.stderr)


class Variable(NamedTuple):
    """Variable of the FMU."""

    type: str
    reference: int  # among those of its type
    name: str
    description: str
    causality: str
    unit: str = ""
    start: float | None = None
    bounds: tuple[float, float] | None = None


def variables(params: ArmParams) -> list[Variable]:
    """List the variables of an arm's FMU: constants, initial state, torque and outputs."""
    comments = {name: rest for name, *rest in _COMMENT.findall(inspect.getsource(ArmParams))}
    reals: list[tuple[Any, ...]] = []
    for name, start in zip(FIELDS, astuple(params), strict=True):
        symbol, unit, text = comments[name]
        title, text = f"{name.replace('_', ' ').capitalize()} {symbol}".rstrip(), _ASSUMED.sub("", text)
        description, unit = f"{title}: {text}" if text else title, unit if unit in _UNITS else ""
        reals.append((name, description, "parameter", unit, start, bounds_of(name)[:2]))
    rest = "Joint angle theta_a / G at which the arm rests at the start"
    turn = "Counts of the encoder per turn of the motor"
    *outputs, count = ((name, text, "output", unit) for name, (unit, text) in OUTPUTS.items())
    reals += [
        ("initial_joint_angle", rest, "parameter", "rad", 0.0, (LOWEST, HIGHEST)),
        ("torque", "Torque command, sampled and held over a control period; cut at torque_limit", "input", "N m", 0.0),
        *outputs,
    ]
    integers = [("counts_per_turn", turn, "parameter", "", ENCODER_COUNTS, (1, MOST_COUNTS)), count]
    of_types = (("Real", reals), ("Integer", integers))
    return [Variable(kind, k, *row) for kind, rows in of_types for k, row in enumerate(rows)]


def fmu_texts(params: ArmParams) -> dict[str, str]:
    """Write the texts of an arm's FMU, by their paths in it."""
    program = Program(SINGLE_LANE)
    program.taken |= TAKEN
    memory = empty_memory(1)
    arm = members("memory", memory)
    given_names = ("joint_angle", "resolution", "torque", "duration")
    angle, resolution, torque, duration = (Scalar(REAL, name) for name in given_names)
    of_arm = variables(params)
    given = {
        "version": __version__,
        "fields": list(fields_of("memory", memory)),
        "refusal": body(program, refusal, [arm, angle], INT),
        "begin": body(program, begin, [arm, angle, resolution]),
        "step": body(program, step, [arm, torque], BOOL),
        "look": body(program, look, [arm, torque, duration]),
        **parts_of(program),
        "constants": len(FIELDS),
        "outputs": len(OUTPUTS),
        "starts": [f"{variable.start!r}, /* {variable.name} */" for variable in of_arm[: len(FIELDS) + 2]],
        "refusals": REFUSALS,
        "counts_per_turn": ENCODER_COUNTS,
        "turn": repr(2 * math.pi),
        "period": repr(CONTROL_PERIOD),
        "stop": f"{EPISODE_TIME:g}",
        "lowest": f"{LOWEST:.4g}",
        "highest": f"{HIGHEST:.4g}",
        "variables": of_arm,
        "unknowns": [k for k, variable in enumerate(of_arm, 1) if variable.causality == "output"],
        "units": _UNITS,
    }

    def texts(guid: str) -> dict[str, str]:
        templates = {"documentation/index.html": "fmu.html", "sources/fmi2.h": "fmi2.h", "sources/fmu.c": "fmu.c"}
        named = {"modelDescription.xml": "modelDescription.xml", **templates}
        return {path: TEMPLATES.get_template(f"{name}.j2").render(given, guid=guid) for path, name in named.items()}

    content = "".join(texts("").values())
    return texts(f"{{{uuid.uuid5(uuid.NAMESPACE_URL, content)}}}")


def _toolchains(alone: bool = False) -> list[tuple[str, str, Toolchain]]:
    """Folder of binaries, suffix of its files and compiler, for this kind of machine and others that zig builds for."""
    chains = list[tuple[str, str, Toolchain]]()
    for folder, (machines, target, suffix) in _PLATFORMS.items():
        if {platform.system(), platform.machine()} <= {*machines.split()}:
            chains.insert(0, (folder, suffix, native()))
        elif not alone and find_spec("ziglang") is not None:
            chains.append((folder, suffix, Toolchain((sys.executable, "-m", "ziglang", "cc", "-target", target))))
    if not chains:
        raise ValueError(f"no binaries are made for {platform.platform()}{': leave --native out' if alone else ''}")
    return chains


def write_fmu(path: Path, params: ArmParams, native: bool = False) -> list[str]:
    """Write an arm as an FMU, whose parameters start with the arm's constants.

    Binaries are for this kind of machine, and unless `native` for others where the package `ziglang` is installed. The
    FMU holds the sources too. Returns the platforms of the binaries as FMI 2.0 names them: "linux64", "win64", ...

    Raises:
        ValueError: If there is no compiler, or it fails.
    """
    content, platforms, _ = packed(params, native)
    write_bytes(path, content)
    return platforms


def packed(params: ArmParams, native: bool = False) -> tuple[bytes, list[str], dict[str, str]]:
    """Compile an arm's FMU and pack it; return the platforms of its binaries too, and why others failed."""
    files = {name: text.encode() for name, text in fmu_texts(params).items()}
    made, failed = list[str](), dict[str, str]()
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            (Path(folder) / Path(name).name).write_bytes(content)
        for kind, suffix, toolchain in progress_over("platforms", _toolchains(native)):
            library = Path(folder) / f"beltarm{suffix}"
            position = () if suffix == ".dll" else ("-fPIC",)
            try:
                toolchain.build([Path(folder) / "fmu.c"], library, "-fvisibility=hidden", "-shared", *position)
            except ValueError as error:
                if not made:  # only this machine's own is needed
                    raise
                failed[kind] = str(error)
                continue
            files[f"binaries/{kind}/{library.name}"] = library.read_bytes()
            made.append(kind)
    archive = BytesIO()
    with zipfile.ZipFile(archive, "w") as opened:
        for name, content in files.items():
            opened.writestr(zipfile.ZipInfo(name, _EPOCH), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue(), made, failed
