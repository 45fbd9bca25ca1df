"""Tables and blocks of Markdown, against what a reader's program makes of them."""

from __future__ import annotations

import pytest

from occlib.base.markdown import END, table_text, with_block


def test_a_cell_stays_one_cell_on_one_line() -> None:
    header, rule, row = table_text(["a", "b"], [["x | y", "two\nlines  here"]]).splitlines()
    assert (header, rule, row) == ("| a | b |", "| --- | --- |", r"| x \| y | two lines here |")


def test_a_block_written_twice_is_as_written_once_and_all_else_stays() -> None:
    text, first = f"before\n<!-- it -->\nold\n{END}\nafter\n", "<!-- it -->\n"
    once = with_block(text, first, "new")
    assert once is not None and "old" not in once and "new" in once
    assert once.startswith("before\n") and once.endswith(f"{END}\nafter\n")
    assert with_block(once, first, "new") == once


@pytest.mark.parametrize("text", ["", "no block", "<!-- it -->\nnot closed", f"{END}\n<!-- it -->\n"])
def test_a_text_without_the_block_is_none(text: str) -> None:
    assert with_block(text, "<!-- it -->\n", "new") is None
