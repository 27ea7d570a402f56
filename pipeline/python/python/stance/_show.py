"""Motions in a notebook: the 3D viewer of reports in a frame, without a server or a network."""

from __future__ import annotations

import html
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from . import _native
from ._native import Motion, Triplet


class Shown:
    """A page with motions in 3D: a notebook shows it, and :meth:`save` writes it to a file."""

    def __init__(self, page: str, height: int, text: str) -> None:
        self.page = page
        self.height = height
        self._text = text

    def _repr_html_(self) -> str:
        # The frame runs the page's script and separates its styles; sandboxed, it cannot reach the notebook.
        return (
            f'<iframe srcdoc="{html.escape(self.page)}" sandbox="allow-scripts" title="Motions in 3D" '
            f'style="width: 100%; height: {self.height}px; border: 0"></iframe>'
        )

    def __repr__(self) -> str:
        return self._text

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the page as an HTML file that needs nothing else."""
        Path(path).write_text(self.page, encoding="utf-8")


def of_each(what: str, given: Iterable[str] | None, motions: Sequence[Motion]) -> list[str]:
    """One text for each motion; empty texts if ``given`` is ``None``."""
    texts = [""] * len(motions) if given is None else list(given)
    if len(texts) != len(motions):
        raise ValueError(f"{what} has {len(texts)} texts for {len(motions)} motions")
    return texts


def show(
    *motions: Motion,
    names: Iterable[str] | None = None,
    captions: Iterable[str] | None = None,
    title: str = "",
    joints: Iterable[str] = (),
    height: int = 440,
) -> Shown:
    """Shows motions side by side in 3D, in a notebook that displays the result.

    ``names`` and ``captions`` stand above each motion, ``title`` above all. ``joints``, such as those of an edit, are
    marked in green. ``height`` is in pixels. All motions run at the rate of the first. Positions are rounded to 1 mm;
    a frame takes 224 bytes.

    Drag to turn the camera; after a click the wheel zooms, Space plays, and the arrows step.
    """
    pairs = zip(of_each("names", names, motions), of_each("captions", captions, motions))
    labels = ["\n".join(filter(None, pair)) for pair in pairs]
    page = _native.viewer_page(list(motions), labels, title, list(joints))
    return Shown(page, height, f"Shown({', '.join(map(repr, motions))})")


def show_triplet(triplet: Triplet) -> Shown:
    """The original and the edited motion under their instruction, with the joints of the edit marked."""
    return show(
        triplet.original,
        triplet.edited,
        names=["original", "edited"],
        title=triplet.instruction,
        joints=[*triplet.hard_joints, *triplet.soft_joints],
    )
