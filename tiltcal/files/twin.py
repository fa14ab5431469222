"""The twin file: what a virtual sensor really is, ``kind: twin``.

::

    tiltcal: 1
    kind: twin
    model: sca100t-d02
    seed: 7
    truth:
      offset: {x: 1024.6, y: 1021.9}          # offset, sensitivity and temperature as in a calibration file
      sensitivity:
        x: {x: 818.2, y: 9.1, z: 2.0}
        y: {x: -6.4, y: 820.7, z: -1.5}
      temperature: {reference: 24.0, offset: {x: [0.21], y: [-0.05]}}
      nonlinearity: {x: [0.002, -0.004]}      # coefficients of a², a³, ... where a is the signal in g
      noise: {x: 0.6, y: 0.6}                 # standard deviation of one sample, unit
      thermometer_error: 0.5                  # °C
      supply: 4.9                             # of an analog sensor, V
      jig: 0.01                               # standard deviation of a set angle, degrees
      ambient: 24.0                           # °C
      time_constant: 300                      # of the chamber, seconds
      mounting: {roll: 90, pitch: 0, yaw: 0}  # how it sits on the fixture, degrees
      faults:
        - {kind: parity, start: 12.0, end: 12.5}   # seconds after the session began

Of a ``gradiometer`` the truth is a disk instead::

    truth:
      disk:
        inclination: 0.086                    # of the spin axis, degrees
        spin: 0.125                           # Hz
        rate: 50                              # lines a second
        wander: 0.01                          # of the common acceleration, relative
        gradient: {differential: 0, cross: 0} # R (Γxx - Γyy) and R Γxy, g
        noise: 1.5e-7                         # one-sided amplitude density, g/√Hz
        corner: 0.05                          # where 1/f noise is as large, Hz
        encoder_noise: 0.002                  # standard deviation, degrees
        accelerometers:
          a1: {scale: 3.383, misalignment: -1.27, phase_error: 0, offset: 0, drift: 0, second_order: 0}
          a2: {scale: 3.415}                  # unit/g; degrees; degrees; unit; unit/s; 1/g
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Any

from tiltcal.core.model import AXES
from tiltcal.drivers.twin.gradiometer import CHANNELS, Accelerometer, Disk
from tiltcal.drivers.twin.stage import FASTEST, StageTruth
from tiltcal.drivers.twin.truth import Fault, Polynomial, Truth
from tiltcal.files.coefficients import read_per_channel, read_polynomials, read_rows
from tiltcal.files.document import read_tiltcal_file
from tiltcal.files.node import Node

FAULTS = ("parity", "stuck", "silent", "unplugged")


def read_twin(path: str | Path, seed: int | None = None) -> tuple[str | None, Truth]:
    """Read and check a twin file.

    Parameters
    ----------
    path : str or Path
    seed : int, optional
        In place of the file's.

    Returns
    -------
    model : str or None
        The sensor model that the file is for; None where it fits any.
    truth : Truth

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and key.
    """
    top = read_tiltcal_file(path, "twin").mapping(required=("tiltcal", "kind", "truth"), optional=("model", "seed"))
    written = top["seed"].integer(minimum=0) if "seed" in top else Truth.seed
    model = top["model"].text() if "model" in top else None
    return model, _read_truth(top["truth"], written if seed is None else seed)


def _read_truth(node: Node, seed: int) -> Truth:
    if "disk" in node.entries():
        section = node.mapping(required=("disk",), optional=("faults",))
        return replace(StageTruth.of(_read_disk(section["disk"]), seed), faults=_read_faults(section))
    section = node.mapping(
        required=("offset", "sensitivity"),
        optional=(
            *("temperature", "nonlinearity", "noise", "thermometer_error", "supply"),
            *("jig", "ambient", "time_constant", "mounting", "faults"),
        ),
    )
    channels = _read_channels(section["offset"])
    given: dict[str, Any] = {}
    if "temperature" in section:
        given.update(_read_temperature(section["temperature"], channels))
    if "nonlinearity" in section:
        given["nonlinearity"] = _read_polynomials(section["nonlinearity"], channels)
    if "noise" in section:
        given["noise"] = _read_noise(section["noise"], channels)
    if "mounting" in section:
        angles = section["mounting"].mapping(optional=("roll", "pitch", "yaw"))
        given["mounting"] = tuple(angles[n].number() if n in angles else 0.0 for n in ("roll", "pitch", "yaw"))
    given["faults"] = _read_faults(section)
    given.update((name, section[name].number()) for name in ("thermometer_error", "ambient") if name in section)
    given.update(
        (name, section[name].number(minimum=0.0)) for name in ("supply", "jig", "time_constant") if name in section
    )
    return Truth(
        channels=channels,
        offset=read_per_channel(section["offset"], channels),
        sensitivity=_read_sensitivity(section["sensitivity"], channels),
        seed=seed,
        **given,
    )


def _read_channels(node: Node) -> tuple[str, ...]:
    """The channels are those that have an offset, in the order x, y, z."""
    named = node.mapping(optional=AXES)
    if not named:
        raise node.error("no channel; give an offset for one to three of x, y, z")
    return tuple(axis for axis in AXES if axis in named)


def _read_sensitivity(node: Node, channels: tuple[str, ...]) -> dict[str, dict[str, float]]:
    rows = read_rows(node, channels)
    for channel, row in rows.items():
        if row.get(channel, 0.0) == 0.0:
            raise node.entries()[channel].error(f"the channel does not sense its own axis; give a {channel} not 0")
    return rows


def _read_temperature(node: Node, channels: tuple[str, ...]) -> dict[str, Any]:
    section = node.mapping(required=("reference",), optional=("offset", "sensitivity"))
    given: dict[str, Any] = {"reference": section["reference"].number()}
    for name, term in (("offset", "drift"), ("sensitivity", "gain")):
        if name in section:
            given[term] = _read_polynomials(section[name], channels)
    return given


def _read_polynomials(node: Node, channels: tuple[str, ...]) -> dict[str, Polynomial]:
    return {channel: tuple(numbers) for channel, numbers in read_polynomials(node, channels).items()}


def _read_noise(node: Node, channels: tuple[str, ...]) -> dict[str, float]:
    return {name: value.number(minimum=0.0) for name, value in node.mapping(optional=channels).items()}


def _read_faults(section: Mapping[str, Node]) -> tuple[Fault, ...]:
    return tuple(_read_fault(item) for item in section["faults"].items()) if "faults" in section else ()


def _read_fault(node: Node) -> Fault:
    section = node.mapping(required=("kind", "start", "end"))
    start, end = section["start"].number(minimum=0.0), section["end"].number()
    if end <= start:
        raise section["end"].error(f"the fault ends at {end:g} s, not after its start at {start:g} s")
    return Fault(section["kind"].choice(FAULTS), start, end)


_NOT_NEGATIVE = ("wander", "noise", "corner", "encoder_noise")


def _read_disk(node: Node) -> Disk:
    section = node.mapping(optional=("inclination", "spin", "rate", *_NOT_NEGATIVE, "gradient", "accelerometers"))
    given: dict[str, Any] = {name: section[name].number(minimum=0.0) for name in _NOT_NEGATIVE if name in section}
    if "inclination" in section:
        given["inclination"] = radians(section["inclination"].number())
    if "spin" in section:
        given["spin"] = section["spin"].number()
    if "rate" in section:
        given["rate"] = section["rate"].number(above=0.0)
        if given["rate"] > FASTEST:
            raise section["rate"].error(f"more than {FASTEST:g} lines a second do not fit on the virtual line")
    if "gradient" in section:
        gradient = section["gradient"].mapping(required=("differential", "cross"))
        given["gradient"] = (gradient["differential"].number(), gradient["cross"].number())
    if "accelerometers" in section:
        parts = section["accelerometers"].mapping(required=CHANNELS)
        given["accelerometers"] = tuple(_read_accelerometer(parts[name]) for name in CHANNELS)
    return Disk(**given)


def _read_accelerometer(node: Node) -> Accelerometer:
    plain, angles = ("offset", "drift", "second_order"), ("misalignment", "phase_error")
    section = node.mapping(required=("scale",), optional=(*plain, *angles))
    return Accelerometer(
        section["scale"].number(),
        **{name: section[name].number() for name in plain if name in section},
        **{name: radians(section[name].number()) for name in angles if name in section},
    )
