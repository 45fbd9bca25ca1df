"""The settings of the chain: those of its stages together, profiles by name, and changes by name.

Each stage has settings of its own, beside its code. A profile chooses one kind of foreground and one kind of finder, so that every setting
that it lists has a say.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np

from occlib.base import checks
from occlib.explaining import Explaining
from occlib.finding import Regions, region_rules
from occlib.foreground.evidence import Difference
from occlib.foreground.shadows import ShadowModel
from occlib.identification import IdentifierSettings
from occlib.tracking import TrackerSettings


@dataclass(frozen=True)
class Settings:
    """The settings of the stages, one set for every recording.

    Parameters
    ----------
    foreground
        How a view becomes evidence: :class:`occlib.foreground.ShadowModel`, which leaves shadows and reflections out, or
        :class:`occlib.foreground.Difference`, the paper's, which thresholds the difference to the background.
    finder
        How evidence becomes objects: :class:`occlib.explaining.Explaining`, the fewest objects that explain all silhouettes, or
        :class:`occlib.finding.Regions`, connected regions of the fused evidence.
    tracker
        How objects are followed.
    """

    foreground: ShadowModel | Difference = field(default_factory=ShadowModel)
    finder: Explaining | Regions = field(default_factory=Explaining)
    tracker: TrackerSettings = field(default_factory=lambda: TrackerSettings(confirm_s=0.2))


PROFILES = {
    "recommended": Settings(),
    "and": Settings(Difference("half-otsu"), Regions("and"), TrackerSettings()),
    "paper": Settings(
        Difference("otsu", colour=False, min_level=0.0),
        Regions(
            "and",
            core=0.0,
            join_m=0.0,
            min_area_m2=0.002,
            position="centroid",
            remove_ghosts=False,
            identify=IdentifierSettings(),
        ),
        TrackerSettings(),
    ),
}
"""``paper``: the paper's chain to the letter: grey difference, smoothing, Otsu; SSD identification and size in each view; AND, centroid,
vectors. What the paper leaves open is said in :mod:`occlib.identification`; the noise floor, below which nothing is an
object, and how vectors are joined from frame to frame (:mod:`occlib.tracking`) are ours.
``and``: the AND rule with what helps it most: colour, half of Otsu, fragments joined, neighbours parted, ghosts dropped.
``recommended``: the best that is known, chosen on the recordings of ``data/lab`` and on ufes-lab."""


def settings_for(
    profile: str = "recommended", *, rule: str | None = None, threshold: str | float | None = None, **changes: Any
) -> Settings:
    """A profile's settings with changes.

    Parameters
    ----------
    profile
        One of :data:`PROFILES`.
    rule
        ``"explain"``, or a fusion rule of :func:`occlib.occlusion.fuse`: the finder that goes with it. None: the profile's.
    threshold
        ``"evidence"``, for the shadow model, or a threshold of :class:`occlib.foreground.Difference`. None: the profile's.
    **changes
        Fields of the stages' settings by name, as in ``core=0.0``; where two stages have one of that name, and on the command line,
        with the stage: ``**{"finder.core": 0.0}``. None leaves a field as it is. All are listed by :func:`list_settings`.

    Examples
    --------
    >>> settings_for("and", threshold="otsu", core=0.0).finder.core
    0.0
    >>> settings_for(**{"finder.cost": 0.2}).finder.search.cost
    0.2
    """
    settings = PROFILES[checks.choice("profile", profile, PROFILES)]
    if rule is not None:
        checks.choice("rule", rule, [*region_rules(), "explain"])
    if rule == "explain":
        settings = replace(
            settings, finder=settings.finder if isinstance(settings.finder, Explaining) else Explaining()
        )
    elif rule is not None:
        regions = settings.finder if isinstance(settings.finder, Regions) else Regions()
        settings = replace(settings, finder=replace(regions, rule=rule))
    if threshold == "evidence":
        known = isinstance(settings.foreground, ShadowModel)
        settings = replace(settings, foreground=settings.foreground if known else ShadowModel())
    elif threshold is not None:
        difference = settings.foreground if isinstance(settings.foreground, Difference) else Difference()
        settings = replace(settings, foreground=replace(difference, threshold=threshold))
    for name, value in changes.items():
        if value is not None:
            settings = _changed(settings, name, value)
    return settings


def list_settings(settings: Settings) -> dict[str, Any]:
    """Every setting that has a say, ``{"stage.name": value}``, in the order of the stages.

    >>> list_settings(settings_for("and"))["finder.join_m"]
    0.2
    """
    return {".".join((path[0], path[-1])): value for path, value in _leaves(settings)}


def setting_meanings(settings: Settings) -> dict[str, str]:
    """What each setting of :func:`list_settings` means, in the words of its class's docstring.

    >>> setting_meanings(settings_for("and"))["finder.min_area_m2"]
    'Less evidence, in m2, is noise.'
    """
    meanings = {}
    for path, _ in _leaves(settings):
        owner: Any = settings
        for name in path[:-1]:
            owner = getattr(owner, name)
        meanings[".".join((path[0], path[-1]))] = _described(type(owner)).get(path[-1], "")
    return meanings


def _described(kind: type) -> dict[str, str]:
    """The parameters of a numpydoc docstring and their descriptions, each on one line."""
    text = (inspect.getdoc(kind) or "").partition("Parameters\n----------\n")[2].partition("\n\n")[0]
    found: dict[str, str] = {}
    for names, body in re.findall(r"^(\w[\w, ]*)\n((?:    .*\n?)+)", text, flags=re.M):
        plain = re.sub(r":\w+:`~?([^`]*)`|``([^`]*)``", r"\1\2", " ".join(body.split()))
        found.update((name.strip(), plain) for name in names.split(","))
    return found


def _leaves(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Path and value of each field of a group of settings and of the groups in it."""
    names = [one.name for one in fields(group)] if is_dataclass(group) else list(group._fields)
    for name in names:
        value = getattr(group, name)
        if is_dataclass(value) or hasattr(value, "_fields"):
            yield from _leaves(value, (*path, name))
        elif value is not None:  # None: a group that this profile does without
            yield (*path, name), value


def _changed(settings: Settings, name: str, value: Any) -> Settings:
    """The settings with one field changed; text is read as the field's type."""
    leaves = dict(_leaves(settings))
    stage, _, last = name.rpartition(".")
    found = [path for path in leaves if path[-1] == last and stage in ("", path[0])]
    if len(found) != 1:
        what = f"{', '.join('.'.join((p[0], p[-1])) for p in found)}" if found else ", ".join(list_settings(settings))
        raise ValueError(f"setting {name!r}: expected one of {what}")
    return _with(settings, found[0], _as_type(name, value, leaves[found[0]]))


def _with(group: Any, path: Sequence[str], value: Any) -> Any:
    if len(path) > 1:
        value = _with(getattr(group, path[0]), path[1:], value)
    if is_dataclass(group):
        return replace(group, **{path[0]: value})  # type: ignore[type-var]
    return group._replace(**{path[0]: value})


def _as_type(name: str, value: Any, default: Any) -> Any:
    """A value in the type of the default."""
    kinds = {
        bool: "true or false",
        int: "a whole number",
        float: "a number",
        tuple: "numbers such as 0,0.1,0.3",
        str: "text",
    }
    try:
        if isinstance(default, bool):
            return {"true": True, "false": False}[str(value).lower()]
        if isinstance(default, int):
            if not isinstance(value, str) and int(value) != value:
                raise ValueError
            return int(value)
        if isinstance(default, float):
            number = float(value)
            if not np.isfinite(number):
                raise ValueError
            return number
        if isinstance(default, tuple):
            numbers = tuple(map(float, value.split(",") if isinstance(value, str) else value))
            if not np.isfinite(numbers).all():
                raise ValueError
            return numbers
        if isinstance(value, str):
            return _number_or_text(value)
        return value
    except (KeyError, ValueError, TypeError):
        raise ValueError(f"setting {name!r}: expected {kinds[type(default)]}, got {value!r}") from None


def _number_or_text(value: str) -> float | str:
    try:
        return float(value)
    except ValueError:
        return value
