"""Policies in files: what they hold, what is refused, that loading executes nothing, and their cards."""

import errno
import math
import os
import pickle
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import DEFAULT, Mock

import numpy as np
import pytest
from bundles import SPEC, Exploit, edit, new_weights
from refusals import refused
from safetensors.numpy import save

from agents.policy.bundle import CARD, POLICY_FILE, annotate, card, load_controller, read_bundle, read_spec, save_bundle
from agents.policy.description import MADE_FOR, BundleError, BundleSpec
from agents.policy.network import NetworkPolicy
from agents.residual.bases import make_base, settings_hash
from agents.residual.controller import ResidualController, ResidualSettings
from agents.tensor_file import MAX_BYTES, packed
from baselines import CONTROLLERS, PaperController
from baselines.optimal.adaptive import AccelerometerAdaptiveController
from beltarm_env.rollout import rollout

NAN = math.nan
MOST = 10**15
SETTINGS = ResidualSettings()
NOTED: Any = {"provenance": {"seed": 3, "note": "ζ", "a": {"b": [1, None]}}}
SPECS = {
    "plain": BundleSpec("ppo", "paper", SETTINGS, (16, 16)),
    "more sensors": BundleSpec("ppo", "rigid", ResidualSettings(0.8, 12), (8,), "relu", "tip", **NOTED),
    "no base": BundleSpec("sac", "none", ResidualSettings(2.0, 10), (), "elu", "full", **NOTED),
    "lstm": BundleSpec("recurrent_ppo", "paper", ResidualSettings(0.5, 6, "none"), (8,), "relu", lstm=12),
    "gru": BundleSpec("student", "adaptive", SETTINGS, (8,), "relu", gru=10, standardised=True),
}
SHIPPED = sorted(path.parent for path in Path(__file__).parents[2].glob(f"agents/policies*/*/*/{POLICY_FILE}"))


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    folder = tmp_path / "policy"
    save_bundle(folder, SPEC, new_weights())
    load_controller(folder)
    return folder


def same(ours: dict[str, np.ndarray], theirs: dict[str, np.ndarray]) -> bool:
    return ours.keys() == theirs.keys() and all(ours[name].tobytes() == theirs[name].tobytes() for name in ours)


class TestSaved:
    @pytest.mark.parametrize("name", SPECS)
    def test_bundle_gives_the_same_policy_bit_for_bit(self, tmp_path: Path, name: str):
        spec = SPECS[name]
        save_bundle(tmp_path, spec, new_weights(spec, 0))
        read, described, *_ = read_bundle(tmp_path)
        assert described == spec and same(read.arrays, new_weights(spec, 0).arrays)
        original = ResidualController(make_base(spec.base), NetworkPolicy(new_weights(spec, 0)), spec.residual)
        arms: dict[str, Any] = {"seed": 1, "sensors": spec.sensors, "randomization": "train"}
        ours, theirs = (rollout(controller, 3, **arms) for controller in (original, load_controller(tmp_path)))
        assert ours.torque.tobytes() == theirs.torque.tobytes() and ours.state.tobytes() == theirs.state.tobytes()

    def test_its_hash_depends_on_content_alone(self, tmp_path: Path):
        spec, found = SPECS["plain"], list[str]()
        for name in ("a", "b", "a"):
            known = read_spec(tmp_path / "a")[0] if name == "b" else spec
            save_bundle(tmp_path / name, known, new_weights(spec, 0))
            found.append(read_spec(tmp_path / name)[1]["sha256"])
        files = [sorted((path.name, path.read_bytes()) for path in (tmp_path / name).iterdir()) for name in "ab"]
        assert files[0] == files[1] and len(files[0]) == 2 and len({*found}) == 1
        for changed in (replace(spec, provenance={"seed": 1}), replace(spec, residual=replace(SETTINGS, hold=5)), spec):
            save_bundle(tmp_path / "d", changed, new_weights(spec, int(changed == spec)))
            found.append(read_spec(tmp_path / "d")[1]["sha256"])
        assert len({*found}) == 4 and len(list((tmp_path / "d").iterdir())) == 2
        assert same(read_bundle(tmp_path / "d")[0].arrays, new_weights(spec, 1).arrays)

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
        refused(ValueError, ("(2, 3)", "--sensors"), lambda: loaded.policy.predict(np.ones((2, 3), np.float32)))

    def test_with_an_accelerometer_the_filter_of_the_base_has_it_too(self, tmp_path: Path):
        spec = BundleSpec("student", "adaptive", SETTINGS, (8,), sensors="accelerometer")
        save_bundle(tmp_path, spec, new_weights(spec, 0))
        assert isinstance(load_controller(str(tmp_path)).informed.base, AccelerometerAdaptiveController)
        assert not isinstance(make_base("adaptive"), AccelerometerAdaptiveController)
        assert isinstance(make_base("paper", "accelerometer"), PaperController)  # which has no filter

    def test_policies_that_are_not_saved(self, bundle: Path):
        before = read_spec(bundle)
        wide, curve = replace(SPEC, hidden=(600, 600)), replace(SPEC, provenance={"curve": [[0, 1.0, NAN]]})
        refused(ValueError, (str(MAX_BYTES),), lambda: save_bundle(bundle, wide, new_weights(wide)))
        refused(ValueError, ("(600, 600)", "(4, 3)"), lambda: save_bundle(bundle, wide, new_weights()))
        refused(ValueError, ("JSON",), lambda: save_bundle(bundle, curve, new_weights()))
        assert read_spec(bundle) == before


@pytest.mark.parametrize("files_written", [0, 1])
def test_a_policy_that_is_not_replaced_stays_valid(bundle: Path, monkeypatch: pytest.MonkeyPatch, files_written: int):
    before, full = (bundle / POLICY_FILE).read_bytes(), OSError(errno.ENOSPC, "No space")
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", Mock(wraps=os.replace, side_effect=[*[DEFAULT] * files_written, full]))
        refused(OSError, ("No space",), lambda: save_bundle(bundle, SPEC, new_weights()))
    assert (bundle / POLICY_FILE).read_bytes() == before
    assert sorted(os.listdir(bundle)) == sorted((CARD, POLICY_FILE))
    save_bundle(bundle, SPEC, new_weights())


def damaged(place: Callable[[bytes], int]) -> Callable[[Path], object]:
    """Change of one bit of a file, at a place that follows from its content."""

    def change(bundle: Path) -> None:
        data = bytearray((bundle / POLICY_FILE).read_bytes())
        data[place(bytes(data))] ^= 1
        (bundle / POLICY_FILE).write_bytes(data)

    return change


def foreign(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], object]:
    return lambda bundle: edit(bundle, {name: change(value) for name, value in new_weights().arrays.items()})


def written(data: bytes) -> Callable[[Path], object]:
    return lambda bundle: (bundle / POLICY_FILE).write_bytes(data)


DAMAGES: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "no folder": (shutil.rmtree, ("is missing", "runs/ppo/best")),
    "no file": (lambda b: (b / POLICY_FILE).unlink(), ("is missing",)),
    "a pipe": (lambda b: ((b / POLICY_FILE).unlink(), os.mkfifo(b / POLICY_FILE)), ("no regular file",)),
    "nothing": (written(b""), ("no policy",)),
    "another file": (written(b"something else"), ("no policy",)),
    "a pickle": (written(pickle.dumps(SPEC)), ("no policy",)),
    "tensors alone": (written(save(new_weights().arrays)), ("no policy",)),
    "an observer": (written(packed("observer", {}, new_weights().arrays)), ("no policy", "policy")),
    "no object": (written(save({}, metadata={"policy": "[]"})), ("no policy",)),
    "deeply nested": (written(save({}, metadata={"policy": "[" * 10**5})), ("no policy",)),
    "huge": (lambda b: os.truncate(b / POLICY_FILE, MAX_BYTES + 1), (str(MAX_BYTES),)),
    "cut": (lambda b: os.truncate(b / POLICY_FILE, 900), ("no policy",)),
    "one bit of the weights": (damaged(lambda data: len(data) - 1), ("SHA-256",)),
    "one bit of the text": (damaged(lambda data: data.index(b"limit") + 9), ("SHA-256",)),
    "edited by hand": (lambda b: edit(b, rehash=False, base="rigid"), ("SHA-256",)),
    "another program's description": (lambda b: edit(b, format="onnx"), ("'onnx'", "beltarm-policy")),
    "weights of another network": (lambda b: edit(b, new_weights(replace(SPEC, hidden=(5,))).arrays), ("of shape",)),
    "weights in double precision": (foreign(lambda value: value.astype(float)), ("float64",)),
    "weights of NaN": (foreign(lambda value: value * np.float32(NAN)), ("not finite",)),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_policies_are_refused(bundle: Path, damage: str):
    break_it, words = DAMAGES[damage]
    break_it(bundle)
    for read in (load_controller, read_spec):
        refused(BundleError, words, lambda read=read: read(bundle))


WRONG: list[tuple[dict[str, Any], str]] = [
    *[({name: value}, str(value)) for name in MADE_FOR for value in (None, "x", [2], {}, 99, NAN)],
    *[({name: value}, value) for name, value in [("algorithm", "dqn"), ("base", "lqr"), ("activation", "gelu")]],
    *[({name: ...}, f"{name} must be there") for name in ("base_settings", "base_hash", "hidden")],
    ({"sensors": "sonar"}, "sonar"),
    ({"entries": []}, "entries"),
    ({"entries": [["tip_speed", "m/s", 1.0, 1.0]]}, "tip_speed"),
    ({"entries": [["motor_angle_error", "deg", 1.5, 200.0]]}, "motor_angle_error.*deg"),
    ({"entries": [["motor_angle_error", "rad", 3.0, 200.0]]}, "motor_angle_error.*3.0"),
    ({"hidden": [10**9, 10**9]}, str(10**9)),
    ({"hidden": [4] * 9}, "8 hidden"),
    ({"hidden": [8, 8]}, "does not hold the weights"),
    ({"gru": 4, "lstm": 4}, "an LSTM or a GRU"),
    ({"lstm": 4}, "does not hold the weights"),
    ({"residual": {"limit": 5.0, "hold": 4, "knowledge": "belief"}}, "5.0"),
    ({"residual": {"limit": 0.5, "hold": 4, "knowledge": "belief", "gain": 1.0}}, "gain"),
    ({"provenance": {"run": {"steps": MOST + 1}}}, "does not fit"),
    ({"provenance": {"curve": [[0, 0.0, 1.0, 1.0]]}}, "does not fit"),
    # Of no such kind
    *[({name: value}, name) for name, value in [("algorithm", {}), ("base", None), ("activation", []), ("gru", "0")]],
    *[({name: value}, name) for name, value in [("sensors", {}), ("standardised", 0), ("base_hash", 3)]],
    *[({name: value}, name) for name, value in [("lstm", NAN), ("residual", {"limit": 0.5}), ("hidden", [4.5])]],
    ({"entries": [[1]]}, "entries"),
    ({"base_settings": {"gains": {"a\nb": 1.0}}}, "base_settings"),
    ({"provenance": {"run": {"steps": 10**400}}}, "not finite"),
]


@pytest.mark.parametrize(("changes", "words"), WRONG, ids=lambda value: str(value)[:40])
def test_descriptions_with_wrong_values_are_refused(bundle: Path, changes: dict[str, Any], words: str):
    """In one line, before anything uses them: not as a traceback, and not by numbers that JSON does not have."""
    edit(bundle, **changes)
    with pytest.raises(BundleError, match=rf"^[^\n]*{POLICY_FILE}[^\n]*\Z") as caught:
        load_controller(bundle)
    assert re.search("NaN is not finite" if NAN in changes.values() else words, str(caught.value))


def test_a_base_has_the_gains_that_it_had_in_training_or_is_refused(bundle: Path):
    settings = read_spec(bundle)[1]["base_settings"]
    settings["gains"]["angle"] = 1.0
    edit(bundle, base_settings=settings, base_hash=settings_hash(settings))
    annotate(bundle, note=1)
    assert read_spec(bundle)[1]["base_settings"] == settings
    base = load_controller(bundle).informed.base
    assert isinstance(base, PaperController) and base.gains.angle == 1.0 != CONTROLLERS["paper"]().gains.angle
    for part, field in (("gains", "angel"), ("doubts", "swing")):
        another = {**settings, part: {**settings[part], field: 0.5}}
        edit(bundle, base_settings=another, base_hash=settings_hash(another))
        refused(BundleError, (POLICY_FILE, f"{part}.{field}"), lambda: load_controller(bundle))


def test_loading_executes_nothing(bundle: Path, monkeypatch: pytest.MonkeyPatch):
    """A pickle in place of a policy is refused and not run; nothing is unpickled."""
    pickled = pickle.dumps(Exploit(bundle.parent / "executed"))
    with monkeypatch.context() as patched:
        for name in ("pickle.load", "pickle.loads", "pickle.Unpickler", "torch.load"):
            patched.setattr(name, None)
        load_controller(bundle)
    (bundle / POLICY_FILE).write_bytes(pickled)
    refused(BundleError, (POLICY_FILE,), lambda: load_controller(bundle))
    assert not (bundle.parent / "executed").exists()
    pickle.loads(pickled)
    assert (bundle.parent / "executed").exists(), "the exploit should work where a pickle is loaded"


def test_shipped_cards_are_what_is_written_today():
    """If not, `agents.policy.bundle.annotate` writes the card of a policy again, and changes nothing else."""
    for folder in SHIPPED:
        assert (folder / CARD).read_text(encoding="utf-8") == card(read_spec(folder)[1]), folder
