"""A solve in blocks that is killed now and then: the small form of ``python -m studies.resilience``."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from irpso_addon.core.tiled.work_folder import MARK
from studies.resilience.harness import Campaign, Torn
from studies.resilience.job import WORK

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks, and looks at /proc")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Campaign]:
    made = Campaign(tmp_path_factory.mktemp("resilience"), seed=4)
    yield made
    made.close()


def test_killed_runs_are_gone_on_with(campaign: Campaign) -> None:
    campaign.run(kills=5)
    assert campaign.kills == 5 and campaign.rounds


def test_two_runs_at_once(campaign: Campaign) -> None:
    campaign.pairs(1)


def test_what_is_torn_is_found(campaign: Campaign) -> None:
    """The watcher itself: a file cut short, a stray file, a lost block."""
    out = campaign.folder / "wrong"
    out.mkdir()
    name = sorted(campaign.whole)[0]
    (out / name).write_bytes(campaign.whole[name][:-1])
    with pytest.raises(Torn, match="is torn"):
        campaign._check(out, False, set())
    (out / name).write_bytes(campaign.whole[name])
    with pytest.raises(Torn, match="holds"):
        campaign.compare(out)
    (out / WORK).mkdir()
    (out / WORK / MARK).write_text("x")
    with pytest.raises(Torn, match="are gone"):
        campaign._check(out, False, {"a"})
