"""The ledger says what the paper says, names what is there, and its tables follow claims and metrics."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from occlib.course.ledger import (
    GENERATED,
    SECTIONS,
    VERDICTS,
    broken_references,
    claims_table,
    load_claims,
    markdown_table,
    measured_text,
    stale_files,
    verdict_counts,
    write_generated,
)
from occlib.formats import Claim

ROOT = Path(__file__).resolve().parents[2]
CLAIMS = load_claims(root=ROOT)
ENTRY = {
    "id": "the-one",
    "kind": "claim",
    "section": "7",
    "quotation": "it works",
    "metrics": ["08/recall"],
    "measured": "in {08/recall:.0%} of the frames",
    "evidence": ["rendered"],
    "verdict": "holds",
    "conditions": "Whole masks.",
    "would_change": "A miss.",
    "headline": True,
}


@pytest.fixture
def project(tmp_path: Path) -> Callable[..., Path]:
    """``project(entry, ...)``: a folder with these claims, two metrics, and the files that the tables go to."""

    def make(*entries: dict[str, Any]) -> Path:
        for name in ("notebooks", "docs", "figures"):
            (tmp_path / name).mkdir(exist_ok=True)
        (tmp_path / "docs/claims.yaml").write_text(yaml.safe_dump(list(entries or (ENTRY,))), encoding="utf-8")
        rows = "notebook,metric,value,unit,tolerance\n08_follow_objects,recall,0.164,,0.01\n"
        (tmp_path / "figures/metrics.csv").write_text(rows, encoding="utf-8")
        for name, block in GENERATED.items():
            text = f"# Title\n\n<!-- ledger: {block} -->\n<!-- end -->\n\nMore.\n"
            (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path

    return make


# --- the ledger that ships
def test_the_ledger_is_about_the_whole_paper() -> None:
    assert len(CLAIMS) >= 40
    assert {claim.section for claim in CLAIMS} == set(SECTIONS)
    figures = [claim for claim in CLAIMS if claim.kind == "figure"]
    assert len({claim.id.split("-")[1] for claim in figures}) == 11
    assert sum(claim.headline for claim in CLAIMS) == 5


def test_every_quotation_is_the_papers() -> None:
    paper = ROOT.parent / "shared" / "reference" / "paper.txt"
    if not paper.is_file():
        pytest.skip("the paper's text is not beside the repository")
    text = " ".join(paper.read_text(encoding="utf-8").split())
    assert [claim.id for claim in CLAIMS if " ".join(claim.quotation.split()) not in text] == []


def test_every_file_name_and_test_is_there() -> None:
    assert broken_references(CLAIMS, ROOT) == []


def test_what_can_be_measured_is_and_the_rest_says_why() -> None:
    for claim in CLAIMS:
        assert claim.metrics or claim.test or claim.verdict in ("cannot be judged", "the paper is silent"), claim.id
        assert claim.conditions.endswith(".") and claim.would_change.endswith("."), claim.id
        if claim.evidence == ["reading"] and not claim.test:
            assert claim.verdict == "cannot be judged", claim.id


def test_the_tables_in_readme_and_book_are_up_to_date() -> None:
    """If this fails: make ledger."""
    assert stale_files(ROOT) == []


# --- tables
def test_a_number_that_changes_makes_the_tables_stale(project: Callable[..., Path]) -> None:
    root = project()
    assert [path.name for path in write_generated(root)] == ["README.md", "ledger.md"]
    assert stale_files(root) == [] and write_generated(root) == []
    readme = (root / "README.md").read_text(encoding="utf-8")
    assert readme.startswith("# Title\n\n<!-- ledger: headline -->\n") and readme.endswith("<!-- end -->\n\nMore.\n")
    assert "in 16%<!--08/recall--> of the frames" in readme
    table = root / "figures/metrics.csv"
    table.write_text(table.read_text(encoding="utf-8").replace("0.164", "0.95"), encoding="utf-8")
    assert [path.name for path in stale_files(root)] == ["README.md", "ledger.md"]
    write_generated(root)
    assert "in 95%<!--08/recall--> of the frames" in (root / "README.md").read_text(encoding="utf-8")


def test_a_verdict_that_changes_makes_the_tables_stale(project: Callable[..., Path]) -> None:
    root = project()
    write_generated(root)
    (root / "docs/claims.yaml").write_text(yaml.safe_dump([{**ENTRY, "verdict": "partly"}]), encoding="utf-8")
    assert len(stale_files(root)) == 2


def test_headlines_are_few_and_all_is_all(project: Callable[..., Path]) -> None:
    root = project(ENTRY, {**ENTRY, "id": "another", "headline": False, "quotation": "a | b"})
    claims = load_claims(root=root)
    assert len(markdown_table(claims, "headline", root=root).splitlines()) == 3
    everything = markdown_table(claims, "all", root=root)
    assert "`the-one`" in everything and "`another`" in everything and "“a | b” (§7)" in everything
    assert (
        "(§7): **holds** (rendered)\n  - Measured: In 16%<!--08/recall--> of the frames.\n  - When: Whole masks.\n"
        in everything
    )
    assert "\n  - Would change it: A miss.\n" in everything
    assert "## §7 Conclusion" in everything and "## Abstract" not in everything
    with pytest.raises(ValueError, match="which: expected headline or all, got 'some'"):
        markdown_table(claims, "some", root=root)


def test_counts_by_hand(project: Callable[..., Path]) -> None:
    silent = {**ENTRY, "id": "silent", "kind": "ambiguity", "verdict": "the paper is silent", "evidence": ["reading"]}
    twice = {**ENTRY, "id": "twice", "evidence": ["geometry", "rendered"]}
    claims = load_claims(root=project(ENTRY, silent, twice))
    kinds = verdict_counts(claims)
    assert list(kinds.columns) == list(VERDICTS) and kinds.to_numpy().sum() == 3
    assert kinds.loc["claim", "holds"] == 2 and kinds.loc["ambiguity", "the paper is silent"] == 1
    evidence = verdict_counts(claims, by="evidence")
    assert evidence.to_numpy().sum() == 4 and evidence.loc["rendered", "holds"] == 2
    with pytest.raises(ValueError, match="by: expected one of kind, section, evidence, got 'year'"):
        verdict_counts(claims, by="year")


def test_the_table_for_the_notebook_has_a_row_an_entry(project: Callable[..., Path]) -> None:
    root = project()
    table = claims_table(load_claims(root=root), root=root)
    assert table.loc["the-one", "measured"] == "in 16% of the frames"
    assert table.loc["the-one", "the paper"] == "it works"


def test_a_number_of_the_run_that_goes_on_goes_first(
    project: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from occlib.reproduce import record

    root = project({**ENTRY, "metrics": ["13/new"], "measured": "{13/new:.1f}"})
    with pytest.raises(ValueError, match="nobody recorded 13/new"):
        load_claims(root=root)
    monkeypatch.setenv("OCCLIB_RUN_DIR", str(tmp_path / "13_judge_the_paper"))
    record("new", 2.5)
    assert claims_table(load_claims(root=root), root=root)["measured"].tolist() == ["2.5"]


def test_a_chapter_that_shows_the_ledger_is_run_again_when_it_changes(project: Callable[..., Path]) -> None:
    from occlib.reproduce.runner import plan_runs

    root = project()
    for name, text in (("13_with", "course.load_claims()"), ("14_without", "1 + 1")):
        cell = {"cell_type": "code", "source": [text], "metadata": {}, "outputs": []}
        (root / f"notebooks/{name}.ipynb").write_text(json.dumps({"cells": [cell]}), encoding="utf-8")
    before = [run.inputs for run in plan_runs(root, None, {})]
    table = root / "figures/metrics.csv"
    table.write_text(table.read_text(encoding="utf-8") + "13_with,own,1,,0\n", encoding="utf-8")
    assert [run.inputs for run in plan_runs(root, None, {})] == before
    (root / "docs/claims.yaml").write_text(yaml.safe_dump([{**ENTRY, "verdict": "partly"}]), encoding="utf-8")
    changed = [run.inputs != inputs for run, inputs in zip(plan_runs(root, None, {}), before, strict=True)]
    assert changed == [True, False]


# --- bad input
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"verdict": "true"}, "the-one.verdict: expected holds, holds under conditions, .*, got 'true'"),
        ({"kind": "rumour"}, "the-one.kind: expected claim, equation, .*, got 'rumour'"),
        ({"colour": "red"}, "the-one: expected the fields .*; missing or not known: 'colour'"),
        ({"evidence": []}, "the-one.evidence: expected a list of geometry, rendered, real and reading, got"),
        ({"evidence": ["hearsay"]}, "the-one.evidence: expected a list of geometry"),
        ({"section": "VII"}, "the-one.section: expected abstract, or a number"),
        ({"quotation": ""}, "the-one.quotation: expected a text, got ''"),
        ({"id": "Not Kebab"}, "Not Kebab.id: expected small letters joined by hyphens, got 'Not Kebab'"),
        ({"metrics": ["8/recall"]}, "the-one.metrics: expected a metric's key NN/name"),
        ({"metrics": []}, "measured: expected each of the metrics in braces, and no other; look at 08/recall"),
        ({"measured": ""}, "measured: expected each of the metrics in braces, and no other; look at 08/recall"),
        (
            {"metrics": ["08/precision"], "measured": "{08/precision:.2f}"},
            "the-one.metrics: nobody recorded 08/precision",
        ),
    ],
)
def test_a_bad_entry_is_named(project: Callable[..., Path], changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        load_claims(root=project({**ENTRY, **changes}))
    assert "claims.yaml" in str(caught.value) and "\n" not in str(caught.value)


def test_a_bad_file_is_named(project: Callable[..., Path]) -> None:
    with pytest.raises(ValueError, match="the-one: expected different ids, this one comes twice"):
        load_claims(root=project(ENTRY, ENTRY))
    root = project()
    for content, message in (("a: 1", "expected a list of entries"), ("- 5", "entry 0: expected the fields"), ("- [", "YAML")):  # fmt: skip
        (root / "docs/claims.yaml").write_text(content, encoding="utf-8")
        with pytest.raises(ValueError, match=message) as caught:
            load_claims(root=root)
        assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="cannot read"):
        load_claims(root / "nowhere.yaml", root=root)


def test_a_format_that_is_none_is_named(project: Callable[..., Path]) -> None:
    root = project({**ENTRY, "measured": "{08/recall:.2q}"})
    with pytest.raises(ValueError, match=r"the-one.measured: not a format of a number: '.2q'"):
        measured_text(load_claims(root=root)[0], {"08/recall": 1.0})


def test_a_file_without_its_block_is_named(project: Callable[..., Path]) -> None:
    root = project()
    (root / "README.md").write_text("# Title\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"README.md: expected a block from <!-- ledger: headline --> to <!-- end -->"):
        write_generated(root)


START, END = "<!-- ledger: headline -->\n", "<!-- end -->\n"


@pytest.mark.parametrize(
    ("readme", "message"),
    [
        (f"{START}old\n\nProse.\n\n<!-- other -->\n{END}", "expected <!-- end --> behind <!-- ledger: headline -->"),
        (f"{END}{START}old\n{END}", "expected no <!-- end --> before a block begins"),
        (f"{START}old\n{END}\nProse.\n\n{START}old\n{END}", "expected one block <!-- ledger: headline -->, found 2"),
    ],
)
def test_markers_that_do_not_pair_are_refused_and_nothing_is_written(
    project: Callable[..., Path], readme: str, message: str
) -> None:
    root = project()
    (root / "README.md").write_text(readme, encoding="utf-8")
    before = (root / "docs/ledger.md").read_bytes()
    with pytest.raises(ValueError, match=f"^README.md: {re.escape(message)}$"):
        write_generated(root)
    assert (root / "README.md").read_text(encoding="utf-8") == readme
    assert (root / "docs/ledger.md").read_bytes() == before


def test_an_entry_cannot_close_its_block(project: Callable[..., Path]) -> None:
    with pytest.raises(ValueError, match=r"docs/ledger.md: expected no <!-- end --> before"):
        write_generated(project({**ENTRY, "conditions": "always <!-- end -->"}))


def test_a_file_that_cannot_be_read_is_named(project: Callable[..., Path]) -> None:
    root = project()
    (root / "docs/ledger.md").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"ledger.md: not a text in UTF-8$"):
        write_generated(root)
    (root / "README.md").unlink()
    with pytest.raises(ValueError, match=r"README.md: cannot read \(No such file or directory\)$"):
        write_generated(root)


def test_what_an_entry_names_and_is_not_there_is_listed(project: Callable[..., Path]) -> None:
    root = project()
    shutil.copy(Path(__file__), root / "test_it.py")
    told = {key: value for key, value in ENTRY.items() if key != "headline"}
    good = {"implemented": ["docs", "occlib.course:check"], "test": ["test_it.py::test_counts_by_hand"]}
    bad = {
        "implemented": ["docs/nothing.md", "occlib.course:nobody", "occlib.nowhere:check"],
        "test": ["test_it.py::test_counts", "test_other.py::test_counts_by_hand"],
    }
    claims = [Claim(**{**told, "id": "good", **good}), Claim(**{**told, "id": "bad", **bad})]
    assert broken_references(claims, root) == [f"bad: {place}" for place in [*bad["implemented"], *bad["test"]]]
