"""Completion as it is met: real shells in a terminal, Tab pressed, and what then stands on the line."""

from __future__ import annotations

import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.writer import Writer

from adcbf_cli.core.planning.names import PLANNER_NAMES
from adcbf_cli.core.planning.presets import PLANNERS
from adcbf_cli.io import run_folder, stored_topics

PROJECT = Path(__file__).resolve().parents[2]
SAMPLE = PROJECT / "sample_data"
PATIENCE_S = 120.0


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home with nothing in it but adcbf on the path, the completion scripts, and a log to complete topics of."""
    folder = tmp_path_factory.mktemp("home")
    (folder / "bin").mkdir()
    adcbf = folder / "bin" / "adcbf"
    adcbf.write_text(f'#!/bin/sh\nPYTHONPATH="{PROJECT}" exec "{sys.executable}" -m adcbf_cli "$@"\n')
    adcbf.chmod(0o755)
    (folder / "sample.mcap").symlink_to(SAMPLE / "sample.mcap")
    for shell in ("bash", "zsh", "fish"):
        (folder / f"completion.{shell}").write_text(run(folder, "adcbf", "completion", shell).stdout)
    return folder


def environment(home: Path, **more: str) -> dict[str, str]:
    path = os.pathsep.join([str(home / "bin"), os.environ["PATH"]])
    return {"PATH": path, "HOME": str(home), "TERM": "dumb", "LC_ALL": "C.UTF-8", **more}


def run(home: Path, *command: str, **more: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, cwd=home, env=environment(home, **more), capture_output=True, text=True, check=True, timeout=PATIENCE_S
    )


def offers(home: Path, line: str) -> list[str]:
    """The values that adcbf offers a completion script for a line."""
    asked = {"_ADCBF_COMPLETE": "complete_fish", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    answer = run(home, "adcbf", **asked, _TYPER_COMPLETE_ARGS=line)
    assert answer.stderr == ""
    return [row.partition("\t")[0] for row in answer.stdout.splitlines() if row]


class Terminal:
    """A shell that believes a person sits before it."""

    def __init__(self, home: Path, *command: str) -> None:
        self.pid, self.handle = pty.fork()
        if self.pid == 0:
            os.chdir(home)
            os.execvpe(command[0], command, environment(home))
        self.seen = ""

    def type(self, keys: str) -> None:
        os.write(self.handle, keys.encode())

    def wait_for(self, pattern: str) -> str:
        """The pattern's first group, of what came since the last one."""
        end = time.monotonic() + PATIENCE_S
        while (found := re.search(pattern, self.seen)) is None:
            if not select.select([self.handle], [], [], max(end - time.monotonic(), 0))[0]:
                raise AssertionError(f"{pattern!r} never came; there is: {self.seen!r}")
            self.seen += os.read(self.handle, 65536).decode(errors="replace")
        self.seen = self.seen[found.end() :]
        return found[1]

    def completed(self, line: str) -> str:
        """The line after Tab: begun with a printf, once it has been completed, and so printed instead of run."""
        self.type(f"{line}\t@\x01printf '<%s>\\n' '\x05'\r")
        return self.wait_for(r"<(adcbf [^>]*)@>")

    def close(self) -> None:
        os.close(self.handle)
        os.waitpid(self.pid, 0)


SETUP = {
    "bash": (("bash", "--norc", "--noprofile", "-i"), "source completion.bash"),
    "zsh": (("zsh", "-f", "-i"), "autoload -Uz compinit && compinit -u -D && source completion.zsh"),
}


@pytest.fixture(scope="module", params=list(SETUP))
def terminal(request: pytest.FixtureRequest, home: Path) -> Iterator[Terminal]:
    command, setup = SETUP[request.param]
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    shell = Terminal(home, *command)
    shell.type(f"{setup} && printf '<%s>' ready\r")
    shell.wait_for("<(ready)>")
    yield shell
    shell.close()


LINES = [
    ("adcbf clu", "adcbf cluster "),
    ("adcbf cluster sample.mcap --lid", "adcbf cluster sample.mcap --lidar "),
    ("adcbf cluster sample.mcap --lidar ", "adcbf cluster sample.mcap --lidar /points "),
    ("adcbf evaluate sample.mcap --truth topic:/o", "adcbf evaluate sample.mcap --truth topic:/odom "),
    ("adcbf run sample.mcap --set tracking.gat", "adcbf run sample.mcap --set tracking.gate_probability="),
    ("adcbf run sample.mcap --set tracking.filter=e", "adcbf run sample.mcap --set tracking.filter=ekf "),
    ("adcbf replay sample.mcap -p od", "adcbf replay sample.mcap -p od-ad-cbf-mpc "),
    ("adcbf simulate cro", "adcbf simulate crossings "),
    ("adcbf info sam", "adcbf info sample.mcap "),
]
"""What is typed before Tab, and what stands there after it."""


@pytest.mark.parametrize(("typed", "after"), LINES)
def test_bash_and_zsh_complete_the_line(terminal: Terminal, typed: str, after: str) -> None:
    assert terminal.completed(typed) == after


@pytest.mark.parametrize(("typed", "after"), LINES[::2])
def test_fish_completes_the_line(home: Path, typed: str, after: str) -> None:
    if shutil.which("fish") is None:
        pytest.skip("fish is not installed")
    script = f"source completion.fish; complete -C '{typed}'"
    found = run(home, "fish", "--no-config", "-c", script).stdout.splitlines()
    assert [row.partition("\t")[0] for row in found] == [after.rstrip().rpartition(" ")[2]]


def test_several_offers_are_all_there(home: Path) -> None:
    assert offers(home, "adcbf replay x.mcap -p ") == [*PLANNER_NAMES, "all"]
    assert offers(home, "adcbf run x --set tracking.filter=") == [f"tracking.filter={n}" for n in ("ukf", "ekf", "kf")]
    assert offers(home, "adcbf cluster sample.mcap --pose ") == ["/odom", "tf", "none"]


def test_topics_come_through_a_run_folder(home: Path) -> None:
    assert stored_topics.MANIFEST == run_folder.MANIFEST
    (home / "done.adcbf").mkdir()
    (home / "done.adcbf" / "run.json").write_text('{"source": {"path": "../sample.mcap"}}')
    assert offers(home, "adcbf plan done.adcbf --lidar ") == ["/points"]


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"nothing of the kind" * 99])
def test_a_log_that_cannot_be_read_offers_nothing_and_says_nothing(home: Path, content: bytes) -> None:
    (home / "bad.mcap").write_bytes(content)
    assert offers(home, "adcbf cluster bad.mcap --lidar ") == []


def test_what_a_shell_would_run_is_never_offered(home: Path) -> None:
    with (home / "hostile.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/PointCloud2", "ros2msg", b"")
        for topic in ("/good", "/$(touch pwned)", "/a;b", "/two words", "/tab\tbed", "/line\nbreak", "/`x`"):
            writer.register_channel(topic, "cdr", schema)
        writer.finish()
    assert offers(home, "adcbf cluster hostile.mcap --lidar ") == ["/good"]


def test_the_names_offered_are_the_planners_there_are() -> None:
    assert tuple(PLANNERS) == PLANNER_NAMES


def test_an_unknown_shell_is_wrong_usage(home: Path) -> None:
    done = subprocess.run(["adcbf", "completion", "tcsh"], env=environment(home), capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == "adcbf: error: tcsh: no shell that adcbf completes in (bash, zsh, fish)\n"
    assert "Traceback" not in done.stderr
