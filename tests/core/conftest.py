"""What several of the tests without a device share."""

from __future__ import annotations

import pytest

from tests.support import random_pictures, random_texels


@pytest.fixture
def same_draws() -> None:
    """Random texels as if no other test had drawn any: whichever tests run, each has the same."""
    random_texels.begin()


@pytest.fixture(autouse=True)
def same_pictures() -> None:
    """Likewise random pictures."""
    random_pictures.begin()
