"""What an installed occlib needs and holds: a light import, extras that are named, a wheel that works anywhere."""

from __future__ import annotations

import ast
import importlib.metadata
import json
import os
import pkgutil
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import occlib
from occlib import recordings
from occlib.base import MissingExtraError, check_extra, import_extra, lazy_extra
from occlib.cli import main
from occlib.reproduce.runner import check_copy, find_root

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BEYOND_CORE = {
    *("IPython", "cyclonedds", "dask", "distributed", "drjit", "ipykernel", "ipywidgets", "joblib", "jupyterlab"),
    *("mitsuba", "pandas", "papermill", "pooch", "psutil", "pyoidn", "rosbags", "sklearn", "threadpoolctl", "zmq"),
}
MODULES = [m.name for m in pkgutil.walk_packages(occlib.__path__, "occlib.") if not m.name.endswith("__main__")]

# Put before a script: from then on nothing beyond the core can be imported, as in an environment without extras.
WITHOUT_EXTRAS = f"""
import sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {BEYOND_CORE!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hidden())
"""


def python(script: str, *arguments: object, cwd: Path | None = None, path: Path = ROOT) -> str:
    """What a script prints, in a process of its own with ``path`` in front of all other packages."""
    environment = {**os.environ, "PYTHONPATH": str(path), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-c", script, *map(str, arguments)]
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stderr
    return done.stdout


# --- imports -----------------------------------------------------------------------------------------------
@pytest.mark.slow
@pytest.mark.parametrize(
    "script, heavy",
    [
        ("import occlib", "cv2 numba numpy matplotlib pandas scipy skimage yaml"),
        (
            "from occlib.cli import build_parser; build_parser().format_help()",
            "cv2 numba numpy matplotlib pandas scipy",
        ),
        ("import occlib.pipeline", "matplotlib pandas skimage scipy.stats zmq"),
        ("import occlib.study, occlib.lab, occlib.live", "pandas scipy.stats matplotlib.pyplot zmq sklearn"),
    ],
)
def test_an_import_waits_for_nothing_heavy(script: str, heavy: str) -> None:
    loaded = python(f"{script}\nimport sys; print(*(name for name in {heavy.split()} if name in sys.modules))")
    assert loaded.split() == []


def test_the_map_of_the_house_names_every_room() -> None:
    named = re.findall(r"^    ([a-z_]+) {2,}\S", str(occlib.__doc__), re.MULTILINE)
    rooms = [name.removeprefix("occlib.") for name in MODULES if name.count(".") == 1]
    assert sorted(named) == sorted(rooms)


def test_names_load_when_used() -> None:
    from occlib.pipeline import Pipeline

    assert occlib.Pipeline is Pipeline and {"Pipeline", "find", "fuse", "lab"} <= set(dir(occlib))
    for name in occlib.__all__:
        assert getattr(occlib, name) is not None
    with pytest.raises(AttributeError, match="pipe_line"):
        occlib.pipe_line  # noqa: B018


@pytest.mark.slow
def test_every_module_can_be_imported_with_the_core_alone() -> None:
    python(f"{WITHOUT_EXTRAS}\nimport importlib\nfor name in {MODULES!r}:\n    importlib.import_module(name)")


# --- extras ------------------------------------------------------------------------------------------------
def test_import_extra_names_the_extra_and_tells_absent_from_broken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hide_package: Callable[[str], None]
) -> None:
    (tmp_path / "broken_package.py").write_text("import numpy.nowhere")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(MissingExtraError, match=r'^needs the extra live: pip install "occlib\[live\]" \(No module'):
        import_extra("broken_package", "live")
    assert lazy_extra("json", "live").dumps([1]) == "[1]"
    hide_package("zmq")
    absent = lazy_extra("zmq.auth", "live")
    for use in (lambda: absent.load_certificate, lambda: check_extra("zmq", "live")):
        with pytest.raises(MissingExtraError, match=r'^needs the extra live: pip install "occlib\[live\]"$') as caught:
            use()
        assert isinstance(caught.value, ImportError) and isinstance(caught.value, ValueError)


@pytest.mark.parametrize(
    "package, extra, command",
    [
        ("zmq", "live", "listen --count 1"),
        ("zmq", "live", "broadcast {recording} --profile and --cameras left"),
        ("rosbags", "ros", "run {recording} --out {out} --bag mcap"),
        ("cyclonedds", "ros2", "broadcast {recording} --profile and --cameras left --address tcp://127.0.0.1:* --ros2"),
        ("joblib", "study", "sweep --fast --out {out}"),
        ("pandas", "study", "sweep --fast --out {out}"),
        ("distributed", "dask", "sweep --fast --scheduler tcp://127.0.0.1:1 --out {out}"),
        ("mitsuba", "render", "render robot --frames 0 --out {out}"),
        ("pyoidn", "render", "render robot --frames 0 --out {out}"),
        ("papermill", "notebooks", "reproduce 00"),
    ],
)
def test_a_missing_extra_is_one_line_that_names_it(
    package: str, extra: str, command: str, tiny_recording: Path, tmp_path: Path,
    hide_package: Callable[[str], None], capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    hide_package(package)
    arguments = command.format(recording=tiny_recording, out=tmp_path / "out").split()
    assert main(arguments) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("occlib ")]
    assert lines == [f'occlib {arguments[0]}: needs the extra {extra}: pip install "occlib[{extra}]"']
    assert not (tmp_path / "out").exists()


def distributions(extra: str) -> set[str]:
    """The distributions that an extra brings, those of other extras that it names included."""
    found: set[str] = set()
    for requirement in PROJECT["optional-dependencies"][extra]:
        name, _, others = re.match(r"([\w.-]+)(\[(.*?)\])?", requirement).groups()  # type: ignore[union-attr]
        found |= {name.lower()} if name != "occlib" else set().union(*map(distributions, others.split(",")))
    return found


def test_each_extra_that_the_code_names_brings_the_package() -> None:
    brought_by = importlib.metadata.packages_distributions()
    named = set()
    for path in (ROOT / "occlib").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in (
                "import_extra",
                "lazy_extra",
                "check_extra",
            ):
                package, extra = (
                    argument.value if isinstance(argument, ast.Constant) else "" for argument in node.args
                )
                if extra:  # but in base.extras itself, both are literals
                    named.add((package.partition(".")[0], extra))
    assert {extra for _, extra in named} == {"study", "live", "ros", "ros2", "dask", "render", "notebooks", "book"}
    for package, extra in named:
        if package in brought_by and package not in ("drjit", "traitlets"):  # mitsuba and anywidget bring them
            assert {name.lower() for name in brought_by[package]} & distributions(extra), (package, extra)


def test_all_is_all() -> None:
    everything = set().union(*(distributions(extra) for extra in PROJECT["optional-dependencies"] if extra != "all"))
    assert distributions("all") == everything
    locked = {line.partition("==")[0] for line in (ROOT / "requirements.lock").read_text().splitlines()}
    core = {re.match(r"[\w-]+", requirement).group().lower() for requirement in PROJECT["dependencies"]}  # type: ignore[union-attr]
    assert everything | core <= locked


# --- wheel and sdist ---------------------------------------------------------------------------------------
def build(target: str, source: Path, out: Path) -> Path:
    """Build with the backend that pip uses, without the network."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", target, "-d", str(out)]
    subprocess.run(command, cwd=source, check=True, capture_output=True, timeout=60)
    (built,) = out.glob("*.whl" if target == "wheel" else "*.tar.gz")
    return built


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("sdist", ROOT, tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made from the unpacked sdist, as a packager would."""
    folder = tmp_path_factory.mktemp("wheel")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (source,) = folder.iterdir()
    return build("wheel", source, folder / "dist")


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel in a folder far from the checkout."""
    target = tmp_path_factory.mktemp("site")
    options = ["--no-deps", "--no-index", "--no-compile", "--disable-pip-version-check", "--quiet"]
    subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, "--target", target, wheel], check=True, timeout=60
    )
    return target


OWN_DATA = {"sources.yaml", "ufes-lab/rig.yaml", "ufes-lab/floor_marks.yaml", "ufes-lab/truth.json"}


def test_the_sdist_holds_the_package_and_no_data_or_tests(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
        size = sum(member.size for member in archive.getmembers())
    assert {"LICENSE", "README.md", "pyproject.toml", "occlib/py.typed"} <= names
    assert {name.partition("/")[0] for name in names if "/" in name} == {"occlib"}
    assert size < 2_000_000


def test_the_wheel_holds_every_module_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
        extra = {name.partition(".dist-info/")[2] for name in archive.namelist()} - {""}
    modules = {path.relative_to(ROOT).as_posix() for path in (ROOT / "occlib").rglob("*.py")}
    others = {"occlib/py.typed", "occlib/course/explorable/explorable.js"}
    assert names == modules | others | {f"occlib/data/{name}" for name in OWN_DATA}
    assert {"METADATA", "entry_points.txt", "licenses/LICENSE"} <= extra


COMMANDS = f"""
{WITHOUT_EXTRAS}
import contextlib, io, json
from pathlib import Path
import occlib
from occlib.cli import main

def run(*arguments):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(arguments)
    return status, out.getvalue(), err.getvalue()

boards = sorted(map(str, Path("boards").iterdir()))
results = {{
    "where": [0, str(Path(occlib.__file__).parent), ""],
    "run": run("run", "recording", "--out", "results"),
    "evaluate": run("evaluate", "results/objects.jsonl", "recording/truth.json", "--json"),
    "compare": run("compare", "image.png", "template.png"),
    "compare --json": run("compare", "image.png", "template.png", "--methods", "zncc", "--json"),
    "calibrate": run("calibrate", *boards, "--pattern", "9x6", "--square", "0.025", "--out", "camera.yaml"),
    "data list": run("data", "list"),
    "data verify": run("data", "verify"),
    "run four_robots": run("run", "four_robots", "--out", "out"),
    "broadcast robot": run("broadcast", "robot"),
    "render robot": run("render", "robot", "--out", "out"),
}}
print(json.dumps(results))
"""


def share_compiled(target: Path) -> None:
    """Give an installed copy what numba has compiled for the checkout: the same code, and half a minute less."""
    for path in (ROOT / "occlib").rglob("*.nb[ic]"):
        copy = target / path.relative_to(ROOT)
        copy.parent.mkdir(exist_ok=True)
        shutil.copyfile(path, copy)


@pytest.mark.slow
@pytest.mark.timeout(300)  # s: where nothing is compiled yet
def test_the_wheel_works_on_folders_of_ones_own(installed: Path, tiny_recording: Path, tmp_path: Path) -> None:
    """In a folder outside the checkout and with the core dependencies alone, as in the checkout with all of them."""
    assert main(["run", str(tiny_recording), "--out", str(tmp_path / "results")]) == 0
    share_compiled(installed)
    home = tmp_path / "home"
    home.mkdir()
    shutil.copytree(tiny_recording, home / "recording")
    (home / "boards").mkdir()
    for path in sorted((ROOT / "data/lab/calibration/frames/left").iterdir())[:6]:
        shutil.copyfile(path, home / "boards" / path.name)
    image = np.random.default_rng(0).integers(0, 256, (90, 120), np.uint8)
    cv2.imwrite(str(home / "image.png"), image)
    cv2.imwrite(str(home / "template.png"), image[20:40, 50:80])
    results: dict[str, Any] = json.loads(python(COMMANDS, cwd=home, path=installed))

    assert results["where"][1] == str(installed / "occlib")
    failed = {name for name, (status, _, _) in results.items() if status}
    assert failed == {"data verify", "run four_robots", "broadcast robot", "render robot"}, results
    objects = (home / "results/objects.jsonl").read_text(encoding="utf-8")
    assert [len(json.loads(line)["objects"]) for line in objects.splitlines()] == [2] * 5
    assert objects == (tmp_path / "results/objects.jsonl").read_text(encoding="utf-8")
    assert {path.name for path in (home / "results").iterdir()} >= {"map.pgm", "map.yaml", "overview.png"}
    assert json.loads(results["evaluate"][1])["moda"] == 1
    assert results["compare"][1].splitlines()[2].split()[:4] == ["ssd", "0", "50", "20"]
    assert json.loads(results["compare --json"][1])["zncc"]["x"] == 50 and (home / "compare.png").is_file()
    assert "rms_px" in (home / "camera.yaml").read_text(encoding="utf-8")
    assert {line.partition(":")[0] for line in results["data list"][1].splitlines()} >= {"ufes-lab"}
    for name in failed:
        assert "data/lab ships with the repository, not with the package: run this in" in results[name][2], name
        assert results[name][2].count("\n") == 1


@pytest.mark.slow
def test_a_copy_finds_the_recordings_from_inside_the_repository(
    installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after ``pip install .`` in the checkout: the copy has no data, but the current folder has."""
    script = (
        "from occlib.recordings import DATA, LAB; print(LAB, LAB.is_dir(), *sorted(p.name for p in DATA.iterdir()))"
    )
    here, packaged = tmp_path.resolve(), "sources.yaml ufes-lab\n"
    assert python(script, cwd=ROOT / "notebooks", path=installed) == f"{ROOT / 'data/lab'} True {packaged}"
    assert python(script, cwd=here, path=installed) == f"{here / 'data/lab'} False {packaged}"
    monkeypatch.chdir(tmp_path)
    assert recordings.lab_folder() == ROOT / "data/lab" and find_root() == ROOT  # the checkout that the tests are in
    monkeypatch.setenv("OCCLIB_LAB", str(here))
    assert recordings.lab_folder() == here


def test_a_copy_that_differs_reproduces_nothing(tmp_path: Path) -> None:
    """Who edits the checkout while a copy of it runs would get the figures of the copy."""
    shutil.copytree(ROOT / "occlib", tmp_path / "occlib", ignore=shutil.ignore_patterns("__pycache__"))
    check_copy(tmp_path)
    check_copy(ROOT)
    (tmp_path / "occlib/pipeline.py").write_text("")
    with pytest.raises(
        ValueError, match=rf"^occlib runs from .*, a copy that differs from {tmp_path}/occlib; first: pip"
    ):
        check_copy(tmp_path)


@pytest.mark.parametrize(
    "variables, expected",
    [
        ({"OCCLIB_CACHE": "/own"}, "/own"),
        ({"XDG_CACHE_HOME": "/xdg"}, "/xdg/occlib"),
        ({"HOME": "/home/me"}, "/home/me/.cache/occlib"),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="each system has its own place")
def test_where_fetched_recordings_are_kept(
    variables: dict[str, str], expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("OCCLIB_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert recordings.cache_folder() == Path(expected)
