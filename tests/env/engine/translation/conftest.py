"""Kernels of a module's cases, compiled together."""

from __future__ import annotations

import pytest
from translating import Translated


@pytest.fixture(scope="module")
def library(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Translated:
    return request.module.CASES.library(tmp_path_factory.mktemp("kernels"))
