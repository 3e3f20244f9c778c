"""Where the compiled solver is kept."""

from pathlib import Path

import pytest
from numba.core import config

import adcbf_cli
from adcbf_cli.core.planning.solvers import compiling


def _one(number: int) -> int:
    return number + 1


def _place() -> Path:
    function = compiling.kept(_one)
    assert function(1) == 2
    return Path(function.stats.cache_path)  # type: ignore[attr-defined]


def test_the_compiled_solver_is_kept_in_the_users_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the module, it would outlive the package: pip removes what it installed and leaves the rest."""
    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    place = _place()
    assert place.is_relative_to(tmp_path)
    assert len([*place.glob("*.nbc")]) == 1
    assert config.CACHE_DIR == "", "other packages' functions are kept where they were"


def test_the_users_own_place_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "own"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert _place().is_relative_to(tmp_path / "own")


def test_the_entry_is_not_kept_in_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from adcbf_cli.core.planning.solvers import sqp_loop

    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    function = sqp_loop.entry.__wrapped__()
    package = Path(adcbf_cli.__file__).parent
    assert not Path(function.stats.cache_path).is_relative_to(package)  # type: ignore[attr-defined]
