"""AMASS archives as dictionaries of arrays."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from ._native import Motion


def to_amass(motion: Motion) -> dict[str, Any]:
    """The motion as the arrays of an AMASS archive, z up, with the keys of the SMPL-X release.

    ``np.savez(path, **motion.to_amass())`` writes a file for tools of AMASS and SMPL-X. GMR plays rates below 30 fps
    as 30: give it ``motion.resample(60)``, as ``stance export --to amass`` does.
    """
    with np.load(io.BytesIO(bytes(motion.to_amass_bytes())), allow_pickle=False) as archive:
        return {key: archive[key] for key in archive.files}


def from_amass(arrays: Mapping[str, Any]) -> Motion:
    """The motion of the arrays of an AMASS archive (SMPL+H or SMPL-X keys, z up), put on the floor.

    Files are read by ``Motion.read(path)``.
    """
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return Motion.from_amass_bytes(buffer.getvalue())


def _restored(*arguments: Any) -> Motion:
    """Makes a motion from its pickled parts."""
    return Motion._restored(*arguments)
