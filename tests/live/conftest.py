"""Keys for those who publish and those who listen."""

from __future__ import annotations

from pathlib import Path

import pytest

from occlib.live.broadcast import keygen


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of keys; ``good`` is in ``allowed/``, ``stranger`` is not."""
    folder = tmp_path_factory.mktemp("keys")
    for name in ("server", "good", "stranger"):
        keygen(folder, name)
    (folder / "allowed").mkdir()
    (folder / "allowed/good.key").write_bytes((folder / "good.key").read_bytes())
    return folder
