"""Every exercise of every chapter: right is right, each known mistake gets its own hint, nothing is given away."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occlib.course.checking import Exercise, exercises, judge
from occlib.reproduce import select_notebooks

ROOT = Path(__file__).resolve().parents[2]
ALL = exercises()
CHAPTERS = {path.stem[:2]: path for path in select_notebooks(root=ROOT)}


def made(example: Any) -> Any:
    return example() if callable(example) else example


def cells(path: Path) -> list[dict[str, Any]]:
    return list(json.loads(path.read_text(encoding="utf-8"))["cells"])


@pytest.fixture(params=ALL.values(), ids=list(ALL))
def one(request: pytest.FixtureRequest) -> Exercise:
    found = request.param
    assert isinstance(found, Exercise)
    return found


def test_there_are_enough() -> None:
    assert len(ALL) >= 45


def test_right_and_not_answered(one: Exercise) -> None:
    assert judge(one.number, made(one.example)).kind == "right"
    assert judge(one.number, None).kind == "not answered yet"


def test_each_mistake_gets_its_own_hint(one: Exercise) -> None:
    assert one.mistakes, "every exercise has a known mistake"
    for mistake in one.mistakes:
        verdict = judge(one.number, made(mistake.example))
        assert (verdict.kind, verdict.hint) == ("not yet", mistake.hint)
    hints = [mistake.hint for mistake in one.mistakes] + [one.otherwise]
    assert len(set(hints)) == len(hints) and all(hint.endswith((".", "?")) for hint in hints)


def test_no_hint_gives_the_answer_away(one: Exercise) -> None:
    answer = np.asarray(made(one.example))
    if (
        answer.size > 1
        or answer.dtype.kind not in "iuf"
        or (abs(float(answer.item())) < 10 and answer.dtype.kind != "f")
    ):
        return  # small whole numbers stand in many sentences
    value = float(answer.item())
    for hint in (one.otherwise, *(mistake.hint for mistake in one.mistakes)):
        for text in re.findall(r"-?\d+(?:\.\d+)?", hint):
            digits = len(text.partition(".")[2])
            assert not (digits and round(value, digits) == float(text)), hint


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_the_chapter_asks_them_all(chapter: str) -> None:
    """Each exercise is a prose cell, a solution, and a check of what the solution assigns last."""
    own = [number for number in ALL if number[:2] == chapter]
    assert 3 <= len(own) <= 5
    asked, checked, open_ones = [], [], []
    for cell in cells(CHAPTERS[chapter]):
        text, tags = "".join(cell["source"]), cell["metadata"].get("tags", [])
        if "exercise" in tags:
            (number,) = re.findall(r"\A\*\*(\d\d\.\d)\*\* \([^)]+\) ", text)
            asked.append(number)
            open_ones += [number] if "open" in tags else []
        if "check" in tags:
            (call,) = re.findall(r'\Acourse\.check\("(\d\d\.\d)", (answer_\d)\)\Z', text)
            assert call[1] == f"answer_{call[0][-1]}"
            checked.append(call[0])
    assert asked == checked == own
    assert open_ones == [number for number in own if ALL[number].invariant]


def test_right_answers_in_another_form() -> None:
    world = exercises()["11.3"].example()
    forms = {
        "03.1": [np.array([[4.0], [1.0]]), [np.array([4.0]), np.array([1.0])]],
        "04.3": [exercises()["04.3"].example()[None]],
        "11.3": [world.astype(int), world.tolist()],
        "12.2": [[name.upper(), round(error)] for name, error in [exercises()["12.2"].example()]],
    }
    for number, answers in forms.items():
        for answer in answers:
            assert judge(number, answer).kind == "right", (number, answer)
