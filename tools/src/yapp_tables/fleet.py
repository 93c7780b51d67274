# SPDX-License-Identifier: GPL-2.0-or-later
"""Many captures: on this machine's cores or on a Dask cluster, with retries, progress and a list of what failed."""

from __future__ import annotations

import csv
import glob
import io
import os
import re
import uuid
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from .config import Config, StrPath
from .convert import convert_one, look_up, made_by, writer
from .dataset import DataSet, MadeBy, Result
from .errors import SetupError, YappError, count_of, need
from .tshark import Tshark

SCHEDULER_SECONDS = 10


def convert(
    captures: StrPath | Iterable[StrPath], config: Config, *, jobs: int | None = None, scheduler: str | None = None
) -> list[Result]:
    """Convert captures to a data set, what is up to date not again; one that fails holds nobody up.

    captures: paths, or patterns such as "flights/**/*.pcapng"; config: how, and where to;
    jobs: how many at a time on this machine, None for its cores; scheduler: of a Dask cluster, "tcp://HOST:PORT".
    Returns a Result for each, in the order of the captures; what failed says why in `failure`. Shows a progress bar
    on a terminal. Raises SetupError where nothing can be done, or the cluster was lost: the same call does the rest.
    """
    found = find(captures)
    writer(config.to)
    config = replace(config, out=_absolute(config.out), run=uuid.uuid4().hex[:12])
    dataset = DataSet(config.out, config.to, config.run)
    made = _made(found, config)
    dataset.open()
    dataset.clean()
    try:
        done = _current(found, config, dataset, made)
        waiting = {capture: made[config.of(capture)[0]] for capture in found if capture not in done}
        with _executor(scheduler, jobs or os.cpu_count() or 1) as pool:
            done |= _run(waiting, config, pool)
        _write_failures(dataset, done)
        if config.to == "delta" and waiting:
            names = {name for result in done.values() for name in result.messages}
            need(f"{__package__}.delta", "delta").compact(dataset.url, names)
        return [done[capture] for capture in found]
    finally:
        dataset.clean()


def prune(out: str, to: str) -> list[Result]:
    """Remove the flights whose capture is no longer where it was. Returns what was removed.

    Raises SetupError where no capture at all is there: a disk that is not mounted deletes nothing.
    """
    dataset = DataSet(out, to)
    results = list(dataset.results())
    gone = [result for result in results if not os.path.exists(result.capture)]
    if gone and len(gone) == len(results):
        raise SetupError(f"of {count_of(len(gone), 'capture')} of {out} none is there: is their disk mounted?")
    for result in gone:
        dataset.forget(result)
    _write_failures(dataset, {})
    return gone


def find(patterns: StrPath | Iterable[StrPath]) -> list[Path]:
    """Return the files that are meant, absolute, in order, each once; SetupError where a pattern finds none."""
    found: dict[Path, None] = {}
    for given in [patterns] if isinstance(patterns, str | os.PathLike) else patterns:
        pattern = os.fspath(given)
        names = [pattern]
        if not os.path.exists(pattern) and glob.has_magic(pattern):
            names = sorted(name for name in glob.glob(pattern, recursive=True) if os.path.isfile(name))
            if not names:
                raise SetupError(f"no file matches {pattern}")
        found |= dict.fromkeys(Path(os.path.abspath(name)) for name in names)
    if not found:
        raise SetupError("no captures: the list is empty")
    return list(found)


def _absolute(out: str) -> str:
    if re.match(r"\w{2,}:(?!//)", out):  # C: is a drive
        raise SetupError(f"{out} is neither a folder nor a URL such as s3://bucket/folder")
    return out if "://" in out else os.path.abspath(out)


def _made(captures: Iterable[Path], config: Config) -> dict[Tshark, MadeBy]:
    """Ask tshark once for each way to decode."""
    kinds = dict.fromkeys(config.of(capture)[0] for capture in captures)
    return {tshark: made_by(tshark, tshark.fields()[0]) for tshark in kinds}


def _current(
    captures: Iterable[Path], config: Config, dataset: DataSet, made: dict[Tshark, MadeBy]
) -> dict[Path, Result]:
    """Return what is up to date; a second capture with the same content waits for nobody."""
    done = {}
    for capture in captures:
        try:
            result = look_up(capture, dataset, made[config.of(capture)[0]])[2]
        except (YappError, OSError):  # said when it is converted
            continue
        if result and not config.bench:
            done[capture] = result
    return done


@contextmanager
def _executor(scheduler: str | None, jobs: int) -> Iterator[Executor]:
    """Where the work is done: `jobs` threads, each waiting for a tshark of its own, or the cluster."""
    if scheduler is None:
        pool = ThreadPoolExecutor(jobs)
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)
        return
    distributed = need("distributed", "fleet")
    try:
        client = distributed.Client(scheduler, timeout=SCHEDULER_SECONDS)
    except (OSError, ValueError) as error:
        raise SetupError(f"no Dask scheduler answers at {scheduler}: {error}") from error
    with client:
        yield client.get_executor(pure=False)


def _run(jobs: dict[Path, MadeBy], config: Config, pool: Executor) -> dict[Path, Result]:
    """Convert all, the largest first."""
    sizes = {capture: capture.stat().st_size if capture.exists() else 0 for capture in jobs}
    waiting = {}
    for capture in sorted(jobs, key=lambda capture: -sizes[capture]):
        waiting[pool.submit(convert_one, capture, config, jobs[capture])] = capture
    done: dict[Path, Result] = {}
    with tqdm(total=sum(sizes.values()), unit="B", unit_scale=True, disable=None) as bar:
        for future in as_completed(waiting):
            capture = waiting[future]
            if future.cancelled():
                raise SetupError("the Dask scheduler went away; the same command does the rest")
            error = future.exception()
            failed = Result("", str(capture), jobs[capture], failure=str(error) or type(error).__name__)
            done[capture] = failed if error else future.result()
            bar.set_postfix_str(f"{len(done)}/{len(jobs)} files", refresh=False)
            bar.update(sizes[capture])
    return done


def _write_failures(dataset: DataSet, done: dict[Path, Result]) -> None:
    """Write failures.csv, beside the data: all captures of the data set that failed, or were read in part."""
    known = {result.capture: result for result in dataset.results()}
    known |= {result.capture: result for result in done.values() if not result.flight_id}
    text = io.StringIO(newline="")
    rows = csv.writer(text)
    rows.writerow(["capture", "reason"])
    for result in sorted(known.values(), key=lambda result: result.capture):
        if reason := result.failure or (result.partial and f"read in part: {result.partial}"):
            rows.writerow([result.capture, reason])
    dataset.write("failures.csv", text.getvalue())
