"""The notebooks run: all in this process at a small size, one through a kernel as Jupyter does."""

import io
import os
import re
from contextlib import redirect_stdout
from pathlib import Path

import nbclient
import nbformat
import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
NOTEBOOKS = {path.stem: path for path in sorted(FOLDER.glob("*.ipynb"))}
SAYS = {
    "data": r"sigma_n=amplitude: 0\.\d+ px\n.*noise: [1-9]",
    "e1_ablation": r"centre \{'v'.*\n(.*\n)*share of shoulder 1's motion that vision alone follows: (0\.[89]|1\.)",
    "e2_nonlinear": r"believed after 5 s: \[-0\.\d+\s+0\.8\d+",
    "e3_drift": r"unit 40 px: 0\.[12]\d of the drift left",
    "e4_refinement": r"'p\+v\+t': 0\.0",
    "e5_rubber_hand": r"^0 s late: 0\.[5-9]\d of the displacement\n(.*\n)*0\.4 s late: -?0\.00",
    "e6_cost": r"counted: 2\.0\d* 1\.0",
    "from_the_page": r"E1\.3 is refuted at sigma_v=pixels",
}
"""What each prints when what it shows is so."""


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    monkeypatch.setenv("BODYLOG_NOTEBOOKS", "small")
    monkeypatch.delenv("BODYLOG_OUT", raising=False)


def test_experiments_all_have_a_notebook():
    assert set(NOTEBOOKS) == set(SAYS) and {f"e{k}" for k in range(1, 7)} <= {name[:2] for name in NOTEBOOKS}


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_notebook_runs_and_reports_success(name):
    notebook = nbformat.read(NOTEBOOKS[name], as_version=4)
    nbformat.validate(notebook)
    reported, names = io.StringIO(), {}
    with redirect_stdout(reported):
        for cell in notebook.cells:
            if cell.cell_type == "code":
                assert not cell.outputs and cell.execution_count is None, "kept without outputs"
                exec(compile(cell.source, name, "exec"), names)
    assert re.search(SAYS[name], reported.getvalue(), re.MULTILINE), reported.getvalue()


def test_notebook_runs_in_a_kernel(tmp_path):
    notebook = nbformat.read(NOTEBOOKS["from_the_page"], as_version=4)
    nbclient.NotebookClient(
        notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    printed = [output.text for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert printed == ["E1.3 is refuted at sigma_v=pixels (90)\n"] and os.environ["BODYLOG_NOTEBOOKS"] == "small"
