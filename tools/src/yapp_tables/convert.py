# SPDX-License-Identifier: GPL-2.0-or-later
"""One capture to its result: tshark writes aside, a writer makes files of that, they are renamed to their place."""

from __future__ import annotations

import errno
from dataclasses import dataclass, replace
from pathlib import Path

from .errors import CaptureError, SetupError, YappError, need
from .results import MadeBy, Result, Results, plain_name
from .tables import digest, nothing_in, plugin_version, present
from .tshark import Export, Tshark
from .undecoded import left_out
from .watch import PROGRESS, Watch
from .writers import Writer

# The module and the function that write a kind, and the extra that it needs: imported only when it is asked for.
KINDS = {
    "parquet": ("writers", "write_parquet", ""),
    "csv": ("writers", "write_csv", ""),
    "mf4": ("mf4", "write_mf4", "mdf"),
    "mcap": ("mcap_file", "write_mcap", "mcap"),
}


@dataclass(frozen=True)
class Job:
    """A capture to convert: all that another machine needs to know."""

    capture: Path
    name: str
    results: Results
    tshark: Tshark
    made_by: MadeBy


def writer(to: str) -> Writer:
    """What writes this kind; SetupError where its library is missing."""
    module, function, extra = KINDS[to]
    found: Writer = getattr(need(f"{__package__}.{module}", extra), function)
    return found


def made_by(tshark: Tshark, fields: dict[str, object]) -> MadeBy:
    """What results of this tshark depend on, from its fields.json."""
    return MadeBy(plugin_version(fields), digest(fields), tshark.options, tshark.filter)


def convert(job: Job) -> Result:
    """Convert one capture; may run twice at once, and be killed at any point.

    Raises CaptureError where there is nothing to convert, SetupError, and YappError for what another try may mend.
    """
    state = job.capture.stat() if job.capture.exists() else None
    try:
        with job.results.aside() as aside:
            export = job.tshark.export(job.capture, aside / "export", watch=Watch(aside / PROGRESS, job.capture))
            _check(job, export)
            name = f"{job.name}.partial" if export.partial else job.name
            # Captures of one name are told apart by their paths.
            source_file = job.capture.name if job.name == plain_name(job.capture) else str(job.capture)
            count = writer(job.results.to)(export, source_file, name, aside / "result")
            assert state is not None
            made = Result(str(job.capture), state.st_size, state.st_mtime_ns, job.made_by, (), count, export.partial)
            made = replace(made, lacks=tuple(left_out(None, export.undecoded, export.complaints)))
            return job.results.place(job.name, aside / "result", made)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise SetupError(f"{job.results.out}: the disk is full") from error
        raise YappError(f"{job.results.out}: {error}") from error


def _check(job: Job, export: Export) -> None:
    here = made_by(job.tshark, export.fields)
    if here != job.made_by:
        raise SetupError(f"the machine that works on it has another plugin or catalogue: {here}, not {job.made_by}")
    if not present(export):
        raise CaptureError(nothing_in(job.capture, export, job.tshark.filter))
