"""Imported by lerobot for images, which these datasets do not have."""

from . import transforms  # noqa: F401
