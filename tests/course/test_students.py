"""Student copies: no solution, stubs that run untouched, targets shown, a student's work kept."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest

from occlib.course import student_copies, student_copy

PNG = b"\x89PNG\r\n\x1a\n target"


def cell(kind: str, source: str, *tags: str) -> Any:
    made = getattr(nbformat.v4, f"new_{kind}_cell")(source)
    made.metadata["tags"] = list(tags)
    return made


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project of one chapter with one exercise, whose solution saves a figure."""
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures/nb01_exercise_1.png").write_bytes(PNG)
    master = nbformat.v4.new_notebook()
    master.cells = [
        cell("markdown", "# 01. A chapter"),
        cell("code", "seed = 0  # number, nothing", "parameters"),
        cell("code", "reproduce.record('x', 42)", "bookkeeping"),
        cell("markdown", "**01.1** (one line) What is it?", "exercise"),
        cell("code", 'secret = "forty-two"\nanswer_1 = 42\nreproduce.save(fig, "nb01_exercise_1")', "solution"),
        cell("markdown", "Because of forty-two.", "solution"),
        cell("code", 'course.check("01.1", answer_1)', "check"),
        cell("markdown", "## Try next"),
    ]
    master.cells[1].outputs = [nbformat.v4.new_output("stream", text="2")]
    nbformat.write(master, tmp_path / "notebooks/01_chapter.ipynb")
    return tmp_path


def copy_of(project: Path) -> Path:
    return project / "course/01_chapter.ipynb"


def test_no_solution_and_a_stub(project: Path) -> None:
    master = project / "notebooks/01_chapter.ipynb"
    before = master.read_bytes()
    assert student_copies(project / "course", root=project) == ([copy_of(project)], [])
    assert master.read_bytes() == before and "forty-two" not in copy_of(project).read_text()
    student = nbformat.read(copy_of(project), as_version=4)
    nbformat.validate(student)
    kinds = [(one.cell_type, one.metadata.get("tags", [])) for one in student.cells]
    assert kinds == [
        ("markdown", []),
        ("code", ["parameters"]),
        ("markdown", ["exercise"]),
        ("markdown", []),
        ("code", ["stub"]),
        ("code", ["check"]),
        ("markdown", []),
    ]
    assert student.cells[4].source.splitlines()[-1] == "answer_1 = None"
    assert student.cells[1].outputs == [] and "nb01_exercise_1.png" in student.cells[3].attachments


def test_work_is_kept(project: Path) -> None:
    student_copies(project / "course", root=project)
    student = nbformat.read(copy_of(project), as_version=4)
    nbformat.write(student, copy_of(project))  # opened and saved: nothing of the student's own
    assert student_copies(project / "course", root=project) == ([copy_of(project)], [])
    student.cells[4].source = "answer_1 = 41"
    nbformat.write(student, copy_of(project))
    assert student_copies(project / "course", root=project) == ([], [copy_of(project)])
    assert "answer_1 = 41" in copy_of(project).read_text()


def test_a_file_that_is_no_copy_is_kept(project: Path) -> None:
    copy_of(project).parent.mkdir()
    copy_of(project).write_text("notes")
    assert student_copies(project / "course", root=project) == ([], [copy_of(project)])
    assert copy_of(project).read_text() == "notes"


def test_the_command_says_what_it_kept(project: Path) -> None:
    command = [sys.executable, "-m", "occlib.course", str(project / "course")]
    first = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2], check=True)
    assert "student copies in" in first.stdout
    copy = next((project / "course").glob("00_*.ipynb"))
    copy.write_text(copy.read_text().replace("= None", "= 7", 1))
    again = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2], check=True)
    assert f"kept {copy}" in again.stdout and "= 7" in copy.read_text()


@pytest.mark.parametrize(("argument", "code"), [("--help", 0), ("--ledgr", 2), ("--version", 2)])
def test_an_option_is_no_folder(argument: str, code: int, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "occlib.course", argument]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert done.returncode == code and "usage:" in done.stdout + done.stderr
    assert not list(tmp_path.iterdir())


def test_bad_masters(project: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot read"):
        student_copy(project / "notebooks/99.ipynb", tmp_path / "x.ipynb")
    (project / "figures/nb01_exercise_1.png").unlink()
    with pytest.raises(ValueError, match=r"01\.1: its figure nb01_exercise_1\.png is not in"):
        student_copies(project / "course", root=project)
    master = nbformat.read(project / "notebooks/01_chapter.ipynb", as_version=4)
    del master.cells[6]
    nbformat.write(master, project / "notebooks/01_chapter.ipynb")
    with pytest.raises(ValueError, match="expected a check cell"):
        student_copies(project / "course", root=project)
