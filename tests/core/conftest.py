"""What several of the tests without a device share."""

from __future__ import annotations

import pytest

from tests.support import random_texels


@pytest.fixture
def same_draws() -> None:
    """Random texels as if no other test had drawn any: whichever tests run, each has the same."""
    random_texels.begin()
