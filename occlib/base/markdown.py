"""Texts in Markdown that are partly written by the program: tables, and the block of a text that is written anew."""

from __future__ import annotations

from collections.abc import Sequence

END = "<!-- end -->"
"""Closes a block that the program writes."""


def table_text(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown, a line a row.

    >>> print(table_text(["rule", "MODA"], [["a | b", "0.9"]]))
    | rule | MODA |
    | --- | --- |
    | a \\| b | 0.9 |
    """
    lines = [header, ["---"] * len(header), *rows]
    cells = [[" ".join(cell.split()).replace("|", r"\|") for cell in line] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def with_block(text: str, first: str, content: str) -> str | None:
    """The text with other content from the line ``first``, which ends in a line break, to :data:`END`; ``None`` without such a block.

    >>> with_block("a\\n<!-- it -->\\nold\\n<!-- end -->\\nb", "<!-- it -->\\n", "new")
    'a\\n<!-- it -->\\n\\nnew\\n\\n<!-- end -->\\nb'
    """
    before, found, rest = text.partition(first)
    _, closed, after = rest.partition(END)
    return f"{before}{first}\n{content}\n\n{END}{after}" if found and closed else None
