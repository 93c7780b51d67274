# SPDX-License-Identifier: GPL-2.0-or-later
"""How captures are decoded: one Config for all, or an aircraft's own settings from a fleet file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

from .errors import SetupError
from .tshark import Tshark

KEYS = {"name", "captures", "profile", "catalogue", "ids", "sources", "preferences"}
StrPath = str | PathLike[str]
Partition = Literal["day", "vehicle"]
Kind = Literal["parquet", "csv", "delta", "mf4", "mcap"]


class How(TypedDict, total=False):
    """How captures are decoded: keywords of `read`, `read_many`, `convert` and `report`."""

    options: Sequence[str]
    sources: Mapping[str, str] | None
    filter: str | None
    profile: str | None
    plugin: StrPath | None
    tshark: StrPath | None


@dataclass(frozen=True)
class Aircraft:
    """A part of a fleet. captures: a pattern of absolute paths, in which * stands for folders, too.

    options, profile, catalogue: as Tshark's.
    """

    name: str
    captures: str
    options: tuple[str, ...] = ()
    profile: str | None = None
    catalogue: str | None = None


@dataclass(frozen=True)
class Config:
    """What a conversion depends on besides its capture: all that another machine needs to know.

    out: a folder, or a URL of fsspec such as s3://bucket/folder; to: "parquet", "csv", "mf4", "mcap" or "delta";
    tshark: how captures are decoded; fleet: whose captures are decoded in another way, see read_fleet;
    run: a name of this run, by which it removes what a killed worker left;
    partition: "day" or "vehicle", the folders below each table of Parquet and CSV, None for none;
    bench: the log of a thrust stand, for the one capture that it is of.
    """

    out: str
    to: Kind = "parquet"
    tshark: Tshark = field(default_factory=Tshark)
    fleet: tuple[Aircraft, ...] = ()
    run: str = ""
    partition: Partition | None = None
    bench: str | None = None

    def __post_init__(self) -> None:
        """Refuse what does not go together."""
        if self.partition and self.to not in ("parquet", "csv"):
            raise SetupError(f"{self.to} has no partitions: --partition is for parquet and csv")

    def of(self, capture: Path) -> tuple[Tshark, str | None]:
        """Return how this capture is decoded, and the name of its aircraft."""
        for aircraft in self.fleet:
            if fnmatch(str(capture), aircraft.captures):
                options = (*aircraft.options, *self.tshark.options)
                profile = aircraft.profile or self.tshark.profile
                catalogue = aircraft.catalogue or self.tshark.catalogue
                return replace(self.tshark, options=options, profile=profile, catalogue=catalogue), aircraft.name
        return self.tshark, None


def listed(texts: Sequence[str] | None) -> Sequence[str]:
    """Return texts as a list: one text is a list of one, as a user means it, not its letters."""
    return [texts] if isinstance(texts, str) else texts or ()


def tshark_of(**how: Unpack[How]) -> Tshark:
    """Return a Tshark of what a user gave; see `yapp_tables.read`. Raises TypeError for another keyword."""
    if strange := how.keys() - How.__annotations__.keys():
        raise TypeError(f"no keyword {sorted(strange)[0]!r}; known keywords: {', '.join(How.__annotations__)}")
    options, names = tuple(listed(how.get("options"))), how.get("sources")
    if names:
        options += (f"yapp.sources:{', '.join(f'{key}={name}' for key, name in names.items())}",)
    program, plugin = (None if path is None else str(path) for path in (how.get("tshark"), how.get("plugin")))
    return Tshark(program, plugin, options, how.get("filter"), how.get("profile"))


def read_fleet(path: StrPath) -> tuple[Aircraft, ...]:
    """Read a fleet file, whose form docs/tables.md shows. Paths in it are relative to it. Raises SetupError."""
    folder = Path(path).resolve().parent
    try:
        entries = tomllib.loads(Path(path).read_text(encoding="utf-8"))["aircraft"]
        return tuple(_aircraft(entry, folder) for entry in entries)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SetupError(f"{path} is no fleet file: {error!r}; docs/tables.md shows one") from error


def _aircraft(entry: dict[str, Any], folder: Path) -> Aircraft:
    if strange := entry.keys() - KEYS:
        raise ValueError(f"no key {sorted(strange)[0]}; known keys: {', '.join(sorted(KEYS))}")
    options = [f"yapp.{message}_ids:{ids}" for message, ids in entry.get("ids", {}).items()]
    options += [f"{name}:{value}" for name, value in entry.get("preferences", {}).items()]
    options += tshark_of(sources=entry.get("sources")).options
    catalogue = str(folder / entry["catalogue"]) if "catalogue" in entry else None
    return Aircraft(entry["name"], str(folder / entry["captures"]), tuple(options), entry.get("profile"), catalogue)
