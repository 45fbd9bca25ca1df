"""Other shapes: a box or something with a waist where a cylinder explains badly, one shape for what lies close together."""

from __future__ import annotations

from typing import Any

import numpy as np

from occlib.base.kernels import compiled
from occlib.explaining.objective import ADD, NOBODY, TAKE, gain, put, put_all, uncovered
from occlib.explaining.prisms import (
    BOX,
    BOX_LONG_M,
    FIELDS,
    ROUND,
    SEAT_LOW,
    SEATED_HIGH_M,
    SEATED_M,
    UPPER_WIDE,
    Prism,
    cylinder,
    is_body,
    plausible,
    prism_at,
)
from occlib.explaining.refining import COARSE_STEP_M, refined, stands_alone

WELL_SHAPED, STILL_WELL_SHAPED = 0.93, 0.8
"""A net share from which on no other shape is tried: for fresh objects, and for those of the previous instant."""

HEADINGS = 6
"""So many headings are tried within half a turn."""

WAISTS = ((0.25, 0.25), (0.4, 0.25))
"""Waists and sizes above them tried first."""

CHAIR_M, CHAIR_RATIO, CHAIR_WAIST = 0.27, 0.6, 0.45
"""Half the length in m, the width over the length and the waist of what is tried first below a trunk: a chair, and legs in front."""

TABLE_BELOW = 0.75
"""A net share below which tables are tried around a fresh object."""

TABLES_M, TOP = np.array([0.45, 0.6, 0.75]), 0.92
"""Their heights in m, and the share of the height at which their tops begin."""

TABLES = np.array([[0.3, 1.0, 2.0], [0.5, 0.65, 4.0]])
"""Half their length in m, their width over it, and how many headings, an eighth of a turn apart, are tried."""

AROUND, AROUND_STEP_M = 3, 0.12
"""So many steps of so many m to each side."""

SQUARE = 0.88
"""Half the side of a square over the radius of a circle of its area."""

LONG_M = 0.25
"""Half the length in m from which on a prism may be two."""

CLOSE_M, MOST_MERGED = 0.2, 8
"""Outlines no further apart, in m, may belong to one object, made of at most so many."""


@compiled
def _boxes(prism: Any, shapes: Any) -> int:
    """Fill ``shapes`` (N, 10) with boxes of a round prism's size; returns their number. A square repeats every right angle."""
    count = HEADINGS // 2 if prism.outline == ROUND else 0
    for turn in range(count):
        shapes[turn] = Prism(
            prism.x, prism.y, SQUARE * prism.radius, prism.height, float(BOX), turn * np.pi / HEADINGS, 1.0,
            prism.waist, prism.upper, prism.lean,
        )  # fmt: skip
    return count


@compiled
def _with_masts(prism: Any, shapes: Any) -> int:
    """The same with a mast: as high as the prism, or the base as high as the prism is."""
    n = 0
    if prism.waist < 1.0:
        return n
    for waist, upper in WAISTS:
        for tall in (prism.height, prism.height / waist):
            for lean in (0.0, 1.0, -1.0):
                if lean == 0.0 or prism.outline != ROUND:
                    shapes[n] = Prism(
                        prism.x, prism.y, prism.radius, tall, prism.outline, prism.heading, prism.ratio, waist, upper, lean
                    )  # fmt: skip
                    n += 1
    return n


@compiled
def _seats(prism: Any, shapes: Any) -> int:
    """The same with the prism as the trunk at the back of a chair."""
    if prism.height < SEATED_M or prism.lean != 0.0:
        return 0
    upper = min(max(prism.radius * prism.upper / CHAIR_M, 0.45), UPPER_WIDE)
    for turn in range(2 * HEADINGS):
        heading = turn * np.pi / HEADINGS
        away = (1.0 - upper) * CHAIR_M
        shapes[turn] = Prism(
            prism.x + away * np.cos(heading), prism.y + away * np.sin(heading), CHAIR_M,
            min(prism.height, SEATED_HIGH_M), float(BOX), heading, CHAIR_RATIO, CHAIR_WAIST, upper, -1.0,
        )  # fmt: skip
    return 2 * HEADINGS


@compiled
def _best(work: Any, sums: Any, shapes: Any, count: int, settings: Any) -> Any:
    """Of some shapes the plausible one that explains most; the first, if none is plausible."""
    chosen, most = 0, -np.inf
    for i in range(count):
        if plausible(prism_at(shapes, i)):
            value = gain(work, sums, prism_at(shapes, i), settings.cost).value
            if value > most:
                chosen, most = i, value
    return prism_at(shapes, chosen)


@compiled
def _table(work: Any, sums: Any, prism: Any, settings: Any) -> Any:
    """The table around a prism that explains most; the prism, if none explains anything."""
    chosen, most = prism, 0.0
    for height in TABLES_M:
        for half, ratio, turns in TABLES:
            for turn in range(int(turns)):
                for i in range(-AROUND, AROUND + 1):
                    for j in range(-AROUND, AROUND + 1):
                        table = Prism(
                            prism.x + i * AROUND_STEP_M, prism.y + j * AROUND_STEP_M, half, height, float(BOX),
                            turn * np.pi / 4, ratio, TOP, 1.0, 0.0,
                        )  # fmt: skip
                        value = gain(work, sums, table, settings.cost).value
                        if value > most:
                            chosen, most = table, value
    return chosen


@compiled
def _better_shape(work: Any, sums: Any, prism: Any, settings: Any, tables: bool) -> Any:
    """The prism, or another shape in its place that explains enough more: of each kind the best is refined."""
    shapes = np.empty((2 * HEADINGS + 6 * len(WAISTS), FIELDS))
    best, value = prism, gain(work, sums, prism, settings.cost).value
    for kind in range(3):  # a mast stands on the box, if that is better
        count = _boxes(best, shapes) if kind == 0 else _with_masts(best, shapes) if kind == 1 else _seats(prism, shapes)
        other = _best(work, sums, shapes, count, settings)
        if count and plausible(other):
            other = refined(work, sums, other, settings.cost, COARSE_STEP_M / 2)
            found = gain(work, sums, other, settings.cost).value
            if found > value + settings.reshape * abs(value):
                best, value = other, found
    if tables and gain(work, sums, best, settings.cost).net_share < TABLE_BELOW:
        other = _table(work, sums, prism, settings)
        if plausible(other):
            other = refined(work, sums, other, settings.cost, COARSE_STEP_M)
            if gain(work, sums, other, settings.cost).value > value + settings.reshape * abs(value):
                best = other
    return best


@compiled
def _gap_m(prisms: Any, i: int, j: int) -> float:
    """Distance between two outlines, taken for circles, in m."""
    return np.hypot(prisms[i, 0] - prisms[j, 0], prisms[i, 1] - prisms[j, 1]) - prisms[i, 2] - prisms[j, 2]


@compiled
def _neighbours(prisms: Any, count: int, first: int, members: Any) -> int:
    """Mark in ``members`` what is linked to a prism by gaps of at most :data:`CLOSE_M`; returns their number."""
    members[:] = False
    members[first] = True
    found, grown = 1, True
    while grown:
        grown = False
        for i in range(count):
            if members[i]:
                continue
            for j in range(count):
                if members[j] and _gap_m(prisms, i, j) <= CLOSE_M:
                    members[i], grown = True, True
                    found += 1
                    break
    return found


@compiled
def _around(prisms: Any, members: Any, count: int, box: bool) -> Any:
    """One prism of the extent of several: their moments as those of discs."""
    area, x, y = 0.0, 0.0, 0.0
    tallest, low = 0.0, 0.0
    for j in range(count):
        if members[j]:
            own = prisms[j, 2] ** 2
            area, x, y = area + own, x + own * prisms[j, 0], y + own * prisms[j, 1]
            low += own * prisms[j, 3]
            tallest = max(tallest, prisms[j, 3])
    x, y = x / area, y / area
    xx, xy, yy = 0.0, 0.0, 0.0
    for j in range(count):
        if members[j]:
            own, dx, dy = prisms[j, 2] ** 2, prisms[j, 0] - x, prisms[j, 1] - y
            xx += own * (dx * dx + own / 4)
            yy += own * (dy * dy + own / 4)
            xy += own * dx * dy
    heading = 0.5 * np.arctan2(2 * xy, xx - yy)
    mean, root = (xx + yy) / 2 / area, np.hypot((xx - yy) / 2, xy) / area
    if box:
        a, b = min(np.sqrt(3 * (mean + root)), BOX_LONG_M), np.sqrt(3 * max(mean - root, 1e-6))
        return Prism(x, y, a, low / area, float(BOX), heading, b / a, 1.0, 1.0, 0.0)
    radius = 2 * np.sqrt(mean)
    waist = min(max(low / area / tallest, 0.3), 0.7)
    return Prism(x, y, radius, tallest, float(ROUND), 0.0, 1.0, waist, 0.6, 0.0)


@compiled
def _seated(prisms: Any, members: Any, count: int) -> Any:
    """One prism of the extent of several: the tallest at its back, above the waist, and all others below in front."""
    tall = 0
    for j in range(count):
        if members[j] and (not members[tall] or prisms[j, 3] > prisms[tall, 3]):
            tall = j
    area, x, y, low = 0.0, 0.0, 0.0, 0.0
    for j in range(count):
        if members[j] and j != tall:
            own = prisms[j, 2] ** 2
            area, x, y = area + own, x + own * prisms[j, 0], y + own * prisms[j, 1]
            low = max(low, prisms[j, 3])
    back = prisms[tall, 2] * prisms[tall, 8]
    heading = np.arctan2(y / area - prisms[tall, 1], x / area - prisms[tall, 0])
    front, wide = back, back
    for j in range(count):
        if members[j]:
            dx, dy = prisms[j, 0] - prisms[tall, 0], prisms[j, 1] - prisms[tall, 1]
            front = max(front, dx * np.cos(heading) + dy * np.sin(heading) + prisms[j, 2])
            wide = max(wide, abs(dy * np.cos(heading) - dx * np.sin(heading)) + 0.7 * prisms[j, 2])
    half = (front + back) / 2
    height = prisms[tall, 3]
    return Prism(
        prisms[tall, 0] + (half - back) * np.cos(heading), prisms[tall, 1] + (half - back) * np.sin(heading),
        half, height, float(BOX), heading, min(max(wide / half, 0.4), 1.0),
        min(max(low / height, SEAT_LOW + 0.05), 0.6), min(max(back / half, 0.3), UPPER_WIDE), -1.0,
    )  # fmt: skip


@compiled
def _merged(work: Any, prisms: Any, count: int, settings: Any) -> int:
    """Put one prism in the place of several close together, where it explains enough more; the new count."""
    members = np.zeros(len(prisms), np.bool_)
    done = np.zeros(len(prisms), np.bool_)
    first = 0
    while first < count:
        size = _neighbours(prisms, count, first, members)
        if size < 2 or done[first] or size > MOST_MERGED:
            first += 1
            continue
        done |= members
        n = _one_instead(work, prisms, count, members, settings)
        if n < count:
            count, first = n, 0
            done[:] = False
            continue
        if size > 2:  # pairs
            pair = np.zeros(len(prisms), np.bool_)
            for i in range(count):
                for j in range(i):
                    if members[i] and members[j] and _gap_m(prisms, i, j) <= CLOSE_M and n == count:
                        pair[:] = False
                        pair[i], pair[j] = True, True
                        n = _one_instead(work, prisms, count, pair, settings)
            if n < count:
                count, first = n, 0
                done[:] = False
                continue
        first += 1
    return count


@compiled
def _one_instead(work: Any, prisms: Any, count: int, members: Any, settings: Any) -> int:
    """Replace the members by one prism if that explains enough more; the new count."""
    bodies, tallest, tall = 0, 0.0, 0
    for j in range(count):
        if members[j]:
            tall = j if prisms[j, 3] > tallest else tall
            bodies += is_body(prism_at(prisms, j))
            tallest = max(tallest, prisms[j, 3])
    if bodies and tallest > SEATED_HIGH_M:
        return count  # who stands beside others stays
    cover = uncovered(work)
    for j in range(count):
        if not members[j]:
            put(work, cover, prism_at(prisms, j), 0.0, ADD)
    several, alone = 0.0, cover.sums.copy()
    for j in range(count):
        if members[j]:
            several += gain(work, cover.sums, prism_at(prisms, j), settings.cost).value
            put(work, cover, prism_at(prisms, j), 0.0, ADD)
    chosen, best = prism_at(prisms, 0), several + settings.merge * abs(several)
    found = False
    shapes = np.empty((2 * HEADINGS + 1, FIELDS))
    for form in range(3):
        if bodies and form < 2:
            continue
        if form < 2:
            one = _around(prisms, members, count, form == 0)
        else:
            shapes[0] = _seated(prisms, members, count)
            one = _best(work, alone, shapes, 1 + _seats(prism_at(prisms, tall), shapes[1:]), settings)
        if plausible(one):
            one = refined(work, alone, one, settings.cost, COARSE_STEP_M)
            value = gain(work, alone, one, settings.cost).value
            if value > best:
                chosen, best, found = one, value, True
    if not found:
        return count
    n = 0
    for j in range(count):
        if not members[j]:
            prisms[n] = prisms[j]
            n += 1
    prisms[n] = chosen
    return n + 1


@compiled
def _divided(work: Any, prisms: Any, count: int, settings: Any) -> int:
    """Put two prisms in the place of a long one, end to end, where they explain enough more; the new count."""
    cover = uncovered(work)
    put_all(work, cover, prisms, count, NOBODY, 0.0, ADD)
    for k in range(count):
        one = prism_at(prisms, k)
        if one.radius < LONG_M or count == len(prisms) or work.spent[0] >= settings.budget:
            continue
        put(work, cover, one, 0.0, TAKE)
        value = gain(work, cover.sums, one, settings.cost).value
        two = np.zeros((2, FIELDS))
        half = one.radius / 2
        for end in range(2):
            away = half if end else -half
            two[end] = cylinder(
                one.x + away * np.cos(one.heading), one.y + away * np.sin(one.heading),
                min(one.radius * one.ratio, half), one.height * min(one.waist, 1.0),
            )  # fmt: skip
        for _ in range(2):
            for end in range(2):
                other = prism_at(two, 1 - end)
                put(work, cover, other, 0.0, ADD)
                two[end] = refined(work, cover.sums, prism_at(two, end), settings.cost, COARSE_STEP_M)
                put(work, cover, other, 0.0, TAKE)
        first, second = prism_at(two, 0), prism_at(two, 1)
        both = gain(work, cover.sums, first, settings.cost).value
        put(work, cover, first, 0.0, ADD)
        both += gain(work, cover.sums, second, settings.cost).value
        if both > value + settings.divide * abs(value) and plausible(first) and plausible(second):
            prisms[k], prisms[count] = first, second
            if stands_alone(work, prisms, count + 1, k, first, settings) and stands_alone(
                work, prisms, count + 1, count, second, settings
            ):
                put(work, cover, second, 0.0, ADD)
                count += 1
                continue
            prisms[k] = one
        put(work, cover, first, 0.0, TAKE)
        put(work, cover, one, 0.0, ADD)
    return count


@compiled
def _shaped(work: Any, prisms: Any, count: int, settings: Any, well: float) -> None:
    """Give each prism that is explained worse than ``well``, a net share, another shape if that explains enough more."""
    cover = uncovered(work)
    put_all(work, cover, prisms, count, NOBODY, 0.0, ADD)
    for k in range(count):
        prism = prism_at(prisms, k)
        if work.spent[0] >= settings.budget:
            break
        put(work, cover, prism, 0.0, TAKE)
        if gain(work, cover.sums, prism, settings.cost).net_share < well:
            other = _better_shape(work, cover.sums, prism, settings, well == WELL_SHAPED)
            prisms[k] = other
            if not stands_alone(work, prisms, count, k, other, settings):
                prisms[k] = prism
        put(work, cover, prism_at(prisms, k), 0.0, ADD)


@compiled
def reshaped(work: Any, prisms: Any, count: int, settings: Any, well: float) -> int:
    """Give what is explained worse than ``well``, a net share, another shape, and merge what lies close together; the new count."""
    _shaped(work, prisms, count, settings, well)
    now = _divided(work, prisms, _merged(work, prisms, count, settings), settings)
    if now != count:
        _shaped(work, prisms, now, settings, well)
    return now
