# SPDX-License-Identifier: Apache-2.0
"""Every reason has a text and a remedy, and the documentation lists them all."""

import re
from pathlib import Path

import pytest

from scara_effmass.codes import Reason
from scara_effmass.safety.reasons import TEXTS
from scara_effmass.safety.remedies import REMEDIES, remedy

DOCS = Path(__file__).parents[2] / "docs"
HEAD = "| code | reason | remedy |\n"
ROW = re.compile(r"^\| (\d+) \| (.+) \| (.+) \|$", re.MULTILINE)
"""Code, reason and remedy in the documentation."""


@pytest.mark.parametrize("reason", [reason for reason in Reason if reason is not Reason.NONE])
def test_reason_has_a_text_and_a_remedy(reason: Reason) -> None:
    assert TEXTS[reason]
    assert remedy(reason)


def test_no_reason_has_no_remedy() -> None:
    assert remedy(Reason.NONE) == TEXTS[Reason.NONE] == ""
    assert {*REMEDIES, Reason.NONE} == set(TEXTS) == set(Reason)


def test_documentation_lists_every_reason_and_remedy() -> None:
    """In the order of the codes, "…" in place of what a text takes from a joint state."""
    pages = [path.read_text(encoding="utf-8") for path in DOCS.glob("*.md")]
    (table,) = (page.split(HEAD)[1].partition("\n\n")[0] for page in pages if HEAD in page)
    rows = ROW.findall(table)
    listed = {int(code): (text, advice) for code, text, advice in rows}
    expected = {reason.value: (re.sub(r"\{[^}]*\}", "…", TEXTS[reason]), advice) for reason, advice in REMEDIES.items()}
    assert listed == expected
    assert list(listed) == sorted(listed)
