"""Property tests: how many examples they try, in the suite and with the profile `fuzz`."""

from hypothesis import Phase, settings

FUZZ = "fuzz"
"""Name of the profile that tries random examples, and many; the suite tries the same few in every run."""

settings.register_profile("suite", derandomize=True, deadline=None, database=None)
settings.register_profile(FUZZ, deadline=None, print_blob=True, max_examples=1000)


def examples(count: int, shrink: bool = True) -> settings:
    """Settings of a property test with so many examples, or ten times as many with the profile `fuzz`.

    A failure that is numerical need not shrink to the smallest example: that takes minutes and tells little.
    """
    many = count * 10 if settings.get_current_profile_name() == FUZZ else count
    phases = tuple(Phase) if shrink else (Phase.explicit, Phase.generate)
    return settings(max_examples=many, phases=phases)
