"""Imported by lerobot for images, which these data sets do not have."""

from . import transforms  # noqa: F401
