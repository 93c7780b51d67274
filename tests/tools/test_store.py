# SPDX-License-Identifier: GPL-2.0-or-later
"""An object store that fails one request in fifty: each row is there once, and DuckDB reads it over the store."""

import itertools
import os
import threading
from collections import Counter

import duckdb
import fsspec
import pytest
from deltalake import DeltaTable
from moto.server import DomainDispatcherApplication, create_backend_app
from running import FAKE, motor_row, run_tables
from werkzeug.serving import make_server

COUNT, FIRST = 12, 20
RETRIES = {"AWS_RETRY_MODE": "standard", "AWS_MAX_ATTEMPTS": "10"}
DELTA = {"AWS_ALLOW_HTTP": "true", "AWS_S3_ALLOW_UNSAFE_RENAME": "true"}


class Unsteady:
    """S3 of the tests: of its requests every fiftieth ends with 503."""

    def __init__(self):
        self.app = DomainDispatcherApplication(create_backend_app)
        self.number = itertools.count(1)
        self.failed = 0

    def __call__(self, environ, start_response):
        if next(self.number) % 50 == 0:
            self.failed += 1
            environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
            start_response("503 Slow Down", [("Content-Type", "text/plain")])
            return [b"Slow Down"]
        return self.app(environ, start_response)


@pytest.fixture(scope="module")
def store():
    app = Unsteady()
    server = make_server("127.0.0.1", 0, app, threaded=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    keys = {f"AWS_{name}": "test" for name in ("ACCESS_KEY_ID", "SECRET_ACCESS_KEY")}
    keys |= {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.server_port}", "AWS_DEFAULT_REGION": "us-east-1"}
    # Of this process and of those that it starts; a region for both libraries.
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (keys | {"AWS_REGION": "us-east-1"} | RETRIES | DELTA).items():
            patch.setenv(name, value)
        fsspec.filesystem("s3", skip_instance_cache=True).mkdir("flights")
        yield app
    server.shutdown()


@pytest.fixture
def captures(make_capture):
    for number in range(COUNT):
        rows = [motor_row(n, rpm_measured=str(number)) for n in range(FIRST + number)]
        make_capture(f"captures/{number:02}.pcapng", motor=rows)
    return Counter({float(number): FIRST + number for number in range(COUNT)})


def convert(folder, to, captures="captures/*.pcapng", **more):
    command = ["convert", captures, "--to", to, "--out", f"s3://flights/{to}", "--tshark", FAKE]
    run_tables(folder, *command, env=os.environ | more, code=0)


def ask(to, query):
    """Ask DuckDB, of the table motor over the store."""
    with duckdb.connect() as asked:
        if to == "parquet":
            asked.register_filesystem(fsspec.filesystem("s3", skip_instance_cache=True))
            files = "s3://flights/parquet/message=motor/*.parquet"
            asked.execute(f"CREATE VIEW motor AS FROM read_parquet('{files}', union_by_name=true)")
        else:
            asked.register("motor", DeltaTable("s3://flights/delta/message=motor").to_pyarrow_dataset())
        return asked.sql(query).fetchall()


def speeds(to):
    """How many rows have each speed."""
    return Counter(dict(ask(to, "SELECT rpm_measured, count(*) FROM motor GROUP BY ALL")))


@pytest.mark.parametrize("to", ["parquet", "delta"])
def test_each_row_is_there_once(store, captures, tmp_path, to):
    before = store.failed
    convert(tmp_path, to)
    assert speeds(to) == captures
    # The same again, of which one capture is new, and one has another content.
    (tmp_path / "captures/new.pcapng").write_text((tmp_path / "captures/00.pcapng").read_text() + " ")
    changed = tmp_path / "captures/01.pcapng"
    changed.write_text(changed.read_text().replace('"rpm_measured": "1"', '"rpm_measured": "1000"'))
    # The catalogue has one more column now.
    column = '{"name": "fan", "type": "float", "unit": "RPM"}'
    convert(tmp_path, to, FAKE_COLUMN=column)
    captures[1000.0] = captures.pop(1.0)
    captures[0.0] *= 2
    assert speeds(to) == captures
    assert ask(to, "SELECT count(fan), count(*) FROM motor") == [(0, captures.total())]
    assert store.failed > before
