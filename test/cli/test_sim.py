"""`sim` and its former name."""

import pytest

from scara_effmass.cli import main


@pytest.mark.parametrize("command", ["sim", "bench"])
def test_former_name_of_the_command_is_accepted(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main([command, "--help"])
    assert "scara-effmass sim" in capsys.readouterr().out


def test_former_name_is_not_documented(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    assert "bench" not in capsys.readouterr().out
