"""Plugins are found by what installed packages declare: here packages laid out on disk as pip lays them out."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from adcbf_cli.core import plugins as plugins_module
from adcbf_cli.core.config import CLUSTERERS, Config, PerceptionConfig, PlanningConfig, TrackingConfig, VehicleConfig
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.perception.clusterers import plugin_clusterer
from adcbf_cli.core.planning.presets import PLANNERS, make_planner
from adcbf_cli.core.plugins import Kind, find_plugin, load_plugin, overshadowed, plugins
from adcbf_cli.core.tracking.motion import build_motion_model
from adcbf_cli.core.types import NO_ID, Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle
from adcbf_cli.io.plugin_versions import planner_plugins, stage_plugins
from adcbf_cli.io.run_folder import stage_keys
from adcbf_cli.io.settings import resolve_config

VEHICLE = Vehicle.from_config(VehicleConfig())


class Installed:
    """A folder on sys.path into which packages are installed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def package(self, name: str, source: str, version: str = "1.0", **offers: str) -> None:
        """offers: `planners="x = name:function"`, as in the entry points' file, under the group's last word."""
        module = self.folder / f"{name}.py"
        module.write_text(source)
        info = self.folder / f"{name}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        groups = [f"[adcbf.{group}]\n{lines}\n" for group, lines in offers.items()]
        (info / "entry_points.txt").write_text("\n".join(groups))
        importlib.invalidate_caches()
        plugins_module._declared.cache_clear()


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Installed]:
    monkeypatch.syspath_prepend(str(tmp_path))
    yield Installed(tmp_path)
    for path in tmp_path.glob("*.py"):
        sys.modules.pop(path.stem, None)


def planner(name: str) -> object:
    return make_planner(name, VEHICLE, PlanningConfig(), Notes())


def model(name: str, **changes: object) -> object:
    return build_motion_model(TrackingConfig(model=name, **changes), planar=False)  # type: ignore[arg-type]


GROUPER = """
import numpy as np
from adcbf_cli.core.perception.clustering import Grouping
def group(cells_m, config, min_cluster_size, returns):
    return Grouping({label}, {probability})
"""

MODEL = """
import numpy as np
from adcbf_cli.core.tracking.motion import MotionModel
def still(config, planar):
    return MotionModel("other", 6, {linear}, lambda s, dt: {propagate}, lambda s, dt: {jacobian},
                       lambda dt: np.eye({noise}), np.ones({variance}))
"""
GOOD_MODEL = {"linear": True, "propagate": "s", "jacobian": "np.eye(6)", "noise": 6, "variance": 6}


def test_a_name_leads_to_what_the_package_says(installed: Installed) -> None:
    installed.package("box_of_tools", "def make(): return 7", "2.5", planners="made-up = box_of_tools:make")
    found = find_plugin(Kind.PLANNER, "made-up", PLANNERS)
    assert (found.distribution, found.version, found.module) == ("box_of_tools", "2.5", "box_of_tools")
    assert load_plugin(found)() == 7
    assert [plugin.name for plugin in plugins(Kind.PLANNER)] == ["made-up"]
    assert plugins(Kind.CLUSTERER) == []


def test_an_unknown_name_is_told_with_the_nearest_and_all(installed: Installed) -> None:
    installed.package("box_of_tools", "", planners="made-up = box_of_tools:make")
    with pytest.raises(UsageError, match="no planner is called 'mad-up'; did you mean made-up") as error:
        planner("mad-up")
    assert str(error.value).endswith("pure-pursuit, made-up")


def test_packages_that_are_not_asked_for_are_not_imported(installed: Installed) -> None:
    installed.package("bomb", "raise RuntimeError('boom')", planners="bomb = bomb:make", clusterers="bomb2 = bomb:make")
    assert planner("dwa")
    assert resolve_config(Config(), environment={}).perception.clusterer == "hdbscan"
    assert planner_plugins(["dwa"], PLANNERS) == {}


@pytest.mark.parametrize(
    ("source", "target", "why"),
    [
        ("raise RuntimeError('boom\\nin two lines')", "faulty:make", r"RuntimeError: boom in two lines"),
        ("import sys\nsys.exit('no licence')", "faulty:make", r"cannot be loaded .*SystemExit: no licence"),
        ("def make(*_): return {}['gain']", "faulty:make", r"failed \(KeyError: 'gain'\)"),
        ("import sys\ndef make(*_): sys.exit(3)", "faulty:make", r"failed \(SystemExit: 3\)"),
        ("import not_there", "faulty:make", r"ModuleNotFoundError: No module named 'not_there'"),
        ("x = 1", "faulty:make", r"AttributeError: .*make"),
        ("x = 1", "nowhere:make", r"ModuleNotFoundError: No module named 'nowhere'"),
        ("def (", "faulty:make", r"SyntaxError"),
        ("make = 3", "faulty:make", r"is a int, where something to call is wanted"),
        ("x = 1", "not a target!", r"cannot be loaded from 'not a target!'"),
    ],
)
def test_what_cannot_be_loaded_is_one_line_that_names_the_package(
    installed: Installed, source: str, target: str, why: str
) -> None:
    installed.package("faulty", source, "0.3", planners=f"odd = {target}")
    with pytest.raises(UsageError, match=why) as error:
        planner("odd")
    assert "the planner 'odd' of faulty 0.3" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_signal_ends_the_process_also_in_a_strangers_code(installed: Installed) -> None:
    installed.package("slow", "import sys\ndef make(*_): sys.exit(143)", planners="slow = slow:make")
    with pytest.raises(SystemExit) as stop:
        planner("slow")
    assert stop.value.code == 143


@pytest.mark.parametrize(
    ("body", "why"),
    [("return None", "returns a NoneType, where a Grouping is wanted"), ("return 1 / 0", "failed .ZeroDivisionError")],
)
def test_a_clusterer_that_fails_or_gives_nothing_is_named(installed: Installed, body: str, why: str) -> None:
    installed.package("grouper", f"def group(*_): {body}", "0.3", clusterers="mine = grouper:group")
    cluster = plugin_clusterer("mine")
    with pytest.raises(UsageError, match=f"the clusterer 'mine' of grouper 0.3.* {why}"):
        cluster(np.zeros((4, 2)), PerceptionConfig(), 2, None)


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("return {}", "returns a dict, where a MotionModel is wanted"),
        ("raise OSError('gone')", "failed .OSError: gone"),
    ],
)
def test_a_model_that_cannot_be_made_is_named(installed: Installed, body: str, why: str) -> None:
    installed.package("models", f"def still(*_): {body}", "0.3", motion_models="mine = models:still")
    with pytest.raises(UsageError, match=f"the motion model 'mine' of models 0.3.* {why}"):
        model("mine")


def test_two_packages_with_one_name_are_both_named(installed: Installed) -> None:
    installed.package("one", "", "1.1", planners="same = one:make")
    installed.package("two", "", "2.2", planners="same = two:make")
    with pytest.raises(UsageError, match=r"one 1\.1 and two 2\.2 both offer a planner called 'same'"):
        planner("same")


def test_a_package_whose_metadata_is_damaged_offers_nothing_and_breaks_nothing(installed: Installed) -> None:
    installed.package("good", "", planners="good-one = good:make")
    for name, content in (("torn", b"\xff\xfe[adcbf.planners"), ("bare", b"[adcbf.planners]\nunnamed = bare:make\n")):
        info = installed.folder / f"{name}-1.dist-info"
        info.mkdir()
        (info / "entry_points.txt").write_bytes(content)
    assert {plugin.name for plugin in plugins(Kind.PLANNER)} == {"good-one", "unnamed"}


def test_of_a_package_that_lies_there_twice_the_first_counts(
    installed: Installed, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    older = Installed(tmp_path_factory.mktemp("older"))
    older.package("tools", "", "1.0", planners="one = tools:make")
    monkeypatch.setattr(sys, "path", [*sys.path, str(older.folder)])
    older.package("more_tools", "", "1.0", planners="gone-since = more_tools:make")
    installed.package("tools", "", "2.0", planners="one = tools:make")
    installed.package("more.tools", "", "2.0")
    assert find_plugin(Kind.PLANNER, "one", PLANNERS).version == "2.0"
    assert [plugin.name for plugin in plugins(Kind.PLANNER)] == ["one"]


def test_what_is_built_in_is_not_replaced_and_the_other_is_known(installed: Installed) -> None:
    installed.package("usurper", "def make(*_): return 'no planner'", planners="dwa = usurper:make")
    assert planner("dwa") != "no planner"
    assert [str(plugin) for plugin in overshadowed(Kind.PLANNER, PLANNERS)] == ["the planner 'dwa' of usurper 1.0"]


@pytest.mark.parametrize("name", ["all", "logged", "Loud", "with.dot", "a/b"])
def test_names_that_mean_something_else_are_refused(installed: Installed, name: str) -> None:
    installed.package("odd", "def make(*_): pass", planners=f"{name} = odd:make")
    with pytest.raises(UsageError):
        planner(name)


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("def make(*_): return 3", "has no method `plan`"),
        ("class make:\n  def __init__(self, *_): self.name = 'x'\n  def plan(self, s): pass", "does not say `name`"),
    ],
)
def test_what_is_no_planner_is_refused(installed: Installed, source: str, why: str) -> None:
    installed.package("odd", source, planners="odd-one = odd:make")
    with pytest.raises(UsageError, match=why):
        planner("odd-one")


PLANNER = """
class Make:
    def __init__(self, name, *_): self.name = name
    def plan(self, situation): return {plan}
"""


@pytest.mark.parametrize(
    ("plan", "why"),
    [
        ("1 / 0", "failed .ZeroDivisionError: division by zero"),
        ("situation.way", "failed .AttributeError: .*'way'"),
        ("[0.0, 1.0]", "returns a list, where a Plan is wanted"),
    ],
)
def test_what_goes_wrong_while_it_plans_is_told_as_the_packages(installed: Installed, plan: str, why: str) -> None:
    installed.package("odd", PLANNER.format(plan=plan), "0.4", planners="odd-one = odd:Make")
    made = planner("odd-one")
    with pytest.raises(UsageError, match=f"the planner 'odd-one' of odd 0.4.* {why}"):
        made.plan(None)  # type: ignore[attr-defined]


def test_what_goes_wrong_in_a_model_is_told_as_the_packages(installed: Installed) -> None:
    fragile = {**GOOD_MODEL, "propagate": "s if dt < 1.0 else s[:, 99]"}
    installed.package("models", MODEL.format(**fragile), "0.3", motion_models="mine = models:still")
    made = model("mine")
    with pytest.raises(UsageError, match=r"the motion model 'mine' of models 0\.3 failed \(IndexError"):
        made.propagate(np.zeros((2, 6)), 1.5)  # type: ignore[attr-defined]


def test_a_clusterers_groups_are_renumbered_by_their_first_cell(installed: Installed) -> None:
    source = GROUPER.format(label="np.array([7, -1, 2, 7])", probability="np.array([1, 0.5, 0.2, 1])")
    installed.package("grouper", source, clusterers="mine = grouper:group")
    cluster = plugin_clusterer("mine")
    found = cluster(np.zeros((4, 2)), PerceptionConfig(clusterer="mine"), 2, None)
    assert found.label.tolist() == [0, NO_ID, 1, 0]
    assert found.probability.tolist() == [1, 0, 0.2, 1]
    assert len(cluster(np.zeros((0, 2)), PerceptionConfig(), 2, None).label) == 0


@pytest.mark.parametrize(
    ("label", "probability", "why"),
    [
        ("np.zeros(3, int)", "np.ones(4)", r"labels \(3,\)"),
        ("np.zeros(4, int)", "np.ones((4, 1))", r"probabilities \(4, 1\)"),
        ("np.zeros(4)", "np.ones(4)", "whole numbers"),
        ("np.full(4, -2)", "np.ones(4)", "whole numbers"),
        ("np.zeros(4, int)", "np.full(4, np.nan)", "between 0 and 1"),
    ],
)
def test_what_is_no_grouping_is_refused(installed: Installed, label: str, probability: str, why: str) -> None:
    source = GROUPER.format(label=label, probability=probability)
    installed.package("grouper", source, clusterers="mine = grouper:group")
    with pytest.raises(UsageError, match=why):
        plugin_clusterer("mine")(np.zeros((4, 2)), PerceptionConfig(), 2, None)


def test_a_model_goes_by_the_name_that_it_is_asked_for(installed: Installed) -> None:
    installed.package("models", MODEL.format(**GOOD_MODEL), motion_models="mine = models:still")
    assert model("mine").name == "mine"  # type: ignore[attr-defined]
    assert model("mine", filter="kf")


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"variance": 5}, "initial_variance"),
        ({"propagate": "s[0]"}, "propagate"),
        ({"propagate": "s.reshape(len(s), -1)[:, :6]"}, r"\(n, m, 6\)"),
        ({"jacobian": "np.ones((len(s), 6, 6))"}, "jacobian"),
        ({"noise": 5}, "process_noise"),
    ],
)
def test_a_model_that_does_not_fit_is_refused(installed: Installed, changes: dict[str, object], why: str) -> None:
    installed.package("models", MODEL.format(**{**GOOD_MODEL, **changes}), motion_models="mine = models:still")
    with pytest.raises(UsageError, match=why):
        model("mine")


def test_the_linear_filter_refuses_a_model_that_is_not(installed: Installed) -> None:
    bent = {**GOOD_MODEL, "linear": False, "jacobian": "np.ones((len(s), 6, 6))"}
    installed.package("models", MODEL.format(**bent), motion_models="mine = models:still")
    assert model("mine")
    with pytest.raises(UsageError, match="filter 'kf' needs a linear motion model"):
        model("mine", filter="kf")


def test_a_setting_names_an_installed_clusterer_or_none(installed: Installed) -> None:
    with pytest.raises(ValidationError, match="no clusterer is called 'mine'; there are hdbscan, dbscan"):
        PerceptionConfig(clusterer="mine")
    installed.package("grouper", "", clusterers="mine = grouper:group")
    assert PerceptionConfig(clusterer="mine").clusterer == "mine"
    assert CLUSTERERS == ("hdbscan", "dbscan")


def test_results_are_keyed_by_the_plugins_version_and_by_its_sources(installed: Installed) -> None:
    installed.package("grouper", "x = 1", "1.0", clusterers="mine = grouper:group")
    config = resolve_config(Config(), settings=["perception.clusterer=mine"], environment={})
    before, key = stage_plugins(config), stage_keys("0", config, None)
    assert list(before) == ["perception.clusterer"]
    assert before["perception.clusterer"].startswith("grouper 1.0+")
    assert stage_keys("0", config, None) == key
    (installed.folder / "grouper.py").write_text("x = 2")
    after = stage_keys("0", config, None)
    assert stage_plugins(config) != before
    assert all(after[stage] != key[stage] for stage in key)
    assert stage_plugins(Config()) == {}


def test_a_models_version_leaves_the_clusters_alone(installed: Installed) -> None:
    installed.package("models", MODEL.format(**GOOD_MODEL), motion_models="mine = models:still")
    config = resolve_config(Config(), settings=["tracking.model=mine"], environment={})
    before = stage_keys("0", config, None)
    (installed.folder / "models.py").write_text("")
    after = stage_keys("0", config, None)
    assert {stage: before[stage] == after[stage] for stage in before} == {
        "cluster": True,
        "track": False,
        "predict": False,
    }
