"""`eval/paper.py` as a user runs it, and every number of docs/science/paper.md against what it computes."""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from commands import mistake, stopped

from beltarm_env import ArmParams
from beltarm_env.task.seeds import PAPER_MOVES
from eval import paper
from eval.reproduction.assumptions import USUAL_MOVE
from eval.reproduction.loop import (
    PAPER_ARM,
    ServoGains,
    best_gain,
    closed_loop,
    digital_poles,
    dominant_damping,
    natural_frequency_locus,
    nominal_m2,
    poles,
    sampled_poles,
)
from eval.reproduction.pole_tables import FREQUENCY_FACTORS
from eval.reproduction.ringing import END_WINDOW, REDUCED, REMOVED
from eval.reproduction.study import (
    AS_ANALYSED,
    FRICTION,
    FULL,
    FULL_ANALYSED,
    MEASURED,
    STANDARD,
    TO_0,
    PaperStudy,
    run_study,
)

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/science/paper.md"
TABLE_2, DEG_90 = ServoGains(), math.pi / 2
PICTURES = {
    *("responses_standard.png", "responses_standard_as_analysed.png", "responses_to_0.png"),
    *("root_locus_90.png", "root_locus_0.png", "damping_map.png", "assumptions.png", "moves.png"),
}
DRIVE_PICTURES = {"drive.png", "drive_ratios.png"}


class Regenerated(NamedTuple):
    folder: Path
    output: str
    study: PaperStudy


@pytest.fixture(scope="module")
def regenerated(tmp_path_factory: pytest.TempPathFactory) -> Regenerated:
    """What the command writes and prints without options, and the study behind it."""
    folder, output, studies = tmp_path_factory.mktemp("paper"), io.StringIO(), []

    def recorded(*arguments) -> PaperStudy:
        studies.append(run_study(*arguments))
        return studies[0]

    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(output):
        patch.setattr(paper, "run_study", recorded)
        assert stopped(paper.main, (), folder) == (0, "")
    return Regenerated(folder / "results" / "paper", output.getvalue(), studies[0])


class TestTables:
    @pytest.mark.slow
    def test_everything_is_written(self, regenerated: Regenerated):
        folder = regenerated.folder
        assert {path.name for path in folder.iterdir()} == {"tables.md", "drive.md", *PICTURES, *DRIVE_PICTURES}
        for name in (*PICTURES, *DRIVE_PICTURES):
            picture = (folder / name).read_bytes()
            assert picture.startswith(b"\x89PNG") and len(picture) < 150_000

    @pytest.mark.slow
    def test_the_terminal_shows_the_answers(self, regenerated: Regenerated):
        assert regenerated.output.startswith("Does K4 = 0.15 remove the tip's ringing?\n")
        assert "| as analysed | yes |" in regenerated.output
        assert "| with friction | in part |" in regenerated.output
        table = regenerated.output.split("\n\n")[1].split("\nwritten to")[0]
        assert table in (regenerated.folder / "tables.md").read_text(encoding="utf-8")

    @pytest.mark.slow
    def test_tables_are_well_formed(self, regenerated: Regenerated):
        text = (regenerated.folder / "tables.md").read_text(encoding="utf-8")
        assert set(re.findall(r"!\[[^]]*\]\(([^)]*)\)", text)) == PICTURES
        assert not re.search(r"\b(nan|inf)\b", text)
        for block in text.split("\n\n"):
            if block.startswith("|"):
                assert len({line.count("|") for line in block.splitlines()}) == 1, block

    @pytest.mark.slow
    def test_the_page_of_the_drive_is_well_formed(self, regenerated: Regenerated):
        text = (regenerated.folder / "drive.md").read_text(encoding="utf-8")
        assert set(re.findall(r"!\[[^]]*\]\(([^)]*)\)", text)) == DRIVE_PICTURES
        assert not re.search(r"\b(nan|inf)\b", text)
        for block in text.split("\n\n"):
            if block.startswith("|"):
                assert len({line.count("|") for line in block.splitlines()}) == 1, block

    @pytest.mark.parametrize("page", ["tables.md", "drive.md"])
    @pytest.mark.slow
    def test_committed_tables_show_the_same_numbers(self, page: str, regenerated: Regenerated):
        """All but the provenance; another processor may round a last digit differently."""
        number = re.compile(r"\d+(?:\.\d+)?")
        new, committed = (
            (folder / page).read_text(encoding="utf-8").rsplit("\n\n", 1)[0]
            for folder in (regenerated.folder, ROOT / "docs/results/paper")
        )
        assert number.sub("#", new) == number.sub("#", committed), "run `make paper`"
        values = [np.array(number.findall(text), dtype=np.float64) for text in (new, committed)]
        np.testing.assert_allclose(*values, rtol=0.02, atol=0.011, err_msg="run `make paper`")


class Claim(NamedTuple):
    """A phrase of the page with `{}` for each number, and the numbers."""

    phrase: str
    values: tuple[float, ...]


def damping(angle: float, k4: float = 0.15, **options) -> float:
    return float(dominant_damping(poles(closed_loop(PAPER_ARM, angle, ServoGains(k4), **options))))


def drives_damping(angle: float) -> float:
    """Of the drive's pairs, the one that is not the simulation's own."""
    pairs = digital_poles(PAPER_ARM, angle, TABLE_2)
    own = math.sqrt(PAPER_ARM.belt_stiffness / nominal_m2(angle))
    others = pairs[(pairs.imag > 1e-6) & (np.abs(np.abs(pairs) - own) > 1e-6)]
    return float(dominant_damping(others))


def twice_counted(angle: float) -> float:
    """Share of M_a1 that M2/G² comes to [%]."""
    return 100 * nominal_m2(angle) / (PAPER_ARM.gear_ratio**2 * PAPER_ARM.motor_inertia)


def claims_of_the_moves(study: PaperStudy) -> Iterator[Claim]:
    def left(view: str, phase: str, place: str = STANDARD) -> float:
        return 100 * study.scenes[place, view].ringing.ratio(phase)

    def tried(view: str, label: str) -> float:
        return 100 * study.found[view][label].ratio("end")

    k4, answers = study.gains.k4, {view: study.answers(view) for view in (AS_ANALYSED, FRICTION)}
    yield Claim(
        "With K4 = {} the standard move keeps {} % of its ringing in the last {} s as analysed, and {} % with friction",
        (k4, left(AS_ANALYSED, "end"), END_WINDOW, left(FRICTION, "end")),
    )
    yield Claim(
        "*Yes* means that less than {} % of the ringing without K4 is left in the last {} s, *in part* less than {} %",
        (100 * REMOVED, END_WINDOW, 100 * REDUCED),
    )
    counts = answers[AS_ANALYSED]
    yield Claim("Of {} other values tried, the answer becomes *in part* with {}", (counts.total(), counts["in part"]))
    yield Claim(
        "and *no* with {}, an arm whose M2(90°) is {} % above what the controller takes it to be, which keeps {} %",
        (counts["no"], 100 * (0.09 / 0.07 - 1), tried(AS_ANALYSED, "M2(90°) 0.09, taken for 0.07")),
    )
    counts = answers[FRICTION]
    yield Claim(
        "Of {} others, the answer becomes *yes* with {}, no Coulomb friction ({} % are left), and *no* with {}: ramps "
        "of {} s ({} %), ramps of {} s ({} %), a move of {} s ({} %)",
        (
            *(counts.total(), counts["yes"], tried(FRICTION, "no Coulomb friction"), counts["no"]),
            *(0.25, tried(FRICTION, "ramps of 0.25 s"), 0.3, tried(FRICTION, "ramps of 0.3 s")),
            *(1.2, tried(FRICTION, "move of 1.2 s")),
        ),
    )
    ideal, real = (study.shares(view, "end") for view in (AS_ANALYSED, FRICTION))
    yield Claim(
        "Of {} random ones the answer is *yes* on {} % as analysed; ringing is reduced on {} % and increased on {} %. "
        "With friction these are {} %, {} % and {} %",
        (
            *(PAPER_MOVES.size, 100 * ideal.removed, 100 * ideal.reduced, 100 * ideal.increased),
            *(100 * real.removed, 100 * real.reduced, 100 * real.increased),
        ),
    )
    yield Claim(
        "keeps {} % of the ringing after the stop on the standard move with friction, and {} % on the one to 0°; the "
        "median over the random moves is {}. As analysed they are {} %, {} % and {}",
        (
            *(left(FULL, "stop"), left(FULL, "stop", TO_0), study.shares(FULL, "stop").median),
            *(left(FULL_ANALYSED, "stop"), left(FULL_ANALYSED, "stop", TO_0)),
            study.shares(FULL_ANALYSED, "stop").median,
        ),
    )
    scene = study.scenes[STANDARD, FRICTION]
    yield Claim(
        "with an error of {} rad/s RMS, {} % of its cruising speed, while the tip rings with {} m/s² during the cruise "
        "and {} m/s² after the stop",
        (
            *(scene.without.motor_speed_error, 100 * scene.without.motor_speed_error / scene.without.cruising_speed),
            *(float(scene.ringing.without.cruise[0]), float(scene.ringing.without.stop[0])),
        ),
    )
    yield Claim(
        "{} % of the ringing are left during the cruise, {} % after the stop. The price is the motor's tracking: an "
        "error of {} rad/s, {} % of its cruising speed",
        (
            *(left(FRICTION, "cruise"), left(FRICTION, "stop"), scene.suppressed.motor_speed_error),
            100 * scene.suppressed.motor_speed_error / scene.suppressed.cruising_speed,
        ),
    )
    yield Claim(
        "the motor sticks for {} % of the time with K4 = 0, for {} % with K4 = {}",
        (100 * scene.without.stuck_share, 100 * scene.suppressed.stuck_share, k4),
    )
    yield Claim("{} % of the ringing after the stop are left", (left(AS_ANALYSED, "stop"),))
    yield Claim("{} % of the ringing are left in the last {} s", (left(AS_ANALYSED, "end", TO_0), END_WINDOW))
    yield Claim(
        "M2/G² counts twice: {} % of M_a1 with M2({}°), {} % with M2({}°)",
        (twice_counted(0.0), 0, twice_counted(DEG_90), 90),
    )
    peaks = (study.scenes[STANDARD, view].suppressed.peak_torque for view in (FRICTION, AS_ANALYSED))
    yield Claim("torque peaks at {} N m with friction and {} N m as analysed", tuple(peaks))
    yield Claim(
        "*Removed* is a ratio below {}, *reduced* one below {}, *increased* one above {}",
        (REMOVED, REDUCED, 1 / REDUCED),
    )
    yield Claim(
        "leads from {}° to {}° in {} s with ramps of {} s",
        (*np.degrees(study.move[:2]).tolist(), *study.move[2:]),
    )


def claims_of_the_loop() -> Iterator[Claim]:
    yield Claim(
        "K4 = {} takes the smallest damping ratio from {} to {}. No K4 does much better: the most is {}, with {}.",
        (TABLE_2.k4, damping(DEG_90, 0.0), damping(DEG_90), *best_gain(TABLE_2, nominal_m2(DEG_90))[::-1]),
    )
    printed = [damping(angle, as_printed=True) for angle in (0.0, DEG_90)]
    yield Claim(
        "has the damping ratios {} and {}, where the right sign gives {} and {}",
        (*printed, damping(0.0), damping(DEG_90)),
    )
    held = [float(dominant_damping(sampled_poles(PAPER_ARM, angle, TABLE_2))) for angle in (0.0, DEG_90)]
    yield Claim(
        "the pair has {} at 0° and {} at 90°; with the speed by differencing and the torsion simulated from it as "
        "well, {} and {}",
        (*held, drives_damping(0.0), drives_damping(DEG_90)),
    )
    own = [digital_poles(PAPER_ARM, angle, TABLE_2)[0] for angle in (0.0, DEG_90)]
    yield Claim(
        "behind a motor held still: {} ± {}j at 0° and {} ± {}j at 90°",
        tuple(part for pole in own for part in (pole.real, abs(pole.imag))),
    )
    full = [damping(angle, model="lagrangian") for angle in np.radians([0, 45, 90])]
    yield Claim("is unstable at 0° with the torsional velocity measured (damping {})", (full[0],))
    without = [damping(angle, 0.0, model="lagrangian") for angle in np.radians([0, 45, 90])]
    simulated = [
        float(dominant_damping(digital_poles(PAPER_ARM, angle, TABLE_2, model="lagrangian")))
        for angle in np.radians([0, 45, 90])
    ]
    yield Claim("which is at most {} with it and {} without", (max(simulated), max(without)))
    best = [best_gain(TABLE_2, nominal_m2(*at)) for at in ((0.0, 0.0), (DEG_90, 0.0), (DEG_90, 0.2))]
    yield Claim(
        "largest with {} N m s/rad at 0° ({}), {} at 90° ({}) and {} at 90° with a payload of 0.2 kg ({})",
        tuple(value for pair in best for value in pair),
    )
    frequencies = TABLE_2.natural_frequency * np.array(FREQUENCY_FACTORS)
    over = dominant_damping(natural_frequency_locus(PAPER_ARM, DEG_90, TABLE_2, frequencies))
    yield Claim(
        "Fig. 6(b): {} at {} rad/s, {} at {} rad/s, {} at {} rad/s, {} at {} rad/s",
        tuple(float(value) for pair in zip(over, frequencies, strict=True) for value in pair),
    )


def prose() -> str:
    """The page in one line, without its table of assumptions."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    return " ".join(" ".join(line for line in lines if not line.startswith("|")).split())


def check(claim: Claim, text: str) -> str:
    """The text without the claim's phrase, which stands there once and whose numbers are right as printed."""
    found = re.findall(re.escape(claim.phrase).replace(r"\{\}", r"(−?\d+(?:\.\d+)?)"), text)
    assert len(found) == 1, f"docs/science/paper.md says {len(found)} times: {claim.phrase}"
    printed = found[0] if isinstance(found[0], tuple) else found
    for number, value in zip(printed, claim.values, strict=True):
        digits = len(number.partition(".")[2])
        expected = pytest.approx(float(number.replace("−", "-")), abs=0.55 * 10**-digits)  # 0.05: other processors
        assert value == expected, claim.phrase
    return text.replace(claim.phrase.format(*printed), "")


NAMES = "|".join(
    (
        r"K4 = 0(?:\.15)?(?!\.?\d)|K4|M2|l3|_a1|M_a1|Table \d|\(\d+[a-z]?\)|Figs?\. \d\([ab]\)|and 8\(b\)|Fig\. 6",
        r"(?:0|45|90)°|[+−]1/\(M|0\.2 kg|1\.5 ms|0\.3 s|Two-mass|\w+\.(?:png|md|py)|: 1 where all|left of 1 it",
        r"mode, 28\.7 rad/s|less than 0\.1 %",  # in docs/science/physics.md, tests/env/test_models.py; below
    )
)


class TestPage:
    @pytest.mark.slow
    def test_every_number_is_what_is_computed(self, regenerated: Regenerated):
        text = prose()
        for claim in (*claims_of_the_moves(regenerated.study), *claims_of_the_loop()):
            text = check(claim, text)
        rest = re.sub(NAMES, "", text)
        unchecked = [rest[max(0, m.start() - 40) : m.end() + 20] for m in re.finditer(r"\d+", rest)]
        assert not unchecked, "numbers that no claim states"

    def test_a_stale_number_is_noticed(self):
        claim = Claim("rings with {} m/s²", (3.64,))
        assert check(claim, "it rings with 3.6 m/s² there") == "it  there"
        for text in ("it rings with 3.7 m/s²", "it rings with 3.60 m/s²", "it sings with 3.6 m/s²"):
            with pytest.raises(AssertionError):
                check(claim, text)

    @pytest.mark.slow
    def test_words_are_those_of_the_numbers(self, regenerated: Regenerated):
        study = regenerated.study
        assert [study.standard(view).answer for view in (AS_ANALYSED, FRICTION)] == ["yes", "in part"]
        assert 0.8 * REMOVED < study.standard(AS_ANALYSED).ratio("end") < REMOVED, "close to the bound"
        assert study.scenes[TO_0, MEASURED].ringing.ratio("end") < 1e-3
        assert study.scenes[STANDARD, AS_ANALYSED].suppressed.stuck_share == 0, "as analysed it never sticks"
        answers = {label: found.answer for label, found in study.found[AS_ANALYSED].items()}
        changed = {a.name: [answers[tried.label] != "yes" for tried in a.alternatives] for a in study.assumptions}
        assert all(changed["duration of the move"]) and all(changed["how the arm folds"])
        for most in ("ramp time of the trapezoid", "M2(90°)"):
            assert np.mean(changed[most]) > 0.5
        friction = [tried.label for tried in study.tried(AS_ANALYSED) if "friction" in tried.label]
        assert all(answers[label] == "in part" for label in friction)
        assert damping(0.0, as_printed=True) < 0 and damping(DEG_90, as_printed=True) < 0, "unstable as printed"
        for angle in np.radians([0, 45, 90]):
            with_k4 = digital_poles(PAPER_ARM, angle, TABLE_2, model="lagrangian")
            assert dominant_damping(with_k4) < damping(angle, 0.0, model="lagrangian") + 5e-4
            assert np.count_nonzero(with_k4.imag > 1e-6) == 2, "two oscillating pairs"

    @pytest.mark.slow
    def test_table_of_assumptions(self, regenerated: Regenerated):
        lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")][1:]
        rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
        assumptions = regenerated.study.assumptions
        assert [(row[0], row[2]) for row in rows] == [(a.name, a.chosen) for a in assumptions]
        assert f"has {6 * 0.01 / (2 * 0.25**2):.2f} kg" in PAGE.read_text(encoding="utf-8")  # 2 m_2 l^2 = 6 M2(0)
        assert ArmParams().arm_inertia == 0.01 and ArmParams().link_length == 0.25


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--k4", "-1"), "gain k4 must lie within 0 and 1 N m s/rad, got -1"),
        (("--natural-frequency", "nan"), "gain natural_frequency must lie within 0.1 and 100 rad/s, got nan"),
        (("--start-deg", "95"), "--start-deg must lie within 0 and 90 degrees, got 95"),
        (("--duration", "0.3", "--ramp-time", "0.1"), "infeasible move"),
        (("--out", "/dev/null/paper"), "cannot write to /dev/null/paper"),
    ],
)
def test_bad_options(arguments: tuple[str, ...], message: str, tmp_path: Path):
    line = mistake(paper.main, arguments, tmp_path)
    assert line.startswith("eval/paper.py: ") and message in line
    assert not list(tmp_path.iterdir())


def test_default_options_are_the_usual_move_and_table_2():
    assert paper.Config().move == USUAL_MOVE and paper.Config().gains == TABLE_2


def run(script: Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", str(script)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=600, check=False)


@pytest.mark.parametrize("missing", ["control", "matplotlib", "tyro"])
def test_missing_extra_is_named(missing: str, tmp_path: Path):
    script = tmp_path / "without.py"
    script.write_text(
        f"import runpy, sys\nsys.modules[{missing!r}] = None\nsys.argv = ['paper.py']\n"
        f"runpy.run_path({str(ROOT / 'eval/paper.py')!r}, run_name='__main__')\n"
    )
    result = run(script, tmp_path)
    assert result.returncode == 2
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith(f"eval/paper.py: {missing} is not installed") and "make setup" in line


def test_interrupt_ends_with_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(paper, "run_study", interrupted)
    assert stopped(paper.main, (), tmp_path) == (130, "eval/paper.py: interrupted\n")


def test_a_closed_pipe_is_no_error(tmp_path: Path):
    script = tmp_path / "closed.py"
    script.write_text(
        f"import sys\nsys.path.insert(0, {str(ROOT)!r})\nfrom baselines.tools.command import one_line_errors\n"
        "sys.stdin.readline()\nwith one_line_errors('eval/paper.py'):\n    print('told', flush=True)\n"
    )
    command = [sys.executable, str(script)]
    pipe = subprocess.PIPE
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=buffered) as process:
        assert process.stdout is not None
        process.stdout.close()
        process.stdout = None
        _, errors = process.communicate("go\n", timeout=300)
    assert (process.returncode, errors) == (0, "")


def test_start_up_does_not_load_torch(tmp_path: Path):
    script = tmp_path / "loaded.py"
    script.write_text(
        f"import sys\nsys.path.insert(0, {str(ROOT)!r})\nimport eval.paper\n"
        "print([name for name in ('torch', 'stable_baselines3', 'pandas') if name in sys.modules])\n"
    )
    assert run(script, tmp_path).stdout == "[]\n"
