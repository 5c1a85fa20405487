"""Property tests: how many examples they try, in the suite and with the profile `fuzz`."""

from hypothesis import Phase, settings

FUZZ = "fuzz"
"""Name of the profile that tries random examples, and many; the suite tries the same few in every run."""
_MORE = 10
_UNSHRUNK = (Phase.explicit, Phase.generate)

settings.register_profile("suite", derandomize=True, deadline=None, database=None)
settings.register_profile(FUZZ, deadline=None, print_blob=True, max_examples=1000)


def examples(count: int, shrink: bool = True) -> settings:
    """Settings of a property test.

    Args:
        count: Examples in the suite; with the profile `fuzz` ten times as many.
        shrink: Whether to look for the smallest example that fails; not where a failure is numerical, which
            takes minutes and tells little.
    """
    many = count * _MORE if settings.get_current_profile_name() == FUZZ else count
    return settings(max_examples=many, phases=tuple(Phase) if shrink else _UNSHRUNK)
