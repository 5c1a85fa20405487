"""What importing pulls in, who imports whom, and the wheel."""

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from tests.lowest import lowest_versions

ROOT = Path(__file__).parents[2]
HEAVY = (
    *("torch", "stable_baselines3", "control", "scipy", "matplotlib", "pandas", "pygame", "tensorboard", "tyro"),
    *("mujoco", "sympy", "pyarrow", "h5py", "minari"),
)
LAYERS = {
    "beltarm_env": ("baselines", "agents", "train", "eval"),
    "baselines": ("agents", "train", "eval"),
    "agents": ("train", "eval"),
}
DEPENDENCIES = {"gymnasium", "llvmlite", "numba", "numpy"}
OPTIONAL = {"pygame", "mujoco", "matplotlib", "pandas", "pyarrow"}


def python(code: str, folder: Path, path: Path | str = ROOT, *options: str, **environment: str) -> str:
    """Output of a Python process of its own, without what this one has in its environment; warnings are errors."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "NUMBA"))}
    result = subprocess.run(
        [sys.executable, "-P", *options, "-W", "error", "-c", code],
        cwd=folder,
        env={**kept, "PYTHONPATH": str(path), **environment},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def lines_of(name: str) -> list[str]:
    return (ROOT / name).read_text(encoding="utf-8").splitlines()


def sources(package: str) -> list[Path]:
    found = sorted((ROOT / package).rglob("*.py"))
    assert found
    return found


def imported(source: Path) -> set[str]:
    """Top-level names that a file imports anywhere, inside functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source} imports relatively"
            names.add(node.module or "")
    return {name.split(".")[0] for name in names}


# Imports


def test_import_is_light_and_registers(tmp_path: Path):
    code = f"""
import sys, beltarm_env, gymnasium
print([name for name in {HEAVY} if name in sys.modules], "numba" in sys.modules)
print(gymnasium.spec("BeltArm-v0").id, gymnasium.spec("BeltArm-v0").vector_entry_point)
"""
    expected = "[] False\nBeltArm-v0 beltarm_env.vector_env:BeltArmVectorEnv\n"
    assert python(code, tmp_path) == expected


def test_every_public_name_can_be_imported_without_the_rest(tmp_path: Path):
    code = f"""
import sys
from beltarm_env import *
import beltarm_env
assert beltarm_env.__all__ and all(name in globals() for name in beltarm_env.__all__)
print([name for name in {HEAVY} if name in sys.modules and name != "scipy"])  # numba looks whether SciPy is there
"""
    assert python(code, tmp_path) == "[]\n"


def test_name_with_module_registers_by_itself(tmp_path: Path):
    code = "import gymnasium; print(gymnasium.make('beltarm_env:BeltArm-v0', disable_env_checker=True).unwrapped)"
    assert "BeltArmEnv" in python(code, tmp_path)


def test_unknown_name():
    import beltarm_env

    with pytest.raises(AttributeError, match=r"'beltarm_env'.*'Arm'"):
        _ = beltarm_env.Arm


@pytest.mark.parametrize("package", LAYERS)
def test_imports_go_one_way(package: str):
    for source in sources(package):
        assert imported(source).isdisjoint(LAYERS[package]), source


def test_the_environment_needs_what_it_declares_and_no_more():
    for source in sources("beltarm_env"):
        others = imported(source) - set(sys.stdlib_module_names) - {"beltarm_env"}
        assert others <= DEPENDENCIES | OPTIONAL, source


def test_every_dependency_states_one_lowest_version():
    stated = {*lowest_versions()}
    assert len(stated) == len({one.partition("==")[0] for one in stated}) > len(DEPENDENCIES)
    assert {one.partition("==")[0] for one in stated} >= DEPENDENCIES


def test_hashes_are_of_the_pinned_versions():
    """Of all but torch and the benchmark's peers, as CONTRIBUTING.md writes them."""
    without_peers, *_ = "\n".join(lines_of("constraints.txt")).partition("# Of the extra `bench`")
    pinned = {line.lower().replace("_", "-") for line in without_peers.splitlines() if "==" in line}
    hashed = re.findall(
        r"^(\S+==\S+) \\\n    --hash=sha256:[0-9a-f]{64}\b", "\n".join(lines_of("hashes.txt")), re.MULTILINE
    )
    torch = {one for one in pinned if one.startswith("torch==")}
    assert torch and set(hashed) == {one.replace(".py=", "-py=") for one in pinned - torch}


def test_optional_packages_are_imported_where_they_are_used():
    for source in sources("beltarm_env"):
        body = ast.parse(source.read_text(encoding="utf-8")).body
        top = {alias.name for node in body if isinstance(node, ast.Import) for alias in node.names}
        top |= {node.module or "" for node in body if isinstance(node, ast.ImportFrom)}
        assert {name.split(".")[0] for name in top}.isdisjoint(OPTIONAL), source


def test_controllers_do_not_know_the_environment_class():
    for source in sources("baselines"):
        text = source.read_text(encoding="utf-8")
        assert "BeltArmEnv" not in text and "BeltArmVectorEnv" not in text, source


# The wheel


def build(folder: Path, checkout: Path, *kinds: str, umask: int = 0o022) -> dict[str, Path]:
    """Files that `build` makes of a checkout, by suffix; without kinds the wheel is made from the source archive."""
    command = [sys.executable, "-m", "build", *kinds, "--no-isolation", "--outdir", str(folder), str(checkout)]
    fixed = {**os.environ, "SOURCE_DATE_EPOCH": "1700000002"}
    result = subprocess.run(command, cwd=folder, env=fixed, umask=umask, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr + result.stdout
    return {path.suffix: path for path in folder.iterdir()}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return build(tmp_path_factory.mktemp("dist"), ROOT, "--sdist", "--wheel")


@pytest.fixture(scope="module")
def wheel(built: dict[str, Path]) -> Path:
    return built[".whl"]


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds what the wheel installs, and nothing else."""
    folder = tmp_path_factory.mktemp("installed")
    command = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--no-compile", "--target"]
    quiet = {**os.environ, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    result = subprocess.run([*command, str(folder), str(wheel)], cwd=folder, env=quiet, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return folder


def test_wheel_holds_the_environment_alone(wheel: Path):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = [archive.read(name).decode() for name in names if name.endswith(".dist-info/METADATA")]
    distribution = {name for name in names if name.split("/")[0].endswith(".dist-info")}
    modules = {str(source.relative_to(ROOT)) for source in sources("beltarm_env")}
    extra = set(names) - distribution - modules
    assert modules <= set(names)
    assert extra == {"beltarm_env/py.typed", "beltarm_env/mujoco/belt_arm.xml"}
    assert any(name.endswith("LICENSE") for name in distribution)
    assert "\nLicense-Expression: MIT\n" in metadata


def test_wheel_asks_for_its_dependencies_alone(wheel: Path):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        lines = archive.read(name).decode().splitlines()
    needed = [line.removeprefix("Requires-Dist: ") for line in lines if line.startswith("Requires-Dist: ")]
    always = {re.split("[<>=]", requirement)[0].strip() for requirement in needed if "extra ==" not in requirement}
    assert always == DEPENDENCIES


def test_the_same_sources_give_the_same_bytes(built: dict[str, Path], tmp_path: Path):
    """Whatever the folder, the times and modes of its files, and the umask."""
    checkout, made = tmp_path / "elsewhere", tmp_path / "dist"
    shutil.copytree(ROOT / "beltarm_env", checkout / "beltarm_env", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", ".gitignore", "README.md", "LICENSE", "CHANGELOG.md"):
        shutil.copy(ROOT / name, checkout)
    for path in checkout.rglob("*"):
        path.chmod(0o700 if path.is_dir() else 0o600)
        os.utime(path, (0, 10**9))
    made.mkdir()
    again = build(made, checkout, umask=0o077)
    assert set(again) == set(built) == {".whl", ".gz"}
    for suffix, path in again.items():
        assert path.name == built[suffix].name and path.read_bytes() == built[suffix].read_bytes(), path.name


EPISODE = """
import beltarm_env, gymnasium, importlib.util, numpy
print(beltarm_env.__file__)
print([name for name in ("baselines", "agents", "train", "eval") if importlib.util.find_spec(name)])
env = gymnasium.make("BeltArm-v0", randomization="train")
env.reset(seed=0)
steps, over = 0, False
while not over:
    *_, terminated, truncated, info = env.step(numpy.zeros(1, numpy.float32))
    steps, over = steps + 1, terminated or truncated
print(steps, truncated, info["total_cost"] > 0)
envs = gymnasium.make_vec("BeltArm-v0", num_envs=2)
envs.reset(seed=0)
print(envs.step(numpy.zeros((2, 1)))[0].shape)
"""


def test_installed_wheel_runs_an_episode_elsewhere(installed: Path, tmp_path: Path):
    """Without compiling, which would take most of this suite's time and is tested everywhere else."""
    # Without site, whose .pth files would bring in the checkout of an editable install.
    path = f"{installed}{os.pathsep}{sysconfig.get_path('purelib')}"
    output = python(EPISODE, tmp_path, path, "-S", NUMBA_DISABLE_JIT="1").splitlines()
    assert output == [str(installed / "beltarm_env" / "__init__.py"), "[]", "1200 True True", "(2, 25)"]


def test_version_is_that_of_the_distribution(installed: Path, tmp_path: Path):
    code = "import beltarm_env, importlib.metadata as m; print(beltarm_env.__version__ == m.version('beltarm-env'))"
    assert python(code, tmp_path, installed) == "True\n"
