"""The one place that imports open3d: its wheel wants system libraries that may be missing, and then
the error has to say which and how to install them."""

from __future__ import annotations

import re
from typing import Any

from adcbf_cli.core.errors import AdcbfError

DEBIAN_PACKAGES = {
    "libusb-1.0": "libusb-1.0-0",
    "libGL": "libgl1",
    "libgomp": "libgomp1",
    "libX11": "libx11-6",
    "libEGL": "libegl1",
}


def load_open3d() -> Any:
    """The open3d module. Raises AdcbfError with the apt command where a system library is missing."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise AdcbfError(explain_missing_library(str(error))) from error
    return open3d


def explain_missing_library(reason: str) -> str:
    """One line from the loader's message, such as 'libGL.so.1: cannot open shared object file'."""
    missing = re.search(r"(lib[\w.+-]+?)\.so[\w.]*", reason)
    if missing is None:
        return f"open3d could not be loaded ({reason}); install it with: pip install 'open3d>=0.19'"
    package = DEBIAN_PACKAGES.get(missing.group(1))
    packages = package if package else "libusb-1.0-0 libgl1 libgomp1"
    return f"open3d needs the system library {missing.group(0)}; install it with: sudo apt-get install -y {packages}"
