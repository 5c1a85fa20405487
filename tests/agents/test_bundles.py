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

import agents.policy.bundle
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
from agents.policy.weights import Weights
from agents.residual.bases import make_base, settings_hash
from agents.residual.controller import ResidualController, ResidualSettings
from baselines import PaperController
from baselines.optimal.felt import FeltAdaptiveController
from beltarm_env import observation
from beltarm_env.observation import size
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


def lively(spec: BundleSpec = SPECS["plain"], seed: int = 0) -> Weights:
    """Random weights, that move the arms but leave them in their workspace."""
    torch.manual_seed(seed)
    return new_weights(spec)


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
        digest = save_bundle(tmp_path, spec, lively(spec))
        read, described, content = read_weights(tmp_path)
        assert described == spec and content["content_hash"] == digest
        assert {name: value.tobytes() for name, value in read.arrays.items()} == {
            name: value.tobytes() for name, value in lively(spec).arrays.items()
        }
        original = ResidualController(make_base(spec.base), NetworkPolicy(lively(spec)), spec.residual)
        sensors: Any = spec.sensors
        runs = [
            rollout(controller, 3, seed=1, sensors=sensors, randomization="train", profile="scurve")
            for controller in (original, load_controller(tmp_path))
        ]
        assert runs[0].torque.tobytes() == runs[1].torque.tobytes()
        assert runs[0].state.tobytes() == runs[1].state.tobytes()

    def test_content_hash_depends_on_content_alone(self, tmp_path: Path):
        spec = SPECS["plain"]
        first = save_bundle(tmp_path / "a", spec, lively())
        assert save_bundle(tmp_path / "b", read_spec(tmp_path / "a")[0], lively()) == first
        assert save_bundle(tmp_path / "a", spec, lively()) == first
        files = [sorted((path.name, path.read_bytes()) for path in (tmp_path / name).iterdir()) for name in "ab"]
        assert files[0] == files[1] and len(files[0]) == 3
        others = [
            save_bundle(tmp_path / "d", replace(spec, provenance={"seed": 1}), lively()),
            save_bundle(tmp_path / "d", replace(spec, residual=replace(SETTINGS, hold=5)), lively()),
            save_bundle(tmp_path / "d", spec, lively(seed=1)),
        ]
        assert len({first, *others}) == 4
        seen = np.ones((1, size()), np.float32)
        expected = ResidualController(make_base("paper"), NetworkPolicy(lively(seed=1)), SETTINGS).predict(seen)[0]
        assert np.array_equal(load_controller(tmp_path / "d").predict(seen)[0], expected), "the last one"
        assert len(list((tmp_path / "d").iterdir())) == 3

    def test_a_policy_is_given_its_entries_by_name(self, tmp_path: Path):
        names = ("base_torque", "motor_speed", "believed_torsion", "motor_angle_error")
        spec = BundleSpec("ppo", "paper", SETTINGS, (16,), inputs=names)
        save_bundle(tmp_path, spec, lively(spec))
        loaded: Any = load_controller(tmp_path)
        assert read_spec(tmp_path)[0] == spec
        offered = [entry.name for entry in spec.offered()]
        seen = np.random.default_rng(0).normal(size=(3, len(offered))).astype(np.float32)
        chosen = np.ascontiguousarray(seen[:, [offered.index(name) for name in names]])
        assert np.array_equal(loaded.policy.predict(seen)[0], NetworkPolicy(lively(spec)).predict(chosen)[0])
        with pytest.raises(ValueError, match=r"\(2, 3\).*--sensors"):
            loaded.policy.predict(np.ones((2, 3), np.float32))

    def test_with_an_accelerometer_the_filter_of_the_base_has_it_too(self, tmp_path: Path):
        spec = BundleSpec("student", "adaptive", SETTINGS, (8,), sensors="accelerometer")
        save_bundle(tmp_path, spec, lively(spec))
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
    old = load_controller(bundle)
    seen = np.ones((2, observation.size()), np.float32)
    expected = old.predict(seen)[0]
    rename, calls = os.replace, []

    def replace_then_fail(*arguments: Any) -> None:
        calls.append(arguments)
        if len(calls) > files_written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        rename(*arguments)

    monkeypatch.setattr(os, "replace", replace_then_fail)
    with pytest.raises(OSError, match="No space"):
        save_bundle(bundle, SPEC, new_weights())
    monkeypatch.undo()
    again = load_controller(bundle)
    assert isinstance(again, ResidualController)
    assert np.array_equal(again.predict(seen)[0], expected)
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


def replace_file(path: Path, make: Callable[[Path], object]) -> None:
    path.unlink()
    make(path)


def flip_a_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


def drop(bundle: Path, key: str) -> None:
    content = json.loads((bundle / MANIFEST).read_text())
    del content[key]
    content["content_hash"] = agents.policy.bundle.content_hash(content)
    (bundle / MANIFEST).write_text(json.dumps(content))


DAMAGES: dict[str, tuple[Callable[[Path], Any], tuple[str, ...]]] = {
    "no folder": (shutil.rmtree, (MANIFEST,)),
    "a file": (lambda b: (shutil.rmtree(b), b.write_bytes(b"PK")), (MANIFEST,)),
    "no manifest": (lambda b: (b / MANIFEST).unlink(), (MANIFEST,)),
    "manifest is a folder": (lambda b: replace_file(b / MANIFEST, Path.mkdir), (MANIFEST,)),
    "manifest is a pipe": (lambda b: replace_file(b / MANIFEST, os.mkfifo), (MANIFEST, "no regular file")),
    "weights are a pipe": (lambda b: replace_file(weights(b), os.mkfifo), ("weights-", "no regular file")),
    "weights are a device": (
        lambda b: replace_file(weights(b), lambda path: path.symlink_to("/dev/zero")),
        ("weights-", "no regular file"),
    ),
    "truncated manifest": (lambda b: os.truncate(b / MANIFEST, 200), (MANIFEST,)),
    "another program's file": (lambda b: (b / MANIFEST).write_text('{"format": "onnx"}'), (MANIFEST, FORMAT)),
    "deeply nested manifest": (lambda b: (b / MANIFEST).write_text("[" * 10**5), (MANIFEST,)),
    "huge manifest": (lambda b: (b / MANIFEST).write_text(" " * (MAX_BYTES + 1)), (MANIFEST, str(MAX_BYTES))),
    "no version": (lambda b: drop(b, "version"), ("None", str(VERSION))),
    "no weights in the manifest": (lambda b: drop(b, "weights"), (MANIFEST, "weights")),
    "edited by hand": (lambda b: edit(b, rehash=False, base="rigid"), (MANIFEST, "hash")),
    "huge weights": (lambda b: os.truncate(weights(b), MAX_BYTES + 1), ("weights-", str(MAX_BYTES))),
    "no weights": (lambda b: weights(b).unlink(), ("weights-",)),
    "truncated weights": (lambda b: os.truncate(weights(b), 100), ("weights-", "SHA-256")),
    "one bit of the weights": (lambda b: flip_a_bit(weights(b)), ("weights-", "SHA-256")),
    "weights that are none": (lambda b: put(b, b"\x80\x04pickled"), ("weights-x",)),
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
    ({"entries": [["motor_angle_error", "rad", 1.5, 5.0]]}, "motor_angle_error.*5.0"),
    ({"hidden": [10**9, 10**9]}, str(10**9)),
    ({"hidden": [-4]}, "-4"),
    ({"hidden": [8, 8]}, "weights-"),
    ({"lstm": 10**9}, str(10**9)),
    ({"gru": 4, "lstm": 4}, "an LSTM or a GRU"),
    ({"lstm": 4}, "weights-"),
    ({"weights": {"file": "../elsewhere.safetensors", "sha256": ""}}, "elsewhere"),
    ({"weights": {"file": "/etc/passwd", "sha256": ""}}, "/etc/passwd"),
    ({"weights": {"file": "weights-\0.safetensors", "sha256": ""}}, "weights-"),
    ({"residual": {"limit": 5.0, "hold": 4, "knowledge": "belief"}}, "5.0"),
    ({"residual": {"limit": 0.5, "hold": 4, "knowledge": "belief", "gain": 1.0}}, "gain"),
    ({"provenance": {"run": {"steps": MOST + 1}}}, "does not fit"),
    ({"provenance": {"run": {"seconds": -1e-9}}}, "does not fit"),
    ({"provenance": {"curve": [[0, 0.0, 1.0, 1.0]]}}, "does not fit"),
]


@pytest.mark.parametrize(("changes", "words"), WRONG, ids=lambda value: str(value)[:40])
def test_manifests_with_wrong_values_are_refused(bundle: Path, changes: dict[str, Any], words: str):
    edit(bundle, rehash=True, **changes)
    with pytest.raises(BundleError, match=words):
        load_controller(bundle)


PLACES = {
    "edition": (True, 2.5),
    "layout": ("2", None, [2]),
    "algorithm": ({}, ["ppo"], None, 1),
    "base": ({"paper": 1}, None),
    "residual": ([], "belief", None, {"limit": NAN}, {"hold": 10**400}, {"knowledge": ["belief"]}, {"limit": 0.5}),
    "hidden": (None, "44", [[4]], [4.5], {"4": 3}, [NAN]),
    "activation": ([], {}, 3),
    "sensors": ([], {}, None),
    "lstm": ("0", None, NAN, [0]),
    "gru": ("0", None, INF, {}),
    "standardised": (0, "yes", None),
    "base_settings": ({"gains": 3}, {"gains": {"a\nb": 1.0}}, {"doubts": {"swing": "0.5"}}, {"gains": {"angle": NAN}}),
    "base_hash": (3, []),
    "entries": (None, "speed", [3], [["motor_angle_error"]], [{}], {"a": 1}),
    "weights": (None, [], "weights-x.safetensors", {"file": []}, {"file": "weights-x.safetensors", "sha256": 3}),
    "provenance": (
        *(None, {"run": []}, {"run": {"steps": "5"}}, {"run": {"steps": NAN}}, {"run": {"steps": 10**400}}),
        *({"config": 3}, {"config": {"seed": [1]}}, {"note": INF}, {"versions": {"numpy": 2}}, {"commit": {}}),
        *({"curve": [[1, 2]]}, {"curve": [["a", "b", "c"]]}, {"validation_of_base": [1]}, {"command": "\ud800"}),
        *({"reached": 3}, {"reached": {"validation": {"cost": 1.0}}}),
    ),
}


@pytest.mark.parametrize("place", PLACES)
def test_manifests_that_are_not_as_they_should_be(place: str, bundle: Path):
    """In one line, before anything reads them: not as a traceback, and not by numbers that JSON does not have."""
    for value in PLACES[place]:
        edit(bundle, rehash=True, **{place: value})
        with pytest.raises(BundleError, match=MANIFEST) as caught:
            read_spec(bundle)
        assert "\n" not in str(caught.value), value


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
    @pytest.mark.parametrize("folder", SHIPPED, ids=lambda folder: "/".join(folder.parts[-3:]))
    def test_shipped_cards_are_what_is_written_today(self, folder: Path):
        """If not, `agents.policy.bundle.annotate` writes the card of a bundle again, and changes nothing else."""
        spec, content = read_spec(folder)
        text = (folder / CARD).read_text(encoding="utf-8")
        assert text == card(content)
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
