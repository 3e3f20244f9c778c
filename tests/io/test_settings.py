"""Layers of settings, and errors that say where and what."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import UsageError
from adcbf_cli.io.settings import first_problem, known_keys, resolve_config


def test_later_layers_win(tmp_path: Path) -> None:
    file = tmp_path / "run.yaml"
    file.write_text("prediction: {steps: 10, step_s: 0.2}\ntracking: {filter: ekf}\n")
    environment = {"ADCBF_PREDICTION__STEPS": "20", "ADCBF_TRACKING__FILTER": "kf", "PATH": "/bin"}
    config = resolve_config(
        Config(), file, ["prediction.steps=40"], {"prediction.steps": None, "tracking.model": "ca"}, environment
    )
    assert (config.prediction.step_s, config.prediction.steps) == (0.2, 40)
    assert (config.tracking.filter, config.tracking.model) == ("kf", "ca")
    config = resolve_config(Config(), None, ["prediction.steps=40"], {"prediction.steps": 50}, {})
    assert config.prediction.steps == 50


def test_the_dumped_defaults_are_the_defaults(tmp_path: Path) -> None:
    file = tmp_path / "all.yaml"
    file.write_text(yaml.safe_dump(Config().model_dump(mode="json")))
    assert resolve_config(Config(), file, environment={}) == Config()


def test_other_environment_variables_are_not_settings() -> None:
    assert resolve_config(Config(), environment={"ADCBF_REAL_DATA": "x", "ADCBF": "y"}) == Config()


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (
            ["tracking.gate_probabilty=0.9"],
            "--set: unknown key tracking.gate_probabilty; did you mean tracking.gate_prob",
        ),
        (["traking.filter=ekf"], "did you mean tracking.filter?"),
        (["foo=1"], "--set: unknown key foo; `adcbf config dump` lists them all"),
        (["nonsense"], "expected stage.key=value"),
        (["prediction.steps=-1"], "prediction.steps: input should be greater than or equal to 1 (got -1)"),
        (["prediction.step_s=.nan"], "prediction.step_s"),
        (["prediction.steps=[1"], "not a YAML value"),
        (["tracking.filter=particle"], "tracking.filter: input should be 'ukf', 'ekf' or 'kf'"),
    ],
)
def test_errors_name_the_key(settings: list[str], text: str) -> None:
    with pytest.raises(UsageError) as error:
        resolve_config(Config(), None, settings, environment={})
    assert text in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("- 1\n", "expected stages"),
        ("tracking: 3\n", "tracking: expected keys below it"),
        ("trackin: 3\n", "did you mean tracking?"),
        ("tracking: {filter: ekf, speed: 3}\n", "unknown key tracking.speed"),
        ("a: [\n", "not valid YAML"),
        ("!!python/object/apply:os.system ['true']\n", "not valid YAML"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, content: str, text: str) -> None:
    file = tmp_path / "run.yaml"
    file.write_text(content)
    with pytest.raises(UsageError) as error:
        resolve_config(Config(), file, environment={})
    assert str(file) in str(error.value)
    assert text in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 5000, "2024-99-99"])
def test_yaml_that_python_cannot_hold_is_wrong_usage(tmp_path: Path, value: str) -> None:
    with pytest.raises(UsageError, match="not a YAML value"):
        resolve_config(Config(), settings=[f"tracking.size_ratio={value}"], environment={})
    path = tmp_path / "run.yaml"
    path.write_text(f"tracking:\n  size_ratio: {value}\n")
    with pytest.raises(UsageError, match="not valid YAML"):
        resolve_config(Config(), path, environment={})


@pytest.mark.parametrize("key", ["prediction.step_s", "perception.cell_m", "evaluation.bootstrap_block_s"])
@pytest.mark.parametrize("value", ["1.0e+300", "1.0e-300", "0", ".inf"])
def test_what_no_clock_and_no_grid_can_hold_is_refused(key: str, value: str) -> None:
    with pytest.raises(UsageError, match=key):
        resolve_config(Config(), settings=[f"{key}={value}"], environment={})


def test_a_missing_file_and_a_binary_one(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="No such file"):
        resolve_config(Config(), tmp_path / "none.yaml", environment={})
    (tmp_path / "b.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="not a text file"):
        resolve_config(Config(), tmp_path / "b.yaml", environment={})


def test_every_setting_says_its_unit_or_has_none() -> None:
    keys = known_keys()
    assert len(keys) == len(set(keys)) > 30
    assert "tracking.gate_probability" in keys


def test_a_finding_on_the_whole_has_no_place() -> None:
    with pytest.raises(ValidationError) as error:
        Config.model_validate_json("{")
    assert first_problem(error.value).startswith("invalid JSON")
