# SPDX-License-Identifier: Apache-2.0
"""Recordings and datasets on S3, here moto's server on the loopback address."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import s3fs  # type: ignore[import-untyped]
from moto.server import ThreadedMotoServer

from test.cli.conftest import Cli, Refused

pytestmark = [pytest.mark.live, pytest.mark.filterwarnings("ignore")]


@pytest.fixture
def s3(monkeypatch: pytest.MonkeyPatch) -> Iterator[s3fs.S3FileSystem]:
    """An empty S3 server."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    names = ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY")
    values = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_DEFAULT_REGION": "us-east-1",
        **dict.fromkeys(names, "x"),
    }
    for name, value in values.items():
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    yield s3fs.S3FileSystem()
    server.stop()


def test_dataset_from_and_to_s3(
    s3: s3fs.S3FileSystem, swing_bag: Path, cli: Cli, refused: Refused, tmp_path: Path
) -> None:
    for bucket in ("fleet", "verdicts"):
        s3.mkdir(bucket)
    s3.put(str(swing_bag), "fleet/cell=A7/swing", recursive=True)
    words = ("assess", "s3://fleet/cell=A7", "-o", "s3://verdicts/week", "--json")
    done = cli(*words)
    assert (done.returncode, done.stderr) == (0, "")
    (part,) = s3.glob("verdicts/week/cell=A7/day=2026-01-01/swing-*.parquet")
    written = s3.info(part)["LastModified"]
    assert cli(*words).stdout == done.stdout
    assert s3.info(part)["LastModified"] == written
    assert "bag" in done.stdout
    line = refused("assess", "s3://fleet/no.mcap", "-o", tmp_path / "a.csv")
    assert line == "s3://fleet/no.mcap: does not exist"
    assert "foo://a.mcap: cannot be read: " in refused("assess", "foo://a.mcap", "-o", tmp_path / "a.csv")
