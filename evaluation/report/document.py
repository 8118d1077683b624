"""What ``report.json`` and ``study.json`` are made of: strict JSON, the same text for the same results."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def json_text(document: Mapping[str, Any]) -> str:
    """Return the text of a document that `evaluation.storage.plain` has made strict."""
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
