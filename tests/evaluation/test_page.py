"""The page in a real browser, offline."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
from matplotlib.image import imread

from evaluation.report import save_report
from tests.chromium import find_chromium
from tests.evaluation.known_models import Known, Sliding, fitted
from tests.evaluation.test_report import make_report


def test_the_page_opens_offline_and_its_pictures_are_drawn(tmp_path: Path) -> None:
    _, page = save_report(make_report({"known": fitted(Known()), "sliding": fitted(Sliding())}), tmp_path)
    picture = tmp_path / "page.png"
    subprocess.run(
        [
            find_chromium(),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-background-networking",
            "--hide-scrollbars",
            f"--user-data-dir={tmp_path / 'profile'}",
            f"--screenshot={picture}",
            "--window-size=1200,6000",
            page.as_uri(),
        ],
        check=True,
        capture_output=True,
        timeout=120,
    )
    pixels = imread(picture)[:, :, :3]
    assert pixels.shape[:2] == (6000, 1200)
    inked = pixels.min(axis=2) < 0.5
    assert np.count_nonzero(inked.sum(axis=1)) > 1500
    # the lines of the horizon curve: their colour occurs in pictures alone
    orange = np.abs(pixels - np.array([0xD5, 0x5E, 0x00]) / 255.0).max(axis=2) < 0.03
    assert orange.sum() > 300
    # nothing sticks out of the column of 60 rem
    assert not inked[:, 1100:].any()
