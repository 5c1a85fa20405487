"""Arguments of the environments: fixed once one is made, and told in its spec as it holds them."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from enum import Enum
from operator import attrgetter
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from beltarm_env.task.ranges import resolve_ranges


def fixed(name: str, argument: str = "") -> Any:
    """Property that reads `_name` and refuses to be set: what an environment has derived from it would not follow."""

    def refuse(_: Any, value: object) -> None:
        given = argument or name
        raise AttributeError(f"{given} is fixed when an environment is made: make a new one with {given}={value!r}")

    return property(attrgetter(f"_{name}"), refuse)


class Arguments:
    """Arguments that one arm and a batch of arms have in common, as attributes, and the spec."""

    sensors: Any = fixed("sensors")
    profile: Any = fixed("profile")
    model: Any = fixed("model")
    randomization: Any = fixed("randomization").getter(lambda env: copy.copy(env._randomization))
    encoder_counts: Any = fixed("encoder_counts")
    delay: Any = fixed("delay")
    num_moves: Any = fixed("num_moves", "moves")
    moves: Any = num_moves  # the argument's name: to set it is refused, too
    max_episode_steps: Any = fixed("max_episode_steps")  # after which an episode of the environment itself is truncated
    render_mode: Any = fixed("render_mode")

    _spec: EnvSpec | None = None

    def _hold(self, *, randomization: Any, encoder_counts: Any, moves: Any, render_mode: Any, **words: Any) -> None:
        """Keep arguments that were checked, as plain Python objects."""
        self._sensors, self._profile, self._model = (str(words[name]) for name in ("sensors", "profile", "model"))
        ranges = isinstance(randomization, Mapping)
        self._randomization = resolve_ranges(randomization) if ranges else str(randomization)
        self._encoder_counts = int(encoder_counts)
        self._delay = np.asarray(words["delay"], dtype=np.float64).tolist()
        self._num_moves = int(moves)
        self._render_mode = None if render_mode is None else str(render_mode)

    @property
    def spec(self) -> Any:
        """What makes the environment again, in `gymnasium.make` or `make_vec`; JSON can hold it."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        if given is not None:
            given = copy.copy(given)
            given.kwargs = {name: self._held(name, value) for name, value in given.kwargs.items()}
            given.max_episode_steps = given.kwargs.get("max_episode_steps", given.max_episode_steps)  # of a batch
        self._spec = given

    def _held(self, name: str, value: object) -> object:
        """Value of an argument as the environment has it, which may have been given as NumPy's; others as given."""
        name = "num_moves" if name == "moves" else name
        held = getattr(self, name) if isinstance(getattr(type(self), name, None), property) else value
        return held.value if isinstance(held, Enum) else held
