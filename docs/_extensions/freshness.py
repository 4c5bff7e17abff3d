"""What is generated is written only where it differs, so that Sphinx rebuilds only what changed."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path


def write_if_new(path: Path, text: str) -> None:
    """Write ``text`` unless the file holds it already."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def digest(paths: Iterable[Path], root: Path, *words: str) -> str:
    """Return a short digest of files, by their place below ``root`` and their content, and of words."""
    total = hashlib.sha256("\0".join(words).encode())
    for path in sorted(paths):
        total.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return total.hexdigest()[:16]
