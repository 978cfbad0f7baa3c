"""The pages that show Python run, in order, beside a street; lazy names are those of their files."""

import json
import re
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest

import nerf
import priors
from priors.street.write import write_street

ROOT = Path(__file__).resolve().parents[1]
PYTHON = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A street of ten frames: one is held out."""
    return write_street(tmp_path_factory.mktemp("street"), frames=10, seed=7, size=(64, 208))


@pytest.mark.docs
@pytest.mark.parametrize("page", ["docs/api.md", "docs/quickstart.md"])
def test_a_page_s_python_runs(page: str, street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "street").symlink_to(street)
    code = "\n".join(PYTHON.findall((ROOT / page).read_text()))
    assert code
    exec(compile(code, page, "exec"), {})


@pytest.mark.docs
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its cells, with fewer steps; what is committed is what Jupyter wrote when it ran them."""
    monkeypatch.chdir(tmp_path)
    cells = json.loads((ROOT / "docs/notebooks/street.ipynb").read_text())["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert "steps=200" in code
    exec(compile(code.replace("steps=200", "steps=10").replace("(96, 320)", "(64, 208)"), "street.ipynb", "exec"), {})


@pytest.mark.parametrize("name", re.findall(r"^::: ([\w.]+)$", (ROOT / "docs/api.md").read_text(), re.MULTILINE))
def test_the_names_of_the_page_are_there_and_say_what_they_are(name: str) -> None:
    module, _, attribute = name.rpartition(".")
    assert getattr(import_module(module), attribute).__doc__


def test_the_version_is_one() -> None:
    told = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert told and priors.__version__ == nerf.__version__ == version("roadprior") == told[1]
    assert f"\n## {told[1]}" in (ROOT / "CHANGELOG.md").read_text()


@pytest.mark.parametrize("package", [priors, nerf])
def test_lazy_names_are_those_of_the_stub(package: object) -> None:
    homes: dict[str, str] = package._HOMES  # type: ignore[attr-defined]
    stub = Path(str(package.__file__)).with_suffix(".pyi").read_text()  # type: ignore[attr-defined]
    told = re.findall(r"^from ([\w.]+) import (\w+) as \2$", stub, re.MULTILINE)
    assert {name: home for home, name in told} == homes
    assert set(homes) <= set(dir(package))
    for name, home in homes.items():
        assert getattr(package, name) is getattr(import_module(home), name)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        package.nothing  # type: ignore[attr-defined]  # noqa: B018
