"""Exercises of chapter 13: verdicts counted, a mask measured, a threshold sought, and a verdict of one's own."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from occlib import lab
from occlib.base.arrays import Image, Mask
from occlib.course.checking import Mistake, Test, exercise, number, word
from occlib.course.ledger import VERDICTS, load_claims, verdict_counts
from occlib.course.lessons.judge_the_paper import sweep_thresholds
from occlib.formats import Claim
from occlib.pipeline import backgrounds_of, settings_for
from occlib.recordings import open_recording

SHOWN = 12
"""The frame of the wooden room that the chapter looks at."""

JUDGED = ("claim", "question", "measure", "condition", "verdict", "would_change")


@cache
def _claims() -> list[Claim]:
    return load_claims()


def _most(by: str, group: str) -> str:
    return str(verdict_counts(_claims(), by=by).loc[group].idxmax())


def _real(*, alone: bool = False) -> float:
    """The share of entries that rest on pictures of a real room."""
    claims = _claims()
    return sum(claim.evidence == ["real"] if alone else "real" in claim.evidence for claim in claims) / len(claims)


def _real_of_all_evidence() -> float:
    counts = verdict_counts(_claims(), by="evidence").sum(axis=1)
    return float(counts["real"] / counts.sum())


@cache
def _cabinet() -> tuple[dict[str, Image], dict[str, Any], dict[str, Mask]]:
    """Pictures, backgrounds and the cabinet's visible pixels of both views of the wooden room."""
    recording = open_recording("wooden_room", ["left", "right"])
    ((_, images),) = recording.images([SHOWN])
    seen = lab.silhouettes(lab.load_scene(recording.path), SHOWN)
    return dict(images), dict(backgrounds_of(recording)), {name: own["cabinet"][1] for name, own in seen.items()}


@cache
def _mask_share(profile: str, *, camera: str = "left", everywhere: bool = False) -> float:
    """The share of the cabinet's visible pixels (of all pixels) that a view's foreground has."""
    images, backgrounds, visible = _cabinet()
    evidence = settings_for(profile).foreground.evidence(images[camera], backgrounds[camera])
    mask = evidence.values > evidence.level
    return float(mask.mean() if everywhere else mask[visible[camera]].mean())


@cache
def _highest(room: str, frame: int, share: float, *, first_that_fails: bool = False) -> int:
    """The highest level with at least that share of the rover on the map, or the next one."""
    tried = {level: settings_for("paper", threshold=float(level)) for level in range(10, 100, 10)}
    table = sweep_thresholds(open_recording(room, ["left", "right"]), tried, frame=frame, object_id="rover")
    found = int(table.index[table["hidden robot covered"] >= share].max())
    return found + 10 if first_that_fails else found


def _judged(answer: Any) -> bool:
    return (
        isinstance(answer, dict)
        and set(answer) == set(JUDGED)
        and all(isinstance(text, str) and text.strip() for text in answer.values())
        and answer["verdict"] in VERDICTS
    )


def _with(**changes: str) -> Callable[[], dict[str, str]]:
    own = {name: "a text" for name in JUDGED} | {"verdict": "partly"} | changes
    return lambda: {name: text for name, text in own.items() if text}


def _lacks(answer: Any) -> bool:
    return isinstance(answer, dict) and not set(JUDGED) <= set(answer)


def _unknown_verdict(answer: Any) -> bool:
    return isinstance(answer, dict) and answer.get("verdict") not in VERDICTS


def _empty(answer: Any) -> bool:
    return isinstance(answer, dict) and any(isinstance(text, str) and not text.strip() for text in answer.values())


def _verdict(text: Callable[[], str]) -> Test:
    return lambda answer: word(text())(answer)


exercise(
    "13.1",
    right=_verdict(lambda: _most("kind", "ambiguity")),
    example=lambda: _most("kind", "ambiguity"),
    otherwise="Select the rows of this kind in the table `ledger` and look at the column `verdict`.",
    mistakes=[
        Mistake(
            "That is the most frequent verdict of the claims. Which rows are of the kind asked for?",
            _verdict(lambda: _most("kind", "claim")),
            example=lambda: _most("kind", "claim"),
        ),
        Mistake(
            "That one says that nobody here had the means to judge. Count once more what the paper leaves open.",
            word("cannot be judged"),
            example="cannot be judged",
        ),
    ],
)
exercise(
    "13.2",
    right=number(_real, tol=0.005),
    example=_real,
    otherwise="`evidence` is a list in each of the `claims`. In how many of them does the word stand?",
    mistakes=[
        Mistake(
            "A share lies between 0 and 1; you answered in percent.",
            number(lambda: 100 * _real(), tol=0.5),
            example=lambda: 100 * _real(),
        ),
        Mistake(
            "You divided by all pieces of evidence. An entry may rest on two kinds and still is one entry.",
            number(_real_of_all_evidence, tol=0.005),
            example=_real_of_all_evidence,
        ),
        Mistake(
            "You counted the entries that rest on real pictures alone. Those with other evidence besides count, too.",
            number(lambda: _real(alone=True), tol=0.005),
            example=lambda: _real(alone=True),
        ),
        Mistake(
            "That is how many, not which share.",
            number(lambda: _real() * len(_claims()), tol=0.1),
            example=lambda: round(_real() * len(_claims())),
        ),
    ],
)
exercise(
    "13.3",
    right=number(lambda: _mask_share("and"), tol=0.01),
    example=lambda: _mask_share("and"),
    otherwise="As in the chapter, with `settings['and'].foreground`: values above the level, at the visible pixels, and their mean.",
    mistakes=[
        Mistake(
            "That is the mask of the paper's settings.",
            number(lambda: _mask_share("paper"), tol=0.01),
            example=lambda: _mask_share("paper"),
        ),
        Mistake(
            "That is the share of the whole picture. Look at the cabinet's visible pixels only.",
            number(lambda: _mask_share("and", everywhere=True), tol=0.005),
            example=lambda: _mask_share("and", everywhere=True),
        ),
        Mistake(
            "A share lies between 0 and 1; you answered in percent.",
            number(lambda: 100 * _mask_share("and"), tol=1),
            example=lambda: 100 * _mask_share("and"),
        ),
        Mistake(
            "You left out the wrong part: that is the share that the mask lacks.",
            number(lambda: 1 - _mask_share("and"), tol=0.01),
            example=lambda: 1 - _mask_share("and"),
        ),
        Mistake(
            "That is the recommended profile's mask.",
            number(lambda: _mask_share("recommended"), tol=0.01),
            example=lambda: _mask_share("recommended"),
        ),
    ],
)
exercise(
    "13.4",
    right=number(lambda: _highest("wooden_room", SHOWN, 0.9)),
    example=lambda: _highest("wooden_room", SHOWN, 0.9),
    otherwise="Sweep the nine levels, keep those with at least nine tenths of the rover, and take the highest.",
    mistakes=[
        Mistake(
            "With that level half of the rover is there, not nine tenths.",
            number(lambda: _highest("wooden_room", SHOWN, 0.5)),
            example=lambda: _highest("wooden_room", SHOWN, 0.5),
        ),
        Mistake(
            "Is that the vinyl room?",
            number(lambda: _highest("long_occlusion", 48, 0.9)),
            example=lambda: _highest("long_occlusion", 48, 0.9),
        ),
        Mistake(
            "That is the lowest level. A low one keeps the rover easily; how far up can you go?",
            number(10),
            example=10,
        ),
    ],
)
exercise(
    "13.5",
    right=_judged,
    example=_with(),
    otherwise="A dictionary of the six texts that the exercise names, and no other.",
    mistakes=[
        Mistake("One of the six texts is missing.", _lacks, example=_with(condition="")),
        Mistake("The verdict is none of the six of `course.ledger`.", _unknown_verdict, example=_with(verdict="great")),
        Mistake("One of the texts is empty.", _empty, example=_with(measure=" ")),
    ],
    invariant="six texts, the verdict one of the six",
)
