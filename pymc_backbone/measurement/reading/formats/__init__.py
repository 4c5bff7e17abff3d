"""Formats of measured records: one file each, from a path to the channels of a `Recording`."""

from __future__ import annotations

import re
from pathlib import Path

from ...._common.checks import InputError
from ...._common.text import natural_key, printable, shorten
from .channel import Channel, Recording

__all__ = ["RECORD_SUFFIXES", "list_recordings", "read_recording"]

RECORD_SUFFIXES = {
    ".csv": "text", ".tsv": "text", ".txt": "text", ".dat": "text", ".asc": "text",
    ".lvm": "LabVIEW", ".mat": "MATLAB", ".uff": "universal", ".unv": "universal", ".uf": "universal",
    ".bunv": "universal", ".nc": "NetCDF", ".nc4": "NetCDF", ".cdf": "NetCDF", ".npz": "NumPy", ".npy": "NumPy",
    ".json": "SEP-005",
}  # fmt: skip
"""Kind of a file by its suffix."""
_MINOR = {".txt", ".dat", ".asc", ".json"}
"""Suffixes of much else beside records: in a folder they count only where nothing else is."""
_NEVER = {"result.json"}
_TDMS = b"TDSm"


def list_recordings(root: Path) -> list[Path]:
    """Return the files of a folder that hold records, naturally sorted; all of one kind.

    Parameters
    ----------
    root : Path
        A folder.

    Returns
    -------
    list of Path
        Empty where there is none.

    Raises
    ------
    InputError
        When the folder holds files of several kinds, which may be the same records twice.
    """
    files = [entry for entry in root.iterdir() if _is_record(entry)]
    major = [file for file in files if file.suffix.lower() not in _MINOR]
    files = major or [file for file in files if file.suffix.lower() != ".json"] or files
    kinds: dict[str, str] = {}
    for file in files:
        kinds.setdefault(RECORD_SUFFIXES[file.suffix.lower()], file.suffix.lower())
    if len(kinds) > 1:
        raise InputError(
            f"{printable(str(root))}: holds {' and '.join(sorted(kinds.values()))} files, which may be the same "
            "records twice; put the files of one kind into a folder of their own."
        )
    return sorted(files, key=lambda file: natural_key(file.name))


def _is_record(entry: Path) -> bool:
    is_hidden = entry.name.startswith((".", "~")) or entry.name in _NEVER
    return entry.suffix.lower() in RECORD_SUFFIXES and not is_hidden and entry.is_file()


def read_recording(path: Path) -> Recording | None:
    """Return the channels of a file by what its first bytes say it is, or None for a text with one header line.

    Parameters
    ----------
    path : Path
        A file.

    Returns
    -------
    Recording or None

    Raises
    ------
    InputError
        When the file cannot be used.
    """
    name = printable(path.name)
    try:
        with path.open("rb") as stream:
            head = stream.read(1024)
    except OSError as error:
        raise InputError(f"{name}: cannot be read ({error.strerror}); check that it is a readable file.") from None
    found = _read(path, name, head)
    return None if found is None else Recording(path, tuple(found[0]), tuple(found[1]))


def try_files() -> None:
    """Be the process in which HDF5 files are tried; see `isolation`."""
    import tempfile

    import xarray

    from . import isolation, mat73, netcdf

    with tempfile.TemporaryDirectory() as folder:  # what is imported later would count into the time of the first file
        example = Path(folder) / "example.nc"
        xarray.Dataset({"x": ("t", [0.0])}).to_netcdf(example, engine="h5netcdf")
        isolation.unasked(netcdf.try_netcdf, example)
    isolation.serve({"netcdf": netcdf.try_netcdf, "mat73": mat73.read_mat73})


def _read(path: Path, name: str, head: bytes) -> tuple[list[Channel], list[str]] | None:
    """Return channels and notes; the readers are imported when they are needed."""
    from . import lvm, mat5, npz, sep005, tree, uff58

    if head.startswith(mat5.MAGIC):
        return tree.channels_of_tree(mat5.read_mat5(path))
    if head.startswith(mat5.MAGIC_73):
        from . import mat73

        return tree.channels_of_tree(mat73.read_mat73(path))
    if head.startswith((npz.ZIP_MAGIC, npz.NPY_MAGIC)):
        if head.startswith(npz.ZIP_MAGIC) and path.suffix.lower() in (".xlsx", ".xlsm", ".ods"):
            raise InputError(f"{name}: is a spreadsheet; save the sheet as CSV.")
        return tree.channels_of_tree(npz.read_npz(path))
    if head.startswith((b"\x89HDF\r\n\x1a\n", b"CDF")):
        from . import netcdf

        if head.startswith(netcdf.CDF5_MAGIC):
            raise InputError(f"{name}: is NetCDF of the 64-bit data variant (CDF-5); convert it with `nccopy -k nc4`.")
        return netcdf.read_netcdf(path)
    if head.startswith(_TDMS):
        raise InputError(f"{name}: is a binary TDMS file; export it as text (LVM or CSV) from LabVIEW or DIAdem.")
    if head.removeprefix(b"\xef\xbb\xbf").startswith(lvm.MAGIC):
        return lvm.read_lvm(path)
    if re.match(rb"[\s\x00]*-1[ \t]*\r?\n", head) and re.match(rb"\s*-1\s+\d+[ b\r\n]", head):
        return uff58.read_uff(path)
    if path.suffix.lower() == ".json":
        return sep005.read_sep005(path)
    if path.suffix.lower() == ".mat":
        what = (
            "a MATLAB 4 file"
            if head[:4] in (b"\0\0\0\0", b"\0\0\x03\xe8")
            else f"no MAT file ({shorten(ascii(head[:12]))})"
        )
        raise InputError(f"{name}: is {what}; save it again in MATLAB with `save -v7`.")
    return None
