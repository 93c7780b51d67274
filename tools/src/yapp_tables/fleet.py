# SPDX-License-Identifier: GPL-2.0-or-later
"""Many captures: on this machine's cores or on a Dask cluster, with retries, progress and a list of what failed."""

from __future__ import annotations

import csv
import io
import logging
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from .convert import Job, convert
from .errors import CaptureError, SetupError, need
from .results import Result
from .watch import NOWHERE, Position
from .whole import write_whole

TRIES = 3
SCHEDULER_SECONDS = 10
LINE_SECONDS = 30
BAR = 24


@dataclass
class Failure:
    """A capture that gave no result, or only a part of one."""

    capture: Path
    reason: str


@contextmanager
def executor(scheduler: str | None, jobs: int) -> Iterator[Executor]:
    """Where the work is done: `jobs` threads, each waiting for a tshark of its own, or the cluster at tcp://HOST:PORT."""
    if scheduler is None:
        pool = ThreadPoolExecutor(jobs)
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)
        return
    distributed = need("distributed", "fleet")
    # What it has to say of lost workers it mends itself; a lost scheduler is told by `run`.
    logging.disable(logging.CRITICAL)
    try:
        client = distributed.Client(scheduler, timeout=SCHEDULER_SECONDS)
    except (OSError, ValueError) as error:
        raise SetupError(f"no Dask scheduler answers at {scheduler}: {error}") from error
    with client:
        yield client.get_executor(pure=False)


def run(jobs: Sequence[Job], pool: Executor, progress: Progress) -> list[Failure]:
    """Convert all, the largest first; returns what failed, after TRIES tries where another try may mend it.

    Raises SetupError where the cluster is lost.
    """
    failures: list[Failure] = []
    waiting: dict[Future[Result], tuple[Job, int]] = {}
    for job in sorted(jobs, key=lambda job: _size(job.capture), reverse=True):
        waiting[pool.submit(convert, job)] = job, 1
    while waiting:
        done, _ = wait(waiting, timeout=1, return_when=FIRST_COMPLETED)
        for future in done:
            job, tries = waiting.pop(future)
            if future.cancelled():
                raise SetupError("the Dask scheduler went away; what was done is kept, the same command does the rest")
            error = future.exception()
            if error is not None and tries < TRIES and not isinstance(error, CaptureError | SetupError):
                waiting[pool.submit(convert, job)] = job, tries + 1
                continue
            result = None if error else future.result()
            failure = _failure(job, result, error)
            failures += [failure] if failure else []
            progress.done(job.capture, result, failure)
        if waiting:
            progress.inside = jobs[0].results.position()
            progress.show()
    return sorted(failures, key=lambda failure: failure.capture)


def _failure(job: Job, result: Result | None, error: BaseException | None) -> Failure | None:
    if result:
        return Failure(job.capture, f"read in part: {result.partial}") if result.partial else None
    reason = str(error) or type(error).__name__
    return Failure(job.capture, reason.removeprefix(f"{job.capture}: "))


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def write_failures(path: Path, failures: Sequence[Failure]) -> None:
    """failures.csv: capture, reason; none where nothing failed. Raises OSError."""
    if not failures:
        path.unlink(missing_ok=True)
        return
    text = io.StringIO(newline="")
    rows = csv.writer(text)
    rows.writerow(["capture", "reason"])
    rows.writerows((str(failure.capture), failure.reason) for failure in failures)
    write_whole(path, text.getvalue())


@dataclass
class Progress:
    """On a terminal one line that is drawn again; elsewhere, as in CI, a line now and then. All of it on stderr."""

    files: int
    bytes: int
    terminal: bool = field(default_factory=lambda: sys.stderr.isatty())
    files_done: int = 0
    bytes_done: int = 0
    messages: int = 0
    failed: int = 0
    incomplete: int = 0
    inside: Position = NOWHERE
    started: float = field(default_factory=time.monotonic)
    shown: float = field(default_factory=time.monotonic)

    @classmethod
    def of(cls, jobs: Sequence[Job]) -> Progress:
        """The progress of these jobs, none of which has begun."""
        return cls(len(jobs), sum(_size(job.capture) for job in jobs))

    def done(self, capture: Path, result: Result | None, failure: Failure | None) -> None:
        """Count a capture that came to its end."""
        self.files_done += 1
        self.inside = NOWHERE
        self.bytes_done += _size(capture)
        self.messages += result.messages if result else 0
        if failure:
            self.failed += 1
            self._print(f"{capture}: {failure.reason}\n")
        lacks = result.lacks if result else ()
        self.incomplete += bool(lacks)
        for text in lacks:
            self._print(f"{capture}: {text}\n")
        if self.files_done == self.files:
            self.show(last=True)

    def show(self, last: bool = False) -> None:
        """Draw the line, where it is time to."""
        now = time.monotonic()
        if self.terminal:
            self._print(f"{self._bar()} {self.text()}" + ("\n" if last else ""))
        elif last or now - self.shown >= LINE_SECONDS:
            self.shown = now
            self._print(self.text() + "\n")

    def text(self) -> str:
        """Files, bytes, messages, failures and the time left."""
        spent, read = time.monotonic() - self.started, self._read()
        left = spent / read * (self.bytes - read) if read else None
        parts = [
            f"{self.files_done}/{self.files} files",
            f"{read / 1e6:,.1f}/{self.bytes / 1e6:,.1f} MB",
            f"{self.messages + self.inside.messages:,} messages",
            f"{self.failed} failed" if self.failed else "",
            f"{_clock(left)} left" if left else f"{_clock(spent)}",
        ]
        return ", ".join(part for part in parts if part)

    def _read(self) -> int:
        return min(self.bytes_done + self.inside.bytes, self.bytes)

    def _bar(self) -> str:
        full = round(BAR * self._read() / self.bytes) if self.bytes else BAR
        return f"[{'#' * full}{'-' * (BAR - full)}]"

    def _print(self, text: str) -> None:
        print(f"\r\x1b[K{text}" if self.terminal else text, end="", file=sys.stderr, flush=True)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
