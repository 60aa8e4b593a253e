"""Parts of lines that users read."""

from __future__ import annotations

import pytest

from irpso_addon.core.phrases import counted, some


@pytest.mark.parametrize(("count", "said"), [(0, "0 views"), (1, "1 view"), (2, "2 views")])
def test_counted(count, said) -> None:
    assert counted(count, "view") == said


@pytest.mark.parametrize(("names", "said"), [
    ([], ""), (["a"], "'a'"), (["a", "b", "c"], "'a', 'b', 'c'"), (list("abcde"), "'a', 'b', 'c' and 2 more")])
def test_the_first_names(names, said) -> None:
    assert some(names) == said
    assert some(names, mark="") == said.replace("'", "")
