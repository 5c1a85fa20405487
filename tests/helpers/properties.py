"""Property tests: how many examples they try, in the suite and under `make fuzz`."""

from __future__ import annotations

from hypothesis import Phase, settings

FUZZ = "fuzz"
"""Name of the profile that tries random examples, and many; the suite tries the same few in every run."""
SIEGE = "siege"
"""Name of the profile of `make soak`, which tries few examples, and many seeds."""
MUTANTS = "mutants"
"""Name of the profile of `make mutants`: the same examples as in the suite, and no search for smaller ones."""
_MORE, _FEWER = 10, 5
_UNSHRUNK = (Phase.explicit, Phase.generate)

settings.register_profile("suite", derandomize=True, deadline=None, database=None)
settings.register_profile(MUTANTS, derandomize=True, deadline=None, database=None, phases=_UNSHRUNK)
settings.register_profile(FUZZ, deadline=None, print_blob=True, max_examples=1000)
settings.register_profile(SIEGE, deadline=None, database=None, max_examples=100 // _FEWER)


def examples(count: int, shrink: bool = True) -> settings:
    """Settings of a property test.

    Args:
        count: Examples in the suite; under `make fuzz` ten times as many, of each seed of a siege a fifth.
        shrink: Whether to look for the smallest example that fails; not where a failure is numerical, which
            takes minutes and tells little.
    """
    profile = settings.get_current_profile_name()
    many = count * _MORE if profile == FUZZ else -(-count // _FEWER) if profile == SIEGE else count
    phases = tuple(Phase) if shrink and profile != MUTANTS else _UNSHRUNK
    return settings(max_examples=many, phases=phases)
