"""The methods of the comparison: classical controllers and shipped or given policies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from agents.bundle import load_controller
from baselines import CONTROLLERS
from beltarm_env.rollout import Controller

POLICIES = Path(__file__).resolve().parent.parent / "agents" / "policies"


@dataclass(frozen=True, slots=True)
class Method:
    """A controller, or one learning method with a controller per training seed."""

    name: str
    kind: Literal["classical", "learned"]
    controllers: list[Controller]
    training: dict[str, Any]  # simulator steps and wall-clock per seed; empty for classical


def classical_methods() -> list[Method]:
    """All classical controllers."""
    return [Method(name, "classical", [make()], {}) for name, make in CONTROLLERS.items()]


def learned_method(folders: list[Path]) -> Method:
    """One learning method from its policy bundles, one per training seed.

    Raises:
        BundleError: If a bundle is missing or damaged.
        ValueError: If the bundles are not of one method.
    """
    loaded = [load_controller(folder) for folder in folders]
    names = {_method_name(spec.algorithm, spec.base) for _, spec in loaded}
    if len(names) > 1:
        raise ValueError(f"the policies given are of different methods ({', '.join(sorted(names))}); compare one a run")
    whole = [(spec.provenance.get("run", {}), spec.residual.hold) for _, spec in loaded]
    training = {
        "simulator_steps": [int(run.get("steps", 0)) * hold for run, hold in whole],
        "wall_clock_s": [float(run.get("seconds", 0.0)) for run, _ in whole],
    }
    return Method(names.pop(), "learned", [controller for controller, _ in loaded], training)


def _method_name(algorithm: str, base: str) -> str:
    return algorithm if base == "paper" else f"{algorithm}-on-{base}"


def shipped_policies() -> list[Path]:
    """Folders of the shipped policies, one per training seed."""
    return sorted(path.parent for path in POLICIES.glob("ppo/*/policy.json"))
