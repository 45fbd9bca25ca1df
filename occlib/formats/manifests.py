"""Manifests: what vouches for the files beside it, by their SHA-256."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

from msgspec import Meta, Struct

from occlib.formats.decoding import Count, Number

Hash: TypeAlias = Annotated[str, Meta(description="a SHA-256 in hexadecimal digits")]


class FileEntry(Struct, frozen=True):
    """Size in bytes and SHA-256 of a file."""

    bytes: Count
    sha256: Hash


class LabManifest(Struct, frozen=True):
    """``manifest.json`` of ``data/lab`` and ``data/rooms``: how the recordings were made, their size in bytes, and every file by its path."""

    made: dict[str, Any]
    bytes: Count
    files: dict[str, FileEntry]


class Metric(Struct, frozen=True):
    """One number that a notebook recorded; value and tolerance are text, as in ``figures/metrics.csv``."""

    metric: str
    value: str
    unit: str
    tolerance: str


class RunManifest(Struct, frozen=True):
    """``runs/<notebook>/manifest.json``: what a notebook was run with, for how long, and what it left."""

    inputs: dict[str, Any]
    seconds: Number
    files: dict[str, Hash]
    metrics: list[Metric]


class SweepManifest(Struct, frozen=True):
    """``OUT/manifest.json`` of a sweep: what its tables were made with; beside these fields the version of each library by its name.

    Parameters
    ----------
    occlib
        SHA-256 of the package.
    methods
        Names of the measures.
    matchers
        SHA-256 of the file of matchers of one's own; empty without.
    recordings
        SHA-256 of each recording by its name.
    """

    occlib: Hash
    methods: list[str] = []
    matchers: str = ""
    recordings: dict[str, Hash] = {}
