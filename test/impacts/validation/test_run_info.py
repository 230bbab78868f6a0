"""What is said of a run: taken as it is meant, refused by name where it cannot be."""

from __future__ import annotations

import json

import pytest

from scara_effmass.errors import SettingsError
from scara_effmass.impacts.run_info import run_info

SAID_NS = 1_800_000_000_000_000_000


def test_it_is_taken() -> None:
    about = {"obstacle_mass": 2, "configuration": "near", "since_ns": 5, "note": "x"}
    assert run_info(json.dumps(about), SAID_NS) == (5, 2.0, "near", about)


@pytest.mark.parametrize("said", [{}, {"obstacle_mass": None, "configuration": None, "since_ns": None}])
def test_what_is_not_said_is_none_and_holds_from_then_on(said: dict[str, None]) -> None:
    assert run_info(json.dumps(said), SAID_NS) == (SAID_NS, None, None, said)


def test_a_configuration_may_be_named_by_a_number() -> None:
    info = run_info('{"configuration": 3}', SAID_NS)
    assert info is not None
    assert info.configuration == "3"


@pytest.mark.parametrize("text", ["", "no JSON", "[1]", "2.39", "[" * 100_000, '{"a": ' * 100_000])
def test_what_is_no_json_object_says_nothing(text: str) -> None:
    assert run_info(text, SAID_NS) is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("obstacle_mass", value) for value in ("NaN", "Infinity", "-1", "1001", "true", '"2.39"', "[2.39]")),
        *(("since_ns", value) for value in ("1e999", "NaN", "1.5", "true", '"now"', "9" * 30)),
        *(("configuration", value) for value in (r'"\ud800"', r'"a\nb"')),
    ],
)
def test_what_cannot_be_is_named(key: str, value: str) -> None:
    with pytest.raises(SettingsError, match=f"^{key} = .*: .* would be right$"):
        run_info(f'{{"{key}": {value}}}', SAID_NS)
