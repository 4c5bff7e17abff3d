"""What is generated is written only where it differs, so that Sphinx rebuilds only what changed."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path


def write_if_new(path: Path, text: str) -> None:
    """Write ``text`` unless the file holds it already."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


KEEP = "PYMC_BACKBONE_SITE_KEEP"  # with any value: take what was run last as it is, whatever changed since


def newest_or(cache: Path, name: str, key: str) -> Path:
    """Return ``cache/name-key``; where it is not there and `KEEP` is set, the newest ``cache/name-*`` there is."""
    wanted = cache / f"{name}-{key}"
    if wanted.exists() or not os.environ.get(KEEP):
        return wanted
    earlier = [path for path in cache.glob(f"{name}-*") if path.suffix == ""]
    return max(earlier, key=lambda path: path.stat().st_mtime, default=wanted)


def digest(paths: Iterable[Path], root: Path, *words: str) -> str:
    """Return a short digest of files, by their place below ``root`` and their content, and of words."""
    total = hashlib.sha256("\0".join(words).encode())
    for path in sorted(paths):
        total.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return total.hexdigest()[:16]
