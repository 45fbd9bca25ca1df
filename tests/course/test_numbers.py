"""Numbers that a text quotes: found, compared at the digits printed, and missed where they carry no mark."""

from __future__ import annotations

from pathlib import Path

import pytest

from occlib.course.numbers import (
    Measured,
    Quoted,
    check_quotes,
    given_numbers,
    load_metrics,
    prose_of,
    quoted_numbers,
    unmarked_numbers,
)

METRICS = {
    "04/f1": Measured(0.8649),
    "07/share": Measured(0.3333),
    "08/error": Measured(0.0243, "m"),
    "08/error_cm": Measured(2.43, "cm"),
    "09/seconds": Measured(0.25, "s"),
    "09/count": Measured(12.0),
    "02/minus": Measured(-0.37),
    "02/threshold": Measured(61.0, "grey levels"),
    "05/area": Measured(0.003, "m2"),
}


@pytest.mark.parametrize(
    ("text", "number", "unit"),
    [
        ("an F1 of 0.86<!--04/f1-->", "0.86", ""),
        ("an F1 of **0.86**<!-- 04/f1 -->.", "0.86", ""),
        ("in 33 %<!--04/f1--> of", "33", "%"),
        ("in 33%<!--04/f1--> of", "33", "%"),
        ("within 2.4 cm<!--04/f1-->", "2.4", "cm"),
        ("within 2.4\u00a0cm<!--04/f1-->", "2.4", "cm"),
        ("by -0.37<!--04/f1-->", "-0.37", ""),
        ("by −0.37<!--04/f1-->", "−0.37", ""),
        ("12 robots<!--04/f1-->", "12", "robots"),
        ("nothing<!--04/f1-->", "", ""),
        ("| MODA | 0.86 | `04/f1` |", "0.86", ""),
        ("| error | 0.024 m | `04/f1` |", "0.024", "m"),
        ("| error | **0.024 m** | `04/f1` |", "0.024", "m"),
    ],
)
def test_a_number_is_found_with_its_unit(text: str, number: str, unit: str) -> None:
    assert quoted_numbers(f"first line\n{text}") == [Quoted(number, unit, "04/f1", 2)]


def test_two_numbers_of_a_line_are_told_apart() -> None:
    found = quoted_numbers("from 0.86<!--04/f1--> to 12<!--09/count-->")
    assert [(one.number, one.key) for one in found] == [("0.86", "04/f1"), ("12", "09/count")]


def test_code_is_not_read() -> None:
    assert quoted_numbers("```text\n0.86<!--04/f1-->\n```\n\n    0.86<!--04/f1-->\n") == []


@pytest.mark.parametrize(
    "text",
    [
        "0.86<!--04/f1-->",
        "0.9<!--04/f1-->",
        "0.865<!--04/f1-->",
        "86 %<!--04/f1-->",
        "33.3 %<!--07/share-->",
        "2.4 cm<!--08/error-->",
        "2.4 cm long<!--08/error-->",
        "30 cm²<!--05/area-->",
        "24 mm<!--08/error-->",
        "0.024 m<!--08/error-->",
        "0.0243 m<!--08/error_cm-->",
        "250 ms<!--09/seconds-->",
        "12 robots<!--09/count-->",
        "-0.37<!--02/minus-->",
        "−0.37<!--02/minus-->",
        "61 grey levels<!--02/threshold-->",
        "| MODA | 0.86 | `04/f1` |",
    ],
)
def test_a_right_number_passes(text: str) -> None:
    assert check_quotes(text, METRICS) == []


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("0.87<!--04/f1-->", "line 1: 04/f1: printed 0.87, measured 0.8649"),
        ("0.860<!--04/f1-->", "line 1: 04/f1: printed 0.860, measured 0.8649"),
        ("34 %<!--07/share-->", "line 1: 07/share: printed 34 %, measured 33.33 %"),
        ("2.5 cm<!--08/error-->", "line 1: 08/error: printed 2.5 cm, measured 2.43 cm"),
        ("2.4 m<!--08/error_cm-->", "line 1: 08/error_cm: printed 2.4 m, measured 0.0243 m"),
        ("2.4 px<!--08/error-->", "line 1: 08/error: printed 2.4 px, measured in m"),
        ("0.37<!--02/minus-->", "line 1: 02/minus: printed 0.37, measured -0.37"),
        ("0.86<!--04/f2-->", "line 1: 04/f2: there is no such metric"),
        ("F1<!--04/f1-->", "line 1: 04/f1: no number before the mark"),
        ("2.43 cm long<!--05/area-->", "line 1: 05/area: printed 2.43 cm long, measured in m2"),
        ("0.003 cm²<!--05/area-->", "line 1: 05/area: printed 0.003 cm², measured 30 cm²"),
        ("0.333 m long<!--08/error_cm-->", "line 1: 08/error_cm: printed 0.333 m long, measured 0.0243 m long"),
        ("61 px<!--02/threshold-->", "line 1: 02/threshold: printed 61 px, measured in grey levels"),
        ("7,012<!--09/count-->", "line 1: 09/count: no number before the mark"),
        ("1e-12<!--09/count-->", "line 1: 09/count: no number before the mark"),
        ("| MODA | 0.87 | `04/f1` |", "line 1: 04/f1: printed 0.87, measured 0.8649"),
    ],
)
def test_a_wrong_number_is_told(text: str, problem: str) -> None:
    assert check_quotes(text, METRICS) == [problem]


def test_changing_one_number_of_a_text_is_seen() -> None:
    root = Path(__file__).resolve().parents[2]
    metrics = load_metrics(root / "figures/metrics.csv")
    text = (root / "docs/results.md").read_text(encoding="utf-8")
    assert check_quotes(text, metrics) == []
    row = "| 2.78 | `00/claimed_ratio_left` |"
    assert row in text
    (problem,) = check_quotes(text.replace(row, row.replace("2.78", "2.79")), metrics)
    assert problem.endswith("00/claimed_ratio_left: printed 2.79, measured 2.77792")


@pytest.mark.parametrize(
    "text",
    [
        "An F1 of 0.86<!--04/f1--> and **33 %**<!--07/share-->.",
        "`0.86` and $0.86$ and [text](a-0.86.md) and https://example.org/0.86 and doi 10.1109/34.888718",
        "```\n0.86\n```",
        "    occlib run --set x=0.86",
        "$$\n0.86\n$$",
        "§6.1 and section 6.1, Python 3.11, version 0.1, exercise 07.3, **07.3** (one line)",
        "## 07. Resolve occlusion",
        "| MODA | 0.86 | `04/f1` |",
        "12 robots, 3 of 4, 640 x 480",
        "<!-- 0.86 -->",
        "within 0.3 m, in 90 % of the frames",
    ],
)
def test_what_needs_no_mark(text: str) -> None:
    assert unmarked_numbers(text, given=[0.3, 0.9]) == []


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("an F1 of 0.86.", "0.86"),
        ("in 33 % of the frames", "33 %"),
        ("in 33% of the frames", "33%"),
        ("by -0.37,", "-0.37"),
        ("(2.4 cm)", "2.4"),
        ("(2.4cm)", "2.4"),
        ("1.5e-3", "1.5"),
        ("from 0.3-0.4", "0.4"),
        ("| 0.86 | zncc |", "0.86"),
        ("- a list\n    with 0.86 in it", "0.86"),
        ("[0.86](a.md)", "0.86"),
    ],
)
def test_a_number_without_a_mark_is_told(text: str, printed: str) -> None:
    (problem,) = unmarked_numbers(text, given=[0.3])
    assert printed in problem.split(": ")[1]


def test_prose_and_code_of_a_notebook() -> None:
    cells = [
        {"cell_type": "markdown", "source": ["Within 0.3 m ", "and 0.4 m."]},
        {"cell_type": "code", "source": "radius = 0.3\nlevels = range(5, 136)"},
    ]
    assert prose_of({"cells": cells}) == "Within 0.3 m and 0.4 m."
    assert given_numbers({"cells": cells}) == {0.3, 5, 136}
    assert len(unmarked_numbers(prose_of({"cells": cells}), given_numbers({"cells": cells}))) == 1
