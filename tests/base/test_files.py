"""Hashes say what changed; a staged folder removes what is to go only after everything else has come."""

from __future__ import annotations

import hashlib
import os
import signal
import sys
from pathlib import Path

import pytest

from occlib.base.files import file_hash, file_hashes, folder_hash, sha256, staged_folder, write_file


def test_hashes_name_every_file_below_a_folder(tmp_path: Path) -> None:
    for name in ("b.txt", "a/c.txt", "a/__pycache__/c.pyc"):
        write_file(tmp_path / name, name)
    expected = {name: hashlib.sha256(name.encode()).hexdigest() for name in ("a/c.txt", "b.txt")}
    assert file_hashes(tmp_path) == expected and list(file_hashes(tmp_path)) == ["a/c.txt", "b.txt"]
    assert file_hashes(tmp_path, "b.*") == {"b.txt": expected["b.txt"]}
    assert file_hash(tmp_path / "b.txt") == sha256("b.txt") == sha256(b"b.txt") == expected["b.txt"]
    assert file_hash(tmp_path / "gone.txt") == "" and file_hashes(tmp_path / "gone") == {}


def test_hash_of_a_folder_changes_with_names_and_contents(tmp_path: Path) -> None:
    write_file(tmp_path / "a.txt", "1")
    hashes = {folder_hash(tmp_path)}
    write_file(tmp_path / "a.txt", "2")
    hashes.add(folder_hash(tmp_path))
    (tmp_path / "a.txt").rename(tmp_path / "b.txt")
    hashes.add(folder_hash(tmp_path))
    write_file(tmp_path / "sub/a.txt", "2")
    hashes.add(folder_hash(tmp_path))
    assert len(hashes) == 4


def test_what_is_to_be_removed_goes_last_or_not_at_all(tmp_path: Path) -> None:
    for name in ("old.png", "kept.png"):
        write_file(tmp_path / name, "old")
    with pytest.raises(ValueError, match="no luck"), staged_folder(tmp_path, remove=["old.png"]) as stage:
        write_file(stage / "new.png", "new")
        raise ValueError("no luck")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kept.png", "old.png"]
    with staged_folder(tmp_path, remove=["old.png", "gone.png"]) as stage:
        write_file(stage / "new.png", "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kept.png", "new.png"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_no_interrupt_comes_between_files_that_move(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace, moved, interrupts = os.replace, list[str](), list[str]()

    def interrupted(source: Path, target: Path) -> None:
        if Path(target).parent == tmp_path:
            moved.append(Path(target).name)
            signal.raise_signal(signal.SIGINT)
        replace(source, target)

    monkeypatch.setattr("occlib.base.files.os.replace", interrupted)
    previous = signal.signal(signal.SIGINT, lambda *_: interrupts.append("came"))
    try:
        with staged_folder(tmp_path) as stage:
            write_file(stage / "a.txt", "a")
            write_file(stage / "b.txt", "b")
    finally:
        signal.signal(signal.SIGINT, previous)
    assert moved == ["a.txt", "b.txt"] and interrupts == []
