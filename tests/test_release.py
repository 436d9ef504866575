"""The checks before a release, the workflows that call them, and how names go."""

import re
import tarfile
import zipfile
from pathlib import Path

import pytest
import yaml

import aslo_jax as aslo
from aslo_jax._deprecation import deprecated

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))

pytest.importorskip("griffe", reason="of the extra dev")

from packaging.version import Version  # noqa: E402

from release import (  # noqa: E402
    _api,
    _archives,
    _changelog,
    _deprecations,
    _install,
    _licences,
    _recipe,
    _versions,
)
from release.__main__ import main  # noqa: E402


def test_the_tree_passes(capsys):
    code = main(["check", "--quick"])
    assert code == 0, capsys.readouterr().out


def test_names_that_the_changelog_does_not_say():
    same = {"p.A": "(a, b=)", "p.A.go": "(t)", "p.f": "(x)"}
    before = {**same, "p.gone": "()", "p.m.h": "(x)"}
    now = {**same, "p.A": "(a, c=)", "p.A.go": "(t=)", "p.New": "(k)", "p.New.run": "()"}
    found = _api.unsaid(before, now, "- `unrelated`, and New without quotes")
    assert [each.partition(",")[0] for each in found] == [
        "`p.New` was added",
        "`p.gone` was removed",
        "`p.m.h` was removed",
        "`b` of `p.A` was removed",
        "`c` of `p.A` was added",
        "`t` of `p.A.go` is optional now",
    ]
    assert _api.unsaid(before, now, "`New(k)`, `h` of m, `gone`, `A(b, c)`, `go(t)`") == []
    assert _api.unsaid(before, before, "") == []


def _package(root: Path) -> None:
    home = root / "aslo_jax"
    home.mkdir()
    (home / "__init__.py").write_text(
        "from . import open_ as open_\nfrom ._shut import Base as Base, f as f\n"
        "__all__ = ['Base', 'f', 'open_']\n"
    )
    (home / "_shut.py").write_text(
        "class Base:\n    a: int\n    b: int = field(default=1)\n"
        "    c: int = eqx.field(static=True)\n"
        "    def go(self, t, *, n=2): ...\n    def _own(self): ...\n"
        "def f(x, *rest, y=1, **more): ...\ndef hidden(): ...\n"
    )
    (home / "open_.py").write_text(
        "from ._shut import Base\n__all__ = ['Child']\nclass Child(Base):\n    d: int = 0\n"
    )
    (home / "apart.py").write_text("__all__ = ['g']\ndef g(): ...\n")


def test_signatures_are_read_from_the_source(tmp_path):
    _package(tmp_path)
    found = _api.public_api(tmp_path)
    assert found == {
        "aslo_jax.Base": "(a, b=, c)",
        "aslo_jax.Base.go": "(t, n=)",
        "aslo_jax.f": "(x, *rest=, y=, **more=)",
        "aslo_jax.open_.Child": "(a, b=, c, d=)",
    }
    assert _api.read(_api.written(found)) == found


def test_a_snapshot_has_what_users_import():
    found = _api.read((_api.SNAPSHOTS / f"{_changelog.latest_release()}.txt").read_text())
    assert found["aslo_jax.AlgebraicObserver"].startswith("(relation, filter, completion=")
    assert "aslo_jax.replay" in found


def test_versions_that_differ(monkeypatch, tmp_path):
    for name in ("pyproject.toml", "CHANGELOG.md", "CITATION.cff"):
        (tmp_path / name).write_text((ROOT / name).read_text("utf-8"), "utf-8")
    monkeypatch.setattr(_versions, "ROOT", tmp_path)
    assert _versions.check_versions() == []
    assert _versions.check_citation() == []
    cff = tmp_path / "CITATION.cff"
    text = re.sub(r"^version: .*$", "version: 9.9.9", cff.read_text("utf-8"), flags=re.M)
    cff.write_text(text.replace("Apache-2.0", "MIT").replace("Pyrkin", "Nobody"), "utf-8")
    (found,) = _versions.check_versions()
    assert "CITATION.cff has version 9.9.9" in found
    assert len(_versions.check_citation()) == 2
    found = _versions.check_versions("v0.0.1")
    assert "The tag is v0.0.1" in found[1]


def test_what_is_unreleased(monkeypatch):
    text = "# C\n\n## [Unreleased]\n\n- `a`\n\n## [0.1.0] - 2026-01-02\n\n- `b`\n"
    monkeypatch.setattr(_changelog, "changelog", lambda: text)
    assert _changelog.unreleased().strip() == "- `a`"
    assert _changelog.releases() == [("0.1.0", "2026-01-02")]
    monkeypatch.setattr(
        _changelog, "changelog", lambda: text.replace("Unreleased", "0.2.0")
    )
    assert _changelog.unreleased() == ""


@pytest.mark.parametrize(
    ("licence", "refused"),
    [
        ("GPL-3.0-or-later", True),
        ("GNU General Public License v3 (GPLv3)", True),
        ("AGPL-3.0-only", True),
        ("LGPL-3.0-only", False),
        ("GNU Lesser General Public License v3 (LGPLv3)", False),
        ("BSD-3-Clause", False),
        ("Apache-2.0 WITH LLVM-exception", False),
        ("", True),
    ],
)
def test_licences(monkeypatch, licence, refused):
    monkeypatch.setattr(_licences, "licences", lambda: {"one": licence})
    assert bool(_licences.check_licences()) == refused


def test_licences_reach_what_dependencies_need():
    found = _licences.licences()
    assert found["jax"] == "Apache-2.0"
    assert "opt-einsum" in found and "hypothesis" not in found and "aslo-jax" not in found


def test_what_archives_must_have():
    wheel = [f"aslo_jax/{each}" for each in _archives.WHEEL_HAS]
    wheel += ["aslo_jax-0.2.0.dist-info/METADATA"]
    assert _archives.wrong_in_wheel(wheel) == []
    strange = ["release/__init__.py", "tests/test_x.py", "aslo_jax/test_y.py"]
    found = _archives.wrong_in_wheel(wheel[1:] + strange)
    assert found == ["The wheel lacks py.typed", *(f"The wheel has {s}" for s in strange)]
    sdist = ["aslo_jax-0.2.0/" + each for each in _archives.SDIST_HAS]
    assert _archives.wrong_in_sdist(sdist) == []
    assert len(_archives.wrong_in_sdist([*sdist[1:], "aslo_jax-0.2.0/.venv/x"])) == 2


@pytest.mark.slow
def test_archives_are_built_twice_alike(tmp_path):
    assert _archives.check_archives() == []
    _archives.build(ROOT, tmp_path)
    (sdist,), (wheel,) = tmp_path.glob("*.tar.gz"), tmp_path.glob("*.whl")
    made = yaml.safe_load(_recipe.recipe(sdist))
    needed = _versions.project()["dependencies"]
    run = [each.replace(" ", "") for each in made["requirements"]["run"]]
    assert sorted(run) == sorted([*needed, "python>=3.11"])
    with tarfile.open(sdist) as packed, zipfile.ZipFile(wheel) as zipped:
        files = {each.partition("/")[2] for each in packed.getnames()}
        assert {each for each in zipped.namelist() if "dist-info" not in each} <= files


@pytest.mark.slow
def test_the_wheel_runs_the_readme_in_an_empty_environment():
    assert _install.pythons()
    assert _install.check_install() == []


def test_the_readme_has_a_block_with_its_output():
    ((code, printed),) = _install.readme_blocks()
    assert "aslo.replay" in code and "exact start" in printed


def test_deprecated_names_warn_and_their_time_ends():
    @deprecated(since="0.3", removed="0.5", instead="aslo.new(x)")
    def old(x: int) -> int:
        """Doc."""
        return 2 * x

    with pytest.warns(
        DeprecationWarning, match=r"since aslo_jax 0.3 .* `aslo.new\(x\)`"
    ) as log:
        assert old(3) == 6
    assert log[0].filename == __file__
    assert old.__doc__ == "Doc."
    code = '@deprecated(since="0.3", removed="0.5", instead="new")\ndef old(): ...\n'
    path = Path("a.py")
    assert list(_deprecations.overdue(code, path, Version("0.4.9"))) == []
    assert list(_deprecations.overdue(code, path, Version("0.5.0"))) == [
        "a.py:1 is to be removed in 0.5"
    ]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows_call_what_is_in_the_tree(path):
    text = path.read_text("utf-8")
    told = yaml.safe_load(text)
    assert set(told) == {"name", True, "permissions", "jobs"}  # YAML 1.1 reads `on` as true
    assert told["permissions"] == {"contents": "read"}
    assert "secrets." not in text
    for job in told["jobs"].values():
        assert job["timeout-minutes"]
        assert set(job.get("needs", ())) <= set(told["jobs"])
        for name in re.findall(r"\$\{\{ matrix\.(\w+) }}", str(job)):
            matrix = job["strategy"]["matrix"]
            rows = matrix.get("include", ())
            assert name in matrix or all(name in row for row in rows)
        for step in job["steps"]:
            assert ("uses" in step) != ("run" in step)
            if "run" in step:
                script = ROOT / step["run"].split()[0]
                assert script.parent.name == ".ci"
                assert script.stat().st_mode & 0o100, "not executable"
                assert "${{" not in step["run"], "what is inserted would be run"
    for line in text.splitlines():
        if "uses:" in line:
            assert re.search(r"uses: [\w-]+/[\w-]+@[0-9a-f]{40} # v\d", line), line


def test_only_publishing_may_ask_for_a_token():
    asking = {
        (path.name, name)
        for path in WORKFLOWS
        for name, job in yaml.safe_load(path.read_text("utf-8"))["jobs"].items()
        if "id-token" in job.get("permissions", {})
    }
    assert asking == {("publish.yml", "publish")}
    job = yaml.safe_load((WORKFLOWS[0].parent / "publish.yml").read_text("utf-8"))["jobs"]
    assert job["publish"]["environment"] == "release"
    assert any("--tag" in step.get("run", "") for step in job["build"]["steps"])


def test_workflows_try_both_ends_of_python():
    jobs = yaml.safe_load((WORKFLOWS[0].parent / "checks.yml").read_text("utf-8"))["jobs"]
    assert jobs["tests"]["strategy"]["matrix"]["python"] == ["3.11", "3.13"]
    rows = jobs["versions"]["strategy"]["matrix"]["include"]
    assert [row["resolution"] for row in rows] == ["lowest-direct", "highest"]


def test_citation_of_an_observer_and_its_parts():
    motor = aslo.plants.PMSM(
        resistance=8.875, inductance=0.04, magnet_flux=0.2, pole_pairs=5, inertia=6e-5
    )
    observer = aslo.AlgebraicObserver(motor.flux_relation(), aslo.LowPass(20.0))
    found = aslo.citation(observer)
    assert found.references == (
        "Bobtsov, Romero, Ortega, Pyrkin, "
        '"An Algebraic State Observer for a Class of Physical Systems"',
        "Kreisselmeier 1977, doi:10.1109/TAC.1977.1101401",
        f"aslo_jax {aslo.__version__}, Apache-2.0",
    )
    names = [each.partition(":")[0] for each in found.parts]
    parts = ["AlgebraicObserver", "FluxRelation", "LowPass", "LeastSquares", "Guard"]
    assert names == [f"aslo_jax.{each}" for each in parts]
    assert str(found).endswith(f"- {found.references[-1]}\n")


def test_citation_of_what_is_no_module():
    with pytest.raises(TypeError, match=r"must be an observer .*, but is int"):
        aslo.citation(3)
