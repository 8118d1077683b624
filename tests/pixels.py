"""What a page looks like, in pixels."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.image import imread
from playwright.sync_api import Page


def seen(page: Page) -> np.ndarray:
    """Return what the page shows, (height, width, 3), from 0 to 1."""
    return np.asarray(imread(io.BytesIO(page.screenshot()))[:, :, :3])


def share_of(colour: str, pixels: np.ndarray) -> float:
    """Return the share of pixels that have a colour, which is given as ``#rrggbb``."""
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return float((np.abs(pixels - wanted).max(axis=2) < 0.02).mean())
