"""Files that are no logs: what they are, and where adcbf takes them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.io.inspection import first_bytes, first_lines

READS = "adcbf reads MCAP, ROS 1 bags, rosbag2 folders (.db3, .mcap) and folders of .pcd scans"


@dataclass(frozen=True)
class Recognised:
    """A file that some command takes: what it is, and where to give it."""

    kind: str
    use: str


_FOREIGN = (
    (b"\x89PNG", "a PNG image"),
    (b"\xff\xd8\xff", "a JPEG image"),
    (
        b"ARROW1",
        "a Feather (Arrow) table; convert Argoverse 2 data to a log or a ground-truth CSV first",
    ),
    (b"BZh", "bzip2-compressed; unpack it first (a CARMEN .clf log is not read even then)"),
    (b"\x1f\x8b", "gzip-compressed; unpack it first"),
    (b"\x28\xb5\x2f\xfd", "zstd-compressed; unpack it first (zstd -d), or give the rosbag2 folder that it belongs to"),
    (b"PK\x03\x04", "a zip archive; unpack it first"),
    (b"ply", "a PLY point cloud; convert it to PCD"),
    (b"<?xml", "an XML file"),
)

_FOREIGN_SUFFIXES = {
    ".bin": "a bare binary point cloud (KITTI or SemanticKITTI layout); convert it to PCD",
    ".label": "a SemanticKITTI label file",
    ".clf": "a CARMEN log; convert it to a bag or MCAP first",
    ".npy": "a NumPy array; convert it to PCD",
}


def recognise(path: Path) -> Recognised:
    """What a file that is no log is good for. Raises AdcbfError, with what it is, where adcbf has no use for it."""
    if path.is_dir():
        if (path / "run.json").is_file():
            return Recognised("a run folder of adcbf", f"give it to a later stage: adcbf evaluate {path}")
        bags = sorted(entry.name for entry in path.iterdir() if entry.suffix == ".bag")
        if bags:
            raise AdcbfError(f"{path} holds {len(bags)} bags; name one of them: {', '.join(bags[:10])}")
        raise AdcbfError(f"{path} is a folder without logs; {READS}: give it the folder that holds the files")
    if not path.exists():
        raise AdcbfError(f"{path} does not exist")
    if not path.is_file():
        raise AdcbfError(f"{path} is neither a file nor a folder; {READS}")
    head = first_bytes(path, 16)
    if not head:
        raise AdcbfError(f"{path} is empty")
    if head.startswith(b"PAR1"):
        return Recognised("a Parquet table", f"its run folder is what commands take: {path.parent}")
    foreign = next((what for magic, what in _FOREIGN if head.startswith(magic)), None)
    foreign = foreign or _FOREIGN_SUFFIXES.get(path.suffix.lower())
    known = None if foreign else _text_kind(path)
    foreign = foreign or (None if known else _foreign_table(path))
    if known is None:
        raise AdcbfError(f"{path} is {foreign or 'not something that adcbf knows'}; {READS}")
    return known


def _text_kind(path: Path) -> Recognised | None:
    lines = first_lines(path, 40)
    if not lines:
        return None
    if path.suffix.lower() in (".yaml", ".yml"):
        return _yaml_kind(path, lines)
    words = lines[0].replace(",", " ").split()
    if "," in lines[0] and "track_id" in words:
        return Recognised(
            "a list of objects (CSV)",
            f"ground truth for evaluate (--truth {path}), or a log of its own: adcbf run {path}; "
            f"adcbf replay {path} --start X,Y --goal X,Y",
        )
    if lines[0].startswith(("P0:", "calib_time:")) and any("velo" in line for line in lines):
        return Recognised("a KITTI calibration", "it is read beside the labels of the same name (calib/ beside label/)")
    if len(words) in (17, 18) and words[2].isalpha() and _numbers(words[3:]):
        return Recognised("KITTI tracking labels (ground truth)", "give it to evaluate: --truth FILE")
    if not _numbers(words):
        return None
    values = [float(word) for word in words]
    if len(words) == 8 and abs(math.hypot(*values[4:]) - 1) < 0.05:
        return Recognised(
            "a TUM trajectory", "poses of PCD scans (--pose FILE), or an object's ground truth (--truth FILE)"
        )
    if len(words) == 12:
        return Recognised("a KITTI pose file", "put it as poses.txt beside the PCD scans, or --pose FILE")
    return None


def _foreign_table(path: Path) -> str | None:
    """Tables of numbers that are known but not read."""
    lines = first_lines(path, 1)
    words = lines[0].split() if lines else []
    if not _numbers(words):
        return None
    if len(words) == 30:
        return "a KITTI OXTS table (GPS and IMU); convert it to a TUM trajectory to use its poses"
    if len(words) == 8 and path.name == "obsmat.txt":
        return "a table of pedestrians seen from above (ETH, UCY); it belongs to no LiDAR log"
    return None


def _yaml_kind(path: Path, lines: list[str]) -> Recognised | None:
    keys = {line.partition(":")[0] for line in lines}
    if "rosbag2_bagfile_information" in keys:
        return Recognised("the metadata of a rosbag2 folder", f"give commands the folder: {path.parent}")
    if keys & {"read", "perception", "tracking", "prediction", "evaluation"}:
        return Recognised("settings of adcbf", "give them to any command: --config FILE")
    if {"ego", "lidar"} <= keys:
        return Recognised("a scenario", f"adcbf simulate {path} makes a log of it")
    return None


def _numbers(words: list[str]) -> bool:
    try:
        return all(math.isfinite(float(word)) for word in words)
    except ValueError:
        return False
