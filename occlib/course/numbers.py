"""The numbers that a text quotes, and whether they are those that were measured.

A text carries an invisible mark right behind each number that was measured, and its unit: ``0.86<!--04/f1_zncc-->``,
``33 %<!--07/x_share-->``, ``2.4 cm<!--08/err-->``. The mark is the key of a row of ``figures/metrics.csv``: number of the
notebook and name of the metric. In a table the key may stand visibly in the last column, behind the number:
``| MODA of AND | 0.78 | `10/moda_and` |``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from occlib.reproduce import read_metrics, tags

LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0}
"""Units of length in metres."""

TIMES = {"s": 1.0, "ms": 0.001, "min": 60.0}
"""Units of time in seconds."""

AREAS = {"m2": 1.0, "m²": 1.0, "cm2": 1e-4, "cm²": 1e-4, "mm2": 1e-6, "mm²": 1e-6}
"""Units of area in square metres."""

_KEY = r"\d\d/[\w.-]+"
_NUMBER = r"(?<![\w.^])(?<!\d,)(?<!\d[eE][-−+])[-−+]?\d+(?:\.\d+)?"  # no end of 12,000 or of 1e-3
_SPACE = "[ \u00a0\u202f]?"
_UNIT = r"%|[A-Za-zµ°²³/]{1,12}(?: [a-z]{1,8})?"
_MARK = re.compile(rf"<!--\s*({_KEY})\s*-->")
_QUOTED = re.compile(rf"({_NUMBER})(?:{_SPACE}({_UNIT}))?[*_]{{0,3}}$")
_IN_CELL = re.compile(rf"({_NUMBER})(?:{_SPACE}({_UNIT}))?")
_LAST_KEY = re.compile(rf"^\|.*\|\s*`({_KEY})`\s*\|\s*$")

_NOT_PROSE = (
    re.compile(r"^(`{3,}|~{3,}|:{3,}).*?^\1[^\n]*$", re.M | re.S),  # fenced code
    re.compile(r"\$\$.*?\$\$", re.S),
    re.compile(r"`[^`\n]+`"),
    re.compile(r"\$[^$\n]+\$"),
    re.compile(r"(?<=\])\([^()\s]*\)"),  # where a link leads
    re.compile(r"<[a-zA-Z/][^>]*>|https?://\S+|\b10\.\d{4,}/\S+"),  # tags, addresses, DOIs
    re.compile(  # what is a name and not a measurement: section 6.1, Python 3.11, exercise 07.3
        r"(?:§|\b(?:[Ss]ections?|[Ff]ig(?:ures?|s)?\.?|Eqs?\.?|[Cc]hapters?|[Ee]xercises?|Python|OpenCV|NumPy|MathJax|version))"
        r"\s*\d+(?:\.\d+)*"
    ),
    re.compile(r"\*\*\d\d\.\d\*\*|^#+\s*\d\d\.", re.M),
)
_MEASURED_LOOK = re.compile(rf"(?<![\w.,])(?<![A-Za-z]-)([-−+]?\d+\.\d+(?:{_SPACE}%)?|[-−+]?\d+{_SPACE}%)(?!\.?\d)")


@dataclass(frozen=True)
class Measured:
    """A row of ``metrics.csv``: its value and its unit."""

    value: float
    unit: str = ""


@dataclass(frozen=True)
class Quoted:
    """A number as a text prints it, its unit (empty without one), the key of its metric, and its line, from 1.

    A mark without a number before it has an empty ``number``.
    """

    number: str
    unit: str
    key: str
    line: int


def load_metrics(path: str | Path) -> dict[str, Measured]:
    """The rows of ``metrics.csv`` by their keys, ``04/f1_zncc``."""
    rows = read_metrics(Path(path))
    return {f"{row['notebook'][:2]}/{row['metric']}": Measured(float(row["value"]), row["unit"]) for row in rows}


def quoted_numbers(text: str) -> list[Quoted]:
    """The numbers of a text that carry the key of a metric, in their order.

    Examples
    --------
    >>> quoted_numbers("An F1 of **0.86**<!--04/f1--> and 33 %<!--07/share-->.")
    [Quoted(number='0.86', unit='', key='04/f1', line=1), Quoted(number='33', unit='%', key='07/share', line=1)]
    >>> quoted_numbers("| median error | 0.024 m | `08/error` |")
    [Quoted(number='0.024', unit='m', key='08/error', line=1)]
    """
    return [found for i, line in enumerate(_blanked_code(text).split("\n"), 1) for found in _of_line(line, i)]


def check_quotes(text: str, metrics: Mapping[str, Measured]) -> list[str]:
    """What is wrong with the quoted numbers of a text, a line each; empty where all is well.

    A number is compared at the digits that it prints. ``%`` takes a ratio times 100; lengths (mm, cm, m, km), areas and
    times (ms, s, min) are converted where both the text and the metric name such a unit.

    Examples
    --------
    >>> metrics = {"08/error": Measured(0.0243, "m")}
    >>> check_quotes("2.4 cm<!--08/error-->", metrics)
    []
    >>> check_quotes("2.6 cm<!--08/error-->", metrics)
    ['line 1: 08/error: printed 2.6 cm, measured 2.43 cm']
    """
    return [f"line {quoted.line}: {wrong}" for quoted in quoted_numbers(text) if (wrong := _wrong(quoted, metrics))]


def unmarked_numbers(text: str, given: Iterable[float | str] = ()) -> list[str]:
    """Decimal numbers and percentages of the prose that carry no mark, a line each.

    Parameters
    ----------
    text
        Markdown. Code, mathematics, addresses, DOIs, comments, and numbers of sections, figures or versions do not
        count.
    given
        Numbers that were not measured but chosen: sizes, thresholds, what the paper says. ``0.9`` allows ``90 %``, too.
    """
    allowed = {float(str(number).replace("−", "-")) for number in given}
    prose = _blanked_code(text)
    prose = "\n".join(_without_quotes(line) for line in prose.split("\n"))
    prose = re.sub(r"<!--.*?-->", _blank, prose, flags=re.S)
    for pattern in _NOT_PROSE:
        prose = pattern.sub(_blank, prose)
    problems = []
    for i, line in enumerate(prose.split("\n"), 1):
        for found in _MEASURED_LOOK.finditer(line):
            printed = found[1].strip()
            number = float(printed.rstrip("% \u00a0\u202f").replace("−", "-"))
            values = {number, abs(number)} | ({number / 100, abs(number) / 100} if "%" in printed else set())
            if not any(abs(value - other) < 1e-9 for value in values for other in allowed):
                problems.append(f"line {i}: {printed}: neither marked nor given")
    return problems


def prose_of(notebook: Mapping[str, Any], *, exercises: bool = True) -> str:
    """The Markdown of a notebook, its cells one below the other; without ``exercises``, what they ask is left out."""
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "markdown"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if exercises or "exercise" not in tags(cell))


def given_numbers(notebook: Mapping[str, Any]) -> set[float]:
    """The numbers that stand in the code of a notebook: sizes, thresholds and levels that were chosen."""
    code = "\n".join("".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code")
    return {float(number) for number in re.findall(r"\d+(?:\.\d+)?(?:e-?\d+)?", code)}


def _of_line(line: str, i: int) -> Iterator[Quoted]:
    for mark in _MARK.finditer(line):
        before = _MARK.sub("", line[: mark.start()]) if line[: mark.start()].endswith("-->") else line[: mark.start()]
        found = _QUOTED.search(before.rstrip())
        yield Quoted(found[1] if found else "", (found[2] or "") if found else "", mark[1], i)
    if last := _LAST_KEY.match(line):
        found = _IN_CELL.fullmatch(line.strip().strip("|").split("|")[-2].strip(" *"))
        yield Quoted(found[1] if found else "", (found[2] or "") if found else "", last[1], i)


def _wrong(quoted: Quoted, metrics: Mapping[str, Measured]) -> str:
    key = quoted.key
    if key not in metrics:
        return f"{key}: there is no such metric"
    if not quoted.number:
        return f"{key}: no number before the mark"
    measured = metrics[key]
    value = _in_unit(measured, quoted.unit)
    printed = f"{quoted.number} {quoted.unit}".strip()
    if value is None:
        return f"{key}: printed {printed}, measured in {measured.unit}"
    digits = len(quoted.number.partition(".")[2])
    if not abs(float(quoted.number.replace("−", "-")) - value) <= 0.5 * 10.0**-digits * (1 + 1e-9):
        return f"{key}: printed {printed}, measured {value:.6g} {quoted.unit}".strip()
    return ""


def _in_unit(measured: Measured, unit: str) -> float | None:
    """The measured value in the printed unit; ``None`` if the two units are of different kinds."""
    if unit == "%":
        return measured.value if measured.unit in ("%", "percent") else measured.value * 100
    unit = unit.partition(" ")[0] if unit != measured.unit else unit  # "2.4 cm long"
    for table in (LENGTHS, TIMES, AREAS):
        if unit in table and measured.unit in table:
            return measured.value * table[measured.unit] / table[unit]
    known = {*LENGTHS, *TIMES, *AREAS, "px"}
    return None if unit in known and measured.unit and unit != measured.unit else measured.value


def _without_quotes(line: str) -> str:
    """A line without the numbers that carry a mark, and without those of a table's row with its key."""
    if _LAST_KEY.match(line):
        cells = line.split("|")
        cells[-3] = " "
        line = "|".join(cells)
    return re.sub(rf"{_NUMBER}(?:{_SPACE}(?:{_UNIT}))?[*_]{{0,3}}\s?(?:<!--\s*{_KEY}\s*-->)+", _blank, line)


def _blanked_code(text: str) -> str:
    """The text without its code blocks, fenced or indented, line for line."""
    text = _NOT_PROSE[0].sub(_blank, text)
    lines, code, after_blank, in_list = [], False, True, False
    for line in text.split("\n"):
        indented = line.startswith("    ") and bool(line.strip())
        code = indented and (code or (after_blank and not in_list))
        if line.strip():
            in_list = bool(re.match(r"\s*(?:[-*+]|\d+\.)\s", line)) or (in_list and line.startswith(" "))
        after_blank = not line.strip() or code
        lines.append("" if code else line)
    return "\n".join(lines)


def _blank(found: re.Match[str]) -> str:
    """Nothing, on as many lines."""
    return "\n" * found[0].count("\n") or " "
