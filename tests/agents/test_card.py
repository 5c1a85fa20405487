"""Cards of policies: what the Hub reads of them, and what people do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from agents.policy.bundle import CARD, FELT_POLICIES, POLICIES, read_spec
from agents.policy.card import Offer, card

SHIPPED = sorted(path.parent for root in (POLICIES, FELT_POLICIES) for path in root.glob("*/*/policy.json"))


def halves(text: str) -> tuple[dict[str, Any], str]:
    """Front matter and Markdown of a card, parted where the Hub parts them."""
    empty, matter, body = text.split("---\n", 2)
    assert empty == ""
    return yaml.safe_load(matter), body


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda folder: "/".join(folder.parts[-3:]))
def test_shipped_cards_are_what_is_written_today(folder: Path):
    """If not, `agents.policy.bundle.annotate` writes the card of a bundle again, and changes nothing else."""
    spec, content = read_spec(folder)
    text = (folder / CARD).read_text(encoding="utf-8")
    assert text == card(content)
    fields, body = halves(text)
    assert list(fields) == ["library_name", "pipeline_tag", "tags"]
    assert {"BeltArm-v0", "deep-reinforcement-learning", "reinforcement-learning", spec.algorithm} <= {*fields["tags"]}
    for words in (
        "without the guard",
        "docs/guide/export.md",
        content["weights"]["file"],
        "| payload_mass | 0 | 0.2 |",
    ):
        assert words in body
    assert "CITATION.cff" in body and "{{ " not in body


def test_a_card_of_a_policy_of_which_little_is_known():
    _, content = read_spec(SHIPPED[0])
    fields, body = halves(card({**content, "base": "none", "provenance": {}}))
    assert "residual-on-none" in fields["tags"] and "It gives torques of at most" in body
    assert "validation arms" not in body and "| constant |" not in body and "None" not in body


def test_what_is_offered_comes_back_from_yaml_as_it_was():
    _, content = read_spec(SHIPPED[0])
    awkward: dict[str, Any] = {"type": "no", "value": "-1.5 +/- 0.5", "name": "cost: ± 5 %", "args": {"low": 0.1}}
    offer = Offer(
        "org/name", "cc-by-4.0", [{"metrics": [awkward]}, {"metrics": [awkward]}], "Some scores.", "@software{x}"
    )
    fields, body = halves(card(content, offer))
    assert fields["license"] == "cc-by-4.0" and list(fields)[-1] == "model-index"
    assert fields["model-index"] == [{"name": "ppo-BeltArm-v0", "results": offer.results}]
    assert 'snapshot_download("org/name"' in body and "\nSome scores.\n" in body and "@software{x}" in body
