"""A policy's card: what its manifest says, for people."""

from __future__ import annotations

from typing import Any

_ROWS = 12


def card(content: dict[str, Any]) -> str:
    """Format a bundle's manifest as Markdown: description, training and scores of the policy."""
    provenance = content["provenance"]
    residual = content["residual"]
    network = " × ".join(str(width) for width in content["hidden"]) or "linear"
    memories = [f"{kind.upper()} of {content[kind]}, then " for kind in ("lstm", "gru") if content[kind]]
    memory = "".join(memories)
    facts = {
        "algorithm": content["algorithm"],
        "base controller": f"`{content['base']}`, settings {content['base_hash'][:12]}",
        "residual": f"at most {residual['limit']:g} of the torque limit, held for {residual['hold']} samples",
        "told besides the observation": residual["knowledge"],
        "sensors": content["sensors"],
        "network": f"{memory}{network}, {content['activation']}",
        "inputs": f"{len(content['entries'])}, layout {content['layout']}",
        "weights": f"`{content['weights']['file']}`",
        "seed": provenance.get("config", {}).get("seed"),
        "command": f"`{provenance['command']}`" if "command" in provenance else None,
        "versions": ", ".join(f"{name} {version}" for name, version in provenance.get("versions", {}).items()),
    }
    lines = [f"# Residual {content['algorithm']} policy on `{content['base']}`", "", "| | |", "|---|---|"]
    lines += [f"| {name} | {value} |" for name, value in facts.items() if value not in (None, "")]
    return "\n".join([*lines, *_scores(provenance), *_curve(provenance), ""])


def _scores(provenance: dict[str, Any]) -> list[str]:
    """Format the scores on the validation arms, beside those of the base."""
    reached = provenance.get("reached", {})
    scores, base = reached.get("validation", {}), provenance.get("validation_of_base", {})
    if not scores:
        return []
    lines = ["", f"On the validation arms, after {reached['steps']} agent steps:", "", "| | policy | base |"]
    return [*lines, "|---|---:|---:|", *(f"| {name} | {scores[name]:.4g} | {base[name]:.4g} |" for name in scores)]


def _curve(provenance: dict[str, Any]) -> list[str]:
    """Format a dozen points of the learning curve."""
    points = provenance.get("curve", [])
    if not points:
        return []
    count = min(len(points), _ROWS)
    chosen = [points[round(k * (len(points) - 1) / max(count - 1, 1))] for k in range(count)]
    lines = ["", "| agent steps | seconds | validation cost |", "|---:|---:|---:|"]
    return [*lines, *(f"| {steps} | {seconds:.0f} | {cost:.1f} |" for steps, seconds, cost in chosen)]
