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
    """``data/lab/manifest.json``: how the laboratory was made, its size in bytes, and every file of it by its path."""

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


class Batch(Struct, frozen=True):
    """Hash of what a table of a sweep was made of, and of the table."""

    made_of: Hash
    sha256: Hash


class SweepManifest(Struct, frozen=True):
    """``OUT/manifest.json`` of a sweep: what it was made of, and its finished tables by their keys."""

    inputs: dict[str, Any]
    batches: dict[str, Batch]
