"""What `adcbf doctor` looks at. Each check is a function that gives rows; what it raises becomes a failed row.

Nothing is imported at the top: what is examined here may be what cannot be imported.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from adcbf_cli.core.plugins import Plugin

State = Literal["ok", "absent", "warning", "failed"]
"""absent: an extra that is not installed. warning: something goes without, or is done otherwise. failed: required."""

DISTRIBUTION = "adcbf"

DONE_WITHOUT = {
    "open3d": "simulated scans cannot be cast",
    "pypatchworkpp": "ground is taken for a plane",
    "numba": "plans take longer: the solver piqp takes the place of sqp",
}
"""Required packages without which the rest still works, and what then is not as it should be."""


@dataclass(frozen=True, slots=True)
class Check:
    """One row. detail: what was found; advice: what to do about it, where there is something to do."""

    name: str
    state: State
    detail: str
    advice: str = ""

    def to_dict(self) -> dict[str, str]:
        return asdict(self)


def all_checks() -> Iterator[Check]:
    """Every check, as it is made; the self-test last, since it explains least."""
    examined: tuple[tuple[str, Callable[[], Iterator[Check]]], ...] = (
        ("python", _python),
        ("packages", _packages),
        ("open3d", _open3d),
        ("extras", _extras),
        ("solvers", _solvers),
        ("compiled solver", _compiled),
        ("plugins", _plugins),
        ("self-test", _self_test),
    )
    for name, check in examined:
        try:
            yield from check()
        except Exception as error:  # a broken installation may break anything: the other checks still tell of it
            yield Check(name, "failed", _in_words(error), "mend what it names, or install adcbf anew")


def _in_words(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split()):.200}"


def _python() -> Iterator[Check]:
    import adcbf_cli

    place = Path(adcbf_cli.__file__).parent
    yield Check("adcbf", "ok", f"{adcbf_cli.__version__} in {place}")
    found = f"{platform.python_version()} ({sys.executable})"
    old = sys.version_info < (3, 11)
    yield Check("python", "failed" if old else "ok", found, "install Python 3.11 or newer" if old else "")
    yield Check("machine", "ok", f"{platform.platform()}, {os.cpu_count()} cores")


def _packages() -> Iterator[Check]:
    """Every package that adcbf requires, by what its own metadata says."""
    from packaging.requirements import Requirement

    try:
        required = [Requirement(text) for text in requires(DISTRIBUTION) or ()]
    except PackageNotFoundError:
        yield Check("packages", "warning", "adcbf runs from its sources, not installed", "pip install .")
        return
    for requirement in required:
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            yield _package(requirement.name, str(requirement.specifier), requirement.specifier.contains)


def _package(name: str, wanted: str, fits: Callable[..., bool]) -> Check:
    bad: State = "warning" if name in DONE_WITHOUT else "failed"
    without = f"; {DONE_WITHOUT[name]}" if name in DONE_WITHOUT else ""
    advice = f"pip install '{name}{wanted}'"
    try:
        found = version(name)
    except PackageNotFoundError:
        return Check(name, bad, f"not installed{without}", advice)
    if not fits(found, prereleases=True):
        return Check(name, bad, f"{found}, where {wanted} is wanted{without}", advice)
    return Check(name, "ok", found)


def _open3d() -> Iterator[Check]:
    """Whether its wheel finds the system libraries that it wants."""
    from adcbf_cli.core.errors import AdcbfError
    from adcbf_cli.core.open3d_import import load_open3d

    try:
        load_open3d()
    except AdcbfError as error:
        what, _, advice = str(error).partition("; install it with: ")
        yield Check("open3d's libraries", "warning", f"{what}; {DONE_WITHOUT['open3d']}", advice)
        return
    yield Check("open3d's libraries", "ok", "found")


def _extras() -> Iterator[Check]:
    from packaging.requirements import Requirement

    try:
        names = metadata(DISTRIBUTION).get_all("Provides-Extra") or []
        required = [Requirement(text) for text in requires(DISTRIBUTION) or ()]
    except PackageNotFoundError:
        return
    for extra in sorted(set(names) - {"dev"}):
        wanted = [r for r in required if r.marker is not None and _is_of(r.marker, extra)]
        found = [_package(r.name, str(r.specifier), r.specifier.contains) for r in wanted]
        missing = [f"{r.name} {c.detail}" for r, c in zip(wanted, found, strict=True) if c.state != "ok"]
        there = ", ".join(f"{r.name} {c.detail}" for r, c in zip(wanted, found, strict=True))
        advice = f"pip install '{DISTRIBUTION}[{extra}]'" if missing else ""
        yield Check(f"extra {extra}", "absent" if missing else "ok", ", ".join(missing) or there, advice)


def _is_of(marker: Any, extra: str) -> bool:
    """Whether a requirement is there for this extra, and not without it."""
    return bool(marker.evaluate({"extra": extra}) and not marker.evaluate({"extra": ""}))


def _solvers() -> Iterator[Check]:
    """Each solver, on a plan past something that crosses."""
    from adcbf_cli.commands.terminal import COMPILING, patience
    from adcbf_cli.core.config import Config
    from adcbf_cli.core.planning.solvers.base import SOLVERS
    from adcbf_cli.core.self_test import predict_scene, run_self_test

    predictions = predict_scene(Config())
    for name in SOLVERS:
        config = Config.model_validate({"planning": {"solver": name}})
        try:
            with patience(COMPILING if name == "sqp" else f"solver {name}: loading"):
                found = run_self_test(predictions, config)
            detail, problems, remarks = _clear(found.clearance_m), found.problems, found.remarks
        except Exception as error:  # a shared library that does not load may raise anything
            detail, problems, remarks = "", (_in_words(error),), ()
        package = {"sqp": "numba", "piqp": "piqp"}.get(name, "casadi")
        if problems:
            bad: State = "warning" if name in ("ipopt", "fatrop") else "failed"  # the oracles
            yield Check(f"solver {name}", bad, "; ".join(problems), f"pip install --upgrade {package}")
        elif remarks:
            yield Check(f"solver {name}", "warning", "; ".join((*remarks, detail)), f"pip install {package}")
        else:
            yield Check(f"solver {name}", "ok", detail)


def _clear(clearance_m: float) -> str:
    return f"plans past what crosses, {clearance_m:.2f} m clear"


def _compiled() -> Iterator[Check]:
    """Whether the fast solver is kept compiled, so that the next start need not compile it."""
    from adcbf_cli.core.planning.solvers.base import has_numba

    if not has_numba():
        yield Check(
            "compiled solver", "warning", f"Numba cannot be imported; {DONE_WITHOUT['numba']}", "pip install numba"
        )
        return
    from adcbf_cli.core.planning.solvers import sqp_loop

    folder = getattr(getattr(sqp_loop.entry(), "stats", None), "cache_path", None)
    if folder is None:
        advice = "make your cache folder (~/.cache) writable, or set NUMBA_CACHE_DIR to one that is"
        yield Check(
            "compiled solver", "warning", "compiled anew in every process: there is no place to keep it", advice
        )
        return
    if any(Path(folder).glob("sqp_loop*.nbc")):
        yield Check("compiled solver", "ok", f"kept in {folder}")
    else:
        yield Check("compiled solver", "warning", f"not kept: nothing of it is in {folder}", "make it writable")


def _plugins() -> Iterator[Check]:
    """Whether what other packages offer can be used; nothing of adcbf's own depends on it."""
    from adcbf_cli.core.config import CLUSTERERS, MOTION_MODELS
    from adcbf_cli.core.errors import AdcbfError
    from adcbf_cli.core.planning.presets import RESERVED
    from adcbf_cli.core.plugins import Kind, find_plugin, plugins

    taken = {Kind.PLANNER: RESERVED, Kind.CLUSTERER: CLUSTERERS, Kind.MOTION_MODEL: MOTION_MODELS}
    for kind, built_in in taken.items():
        for plugin in plugins(kind):
            name = f"{kind.noun} {plugin.name}"
            package = f"{plugin.distribution} {plugin.version}"
            if plugin.name in built_in:
                yield Check(name, "warning", f"of {package}: that name is built in", "give it another name there")
                continue
            try:
                _use(find_plugin(kind, plugin.name, built_in))
            except AdcbfError as error:
                wrong = str(error)
            except (Exception, SystemExit) as error:  # what it made may still fail where it is used
                wrong = f"{plugin}: {_in_words(error)}"
            else:
                yield Check(name, "ok", f"of {package}")
                continue
            yield Check(name, "warning", wrong, f"mend or uninstall {plugin.distribution}")


def _use(plugin: Plugin) -> None:
    """Puts it to work, once, on the self-test's scene. Raises whatever it does."""
    from adcbf_cli.core.config import Config
    from adcbf_cli.core.plugins import Kind
    from adcbf_cli.core.self_test import plan_scene, predict_scene
    from adcbf_cli.core.types import Notes

    settings: dict[Kind, dict[str, Any]] = {
        Kind.PLANNER: {},
        Kind.CLUSTERER: {"perception": {"clusterer": plugin.name}},
        Kind.MOTION_MODEL: {"tracking": {"model": plugin.name}},
    }
    predictions = predict_scene(Config.model_validate(settings[plugin.kind]))
    if plugin.kind is Kind.PLANNER:
        plan_scene(predictions, Config(), plugin.name, Notes())


def _self_test() -> Iterator[Check]:
    from adcbf_cli.core.config import Config
    from adcbf_cli.core.self_test import SCANS, predict_scene, run_self_test

    found = run_self_test(predict_scene(Config()), Config())
    if found.problems:
        advice = "report it, with this table; until then trust no result of this installation"
        yield Check("self-test", "failed", "; ".join(found.problems), advice)
        return
    detail = (
        f"{SCANS} scans of a post that crosses: its track is {found.position_error_m * 1e3:.0f} mm and "
        f"{found.velocity_error_mps * 1e3:.0f} mm/s off, the plan keeps {found.clearance_m:.2f} m clear"
    )
    yield Check("self-test", "ok", detail)
