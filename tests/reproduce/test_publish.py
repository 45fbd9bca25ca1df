"""The notebook runner, on tiny notebooks in a project of their own."""

from __future__ import annotations

import base64
import csv
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import lazy_loader
import matplotlib.figure
import numpy as np
import psutil
import pytest
from PIL import Image, PngImagePlugin

from occlib.base import files
from occlib.plotting import figure_png
from occlib.reproduce import agreement, publish, runner
from occlib.reproduce import notebook as notebook_module
from occlib.reproduce.agreement import row_stays
from occlib.reproduce.notebook import record, save
from occlib.reproduce.publish import reproduce

nbformat = lazy_loader.load("nbformat")  # it takes a second, and these tests are slow ones
pytestmark = pytest.mark.slow

IMPORTS = "from matplotlib.figure import Figure\nfrom occlib.reproduce import record, save\nimport numpy as np"
PARAMETERS = "seed = 0  # -, of the noise\nfast = False  # -, smaller\nscale = 1.5  # m, of everything"
DRAW = "fig = Figure()\nfig.add_subplot().plot(np.random.default_rng(seed).normal(size=9))\nsave(fig, {name!r})"
MEASURE = "record('mean', scale * np.random.default_rng(seed).normal(size=9).mean(), unit='m', tolerance=0.01)"


def write_notebook(project: Path, name: str, *cells: str, parameters: str | None = PARAMETERS) -> Path:
    notebook = nbformat.v4.new_notebook()
    notebook.cells = [nbformat.v4.new_markdown_cell("# A title"), nbformat.v4.new_code_cell(IMPORTS)]
    if parameters is not None:
        notebook.cells.append(nbformat.v4.new_code_cell(parameters, metadata={"tags": ["parameters"]}))
    notebook.cells += [nbformat.v4.new_code_cell(cell) for cell in cells]
    path = project / "notebooks" / f"{name}.ipynb"
    nbformat.write(notebook, path)
    return path


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones too."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def run(project: Path, *notebooks: str, **options: object) -> publish.Report:
    return reproduce(notebooks or None, root=project, progress=False, **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module", autouse=True)
def package_hash() -> Iterator[None]:
    """The same all along, whoever saves a module of the package while these tests run."""
    package, folder_hash = runner.PACKAGE, files.folder_hash
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "folder_hash", lambda folder: "0" if folder == package else folder_hash(folder))
        yield


@pytest.fixture
def project(tmp_path: Path) -> Path:
    (tmp_path / "notebooks").mkdir()
    return tmp_path


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project after a first ``reproduce --jobs 2``; tests work on copies."""
    project = tmp_path_factory.mktemp("finished")
    (project / "notebooks").mkdir()
    write_notebook(project, "01_draw", DRAW.format(name="fig01"), MEASURE)
    write_notebook(project, "02_count", DRAW.format(name="fig02"), "record('count', 3)", MEASURE)
    report = run(project, jobs=2)
    assert [item.skipped for item in report.runs] == [False, False]
    return project


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished, tmp_path / "copy"))


# --- a run


def test_results_are_published_and_described(finished: Path) -> None:
    assert sorted(contents(finished / "figures")) == ["fig01.png", "fig02.png", "metrics.csv"]
    mean = 1.5 * np.random.default_rng(0).normal(size=9).mean()
    expected = ["01_draw,mean,{0},m,0.01", "02_count,count,3,,0", "02_count,mean,{0},m,0.01"]
    lines = (finished / "figures/metrics.csv").read_text().splitlines()
    assert lines == ["notebook,metric,value,unit,tolerance", *(line.format(f"{mean:.10g}") for line in expected)]
    with Image.open(finished / "figures/fig01.png") as image:
        assert image.info["Source"] == "01_draw" and "Software" not in image.info
    manifest = json.loads((finished / "runs/01_draw/manifest.json").read_text())
    assert manifest["inputs"]["parameters"] == {"seed": 0, "fast": False, "scale": 1.5}
    assert {"python", "cv2", "numpy", "occlib", "papermill"} <= set(manifest["inputs"]["versions"])
    assert set(manifest["files"]) == {"01_draw.ipynb", "fig01.png"} and manifest["seconds"] > 0
    executed = nbformat.read(finished / "runs/01_draw/01_draw.ipynb", as_version=4)
    assert executed.cells[-1].execution_count == 4


def test_nothing_runs_when_nothing_changed(copy: Path, finished: Path) -> None:
    # The manifest does not name the project's folder, so the copy is as current as the original.
    before, started = contents(copy), time.monotonic()
    report = run(copy)
    assert all(item.skipped for item in report.runs) and "2 unchanged" in str(report)
    assert time.monotonic() - started < 5 and contents(copy) == before


def test_again_one_after_the_other_gives_the_same_bytes(copy: Path, finished: Path) -> None:
    report = run(copy, jobs=1, force=True)
    assert not any(item.skipped for item in report.runs)
    assert contents(copy / "figures") == contents(finished / "figures")


@pytest.mark.parametrize("change", ["notebook", "output", "data", "package"])
def test_what_changed_is_not_current(copy: Path, change: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = runner.plan_runs(copy, None, {})
    assert all(runner.is_current(item) for item in plan)
    stale = {"01_draw", "02_count"}
    if change == "notebook":
        path, stale = copy / "notebooks/01_draw.ipynb", {"01_draw"}
        path.write_text(path.read_text().replace("A title", "Another title"))
    elif change == "output":
        (copy / "runs/01_draw/fig01.png").write_bytes(b"cut off")
        stale = {"01_draw"}
    elif change == "data":
        (copy / "data/lab").mkdir(parents=True)
        (copy / "data/lab/manifest.json").write_text("{}")
    else:
        (copy / "package").mkdir()
        (copy / "package/matching.py").write_text("")
        monkeypatch.setattr(runner, "PACKAGE", copy / "package")
    plan = runner.plan_runs(copy, None, {})
    assert {item.notebook for item in plan if not runner.is_current(item)} == stale


def test_changed_notebook_runs_again_and_its_old_figure_goes(copy: Path) -> None:
    others = {name: content for name, content in contents(copy / "figures").items() if name == "fig02.png"}
    (copy / "figures/hero.png").write_bytes(b"not made by a notebook")
    write_notebook(copy, "01_draw", DRAW.format(name="fig01_new"), "record('mean', 2.5, unit='m')")
    report = run(copy)
    assert [item.skipped for item in report.runs] == [False, True]
    assert sorted(contents(copy / "figures")) == ["fig01_new.png", "fig02.png", "hero.png", "metrics.csv"]
    assert others.items() <= contents(copy / "figures").items()
    assert "01_draw,mean,2.5,m,2.5e-06\n02_count,count" in (copy / "figures/metrics.csv").read_text()


def test_selected_notebook_leaves_the_rows_and_figures_of_others(copy: Path) -> None:
    before = contents(copy / "figures")
    (copy / "figures/fig01.png").unlink()
    assert len(run(copy, "01").runs) == 1
    assert contents(copy / "figures") == before


def test_notebook_is_alone_with_one_thread(project: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The interpreter is this one, the folder is empty, the user's kernels and matplotlibrc are not seen."""
    kernel = tmp_path / "user/kernels/python3/kernel.json"
    kernel.parent.mkdir(parents=True)
    kernel.write_text(json.dumps({"argv": ["false"], "display_name": "broken", "language": "python"}))
    (tmp_path / "matplotlibrc").write_text("lines.linewidth: 77\n")
    monkeypatch.setenv("JUPYTER_PATH", str(tmp_path / "user"))
    monkeypatch.setenv("MATPLOTLIBRC", str(tmp_path / "matplotlibrc"))
    lines = [
        "import sys, os, cv2, matplotlib",
        f"record('interpreter', sys.executable == {sys.executable!r})",
        "record('files', len([name for name in os.listdir() if name != 'matplotlibrc']))",
        "record('threads', cv2.getNumThreads())",
        "record('width', matplotlib.rcParams['lines.linewidth'])",
        "record('seed', seed)",
        "record('scale', scale)",
    ]
    path = write_notebook(project, "05_alone", "\n".join(lines))
    content = json.loads(path.read_text())
    content["metadata"] = {}  # no kernelspec: papermill alone would refuse the parameters
    path.write_text(json.dumps(content))
    table = run(project, str(path), parameters={"seed": "7", "scale": 2}).metrics()
    results = dict(zip(table["metric"], table["value"], strict=True))
    assert results == {"interpreter": 1, "files": 0, "threads": 1, "width": 1.5, "seed": 7, "scale": 2}
    assert not (project / "figures").exists()
    assert [folder.name[:10] for folder in (project / "runs").iterdir()] == ["05_alone__"]


def test_the_picture_of_a_slider_is_an_output_of_its_cell(project: Path) -> None:
    """Not one that only the widget holds: with widgets answered, the runner sometimes waited for ever."""
    slide = (
        "from matplotlib import pyplot as plt\nfrom ipywidgets import interact\ninteract(lambda x: plt.plot([x]), x=3)"
    )
    write_notebook(project, "01_slide", slide + "\nplt.show()", MEASURE, parameters=PARAMETERS)
    executed = json.loads((run(project).runs[0].folder / "01_slide.ipynb").read_text())
    (cell,) = (cell for cell in executed["cells"] if "interact" in "".join(cell["source"]))
    assert [output for output in cell["outputs"] if "image/png" in output.get("data", {})]


def test_fast_is_not_published(copy: Path) -> None:
    before = contents(copy / "figures")
    write_notebook(copy, "01_draw", "record('fast', fast)")
    report = run(copy, "01_draw", fast=True)
    assert list(report.metrics()["value"]) == [1.0]
    assert "runs/01_draw__fast" in str(report) and "figures/ is as it was" in str(report)
    assert contents(copy / "figures") == before


# --- what is refused


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"sed": 1}, r"^01_draw: no parameter 'sed'; it has seed, fast, scale$"),
        ({"seed": "two"}, r"^01_draw: parameter seed: expected int, got 'two'$"),
        ({"seed": 1.5}, "parameter seed: expected int, got 1.5"),
        ({"seed": True}, "parameter seed: expected int, got True"),
        ({"fast": "1"}, "parameter fast: expected bool, got '1'"),
        ({"scale": "big"}, "parameter scale: expected float, got 'big'"),
    ],
)
def test_wrong_parameter(finished: Path, parameters: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        run(finished, parameters=parameters)


def test_parameters_are_typed_by_their_defaults() -> None:
    defaults = {"seed": 0, "fast": False, "scale": 1.5, "method": "ssd"}
    given = {"seed": "3", "fast": "true", "scale": "2", "method": "5"}
    checked = runner.override("n", defaults, given)
    assert checked == {"seed": 3, "fast": True, "scale": 2.0, "method": "5"}
    assert type(checked["scale"]) is float


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"notebooks": ["07"]}, "notebook '07': expected one of 01_draw, 02_count"),
        ({"notebooks": ["/elsewhere/01.ipynb"]}, "expected one of 01_draw"),
        ({"notebooks": []}, "no notebooks to run"),
        ({"jobs": 0}, "jobs: expected a whole number >= 1, got 0"),
        ({"check": True, "fast": True}, "check: the committed metrics are those of the default parameters"),
    ],
)
def test_wrong_option(finished: Path, options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        reproduce(root=finished, progress=False, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("text", ["{", "[]", '{"cells": 3}'])
def test_not_a_notebook(project: Path, text: str) -> None:
    (project / "notebooks/01_x.ipynb").write_text(text)
    with pytest.raises(ValueError, match=r"01_x.ipynb: not (valid JSON|a notebook)"):
        run(project)


@pytest.mark.parametrize("line", ["seed = rng()", "seed = [1]", "seed ="])
def test_parameters_are_plain_values(project: Path, line: str) -> None:
    write_notebook(project, "01_x", parameters=line)
    with pytest.raises(ValueError, match="01_x: parameters cell: expected lines like"):
        run(project)


def test_two_notebooks_may_not_make_the_same_figure(copy: Path) -> None:
    before = contents(copy / "figures")
    write_notebook(copy, "03_other", DRAW.format(name="fig02"))
    with pytest.raises(ValueError, match=r"figure fig02.png: both 02_count and 03_other make it"):
        run(copy, "03")
    assert contents(copy / "figures") == before


# --- failure and interruption


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        (
            "# Figure 1\n1 / 0",
            r"^02_count: cell 3 \(# Figure 1\) failed: ZeroDivisionError: division by zero; see runs",
        ),
        ("for", r"^02_count: cell 3 \(for\) failed: SyntaxError: invalid syntax.*; see runs"),
        ("import os\nos._exit(3)", r"^02_count: cell 3 stopped: .*Kernel died"),
    ],
    ids=["error", "syntax", "dead"],
)
def test_failed_cell_is_named_and_nothing_is_published(copy: Path, cell: str, message: str) -> None:
    write_notebook(copy, "02_count", cell)
    before = contents(copy / "figures")
    with pytest.raises(ValueError, match=message) as caught:
        run(copy, "02_count")
    assert "\n" not in str(caught.value)
    assert contents(copy / "figures") == before
    assert "execution_count" in (copy / "runs/02_count/failed.ipynb").read_text()
    assert (copy / "runs/02_count/fig02.png").exists(), "the last good results were lost"


def test_what_succeeds_beside_a_failure_is_kept_but_not_published(copy: Path) -> None:
    write_notebook(copy, "01_draw", "import time; time.sleep(3)", DRAW.format(name="fig01_new"))
    write_notebook(copy, "02_count", "1 / 0")
    write_notebook(copy, "03_later", "1 + 1")
    before = contents(copy / "figures")
    with pytest.raises(ValueError, match="02_count: cell 3"):
        run(copy, jobs=2)
    assert (copy / "runs/01_draw/fig01_new.png").exists() and not (copy / "runs/03_later").exists()
    assert contents(copy / "figures") == before


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_run_leaves_nothing(copy: Path, sign: signal.Signals) -> None:
    started = copy / "started"
    write_notebook(copy, "01_draw", f"import pathlib, time\npathlib.Path({str(started)!r}).touch()\ntime.sleep(60)")
    before = {**contents(copy), "started": b""}
    code = f"from occlib.reproduce import reproduce; reproduce(root={str(copy)!r}, progress=False)"
    environment = {**os.environ, "PYTHONPATH": str(runner.PACKAGE.parent), "TMPDIR": str(copy)}
    process = subprocess.Popen([sys.executable, "-c", code], env=environment, stderr=subprocess.PIPE)
    try:
        _wait(started.exists)
        children = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(sign)
        _, errors = process.communicate(timeout=10)
    finally:
        process.kill()
        process.wait()
    assert process.returncode and b"KeyboardInterrupt" in errors
    # At once: a kernel whose parent is gone ends by itself too, but up to a second later.
    assert len(children) >= 2 and not any(map(_lives, psutil.wait_procs(children, timeout=0.2)[1]))
    assert contents(copy) == before


def _lives(process: psutil.Process) -> bool:
    try:
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


def _wait(condition: Callable[[], bool], seconds: float = 30) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_figures_are_written_aside_first(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that fills up in the middle of publishing leaves the committed figures as they were."""
    before = contents(copy / "figures")
    runs = run(copy).runs
    for item in runs:
        item.manifest["metrics"] = []
        name = next(name for name in item.manifest["files"] if name.endswith(".png"))
        (item.folder / name).write_bytes(b"changed")
    write_file = files.write_file

    def full(path: Path, content: bytes) -> Path:
        if path.name == "metrics.csv":
            raise ValueError(f"{path}: cannot write (No space left on device)")
        return write_file(path, content)

    monkeypatch.setattr(publish, "write_file", full)
    with pytest.raises(ValueError, match="No space left"):
        publish._publish(copy, runs)
    assert contents(copy / "figures") == before
    monkeypatch.undo()
    assert publish._publish(copy, runs) == ["fig01.png", "fig02.png", "metrics.csv"]


def test_results_folder_that_cannot_be_written(project: Path) -> None:
    write_notebook(project, "01_x", "record('x', 1)")
    (project / "runs").write_text("a file in the way")
    with pytest.raises(ValueError, match=r"runs.01_x: cannot write") as caught:
        run(project)
    assert "\n" not in str(caught.value) and not (project / "figures").exists()


# --- what agrees stays as it is committed


def change_metric(project: Path, difference: float, column: int = 2) -> bytes:
    """Change a column of the first published row as another machine would have it; the table's new bytes."""
    path = project / "figures/metrics.csv"
    rows = list(csv.reader(path.read_text().splitlines()))
    rows[1][column] = f"{float(rows[1][column]) + difference:.10g}"
    path.write_text("".join(",".join(row) + "\n" for row in rows))
    return path.read_bytes()


@pytest.mark.parametrize("difference", [1e-9, -0.0099])
def test_metric_within_its_tolerance_stays(copy: Path, difference: float) -> None:
    committed = change_metric(copy, difference)
    assert "nothing changed" in str(run(copy))
    assert (copy / "figures/metrics.csv").read_bytes() == committed


@pytest.mark.parametrize(
    ("difference", "column"), [(0.0101, 2), (-1.0, 2), (0.02, 4)], ids=["little", "much", "tolerance"]
)
def test_metric_out_of_its_tolerance_and_a_new_tolerance_are_published(
    copy: Path, finished: Path, difference: float, column: int
) -> None:
    change_metric(copy, difference, column)
    assert "figures/: metrics.csv changed" in str(run(copy))
    assert (copy / "figures/metrics.csv").read_bytes() == (finished / "figures/metrics.csv").read_bytes()


def test_default_tolerances_differ_in_the_last_digits_too() -> None:
    row = {"notebook": "01_x", "metric": "a", "value": "1.026315789", "unit": "m", "tolerance": "1.026315789e-06"}
    assert row_stays(row, row | {"value": "1.026315790", "tolerance": "1.026315790e-06"})
    assert not row_stays(row, row | {"value": "1.026317"}) and not row_stays(row, row | {"unit": "cm"})
    seconds = row | {"tolerance": "inf"}
    assert row_stays(seconds | {"value": "3"}, seconds) and not row_stays(seconds, row)


def repaint(project: Path, change: Callable[[Any], None], source: str = "01_draw") -> bytes:
    """Replace a published figure by what another machine, or another drawing, might have made; its new bytes."""
    path = project / "figures/fig01.png"
    pixels = np.array(Image.open(path))
    change(pixels)
    information = PngImagePlugin.PngInfo()
    information.add_text("Source", source)
    information.add_text("Software", "another")
    Image.fromarray(pixels).save(path, pnginfo=information, compress_level=1)
    return path.read_bytes()


def shade_an_edge(pixels: Any) -> None:
    pixels[100:104, 100:150, :3] = np.clip(pixels[100:104, 100:150, :3].astype(int) - 16, 0, 255)


def move_a_dot(pixels: Any) -> None:
    pixels[100:102, 100:104, :3] = 0


@pytest.mark.parametrize("change", [lambda pixels: None, shade_an_edge, move_a_dot], ids=["bytes", "shades", "a dot"])
def test_figure_that_looks_the_same_stays(copy: Path, change: Callable[[Any], None]) -> None:
    committed = repaint(copy, change)
    assert "nothing changed" in str(run(copy))
    assert (copy / "figures/fig01.png").read_bytes() == committed


def another_digit(pixels: Any) -> None:
    pixels[100:106, 100:105, :3] = 0  # 30 px


def a_paler_panel(pixels: Any) -> None:
    panel = pixels[:50, :100, :3]  # 2 % of the picture
    panel[panel == 255] = 250


@pytest.mark.parametrize("change", [another_digit, a_paler_panel], ids=["digit", "colour"])
def test_figure_that_looks_different_is_published(copy: Path, finished: Path, change: Callable[[Any], None]) -> None:
    repaint(copy, change)
    assert "figures/: fig01.png changed" in str(run(copy))
    assert contents(copy / "figures") == contents(finished / "figures")


def test_figure_of_another_notebook_size_or_format_is_published(copy: Path, finished: Path) -> None:
    repaint(copy, lambda pixels: None, source="00_gone")
    assert "figures/: fig01.png changed" in str(run(copy))
    Image.new("RGBA", (9, 9)).save(copy / "figures/fig01.png")
    assert "figures/: fig01.png changed" in str(run(copy))
    (copy / "figures/fig01.png").write_bytes(b"damaged")
    assert "figures/: fig01.png changed" in str(run(copy))
    assert contents(copy / "figures") == contents(finished / "figures")


def test_smallest_digits_of_a_figure_differ_enough() -> None:
    """The limit on stray pixels lies well below what another digit in a legend of 7 pt changes."""
    pictures = []
    for digit in range(10):
        figure = matplotlib.figure.Figure(figsize=(1, 1))
        figure.text(0.5, 0.5, f"{digit}0", fontsize=7)
        pictures.append(np.array(Image.open(io.BytesIO(figure_png(figure, dpi=120))).convert("RGB")).astype(int))
    differences = [np.abs(a - b).max(axis=2) for a, b in combinations(pictures, 2)]
    assert min(np.count_nonzero(d > agreement.SHADE_LEVELS) for d in differences) > 2 * agreement.OTHER_PIXELS


# --- check


def test_check_lists_what_differs(copy: Path) -> None:
    assert run(copy, check=True).problems == ()
    path = copy / "figures/metrics.csv"
    rows = list(csv.reader(path.read_text().splitlines()))
    mean = float(rows[1][2])
    rows[1][2] = f"{mean + 0.011:.10g}"  # out of its tolerance of 0.01
    rows[2][1] = "counted"  # renamed: one metric missing, one new
    rows[3][2] = f"{mean - 0.009:.10g}"  # within its tolerance
    path.write_text("\n".join(map(",".join, rows)))
    (copy / "figures/fig01.png").rename(copy / "figures/fig09.png")
    before = contents(copy / "figures")
    problems = run(copy, check=True).problems
    assert problems == (
        f"01_draw: mean: {mean:.10g}, metrics.csv says {rows[1][2]} +- 0.01 m",
        "02_count: count: new, not in metrics.csv",
        "02_count: counted: missing, only in metrics.csv",
        "figure fig01.png: not in figures/",
        "figure fig09.png: no notebook makes it",
    )
    assert contents(copy / "figures") == before
    assert [line for line in run(copy, "01", check=True).problems if line.startswith("02")] == []


@pytest.mark.parametrize(
    "text", ["notebook,metric\n01_draw,mean\n", "notebook,metric,value,unit,tolerance\na,b,much,m,0\n", "\0"]
)
def test_damaged_table_of_metrics(copy: Path, text: str) -> None:
    (copy / "figures/metrics.csv").write_text(text)
    with pytest.raises(ValueError, match=r"metrics.csv: expected a table with the columns notebook, metric"):
        run(copy, check=True)


# --- in a notebook


@pytest.fixture
def notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OCCLIB_RUN_DIR", str(tmp_path / "01_x"))
    return tmp_path / "01_x"


def test_record_keeps_ten_digits_and_plain_numbers(notebook: Path) -> None:
    record("third", 1 / 3, unit="m")
    record("found", np.True_)
    record("seconds", np.float32(2.5), unit="s", tolerance=np.inf)
    rows = [list(row.values()) for row in json.loads((notebook / "metrics.json").read_text())]
    expected = [["third", "0.3333333333", "m", "3.333333333e-07"], ["found", "1", "", "0"]]
    assert rows == [*expected, ["seconds", "2.5", "s", "inf"]]
    with pytest.raises(ValueError, match="metric 'third' was recorded before"):
        record("third", 1 / 3)


@pytest.mark.parametrize("value", [np.nan, np.inf, [1, 2], "1", None])
def test_record_refuses_what_is_not_a_number(notebook: Path, value: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OCCLIB_OWN_PARAMETERS", "1")
    with pytest.raises(ValueError, match="record: x: expected one finite number"):
        record("x", value)  # type: ignore[arg-type]


def test_record_refuses_a_wrong_name_or_tolerance(notebook: Path) -> None:
    with pytest.raises(ValueError, match="name: expected letters"):
        record("a,b", 1)
    with pytest.raises(ValueError, match="tolerance: expected a number >= 0, got nan"):
        record("x", 1, tolerance=np.nan)
    assert not notebook.exists()


def test_save_gives_the_same_bytes_once(notebook: Path) -> None:
    figure = matplotlib.figure.Figure()
    figure.add_subplot().plot([1, 2])
    save(figure, "one")
    save(figure, "two")
    one, two = contents(notebook).values()
    assert one == two
    with pytest.raises(ValueError, match="figure 'one' was saved before"):
        save(figure, "one")
    with pytest.raises(ValueError, match="name: expected letters"):
        save(figure, "../../figures/one")


def test_by_hand_results_stay_out_of_figures(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OCCLIB_RUN_DIR", raising=False)
    monkeypatch.setenv("JPY_SESSION_NAME", "/home/me/notebooks/01_draw.ipynb")
    monkeypatch.setattr(runner, "PACKAGE", project / "occlib")
    for value in (1, 2):  # a cell may be run again
        record("x", value)
    assert list(contents(project)) == [str(Path("runs/interactive/01_draw/metrics.json"))]
    assert '"2"' in (project / "runs/interactive/01_draw/metrics.json").read_text()


def test_show_versions(capsys: pytest.CaptureFixture[str]) -> None:
    notebook_module.show_versions()
    assert capsys.readouterr().out.startswith("occlib 0.1.0, cv2 ")


# --- films


def film(shift: int = 0, shade: int = 200) -> list[np.ndarray[Any, Any]]:
    """Three frames with a square of 16 px that moves."""
    frames = np.full((3, 90, 120, 3), shade, np.uint8)
    for i, frame in enumerate(frames):
        frame[30:46, 20 + 20 * i + shift : 36 + 20 * i + shift] = (200, 30, 30)
    return list(frames)


@pytest.fixture
def saved_film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Save a film as the notebook ``name`` would: its path."""

    def save(name: str, frames: list[np.ndarray[Any, Any]]) -> Path:
        folder = tmp_path / name / "01_draw"
        folder.mkdir(parents=True)
        monkeypatch.setenv("OCCLIB_RUN_DIR", str(folder))
        shown = notebook_module.save_film(frames, "film", fps=5)._repr_html_()
        assert base64.b64encode((folder / "film.webp").read_bytes()).decode() in shown and "<img alt=" in shown
        return folder / "film.webp"

    return save


def test_a_film_moves_and_says_whose_it_is(saved_film: Callable[..., Path]) -> None:
    path = saved_film("a", film())
    with Image.open(path) as found:
        found.load()
        assert (found.n_frames, found.info["duration"], found.info["loop"]) == (3, 200, 0)  # type: ignore[attr-defined]
        assert found.getexif()[runner.IMAGE_DESCRIPTION] == "01_draw"
    (path.parents[1] / "figures").mkdir()
    shutil.copy(path, path.parents[1] / "figures")
    assert publish._published_figures(path.parents[1]) == {"film.webp": "01_draw"}
    with pytest.raises(ValueError, match="film 'film' was saved before"):
        notebook_module.save_film(film(), "film")


@pytest.mark.parametrize("frames", [[], [*film()[:1], film()[1][:50]]], ids=["none", "of two sizes"])
def test_a_film_of_nothing_is_refused(saved_film: Callable[..., Path], frames: Any) -> None:
    with pytest.raises(ValueError, match="expected pictures of one size"):
        saved_film("a", frames)


@pytest.mark.parametrize(
    ("frames", "fps", "message"),
    [
        ([film()[0] / 255.0], 5, "frames: expected RGB uint8"),
        ([film()[0][..., 0]], 5, "frames: expected RGB uint8"),
        (film(), 0, "fps: expected frames a second from 0.1 to 1000, got 0"),
        (film(), float("nan"), "fps: expected frames a second from 0.1 to 1000, got nan"),
    ],
)
def test_what_is_no_film_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, frames: Any, fps: float, message: str
) -> None:
    monkeypatch.setenv("OCCLIB_RUN_DIR", str(tmp_path))
    with pytest.raises(ValueError, match=f"^save_film: {message}"):
        notebook_module.save_film(frames, "film", fps=fps)


def test_without_webp_the_reason_is_told(saved_film: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import features

    monkeypatch.setattr(features, "check", lambda name: False)
    with pytest.raises(ValueError, match=r"^save_film: this Pillow cannot write WebP"):
        saved_film("a", film())


def test_a_damaged_film_belongs_to_nobody_and_agrees_with_none(saved_film: Callable[..., Path]) -> None:
    good = saved_film("a", film())
    home = good.parents[1]
    damaged = home / "figures/film.webp"
    damaged.parent.mkdir()
    content = bytearray(good.read_bytes())
    content[content.index(b"EXIF") + 8] ^= 0xFF
    for broken in (bytes(content), good.read_bytes()[:40]):
        damaged.write_bytes(broken)
        assert publish._published_figures(home) == {}
    assert not agreement.figure_agrees(good, damaged)


def test_films_agree_frame_by_frame(saved_film: Callable[..., Path]) -> None:
    one = saved_film("a", film())
    assert agreement.figure_agrees(one, saved_film("b", film()))
    assert not agreement.figure_agrees(one, saved_film("moved", [film()[0], *film(shift=12)[1:]]))
    assert not agreement.figure_agrees(one, saved_film("shorter", film()[:2]))
    assert not agreement.figure_agrees(one, saved_film("paler", film(shade=202)))
    one.write_bytes(b"damaged")
    assert not agreement.figure_agrees(one, saved_film("c", film()))


# --- what a cell shows


def outputs_of(project: Path, name: str) -> list[list[str]]:
    """The kinds of data that each code cell of an executed notebook shows."""
    cells = nbformat.read(project / f"runs/{name}/{name}.ipynb", as_version=4).cells
    return [[kind for output in cell.outputs for kind in output.get("data", {})] for cell in cells
            if cell.cell_type == "code"]  # fmt: skip


def test_a_saved_figure_is_shown_once_whoever_made_it(project: Path) -> None:
    bare = "fig = Figure(figsize=(3, 2))\nfig.add_subplot().plot([0, 1])\nsave(fig, 'bare')"
    pyplots = "from matplotlib import pyplot as plt\nfig, ax = plt.subplots()\nsave(fig, 'pyplots')"
    write_notebook(project, "01_x", bare, pyplots, bare.replace("'bare'", "'again'"))
    run(project)
    shown = outputs_of(project, "01_x")[2:]
    assert [[kind for kind in kinds if kind == "image/png"] for kinds in shown] == [["image/png"]] * 3


def test_what_the_text_says_is_asked_of_its_own_parameters_only(project: Path) -> None:
    write_notebook(
        project,
        "01_x",
        "from occlib.reproduce import expect",
        "expect(seed == 0); record('gap', 1 / 3 if seed == 0 else float('nan'))",
    )
    run(project)
    (changed,) = run(project, parameters={"seed": 1}).runs
    cells = nbformat.read(changed.folder / "01_x.ipynb", as_version=4).cells
    assert "does not hold" in cells[-1].outputs[0].text and "not recorded: gap is nan" in cells[-1].outputs[0].text
    write_notebook(project, "01_x", "from occlib.reproduce import expect", "expect(seed == 1)")
    with pytest.raises(ValueError, match="does not hold in this run"):
        run(project)
