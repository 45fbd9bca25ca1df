"""``docs/claims.yaml``: what the paper says, and what came of it. A field that is not known is an error: nobody else writes this file."""

from __future__ import annotations

import re
from typing import Annotated, Literal, TypeAlias

from msgspec import Meta, Struct

Kind: TypeAlias = Literal["claim", "equation", "figure", "step", "ambiguity"]
"""What of the paper an entry is about."""

Evidence: TypeAlias = Literal["geometry", "rendered", "real", "reading"]
"""What a verdict rests on: exact silhouettes, rendered pictures, real pictures and rooms, or the paper's text alone."""

VerdictWord: TypeAlias = Literal[
    "holds", "holds under conditions", "partly", "does not hold", "cannot be judged", "the paper is silent"
]
"""The verdicts, from the best to the least said."""

MetricKey: TypeAlias = Annotated[
    str, Meta(pattern=r"^\d\d/[A-Za-z0-9][\w.-]*$", description="a metric's key NN/name, as 07/paper_objects")
]
Text: TypeAlias = Annotated[str, Meta(min_length=1, description="a text")]

PLACE = re.compile(r"\{(\d\d/[\w.-]+):([^{}]*)\}")
"""A metric in ``measured``: its key, and how it is written (``.2f``, ``.0%``, ``d``)."""


class Claim(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An entry of the ledger.

    Parameters
    ----------
    id
        Its name in small letters, joined by hyphens; never changed.
    kind, section
        What it is, and the section of the paper that it stands in.
    quotation
        The paper's words.
    implemented
        Files of the repository, or ``module:name``, in which it is built.
    test
        ``path::name`` of the tests that hold it.
    metrics
        Keys of the numbers that the verdict rests on.
    measured
        Those numbers in a sentence, each in braces with its format, as in ``{08/four_robots_moda:.2f}``.
    evidence, verdict
        What the verdict rests on, and the verdict.
    conditions
        When it holds, or what is left open.
    would_change
        What would change the verdict.
    headline
        Whether it is one of those that the README shows.
    """

    id: Annotated[str, Meta(pattern=r"^[a-z0-9]+(-[a-z0-9]+)*$", description="small letters joined by hyphens")]
    kind: Annotated[Kind, Meta(description="claim, equation, figure, step or ambiguity")]
    section: Annotated[str, Meta(pattern=r"^(abstract|\d(\.\d)?)$", description="abstract, or a number as '6.1'")]
    quotation: Text
    implemented: Annotated[list[str], Meta(description="a list of files or module:name")] = []
    test: Annotated[list[str], Meta(description="a list of path::name")] = []
    metrics: Annotated[list[MetricKey], Meta(description="a list of keys NN/name")] = []
    measured: Annotated[str, Meta(description="a text")] = ""
    evidence: Annotated[
        list[Evidence], Meta(min_length=1, description="a list of geometry, rendered, real and reading")
    ]
    verdict: Annotated[
        VerdictWord,
        Meta(
            description="holds, holds under conditions, partly, does not hold, cannot be judged or the paper is silent"
        ),
    ]
    conditions: Text
    would_change: Text
    headline: bool = False

    def __post_init__(self) -> None:
        shown = [key for key, _ in PLACE.findall(self.measured)]
        if sorted(set(shown)) != sorted(self.metrics):
            wrong = sorted(set(shown) ^ set(self.metrics)) or self.metrics
            raise ValueError(f"measured: expected each of the metrics in braces, and no other; look at {wrong[0]}")
