"""Files that people try which are not maps: what they are, and what to do about them."""

from __future__ import annotations

from tasklift.plans.source import Source
from tasklift.text import shown

_SIGNATURES: tuple[tuple[bytes, str], ...] = (
    (b"version https://git-lfs", "is a Git LFS pointer, not the file itself: run git lfs pull"),
    (b"%PDF", "is a PDF: export it as PNG (and give --resolution) or as DXF"),
    (b"AC10", "is a DWG drawing: save it as DXF"),
    (b"PK\x03\x04", "is an archive (ZIP): unpack it"),
    (b"\x1f\x8b", "is compressed (gzip): unpack it"),
    (b"BZh", "is compressed (bzip2): unpack it"),
    (b"\xfd7zXZ", "is compressed (xz): unpack it"),
    (b"7z\xbc\xaf", "is an archive (7z): unpack it"),
    (b"#ROSBAG", "is a recording (ROS bag): save its map with map_saver"),
    (b"\x89MCAP", "is a recording (MCAP): save its map with map_saver"),
    (b"SQLite format 3", "is a database (a ROS 2 bag, or an experiment): save its map with map_saver"),
    (b"# .PCD", "is a point cloud (PCD): project it onto a floor plan first"),
    (b"ply", "is a point cloud or mesh (PLY): project it onto a floor plan first"),
    (b"# Octomap OcTree", "is an OctoMap: project it with octomap_server and save that map"),
    (b"ISO-10303-21", "is an IFC or STEP model: export a storey as DXF"),
    (b"glTF", "is a 3-D model (glTF): export a floor plan as PNG or DXF"),
    (b"%!PS", "is PostScript: export it as PNG (and give --resolution) or as DXF"),
    (b"\x93NUMPY", "is a NumPy array: save it as a picture"),
)
_ROOTS = {
    "svg": "is an SVG drawing: export it as PNG (and give --resolution) or as DXF",
    "html": "is a web page: download the file itself (its raw version)",
    "sdf": "is a Gazebo world (SDF): export its map as a picture, or use gazebo_ros's occupancy map",
    "world": "is a simulator's world: export its map as a picture",
    "robot": "is a robot's description (URDF), not a map",
    "kml": "is KML of a globe, not a floor plan",
    "gpx": "is a GPX track, not a floor plan",
}


def by_signature(source: Source) -> str | None:
    """What a file is that begins like something else than a map, and what to do; ``None`` where that is not known."""
    head = source.head
    for signature, said in _SIGNATURES:
        if head.startswith(signature):
            return said
    if head[:512].lower().lstrip().startswith((b"<!doctype html", b"<html")):
        return _ROOTS["html"]
    return None


def by_content(source: Source) -> str:
    """What a document is that no reader recognises."""
    if source.xml is not None:
        root = source.xml.tag.rpartition("}")[2]
        return _ROOTS.get(root.lower(), f"is XML with the root {shown(root)}, which is not a map that is read")
    kind = source.fields.get("format")
    if isinstance(kind, str) and kind.startswith("tasklift-"):
        return f"is a file of the kind {shown(kind)}; expected a map, or a building ('tasklift-building')"
    fields = ", ".join(str(key) for key in list(source.fields)[:5])
    found = f"has the fields {shown(fields)}" if fields else "begins like none of them"
    return f"is not a map that is read here: it {found}; 'tasklift map formats' lists what is read"
