"""The methods of the comparison: classical controllers, shipped or given policies, an oracle, and a user's own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, groupby, islice
from pathlib import Path
from typing import Any, Literal, NamedTuple

from agents.policy.bundle import POLICIES, POLICY_FILE, load_controller, read_bundle, read_spec, told_apart
from agents.policy.description import BundleSpec
from agents.residual.controller import behind_guard
from baselines import CONTROLLERS, DOMINATED
from baselines.gains import read_file
from baselines.tools.command import require_known
from baselines.yardsticks.privileged import PrivilegedController
from beltarm_env import ArmParams
from beltarm_env.observation import Sensors
from beltarm_env.rollout import Controller
from eval.comparison import custom
from eval.comparison.carrying import Carried, carry
from eval.comparison.splits import digest_of

Kind = Literal["classical", "learned", "privileged", "added"]
PRIVILEGED = "privileged"
PRIMARY = ("student", "adaptive")
"""Learned method and classical controller that the comparison is about first: the best ones on the development set,
named in docs/benchmark/protocol.md before the test scenarios were drawn."""
LARGEST_BATCH = 500
"""Arms of a batch of several training seeds or splits; larger batches are hardly faster."""

EFFORT = ("simulator_steps", "wall_clock_s", "trials", "refused", "base_steps")
"""Effort of tuning or training, a number per training seed: samples and seconds; of a search for gains also its trials,
and the proposals that it refused because their loop fell short of the margins; of a learned method the samples of the
search for its base's gains. Empty: neither tuned nor trained here."""


@dataclass(frozen=True, slots=True)
class Method:
    """Recipe for a controller, or for the controllers of a learning method, one per training seed."""

    name: str
    kind: Kind  # "privileged" sees what no other does; "added" is a user's own
    sources: tuple[str, ...]  # one per training seed: name of a controller, folder of a policy, or package.module:Class
    identity: str | None  # SHA-256 of gains, policies or sources; None: unknown, its results are not used again
    training: dict[str, list[float]] = field(default_factory=dict)  # effort of tuning or training, see `EFFORT`
    base: str | None = None  # of a learned method: the controller that it corrects
    guarded: bool = False  # whether the guard is between its controllers and the motor
    time_limit: float = custom.TIME_LIMIT  # of an added one, for a batch of episodes [s]
    results: Path | None = None  # of an added one: folder of results, which is no part of it

    @property
    def sensors(self) -> Sensors:
        """Sensor tier of its observations."""
        return "full" if self.kind == "privileged" else "encoder"

    def batches(self, episodes: int) -> list[range]:
        """Training seeds that run in one batch each, as long as a batch stays small."""
        seeds, together = range(len(self.sources)), max(1, LARGEST_BATCH // episodes)
        return [seeds[k : k + together] for k in seeds[::together]]

    def controller(self, seed: int, *arms: Sequence[ArmParams]) -> Controller:
        """Make the controller of a training seed, as `controllers` does."""
        return self.controllers(range(seed, seed + 1), *arms)

    def controllers(self, seeds: range, *arms: Sequence[ArmParams], model: str = "lumped") -> Controller:
        """Make the controllers of some training seeds, one of `batches`, as one, for arms that they share equally.

        Only a privileged controller needs the constants of the arms, in each move of an episode, and their model.

        Raises:
            ValueError: If it cannot be made.
        """
        source = self.sources[seeds[0]]
        if self.kind == "privileged":
            return PrivilegedController(*arms, model=model)
        if self.kind == "learned":
            controller: Controller = load_controller(*(self.sources[seed] for seed in seeds))
        else:
            controller = custom.make(source) if self.kind == "added" else CONTROLLERS[source]()
        return behind_guard(controller) if self.guarded else controller

    def belongings(self) -> dict[str, Carried]:
        """Folders that its controllers are read from, by source: of policies, and of a user's own file.

        Raises:
            ValueError: If a user's own folder is too large to be carried.
        """
        if self.kind == "learned":
            return {path: Carried(Path(path), ((POLICY_FILE, read_bundle(path).data),)) for path in self.sources}
        if self.kind != "added" or not self.sources[0].rpartition(":")[0].endswith(".py"):
            return {}
        folder = custom.home(self.sources[0])
        files = custom.files_of(folder, self.results)
        if files is None:
            raise ValueError(f"{folder} is too large to be sent to other machines: keep {self.name} in a smaller one")
        return {self.sources[0]: carry(folder, files)}

    def at(self, belongings: dict[str, Carried]) -> Method:
        """Make the same method on a machine that the folders were carried to."""

        def there(source: str) -> str:
            if source not in belongings:
                return source
            file, colon, name = source.rpartition(":") if self.kind == "added" else (source, "", "")
            carried = belongings[source]
            return f"{carried.here() / Path(file).relative_to(carried.folder)}{colon}{name}"

        return replace(self, sources=tuple(map(there, self.sources)))

    @property
    def own_files(self) -> str | None:
        """SHA-256 of the files of a user's own controller, None if they are unknown, and of other methods."""
        return custom.identity(custom.home(self.sources[0]), self.results) if self.kind == "added" else None

    def with_guard(self) -> Method:
        """Make the same method with the guard between its controllers and the motor; for classical and learned ones."""
        return replace(self, name=f"{self.name}+guard", identity=_guarded(self.identity), guarded=True)

    def changed(self) -> bool:
        """Whether policies or a user's files are no longer those of its identity, if that is known."""
        if self.identity is None or self.kind not in ("learned", "added"):
            return False
        try:
            now = _identity(self.kind, self.sources, self.results)
        except (OSError, ValueError):  # gone, or half written
            return True
        return (_guarded(now) if self.guarded else now) != self.identity


def classical_methods() -> list[Method]:
    """All classical controllers."""
    tuned = read_file()
    return [
        Method(name, "classical", (name,), digest_of(tuned.get(name, {}).get("gains")), _tuning_of(tuned.get(name, {})))
        for name in CONTROLLERS
    ]


def _tuning_of(entry: dict[str, Any]) -> dict[str, list[float]]:
    """Effort of a search for gains, from their provenance."""
    origin = entry.get("provenance", {})
    names = zip(EFFORT, ("steps", "seconds", "trials", "refused"), strict=False)
    return {name: [origin[key]] for name, key in names if key in origin}


def _all_gains() -> dict[str, Any]:
    """Gains of all classical controllers, which a controller that builds on them may use."""
    return {name: entry.get("gains") for name, entry in read_file().items()}


def _guarded(identity: str | None) -> str | None:
    return identity and digest_of([identity, "guard", _all_gains()])  # the servo's among them


def privileged_method() -> Method:
    """Preview LQG with true constants and true state: the oracle."""
    return Method(PRIVILEGED, "privileged", (PRIVILEGED,), digest_of(_all_gains()))  # it has gains of `adaptive`


def added_method(spec: str, results: Path | None = None, time_limit: float = custom.TIME_LIMIT) -> Method:
    """A user's own controller, named by its class; nothing of it is executed here. See `eval.comparison.custom`.

    Raises:
        ValueError: If there is no such file or package, or no such class.
    """
    spec = custom.absolute(spec)
    name, identity = spec.rpartition(":")[2], _identity("added", (spec,), results)
    return Method(name, "added", (spec,), identity, time_limit=time_limit, results=results)


def _identity(kind: Kind, sources: Sequence[str], results: Path | None = None) -> str | None:
    """Identity of a learned or an added method, by the files that are there now."""
    if kind == "learned":
        return digest_of([[read_spec(folder)[1]["sha256"] for folder in sources], _all_gains()])
    home, where = custom.home(sources[0]), sources[0].rpartition(":")[0]
    inside = Path(where).resolve().relative_to(home).as_posix() if where.endswith(".py") else where
    own = custom.identity(home, results)
    return own and digest_of([own, inside, _all_gains()])


def learned_methods(policies: Iterable[Path | str]) -> list[Method]:
    """Learning methods from policies, FOLDER or NAME=FOLDER, one per training seed of a method, in their order.

    Without a NAME, shipped ones are called as their folder, others "my" and their algorithm's name.

    Raises:
        BundleError: If a policy is missing or damaged.
        ValueError: If a policy is twice in a method, or two in it differ in more than their training seed or not in
            it, or one needs other sensors than the encoder, or is an archive of Stable-Baselines3.
    """
    grouped: dict[str, list[tuple[Path, BundleSpec]]] = {}
    for policy in map(str, policies):
        *given, path = [policy] if Path(policy).is_dir() else policy.split("=", 1)  # a path may have a "=", too
        folder = Path(path)
        if folder.suffix == ".zip":
            raise ValueError(
                f"{folder} is an archive of Stable-Baselines3, and loading one can execute what is in it: wrap it in a "
                "controller, and give that with --add (docs/guide/faq.md, 'A controller or policy of mine')"
            )
        spec, _ = read_spec(folder)
        if spec.sensors != "encoder":
            raise ValueError(f"{folder} needs sensors={spec.sensors!r}; the comparison gives methods the encoder alone")
        usual = f"my-{spec.algorithm}" if spec.base == "paper" else f"my-{spec.algorithm}-{spec.base}"
        if folder.resolve().is_relative_to(POLICIES):  # shipped policies lie in a folder of their method's name
            usual = folder.resolve().parent.name
        name = "".join(given) or usual
        members = grouped.setdefault(name, [])
        if any(folder.resolve() == known for known, *_ in members):
            raise ValueError(
                f"{folder} is two seeds of {name}: give each policy once, and not those that take part anyway"
            )
        members.append((folder.resolve(), spec))
    return [_learned(name, members) for name, members in grouped.items()]


def _learned(name: str, members: list[tuple[Path, BundleSpec]]) -> Method:
    if len({folder.is_relative_to(POLICIES) for folder, _ in members}) > 1:
        raise ValueError(f"{name!r} is the name of a shipped method: give your policy another, as NAME=FOLDER")
    for (folder, spec), (other, theirs) in combinations(members, 2):
        if reason := told_apart(spec, theirs):
            found = f"{folder} and {other} have {reason}, and are no two training seeds of {name}"
            raise ValueError(f"{found}: give each method a name of its own, as NAME=FOLDER")
    runs = [(spec.provenance.get("run", {}), spec.residual.hold) for _, spec in members]
    base = members[0][1].base
    base_steps = _tuning_of(read_file().get(base or "", {})).get("simulator_steps", [])
    training = {
        "simulator_steps": [int(run.get("steps", 0)) * hold for run, hold in runs],
        "wall_clock_s": [float(run.get("seconds", 0.0)) for run, _ in runs],
        **({"base_steps": base_steps} if base_steps else {}),
    }
    folders = tuple(str(folder) for folder, _ in members)
    return Method(name, "learned", folders, _identity("learned", folders), training, base)


def shipped_policies(seeds: int | None = None, method: str = "*") -> list[Path]:
    """Folders of shipped policies, `agents/policies/METHOD/SEED`: the first `seeds`, or all, of one method or each."""
    found = sorted(path.parent for path in POLICIES.glob(f"{method}/*/{POLICY_FILE}"))
    return [folder for _, of_method in groupby(found, lambda path: path.parent) for folder in islice(of_method, seeds)]


def is_shipped(method: Method) -> bool:
    """Whether a method comes with the project, rather than from its user."""
    return method.kind != "added" and all(
        method.kind != "learned" or Path(source).is_relative_to(POLICIES) for source in method.sources
    )


def policies_of(methods: Iterable[Method]) -> list[str]:
    """SHA-256 of the policies of some methods."""
    folders = [Path(source) for method in methods if method.kind == "learned" for source in method.sources]
    return [read_spec(folder)[1]["sha256"] for folder in folders]


def learned_names() -> list[str]:
    """Names of the learned methods that come with the project."""
    return [folder.parent.name for folder in shipped_policies(1)]


def project_names() -> list[str]:
    """Names of the project's own methods."""
    return [*CONTROLLERS, PRIVILEGED, *learned_names()]


class OwnMethods(NamedTuple):
    """Methods of a user's own."""

    policies: Sequence[Path | str] = ()  # see `learned_methods`
    added: Sequence[str] = ()  # controllers, see `added_method`
    results: Path | None = None  # folder of results, which is no part of a controller
    time_limit: float = custom.TIME_LIMIT  # of such a controller [s]


NO_METHODS = OwnMethods()


def choose_methods(
    names: Sequence[str], own: OwnMethods = NO_METHODS, *, guard: bool = False, seeds: int | None = None
) -> list[Method]:
    """Choose the project's own methods by name, by default all that are not dominated; a user's own always run.

    See `shipped_policies` for `seeds`. With `guard` each classical and learned method also runs with the guard.

    Raises:
        ValueError: If a name is unknown or given twice, or there is no such file or package.
    """
    known = [*classical_methods(), *learned_methods([*shipped_policies(seeds), *own.policies])]
    known += [added_method(spec, own.results, own.time_limit) for spec in own.added] + [privileged_method()]
    all_names = [method.name for method in known]
    if twice := [name for name in all_names if all_names.count(name) > 1]:
        how = "of a policy by NAME=FOLDER, of a controller by renaming its class"
        raise ValueError(f"two methods are called {twice[0]!r}: give yours another name, {how}")
    wanted = chosen("method", names or [name for name in all_names if name not in DOMINATED], all_names)
    learned = {method.name for method in learned_methods(own.policies)}
    methods = [method for method in known if method.name in {*wanted, *learned} or method.kind == "added"]
    if names and [method.name for method in methods] == [PRIVILEGED]:
        raise ValueError(f"--methods names {PRIVILEGED} alone, which is compared with nothing: name another as well")
    with_guard = ("classical", "learned") if guard else ()
    pairs = ([method, method.with_guard()] if method.kind in with_guard else [method] for method in methods)
    return [method for pair in pairs for method in pair]


def methods_side_by_side(controllers: Sequence[str], policies: Sequence[Path]) -> list[tuple[str, Method]]:
    """Single methods with names that tell them apart, where neither is given `paper`, `adaptive` and a shipped policy.

    Controllers are classical ones by name, or a user's own, with their file where several have one name; each policy is
    a method by itself.

    Raises:
        ValueError: If a name is unknown, or a controller or policy cannot be loaded.
    """
    if not controllers and not policies:
        controllers, policies = ("paper", "adaptive"), shipped_policies()[:1]
    known = {method.name: method for method in classical_methods()}
    methods = []
    for name in controllers:
        method = added_method(name) if ":" in name else known[chosen("controller", (name,), known)[0]]
        file, _, shown = name.rpartition(":")
        several = file and [each.rpartition(":")[2] for each in controllers].count(shown) > 1
        methods.append((f"{shown} ({file})" if several else method.name, method))
    for folder in policies:
        (method,) = learned_methods([folder])
        methods.append((method.name if len(policies) == 1 else f"{method.name} ({folder})", method))
    return methods


def chosen(kind: str, wanted: Sequence[str], known: Iterable[str]) -> list[str]:
    """Wanted ones of the known names, in the known order; all if none is named.

    Raises:
        ValueError: On an unknown name, suggesting one that is near.
    """
    known = list(known)
    require_known(wanted, known, f"unknown {kind} {{}}")
    return [name for name in known if name in wanted] if wanted else known
