"""Formats that are only read, beside those of `export`."""

from __future__ import annotations

import dataclasses

from drake_rho.formats.ulog import ULog
from drake_rho.scenario.maps import mesh_files, octomaps, point_clouds, world_xml


@dataclasses.dataclass(frozen=True)
class OnlyRead:
    """Format that is only read."""

    name: str
    """name of the format"""
    endings: tuple[str, ...]
    """endings of its files"""
    content: str
    """description of what a file holds"""
    read_by: str
    """how a file is read"""


ONLY_READ = (
    OnlyRead("lsc", (".json",), "a mission of the LSC planner", "rho.load_lsc_mission(path, grid)"),
    OnlyRead("crazyflies", (".yaml",), "robots of Crazyswarm2", "rho.load_crazyflies(path)"),
    OnlyRead("octomap", octomaps.ENDINGS, "cells", "rho.Voxels.from_octomap(path, unknown)"),
    OnlyRead("points", point_clouds.ENDINGS, "points", "rho.Voxels.from_points(path, resolution)"),
    OnlyRead("mesh", mesh_files.ENDINGS, "triangles", "rho.Mesh.load(path)"),
    OnlyRead("world", world_xml.ENDINGS, "shapes that collide", "rho.load_world(path)"),
    OnlyRead(ULog.name, (".ulg",), ULog.content, ULog.read_by),
)
"""Formats of missions, robots, obstacles and logs."""
