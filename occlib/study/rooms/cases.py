"""The cases: a recording seen by some of its cameras, scored in some of its regions. Which of them are at hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

from occlib.base.files import folder_hash
from occlib.formats import load_truth
from occlib.formats.scene import Surface, Wood
from occlib.lab import DEVELOPMENT, REPORTED, load_scene
from occlib.recordings import LAB, ROOMS, cache_folder, open_recording
from occlib.study.rooms.lighting import LIGHTS

RADIUS_M = {"real": 0.5, "lab": 0.3, "room": 0.3}
"""Matches are closer than this: 0.5 m is the field's convention for people; rendered objects are smaller, their truth is exact."""

LAB_RECORDINGS = ("ball_and_oval", "robot", "four_robots", "long_occlusion", "wooden_room")
"""Those of ``data/lab`` with moving objects."""

Views: TypeAlias = dict[tuple[str, ...], tuple[str | None, ...]]  # cameras: regions

_PLATFORM: Views = {
    ("cam01", "cam03"): ("platform",),
    ("cam02", "cam04"): ("platform",),
    ("cam01", "cam02", "cam03", "cam04"): ("platform",),
}

REAL: dict[str, tuple[Views, tuple[int, ...]]] = {
    "ufes-lab": (
        {
            ("cam2", "cam3"): ("cam2+cam3", "cam2+cam3 wide"),
            ("cam1", "cam2"): ("cam1+cam2",),
            ("cam1", "cam3"): ("cam1+cam3",),
            ("cam0", "cam3"): ("cam1+cam2+cam3",),  # none was marked for cam0; this one is bare floor in all four views
            ("cam0", "cam1", "cam2", "cam3"): ("cam1+cam2+cam3",),
        },
        tuple(range(20, 149)),
    ),
    "p2s-multi": (_PLATFORM, tuple(range(0, 100, 3))),
    "p2s-single": (_PLATFORM, tuple(range(0, 100, 3))),
    "uu-horse": (
        {("cam1", "cam4"): (None,), ("cam1", "cam2", "cam3", "cam4"): (None,)},
        tuple(range(0, 421, 10)),
    ),
    "uu-board": ({("cam1", "cam2", "cam3", "cam4"): (None,)}, tuple(range(25))),
}
"""Real recordings, which do not ship: for each the cameras and the regions in which they are scored (None: the whole floor), and the
frames that are run. There are more than the truth has, as objects are followed and have to be confirmed."""

LIGHT_FRAMES = tuple(range(30, 70, 2))
"""Of four_robots, in other light: from 30 on no robot touches the place where it stood at frame 0."""

WORDS = ("reported", "lab", "rooms", "real", "development")
"""Lists by name: ``rooms`` are the random rooms that ship and the reported ones, ``reported`` these, the lab and the real recordings; the rooms
of ``development`` are those to tune on."""


@dataclass(frozen=True)
class Case:
    """A recording as some of its cameras see it.

    Parameters
    ----------
    path
        Its folder.
    cameras
        Names, two or more.
    kind
        ``"real"``, ``"lab"`` (``data/lab``), or ``"room"``, a random one.
    regions
        Of its truth, in which it is scored; None is the whole floor.
    frames
        To run; all for None.
    light
        One of :data:`occlib.study.rooms.LIGHTS`, or none.
    content
        A hash of the recording, so that results of another are not taken for its.
    """

    path: str
    cameras: tuple[str, ...]
    kind: str
    regions: tuple[str | None, ...] = (None,)
    frames: tuple[int, ...] | None = None
    light: str = ""
    content: str = ""

    @property
    def name(self) -> str:
        """The recording's name, that of its folder."""
        return Path(self.path).name

    @property
    def key(self) -> str:
        """For file names."""
        parts = [self.name, "+".join(self.cameras), *([self.light.replace(" ", "_")] if self.light else [])]
        return "-".join(parts)


def cases_at_hand(words: Iterable[str] = ("reported",)) -> list[Case]:
    """The cases of lists, names and folders, each once; rooms with their first two cameras, and with all.

    Parameters
    ----------
    words
        Each one of :data:`WORDS`, the name of a recording, a recording's folder, or a folder of recordings. Of a list, what is at hand:
        random rooms that were rendered (``make rooms``), and real recordings, which are looked for in the cache and in ``../shared/data`` beside the repository.

    Raises
    ------
    ValueError
        In one line: no such recording, or none at all.
    """
    found = {(case.path, case.cameras): case for word in words for case in _of_word(word)}
    if not found:
        raise ValueError(f"recordings: expected some of {', '.join(WORDS)}, names or folders; nothing is at hand")
    return list(found.values())


def light_cases() -> list[Case]:
    """``four_robots`` as it is and in every light of :data:`LIGHTS`, with two cameras and with four."""
    plain = [replace(case, frames=LIGHT_FRAMES) for case in _rendered(LAB / "four_robots", "lab")]
    return [replace(case, light=name) for name in ("as it is", *LIGHTS) for case in plain]


def _of_word(word: str) -> list[Case]:
    if word == "reported":
        return [case for each in ("lab", "rooms", "real") for case in _of_word(each)]
    if word == "lab":
        return [case for name in LAB_RECORDINGS for case in _rendered(LAB / name, "lab")]
    if word in ("rooms", "development"):
        seeds, folders = (DEVELOPMENT, []) if word == "development" else (REPORTED, sorted(ROOMS.glob("room_*")))
        folders += [cache_folder() / f"room_{seed}" for seed in seeds]
        return [case for path in folders if (path / "truth.json").is_file() for case in _rendered(path, "room")]
    if word == "real":
        return [case for name in REAL for case in _real(name)]
    if word in REAL:
        if not (cases := _real(word)):
            raise ValueError(f"{word}: not at hand, neither in {cache_folder()} nor in {_shared()}")
        return cases
    if Path(word).is_dir() and not (Path(word) / "rig.yaml").is_file():
        return [case for path in sorted(Path(word).glob("*/truth.json")) for case in _rendered(path.parent, "room")]
    path = open_recording(word).path
    return _rendered(path, "lab" if path.parent == LAB else "room")


def _shared() -> Path:
    return LAB.parents[2] / "shared" / "data"


def _real(name: str) -> list[Case]:
    folder = next(
        (place / name for place in (cache_folder(), _shared()) if (place / name / "truth.json").is_file()), None
    )
    if folder is None:
        return []
    (views, frames), content = REAL[name], folder_hash(folder)
    return [Case(str(folder), cameras, "real", regions, frames, content=content) for cameras, regions in views.items()]


def _rendered(folder: Path, kind: str) -> list[Case]:
    names = tuple(open_recording(folder).rig.cameras)
    content = folder_hash(folder)
    views: Sequence[tuple[str, ...]] = [names[:2], *([names] if len(names) > 2 else [])]
    return [Case(str(folder.resolve()), cameras, kind, content=content) for cameras in views]


def facts(case: Case) -> dict[str, Any]:
    """What is known of a recording's room: most objects at one instant, floor and its gloss.

    ``floor`` is the pattern and ``gloss`` one of glossy, satin and dull, both empty where no ``scene.yaml`` tells.
    """
    truth = load_truth(Path(case.path) / "truth.json")
    known: dict[str, Any] = {"objects": max(map(len, truth.frames.values()), default=0), "floor": "", "gloss": ""}
    if not (Path(case.path) / "scene.yaml").is_file() or (room := load_scene(case.path).room) is None:
        return known
    coat = room.coat
    pattern = coat.pattern if isinstance(coat, Surface) else "planks" if isinstance(coat, Wood) else "vinyl"
    return {**known, "floor": pattern, "gloss": _gloss(coat.roughness, coat.ior)}


def _gloss(roughness: float, ior: float) -> str:
    """By the roughness of the coat: below 0.12 it mirrors, and one that hardly refracts is none.

    >>> _gloss(0.08, 1.5), _gloss(0.2, 1.5), _gloss(0.7, 1.02)
    ('glossy', 'satin', 'dull')
    """
    if ior < 1.2 or roughness > 0.4:
        return "dull"
    return "glossy" if roughness < 0.12 else "satin"
