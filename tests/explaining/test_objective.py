"""What a prism explains, and a set of them, is the plain sum over the samples; a cover can be undone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.prisms import (
    FOUR,
    LEFT_RIGHT,
    THREE,
    Array,
    Watch,
    any_prisms,
    gain_of,
    leg_masks,
    lower_rows,
    mirror_masks,
    person,
    plausible_boxes,
    plausible_cylinders,
    random_weights,
    run_masks,
    sample_masks,
    seen_from,
    shown,
    station,
    tables,
    watch,
    with_waists,
)
from occlib.explaining.evidence import running_sums
from occlib.explaining.objective import (
    LEGS_SHOWN,
    STRIDE_M,
    STRIDE_SHARE,
    Cover,
    Workspace,
    abreast,
    gain,
    left_over,
    objective,
    put,
    put_all,
    supported,
    uncovered,
    workspace,
)
from occlib.explaining.prisms import BOX, PERSON_M, ROUND, Prism, as_array, is_body, larger
from occlib.explaining.silhouettes import CHIN, HEAD, LEGS, run_of, span_of

MARGINS = st.sampled_from([0.0, 0.05, 0.2])
GLOSSES = st.lists(st.sampled_from([0.0, 0.3, 0.8, 1.0]), min_size=3, max_size=3)


def tall(prism: Prism) -> Prism:
    """As high as a person."""
    return prism._replace(height=1.45 + 0.25 * prism.height)


some_prisms = st.one_of(any_prisms, plausible_cylinders.map(tall))


def counted(at: Watch, weights: Array, prism: Prism, gloss: Sequence[float]) -> tuple[Array, list[float]]:
    """The samples by which a prism is judged, and for each view the foreground right beyond its base and top.

    All samples of its silhouette; of a person, head and legs only in columns that show more foreground there, and so
    the legs of a table.
    """
    table, all_legs = prism.waist < 1 and prism.upper == 1, leg_masks(at, prism)
    masks, beyond = np.zeros(at.seen.shape, bool), [0.0] * len(at.views)
    to_chin = prism._replace(height=CHIN * prism.height)
    person = prism.height >= PERSON_M and prism.outline == ROUND and prism.waist >= 1
    for k, (columns, rows) in enumerate(at.sizes.tolist()):
        view = at.views[k]
        span = span_of(view, columns, prism)
        to_axis = np.array([prism.x, prism.y]) - station(view)[:2]
        for column in range(span.first, span.last):
            low, high, above, below, _, _ = run_of(view, rows, prism, span, column)
            evidence = weights[k, :, column].astype(int)
            beyond[k] += int((1 - gloss[k]) * max(evidence[high:below].sum(), 0)) / 255
            azimuth = view.middle + view.left + column * view.step
            sight = np.array([np.cos(azimuth), np.sin(azimuth)])
            chord = np.sqrt(max(prism.radius**2 - (to_axis @ [-sight[1], sight[0]]) ** 2, 0))  # half of it
            if person:
                chin = run_of(view, rows, to_chin, span, column).low
                trunk = chin if chord < HEAD * prism.radius else low
                if evidence[low:trunk].sum() <= 0:
                    low, above = trunk, above + trunk - low
                drop = np.arctan2(view.height - LEGS * prism.height, to_axis @ sight - chord)
                legs = int(np.clip(np.ceil((drop - view.top) / view.step), trunk, high))
                high = legs if evidence[legs:high].sum() <= 0 else high
            if table and evidence[all_legs[k, :, column]].sum() <= 0:
                high -= int(all_legs[k, :, column].sum())
            beyond[k] += max(evidence[above:low].sum(), 0) / 255
            masks[k, low:high, column] = True
    return masks, beyond


@settings(max_examples=40, deadline=None)
@given(prism=some_prisms, seed=st.integers(0, 99), cost=st.floats(0, 0.5), gloss=GLOSSES)
def test_the_gain_is_the_plain_sum_over_the_samples(prism: Prism, seed: int, cost: float, gloss: list[float]) -> None:
    """Of people, half of the time in columns that show no foreground at all."""
    at = watch(THREE, step_px=6.0)
    weights = random_weights(at, seed)
    if seed % 2:
        weights[:, :, seed % 7 :: 3] = -abs(weights[:, :, seed % 7 :: 3])
    masks, beyond = counted(at, weights, prism, gloss)
    total = area = square = share = 0.0
    for k, view in enumerate(at.views):
        covered = int((masks[k] & at.seen[k]).sum())
        explained = float(weights[k][masks[k]].sum()) / 255
        slant = np.linalg.norm([prism.x - view.x, prism.y - view.y, prism.height / 2 - view.height])
        total += (explained - beyond[k]) * view.weight
        area += covered * view.weight
        square += explained * (view.step * slant) ** 2
        share = max(share, explained / max(covered, 1))
    found = gain_of(at, weights, prism, cost, gloss)
    assert found.value == pytest.approx(total - cost * area, abs=1e-6)
    assert found.explained_m2 == pytest.approx(square, abs=1e-6)
    assert found.best_share == pytest.approx(share, abs=1e-6)
    assert found.net_share == pytest.approx(total / max(area, 1e-9), abs=1e-6)


@settings(max_examples=25, deadline=None)
@given(table=tables, seed=st.integers(0, 99), cost=st.floats(0, 0.5))
def test_so_is_that_of_a_table_through_whose_legs_the_floor_shows(table: Prism, seed: int, cost: float) -> None:
    """There are no legs in two of three columns."""
    at = watch(THREE, step_px=6.0)
    weights = random_weights(at, seed)
    legs = leg_masks(at, table)
    legs[:, :, seed % 3 :: 3] = False
    weights[legs] = -abs(weights[legs])
    masks, beyond = counted(at, weights, table, [0.0] * 3)
    assert (masks & legs).sum() == 0 and masks.any()
    total = sum(
        (float(weights[k][masks[k]].sum()) / 255 - beyond[k] - cost * int((masks[k] & at.seen[k]).sum())) * view.weight
        for k, view in enumerate(at.views)
    )
    assert gain_of(at, weights, table, cost).value == pytest.approx(total, abs=1e-6)


@pytest.mark.parametrize("heading", [0.0, 0.5, 1.3])
def test_a_top_with_the_floor_below_it_is_a_table_and_no_box_nor_does_a_carton_become_one(heading: float) -> None:
    at = watch(THREE)
    table = Prism(0.1, 0.1, 0.5, 0.7, BOX, heading, 0.65, 0.92)
    box, plate = table._replace(waist=1.0), table._replace(height=0.7 * 0.92, waist=1.0)
    whole, legs = sample_masks(at, table), leg_masks(at, table)
    top = shown(at, whole & ~legs).weights
    own = gain_of(at, top, table, 0.08)
    assert own.net_share > 0.97
    for other in (box, plate):
        assert gain_of(at, top, other, 0.08).net_share < 0.4
    solid = shown(at, whole).weights
    assert gain_of(at, solid, table, 0.08) == gain_of(at, solid, box, 0.08)  # what hangs down to the floor: no more


@settings(max_examples=15, deadline=None)
@given(prism=st.one_of(plausible_boxes, with_waists))
def test_of_all_prisms_the_one_that_is_there_explains_most(prism: Prism) -> None:
    """Ideal evidence by rays: nothing explains all and nothing else but what stands there."""
    at = watch(THREE)
    weights = shown(at, sample_masks(at, prism)).weights
    own = gain_of(at, weights, prism, 0.15)
    assert own.best_share > 0.97 and own.net_share > 0.93
    others = [
        prism._replace(x=prism.x + 0.08),
        prism._replace(y=prism.y - 0.08),
        prism._replace(radius=1.2 * prism.radius),
        prism._replace(height=0.8 * prism.height),
        prism._replace(outline=BOX - prism.outline),
        prism._replace(waist=1.0) if prism.waist < 1 else prism._replace(waist=0.5, upper=0.5),
        prism._replace(heading=prism.heading + 0.4) if prism.ratio < 0.8 else prism._replace(ratio=0.5),
    ]
    for other in others:
        if other.outline == BOX or other.outline != prism.outline or other.ratio == prism.ratio:
            assert gain_of(at, weights, other, 0.15).value < own.value, other


# --- covering --------------------------------------------------------------------------------------------------
def left_naive(weights: Array, cover: Cover) -> Array:
    """What is left of the weights: nothing where something covers, less of the foreground where some is absorbed."""
    absorbed = np.maximum(100 - cover.absorbed.astype(int), 0)
    less = np.where(weights > 0, weights * absorbed // 100, weights)
    return np.where(cover.counts > 0, 0, less)


def assert_sums(work: Workspace, cover: Cover) -> None:
    left = left_naive(work.weights, cover)
    for k, rows in enumerate(work.sizes[:, 1]):  # padding below a view is never looked at
        np.testing.assert_array_equal(cover.sums[k, : rows + 1], running_sums(left)[k, : rows + 1])


def stride(prism: Prism) -> Prism:
    """Where somebody's legs may be apart."""
    return Prism(prism.x, prism.y, prism.radius + STRIDE_M, LEGS * prism.height)


@settings(max_examples=25, deadline=None)
@given(prism=some_prisms, seed=st.integers(0, 99), margin=MARGINS, gloss=GLOSSES)
def test_a_cover_takes_the_samples_out_and_keeps_the_sums_right(
    prism: Prism, seed: int, margin: float, gloss: list[float]
) -> None:
    at = watch(THREE, step_px=6.0)
    work = workspace(at.evidence(random_weights(at, seed)), gloss)
    kept = work.weights.copy()
    cover = uncovered(work)
    put(work, cover, prism, margin, 1)
    body = larger(prism, margin) if margin else prism
    own = run_masks(at, body)
    assert own.any()
    np.testing.assert_array_equal(cover.counts, own)
    assert_sums(work, cover)
    np.testing.assert_array_equal(work.weights, kept)  # the evidence stays as it is
    np.testing.assert_array_equal(work.sums, running_sums(kept))


@settings(max_examples=25, deadline=None)
@given(prism=some_prisms, gloss=GLOSSES)
def test_the_stride_and_the_mirror_image_are_absorbed_and_nothing_else(prism: Prism, gloss: list[float]) -> None:
    """Sample by sample: rays that meet the wider prism of a person's legs, and rays that the floor throws back."""
    at = watch(THREE)
    work = workspace(at.evidence(), gloss)
    cover = uncovered(work)
    put(work, cover, prism, 0.0, 1)
    expected = np.zeros(at.seen.shape, int)
    if is_body(prism):
        expected += round(100 * STRIDE_SHARE) * sample_masks(at, stride(prism))
    image = lower_rows(mirror_masks(at, prism), run_masks(at, prism))
    expected += np.array([int(100 * g) for g in gloss])[:, None, None] * image
    differ = cover.absorbed != expected
    if prism.waist < 1:
        differ &= cover.absorbed < expected  # a waist's image is not looked at: see the next test
    assert differ.sum(axis=1).max() <= 2, prism  # a row at the rims, where rounding decides
    assert differ.sum() <= 10, prism


@settings(max_examples=30, deadline=None)
@given(
    prisms=st.lists(st.tuples(some_prisms, MARGINS), min_size=1, max_size=4),
    seed=st.integers(0, 99),
    gloss=GLOSSES,
    order=st.randoms(use_true_random=False),
)
def test_what_is_put_and_taken_away_in_any_order_leaves_no_trace(
    prisms: list[tuple[Prism, float]], seed: int, gloss: list[float], order: object
) -> None:
    at = watch(THREE, step_px=6.0)
    work = workspace(at.evidence(random_weights(at, seed)), gloss)
    cover = uncovered(work)
    steps = [(prism, margin, 1) for prism, margin in prisms]
    order.shuffle(steps)  # type: ignore[attr-defined]
    there: list[tuple[Prism, float]] = []
    counts, absorbed = np.zeros(at.seen.shape, int), np.zeros(at.seen.shape, int)
    alone = {}
    for each in set(prisms):
        only = uncovered(work)
        put(work, only, *each, 1)
        alone[each] = only
    while steps or there:  # sometimes one more, sometimes one less
        if steps and (not there or order.random() < 0.6):  # type: ignore[attr-defined]
            prism, margin, _ = steps.pop()
            there.append((prism, margin))
            sign = 1
        else:
            prism, margin = there.pop(order.randrange(len(there)))  # type: ignore[attr-defined]
            sign = -1
        put(work, cover, prism, margin, sign)
        counts += sign * alone[prism, margin].counts
        absorbed += sign * alone[prism, margin].absorbed
        np.testing.assert_array_equal(cover.counts, counts)
        np.testing.assert_array_equal(cover.absorbed, absorbed)
        assert_sums(work, cover)
    np.testing.assert_array_equal(cover.sums, work.sums)


def test_all_but_one_are_put() -> None:
    at = watch(THREE, step_px=6.0)
    work = workspace(at.evidence(random_weights(at, 0)))
    prisms = [Prism(0.1 * i, 0.2, 0.2, 0.4) for i in range(4)]
    cover, expected = uncovered(work), uncovered(work)
    put_all(work, cover, as_array(prisms, "prisms"), 3, 1, 0.05, 1)
    for prism in (prisms[0], prisms[2]):
        put(work, expected, prism, 0.05, 1)
    np.testing.assert_array_equal(cover.sums, expected.sums)


@settings(max_examples=20, deadline=None)
@given(
    prisms=st.lists(st.tuples(some_prisms, MARGINS), max_size=3),
    seed=st.integers(0, 99),
    gloss=GLOSSES,
)
def test_the_share_left_over_is_that_of_the_foreground(
    prisms: list[tuple[Prism, float]], seed: int, gloss: list[float]
) -> None:
    at = watch(THREE, step_px=6.0)
    weights = random_weights(at, seed)
    work = workspace(at.evidence(weights), gloss)
    cover = uncovered(work)
    for prism, margin in prisms:
        put(work, cover, prism, margin, 1)
    left, whole = np.maximum(left_naive(weights, cover), 0).sum(), np.maximum(weights, 0).sum()
    assert left_over(work, cover) == pytest.approx(left / whole)
    assert left_over(work, uncovered(work)) == 1
    nothing = workspace(at.evidence(-abs(weights)))
    assert left_over(nothing, uncovered(nothing)) == 0


@settings(max_examples=20, deadline=None)
@given(prisms=st.lists(some_prisms, max_size=4), seed=st.integers(0, 99), cost=st.floats(0, 0.5), gloss=GLOSSES)
def test_the_objective_counts_what_several_cover_once(
    prisms: list[Prism], seed: int, cost: float, gloss: list[float]
) -> None:
    at = watch(THREE, step_px=6.0)
    weights = random_weights(at, seed)
    prisms = [*prisms, *prisms[:1]]  # the first one twice: pays its price twice and explains once
    work = workspace(at.evidence(weights), gloss)
    expected, cover = 0.0, uncovered(work)
    for prism in prisms:
        left = left_naive(weights, cover)
        masks, beyond = counted(at, left, prism, gloss)
        for k, view in enumerate(at.views):
            covered, explained = int((masks[k] & at.seen[k]).sum()), float(left[k][masks[k]].sum()) / 255
            expected += (explained - beyond[k] - cost * covered) * view.weight
        put(work, cover, prism, 0.0, 1)
    for _ in range(2):  # the scratch is left as it was
        value = objective(work, as_array(prisms, "prisms"), len(prisms), cost)
        assert value == pytest.approx(expected, abs=1e-6)
    np.testing.assert_array_equal(work.weights, weights)
    np.testing.assert_array_equal(work.scratch.sums, work.sums)
    assert not work.scratch.counts.any() and not work.scratch.absorbed.any()


# --- who stands beside whom ------------------------------------------------------------------------------------
@settings(max_examples=40, deadline=None)
@given(prism=some_prisms, other=some_prisms, margin=MARGINS, seed=st.integers(0, 99), gloss=GLOSSES)
def test_what_has_no_column_in_common_takes_nothing_away(
    prism: Prism, other: Prism, margin: float, seed: int, gloss: list[float]
) -> None:
    at = watch(LEFT_RIGHT, step_px=6.0)
    work = workspace(at.evidence(random_weights(at, seed)), gloss[:2])
    wide = larger(other, margin + (STRIDE_M if is_body(other) else 0.0))
    spans = [[span_of(view, at.sizes[k, 0], one)[:2] for one in (prism, wide)] for k, view in enumerate(at.views)]
    beside = abreast(work, prism, other, margin)
    assert beside is any(set(range(*own)) & set(range(*its)) for own, its in spans)
    if not beside:
        cover = uncovered(work)
        put(work, cover, other, margin, 1)
        assert gain(work, cover.sums, prism, 0.1) == gain(work, work.sums, prism, 0.1)


def test_a_margin_makes_nothing_somebody() -> None:
    at = watch(LEFT_RIGHT, step_px=6.0)
    work = workspace(at.evidence(random_weights(at, 0)))
    cover = uncovered(work)
    put(work, cover, Prism(0.1, 0.2, 0.2, 1.03), 0.05, 1)
    assert not cover.absorbed.any()


def test_whoever_stands_in_line_for_one_view_is_abreast() -> None:
    at = watch()
    work = workspace(at.evidence())
    beside = Prism(0.0, 0.6, 0.1, 0.3)
    assert not abreast(work, Prism(0.0, 0.0, 0.1, 0.3), beside, 0.05)
    assert abreast(work, Prism(0.0, 0.0, 0.1, 0.3), beside, 0.5)  # with such a margin
    assert abreast(work, Prism(0.0, 0.0, 0.1, 0.3), beside._replace(height=1.5), 0.2)  # somebody takes a stride
    assert not abreast(work, Prism(0.0, 0.0, 0.1, 0.3), beside._replace(height=1.0), 0.2)
    assert abreast(work, Prism(0.0, 0.0, 0.1, 0.3), Prism(-0.8, 0.0, 0.1, 0.3), 0.05)


# --- support ---------------------------------------------------------------------------------------------------
def supported_naive(at: Watch, weights: Array, prism: Prism, least: float, spare: float) -> bool:
    """Sample by sample, also those beyond the polar views."""
    own = run_masks(at, prism)
    whole = run_masks(at.around(300, 150), prism).sum(axis=(1, 2))
    seeing = showing = 0
    if prism.height >= PERSON_M and prism.outline == ROUND and prism.waist >= 1:
        legs = leg_masks(at, prism)
        shares = [
            (weights[k][part] > 0).mean() for k, part in enumerate(legs & at.seen) if 2 * part.sum() > legs[k].sum()
        ]
        if sum(share >= LEGS_SHOWN for share in shares) < len(shares) / 2:
            return False
    for k in range(len(at.views)):
        seen = int((own[k] & at.seen[k]).sum())
        if seen > whole[k] / 2:
            seeing += 1
            showing += int((weights[k][own[k] & at.seen[k]] > 0).sum()) >= least * seen
    return showing >= seeing - int(spare * seeing) and showing >= min(2, seeing)


@settings(max_examples=60, deadline=None)
@given(
    prism=some_prisms.filter(lambda p: np.hypot(p.x, p.y) < 1.2),  # well within the pictures
    share=st.lists(st.floats(0, 1), min_size=3, max_size=3),
    legs=st.lists(st.sampled_from([0.0, 0.05, 0.11, 1.0]), min_size=3, max_size=3),
    blind=st.sampled_from([0, 1, 2, 4]),
    least=st.sampled_from([0.25, 0.6]),
    spare=st.sampled_from([0.0, 0.25, 0.4, 0.7, 1.0]),
    seed=st.integers(0, 99),
)
def test_every_view_that_sees_an_object_supports_it_but_for_those_to_spare(
    prism: Prism, share: list[float], legs: list[float], blind: int, least: float, spare: float, seed: int
) -> None:
    """What is left of a person's legs is drawn, too."""
    at = watch(THREE, step_px=6.0)
    seen = at.seen.copy()
    if blind < 3:  # a view that sees nothing has no say
        seen[blind] = False
    at = Watch(at.views, at.sizes, seen, at.rays)
    drawn = np.random.default_rng(seed).random(seen.shape)
    shares = np.where(leg_masks(at, prism), np.array(legs)[:, None, None], np.array(share)[:, None, None])
    foreground = drawn < shares
    weights = np.where(foreground, 30, -30) * seen
    work = workspace(at.evidence(weights))
    assert supported(work, prism, least, spare) is supported_naive(at, weights, prism, least, spare)


def test_what_one_of_two_views_does_not_show_is_not_supported_whoever_may_be_spared() -> None:
    prism, at = Prism(0.1, 0.1, 0.2, 0.4), watch()
    weights = shown(at, sample_masks(at, prism)).weights
    assert supported(workspace(at.evidence(weights)), prism, 0.25, 0.0)
    weights[1] = -150
    for spare in (0.0, 0.5, 1.0):  # two at least must show it, as two see it
        assert not supported(workspace(at.evidence(weights)), prism, 0.25, spare)


def test_with_a_third_to_spare_two_of_three_do() -> None:
    prism, at = Prism(0.1, 0.1, 0.2, 0.4), watch(THREE)
    weights = shown(at, sample_masks(at, prism)).weights
    weights[2] = -150
    assert not supported(workspace(at.evidence(weights)), prism, 0.25, 0.0)
    assert supported(workspace(at.evidence(weights)), prism, 0.25, 0.34)
    assert not supported(workspace(at.evidence(weights)), prism, 0.25, 0.25)  # not a whole one
    weights[1] = -150
    assert not supported(workspace(at.evidence(weights)), prism, 0.25, 0.34)


def test_foreground_that_another_object_casts_counts() -> None:
    at = watch()
    near, hidden = Prism(-0.3, 0.05, 0.27, 0.9), Prism(0.45, 0.06, 0.11, 0.16)
    evidence = seen_from(LEFT_RIGHT, [near, hidden])
    assert supported(workspace(evidence), hidden, 0.95, 0.0)
    assert not supported(workspace(seen_from(LEFT_RIGHT, [near])), hidden, 0.25, 0.0)  # right does not show it
    assert at.seen.any()


SOMEBODY = Prism(0.1, 0.1, 0.2, 1.7)


@pytest.mark.parametrize(
    ("cameras", "without", "stands"),
    [
        (LEFT_RIGHT, (), True),
        (LEFT_RIGHT, (1,), True),  # half of the views show them
        (LEFT_RIGHT, (0, 1), False),
        (THREE, (0,), True),
        (THREE, (0, 2), False),
        (FOUR, (0, 2), True),
        (FOUR, (0, 1, 3), False),
    ],
)
def test_half_of_the_views_show_the_legs_of_somebody_who_stands(
    cameras: tuple[str, ...], without: tuple[int, ...], stands: bool
) -> None:
    at = watch(cameras)
    bodies, legs = sample_masks(at, SOMEBODY), leg_masks(at, SOMEBODY)
    for k in without:
        bodies[k] &= ~legs[k]
    work = workspace(shown(at, bodies))
    assert supported(work, SOMEBODY, 0.18, 0.25) is stands
    for other in (SOMEBODY._replace(height=1.39), SOMEBODY._replace(outline=BOX, waist=0.4, upper=0.5)):
        assert supported(work, other, 0.18, 0.25)  # of nothing else legs are asked for


@pytest.mark.parametrize(("share", "stands"), [(0.0, True), (0.4, True), (0.6, False), (1.0, False)])
def test_a_view_that_does_not_see_half_of_the_legs_has_no_say_about_them(share: float, stands: bool) -> None:
    """Two of three views show none; then it is one of two that does show them, or one of three."""
    at = watch(THREE)
    bodies, legs = sample_masks(at, SOMEBODY), leg_masks(at, SOMEBODY)
    bodies[:2] &= ~legs[:2]
    seen = at.seen.copy()
    rows, columns = np.nonzero(legs[0])
    seen[0, rows, columns] = np.arange(len(rows)) < share * len(rows)
    partly = Watch(at.views, at.sizes, seen, at.rays)
    assert supported(workspace(shown(partly, bodies)), SOMEBODY, 0.18, 0.25) is stands


@pytest.mark.parametrize("share", [0.06, 0.1])
def test_a_few_samples_of_the_legs_do_but_not_fewer(share: float) -> None:
    at = watch()
    bodies, legs = sample_masks(at, SOMEBODY), leg_masks(at, SOMEBODY)
    for k in range(2):
        rows, columns = np.nonzero(legs[k] & at.seen[k])
        bodies[k] &= ~legs[k]
        few = round(share * len(rows))
        bodies[k, rows[:few], columns[:few]] = True
    assert supported(workspace(shown(at, bodies)), SOMEBODY, 0.18, 0.0) is (share > 0.08)


@pytest.mark.xfail(strict=True, reason="supported takes the part within the polar view for the whole silhouette")
def test_a_view_that_sees_less_than_half_of_an_object_has_no_say() -> None:
    """At the left edge of the front camera's picture: two columns of it are in the picture, some twenty are not."""
    at = watch(("left", "right", "front"))
    whole = at.around(300, 150)
    prism = None
    for x in np.arange(-4.0, 4.0, 0.02):
        one = Prism(float(x), 0.9, 0.2, 0.4)
        seen = (run_masks(at, one) & at.seen).sum(axis=(1, 2)) / run_masks(whole, one).sum(axis=(1, 2))
        if seen[0] > 0.9 and seen[1] > 0.9 and 0 < seen[2] < 0.3:
            prism = one
            break
    assert prism is not None
    weights = np.where(sample_masks(at, prism), 255, -150) * at.seen
    weights[2] = -150 * at.seen[2]
    assert supported(workspace(at.evidence(weights)), prism, 0.25, 0.0)


# --- people ----------------------------------------------------------------------------------------------------
def test_legs_that_are_apart_lie_in_the_stride() -> None:
    at = watch(THREE)
    masks = person(at, ((0.1, -0.1), (0.1, 0.5)))
    body = Prism(0.1, 0.2, 0.2, 1.68)
    evidence = shown(at, masks)
    work = workspace(evidence)
    cover = uncovered(work)
    put(work, cover, body, 0.0, 1)
    legs = masks & ~run_masks(at, body)
    low = sample_masks(at, Prism(0.1, 0.2, 0.6, 0.6))
    assert (legs & low).sum() > 300
    assert (cover.absorbed[legs & low] > 0).mean() > 0.9
    put(work, cover, body, 0.0, -1)
    put(work, cover, body._replace(height=1.0), 0.0, 1)
    assert not cover.absorbed.any()
