"""Bundles of policies: what they hold, what is refused, that loading executes nothing, and their cards."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from bundles import SPEC, Exploit, edit, halves, new_weights
from refusals import refused
from safetensors.torch import load_file
from safetensors.torch import save as save_tensors

from agents.policy.bundle import (
    CARD,
    FELT_POLICIES,
    FORMAT,
    MANIFEST,
    MAX_BYTES,
    POLICIES,
    VERSION,
    BundleError,
    BundleSpec,
    load_controller,
    read_spec,
    read_weights,
    save_bundle,
)
from agents.policy.card import Offer, card
from agents.policy.network import NetworkPolicy
from agents.residual.bases import make_base, settings_hash
from agents.residual.controller import ResidualController, ResidualSettings
from baselines import PaperController
from baselines.optimal.felt import FeltAdaptiveController
from beltarm_env.rollout import rollout

NAN, INF = math.nan, math.inf
MOST = 10**15
SETTINGS = ResidualSettings()
SPECS = {
    "plain": BundleSpec("ppo", "paper", SETTINGS, (16, 16)),
    "more sensors": BundleSpec(
        "ppo", "rigid", ResidualSettings(0.8, 12), (8,), "relu", "tip", provenance={"seed": 3, "note": "ζ"}
    ),
    "no base": BundleSpec(
        "sac", "none", ResidualSettings(2.0, 10), (), "elu", "full", provenance={"a": {"b": [1, None]}}
    ),
    "lstm": BundleSpec("recurrent_ppo", "paper", ResidualSettings(0.5, 6, "none"), (8,), "relu", lstm=12),
    "gru": BundleSpec("student", "adaptive", SETTINGS, (8,), "relu", gru=10, standardised=True),
}
SHIPPED = sorted(path.parent for root in (POLICIES, FELT_POLICIES) for path in root.glob("*/*/policy.json"))


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    folder = tmp_path / "policy"
    save_bundle(folder, SPEC, new_weights())
    load_controller(folder)
    return folder


def weights(bundle: Path) -> Path:
    (path,) = bundle.glob("*.safetensors")
    return path


class TestSaved:
    @pytest.mark.parametrize("name", SPECS)
    def test_bundle_gives_the_same_policy_bit_for_bit(self, tmp_path: Path, name: str):
        spec = SPECS[name]
        digest = save_bundle(tmp_path, spec, new_weights(spec, 0))
        read, described, content = read_weights(tmp_path)
        assert described == spec and content["content_hash"] == digest
        assert {name: value.tobytes() for name, value in read.arrays.items()} == {
            name: value.tobytes() for name, value in new_weights(spec, 0).arrays.items()
        }
        original = ResidualController(make_base(spec.base), NetworkPolicy(new_weights(spec, 0)), spec.residual)
        sensors: Any = spec.sensors
        runs = [
            rollout(controller, 3, seed=1, sensors=sensors, randomization="train", profile="scurve")
            for controller in (original, load_controller(tmp_path))
        ]
        assert runs[0].torque.tobytes() == runs[1].torque.tobytes()
        assert runs[0].state.tobytes() == runs[1].state.tobytes()

    def test_content_hash_depends_on_content_alone(self, tmp_path: Path):
        spec = SPECS["plain"]
        first = save_bundle(tmp_path / "a", spec, new_weights(spec, 0))
        assert save_bundle(tmp_path / "b", read_spec(tmp_path / "a")[0], new_weights(spec, 0)) == first
        assert save_bundle(tmp_path / "a", spec, new_weights(spec, 0)) == first
        files = [sorted((path.name, path.read_bytes()) for path in (tmp_path / name).iterdir()) for name in "ab"]
        assert files[0] == files[1] and len(files[0]) == 3
        others = [
            save_bundle(tmp_path / "d", replace(spec, provenance={"seed": 1}), new_weights(spec, 0)),
            save_bundle(tmp_path / "d", replace(spec, residual=replace(SETTINGS, hold=5)), new_weights(spec, 0)),
            save_bundle(tmp_path / "d", spec, new_weights(spec, 1)),
        ]
        assert len({first, *others}) == 4 and len(list((tmp_path / "d").iterdir())) == 3
        kept = read_weights(tmp_path / "d")[0].arrays
        assert all(np.array_equal(kept[name], value) for name, value in new_weights(spec, 1).arrays.items()), (
            "the last one"
        )

    def test_a_policy_is_given_its_entries_by_name(self, tmp_path: Path):
        names = ("base_torque", "motor_speed", "believed_torsion", "motor_angle_error")
        spec = BundleSpec("ppo", "paper", SETTINGS, (16,), inputs=names)
        save_bundle(tmp_path, spec, new_weights(spec, 0))
        loaded: Any = load_controller(tmp_path)
        assert read_spec(tmp_path)[0] == spec
        offered = [entry.name for entry in spec.offered()]
        seen = np.random.default_rng(0).normal(size=(3, len(offered))).astype(np.float32)
        chosen = np.ascontiguousarray(seen[:, [offered.index(name) for name in names]])
        assert np.array_equal(loaded.policy.predict(seen)[0], NetworkPolicy(new_weights(spec, 0)).predict(chosen)[0])
        with pytest.raises(ValueError, match=r"\(2, 3\).*--sensors"):
            loaded.policy.predict(np.ones((2, 3), np.float32))

    def test_with_an_accelerometer_the_filter_of_the_base_has_it_too(self, tmp_path: Path):
        spec = BundleSpec("student", "adaptive", SETTINGS, (8,), sensors="accelerometer")
        save_bundle(tmp_path, spec, new_weights(spec, 0))
        controller = load_controller(str(tmp_path))
        assert isinstance(controller.informed.base, FeltAdaptiveController)
        assert not isinstance(make_base("adaptive"), FeltAdaptiveController)
        assert isinstance(make_base("paper", "accelerometer"), PaperController)  # which has no filter

    def test_policies_that_are_not_saved(self, bundle: Path):
        before, broken = read_spec(bundle), new_weights()
        next(iter(broken.arrays.values()))[:] = NAN
        wide, curve = replace(SPEC, hidden=(600, 600)), replace(SPEC, provenance={"curve": [[0, 1.0, NAN]]})
        refused(BundleError, ("not finite", "layers.0.weight"), lambda: save_bundle(bundle, SPEC, broken))
        refused(ValueError, (str(MAX_BYTES),), lambda: save_bundle(bundle, wide, new_weights(wide)))
        refused(ValueError, ("(600, 600)", "(4, 3)"), lambda: save_bundle(bundle, wide, new_weights()))
        refused(ValueError, ("JSON",), lambda: save_bundle(bundle, curve, new_weights()))
        assert read_spec(bundle) == before


@pytest.mark.parametrize("files_written", [0, 1])
def test_a_bundle_that_cannot_be_replaced_stays_valid(
    bundle: Path, monkeypatch: pytest.MonkeyPatch, files_written: int
):
    """The disk fills up at the weights, or between the weights and the manifest."""
    before, rename, calls = read_weights(bundle)[0].arrays, os.replace, []

    def replace_then_fail(*arguments: Any) -> None:
        calls.append(arguments)
        if len(calls) > files_written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        rename(*arguments)

    with monkeypatch.context() as patched, pytest.raises(OSError, match="No space"):
        patched.setattr(os, "replace", replace_then_fail)
        save_bundle(bundle, SPEC, new_weights())
    after = read_weights(bundle)[0].arrays
    assert all(np.array_equal(before[name], after[name]) for name in before)
    assert not [name for name in os.listdir(bundle) if name.startswith(".")]
    save_bundle(bundle, SPEC, new_weights())
    assert len(os.listdir(bundle)) == 3


def put(bundle: Path, data: bytes) -> None:
    """Put other bytes in the place of the weights, with fitting hashes."""
    (bundle / "weights-x.safetensors").write_bytes(data)
    edit(bundle, rehash=True, weights={"file": "weights-x.safetensors", "sha256": hashlib.sha256(data).hexdigest()})


def change_weights(bundle: Path, change: Callable[[torch.Tensor], torch.Tensor]) -> None:
    put(bundle, save_tensors({name: change(value) for name, value in load_file(weights(bundle)).items()}))


def foreign_weights(bundle: Path) -> None:
    """Weights of another network, with fitting hashes."""
    other, spec = bundle.parent / "other", replace(SPEC, hidden=(5,))
    save_bundle(other, spec, new_weights(spec))
    put(bundle, weights(other).read_bytes())


def make_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def flip_a_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


DAMAGES: dict[str, tuple[Callable[[Path], Any], tuple[str, ...]]] = {
    "no folder": (shutil.rmtree, (MANIFEST,)),
    "no manifest": (lambda b: (b / MANIFEST).unlink(), (MANIFEST,)),
    "manifest is a pipe": (lambda b: make_pipe(b / MANIFEST), (MANIFEST, "no regular file")),
    "weights are a pipe": (lambda b: make_pipe(weights(b)), ("weights-", "no regular file")),
    "another program's file": (lambda b: (b / MANIFEST).write_text('{"format": "onnx"}'), (MANIFEST, FORMAT)),
    "deeply nested manifest": (lambda b: (b / MANIFEST).write_text("[" * 10**5), (MANIFEST,)),
    "huge manifest": (lambda b: (b / MANIFEST).write_text(" " * (MAX_BYTES + 1)), (MANIFEST, str(MAX_BYTES))),
    "no version": (lambda b: edit(b, rehash=True, version=None), ("None", str(VERSION))),
    "edited by hand": (lambda b: edit(b, rehash=False, base="rigid"), (MANIFEST, "hash")),
    "huge weights": (lambda b: os.truncate(weights(b), MAX_BYTES + 1), ("weights-", str(MAX_BYTES))),
    "no weights": (lambda b: weights(b).unlink(), ("weights-",)),
    "one bit of the weights": (lambda b: flip_a_bit(weights(b)), ("weights-", "SHA-256")),
    "weights of another network": (foreign_weights, ("weights-x",)),
    "weights in double precision": (lambda b: change_weights(b, torch.Tensor.double), ("weights-x", "float64")),
    "weights of NaN": (lambda b: change_weights(b, lambda value: value * NAN), ("weights-x", "not finite")),
}


def test_a_manifest_of_a_megabyte_is_read_and_no_larger_one(bundle: Path):
    provenance = {"run": {"steps": MOST, "seconds": float(MOST)}, "curve": [[0, 0.0, -1.5], [MOST, 1e15, 3]]}
    edit(bundle, rehash=True, provenance=provenance)
    text = (bundle / MANIFEST).read_text()
    (bundle / MANIFEST).write_text(text.ljust(10**6))
    assert read_spec(bundle)[0].provenance == provenance
    (bundle / MANIFEST).write_text(text.ljust(10**6 + 1))
    refused(BundleError, (MANIFEST, "cannot be read"), lambda: read_spec(bundle))


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_bundles_are_refused(bundle: Path, damage: str):
    break_it, words = DAMAGES[damage]
    break_it(bundle)
    refused(BundleError, words, lambda: load_controller(bundle))


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"version": 99}, "99"),
    ({"edition": 1}, "edition 1"),
    ({"layout": 99}, "layout 99"),
    ({"algorithm": "dqn"}, "dqn"),
    ({"base": "lqr"}, "lqr"),
    ({"activation": "gelu"}, "gelu"),
    ({"sensors": "sonar"}, "sonar"),
    ({"entries": []}, "at least one"),
    ({"entries": [["tip_speed", "m/s", 1.0, 1.0]]}, "tip_speed"),
    ({"entries": [["motor_angle_error", "deg", 1.5, 200.0]]}, "motor_angle_error.*deg"),
    ({"entries": [["motor_angle_error", "rad", 3.0, 200.0]]}, "motor_angle_error.*3.0"),
    ({"hidden": [10**9, 10**9]}, str(10**9)),
    ({"hidden": [8, 8]}, "weights-"),
    ({"gru": 4, "lstm": 4}, "an LSTM or a GRU"),
    ({"lstm": 4}, "weights-"),
    ({"weights": {"file": "../elsewhere.safetensors", "sha256": ""}}, "elsewhere"),
    ({"weights": {"file": "/etc/passwd", "sha256": ""}}, "/etc/passwd"),
    ({"residual": {"limit": 5.0, "hold": 4, "knowledge": "belief"}}, "5.0"),
    ({"residual": {"limit": 0.5, "hold": 4, "knowledge": "belief", "gain": 1.0}}, "gain"),
    ({"provenance": {"run": {"steps": MOST + 1}}}, "does not fit"),
    ({"provenance": {"curve": [[0, 0.0, 1.0, 1.0]]}}, "does not fit"),
]


@pytest.mark.parametrize(("changes", "words"), WRONG, ids=lambda value: str(value)[:40])
def test_manifests_with_wrong_values_are_refused(bundle: Path, changes: dict[str, Any], words: str):
    edit(bundle, rehash=True, **changes)
    with pytest.raises(BundleError, match=words):
        load_controller(bundle)


OF_NO_SUCH_KIND: dict[str, Any] = {
    **{"edition": 2.5, "layout": [2], "algorithm": {}, "base": None, "activation": [], "sensors": {}, "lstm": NAN},
    **{"residual": {"limit": 0.5}, "hidden": [4.5], "gru": "0", "standardised": 0, "base_hash": 3, "entries": [[1]]},
    **{"base_settings": {"gains": {"a\nb": 1.0}}, "weights": {"file": []}, "provenance": {"run": {"steps": 10**400}}},
}


@pytest.mark.parametrize("place", OF_NO_SUCH_KIND)
def test_manifests_that_are_not_as_they_should_be(place: str, bundle: Path):
    """In one line, before anything reads them: not as a traceback, and not by numbers that JSON does not have."""
    edit(bundle, rehash=True, **{place: OF_NO_SUCH_KIND[place]})
    with pytest.raises(BundleError, match=MANIFEST) as caught:
        read_spec(bundle)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("part", "field", "value"), [("gains", "angle", 1.0), ("doubts", "swing", 0.5)])
def test_a_base_with_other_settings_is_refused(bundle: Path, part: str, field: str, value: float):
    settings = json.loads((bundle / MANIFEST).read_text())["base_settings"]
    settings[part][field] = value
    edit(bundle, rehash=True, base_settings=settings, base_hash=settings_hash(settings))
    refused(BundleError, (MANIFEST, f"{part}.{field}"), lambda: load_controller(bundle))


def test_loading_executes_nothing(bundle: Path, monkeypatch: pytest.MonkeyPatch):
    """Pickles in place of the weights and of the manifest are refused and not run; nothing is unpickled."""
    target = bundle.parent / "executed"
    pickled = pickle.dumps(Exploit(target))
    with monkeypatch.context() as patched:
        for name in ("pickle.load", "pickle.loads", "pickle.Unpickler", "torch.load"):
            patched.setattr(name, None)
        load_controller(bundle)
    put(bundle, pickled)
    refused(BundleError, ("weights-x",), lambda: load_controller(bundle))
    (bundle / MANIFEST).write_bytes(pickled)
    refused(BundleError, (MANIFEST,), lambda: load_controller(bundle))
    assert not target.exists()
    pickle.loads(pickled)
    assert target.exists(), "the exploit should work where a pickle is loaded"


class TestCard:
    def test_shipped_cards_are_what_is_written_today(self):
        """If not, `agents.policy.bundle.annotate` writes the card of a bundle again, and changes nothing else."""
        for folder in SHIPPED:
            spec, content = read_spec(folder)
            text = (folder / CARD).read_text(encoding="utf-8")
            assert text == card(content), folder
            fields, body = halves(text)
            assert list(fields) == ["library_name", "pipeline_tag", "tags"]
            assert {"BeltArm-v0", "reinforcement-learning", spec.algorithm} <= {*fields["tags"]}
            assert all(words in body for words in ("docs/guide/export.md", content["weights"]["file"], "payload_mass"))

    def test_what_is_offered_comes_back_from_yaml_as_it_was(self):
        _, content = read_spec(SHIPPED[0])
        awkward: dict[str, Any] = {"type": "no", "value": "-1.5 +/- 0.5", "name": "cost: ± 5 %", "args": {"low": 0.1}}
        offer = Offer("org/name", "cc-by-4.0", [{"metrics": [awkward]}] * 2, "Some scores.", "@software{x}")
        fields, body = halves(card(content, offer))
        assert fields["license"] == "cc-by-4.0" and list(fields)[-1] == "model-index"
        assert fields["model-index"] == [{"name": "ppo-BeltArm-v0", "results": offer.results}]
        assert all(words in body for words in ('"org/name"', "\nSome scores.\n", "@software{x}"))
