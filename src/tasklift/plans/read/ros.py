"""Floor plans as pictures: the map files of ROS (map_server, nav2), without ROS.

A map is a YAML file beside a picture. The rules by which a grey value becomes free, occupied or unknown are those of
map_server; numbers are read as its parser (yaml-cpp) reads them. ``docs/maps.md`` states both.
"""

from __future__ import annotations

import difflib
import math
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.pictures import PICTURE_ENDINGS, Picture, plan_from
from tasklift.plans.plan import Plan
from tasklift.plans.source import Source, number_in
from tasklift.text import shown

TITLE = "ROS map (YAML with image, resolution, origin, …)"
# map_saver writes unknown as grey 205, p = 50/255 = 0.19608: free for a reader whose threshold is above that
SAVED_UNKNOWN_GREY = 205
SAVED_UNKNOWN_P = 0.1961
MODES = ("trinary", "scale", "raw")
_TRUTHS = {"true": 1, "yes": 1, "y": 1, "on": 1, "1": 1, "false": 0, "no": 0, "n": 0, "off": 0, "0": 0}


def recognises(source: Source) -> bool:
    """Whether it is a mapping with a picture or a resolution."""
    return ("image" in source.fields or "resolution" in source.fields) and "levels" not in source.fields


def read(source: Source) -> Plan:
    """Read the picture that the YAML names, by the rules that it sets.

    Raises
    ------
    TaskliftError
        With the field at fault.
    """
    fields = source.fields
    if "image" not in fields:
        raise source.fault("field 'image' is missing; is this the YAML of a map?")
    doubts: list[str] = []
    resolution = _number(source, "resolution", above=0.0, most=1000.0)
    origin = _origin(source, doubts)
    negate = _TRUTHS.get(str(fields.get("negate")).lower())
    if negate is None:
        raise source.fault(f"field 'negate': expected 0 or 1, found {shown(fields.get('negate'))}")
    occupied = _number(source, "occupied_thresh", most=1.0)
    free = _number(source, "free_thresh", most=1.0)
    if free > occupied:
        raise source.fault(f"free_thresh {free:g} is above occupied_thresh {occupied:g}; swap them")
    mode = fields.get("mode", "trinary")
    if mode not in MODES:
        raise source.fault(f"field 'mode': expected {', '.join(MODES)}, found {shown(mode)}")
    source.files.append(_find_image(source, fields["image"], doubts))
    picture = Picture(source.files[-1])
    if picture.is_jpeg:
        doubts.append("the picture is a JPEG, which blurs walls; PNG or PGM would not")
    greys = np.zeros(256, np.int64)
    plan = plan_from(
        picture,
        partial(_classify, negate=bool(negate), occupied=occupied, free=free, mode=mode, greys=greys),
        name=source.path.stem,
        resolution_m=resolution,
        origin=origin,
        inverted=bool(negate),
    )
    _doubt_greys(source, plan, greys, free, mode, bool(negate), doubts)
    object.__setattr__(plan, "doubts", tuple(doubts))
    return plan


def _doubt_greys(
    source: Source, plan: Plan, greys: NDArray[np.int64], free: float, mode: str, negate: bool, doubts: list[str]
) -> None:
    """Say where thresholds and greys do not fit each other; nothing free at all is an error."""
    shares = greys / max(1, greys.sum())
    if mode != "raw" and not negate and free > SAVED_UNKNOWN_P and shares[SAVED_UNKNOWN_GREY] > 0.01:
        doubts.append(
            f"unknown shown as free: {shares[SAVED_UNKNOWN_GREY]:.0%} of the picture is grey 205, which map_saver "
            f"writes for unknown, and free_thresh {free:g} makes it free; 0.196 would not"
        )
    known = ~plan.unknown
    share_free = float(plan.free.sum()) / max(1, int(known.sum()))
    brightest = int(np.flatnonzero(shares > 0.02)[-1]) if (shares > 0.02).any() else 255
    common = int(shares.argmax())
    p = (common if negate else 255 - common) / 255
    if not plan.free.any():
        raise source.fault(
            f"no free space in the picture: the commonest grey is {common} (p = {p:.3f}, {shares[common]:.0%} of the "
            f"picture), and free_thresh {free:g} makes only p below it free; is the threshold right, or 'negate'?"
        )
    if share_free < 0.35 and mode != "raw":
        light, dark = float(shares[200:].sum()), float(shares[:55].sum())
        mostly_dark = dark > 2 * light if not negate else light > 2 * dark
        if mostly_dark:
            doubts.append(
                f"most of the picture is {'black' if not negate else 'white'}, which 'negate: {int(negate)}' makes a "
                f"wall; is it inverted ('negate: {int(not negate)}')?"
            )
    bright_p = (brightest if negate else 255 - brightest) / 255
    if mode == "trinary" and not negate and shares[brightest] > 0.1 and free <= bright_p < 0.5:
        doubts.append(
            f"grey {brightest} ({shares[brightest]:.0%} of the picture, p = {bright_p:.3f}) is the brightest common "
            f"one, and free_thresh {free:g} makes it unknown; a threshold above {bright_p:.3f} would make it free"
        )


def _classify(
    mean: NDArray[np.float32],
    alpha: NDArray[np.float32] | None,
    *,
    negate: bool,
    occupied: float,
    free: float,
    mode: str,
    greys: NDArray[np.int64],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """map_server's rules: ``(free, unknown)`` of every pixel; ``greys`` counts how often each grey comes."""
    greys += np.bincount(np.clip(np.rint(mean), 0, 255).astype(np.uint8).ravel(), minlength=256)
    value = (mean * 3 + alpha) / 4 if mode == "trinary" and alpha is not None else mean
    if mode == "raw":  # the grey value is the occupancy in percent, above 100 it is unknown
        percent = value / np.float32(100)
        known = percent <= 1
        return known & (percent < free), ~known | ((percent >= free) & (percent <= occupied))
    # 205 / 255 is a threshold that people write: keep the comparison exact
    p = (value if negate else 255 - value).astype(np.float64) / 255
    is_free, between = p < free, (p >= free) & (p <= occupied)
    if mode == "trinary":
        return is_free, between
    # scale: in between is a probability; nearer to free than to occupied counts as free
    seen = between if alpha is None else between & (alpha >= 255)
    return is_free | (seen & (p < (free + occupied) / 2)), between & ~seen


def _origin(source: Source, doubts: list[str]) -> tuple[float, float, float]:
    given = source.fields.get("origin")
    values = [number_in(v) for v in given] if isinstance(given, list) and len(given) == 3 else []
    if len(values) != 3 or any(v is None for v in values) or not all(math.isfinite(v or 0) for v in values[:2]):
        raise source.fault(f"field 'origin': expected three numbers [x, y, yaw], found {shown(given)}")
    x, y, yaw = (float(v or 0) for v in values)
    if math.isnan(yaw):
        doubts.append("the yaw of 'origin' is not a number; taken as 0")
        yaw = 0.0
    if not max(abs(x), abs(y), abs(yaw)) <= 1e6:
        raise source.fault(f"field 'origin': {shown(given)} is farther than 1,000 km away")
    return x, y, yaw


def _find_image(source: Source, image: Any, doubts: list[str]) -> Path:
    """The picture: where the YAML says, or the one of that name beside it."""
    if not isinstance(image, str) or not image or "\0" in image:
        raise source.fault(f"field 'image': expected the name of a file, found {shown(image)}")
    path = source.path
    try:
        folder = path.parent.resolve()
        target = (path.parent / image).resolve()
        inside = target.is_relative_to(folder)
        if target.is_file() and (inside or source.allow_outside):
            return target
        base = re.split(r"[/\\]", image)[-1]
        beside = path.parent / base
        if base not in ("", ".", "..") and base != image and beside.is_file() and beside.resolve().parent == folder:
            doubts.append(f"the picture {shown(image)} is not in reach; took {shown(base)} beside the YAML")
            return beside.resolve()
        pictures = sorted(p.name for p in path.parent.glob("*") if p.suffix.lower() in PICTURE_ENDINGS)
    except (OSError, RuntimeError, ValueError) as error:
        raise source.fault(f"image {shown(image)} cannot be opened ({' '.join(str(error).split()):.60})") from error
    near = difflib.get_close_matches(base, pictures, n=1, cutoff=0.0)
    hint = f"there is {shown(near[0])}: correct 'image'" if near else "there is no picture in that folder"
    if not inside and not source.allow_outside and target.exists():
        raise source.fault(
            f"image {shown(image)} leaves the folder of the YAML file; pass --allow-outside if you trust it"
        )
    raise source.fault(f"image {shown(image)} does not exist; {hint}")


def _number(source: Source, key: str, most: float, above: float | None = None) -> float:
    if key not in source.fields:
        raise source.fault(f"field {key!r} is missing")
    value = number_in(source.fields[key])
    fits = value is not None and value <= most and (value > above if above is not None else value >= 0)
    if value is None or not fits:
        low = f"above {above:g}" if above is not None else "from 0"
        raise source.fault(f"field {key!r}: expected a number {low} up to {most:g}, found {shown(source.fields[key])}")
    return value
