"""Two views, one map: the rules cell by cell, the umbra that holds every base, and who hides whom."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from occlib.explaining.explainer import standing_places
from occlib.geometry import Floor
from occlib.occlusion import RULES, FusionRule, fuse, fusion_rule, hidden_fractions, truth_table

Array = np.ndarray[Any, Any]
LEFT = np.array([[True, True, False, False]])
RIGHT = np.array([[True, False, True, False]])


# --- rules -------------------------------------------------------------------------------------------------
def test_and_and_or_on_all_four_rows() -> None:
    assert fuse([LEFT, RIGHT]).tolist() == [[True, False, False, False]]
    assert fuse([LEFT, RIGHT], "and").tolist() == [[True, False, False, False]]
    assert fuse([LEFT, RIGHT], "or").tolist() == [[True, True, True, False]]
    assert fuse([LEFT, RIGHT]).dtype == np.bool_


def test_the_truth_table_is_complete_and_says_what_fuse_does() -> None:
    table = truth_table()
    assert {(row["left"], row["right"]) for row in table} == set(product([True, False], repeat=2))
    for row in table:
        assert row["output"] == fuse([np.array([[row["left"]]]), np.array([[row["right"]]])])[0, 0]
    printed = {(row["left"], row["right"]): row["as printed"] for row in table}
    assert "twice" in printed[False, False] and printed[True, False] == "missing"


@given(arrays(bool, (3, 4, 5)))
def test_the_order_of_the_views_does_not_matter_and_repeating_one_changes_nothing(views: Array) -> None:
    for rule, numpys in (("and", np.logical_and), ("or", np.logical_or)):
        expected = numpys.reduce(views)
        np.testing.assert_array_equal(fuse(list(views), rule), expected)
        np.testing.assert_array_equal(fuse(list(views[::-1]), rule), expected)
        np.testing.assert_array_equal(fuse([*views, views[0]], rule), expected)
    np.testing.assert_array_equal(fuse(list(views), "and"), ~fuse(list(~views), "or"))  # De Morgan


@given(arrays(np.uint8, (2, 4, 5)), st.integers(0, 255))
def test_thresholding_the_soft_result_equals_the_rule_on_the_thresholded_views(views: Array, level: int) -> None:
    for rule in ("and", "or"):
        soft = fuse(list(views), rule)
        assert soft.dtype == np.uint8
        np.testing.assert_array_equal(soft > level, fuse(list(views > level), rule))


def test_three_views_of_float_evidence() -> None:
    views = [np.array([[0.2, 0.9, -1.0]]), np.array([[0.5, 0.8, 3.0]]), np.array([[0.4, 0.7, 2.0]])]
    assert fuse(views).tolist() == [[0.2, 0.7, -1.0]]
    assert fuse(views, "or").tolist() == [[0.5, 0.9, 3.0]]


# --- what a view cannot see ----------------------------------------------------------------------------------
def fuse_naive(views: list[Array], rule: str, visible: list[Array]) -> Array:
    """Cell by cell: the rule among the views that see the cell; 0 where none does."""
    fused = np.zeros_like(views[0])
    for cell in np.ndindex(views[0].shape):
        evidence = [view[cell] for view, seen in zip(views, visible, strict=True) if seen[cell]]
        if evidence:
            fused[cell] = min(evidence) if rule == "and" else max(evidence)
    return fused


KINDS: dict[str, st.SearchStrategy[Array]] = {
    "bool": arrays(bool, (3, 3, 4)),
    "uint8": arrays(np.uint8, (3, 3, 4)),
    "int16": arrays(np.int16, (3, 3, 4)),
    "float": arrays(np.float64, (3, 3, 4), elements=st.floats(-9, 9)),
}


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["and", "or"])
@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
def test_a_view_says_nothing_about_what_it_cannot_see(kind: str, rule: str, data: st.DataObject) -> None:
    views = list(data.draw(KINDS[kind]))
    visible = list(data.draw(arrays(bool, (3, 3, 4))))
    kept = [view.copy() for view in views]
    fused = fuse(views, rule, visible=visible)
    assert fused.dtype == views[0].dtype
    np.testing.assert_array_equal(fused, fuse_naive(views, rule, visible))
    for view, before in zip(views, kept, strict=True):
        np.testing.assert_array_equal(view, before)


def test_seeing_everything_is_the_same_as_not_saying() -> None:
    everywhere = np.ones_like(LEFT)
    for rule in ("and", "or"):
        np.testing.assert_array_equal(
            fuse([LEFT, RIGHT], rule, visible=[everywhere, everywhere]), fuse([LEFT, RIGHT], rule)
        )


def test_changing_the_result_never_changes_the_evidence() -> None:
    for views in ([LEFT.copy()], [LEFT.copy(), RIGHT.copy()]):
        fused = fuse(views)
        fused[:] = True
        np.testing.assert_array_equal(views[0], LEFT)


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(ValueError, match=f"rule: expected one of {', '.join(RULES)}, got 'xor'"):
        fuse([LEFT], "xor")
    with pytest.raises(ValueError, match="evidence: expected at least one view, got none"):
        fuse([])
    for other in (RIGHT[:, :2], RIGHT.astype(np.uint8), RIGHT[0]):
        with pytest.raises(ValueError, match="evidence: expected one shape and dtype"):
            fuse([LEFT, other])
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="evidence: expected finite numbers, got NaN or infinity"):
            fuse([np.array([[0.5]]), np.array([[bad]])])
    for visible in ([LEFT], [LEFT, RIGHT[:, :2]]):
        with pytest.raises(ValueError, match=r"visible: expected 2 masks of shape \(1, 4\)"):
            fuse([LEFT, RIGHT], visible=visible)


# --- the soft rules, cell by cell ------------------------------------------------------------------------------
FULL: dict[str, st.SearchStrategy[Array]] = {
    "bool": arrays(bool, (3, 4)),
    "uint8": arrays(np.uint8, (3, 4)),
    "float": arrays(float, (3, 4), elements=st.floats(0, 1)),
}


def probability(value: Any) -> float:
    return float(value) / 255 if isinstance(value, np.uint8) else float(value)


def joint_naive(views: list[Array], rule: str, visible: list[Array]) -> Array:
    """Cell by cell, in plain words, as a float; no view is surer than a thousandth."""
    fused = np.zeros(views[0].shape)
    for cell in np.ndindex(views[0].shape):
        evidence = [probability(view[cell]) for view, seen in zip(views, visible, strict=True) if seen[cell]]
        if not evidence:
            continue
        p = [min(max(e, 1e-3), 1 - 1e-3) for e in evidence]
        if rule == "most":  # one view may say no: the second smallest, where there are two or more
            fused[cell] = sorted(evidence)[min(1, len(evidence) - 1)]
        elif rule == "product":
            fused[cell] = math.prod(p) ** (1 / len(p))
        else:
            odds = math.prod(q / (1 - q) for q in p)
            fused[cell] = odds / (1 + odds)
    return fused


def assert_is(fused: Array, expected: Array) -> None:
    """The evidence is this probability: as a float, rounded to 255ths, or, but for a tie, whether it is likelier than not."""
    if fused.dtype == np.bool_:
        clear = np.abs(expected - 0.5) > 1e-9
        np.testing.assert_array_equal(fused[clear], expected[clear] > 0.5)
    else:
        scale, spare = (255, 0.5 + 1e-6) if fused.dtype == np.uint8 else (1, 1e-9)
        assert np.abs(fused - scale * expected).max() <= spare


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("rule", ["most", "product", "log-odds"])
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_the_joint_rules_are_what_they_say_cell_by_cell(rule: str, count: int, data: st.DataObject) -> None:
    kind = FULL[data.draw(st.sampled_from(sorted(FULL)))]
    views = [data.draw(kind) for _ in range(count)]
    everywhere = [np.ones((3, 4), bool)] * count
    some = [data.draw(arrays(bool, (3, 4))) for _ in range(count)]
    kept = [view.copy() for view in views]
    for visible in (everywhere, some):
        fused = fuse(views, rule, visible=visible)
        assert fused.dtype == views[0].dtype and fused.shape == (3, 4)
        assert_is(fused, joint_naive(views, rule, visible))
        assert not fused[~np.any(visible, axis=0)].any()  # what no view sees is 0
    np.testing.assert_array_equal(fuse(views, rule), fuse(views, rule, visible=everywhere))
    np.testing.assert_allclose(
        fuse(views[::-1], rule).astype(float), fuse(views, rule), atol=1e-9 if kind is FULL["float"] else 1
    )
    for view, before in zip(views, kept, strict=True):
        np.testing.assert_array_equal(view, before)


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["and", "or", "most", "product", "log-odds"])
@given(data=st.data())
def test_one_view_alone_is_passed_on(rule: str, data: st.DataObject) -> None:
    view = data.draw(FULL[data.draw(st.sampled_from(sorted(FULL)))])
    fused = fuse([view], rule)
    if rule in ("product", "log-odds"):  # but for certainty, which no view has
        view = np.clip(view, 0.001, 0.999) if view.dtype.kind == "f" else view
    np.testing.assert_allclose(fused.astype(float), view, atol=1e-9)


def test_the_rules_on_all_rows_of_three_views() -> None:
    rows = list(product([False, True], repeat=3))
    views = [np.array([column]) for column in zip(*rows, strict=True)]
    count = np.array([[sum(row) for row in rows]])
    for rule, least in {"and": 3, "or": 1, "most": 2, "product": 3, "log-odds": 2}.items():
        np.testing.assert_array_equal(fuse(views, rule), count >= least)
        soft = fuse([255 * v.astype(np.uint8) for v in views], rule)
        np.testing.assert_array_equal(soft > 127, count >= least)
    pairs = [np.array([[False, False, True, True]]), np.array([[False, True, False, True]])]
    assert fuse(pairs, "most").tolist() == [[False, True, True, True]]  # of two views one may miss it
    assert fuse(pairs, "product").tolist() == [[False, False, False, True]]


def test_a_sure_view_outvotes_two_that_waver_by_log_odds_alone() -> None:
    views = [np.array([[0.95]]), np.array([[0.4]]), np.array([[0.4]])]
    assert fuse(views, "log-odds") > 0.5 > fuse(views, "most")
    assert fuse(views, "log-odds")[0, 0] == pytest.approx(1 / (1 + np.exp(-(np.log(19) + 2 * np.log(2 / 3)))))


@settings(max_examples=60, deadline=None)
@given(data=st.data(), planes=st.integers(1, 5), count=st.integers(1, 4))
def test_planes_count_where_every_view_agrees(data: st.DataObject, planes: int, count: int) -> None:
    kinds = {"bool": (bool, None), "uint8": (np.uint8, None), "float": (float, st.floats(0, 1))}
    dtype, elements = kinds[data.draw(st.sampled_from(sorted(kinds)))]
    shape = (planes, 2, 3)
    views = [data.draw(arrays(dtype, shape, elements=elements)) for _ in range(count)]
    everywhere, some = [np.ones(shape, bool)] * count, [data.draw(arrays(bool, shape)) for _ in range(count)]
    kept = [view.copy() for view in views]
    for visible in (everywhere, some):
        fused = fuse(views, "planes", visible=visible)
        assert fused.shape == (2, 3) and fused.dtype == views[0].dtype
        expected = np.zeros((2, 3))
        for p, iy, ix in np.ndindex(shape):
            said = [probability(v[p, iy, ix]) for v, seen in zip(views, visible, strict=True) if seen[p, iy, ix]]
            expected[iy, ix] += min(said, default=0.0) / planes
        if fused.dtype == np.bool_:
            np.testing.assert_array_equal(fused, expected > 0.5 - 1e-9)  # half of the planes are enough
        else:
            assert_is(fused, expected)
    np.testing.assert_array_equal(fuse(views, "planes"), fuse(views, "planes", visible=everywhere))
    for view, before in zip(views, kept, strict=True):
        np.testing.assert_array_equal(view, before)


def test_a_body_counts_where_the_feet_are_not_seen() -> None:
    left = np.array([[[False]], [[True]], [[True]], [[True]]])  # a low thing hides the feet, plane 0
    right = np.ones_like(left)
    assert fuse([left, right], "planes").tolist() == [[True]]
    assert fuse([left[:2], right[:2]], "planes").tolist() == [[True]]  # half of the planes is enough,
    assert fuse([left[[0, 0, 1]], right[:3]], "planes").tolist() == [[False]]  # a third is not
    assert fuse([left[0], right[0]], "and").tolist() == [[False]]


def test_wrong_arguments_of_the_soft_rules_are_named() -> None:
    for rule in ("product", "log-odds"):
        for bad in (-0.1, 1.5):
            with pytest.raises(ValueError, match=r"evidence: expected probabilities in \[0, 1\], got"):
                fuse([np.array([[0.5, bad]])], rule)
    with pytest.raises(ValueError, match="evidence: expected one shape and dtype"):
        fuse([LEFT, RIGHT], "planes")
    for rule in ("and", "most", "product"):
        with pytest.raises(ValueError, match="evidence: expected one shape and dtype"):
            fuse([np.ones((2, 3, 4), bool)], rule)
    with pytest.raises(ValueError, match=r"visible: expected 2 masks of shape \(2, 1, 4\)"):
        fuse([np.ones((2, 1, 4), bool)] * 2, "planes", visible=[np.ones((1, 4), bool)] * 2)
    with pytest.raises(ValueError, match="evidence: expected finite numbers"):
        fuse([np.array([[np.nan]])], "log-odds")
    with pytest.raises(ValueError, match="evidence: expected at least one plane, got none"):
        fuse([np.ones((0, 2, 3), bool)], "planes")


def test_what_callers_need_to_know_is_told_by_each_rule() -> None:
    assert all(name == rule.name and rule.description and "\n" not in rule.description for name, rule in RULES.items())
    expected = {"and": (False, False, True, False), "or": (False, False, False, True), "most": (False,) * 4}
    expected |= {"product": (True, False, False, False), "log-odds": (True, False, False, False)}
    expected |= {"planes": (True, True, False, False)}
    for name, flags in expected.items():
        rule = RULES[name]
        assert (rule.soft, rule.planes, rule.unanimous, rule.one_view_enough) == flags, name


@given(arrays(bool, (3, 4, 5)), arrays(bool, (3, 4, 5)))
def test_a_unanimous_rule_lies_inside_every_view_that_sees_the_cell(views: Array, seen: Array) -> None:
    for name in (name for name, rule in RULES.items() if rule.unanimous):
        fused = fuse(list(views), name, visible=list(seen))
        assert (views | ~seen)[:, fused].all()


def test_a_rule_of_ones_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("occlib.occlusion.RULES", table := dict(RULES))

    @fusion_rule("nearest-yes", soft=True)
    def _mean(views: Array, seen: Array) -> Array:
        """the mean is at least one half

        And more.
        """
        assert views.dtype == np.float64 and seen.dtype == np.bool_ and views.shape == seen.shape
        return np.asarray(np.where(seen, views, 0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1))

    expected = FusionRule("nearest-yes", "the mean is at least one half", _mean, soft=True)
    assert table["nearest-yes"] == expected
    views = [np.array([[255, 0, 80]], np.uint8), np.array([[155, 0, 90]], np.uint8)]
    assert fuse(views, "nearest-yes").tolist() == [[205, 0, 85]]
    assert fuse(views, "nearest-yes", visible=[np.array([[True, False, False]])] * 2).tolist() == [[205, 0, 0]]
    assert fuse([LEFT, RIGHT], "nearest-yes").tolist() == [[True, True, True, False]]
    fusion_rule("nearest-yes")(lambda views, seen: views[0, 0])  # again, as in a notebook
    with pytest.raises(ValueError, match=r"nearest-yes: expected a rule that returns \(1, 4\), got \(4,\)"):
        fuse([LEFT, RIGHT], "nearest-yes")
    for bad in ("and", "log odds", "", 3):
        with pytest.raises(ValueError, match=f"name: expected letters, digits, _ and -, and none of .*; got {bad!r}"):
            fusion_rule(bad)  # type: ignore[arg-type]


def test_evidence_at_the_level_is_not_above_it() -> None:
    floor, seen = Floor((0.0, 0.2), (0.0, 0.1), 0.1), [np.ones((1, 1, 2), bool)] * 2
    evidence = [np.array([[[127, 128]]], np.uint8)] * 2
    np.testing.assert_allclose(standing_places(evidence, seen, floor), [[0.15, 0.05]])


@settings(max_examples=50, deadline=None)
@given(data=st.data(), views=st.integers(1, 3), level=st.sampled_from([0, 100, 127, 255]))
def test_standing_places_are_cells_where_no_view_that_sees_them_objects(
    data: st.DataObject, views: int, level: int
) -> None:
    floor, shape = Floor((-1.0, 0.0), (2.0, 2.6), 0.2), (2, 3, 5)
    count = data.draw(st.integers(1, 3))
    evidence = [data.draw(arrays(np.uint8, shape)) for _ in range(count)]
    visible = [data.draw(arrays(bool, shape)) for _ in range(count)]
    expected = []
    for iy, ix in np.ndindex(floor.shape):
        for plane in range(2):
            said = [e[plane, iy, ix] for e, seen in zip(evidence, visible, strict=True) if seen[plane, iy, ix]]
            if len(said) >= views and all(value > level for value in said):
                expected.append([-1.0 + 0.2 * (ix + 0.5), 2.0 + 0.2 * (iy + 0.5)])
                break
    found = standing_places(evidence, visible, floor, level=level, views=views)
    assert found.shape == (len(expected), 2)
    np.testing.assert_allclose(found, np.array(expected).reshape(-1, 2))


# --- the umbra ------------------------------------------------------------------------------------------------
NY, NX, CELL = 60, 80, 0.05  # a floor of 4 m x 3 m
IY, IX = np.mgrid[:NY, :NX]
CENTRES = np.stack([(IX + 0.5) * CELL, (IY + 0.5) * CELL], axis=-1)
Prism = tuple[Array, float]


def prism(x: float, y: float, radius: float, height: float, sides: int, turn: float) -> Prism:
    """An upright prism with a regular base, a near-cylinder for many sides: corners in m and height in m."""
    angle = turn + 2 * np.pi * np.arange(sides) / sides
    return np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)]), height


def blocked(points: Array, lamp: Array, solid: Prism) -> Array:
    """Whether the sight-line from each floor point to the lamp meets the solid: clipped by its sides, up to its top."""
    corners, height = solid
    low, high = np.zeros(points.shape[:-1]), np.full(points.shape[:-1], height / lamp[2])
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        normal = np.array([b[1] - a[1], a[0] - b[0]])  # outwards, as the corners run counter-clockwise
        at_start, slope = (points - a) @ normal, (lamp[:2] - points) @ normal  # inside: at_start + s * slope <= 0
        crossing = -at_start / np.where(slope == 0, 1.0, slope)
        high = np.where((slope == 0) & (at_start > 0), -1.0, high)  # runs beside the solid
        high = np.where(slope > 0, np.minimum(high, crossing), high)
        low = np.where(slope < 0, np.maximum(low, crossing), low)
    return np.asarray(low <= high)


def shadow(lamp: Array, solids: list[Prism]) -> Array:
    return np.any([blocked(CENTRES, lamp, solid) for solid in solids], axis=0)


def base(solid: Prism) -> Array:
    corners = solid[0]
    edges = np.roll(corners, -1, axis=0) - corners
    offsets = CENTRES[..., None, :] - corners
    return np.asarray((edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0] > 1e-9).all(axis=-1))


solids = st.lists(
    st.builds(
        prism,
        x=st.floats(0.3, 3.7),
        y=st.floats(0.3, 2.7),
        radius=st.floats(0.1, 0.4),
        height=st.floats(0.05, 0.9),
        sides=st.sampled_from([3, 4, 6, 24]),
        turn=st.floats(0, 6),
    ),
    min_size=1,
    max_size=5,
)
lamps = st.lists(
    st.tuples(st.floats(-2, 6), st.floats(-2, 5), st.floats(1.0, 4.0)).map(np.array), min_size=2, max_size=4
)


@settings(max_examples=80, deadline=None)
@given(solids, lamps)
def test_the_umbra_holds_the_base_of_every_object(things: list[Prism], cameras: list[Array]) -> None:
    views = [shadow(camera, things) for camera in cameras]
    umbra = fuse(views)
    for thing in things:
        assert umbra[base(thing)].all()
    for view in views:
        assert not (umbra & ~view).any()  # never more than any single shadow claims
    assert fuse(views, "or")[umbra].all()


def test_one_shadow_claims_far_more_floor_than_the_umbra_of_two() -> None:
    thing = prism(2.0, 1.5, 0.2, 0.4, 24, 0.0)
    views = [shadow(np.array([x, 1.5, 2.5]), [thing]) for x in (-1.0, 5.0)]
    true = base(thing).sum()
    assert all(view.sum() > 1.8 * true for view in views)
    assert fuse(views).sum() < 1.2 * true


def test_an_object_hidden_from_the_left_is_on_the_map_and_apart() -> None:
    big, small = prism(1.6, 1.5, 0.3, 0.9, 24, 0.0), prism(2.6, 1.5, 0.1, 0.1, 24, 0.0)
    left, right = np.array([-1.5, 1.5, 2.5]), np.array([5.5, 1.5, 2.5])
    alone = shadow(left, [big])
    assert alone[base(small)].all()  # the left view learns nothing from the small object ...
    umbra = fuse([shadow(left, [big, small]), shadow(right, [big, small])])
    assert umbra[base(small)].all()  # ... and yet it is on the map,
    assert not umbra[:, int(2.2 / CELL)].any()  # with free floor between the two


# --- who hides whom --------------------------------------------------------------------------------------------
def hidden_naive(labels: Array, masks: list[Array], stations: list[Any], *, rays: int, step: int) -> Array:
    """Ray by ray: walk from a cell towards the station while the view says foreground; another object hides it."""
    fractions = np.zeros((labels.max(initial=0), len(masks)))
    for row in range(len(fractions)):
        cells = np.argwhere(labels == row + 1)[:, ::-1]
        tested = min(rays, len(cells))
        for view, (mask, station) in enumerate(zip(masks, stations, strict=True)):
            hidden = 0
            for k in range(tested):
                start = cells[k * len(cells) // tested].astype(float)
                distance = float(np.hypot(*(station - start)))
                walked = 0.0
                while walked < distance:
                    walked = min(walked + step, distance)
                    x, y = np.rint(start + (station - start) * (walked / distance)).astype(int)
                    if not (0 <= x < labels.shape[1] and 0 <= y < labels.shape[0] and mask[y, x]):
                        break
                    if labels[y, x] not in (0, row + 1):
                        hidden += 1
                        break
            fractions[row, view] = hidden / max(tested, 1)
    return fractions


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), rays=st.integers(1, 30), step=st.integers(1, 3))
def test_hidden_fractions_agree_with_walking_ray_by_ray(seed: int, rays: int, step: int) -> None:
    rng = np.random.default_rng(seed)
    labels = np.zeros((30, 40), np.int32)
    for value in range(1, 5):
        y, x = rng.integers(0, 24), rng.integers(0, 34)
        labels[y : y + rng.integers(1, 7), x : x + rng.integers(1, 7)] = value
    values = np.unique(labels[labels > 0])
    labels = np.searchsorted(np.concatenate([[0], values]), labels).astype(np.int32)
    masks = [(rng.random(labels.shape) < 0.93) | (labels > 0) for _ in range(2)]
    stations = [rng.uniform(-30, 70, 2), rng.uniform(0, 30, 2)]  # outside the map and, maybe, on it
    found = hidden_fractions(labels, masks, stations, rays=rays, step=step)
    np.testing.assert_allclose(found, hidden_naive(labels, masks, stations, rays=rays, step=step))
    assert ((found >= 0) & (found <= 1)).all()


def planted(*boxes: tuple[int, int, int, int]) -> Array:
    labels = np.zeros((40, 100), np.int32)
    for value, (x0, x1, y0, y1) in enumerate(boxes, start=1):
        labels[y0:y1, x0:x1] = value
    return labels


WEST, EAST = (-40.0, 19.5), (140.0, 19.5)


def test_behind_another_is_hidden_beside_it_is_not() -> None:
    labels = planted((30, 40, 10, 30), (50, 55, 17, 22), (50, 55, 0, 5))  # front, behind it, beside it
    west, east = np.zeros_like(labels, bool), np.zeros_like(labels, bool)
    west[10:30, 30:60] = west[0:5, 50:58] = True  # the front's shadow reaches beyond the one behind
    east[10:30, 25:40] = east[17:22, 48:55] = east[0:5, 48:55] = True
    found = hidden_fractions(labels, [west, east], [WEST, EAST])
    assert found.tolist() == [[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]]


def test_floor_visible_in_between_means_that_the_object_is_plain() -> None:
    labels = planted((30, 40, 10, 30), (50, 55, 17, 22))
    low = labels > 0
    low[10:30, 30:45] = True  # the shadow ends five cells short of the second object
    assert hidden_fractions(labels, [low], [WEST]).tolist() == [[0.0], [0.0]]
    low[10:30, 30:50] = True
    assert hidden_fractions(labels, [low], [WEST]).tolist() == [[0.0], [1.0]]


def test_half_behind_is_half_hidden() -> None:
    labels = planted((30, 40, 0, 20), (50, 54, 14, 26))
    mask = np.zeros_like(labels, bool)
    mask[0:20, 30:60] = mask[14:26, 50:60] = True
    far_west = (-100_000.0, 19.5)  # parallel sight-lines
    found = hidden_fractions(labels, [mask], [far_west], rays=1000)
    assert found[1, 0] == pytest.approx(0.5)


def test_nothing_hides_an_object_alone_and_no_object_gives_no_rows() -> None:
    everything = np.ones((40, 100), bool)
    assert hidden_fractions(planted((30, 40, 10, 30)), [everything], [WEST]).tolist() == [[0.0]]
    assert hidden_fractions(planted(), [everything] * 2, [WEST, EAST]).shape == (0, 2)
    right_above = hidden_fractions(planted((30, 31, 10, 11)), [everything], [(30.0, 10.0)])
    assert right_above.tolist() == [[0.0]]  # the camera stands over the only cell: no NaN


def test_a_number_without_cells_is_hidden_nowhere() -> None:
    labels = planted((30, 40, 10, 30), (0, 0, 0, 0), (50, 55, 17, 22))
    found = hidden_fractions(labels, [np.ones((40, 100), bool)], [WEST])
    assert found.tolist() == [[0.0], [0.0], [1.0]]


def test_turning_the_scene_turns_the_answer() -> None:
    labels = planted((30, 40, 10, 30), (50, 55, 17, 22), (70, 80, 15, 25))
    mask = np.ones((40, 100), bool)
    there = hidden_fractions(labels, [mask], [WEST], rays=10_000)
    mirrored = hidden_fractions(labels[:, ::-1], [mask], [(99 - WEST[0], WEST[1])], rays=10_000)
    np.testing.assert_allclose(there, mirrored)
    assert there.tolist() == [[0.0], [1.0], [1.0]]


def test_hidden_fractions_leave_their_inputs_alone_and_want_a_station_a_view() -> None:
    labels = planted((30, 40, 10, 30), (50, 55, 17, 22))
    mask = np.ones((40, 100), bool)
    kept = labels.copy()
    hidden_fractions(labels, [mask], [WEST])
    np.testing.assert_array_equal(labels, kept)
    assert mask.all()
    with pytest.raises(ValueError):
        hidden_fractions(labels, [mask], [WEST, EAST])
