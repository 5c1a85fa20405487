"""What importing the package pulls in, its versions, and the wheel."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from commands import ROOT

import beltarm_env
from beltarm_env.engine import building, shipped
from beltarm_env.sources import source_files
from tests.lowest import lowest_versions

PACKAGE = ROOT / "beltarm_env"
README = ("engine/translation/README.md",)
HEAVY = (
    *("torch", "stable_baselines3", "control", "scipy", "matplotlib", "pandas", "pygame", "tensorboard", "tyro"),
    *("mujoco", "sympy", "pyarrow", "h5py", "minari", "numba"),
)
DEPENDENCIES = {"gymnasium", "numpy"}


def python(
    code: str, folder: Path, path: Path | str = ROOT, *options: str, stream: str = "stdout", **environment: str
) -> str:
    """Output of a Python process of its own, without what this one has in its environment; warnings are errors."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "BELTARM"))}
    command = [sys.executable, "-P", *options, "-W", "error", "-c", code]
    known = {**kept, "PYTHONPATH": str(path), **environment}
    result = subprocess.run(command, cwd=folder, env=known, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return getattr(result, stream)


def test_import_is_light_and_registers(tmp_path: Path):
    """Also by a name with its module, and public names pull in nothing else."""
    code = f"""
import gymnasium, sys
print(type(gymnasium.make("beltarm_env:BeltArm-v0", model="lagrangian").unwrapped).__name__)
print(gymnasium.spec("BeltArm-v0").vector_entry_point)
from beltarm_env import *
import beltarm_env
assert beltarm_env.__all__ and all(name in globals() for name in beltarm_env.__all__)
print([name for name in {HEAVY} if name in sys.modules])
"""
    assert python(code, tmp_path) == "BeltArmEnv\nbeltarm_env.vector_env:BeltArmVectorEnv\n[]\n"
    with pytest.raises(AttributeError, match=r"'beltarm_env'.*'Arm'"):
        _ = beltarm_env.Arm


def test_every_dependency_states_one_lowest_version():
    stated = [one.partition("==")[0] for one in {*lowest_versions()}]
    assert len(stated) == len({*stated}) > len(DEPENDENCIES) and {*stated} > DEPENDENCIES


def test_hashes_are_of_the_pinned_versions():
    """Of all but torch and the benchmark's peers, as CONTRIBUTING.md writes them."""
    without_peers, *_ = (ROOT / "constraints.txt").read_text().partition("# Of the extra `bench`")
    pinned = {line.lower().replace("_", "-") for line in without_peers.splitlines() if "==" in line}
    hashes = (ROOT / "hashes.txt").read_text()
    hashed = re.findall(r"^(\S+==\S+) \\\n    --hash=sha256:[0-9a-f]{64}\b", hashes, re.MULTILINE)
    torch = {one for one in pinned if one.startswith("torch==")}
    assert torch and set(hashed) == {one.replace(".py=", "-py=") for one in pinned - torch}


def build(folder: Path, checkout: Path, *kinds: str, umask: int = 0o022) -> dict[str, Path]:
    """Files that `build` makes of a checkout, by suffix; without kinds the wheel is made from the source archive."""
    command = [sys.executable, "-m", "build", *kinds, "--no-isolation", "--outdir", str(folder), str(checkout)]
    # A single level, and objects that were built before: to compile all of them takes a minute.
    known = {"BELTARM_LEVEL": building.level(), "BELTARM_CACHE_DIR": str(building.cache_folder())}
    fixed = {**os.environ, "SOURCE_DATE_EPOCH": "1700000002", **known}
    result = subprocess.run(command, cwd=folder, env=fixed, umask=umask, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr + result.stdout
    return {path.suffix: path for path in folder.iterdir()}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return build(tmp_path_factory.mktemp("dist"), ROOT, "--sdist", "--wheel")


@pytest.mark.slow
def test_wheel_holds_the_environment_alone_and_asks_for_its_dependencies(built: dict[str, Path]):
    with zipfile.ZipFile(built[".whl"]) as archive:
        names = {*archive.namelist()}
        distribution = {name for name in names if name.split("/")[0].endswith(".dist-info")}
        (metadata,) = [archive.read(name).decode() for name in distribution if name.endswith("/METADATA")]
    sources = {f"beltarm_env/{source.relative_to(PACKAGE)}" for source in source_files(PACKAGE)}
    kernels = {name for name in names if name.startswith(f"beltarm_env/engine/built/{shipped.sources()}/")}
    data = {f"beltarm_env/{name}" for name in ("py.typed", "mujoco/belt_arm.xml", "engine/built/sources.json", *README)}
    assert names - distribution == sources | data | kernels and len(kernels) > 40
    assert re.search(r"-cp311-abi3-\w+\.whl$", built[".whl"].name)
    assert any(name.endswith("LICENSE") for name in distribution) and "\nLicense-Expression: MIT\n" in metadata
    assert {*re.findall(r"^Requires-Dist: ([\w-]+)[^;\n]*$", metadata, re.MULTILINE)} == DEPENDENCIES


@pytest.mark.slow
def test_the_same_sources_give_the_same_bytes(built: dict[str, Path], tmp_path: Path):
    """Whatever the folder, the times and modes of its files, and the umask."""
    checkout, made = tmp_path / "elsewhere", tmp_path / "dist"
    left_out = shutil.ignore_patterns("__pycache__", "built")
    shutil.copytree(PACKAGE, checkout / "beltarm_env", ignore=left_out)
    for name in ("pyproject.toml", "hatch_build.py", ".gitignore", "README.md", "LICENSE", "CHANGELOG.md"):
        shutil.copy(ROOT / name, checkout)
    for path in checkout.rglob("*"):
        path.chmod(0o700 if path.is_dir() else 0o600)
        os.utime(path, (0, 10**9))
    made.mkdir()
    again = build(made, checkout, umask=0o077)
    assert set(again) == set(built) == {".whl", ".gz"}
    for suffix, path in again.items():
        assert path.name == built[suffix].name and path.read_bytes() == built[suffix].read_bytes(), path.name


CHANGED = """
from beltarm_env.engine import building
building._packaged_compiler = lambda: None
import beltarm_env
beltarm_env.BeltArmEnv()
"""
EPISODE = """
import beltarm_env, copy, gymnasium, importlib.metadata, importlib.util, numpy
print(beltarm_env.__file__)
print(beltarm_env.__version__ == importlib.metadata.version("beltarm-env"))
print([name for name in ("baselines", "agents", "train", "eval") if importlib.util.find_spec(name)])
env = gymnasium.make("BeltArm-v0", randomization="train")
env.reset(seed=0)
steps, over = 0, False
while not over:
    *_, terminated, truncated, info = env.step(numpy.zeros(1, numpy.float32))
    steps, over = steps + 1, terminated or truncated
print(steps, truncated, info["total_cost"] > 0)
envs = gymnasium.make_vec("BeltArm-v0", num_envs=2, moves=2, randomization={"payload_mass": (0.1, 0.3)})
copy.deepcopy(env).reset(seed=0), envs.reset(seed=0)
print(envs.step(numpy.zeros((2, 1)))[0].shape)
"""


@pytest.mark.slow
def test_installed_wheel_runs_an_episode_elsewhere(built: dict[str, Path], tmp_path: Path):
    folder = tmp_path / "installed"
    command = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--no-compile", "--target"]
    quiet = {**os.environ, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    subprocess.run([*command, str(folder), str(built[".whl"])], env=quiet, capture_output=True, check=True)
    # Without site, whose .pth files would bring in the checkout of an editable install.
    path = f"{folder}{os.pathsep}{sysconfig.get_path('purelib')}"
    output = python(EPISODE, tmp_path, path, "-S", "-B", BELTARM_LEVEL=building.level()).splitlines()
    assert output == [str(folder / "beltarm_env" / "__init__.py"), "True", "[]", "1200 True True", "(2, 26)"]
    assert python(EPISODE, tmp_path, path, "-S", "-B", stream="stderr", BELTARM_LEVEL=building.level()) == ""
    engine = folder / "beltarm_env" / "engine"
    assert not (engine / "__pycache__").exists(), "nothing was compiled"
    with (engine / "c" / "real.h").open("a") as file:
        file.write("\n")
    told = python(CHANGED, tmp_path, path, "-S", "-B", stream="stderr")
    assert "beltarm_env/engine/c/real.h was changed" in told and told.count("\n") == 1
