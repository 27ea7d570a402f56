"""Human-motion data, MotionCutMix and evaluation for text-guided motion editing.

Motions are SMPL-X parameters, y up, in metres and radians; the character's left is +x at rest and it faces +z.
Arrays are NumPy's, ``float32`` unless said otherwise. Calls that take more than a moment release Python's lock and
end on Ctrl-C. Failures raise :class:`stance.Error`, with the same ``code`` as in the command.
"""

from __future__ import annotations

import json as _json
import os as _os
from collections.abc import Iterable as _Iterable
from typing import Any as _Any

from . import _native
from ._dataset import Dataset
from ._errors import Error
from ._evaluate import Scores, evaluate
from ._mix import Batch, MotionCutMix
from ._native import (
    SCHEMA_VERSION,
    Encoder,
    Item,
    Motion,
    Triplet,
    blend,
    diversity,
    fid,
    foot_score,
    foot_slide,
    jerk,
    multimodality,
    position_error,
    retrieval,
)
from ._rerun import to_rerun
from ._show import Shown, show

__version__: str = _native.VERSION

__all__ = [
    "Batch",
    "Dataset",
    "Encoder",
    "Error",
    "Item",
    "Motion",
    "MotionCutMix",
    "SCHEMA_VERSION",
    "Scores",
    "Shown",
    "Triplet",
    "blend",
    "corpus",
    "diversity",
    "evaluate",
    "fid",
    "foot_score",
    "foot_slide",
    "ingest",
    "jerk",
    "masks",
    "multimodality",
    "position_error",
    "retrieval",
    "show",
    "to_rerun",
]

_Path = str | _os.PathLike[str]


def ingest(sources: _Path | _Iterable[_Path], out: _Path, **options: _Any) -> dict[str, _Any]:
    """Turns motion files into one checked dataset at ``out``, or adds to it, as ``stance ingest`` does.

    Sources and ``out`` may be URLs (``s3://``, ``gs://``, ``az://``; sources also ``http://``), with credentials from
    the environment.

    ``options``: ``fps`` (20; ``None`` keeps each clip's own), ``resample`` (``exact`` or ``humanml3d``), ``format``,
    ``seed``, ``license``, ``features`` (``humanml3d``), ``teleports`` (``quarantine``, ``trim`` or ``keep``),
    ``lenient``, ``made_captions``, ``pairs``, ``splits``, ``new_version``, ``prune``, ``drop_labels``, ``progress``.

    Returns the counts: ``sources`` is always ``ingested + quarantined + skipped``, and ``quarantine`` lists
    rejected clips with code, reason and byte offset. A bad file raises no exception.
    """
    if isinstance(sources, (str, _os.PathLike)):
        sources = [sources]
    return _json.loads(_native.ingest(list(sources), out, **options))


def masks(dataset: _Path) -> None:
    """Writes masks of the body parts that each clip is about, by their speed, as ``stance masks`` does.

    :class:`MotionCutMix` needs masks. Fails if people have judged masks of the dataset.
    """
    _native.masks(dataset)


def corpus(out: _Path, clips: int | None = None, seed: int = 0) -> None:
    """Writes the built-in corpus of procedural motions to a folder, as files that :func:`ingest` reads."""
    _native.corpus(out, clips, seed)
