"""The ledger: every claim, equation, figure, step and ambiguity of the paper, and the verdict on each, from ``docs/claims.yaml``.

The numbers come from ``figures/metrics.csv`` and are written by hand nowhere: the table of README and chapter 13 and the list of the book are generated. ``make ledger``
writes them anew; a test fails while they are not what it would write.
"""

from __future__ import annotations

import importlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from occlib.base.files import read_text, read_yaml, write_file
from occlib.base.markdown import END, table_text, with_block
from occlib.course.book.pages import check_blocks
from occlib.formats import PLACE, Claim, Evidence, Kind, VerdictWord, convert
from occlib.reproduce import find_root, recorded_metrics

if TYPE_CHECKING:
    import pandas as pd

VERDICTS: tuple[str, ...] = get_args(VerdictWord)
"""From the best to the least said."""

SECTIONS = {
    "abstract": "Abstract",
    "1": "§1 Introduction",
    "2": "§2 Multiple robot navigation approach",
    "3": "§3 Objects identification",
    "4": "§4 Objects localization",
    "5": "§5 Occlusion detection",
    "6": "§6 Experimental setup",
    "6.1": "§6.1 Application",
    "7": "§7 Conclusion",
}
"""The paper's sections and their titles."""

GENERATED = {"README.md": "headline", "docs/ledger.md": "all"}
"""Files with a block ``<!-- ledger: NAME -->`` ... ``<!-- end -->``, and the block's name."""

_GROUPS: dict[str, tuple[str, ...]] = {
    "kind": get_args(Kind),
    "section": tuple(SECTIONS),
    "evidence": get_args(Evidence),
}


def load_claims(path: str | Path | None = None, *, root: str | Path | None = None) -> list[Claim]:
    """The entries of ``docs/claims.yaml``, in its order.

    Parameters
    ----------
    path
        Another file.
    root
        The project's folder, whose metrics are the known ones.

    Raises
    ------
    ValueError
        In one line that names the file and the entry: a field or verdict that is not known, an id that comes twice, a metric that
        nobody recorded.
    """
    home = Path(root or find_root())
    file = Path(path or home / "docs" / "claims.yaml")
    content = read_yaml(file)
    if not isinstance(content, list) or not content:
        raise ValueError(f"{file}: expected a list of entries")
    claims = []
    for number, entry in enumerate(content):
        name = entry.get("id") if isinstance(entry, Mapping) else None
        try:
            claims.append(convert(entry, Claim, str(name or f"entry {number}"), inside=str(name or f"entry {number}")))
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from None
    if twice := [name for name, count in Counter(claim.id for claim in claims).items() if count > 1]:
        raise ValueError(f"{file}: {twice[0]}: expected different ids, this one comes twice")
    known = recorded_metrics(home)
    for claim in claims:
        if missing := [key for key in claim.metrics if key not in known]:
            raise ValueError(f"{file}: {claim.id}.metrics: nobody recorded {missing[0]}")
    return claims


def measured_text(claim: Claim, metrics: Mapping[str, float], *, marked: bool = False) -> str:
    """What was measured for an entry, in a sentence, with the numbers filled in.

    Parameters
    ----------
    marked
        Behind each number its metric, in a comment of HTML that a reader does not see.

    Examples
    --------
    >>> from occlib.formats import Claim
    >>> told = {"kind": "claim", "section": "7", "quotation": "...", "evidence": ["rendered"], "verdict": "holds",
    ...         "conditions": "none", "would_change": "a miss"}
    >>> claim = Claim(id="a", metrics=["08/recall"], measured="found in {08/recall:.0%} of the frames", **told)
    >>> measured_text(claim, {"08/recall": 0.164})
    'found in 16% of the frames'
    """

    def written(place: re.Match[str]) -> str:
        value = metrics[place[1]]
        try:
            text = format(round(value) if place[2] == "d" else value, place[2])
        except ValueError:
            raise ValueError(f"{claim.id}.measured: not a format of a number: {place[2]!r}") from None
        return f"{text}<!--{place[1]}-->" if marked else text

    return PLACE.sub(written, claim.measured)


def claims_table(claims: Sequence[Claim], *, root: str | Path | None = None) -> pd.DataFrame:
    """The ledger as a table, a row an entry: indexed by id, the measured values filled in."""
    import pandas as pd

    metrics = recorded_metrics(root or find_root())
    rows = [
        {
            "kind": claim.kind,
            "section": claim.section,
            "the paper": claim.quotation,
            "verdict": claim.verdict,
            "measured": measured_text(claim, metrics),
            "conditions": claim.conditions,
            "would change it": claim.would_change,
            "evidence": ", ".join(claim.evidence),
        }
        for claim in claims
    ]
    return pd.DataFrame(rows, index=pd.Index([claim.id for claim in claims], name="id"))


def verdict_counts(claims: Sequence[Claim], by: str = "kind") -> pd.DataFrame:
    """How many entries have each verdict: a row for each kind, section or evidence, a column a verdict.

    An entry that rests on two kinds of evidence counts for both.
    """
    import pandas as pd

    if by not in _GROUPS:
        raise ValueError(f"by: expected one of {', '.join(_GROUPS)}, got {by!r}")
    counts: Counter[tuple[str, str]] = Counter(
        (str(group), str(claim.verdict))
        for claim in claims
        for group in (claim.evidence if by == "evidence" else [getattr(claim, by)])
    )
    values = [[counts[group, verdict] for verdict in VERDICTS] for group in _GROUPS[by]]
    return pd.DataFrame(values, index=pd.Index(_GROUPS[by], name=by), columns=list(VERDICTS))


def broken_references(claims: Sequence[Claim], root: str | Path | None = None) -> list[str]:
    """Files, names and tests that entries name and that are not there, a line each."""
    home = Path(root or find_root())
    broken = []
    for claim in claims:
        for place in claim.implemented:
            module, _, name = place.partition(":")
            if name:
                try:
                    there = hasattr(importlib.import_module(module), name)
                except ImportError:
                    there = False
            else:
                there = (home / place).exists()
            broken += [] if there else [f"{claim.id}: {place}"]
        for place in claim.test:
            file, _, name = place.partition("::")
            text = (home / file).read_text(encoding="utf-8") if (home / file).is_file() else ""
            if not re.search(rf"^def {re.escape(name)}\(", text, re.MULTILINE):
                broken.append(f"{claim.id}: {place}")
    return broken


def markdown_table(claims: Sequence[Claim], which: str = "headline", *, root: str | Path | None = None) -> str:
    """The ledger in Markdown.

    Parameters
    ----------
    which
        ``"headline"``: the few entries that the README shows. ``"all"``: the counts, then every entry as a list, by the paper's sections.
    """
    if which not in GENERATED.values():
        raise ValueError(f"which: expected headline or all, got {which!r}")
    metrics = recorded_metrics(root or find_root())
    if which == "headline":
        short = [
            (_quoted(claim), f"**{claim.verdict}**", measured_text(claim, metrics, marked=True))
            for claim in claims
            if claim.headline
        ]
        return table_text(("the paper says", "verdict", "measured here"), short)
    counts = verdict_counts(claims)
    by_kind = [
        (str(kind), *map(str, row), str(sum(row))) for kind, row in zip(counts.index, counts.to_numpy(), strict=True)
    ]
    total = counts.to_numpy().sum(axis=0)
    parts = [table_text(("", *VERDICTS, "all"), [*by_kind, ("all", *map(str, total), str(total.sum()))])]
    for section, title in SECTIONS.items():
        if entries := [_entry(claim, metrics) for claim in claims if claim.section == section]:
            parts.append("\n\n".join([f"## {title}", *entries]))
    return "\n\n".join(parts)


def _entry(claim: Claim, metrics: Mapping[str, float]) -> str:
    """An entry of the whole ledger: what the paper says and the verdict, then what speaks for it, a line each."""
    places = ", ".join(f"`{place}`" for place in [*claim.implemented, *claim.test])
    lines = {
        "Measured": _sentence(measured_text(claim, metrics, marked=True)),
        "When": claim.conditions,
        "Would change it": claim.would_change,
    }
    return "\n".join(
        [
            f"- {_quoted(claim)}: **{claim.verdict}** ({', '.join(claim.evidence)})",
            *(f"  - {name}: {' '.join(text.split())}" for name, text in lines.items() if text),
            f"  - <sub>`{claim.id}`{': ' if places else ''}{places}</sub>",
        ]
    )


def _quoted(claim: Claim) -> str:
    place = claim.section if claim.section == "abstract" else f"§{claim.section}"
    words = " ".join(claim.quotation.split())
    formula = "\\" in words and "$" not in words
    return f"${words}$ ({place})" if formula else f"“{words}” ({place})"


def _sentence(text: str) -> str:
    """The text with a capital and a full stop."""
    return text and f"{text[0].upper()}{text[1:].rstrip('.')}."


def generated_texts(root: str | Path | None = None) -> dict[Path, str]:
    """The files with a block of the ledger, and what they should say.

    Raises
    ------
    ValueError
        A file without its block, or whose blocks are not closed; and as :func:`load_claims`.
    """
    home = Path(root or find_root())
    claims, texts = load_claims(root=home), {}
    for name, block in GENERATED.items():
        text, first = read_text(home / name), f"<!-- ledger: {block} -->\n"
        written = with_block(text, first, markdown_table(claims, block, root=home))
        if written is None:
            raise ValueError(f"{name}: expected a block from {first.strip()} to {END}")
        check_blocks(name, text)
        if (count := text.count(first)) > 1:
            raise ValueError(f"{name}: expected one block {first.strip()}, found {count}")
        texts[home / name] = written
        check_blocks(name, texts[home / name])  # an entry must not close the block
    return texts


def stale_files(root: str | Path | None = None) -> list[Path]:
    """The files whose block is not what claims and metrics say."""
    return [path for path, text in generated_texts(root).items() if path.read_text(encoding="utf-8") != text]


def write_generated(root: str | Path | None = None) -> list[Path]:
    """Write the blocks anew; the files that changed."""
    stale = stale_files(root)
    texts = generated_texts(root)
    return [write_file(path, texts[path]) for path in stale]
