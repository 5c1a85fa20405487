"""Three parts of the siege: they find nothing here, and they do find what is wrong."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from baselines.tools.files import write_text
from eval.siege import chains, kills
from eval.siege.files import guided, inputs, readers
from eval.siege.files.damage import exploit


@pytest.mark.slow
def test_a_search_for_gains_survives_kills():
    (subject,) = [one for one in kills.SUBJECTS if one.name == "a search for gains"]
    count, found = kills.attack(subject, 0.05, 0)
    assert found == [] and count >= 3


def _careful(folder: Path) -> None:
    for name in "ab":
        write_text(folder / f"{name}.json", json.dumps([name] * 500))


def _careless(folder: Path) -> None:
    for name in "abcdef":
        if not (folder / f"{name}.json").exists():
            (folder / f"{name}.json").write_text(json.dumps([name] * 500))


def _fails_the_second_time(folder: Path) -> None:
    (folder / "begun").mkdir()
    _careful(folder)


def _meaning(folder: Path) -> dict[str, object]:
    return {path.name: json.loads(path.read_text()) for path in folder.glob("*.json")}


@pytest.mark.parametrize(
    ("run", "words"),
    [(_careful, ""), (_careless, "JSONDecodeError"), (_fails_the_second_time, "FileExistsError")],
)
def test_kills_find_what_does_not_survive_them(run: Callable[[Path], None], words: str):
    count, found = kills.attack(kills.Subject("it", run, run, _meaning), 1.0, 0)
    assert count > 5
    assert any(words in line for line in found) if words else found == []


def test_damaged_files_are_refused():
    siege = inputs.besiege(1e-4, 0)
    assert siege.found == [] and siege.count >= 100


FAULTS: dict[str, Callable[[Path], object]] = {
    "KeyError: 'size'": lambda path: json.loads(path.read_text())["size"],
    "accepted with another meaning": lambda path: json.loads(path.read_text()).get("size"),
    "leaves more": lambda path: (path.with_name("more").touch(), refuse("no size")),
    "changes sound.json": lambda path: (path.write_text("{}"), refuse("no size")),
    "a message of 301 characters": lambda path: refuse("x" * 301),
    "a message that is no line": lambda path: refuse("no\nsize"),
    "a pickle was executed": lambda path: pickle.loads(path.read_bytes()),
}


def refuse(message: str) -> None:
    raise ValueError(message)


@pytest.mark.parametrize("fault", FAULTS)
def test_inputs_find_a_reader_with_a_fault(fault: str, monkeypatch: pytest.MonkeyPatch):
    def reader(folder: Path) -> readers.Reader:
        path, sound = folder / "sound.json", b'{"size": 3}'
        path.write_bytes(sound)
        bad = exploit(folder) if "pickle" in fault else b'{ "other": 3}'
        return readers.Reader(
            lambda: 3 if path.read_bytes() == sound else FAULTS[fault](path) or 0, lambda _: ({path.name: bad}, False)
        )

    monkeypatch.setattr(inputs, "READERS", {"faulty": reader})
    monkeypatch.setattr(guided, "installed", lambda: False)
    assert fault in inputs.again("faulty", 0, 7)
    siege = inputs.besiege(1e-7, 0)
    assert siege.count == 1 and len(siege.found) == 1
    assert siege.found[0].startswith("eval.siege.files.inputs.again('faulty', 0, 0): ") and fault in siege.found[0]


COUNTING = """
import json, os, sys, time
from pathlib import Path
out, careful = Path(sys.argv[1]), sys.argv[2] == "careful"
out.mkdir(exist_ok=True)
file, lock = out / "count.json", out / "lock"
if careful:
    import fcntl
    handle = lock.open("w")
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        print(f"somebody counts in {out}", file=sys.stderr)
        sys.exit(2)
done = json.loads(file.read_text()) if file.exists() else []
for k in range(len(done) if careful else 0, 15):
    done.append(k)
    temporary = file.with_suffix(".new")
    temporary.write_text(json.dumps(done))
    temporary.replace(file)
    time.sleep(0.03)
"""


@pytest.mark.parametrize("how", ["careful", "careless"])
def test_chains_find_what_does_not_survive_kills_from_outside(how: str, monkeypatch: pytest.MonkeyPatch):
    def started(out: Path) -> subprocess.Popen[str]:
        words = [sys.executable, "-c", COUNTING, str(out), how]
        return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    monkeypatch.setattr(chains, "_started", started)
    monkeypatch.setattr(
        chains, "meaning_of_training", lambda out: {"count": json.loads((out / "count.json").read_text())}
    )
    siege = chains.besiege(0.1, 0)
    assert siege.count == 5
    assert [line.split(":")[0] for line in siege.found] == (
        [] if how == "careful" else ["chain 0 of seed 0", "two trainings at a time in one folder"]
    )


@pytest.mark.parametrize(("reader", "number"), [("checkpoint", 6500)])
def test_inputs_that_broke_a_promise_once(reader: str, number: int):
    assert inputs.again(reader, 0, number) == ""


def test_guided_choices_are_those_of_the_bytes():
    assert guided.Choices(b"\x00\x80").random() == 0 and guided.Choices(b"\xff").random() == 255 / 256
    assert guided.Choices(b"\x05\x01").getrandbits(16) == 0x105
    assert [guided.Choices(bytes([k])).randrange(4) for k in range(4)] == [0, 1, 2, 3]
    assert guided.Choices(b"").random() == guided.Choices(b"").random(), "the same for ever after their end"
    assert inputs.again_by("gains", "00ff07") == ""


FAULTY = """
from eval.siege.files import guided, readers

def reader(folder):
    (folder / "sound").write_bytes(b"sound")
    return readers.Reader((folder / "sound").read_bytes, lambda rng: ({"sound": rng.randbytes(2)}, False))

readers.READERS["faulty"] = reader
guided.look("faulty", 1, 50)
"""


def test_guided_damage_finds_a_reader_with_a_fault(tmp_path: Path):
    pytest.importorskip("atheris")
    done = subprocess.run([sys.executable, "-c", FAULTY], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "found eval.siege.files.inputs.again_by('faulty', '" in done.stdout
    assert done.stdout.count("is accepted with another meaning") == 1
