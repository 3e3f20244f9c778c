"""A missing system library is named, with the command that installs it."""

from __future__ import annotations

import pytest

from adcbf_cli.core.open3d_import import explain_missing_library


@pytest.mark.parametrize(
    ("library", "package"),
    [("libusb-1.0.so.0", "libusb-1.0-0"), ("libGL.so.1", "libgl1"), ("libgomp.so.1", "libgomp1")],
)
def test_a_missing_library_is_named(library: str, package: str):
    line = explain_missing_library(f"{library}: cannot open shared object file: No such file or directory")
    assert library in line
    assert line.endswith(f"sudo apt-get install -y {package}")


def test_an_unknown_library_gets_the_known_packages():
    line = explain_missing_library("libfoo.so.3: cannot open shared object file")
    assert "libfoo.so.3" in line
    assert line.endswith("libusb-1.0-0 libgl1 libgomp1")


def test_without_the_package_pip_is_named():
    assert "pip install" in explain_missing_library("No module named 'open3d'")
